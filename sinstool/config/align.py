"""The first attitude: found at rest or in motion, or given."""

from __future__ import annotations

from typing import Literal

from sinstool.core.errors import ConfigurationError
from sinstool.core.options import Group, option

IN_FLIGHT = ("svd", "quest", "davenport", "triad")


class AlignOptions(Group):
    """Where the vehicle points, and where it is."""

    align: Literal[
        "auto", "level", "gyrocompass", "log", "fixed", "svd", "quest", "davenport", "triad"
    ] = option(
        "auto",
        "first attitude: tilt from the still lead-in with heading 0 (level), heading"
        " from the Earth's rotation too (gyrocompass), the first valid orientation in the Imu"
        " topic (log), --initial-attitude (fixed), or in motion from GNSS velocity by a solver of"
        " Wahba's problem (svd, quest, davenport) or from two vectors (triad); auto takes svd"
        " where GNSS velocity shows heading, gyrocompass where the gyro is good enough, else"
        " level, else log, else the mean specific force of the first second",
    )
    initial_attitude: tuple[float, float, float] | None = option(
        None,
        "roll, pitch, heading in degrees of FRD axes in NED, for --align fixed",
        "ROLL,PITCH,HEADING",
    )
    gyro_bias: Literal["still", "none"] | tuple[float, float, float] = option(
        "still",
        "still: the mean of the still lead-in is removed; none; or X,Y,Z in rad/s in"
        " the log's axes",
        "X,Y,Z|still|none",
    )
    latitude: float | None = option(None, "degrees, where the log has no fix", "DEG", ge=-90, le=90)
    longitude: float | None = option(None, "degrees", "DEG", ge=-180, le=180)
    height: float | None = option(None, "metres above the ellipsoid", "M")

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

    lever_arm: tuple[float, float, float] = option(
        (0.0, 0.0, 0.0), "from the Imu to the antenna in metres, FRD", "X,Y,Z"
    )
    gnss_latency: float | None = option(
        None,
        "seconds by which a fix is older than its stamp says on the Imu's clock"
        " (default: 0 for alignment, estimated by the filter)",
        "S",
        ge=-10,
        le=10,
    )
    gnss_sigma_v: float = option(
        0.1, "velocity noise in m/s per axis where the log gives none", "M/S", gt=0
    )


class InFlightOptions(Group):
    """Alignment in motion, from vectors in inertial space."""

    vectors: Literal["win", "cen", "int", "diff", "diffc", "pos"] = option(
        "win",
        "integrated vectors: differences over a sliding window (win), less their mean"
        " (cen), from the start (int); differentiated velocity, backward (diff) or central"
        " (diffc); or positions (pos)",
    )
    window: float = option(2.0, "of win, seconds", "S", gt=0)
    fade: float | None = option(
        None, "time constant in seconds with which old pairs are forgotten", "S", gt=0
    )
    gate: Literal["auto", "paper", "mask", "off"] = option(
        "auto",
        "paper: start and stop by the vehicle's dynamics; mask: leave out pairs that"
        " span lively samples; off; auto: paper where the log shows a lift-off, else off",
    )
    refine: Literal["kf", "none"] = option(
        "kf", "a linear Kalman filter over the same vectors, started from the solver's"
    )
    align_start: float | None = option(
        None, "use GNSS from so many seconds after the log's start", "S", ge=0
    )
    align_end: float | None = option(
        None, "and up to so many (default: 200 s after the start of alignment)", "S", gt=0
    )
    at: str = option(
        "end",
        "when `align` gives the attitude: end, start, or seconds from the start",
        "end|start|S",
    )
    lift_off: float | None = option(
        None, "seconds from the log's start (default: first time above 2 g)", "S"
    )
    f_set: float = option(12.0, "gate: specific force below this, m/s^2", "M/S^2", gt=0)
    df_set: float = option(100.0, "gate: its change below this, m/s^3", "M/S^3", gt=0)
    w_set: float = option(5.0, "gate: angular rate below this, deg/s", "DEG/S", gt=0)
    dw_set: float = option(100.0, "gate: its change below this, deg/s^2", "DEG/S^2", gt=0)
    t_set1: float = option(40.0, "gate: start so long after lift-off, s", "S", ge=0)
    n_set1: int = option(1, "gate: start after so many calm samples in a row", "N", ge=1)
    t_set2: float = option(200.0, "gate: stop so long after the start, s", "S", ge=0)
    n_set2: int = option(200, "gate: stop after so many calm samples in a row", "N", ge=1)
    gate_smooth: int = option(1, "gate: samples averaged before the tests", "N", ge=1)
    sigma_stop: float | None = option(
        None, "stop as soon as the worst sigma is below this, deg", "DEG", gt=0
    )
    sigma_bg: float | None = option(None, "gyro bias, deg/h, instead of grade's", "DEG/H", gt=0)
    sigma_ba: float | None = option(
        None, "accelerometer bias, m/s^2, instead of the grade's", "M/S^2", gt=0
    )
    sigma_sf: float | None = option(
        None, "scale factors, relative, instead of the grade's", "X", gt=0
    )
    arw: float | None = option(None, "deg/sqrt(h), instead of the grade's", "DEG/SQRT(H)", gt=0)
    vrw: float | None = option(
        None, "micro-g/sqrt(Hz), instead of the grade's", "UG/SQRT(HZ)", gt=0
    )
    kappa: float = option(
        4.0, "factor on the variances of sensor errors; 1 for constant errors", "X", gt=0
    )
    gyro_range: float | None = option(
        None, "deg/s at which the gyro clips; alignment starts after that", "DEG/S", gt=0
    )
    accel_range: float | None = option(None, "m/s^2, the same", "M/S^2", gt=0)

    def check(self) -> None:
        """The alignment ends after it starts, and ``--at`` is a time."""
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
