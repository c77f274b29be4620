"""Errors of inertial sensors, and the grades of sensors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import exp, hypot, log
from typing import Literal, get_args

import numpy as np

from sinstool.core import units
from sinstool.core.arrays import FloatArray
from sinstool.core.errors import ConfigurationError

Triple = tuple[float, float, float]
Grade = Literal["consumer", "mems", "industrial", "tactical", "navigation"]

LOW_COST: tuple[Grade, ...] = ("consumer", "mems")
"""Grades whose gyros do not feel the Earth's rotation, and whose rests show their biases."""

# Angular random walk up to which a gyro is of a grade. Laser and fibre gyros of navigation grade
# have 0.001 to 0.005 deg/sqrt(h), tactical ones 0.02 to 0.1, MEMS 0.15 and more.
_NAVIGATION_WALK = 0.01 * units.DEGREE_PER_ROOT_HOUR
_TACTICAL_WALK = 0.12 * units.DEGREE_PER_ROOT_HOUR
# Low-cost IMUs are calibrated, or are not. One sigma of the bias of a gyro axis, rad/s: data sheets
# of parts for telephones allow 1 to 20 deg/s.
CALIBRATED, UNCALIBRATED = 0.0035, 0.0175
# A bias, as the length of a vector, is seldom more than so many sigmas of one of its axes.
LIKELY = 4.0


def not_negative(owner: str, **values: float | Triple) -> None:
    """Refuse sigmas and times that are negative or not a number.

    Parameters
    ----------
    owner : str
        For the message.
    **values
        By their names.

    Raises
    ------
    ConfigurationError
        If one is.
    """
    for name, value in values.items():
        if not np.all(np.asarray(value, dtype=np.float64) >= 0.0):
            raise ConfigurationError(f"{owner}: {name} is {value}", "it must be 0 or more")


@dataclass(frozen=True)
class SensorGrade:
    """Errors of gyros and accelerometers, one sigma of one axis, each axis alike.

    Attributes
    ----------
    gyro_bias, accel_bias : float
        What the biases are at the start beyond what was taken off, rad/s and m/s^2.
    gyro_scale, accel_scale : float
        Scale factors, as a fraction.
    angle_random_walk : float
        rad/sqrt(s).
    velocity_random_walk : float
        (m/s)/sqrt(s).
    bias_time_s : float
        Correlation time of biases that wander, a first-order Markov process; infinite for
        constant ones. A filter has one state for both parts of a bias: a random walk that moves,
        over times shorter than this one, as the wandering part does. An alignment in motion lets
        the whole bias wander.
    gyro_instability, accel_instability : float
        The part of a bias that wanders, rad/s and m/s^2; 0: a bias stays.
    scale_wander : float
        The share of the scale factors, as a fraction of their sigma, that wanders as biases do:
        temperature moves both.
    gyro_misalignment, accel_misalignment : float
        Each of the six angles between the axes, rad. A filter has states for them where a log can
        show them. Without, attitude gets less certain with each angle turned, by that of the gyros
        in a turn by a right angle; where it has no states for the scale factors of gyros either,
        these count in the same way.

    Raises
    ------
    ConfigurationError
        If one is negative or not a number, or the time is 0.
    """

    gyro_bias: float = 0.0
    accel_bias: float = 0.0
    gyro_scale: float = 0.0
    accel_scale: float = 0.0
    angle_random_walk: float = 0.0
    velocity_random_walk: float = 0.0
    bias_time_s: float = 100.0
    gyro_instability: float = 0.0
    accel_instability: float = 0.0
    scale_wander: float = 0.0
    gyro_misalignment: float = 0.0
    accel_misalignment: float = 0.0

    def __post_init__(self) -> None:
        not_negative("noise of the IMU", **vars(self))
        if self.bias_time_s == 0.0:
            raise ConfigurationError("noise of the IMU: bias_time_s is 0 s", "it must be positive")


Part = Literal["scale", "misalignment", "drift"]
_PARTS: dict[Part, tuple[str, ...]] = {
    "scale": ("gyro_scale", "accel_scale"),
    "misalignment": ("gyro_misalignment", "accel_misalignment"),
    "drift": ("gyro_instability", "accel_instability"),
}


def without(grade: SensorGrade, *parts: Part) -> SensorGrade:
    """A grade without scale factors, misalignments, or the part of its biases that wanders."""
    return replace(grade, **{name: 0.0 for part in parts for name in _PARTS[part]})


