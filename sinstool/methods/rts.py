"""A step of the Rauch-Tung-Striebel recursion, compiled, shared by all smoothers."""

from __future__ import annotations

from math import sqrt

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import part
from sinstool.methods.products import take_off

# A pivot of the scaled covariance below which a direction counts as known from the others:
# rounding of n = 26 sums leaves some 1e-14.
_PIVOT = 1e-13
ROWS, COLUMNS = 4, 16
"""Of what numbers of rows and columns are multiples: the processor takes as many at a time."""


@part(fastmath={"contract"})
def smoother_gain(
    p_minus: FloatArray, columns: int, gain: FloatArray, up: FloatArray, scale: FloatArray
) -> None:
    """Rows of the gain ``P+ Phi^T P-^-1``, transposed.

    Parameters
    ----------
    p_minus : ndarray, shape (n, n)
        Covariance before the measurements of the next row; n is a multiple of `ROWS`, made up with
        zeros.
    columns : int
        So many rows of the gain, a multiple of `ROWS`, too; one of `COLUMNS` is faster.
    gain : ndarray, shape (n, >= columns)
        ``Phi P+``, the columns of the states whose rows they are; gets the transposed gain.
    up, scale : ndarray, shape (n, n) and (n,)
        Scratch.

    Notes
    -----
    ``P-`` is scaled to ones on its diagonal and factored by Cholesky; a state without variance,
    or known from the others to rounding, gets no row.
    """
    n = len(scale)
    for i in range(n):
        v = p_minus[i, i]
        scale[i] = 1.0 / sqrt(v) if v > 0.0 else 0.0
    # Cholesky's U of P- scaled to ones on the diagonal, U^T U
    for i in range(0, n, ROWS):
        for k in range(i, i + ROWS):
            for j in range(i, n):
                up[k, j] = p_minus[k, j] * scale[j] * scale[k]
        take_off(up, up, 0, i, i, i, n, up)
        for k in range(i, i + ROWS):
            # The reciprocal of the pivot; 0 leaves a known direction out.
            f = 1.0 / sqrt(up[k, k]) if up[k, k] > _PIVOT else 0.0
            up[k, k] = f
            for j in range(k + 1, i + ROWS):
                up[k, j] *= f
            for m in range(k + 1, i + ROWS):
                for j in range(m, i + ROWS):
                    up[m, j] -= up[k, m] * up[k, j]
        _solve_rows(up, i, i + ROWS, n, up)
    # P-^-1 Phi P+ = G^T, in place
    for i in range(n):
        for j in range(columns):
            gain[i, j] *= scale[i]
    for i in range(0, n, ROWS):
        take_off(up, gain, 0, i, i, 0, columns, gain)
        _solve_rows(up, i, 0, columns, gain)
    for i in range(n - ROWS, -1, -ROWS):
        take_off(up.T, gain, i + ROWS, n, i, 0, columns, gain)
        _solve_rows_back(up, i, columns, gain)
    for i in range(n):
        for j in range(columns):
            gain[i, j] *= scale[i]


@part(fastmath={"contract"})
def _solve_rows(up: FloatArray, i: int, start: int, end: int, out: FloatArray) -> None:
    """Divide four rows, of columns from `start` to `end`, by their block of ``U^T``."""
    d0, d1, d2, d3 = up[i, i], up[i + 1, i + 1], up[i + 2, i + 2], up[i + 3, i + 3]
    u01, u02, u03 = up[i, i + 1], up[i, i + 2], up[i, i + 3]
    u12, u13, u23 = up[i + 1, i + 2], up[i + 1, i + 3], up[i + 2, i + 3]
    for j in range(start, end):
        e = out[i, j] * d0
        f = (out[i + 1, j] - u01 * e) * d1
        g = (out[i + 2, j] - u02 * e - u12 * f) * d2
        out[i + 3, j] = (out[i + 3, j] - u03 * e - u13 * f - u23 * g) * d3
        out[i, j], out[i + 1, j], out[i + 2, j] = e, f, g


@part(fastmath={"contract"})
def _solve_rows_back(up: FloatArray, i: int, columns: int, out: FloatArray) -> None:
    """Divide four rows by their block of ``U``."""
    d0, d1, d2, d3 = up[i, i], up[i + 1, i + 1], up[i + 2, i + 2], up[i + 3, i + 3]
    u01, u02, u03 = up[i, i + 1], up[i, i + 2], up[i, i + 3]
    u12, u13, u23 = up[i + 1, i + 2], up[i + 1, i + 3], up[i + 2, i + 3]
    for j in range(columns):
        h = out[i + 3, j] * d3
        g = (out[i + 2, j] - u23 * h) * d2
        f = (out[i + 1, j] - u12 * g - u13 * h) * d1
        out[i, j] = (out[i, j] - u01 * f - u02 * g - u03 * h) * d0
        out[i + 1, j], out[i + 2, j], out[i + 3, j] = f, g, h


@part(fastmath={"contract"})
def smoothed_change(
    p_minus: FloatArray,
    after: FloatArray,
    columns: int,
    gain: FloatArray,
    product: FloatArray,
    change: FloatArray,
) -> None:
    """What smoothing changes of a row's covariance, ``G (Ps - P-) G^T``.

    Parameters
    ----------
    p_minus, columns, gain
        See :func:`smoother_gain`; ``Ps`` is added to ``-P-`` in place.
    after : ndarray, shape (m, m)
        Smoothed covariance of the next row, Ps, without zeros that make up its number of rows.
    product : ndarray, shape (n, >= columns)
        Gets ``(P- - Ps) G^T``.
    change : ndarray, shape (>= columns, >= columns)
        Gets the change; what lies above its diagonal is anything.
    """
    n, m = len(p_minus), len(after)
    for i in range(m):
        for j in range(m):
            p_minus[i, j] = after[i, j] - p_minus[i, j]
    for i in range(0, n, ROWS):
        for k in range(i, i + ROWS):
            for j in range(columns):
                product[k, j] = 0.0
        take_off(p_minus, gain, 0, n, i, 0, columns, product)
    for i in range(0, columns, ROWS):
        end = min(i - i % COLUMNS + COLUMNS, columns)
        for k in range(i, i + ROWS):
            for j in range(end):
                change[k, j] = 0.0
        take_off(gain, product, 0, n, i, 0, end, change)
