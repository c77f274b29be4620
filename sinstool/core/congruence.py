"""Covariances of many vectors that are turned, or that others are made of: ``A M A^T``, compiled.

NumPy calls a routine of its own for each of the small matrices.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import kernel


def congruent(a: FloatArray, m: FloatArray) -> FloatArray:
    """``A M A^T`` of each pair of matrices.

    Parameters
    ----------
    a : ndarray, shape (n, i, j)
    m : ndarray, shape (n, j, j) or (j, j)
        Symmetric; one for all, or one for each.

    Returns
    -------
    ndarray, shape (n, i, i)
        Symmetric to the last bit.
    """
    count, rows, columns = a.shape
    each = m.reshape(-1, columns, columns)
    if len(each) not in (1, count):
        raise ValueError(f"Expected one matrix or {count}, got {len(each)}.")
    out = np.empty((count, rows, rows))
    _congruent(np.ascontiguousarray(a), np.ascontiguousarray(each), out)
    return out


@kernel()
def _congruent(a: FloatArray, m: FloatArray, out: FloatArray) -> None:
    count, rows, columns = a.shape
    step = 1 if len(m) == count else 0
    for n in range(count):
        one = m[n * step]
        for i in range(rows):
            for j in range(i + 1):
                total = 0.0
                for k in range(columns):
                    part = 0.0
                    for p in range(columns):
                        part += a[n, i, p] * one[p, k]
                    total += part * a[n, j, k]
                out[n, i, j] = total
                out[n, j, i] = total