def as_if_aligned(grade: SensorGrade) -> SensorGrade:
    """A grade whose misalignments are part of other errors, for methods that do not know them.

    What misaligned accelerometers feel of gravity stays the same while a vehicle is about level, as
    a bias does; what misaligned gyros feel of a turn follows it, as the scale factor's error does.
    """
    return replace(
        grade,
        accel_bias=hypot(grade.accel_bias, grade.accel_misalignment * units.STANDARD_GRAVITY),
        gyro_scale=hypot(grade.gyro_scale, grade.gyro_misalignment),
        gyro_misalignment=0.0,
        accel_misalignment=0.0,
    )


# Of field: its unit, and in that the value of each grade
_Table = dict[str, tuple[float, tuple[float, ...]]]


def _grades(names: tuple[str, ...], table: _Table) -> dict[str, SensorGrade]:
    return {
        grade: SensorGrade(**{name: unit * values[k] for name, (unit, values) in table.items()})
        for k, grade in enumerate(names)
    }


# Calibrated sensors, one sigma. Navigation: ring laser gyros (HG9900, LN-100; the aviation grade of
# Groves, 2013, has 8 ppm and 100 urad). Tactical: between LN-200 (100 ppm and 100 urad of gyros,
# 300 ppm of accelerometers; its biases wander by 0.35 deg/h and 50 ug within a minute or two),
# HG1700 (150 ppm, 500 urad) and Groves' tactical grade (350 ppm, 250 urad). Industrial: quiet MEMS
# (ADIS16495, M-G370): 0.1 deg/sqrt(h), 0.01 deg, biases after warming up. MEMS: modules that are
# calibrated one by one (ADIS16488, VN-100, MTi): 0.1 %, 0.05 deg, 5 deg/h. Consumer: the chips of
# telephones and hobbyists' boards as they are sold (MPU-6050, BMI160, ICM-20948, LSM6DS3): zero
# rates of 1 to 20 deg/s and zero levels of 20 to 80 mg at most, 0.5 to 3 % and 1 to 2 % across.
_SIMULATED: _Table = {
    "angle_random_walk": (units.DEGREE_PER_ROOT_HOUR, (0.002, 0.05, 0.1, 0.3, 0.4)),
    "velocity_random_walk": (units.MICRO_G, (5.0, 50.0, 40.0, 150.0, 200.0)),  # per root Hz
    "gyro_bias": (units.DEGREE_PER_HOUR, (0.01, 1.0, 20.0, 5.0, 3600.0)),
    "accel_bias": (units.MILLI_G, (0.03, 1.0, 2.0, 2.0, 30.0)),
    "gyro_instability": (units.DEGREE_PER_HOUR, (0.002, 0.3, 2.0, 5.0, 20.0)),
    "accel_instability": (units.MILLI_G, (0.005, 0.05, 0.05, 0.05, 0.2)),
    "bias_time_s": (1.0, (1000.0, 100.0, 1000.0, 300.0, 300.0)),
    "gyro_scale": (1e-6, (10.0, 200.0, 500.0, 1000.0, 10000.0)),
    "accel_scale": (1e-6, (100.0, 300.0, 500.0, 1000.0, 10000.0)),
    "gyro_misalignment": (1e-6, (50.0, 200.0, 200.0, 1000.0, 10000.0)),
    "accel_misalignment": (1e-6, (50.0, 200.0, 200.0, 1000.0, 10000.0)),
}
SIMULATED_GRADES = {
    "perfect": SensorGrade(),
    **_grades(("navigation", "tactical", "industrial", "mems", "consumer"), _SIMULATED),
}
"""What simulated sensors have, by grade."""

