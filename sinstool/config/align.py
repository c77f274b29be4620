"""Where the vehicle points: at rest, in flight, or as somebody says."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from sinstool.config.group import Group
from sinstool.core.errors import ConfigurationError

IN_FLIGHT = ("svd", "quest", "davenport", "triad")


class AlignOptions(Group):
    """Where the vehicle points, and where it is."""

    align: Literal[
        "auto", "level", "gyrocompass", "log", "fixed", "svd", "quest", "davenport", "triad"
    ] = Field(
        "auto",
        description="first attitude: tilt from the still lead-in with heading 0 (level), heading"
        " from the Earth's rotation too (gyrocompass), the first valid orientation in the Imu"
        " topic (log), --initial-attitude (fixed), or in motion from GNSS velocity by a solver of"
        " Wahba's problem (svd, quest, davenport) or from two vectors (triad); auto takes svd"
        " where GNSS velocity shows heading, gyrocompass where the gyro is good enough, else"
        " level, else log, else the mean specific force of the first second",
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


class GnssOptions(Group):
    """The receiver: where its antenna is, when its fixes were valid, how good they are."""

    lever_arm: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0), description="from the Imu to the antenna in metres, FRD"
    )
    gnss_latency: float | None = Field(
        None,
        ge=-10,
        le=10,
        description="seconds by which a fix is older than its stamp says on the Imu's clock"
        " (default: 0 for alignment, estimated by the filter)",
    )
    gnss_sigma_v: float = Field(
        0.1, gt=0, description="velocity noise in m/s per axis where the log gives none"
    )


class InFlightOptions(Group):
    """Alignment in motion, from vectors in inertial space."""

    vectors: Literal["win", "cen", "int", "diff", "diffc", "pos"] = Field(
        "win",
        description="integrated vectors: differences over a sliding window (win), less their mean"
        " (cen), from the start (int); differentiated velocity, backward (diff) or central"
        " (diffc); or positions (pos)",
    )
    window: float = Field(2.0, gt=0, description="of win, seconds")
    fade: float | None = Field(
        None, gt=0, description="time constant in seconds with which old pairs are forgotten"
    )
    gate: Literal["auto", "paper", "mask", "off"] = Field(
        "auto",
        description="paper: start and stop by the vehicle's dynamics; mask: leave out pairs that"
        " span lively samples; off; auto: paper where the log shows a lift-off, else off",
    )
    refine: Literal["kf", "none"] = Field(
        "kf", description="a linear Kalman filter over the same vectors, started from the solver's"
    )
    align_start: float | None = Field(
        None, ge=0, description="use GNSS from so many seconds after the log's start"
    )
    align_end: float | None = Field(
        None,
        gt=0,
        description="and up to so many (default: 200 s after the start of alignment)",
    )
    at: str = Field(
        "end", description="when `align` gives the attitude: end, start, or seconds from the start"
    )
    lift_off: float | None = Field(
        None, description="seconds from the log's start (default: first time above 2 g)"
    )
    f_set: float = Field(12.0, gt=0, description="gate: specific force below this, m/s^2")
    df_set: float = Field(100.0, gt=0, description="gate: its change below this, m/s^3")
    w_set: float = Field(5.0, gt=0, description="gate: angular rate below this, deg/s")
    dw_set: float = Field(100.0, gt=0, description="gate: its change below this, deg/s^2")
    t_set1: float = Field(40.0, ge=0, description="gate: start so long after lift-off, s")
    n_set1: int = Field(1, ge=1, description="gate: start after so many calm samples in a row")
    t_set2: float = Field(200.0, ge=0, description="gate: stop so long after the start, s")
    n_set2: int = Field(200, ge=1, description="gate: stop after so many calm samples in a row")
    gate_smooth: int = Field(1, ge=1, description="gate: samples averaged before the tests")
    sigma_stop: float | None = Field(
        None, gt=0, description="stop as soon as the worst sigma is below this, deg"
    )
    sigma_bg: float | None = Field(None, gt=0, description="gyro bias, deg/h, instead of grade's")
    sigma_ba: float | None = Field(
        None, gt=0, description="accelerometer bias, m/s^2, instead of the grade's"
    )
    sigma_sf: float | None = Field(
        None, gt=0, description="scale factors, relative, instead of the grade's"
    )
    arw: float | None = Field(None, gt=0, description="deg/sqrt(h), instead of the grade's")
    vrw: float | None = Field(None, gt=0, description="micro-g/sqrt(Hz), instead of the grade's")
    kappa: float = Field(
        4.0, gt=0, description="factor on the variances of sensor errors; 1 for constant errors"
    )
    gyro_range: float | None = Field(
        None, gt=0, description="deg/s at which the gyro clips; alignment starts after that"
    )
    accel_range: float | None = Field(None, gt=0, description="m/s^2, the same")

    def check(self) -> None:
        """The span of alignment is one, and the time asked for is a time."""
        if (
            self.align_start is not None
            and self.align_end is not None
            and not self.align_start < self.align_end
        ):
            raise ConfigurationError("--align-end is not after --align-start")
        if self.at not in ("end", "start"):
            try:
                float(self.at)
            except ValueError:
                raise ConfigurationError(
                    f"--at {self.at}: not end, start or a number of seconds"
                ) from None
