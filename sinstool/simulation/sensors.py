"""Errors of real sensors: white noise and a turn-on bias, by grade."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sinstool.simulation.truth import ImuTruth

_DEGREE = np.pi / 180.0
_G = 9.80665


@dataclass(frozen=True)
class SensorGrade:
    """Size of a sensor's errors.

    Attributes
    ----------
    angle_random_walk : float
        rad/sqrt(s).
    gyro_bias : float
        Standard deviation of each axis' turn-on bias, rad/s.
    velocity_random_walk : float
        (m/s)/sqrt(s).
    accel_bias : float
        Standard deviation of each axis' turn-on bias, m/s^2.
    """

    angle_random_walk: float
    gyro_bias: float
    velocity_random_walk: float
    accel_bias: float


def _grade(arw: float, bias: float, noise: float, accel_bias: float) -> SensorGrade:
    """From data-sheet units: deg/sqrt(h), deg/h, ug/sqrt(Hz), mg."""
    return SensorGrade(
        arw * _DEGREE / 60.0, bias * _DEGREE / 3600.0, noise * 1e-6 * _G, accel_bias * 1e-3 * _G
    )


GRADES = {
    "perfect": SensorGrade(0.0, 0.0, 0.0, 0.0),
    "navigation": _grade(0.002, 0.01, 5.0, 0.03),
    "tactical": _grade(0.05, 1.0, 50.0, 1.0),
    "mems": _grade(0.3, 5.0, 150.0, 2.0),
}


def with_errors(truth: ImuTruth, grade: SensorGrade, seed: int) -> ImuTruth:
    """Samples as a sensor of a grade would give them; the attitude stays the truth.

    Parameters
    ----------
    truth : ImuTruth
    grade : SensorGrade
    seed : int
        Of the random numbers: the same seed gives the same errors.

    Returns
    -------
    ImuTruth
        Rates, mean rates and increments carry the same noise, that of a mean over the
        interval: random walk over the square root of the interval.
    """
    random = np.random.default_rng(seed)
    n = len(truth.time_ns)
    root = np.sqrt(truth.interval)[:, None]
    gyro_bias = grade.gyro_bias * random.standard_normal(3)
    accel_bias = grade.accel_bias * random.standard_normal(3)
    gyro = gyro_bias + grade.angle_random_walk / root * random.standard_normal((n, 3))
    accel = accel_bias + grade.velocity_random_walk / root * random.standard_normal((n, 3))
    return replace(
        truth,
        gyro_rate=truth.gyro_rate + gyro,
        gyro_mean_rate=truth.gyro_mean_rate + gyro,
        gyro_increment=truth.gyro_increment + gyro * truth.interval[:, None],
        specific_force=truth.specific_force + accel,
        mean_specific_force=truth.mean_specific_force + accel,
    )
