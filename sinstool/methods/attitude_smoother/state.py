"""The state of the filter over epochs: how it is numbered, corrected and compared.

It has 22 numbers: the correction C row by row (9), velocity (3), gyro bias (3), vertical
excess of the specific force (1), position (3), accelerometer bias (3, body axes). Errors come in
the order attitude, velocity, gyro bias, excess, and then the position of a hand or, where it is
estimated, the accelerometer bias of a vehicle: the right-invariant ``C_true = exp(phi) C``,
``v_true = exp(phi) v + xi_v``, likewise the position.
"""

from __future__ import annotations

from math import cos, sin, sqrt
from typing import Any

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import part
from sinstool.methods.attitude_smoother.epochs import JB

V, B, G, P, A = 9, 12, 15, 16, 19  # of the state
# Of the errors. A literal is a type of its own to numba, and every function that it is passed to
# would be compiled for each.
XA: Any
XV: Any
XB: Any
XG: Any
XP: Any
XA, XV, XB, XG, XP = map(np.int64, (0, 3, 6, 9, 10))
STATE, ERRORS, KEPT = 22, 13, 17


@part()
def copy(source: FloatArray, out: FloatArray) -> None:
    """out <- source; an assignment to a slice takes numba a second to compile."""
    for i in range(len(source)):
        out[i] = source[i]


@part()
def copy_square(source: FloatArray, n: int, out: FloatArray) -> None:
    """out <- source, of n rows and columns."""
    for i in range(n):
        for j in range(n):
            out[i, j] = source[i, j]


@part()
def rotation_of(x: float, y: float, z: float, e: FloatArray) -> None:
    """Matrix of a rotation vector, rad."""
    square = x * x + y * y + z * z
    if square < 1e-8:
        s, c = 1.0 - square / 6.0, 0.5 - square / 24.0
    else:
        angle = sqrt(square)
        s, c = sin(angle) / angle, (1.0 - cos(angle)) / square
    e[0, 0] = 1.0 - c * (y * y + z * z)
    e[0, 1] = c * x * y - s * z
    e[0, 2] = c * x * z + s * y
    e[1, 0] = c * x * y + s * z
    e[1, 1] = 1.0 - c * (x * x + z * z)
    e[1, 2] = c * y * z - s * x
    e[2, 0] = c * x * z - s * y
    e[2, 1] = c * y * z + s * x
    e[2, 2] = 1.0 - c * (x * x + y * y)


@part()
def turn(x: FloatArray, e: FloatArray) -> None:
    """C <- e C."""
    for j in range(3):
        a, b, c = x[j], x[3 + j], x[6 + j]
        for i in range(3):
            x[3 * i + j] = e[i, 0] * a + e[i, 1] * b + e[i, 2] * c


@part()
def felt(x: FloatArray, row: FloatArray, at: int, share: float) -> tuple[float, float, float]:
    """A sum of specific force over an epoch, corrected.

    The bias has turned the axes by a share of what it does over all of the epoch, in the mean.
    """
    a = row[at] - (row[JB] * x[A] + row[JB + 1] * x[A + 1] + row[JB + 2] * x[A + 2])
    b = row[at + 1] - (row[JB + 3] * x[A] + row[JB + 4] * x[A + 1] + row[JB + 5] * x[A + 2])
    c = row[at + 2] - (row[JB + 6] * x[A] + row[JB + 7] * x[A + 1] + row[JB + 8] * x[A + 2])
    u = row[JB] * x[B] + row[JB + 1] * x[B + 1] + row[JB + 2] * x[B + 2]
    v = row[JB + 3] * x[B] + row[JB + 4] * x[B + 1] + row[JB + 5] * x[B + 2]
    w = row[JB + 6] * x[B] + row[JB + 7] * x[B + 1] + row[JB + 8] * x[B + 2]
    d, e, f = a - share * (v * c - w * b), b - share * (w * a - u * c), c - share * (u * b - v * a)
    return (
        x[0] * d + x[1] * e + x[2] * f,
        x[3] * d + x[4] * e + x[5] * f,
        x[6] * d + x[7] * e + x[8] * f,
    )


