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
    up: FloatArray,
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
    up, scale : ndarray, shape (n, n) and (n,)
        Scratch.

    Notes
    -----
    ``P-`` is scaled to ones on its diagonal and factored by Cholesky; a state without variance,
    or known from the others to rounding, gets no row.
    """
    n = len(scale)
    # Phi P+, which is the transpose of what G multiplies the inverse with
    product(transition, p_plus, n, n, n, gain)
    # Cholesky's U of P- scaled to ones on the diagonal, U^T U, along rows; here and below four of
    # them at a time: short loops take longer to begin than to run
    for i in range(n):
        v = p_minus[i, i]
        scale[i] = 1.0 / sqrt(v) if v > 0.0 else 0.0
    for i in range(n):
        for j in range(i, n):
            up[i, j] = p_minus[i, j] * scale[j] * scale[i]
        whole = i - i % 4
        for m in range(0, whole, 4):
            e, f, g, h = up[m, i], up[m + 1, i], up[m + 2, i], up[m + 3, i]
            for j in range(i, n):
                s = up[i, j] - e * up[m, j] - f * up[m + 1, j]
                up[i, j] = s - g * up[m + 2, j] - h * up[m + 3, j]
        for m in range(whole, i):
            f = up[m, i]
            for j in range(i, n):
                up[i, j] -= f * up[m, j]
        # The reciprocal of the pivot; 0 leaves a known direction out.
        f = 1.0 / sqrt(up[i, i]) if up[i, i] > _PIVOT else 0.0
        up[i, i] = f
        for j in range(i + 1, n):
            up[i, j] *= f
    # P-^-1 Phi P+ = G^T, in place
    for i in range(n):
        for j in range(n):
            gain[i, j] *= scale[i]
        whole = i - i % 4
        for m in range(0, whole, 4):
            e, f, g, h = up[m, i], up[m + 1, i], up[m + 2, i], up[m + 3, i]
            for j in range(n):
                s = gain[i, j] - e * gain[m, j] - f * gain[m + 1, j]
                gain[i, j] = s - g * gain[m + 2, j] - h * gain[m + 3, j]
        for m in range(whole, i):
            f = up[m, i]
            for j in range(n):
                gain[i, j] -= f * gain[m, j]
        f = up[i, i]
        for j in range(n):
            gain[i, j] *= f
    for i in range(n - 1, -1, -1):
        whole = n - (n - 1 - i) % 4
        for m in range(i + 1, whole, 4):
            e, f, g, h = up[i, m], up[i, m + 1], up[i, m + 2], up[i, m + 3]
            for j in range(n):
                s = gain[i, j] - e * gain[m, j] - f * gain[m + 1, j]
                gain[i, j] = s - g * gain[m + 2, j] - h * gain[m + 3, j]
        for m in range(whole, n):
            f = up[i, m]
            for j in range(n):
                gain[i, j] -= f * gain[m, j]
        f = up[i, i]
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
        for m in range(0, n - 3, 4):
            e = after[i, m] - p_minus[i, m]
            f = after[i, m + 1] - p_minus[i, m + 1]
            g = after[i, m + 2] - p_minus[i, m + 2]
            h = after[i, m + 3] - p_minus[i, m + 3]
            for j in range(n):
                s = diff[i, j] + e * gain[m, j] + f * gain[m + 1, j]
                diff[i, j] = s + g * gain[m + 2, j] + h * gain[m + 3, j]
        for m in range(n - n % 4, n):
            f = after[i, m] - p_minus[i, m]
            for j in range(n):
                diff[i, j] += f * gain[m, j]
    for i in range(n):
        for j in range(n):
            low[i, j] = 0.0
        for m in range(0, n - 3, 4):
            e, f, g, h = gain[m, i], gain[m + 1, i], gain[m + 2, i], gain[m + 3, i]
            for j in range(i + 1):
                s = low[i, j] + e * diff[m, j] + f * diff[m + 1, j]
                low[i, j] = s + g * diff[m + 2, j] + h * diff[m + 3, j]
        for m in range(n - n % 4, n):
            f = gain[m, i]
            for j in range(i + 1):
                low[i, j] += f * diff[m, j]
    for i in range(n):
        for j in range(i + 1):
            v = 0.5 * (p_plus[i, j] + p_plus[j, i]) + low[i, j]
            out[i, j] = v
            out[j, i] = v