# Industrial, tactical and navigation grade: data sheets; biases after warming up. Industrial ones
# are quiet, calibrated MEMS, which have the noise of a tactical gyro but not its bias. MEMS: those
# of a calibrated module, in a vehicle that shakes it. Its random walks are ten times and more those
# of a data sheet, for they stand in for vibration and sampling too: with the data sheet's a filter
# is too sure of itself after seconds without fixes, and gates the first ones that come. Gyro biases
# of such sensors were seen to move by 100 deg/h from one stop of a car to one minutes later.
# Consumer: chips that nobody has calibrated, see above; the gyro bias is what is left after it was
# taken off.
_GRADES = ("consumer", "mems", "industrial", "tactical", "navigation")
_ASSUMED: _Table = {
    "angle_random_walk": (units.DEGREE_PER_ROOT_HOUR, (3.0, 3.0, 0.2, 0.05, 0.002)),
    "velocity_random_walk": (units.MICRO_G, (3000.0, 3000.0, 300.0, 50.0, 10.0)),  # per root Hz
    "gyro_bias": (units.DEGREE_PER_HOUR, (50.0, 50.0, 30.0, 1.0, 0.01)),
    "accel_bias": (units.MILLI_G, (30.0, 10.0, 2.0, 1.0, 0.05)),
    "gyro_instability": (units.DEGREE_PER_HOUR, (100.0, 100.0, 15.0, 0.3, 0.002)),
    "accel_instability": (units.MILLI_G, (1.0, 1.0, 0.2, 0.05, 0.005)),
    "scale_wander": (1.0, (0.1, 0.1, 0.1, 0.05, 0.1)),
    "bias_time_s": (1.0, (100.0, 100.0, 2000.0, 300.0, 1000.0)),
    "accel_scale": (1.0, (1e-2, 3e-3, 1e-3, 3e-4, 2e-4)),
    "gyro_scale": (1.0, (1e-2, 5e-3, 1e-3, 3e-4, 2e-4)),
    "gyro_misalignment": (1.0, (1e-2, 1e-3, 2e-4, 2e-4, 5e-5)),
    "accel_misalignment": (1.0, (1e-2, 1e-3, 2e-4, 2e-4, 5e-5)),
}
IMU_GRADES = _grades(_GRADES, _ASSUMED)
"""What a filter assumes, by grade of IMU."""
# What a sensor may miss at the end of its range, as shares of the range.
MISSED = (0.1, 0.2, 0.5, 1.0)


# What a calibration takes off.
_CALIBRATED = ("accel_bias", "accel_scale", "gyro_scale", "gyro_misalignment", "accel_misalignment")
UNCALIBRATED_BY = IMU_GRADES["consumer"].gyro_misalignment / IMU_GRADES["mems"].gyro_misalignment
"""How many times as large as after a calibration the angles of a bare chip are."""


def partly_calibrated(calibrated: SensorGrade, bare: SensorGrade, share: float) -> SensorGrade:
    """Errors between those of a calibrated IMU, share 0, and of a bare chip, share 1, or beyond.

    Each by its logarithm; the noise is that of the former.
    """
    errors = {
        name: getattr(calibrated, name) ** (1.0 - share) * getattr(bare, name) ** share
        for name in _CALIBRATED
    }
    return replace(calibrated, **errors)


def misaligned(grade: SensorGrade, times: float) -> SensorGrade:
    """A grade whose axes are so many times as misaligned."""
    angles = {name: times * getattr(grade, name) for name in _PARTS["misalignment"]}
    return replace(grade, **angles)


def log_odds_uncalibrated(gyro_bias: FloatArray) -> float:
    """Log of the odds that a low-cost IMU is not calibrated, 0 before a bias is known.

    Parameters
    ----------
    gyro_bias : ndarray, shape (3,)
        That is found, rad/s; NaN for axes of which it is not known.
    """
    known = gyro_bias[np.isfinite(gyro_bias)]
    more = 0.5 * float(known @ known) * (1.0 / CALIBRATED**2 - 1.0 / UNCALIBRATED**2)
    return min(more, 50.0) + len(known) * log(CALIBRATED / UNCALIBRATED)


def uncalibrated(gyro_bias: FloatArray) -> float:
    """Probability that a low-cost IMU is not calibrated: see :func:`log_odds_uncalibrated`."""
    odds = exp(log_odds_uncalibrated(gyro_bias))
    return odds / (1.0 + odds)


def grade_by_bias(grade: Grade, gyro_bias: float) -> Grade:
    """The best grade, not above one, whose gyros may have a bias, rad/s."""
    order: tuple[Grade, ...] = ("navigation", "tactical", "industrial")
    for one in order[order.index(grade) :] if grade not in LOW_COST else ():
        if gyro_bias <= LIKELY * IMU_GRADES[one].gyro_bias:
            return one
    return "mems"


def grade_by_noise(angle_random_walk: float) -> Grade:
    """Grade of an IMU whose gyros have a random walk, rad/sqrt(s)."""
    if angle_random_walk <= _NAVIGATION_WALK:
        return "navigation"
    return "tactical" if angle_random_walk <= _TACTICAL_WALK else "mems"


def next_worse(grade: Grade) -> Grade | None:
    """The grade below one."""
    order: tuple[Grade, ...] = get_args(Grade)  # from the worst on
    at = order.index(grade)
    return order[at - 1] if at else None
