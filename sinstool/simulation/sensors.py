"""Samples with errors of sensors: white noise, biases that wander, scale and misalignment."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.methods.sensor_errors import SensorGrade
from sinstool.simulation.truth import FloatArray, ImuTruth
from sinstool.simulation.wander import carry_over


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
            error += size * markov(n, step, grade.bias_time_s, random, 3)
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
