"""What a simulated motion gives: exact IMU samples of every kind and the true attitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class ImuTruth:
    """Samples without sensor errors, and the attitude they belong to.

    Mean values and increments of row k are over (t[k-1], t[k]]; for row 0 that is an
    interval before the first instant as long as the first one after it.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (n,)
        Instants t[k].
    interval : ndarray, shape (n,)
        Duration that the means of each row are over, s.
    gyro_rate : ndarray, shape (n, 3)
        ``omega_ib_b`` at the instants, rad/s.
    gyro_mean_rate : ndarray, shape (n, 3)
        Its mean over each interval, rad/s.
    gyro_increment : ndarray, shape (n, 3)
        Its integral over each interval, rad.
    specific_force : ndarray, shape (n, 3)
        ``f_b`` at the instants, m/s^2.
    mean_specific_force : ndarray, shape (n, 3)
        Its mean over each interval, m/s^2.
    q_nb : ndarray, shape (n, 4)
        Attitude at the instants.
    """

    time_ns: IntArray
    interval: FloatArray
    gyro_rate: FloatArray
    gyro_mean_rate: FloatArray
    gyro_increment: FloatArray
    specific_force: FloatArray
    mean_specific_force: FloatArray
    q_nb: FloatArray


def sample_times(rate_hz: float, duration_s: float, start_ns: int = 0) -> IntArray:
    """Instants of equal spacing, each rounded to a nanosecond of its own.

    Parameters
    ----------
    rate_hz : float
        Samples per second.
    duration_s : float
        From the first instant to the last, or a part of an interval more.
    start_ns : int, optional
        First instant.

    Returns
    -------
    ndarray of int64, shape (n,)
        Two instants at least.

    Raises
    ------
    ValueError
        If the rate is not positive or the duration holds no interval.
    """
    if not rate_hz > 0.0:
        raise ValueError(f"Expected a positive `rate_hz`, got {rate_hz}.")
    # A millionth of an interval forgives the rounding of duration times rate.
    count = int(np.floor(duration_s * rate_hz + 1e-6))
    if count < 1:
        raise ValueError(f"{duration_s} s at {rate_hz} Hz hold no interval.")
    return start_ns + np.round(np.arange(count + 1) * (1e9 / rate_hz)).astype(np.int64)


def check_times(time_ns: ArrayLike) -> tuple[IntArray, FloatArray]:
    """Instants of a simulation and the interval that ends at each.

    Parameters
    ----------
    time_ns : array_like of int64, shape (n,)
        Instants, strictly increasing, two at least.

    Returns
    -------
    time_ns : ndarray of int64, shape (n,)
        The same.
    interval : ndarray, shape (n,)
        s; that of row 0 equals that of row 1.

    Raises
    ------
    ValueError
        If they are fewer, of another type or not increasing.
    """
    times = np.asarray(time_ns)
    if times.ndim != 1 or len(times) < 2 or not np.issubdtype(times.dtype, np.integer):
        raise ValueError(
            f"Expected `time_ns` to be two or more integers, got {times.shape} of {times.dtype}."
        )
    steps = np.diff(times.astype(np.int64))
    if np.any(steps <= 0):
        raise ValueError("Expected `time_ns` to increase.")
    return times.astype(np.int64), np.concatenate([steps[:1], steps]) * 1e-9
