"""Piecewise cubics through points, monotone where these are, and their integrals.

`scipy.interpolate.PchipInterpolator` does the same, but takes longer to import than most logs to
process.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import FloatArray


def integral(x: FloatArray, y: FloatArray, at: FloatArray) -> FloatArray:
    """Integral of the piecewise cubic from the first point to others.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Increasing, at least three.
    y : ndarray, shape (n, m)
    at : ndarray, shape (k,)
        From the first of `x` to the last.

    Returns
    -------
    ndarray, shape (k, m)
    """
    h, slope = np.diff(x)[:, None], _slopes(x, y)
    whole = h * (0.5 * (y[:-1] + y[1:]) + h / 12.0 * (slope[:-1] - slope[1:]))
    before = np.concatenate([np.zeros((1, y.shape[1])), np.cumsum(whole, axis=0)])
    k = np.clip(np.searchsorted(x, at, "right") - 1, 0, len(x) - 2)
    s, h = (at - x[k])[:, None], h[k]
    t = s / h
    # Hermite's cubic, integrated
    own = 1.0 - t**2 * (1.0 - 0.5 * t)
    next_own = t**2 * (1.0 - 0.5 * t)
    part = own * y[k] + next_own * y[k + 1]
    part += s * ((0.5 - t * (2.0 / 3.0 - 0.25 * t)) * slope[k])
    part += s * (t * (0.25 * t - 1.0 / 3.0) * slope[k + 1])
    return np.asarray(before[k] + s * part)


def _slopes(x: FloatArray, y: FloatArray) -> FloatArray:
    """Derivatives at the points.

    References
    ----------
    .. [1] F. N. Fritsch, J. Butland, "A method for constructing local monotone piecewise cubic
       interpolants", SIAM J. Scientific and Statistical Computing 5(2), 1984, 300-304.
    """
    h = np.diff(x)[:, None]
    d = np.diff(y, axis=0) / h
    out = np.zeros_like(y)
    one, other = 2.0 * h[1:] + h[:-1], h[1:] + 2.0 * h[:-1]
    same = d[:-1] * d[1:] > 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (one / d[:-1] + other / d[1:]) / (one + other)
        out[1:-1] = np.where(same, 1.0 / mean, 0.0)
    for end, near in ((0, 1), (-1, -2)):
        first, second = h[end], h[near]
        d0, d1 = d[end], d[near]
        value = ((2.0 * first + second) * d0 - first * d1) / (first + second)
        value = np.where(np.sign(value) == np.sign(d0), value, 0.0)
        steep = (np.sign(d0) != np.sign(d1)) & (np.abs(value) > 3.0 * np.abs(d0))
        out[end] = np.where(steep, 3.0 * d0, value)
    return out
