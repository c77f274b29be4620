"""The backward recursion of the smoother, compiled."""

from __future__ import annotations

from math import sqrt

import numba
import numpy as np

from sinstool.core.arrays import FloatArray

# A pivot of the scaled covariance below which a direction counts as known from the others:
# rounding of n = 26 sums leaves some 1e-14.
_PIVOT = 1e-13


@numba.njit(cache=True, nogil=True)
def smooth_backward(
    transition: FloatArray,
    p_minus: FloatArray,
    p_plus: FloatArray,
    correction: FloatArray,
    starts: np.ndarray,
    work: FloatArray,
    d: FloatArray,
    p_smooth: FloatArray,
) -> None:
    """Smooth from the last row to the first.

    Parameters
    ----------
    transition : ndarray, shape (m, n, n)
        From the row before to each.
    p_minus, p_plus : ndarray, shape (m, n, n)
        Covariances of the filter before and after the measurements of each row.
    correction : ndarray, shape (m, n)
        What the measurements of the row added to the estimate.
    starts : ndarray of bool, shape (m,)
        Nothing may be taken across from this row to the one before.
    work : ndarray, shape (4, n, n)
        Scratch.
    d : ndarray, shape (m, n)
        Gets what later rows add to the estimate of each.
    p_smooth : ndarray, shape (m, n, n)
        Gets the smoothed covariances; may be `p_plus` itself.

    Notes
    -----
    ``P-`` is scaled to ones on its diagonal and factored by Cholesky; a state without variance,
    or known from the others to rounding, gets no row in G.
    """
    n = d.shape[1]
    last = d.shape[0] - 1
    low, gain, diff = work[0], work[1], work[2]
    scale, x = work[3, 0], work[3, 1]
    for i in range(n):
        d[last, i] = 0.0
        for j in range(n):
            p_smooth[last, i, j] = p_plus[last, i, j]
    for k in range(last - 1, -1, -1):
        after = k + 1
        if starts[after]:
            for i in range(n):
                d[k, i] = 0.0
                for j in range(n):
                    p_smooth[k, i, j] = p_plus[k, i, j]
            continue
        # Phi P+, which is the transpose of what G multiplies the inverse with
        for i in range(n):
            for j in range(n):
                gain[i, j] = 0.0
            for m in range(n):
                f = transition[after, i, m]
                if f != 0.0:
                    for j in range(n):
                        gain[i, j] += f * p_plus[k, m, j]
        # Cholesky of P- scaled to ones on the diagonal
        for i in range(n):
            v = p_minus[after, i, i]
            scale[i] = 1.0 / sqrt(v) if v > 0.0 else 0.0
        for i in range(n):
            for j in range(i + 1):
                s = p_minus[after, i, j] * scale[i] * scale[j]
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
            for m in range(i):
                f = low[i, m]
                for j in range(n):
                    gain[i, j] -= f * gain[m, j]
            f = low[i, i]
            for j in range(n):
                gain[i, j] *= f
        for i in range(n - 1, -1, -1):
            for m in range(i + 1, n):
                f = low[m, i]
                for j in range(n):
                    gain[i, j] -= f * gain[m, j]
            f = low[i, i]
            for j in range(n):
                gain[i, j] *= f
        for i in range(n):
            for j in range(n):
                gain[i, j] *= scale[i]
        for j in range(n):
            s = 0.0
            for m in range(n):
                s += gain[m, j] * (d[after, m] + correction[after, m])
            x[j] = s
        # P+ + G (Ps - P-) G^T, symmetric to the last bit
        for i in range(n):
            for j in range(n):
                diff[i, j] = 0.0
            for m in range(n):
                f = p_smooth[after, i, m] - p_minus[after, i, m]
                for j in range(n):
                    diff[i, j] += f * gain[m, j]
        for i in range(n):
            for j in range(n):
                low[i, j] = 0.0
        for m in range(n):
            for i in range(n):
                f = gain[m, i]
                for j in range(i + 1):
                    low[i, j] += f * diff[m, j]
        for i in range(n):
            d[k, i] = x[i]
            for j in range(i + 1):
                v = 0.5 * (p_plus[k, i, j] + p_plus[k, j, i]) + low[i, j]
                p_smooth[k, i, j] = v
                p_smooth[k, j, i] = v
