"""The backward recursion of the smoother, compiled."""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import kernel
from sinstool.methods.rts import smoother_covariance, smoother_gain


@kernel()
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
        smoother_gain(transition[after], p_plus[k], p_minus[after], gain, low, scale)
        for j in range(n):
            s = 0.0
            for m in range(n):
                s += gain[m, j] * (d[after, m] + correction[after, m])
            x[j] = s
        smoother_covariance(
            p_plus[k], p_minus[after], p_smooth[after], gain, diff, low, p_smooth[k]
        )
        for i in range(n):
            d[k, i] = x[i]
