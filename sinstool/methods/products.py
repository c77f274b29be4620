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


@part(inline="always")
def take_off(
    a: FloatArray,
    b: FloatArray,
    first: int,
    last: int,
    i: int,
    start: int,
    end: int,
    out: FloatArray,
) -> None:
    """Rows `i` to `i` + 3 of ``out -= a^T b``, of columns from `start` to `end`.

    Of dense matrices: four rows by four, as what is loaded then serves four times.

    Parameters
    ----------
    a, b : ndarray
        Their rows from `first` to `last` are summed over, a multiple of four.
    out : ndarray
        Other rows than those of `b`, if it is the same.
    """
    for m in range(first, last, 4):
        a00, a01, a02, a03 = a[m, i], a[m, i + 1], a[m, i + 2], a[m, i + 3]
        a10, a11, a12, a13 = a[m + 1, i], a[m + 1, i + 1], a[m + 1, i + 2], a[m + 1, i + 3]
        a20, a21, a22, a23 = a[m + 2, i], a[m + 2, i + 1], a[m + 2, i + 2], a[m + 2, i + 3]
        a30, a31, a32, a33 = a[m + 3, i], a[m + 3, i + 1], a[m + 3, i + 2], a[m + 3, i + 3]
        for j in range(start, end):
            e, f, g, h = b[m, j], b[m + 1, j], b[m + 2, j], b[m + 3, j]
            out[i, j] = out[i, j] - a00 * e - a10 * f - a20 * g - a30 * h
            out[i + 1, j] = out[i + 1, j] - a01 * e - a11 * f - a21 * g - a31 * h
            out[i + 2, j] = out[i + 2, j] - a02 * e - a12 * f - a22 * g - a32 * h
            out[i + 3, j] = out[i + 3, j] - a03 * e - a13 * f - a23 * g - a33 * h
