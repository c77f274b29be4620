"""Sensor errors: white noise, wandering biases, scale, misalignment, range; a barometer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray, IntArray
from sinstool.core.first_order import carry_over
from sinstool.core.units import DEGREE, STANDARD_GRAVITY
from sinstool.methods.sensor_errors import SensorGrade
from sinstool.simulation.truth import ImuTruth, check_times

# Gyro bias in deg/h, accelerometer bias in m/s^2 or g (see launch_grade), scale error, angle random
# walk in deg/sqrt(h), accelerometer noise in ug/sqrt(Hz)
_GRADES = {
    "0.01": (0.01, 1e-5, 1e-5, 0.002, 5.0),
    "1": (1.0, 1e-3, 1e-4, 0.05, 50.0),
    "10": (10.0, 5e-3, 3e-4, 0.3, 150.0),
}


@dataclass(frozen=True)
class ImuErrors:
    """Errors of a simulated sensor other than white noise.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (n,)
    gyro_bias, accel_bias : ndarray, shape (n, 3)
        Bias of each sample, its drift included, rad/s and m/s^2, FRD.
    gyro_matrix, accel_matrix : ndarray, shape (3, 3)
        Scale errors on the diagonal, misalignments off it; the error is this matrix times the
        truth.
    """

    time_ns: IntArray
    gyro_bias: FloatArray
    accel_bias: FloatArray
    gyro_matrix: FloatArray
    accel_matrix: FloatArray


def with_errors(truth: ImuTruth, grade: SensorGrade, seed: int) -> ImuTruth:
    """Samples as a sensor of a grade would give them; see `measured`."""
    return measured(truth, grade, seed)[0]


def measured(truth: ImuTruth, grade: SensorGrade, seed: int) -> tuple[ImuTruth, ImuErrors]:
    """Samples as a sensor of a grade would give them; the attitude stays the truth.

    Parameters
    ----------
    seed : int
        Seed of the random numbers. Biases and white noise do not change with the sizes of the other
        errors.

    Returns
    -------
    samples : ImuTruth
        Rates, mean rates and increments have the same noise, that of a mean over the interval:
        random walk over the square root of the interval. Scale error and misalignment act on each
        of them separately.
    errors : ImuErrors
        The errors that were added.
    """
    random = np.random.default_rng(seed)
    n = len(truth.time_ns)
    root = np.sqrt(truth.interval)[:, None]
    gyro_bias = np.tile(grade.gyro_bias * random.standard_normal(3), (n, 1))
    accel_bias = np.tile(grade.accel_bias * random.standard_normal(3), (n, 1))
    gyro = grade.angle_random_walk / root * random.standard_normal((n, 3))
    accel = grade.velocity_random_walk / root * random.standard_normal((n, 3))
    gyro_matrix = _matrix(grade.gyro_scale, grade.gyro_misalignment, random)
    accel_matrix = _matrix(grade.accel_scale, grade.accel_misalignment, random)
    step = float(np.mean(truth.interval))
    for bias, size in ((gyro_bias, grade.gyro_instability), (accel_bias, grade.accel_instability)):
        if size > 0.0:
            bias += size * markov(n, step, grade.bias_time_s, random, 3)
    gyro, accel = gyro + gyro_bias, accel + accel_bias
    mean_rate = truth.gyro_mean_rate + truth.gyro_mean_rate @ gyro_matrix.T + gyro
    force = truth.mean_specific_force + truth.mean_specific_force @ accel_matrix.T + accel
    samples = replace(
        truth,
        gyro_rate=truth.gyro_rate + truth.gyro_rate @ gyro_matrix.T + gyro,
        gyro_mean_rate=mean_rate,
        gyro_increment=mean_rate * truth.interval[:, None],
        specific_force=truth.specific_force + truth.specific_force @ accel_matrix.T + accel,
        mean_specific_force=force,
    )
    return samples, ImuErrors(truth.time_ns, gyro_bias, accel_bias, gyro_matrix, accel_matrix)


def _matrix(scale: float, misalignment: float, random: np.random.Generator) -> FloatArray:
    """Random scale errors on the diagonal, misalignments off it."""
    drawn = random.standard_normal((3, 3))
    return np.where(np.eye(3, dtype=bool), scale * drawn, misalignment * drawn)


def markov(
    n: int, step: float, correlation_time: float, random: np.random.Generator, columns: int = 1
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


def idling(
    samples: ImuTruth, standing: np.ndarray, accel: float, gyro: float, seed: int
) -> ImuTruth:
    """Samples with the vibration of an idling engine.

    Parameters
    ----------
    standing : ndarray of bool, shape (n,)
        Whether the vehicle stands with its engine running.
    accel, gyro : float
        Root mean square of the three axes together, m/s^2 and rad/s.
    seed : int
        Seed of the random numbers.

    Returns
    -------
    ImuTruth
        A tone, the firing of a four-stroke engine at a frequency that wanders about 27 Hz, has 0.9
        of the given size; white noise, for what aliases from higher frequencies, makes up the
        rest. The same is added to values at instants and to means.
    """
    random = np.random.default_rng(seed)
    n, step = len(samples.time_ns), float(np.mean(samples.interval))
    turn = (
        2.0
        * np.pi
        * np.cumsum(samples.interval * (27.0 + 0.5 * markov(n, step, 5.0, random)[:, 0]))
    )
    added = []
    for size in (accel, gyro):
        direction = random.standard_normal(3)
        direction *= np.sqrt(2.0) * 0.9 / np.linalg.norm(direction)
        tone = np.sin(turn[:, None] + random.uniform(0.0, 2.0 * np.pi, 3)) * direction
        white = np.sqrt((1.0 - 0.9**2) / 3.0) * random.standard_normal((n, 3))
        added.append(size * standing[:, None] * (tone + white))
    force, rate = added
    mean_rate = samples.gyro_mean_rate + rate
    return replace(
        samples,
        gyro_rate=samples.gyro_rate + rate,
        gyro_mean_rate=mean_rate,
        gyro_increment=mean_rate * samples.interval[:, None],
        specific_force=samples.specific_force + force,
        mean_specific_force=samples.mean_specific_force + force,
    )


def launch_grade(gyro_bias_deg_h: str, accelerometer_unit: Literal["m/s^2", "g"]) -> SensorGrade:
    """One of the three grades of Qu, Li, Zhu and Wang's Monte Carlo runs.

    They print the accelerometer biases 0.00001, 0.001 and 0.005 with the unit m/s^2, and draw
    conclusions for 0.01 and 0.05 m/s^2; their flight unit has 0.001 g. So g may be meant.

    Parameters
    ----------
    gyro_bias_deg_h : {'0.01', '1', '10'}
    accelerometer_unit : {'m/s^2', 'g'}
        How to read the printed accelerometer biases.

    Returns
    -------
    SensorGrade
        Repeatability and in-run stability both have the printed size, the latter with a correlation
        time of 100 s; misalignment is half the scale error. The paper prints no noise; that of
        typical sensors of such grades is taken.
    """
    gyro, accel, scale, walk, noise = _GRADES[gyro_bias_deg_h]
    gyro *= DEGREE / 3600.0
    accel *= STANDARD_GRAVITY if accelerometer_unit == "g" else 1.0
    return SensorGrade(
        angle_random_walk=walk * DEGREE / 60.0,
        gyro_bias=gyro,
        velocity_random_walk=noise * 1e-6 * STANDARD_GRAVITY,
        accel_bias=accel,
        gyro_instability=gyro,
        accel_instability=accel,
        bias_time_s=100.0,
        gyro_scale=scale,
        accel_scale=scale,
        gyro_misalignment=0.5 * scale,
        accel_misalignment=0.5 * scale,
    )


def saturated(samples: ImuTruth, gyro_range: float) -> ImuTruth:
    """Samples of gyros with a limited range.

    Parameters
    ----------
    samples : ImuTruth
        Without the limit.
    gyro_range : float
        Largest reading of each axis, rad/s.

    Returns
    -------
    ImuTruth
        Values at instants and means are limited; increments follow from the means.
    """
    mean_rate = np.clip(samples.gyro_mean_rate, -gyro_range, gyro_range)
    return replace(
        samples,
        gyro_rate=np.clip(samples.gyro_rate, -gyro_range, gyro_range),
        gyro_mean_rate=mean_rate,
        gyro_increment=mean_rate * samples.interval[:, None],
    )


def barometer(
    time_ns: ArrayLike,
    height: ArrayLike,
    *,
    sigma: float = 10.0,
    correlation_time: float = 500.0,
    white: float = 0.0,
    seed: int = 0,
) -> tuple[FloatArray, FloatArray]:
    """Height measured by a barometer.

    Parameters
    ----------
    time_ns : array_like of int64, shape (n,)
        Instants, increasing, two at least; their spacing may vary.
    height : array_like, shape (n,)
        True, m.
    sigma : float, optional
        Standard deviation of the wandering error, a first-order Markov process, m.
    correlation_time : float, optional
        Correlation time of that process, s.
    white : float, optional
        Standard deviation of independent errors, m.
    seed : int, optional
        Of the random numbers.

    Returns
    -------
    measured : ndarray, shape (n,)
        m.
    error : ndarray, shape (n,)
        The wandering part of its error, stationary from the first row, m:
        ``b[k+1] = exp(-T/tau) b[k] + w`` with ``var w = sigma**2 (1 - exp(-2 T/tau))``, which
        are the process' own values at the instants.

    Raises
    ------
    ValueError
        If shapes do not fit or time does not increase.
    """
    times, interval = check_times(time_ns)
    truth = np.asarray(height, dtype=np.float64)
    if truth.shape != times.shape:
        raise ValueError(f"Expected `height` to have shape {times.shape}, got {truth.shape}.")
    random = np.random.default_rng(seed)
    error = random.standard_normal(len(times))
    noise = random.standard_normal(len(times))
    share = interval / correlation_time
    drive = sigma * np.sqrt(-np.expm1(-2.0 * share))
    drive[0] = sigma
    error *= drive
    carry_over(np.exp(-share), error[:, None])
    return truth + error + white * noise, error
