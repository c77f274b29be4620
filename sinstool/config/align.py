"""Where the vehicle points when the log begins."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from sinstool.config.group import Group
from sinstool.errors import ConfigurationError


class AlignOptions(Group):
    """Where the vehicle points when the log begins."""

    align: Literal["auto", "level", "log", "fixed"] = Field(
        "auto",
        description="first attitude: tilt from the still lead-in with heading 0 (level), the"
        " first valid orientation in the Imu topic (log), or --initial-attitude (fixed); auto"
        " takes level, else log, else the mean specific force of the first second",
    )
    initial_attitude: tuple[float, float, float] | None = Field(
        None, description="roll, pitch, heading in degrees of FRD axes in NED, for --align fixed"
    )
    gyro_bias: Literal["still", "none"] | tuple[float, float, float] = Field(
        "still",
        description="still: the mean of the still lead-in is removed; none; or X,Y,Z in rad/s in"
        " the log's axes",
    )
    latitude: float | None = Field(
        None, ge=-90, le=90, description="degrees, where the log has no fix"
    )
    longitude: float | None = Field(None, ge=-180, le=180, description="degrees")
    height: float | None = Field(None, description="metres above the ellipsoid")

    def check(self) -> None:
        """An attitude is given where, and only where, it is taken."""
        fixed = self.align == "fixed"
        if fixed and self.initial_attitude is None:
            raise ConfigurationError(
                "--align fixed needs an attitude", "give --initial-attitude ROLL,PITCH,HEADING"
            )
        if not fixed and self.initial_attitude is not None:
            raise ConfigurationError(
                f"--initial-attitude is given, but --align is {self.align}",
                "add --align fixed or leave it out",
            )
