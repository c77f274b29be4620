"""Errors of real sensors by grade: white noise, biases that wander, scale and misalignment."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sinstool.core.units import DEGREE, STANDARD_GRAVITY
from sinstool.simulation.truth import FloatArray, ImuTruth
from sinstool.simulation.wander import carry_over


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
    gyro_instability, accel_instability : float
        Standard deviation of the part of each axis' bias that wanders as a first-order Markov
        process, rad/s and m/s^2.
    correlation_time : float
        Of that process, s.
    gyro_scale, accel_scale : float
        Standard deviation of each axis' scale-factor error, as a fraction.
    gyro_misalignment, accel_misalignment : float
        Standard deviation of each of the six angles between the axes, rad.
    """

    angle_random_walk: float
    gyro_bias: float
    velocity_random_walk: float
    accel_bias: float
    gyro_instability: float = 0.0
    accel_instability: float = 0.0
    correlation_time: float = 100.0
    gyro_scale: float = 0.0
    accel_scale: float = 0.0
    gyro_misalignment: float = 0.0
    accel_misalignment: float = 0.0


def _grade(arw: float, bias: float, noise: float, accel_bias: float) -> SensorGrade:
    """From data-sheet units: deg/sqrt(h), deg/h, ug/sqrt(Hz), mg."""
    return SensorGrade(
        arw * DEGREE / 60.0,
        bias * DEGREE / 3600.0,
        noise * 1e-6 * STANDARD_GRAVITY,
        accel_bias * 1e-3 * STANDARD_GRAVITY,
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
    grade : SensorGrade
    seed : int
        Of the random numbers: the same seed gives the same errors.

    Returns
    -------
    ImuTruth
        Rates, mean rates and increments carry the same noise, that of a mean over the
        interval: random walk over the square root of the interval. Scale and misalignment
        act on each of them by itself.
    """
    random = np.random.default_rng(seed)
    n = len(truth.time_ns)
    root = np.sqrt(truth.interval)[:, None]
    gyro_bias = grade.gyro_bias * random.standard_normal(3)
    accel_bias = grade.accel_bias * random.standard_normal(3)
    gyro = gyro_bias + grade.angle_random_walk / root * random.standard_normal((n, 3))
    accel = accel_bias + grade.velocity_random_walk / root * random.standard_normal((n, 3))
    gyro_matrix = _matrix(grade.gyro_scale, grade.gyro_misalignment, random)
    accel_matrix = _matrix(grade.accel_scale, grade.accel_misalignment, random)
    step = float(np.mean(truth.interval))
    for error, size in ((gyro, grade.gyro_instability), (accel, grade.accel_instability)):
        if size > 0.0:
            error += size * markov(n, step, grade.correlation_time, random, 3)
    mean_rate = truth.gyro_mean_rate + truth.gyro_mean_rate @ gyro_matrix.T + gyro
    force = truth.mean_specific_force + truth.mean_specific_force @ accel_matrix.T + accel
    return replace(
        truth,
        gyro_rate=truth.gyro_rate + truth.gyro_rate @ gyro_matrix.T + gyro,
        gyro_mean_rate=mean_rate,
        gyro_increment=mean_rate * truth.interval[:, None],
        specific_force=truth.specific_force + truth.specific_force @ accel_matrix.T + accel,
        mean_specific_force=force,
    )


def _matrix(scale: float, misalignment: float, random: np.random.Generator) -> FloatArray:
    """Scale errors on the diagonal, misalignments beside it."""
    drawn = random.standard_normal((3, 3))
    return np.where(np.eye(3, dtype=bool), scale * drawn, misalignment * drawn)


def markov(
    n: int,
    step: float,
    correlation_time: float,
    random: np.random.Generator,
    columns: int = 1,
) -> FloatArray:
    """First-order Gauss-Markov processes of unit variance, stationary from the first row.

    Parameters
    ----------
    n : int
        Rows.
    step : float
        Between rows, s.
    correlation_time : float
        s.
    columns : int, optional
        Independent processes.

    Returns
    -------
    ndarray, shape (n, columns)
        ``x[k+1] = exp(-step/correlation_time) x[k] + w``.
    """
    decay = np.exp(-step / correlation_time)
    drive = np.sqrt(-np.expm1(-2.0 * step / correlation_time)) * random.standard_normal(
        (n, columns)
    )
    if n:
        drive[0] /= np.sqrt(-np.expm1(-2.0 * step / correlation_time))
    carry_over(np.full(n, decay), drive)
    return np.asarray(drive)
