"""Products of sparse matrices, for compiled loops."""

from __future__ import annotations

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import part


# Inlined, so that the caller's settings of floating point hold.
@part(inline="always")
def add_product(
    a: FloatArray, b: FloatArray, rows: int, inner: int, columns: int, out: FloatArray
) -> None:
    """``out += a b``, skipping zeros of `a`.

    Parameters
    ----------
    a, b : ndarray, shape (>= rows, >= inner) and (>= inner, >= columns)
    rows, inner, columns : int
        Of the product; what lies beyond is left alone.
    out : ndarray, shape (>= rows, >= columns)
        Neither `a` nor `b`.
    """
    # Four rows at a time: short loops take longer to begin than to run
    whole = inner - inner % 4
    for i in range(rows):
        for k in range(0, whole, 4):
            e, f, g, h = a[i, k], a[i, k + 1], a[i, k + 2], a[i, k + 3]
            if e != 0.0 or f != 0.0 or g != 0.0 or h != 0.0:
                for j in range(columns):
                    out[i, j] = (
                        out[i, j]
                        + e * b[k, j]
                        + f * b[k + 1, j]
                        + g * b[k + 2, j]
                        + h * b[k + 3, j]
                    )
        for k in range(whole, inner):
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
