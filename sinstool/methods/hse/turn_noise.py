"""Accuracy of a mean rate over whole turns, where part of the noise cancels between turns.

The white noise of a gyro is independent from turn to turn. The sway of a base, or the jitter of the
encoder's stamps at the end of a turn, is not: what it adds to the rate of one turn it takes from
the next, as the angle itself stays small. The mean rate over N turns of length T has the variance

    (q / T) / N + 2 (r / T**2) / N**2,

with ``q`` the white noise and ``r`` the variance of that angle; the scatter of the turns alone,
over sqrt(N), would be several times too large where the base sways by arc seconds.

The turns themselves show how much cancels. Their restricted likelihood (restricted, as their mean
is unknown) is computed for white noise and for several ratios of the two, and the variances are
averaged with it as weight; with few turns the white noise of the prior prevails.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray

FEWEST_TURNS_FOR_SCATTER = 4

# r / (q T): none, or half a turn's white noise up to a base whose sway is all that is seen
_RATIOS = np.array([0.0, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0])
# Before any turn is seen: a base on solid ground, and an encoder stamped by its own clock
_WHITE = 0.9
_PRIOR = np.concatenate([[_WHITE], np.full(len(_RATIOS) - 1, (1.0 - _WHITE) / (len(_RATIOS) - 1))])


def sigma_of_mean(rates: ArrayLike) -> float:
    """Standard deviation of the mean of rates of turns that follow one another.

    Parameters
    ----------
    rates : array_like, shape (n,)
        One for each turn; turns of one length.

    Returns
    -------
    float
        In their unit; NaN for fewer than four.
    """
    values = np.asarray(rates, dtype=np.float64)
    n = len(values)
    if n < FEWEST_TURNS_FOR_SCATTER:
        return float("nan")
    # Sines are the eigenvectors of the covariance of what cancels: 2 on its diagonal, -1 beside it
    order = np.arange(1, n + 1)
    eigenvalues = 1.0 + _RATIOS[:, np.newaxis] * (2.0 - 2.0 * np.cos(np.pi * order / (n + 1)))
    seen, mean = _in_sines(values - values.mean()), _in_sines(np.ones(n))
    information = (mean**2 / eigenvalues).sum(axis=1)
    squares = (seen**2 / eigenvalues).sum(axis=1)
    squares -= (seen * mean / eigenvalues).sum(axis=1) ** 2 / information
    if not squares.min() > 0.0:
        return 0.0
    likelihood = -0.5 * (
        np.log(eigenvalues).sum(axis=1) + np.log(information) + (n - 1) * np.log(squares)
    )
    weights = _PRIOR * np.exp(likelihood - likelihood.max())
    variances = squares / (n - 1) * (1.0 + 2.0 * _RATIOS / n) / n
    return float(np.sqrt(weights @ variances / weights.sum()))


def _in_sines(values: FloatArray) -> FloatArray:
    """Coefficients in orthonormal sines: zero before the first value and after the last."""
    n = len(values)
    odd = np.concatenate([[0.0], values, [0.0], -values[::-1]])
    return np.asarray(-np.fft.rfft(odd).imag[1 : n + 1] / np.sqrt(2.0 * (n + 1)))
