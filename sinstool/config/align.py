"""Options of the first attitude: determined at rest or in motion, or set by the user."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field

from sinstool.core.errors import ConfigurationError
from sinstool.core.options import Group, option

IN_FLIGHT = ("svd", "quest", "davenport", "triad")
LONGEST_S = 1e9
Metres = Annotated[float, Field(ge=-1e6, le=1e6)]


class AlignOptions(Group):
    """The attitude and position at the start."""

    title = "First attitude"

    align: Literal[
        "auto", "level", "gyrocompass", "log", "fixed", "svd", "quest", "davenport", "triad"
    ] = option(
        "auto",
        "how the first attitude is found. At rest: level (tilt from gravity, heading 0) or"
        " gyrocompass (heading from the Earth's rotation too). In motion, from GNSS velocity: svd,"
        " quest, davenport (solvers of Wahba's problem) or triad. log: the first valid orientation"
        " in the IMU topic. fixed: --initial-attitude. auto: gyrocompass where the gyro is good"
        " enough to see north, otherwise svd where GNSS velocity shows heading, otherwise level,"
        " otherwise log, otherwise tilt from the first second; --mode ins-gnss: svd",
        "METHOD",
        brief="how the first attitude is found",
    )
    initial_attitude: tuple[float, float, float] | None = option(
        None,
        "roll, pitch, heading in degrees of FRD axes in NED, for --align fixed",
        "ROLL,PITCH,HEADING",
        brief="degrees, with --align fixed",
    )
    gyro_bias: Literal["still", "none"] | tuple[float, float, float] = option(
        "still",
        "gyro bias to remove: still (the mean rate while the log begins at rest), none, or X,Y,Z"
        " in rad/s in the log's axes",
        "X,Y,Z|still|none",
        brief="gyro bias to remove, rad/s; still: by a rest",
    )
    latitude: float | None = option(
        None,
        "latitude in degrees, for a log without fixes",
        "DEG",
        brief="in degrees, for a log without fixes",
        ge=-90,
        le=90,
    )
    longitude: float | None = option(
        None, "longitude in degrees, for a log without fixes", "DEG", ge=-180, le=180
    )
    height: float | None = option(
        None, "height above the ellipsoid in m, for a log without fixes", "M"
    )

    def check(self) -> None:
        """Require an initial attitude exactly where ``--align fixed`` uses one."""
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
    """The receiver: position of its antenna, latency, and noise."""

    title = "GNSS receiver"

    lever_arm: tuple[Metres, Metres, Metres] | None = option(
        None,
        "from the IMU to the antenna, in m, Forward-Right-Down (default: by the transforms of"
        " /tf_static, else 0,0,0, or what the filter finds in the log)",
        "X,Y,Z",
        brief="from the IMU to the antenna, in m, FRD",
    )
    gnss_latency: float | None = option(
        None,
        "age of a fix at its time stamp in s, on the IMU's clock (default: 0 for alignment;"
        " estimated by the filter)",
        "S",
        ge=-10,
        le=10,
    )
    gnss_sigma_v: float = option(
        0.1, "velocity noise in m/s per axis, where the log gives none", "M/S", gt=0, le=1e6
    )


class InFlightOptions(Group):
    """Alignment in motion, from vectors in inertial space."""

    title = "Alignment in motion"

    vectors: Literal["win", "cen", "int", "diff", "diffc", "pos"] = option(
        "win",
        "which vectors are compared. Integrated velocity: over a sliding window (win), the same"
        " less its mean (cen), or from the start (int). Differentiated velocity: backward (diff)"
        " or central (diffc). Positions: pos",
    )
    window: float = option(
        2.0, "length of the sliding window of win, in s", "S", gt=0, le=LONGEST_S
    )
    fade: float | None = option(
        None, "time constant in s with which old vectors are forgotten", "S", gt=0
    )
    gate: Literal["auto", "paper", "mask", "off"] = option(
        "auto",
        "paper: start and stop by the vehicle's dynamics; mask: leave out vectors that span"
        " strong dynamics; off; auto: paper where the log shows a lift-off, otherwise off",
    )
    refine: Literal["kf", "none"] = option(
        "kf", "refine the solver's attitude by a linear Kalman filter over the same vectors, or not"
    )
    align_start: float | None = option(
        None, "start of alignment, in s from the log's start", "S", ge=0, le=LONGEST_S
    )
    align_end: float | None = option(
        None,
        "end of alignment, in s from the log's start (default: 200 s after its start, or later"
        " where that is too short; --gate paper ends it by itself)",
        "S",
        gt=0,
        le=LONGEST_S,
    )
    at: str = option(
        "end",
        "time of the attitude of an alignment in motion: its end or its start, or seconds from the"
        " log's start; at rest, seconds within the rest at the beginning",
        "end|start|S",
    )
    lift_off: float | None = option(
        None,
        "lift-off, in s from the log's start (default: the first time above 2 g)",
        "S",
        ge=-LONGEST_S,
        le=LONGEST_S,
    )
    f_set: float = option(12.0, "gate: calm below this specific force, m/s^2", "M/S^2", gt=0)
    df_set: float = option(
        100.0, "gate: calm below this change of specific force, m/s^3", "M/S^3", gt=0
    )
    w_set: float = option(5.0, "gate: calm below this angular rate, deg/s", "DEG/S", gt=0)
    dw_set: float = option(
        100.0, "gate: calm below this angular acceleration, deg/s^2", "DEG/S^2", gt=0
    )
    t_set1: float = option(40.0, "gate: earliest start after lift-off, s", "S", ge=0)
    n_set1: int = option(1, "gate: calm samples in a row before the start", "N", ge=1)
    t_set2: float = option(200.0, "gate: latest stop after the start, s", "S", ge=0)
    n_set2: int = option(200, "gate: calm samples in a row before the stop", "N", ge=1)
    gate_smooth: int = option(1, "gate: samples averaged before the tests", "N", ge=1)
    sigma_stop: float | None = option(
        None, "stop as soon as the largest sigma is below this, deg", "DEG", gt=0
    )
    sigma_bg: float | None = option(
        None, "gyro bias (1 sigma), deg/h, in place of the grade's", "DEG/H", gt=0
    )
    sigma_ba: float | None = option(
        None, "accelerometer bias (1 sigma), m/s^2, in place of the grade's", "M/S^2", gt=0
    )
    sigma_sf: float | None = option(
        None, "scale factors (1 sigma), relative, in place of the grade's", "X", gt=0
    )
    bias_time: float | None = option(
        None,
        "correlation time, s, of biases and scale factors as first-order Markov processes of their"
        " full sigma, in place of the grade's, of which only a part wanders",
        "S",
        gt=0,
    )
    arw: float | None = option(
        None, "angular random walk, deg/sqrt(h), in place of the grade's", "DEG/SQRT(H)", gt=0
    )
    vrw: float | None = option(
        None, "velocity random walk, micro-g/sqrt(Hz), in place of the grade's", "UG/SQRT(HZ)", gt=0
    )
    kappa: float = option(
        4.0, "factor on the variances of sensor errors; 1 if they are constant", "X", gt=0
    )
    gyro_range: float | None = option(
        None, "range of the gyro, deg/s; alignment starts after it was last exceeded", "DEG/S", gt=0
    )
    accel_range: float | None = option(
        None,
        "range of the accelerometer, m/s^2; alignment starts after it was last exceeded",
        "M/S^2",
        gt=0,
    )

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
                seconds = float(self.at)
            except ValueError:
                seconds = math.nan
            if not math.isfinite(seconds):
                raise ConfigurationError(f"--at {self.at}: not end, start or a number of seconds")
