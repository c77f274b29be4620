"""Height from a barometer: the truth with an error that wanders and white noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sinstool.simulation.truth import check_times
from sinstool.simulation.wander import carry_over

FloatArray = NDArray[np.float64]


def barometer(
    time_ns: ArrayLike,
    height: ArrayLike,
    *,
    sigma: float = 10.0,
    correlation_time: float = 500.0,
    white: float = 0.0,
    seed: int = 0,
) -> tuple[FloatArray, FloatArray]:
    """Height as a barometer gives it.

    Parameters
    ----------
    time_ns : array_like of int64, shape (n,)
        Instants, increasing, two at least; at any distance from each other.
    height : array_like, shape (n,)
        True, m.
    sigma : float, optional
        Standard deviation of the error that wanders, a first-order Markov process, m.
    correlation_time : float, optional
        Of that process, s.
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
