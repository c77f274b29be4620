"""Covariances of many vectors in the axes of a body, compiled.

NumPy calls a routine of its own for each of the small matrices.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import kernel, part
from sinstool.core.quaternion_kernels import dcm

Row = tuple[float, float, float]
Rows = tuple[Row, Row, Row]


def turned_back(q: FloatArray, m: FloatArray, sign: FloatArray) -> FloatArray:
    """``S C^T M C S`` of each quaternion and matrix, with C the turn and S a diagonal of signs.

    Parameters
    ----------
    q : ndarray, shape (n, 4)
        Units, scalar first.
    m : ndarray, shape (n, 3, 3)
        Symmetric.
    sign : ndarray, shape (3,)

    Returns
    -------
    ndarray, shape (n, 3, 3)
        Symmetric to the last bit.
    """
    out = np.empty(m.shape)
    _turned_back(np.ascontiguousarray(q), np.ascontiguousarray(m), sign, out)
    return out


def of_turned(v: FloatArray, turn: FloatArray) -> FloatArray:
    """Covariances of vectors that are turned by uncertain small angles: ``[v x] T [v x]^T``.

    Parameters
    ----------
    v : ndarray, shape (n, 3)
    turn : ndarray, shape (n, 3, 3)
        Covariances of the angles about the same axes, rad^2.

    Returns
    -------
    ndarray, shape (n, 3, 3)
        Symmetric to the last bit.
    """
    out = np.empty(turn.shape)
    _of_turned(np.ascontiguousarray(v), np.ascontiguousarray(turn), out)
    return out


@kernel(vectorizes=False)
def _of_turned(v: FloatArray, turn: FloatArray, out: FloatArray) -> None:
    for n in range(len(v)):
        x, y, z = v[n, 0], v[n, 1], v[n, 2]
        _congruence(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)), turn[n], out[n])


@kernel(vectorizes=False)
def _turned_back(q: FloatArray, m: FloatArray, sign: FloatArray, out: FloatArray) -> None:
    r, s, t = sign[0], sign[1], sign[2]
    for n in range(len(q)):
        c00, c01, c02, c10, c11, c12, c20, c21, c22 = dcm(q[n, 0], q[n, 1], q[n, 2], q[n, 3])
        columns = (
            (r * c00, r * c10, r * c20),
            (s * c01, s * c11, s * c21),
            (t * c02, t * c12, t * c22),
        )
        _congruence(columns, m[n], out[n])


@part()
def _congruence(rows: Rows, m: FloatArray, out: FloatArray) -> None:
    """``A M A^T`` of a symmetric M, with the rows of A."""
    for i, (a, b, c) in enumerate(rows):
        x = a * m[0, 0] + b * m[1, 0] + c * m[2, 0]
        y = a * m[0, 1] + b * m[1, 1] + c * m[2, 1]
        z = a * m[0, 2] + b * m[1, 2] + c * m[2, 2]
        for j, (d, e, f) in enumerate(rows):
            if j <= i:
                total = x * d + y * e + z * f
                out[i, j] = total
                out[j, i] = total