@part()
def inject(x: FloatArray, dx: FloatArray, n: int, hand: bool, e: FloatArray) -> None:
    """Add errors to the state."""
    rotation_of(dx[0], dx[1], dx[2], e)
    turn(x, e)
    a, b, c = x[V], x[V + 1], x[V + 2]
    for i in range(3):
        x[V + i] = e[i, 0] * a + e[i, 1] * b + e[i, 2] * c + dx[XV + i]
        x[B + i] += dx[XB + i]
    x[G] += dx[XG]
    if hand:
        a, b, c = x[P], x[P + 1], x[P + 2]
        for i in range(3):
            x[P + i] = e[i, 0] * a + e[i, 1] * b + e[i, 2] * c + dx[XP + i]
    elif n > XP:
        for i in range(3):
            x[A + i] += dx[XP + i]


@part()
def less(a: FloatArray, b: FloatArray, n: int, hand: bool, out: FloatArray, e: FloatArray) -> None:
    """Errors that lead from state b to state a."""
    # e = C_a C_b^T, and its rotation vector
    for i in range(3):
        for j in range(3):
            e[i, j] = (
                a[3 * i] * b[3 * j] + a[3 * i + 1] * b[3 * j + 1] + a[3 * i + 2] * b[3 * j + 2]
            )
    x, y, z = e[2, 1] - e[1, 2], e[0, 2] - e[2, 0], e[1, 0] - e[0, 1]
    sine = 0.5 * sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (e[0, 0] + e[1, 1] + e[2, 2] - 1.0)
    factor = 0.5 if sine < 1e-9 else 0.5 * np.arctan2(sine, cosine) / sine
    out[0], out[1], out[2] = factor * x, factor * y, factor * z
    for i in range(3):
        out[XV + i] = a[V + i] - (e[i, 0] * b[V] + e[i, 1] * b[V + 1] + e[i, 2] * b[V + 2])
        out[XB + i] = a[B + i] - b[B + i]
        if hand:
            out[XP + i] = a[P + i] - (e[i, 0] * b[P] + e[i, 1] * b[P + 1] + e[i, 2] * b[P + 2])
        elif n > XP:
            out[XP + i] = a[A + i] - b[A + i]
    out[XG] = a[G] - b[G]


@part()
def keep(p: FloatArray, out: FloatArray) -> None:
    """Covariance of attitude (9); variances of gyro bias (3), level velocity (2), the rest (3)."""
    for i in range(3):
        for j in range(3):
            out[3 * i + j] = p[i, j]
        out[9 + i] = p[XB + i, XB + i]
    out[12], out[13] = p[XV, XV], p[XV + 1, XV + 1]
    for i in range(3):
        out[14 + i] = p[XP + i, XP + i] if len(p) > XP else 0.0


@part()
def update(
    p: FloatArray,
    n: int,
    i: int,
    a: float,
    j: int,
    b: float,
    k: int,
    c: float,
    innovation: float,
    variance: float,
    gain: FloatArray,
    dx: FloatArray,
) -> tuple[float, float]:
    """One scalar measurement of a x_i + b x_j + c x_k; the innovation left and its variance."""
    left = innovation - (a * dx[i] + b * dx[j] + c * dx[k])
    for m in range(n):
        gain[m] = a * p[m, i] + b * p[m, j] + c * p[m, k]
    s = a * gain[i] + b * gain[j] + c * gain[k] + variance
    _correct(p, n, gain, s, left, dx)
    return left, s


@part(inline="always")
def _correct(
    p: FloatArray, n: int, gain: FloatArray, s: float, left: float, dx: FloatArray
) -> None:
    """Correct by a measurement with innovation `left`, variance `s`, and covariance `gain`."""
    for m in range(n):
        f = gain[m] / s
        dx[m] += f * left
        for q in range(m + 1):
            p[m, q] -= f * gain[q]
            p[q, m] = p[m, q]


@part()
def update_row(
    p: FloatArray,
    n: int,
    h: FloatArray,
    innovation: float,
    variance: float,
    gain: FloatArray,
    dx: FloatArray,
) -> tuple[float, float]:
    """One scalar measurement of the sum of h x; the innovation left and its variance."""
    left = innovation
    s = variance
    for m in range(n):
        left -= h[m] * dx[m]
        gain[m] = 0.0
        for i in range(n):
            gain[m] += p[m, i] * h[i]
        s += h[m] * gain[m]
    _correct(p, n, gain, s, left, dx)
    return left, s
