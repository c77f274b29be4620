"""Products of sparse matrices, for compiled loops."""

from __future__ import annotations

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import part


# Inlined, so that the caller's settings of floating point hold.
@part(inline="always")
def add_product(
    a: FloatArray, b: FloatArray, rows: int, inner: int, columns: int, out: FloatArray
) -> None:
    """``out += a b``, skipping the zeros of `a`.

    Parameters
    ----------
    a, b : ndarray, shape (>= rows, >= inner) and (>= inner, >= columns)
    rows, inner, columns : int
        Of the product; what lies beyond is left alone.
    out : ndarray, shape (>= rows, >= columns)
        Neither `a` nor `b`.
    """
    for i in range(rows):
        for k in range(inner):
            f = a[i, k]
            if f != 0.0:
                for j in range(columns):
                    out[i, j] += f * b[k, j]


@part(inline="always")
def product(
    a: FloatArray, b: FloatArray, rows: int, inner: int, columns: int, out: FloatArray
) -> None:
    """``out = a b``; see :func:`add_product`."""
    for i in range(rows):
        for j in range(columns):
            out[i, j] = 0.0
    add_product(a, b, rows, inner, columns, out)
