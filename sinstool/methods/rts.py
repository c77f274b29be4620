"""A step of the Rauch-Tung-Striebel recursion, compiled, shared by all smoothers."""

from __future__ import annotations

from math import sqrt

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import part
from sinstool.methods.products import product

# A pivot of the scaled covariance below which a direction counts as known from the others:
# rounding of n = 26 sums leaves some 1e-14.
_PIVOT = 1e-13


@part()
def smoother_gain(
    transition: FloatArray,
    p_plus: FloatArray,
    p_minus: FloatArray,
    gain: FloatArray,
    low: FloatArray,
    scale: FloatArray,
) -> None:
    """Transpose of the gain ``P+ Phi^T P-^-1``.

    Parameters
    ----------
    transition : ndarray, shape (n, n)
        Phi, from a row to the next.
    p_plus : ndarray, shape (n, n)
        Covariance after the measurements of the row.
    p_minus : ndarray, shape (n, n)
        Before those of the next.
    gain : ndarray, shape (n, n)
        Gets it.
    low, scale : ndarray, shape (n, n) and (n,)
        Scratch.

    Notes
    -----
    ``P-`` is scaled to ones on its diagonal and factored by Cholesky; a state without variance,
    or known from the others to rounding, gets no row.
    """
    n = len(scale)
    # Phi P+, which is the transpose of what G multiplies the inverse with
    product(transition, p_plus, n, n, n, gain)
    # Cholesky of P- scaled to ones on the diagonal
    for i in range(n):
        v = p_minus[i, i]
        scale[i] = 1.0 / sqrt(v) if v > 0.0 else 0.0
    for i in range(n):
        for j in range(i + 1):
            s = p_minus[i, j] * scale[i] * scale[j]
            for m in range(j):
                s -= low[i, m] * low[j, m]
            if i > j:
                low[i, j] = s * low[j, j]
            else:
                # The reciprocal of the pivot; 0 leaves a known direction out.
                low[i, i] = 1.0 / sqrt(s) if s > _PIVOT else 0.0
    # P-^-1 Phi P+ = G^T, in place
    for i in range(n):
        for j in range(n):
            gain[i, j] *= scale[i]
        # Three rows at a time here and below: short loops take longer to begin than to run
        whole = i - i % 3
        for m in range(0, whole, 3):
            f, g, h = low[i, m], low[i, m + 1], low[i, m + 2]
            for j in range(n):
                gain[i, j] = gain[i, j] - f * gain[m, j] - g * gain[m + 1, j] - h * gain[m + 2, j]
        for m in range(whole, i):
            f = low[i, m]
            for j in range(n):
                gain[i, j] -= f * gain[m, j]
        f = low[i, i]
        for j in range(n):
            gain[i, j] *= f
    for i in range(n - 1, -1, -1):
        whole = n - (n - 1 - i) % 3
        for m in range(i + 1, whole, 3):
            f, g, h = low[m, i], low[m + 1, i], low[m + 2, i]
            for j in range(n):
                gain[i, j] = gain[i, j] - f * gain[m, j] - g * gain[m + 1, j] - h * gain[m + 2, j]
        for m in range(whole, n):
            f = low[m, i]
            for j in range(n):
                gain[i, j] -= f * gain[m, j]
        f = low[i, i]
        for j in range(n):
            gain[i, j] *= f
    for i in range(n):
        for j in range(n):
            gain[i, j] *= scale[i]


@part()
def smoother_covariance(
    p_plus: FloatArray,
    p_minus: FloatArray,
    after: FloatArray,
    gain: FloatArray,
    diff: FloatArray,
    low: FloatArray,
    out: FloatArray,
) -> None:
    """Smoothed covariance of a row.

    Parameters
    ----------
    p_plus, p_minus : ndarray, shape (n, n)
        See :func:`smoother_gain`.
    after : ndarray, shape (n, n)
        Smoothed covariance of the next row.
    gain : ndarray, shape (n, n)
        Of :func:`smoother_gain`.
    diff, low : ndarray, shape (n, n)
        Scratch.
    out : ndarray, shape (n, n)
        Gets it; may be `p_plus` or `after`.
    """
    n = len(gain)
    # P+ + G (Ps - P-) G^T, symmetric to the last bit
    for i in range(n):
        for j in range(n):
            diff[i, j] = 0.0
        for m in range(0, n - 2, 3):
            f = after[i, m] - p_minus[i, m]
            g = after[i, m + 1] - p_minus[i, m + 1]
            h = after[i, m + 2] - p_minus[i, m + 2]
            for j in range(n):
                diff[i, j] = diff[i, j] + f * gain[m, j] + g * gain[m + 1, j] + h * gain[m + 2, j]
        for m in range(n - n % 3, n):
            f = after[i, m] - p_minus[i, m]
            for j in range(n):
                diff[i, j] += f * gain[m, j]
    for i in range(n):
        for j in range(n):
            low[i, j] = 0.0
        for m in range(0, n - 2, 3):
            f, g, h = gain[m, i], gain[m + 1, i], gain[m + 2, i]
            for j in range(i + 1):
                low[i, j] = low[i, j] + f * diff[m, j] + g * diff[m + 1, j] + h * diff[m + 2, j]
        for m in range(n - n % 3, n):
            f = gain[m, i]
            for j in range(i + 1):
                low[i, j] += f * diff[m, j]
    for i in range(n):
        for j in range(i + 1):
            v = 0.5 * (p_plus[i, j] + p_plus[j, i]) + low[i, j]
            out[i, j] = v
            out[j, i] = v
