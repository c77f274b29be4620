"""What is computed: attitude alone, or a whole navigation solution with its vertical channel."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from sinstool.config.group import Group
from sinstool.core.errors import ConfigurationError


class NavigationOptions(Group):
    """What is computed, and from where it starts."""

    mode: Literal["auto", "attitude", "ins", "ins-gnss"] = Field(
        "auto",
        description="what is computed: attitude; or attitude, velocity and position, from inertial"
        " data alone (ins) or with GNSS (ins-gnss); auto is ins-gnss where the log has fixes and"
        " velocity, else attitude",
    )
    initial_velocity: tuple[float, float, float] | None = Field(
        None,
        description="north, east, down in m/s at the start (default: GNSS velocity, else at rest)",
    )
    imu_grade: Literal["auto", "mems", "tactical", "navigation"] = Field(
        "auto",
        description="of the sensors, where the configuration gives no noise; auto judges by the"
        " gyro's noise at rest",
    )
    attitude_order: Literal["exact", "1", "2", "3", "4"] = Field(
        "exact",
        description="quaternion of an update in ins: exact, or Picard's approximation of an order",
    )


class HeightOptions(Group):
    """The vertical channel and what damps it."""

    height_damping: Literal["off", "baro", "gnss"] = Field(
        "off",
        description="third-order network that holds height to the barometer or to GNSS heights",
    )
    height_preset: Literal["recommended", "paper"] = Field(
        "recommended",
        description="recommended: tau 5, 30 or 100 s by --imu-grade, K4 = 0; paper: tau 2.4 s, K4"
        " = 0.5",
    )
    tau: float | None = Field(
        None, gt=0, le=3000, description="time constant in seconds, instead of the preset's"
    )
    k4: float | None = Field(
        None,
        description="gain of vertical velocity in s, |K4| < tau, instead of the preset's",
    )
    baro_lag: float = Field(
        0.0, ge=0, le=60, description="known first-order lag of the barometer in seconds"
    )
    baro_ref: Literal["auto", "gnss", "init"] = Field(
        "auto",
        description="what the barometer is set by: GNSS heights of its first 30 s, or the height at"
        " the start; auto takes GNSS where there is any",
    )
    qnh: float | None = Field(
        None, ge=8e4, le=1.1e5, description="altimeter setting in Pa, instead of --baro-ref"
    )
    undulation: float = Field(
        0.0,
        ge=-120,
        le=100,
        description="height of mean sea level above the ellipsoid in metres, with --qnh",
    )

    def check(self) -> None:
        """K4 and the lag leave the network stable."""
        if self.tau is not None and self.k4 is not None and not abs(self.k4) < self.tau:
            raise ConfigurationError(
                f"--k4 {self.k4:g} is not below --tau {self.tau:g} in size",
                "the network is stable for -tau < K4 < tau; 0 is recommended",
            )
        if self.height_damping == "off":
            given = [
                f"--{name}" for name in ("tau", "k4", "qnh") if getattr(self, name) is not None
            ]
            if given:
                raise ConfigurationError(
                    f"{given[0]} is given, but --height-damping is off",
                    "add --height-damping baro or leave it out",
                )
