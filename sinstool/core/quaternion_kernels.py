"""Quaternions, vectors and angles in compiled loops: updates, products, matrices.

All in scalars, so that nothing is allocated; `sinstool.core.rotation` has them for arrays.

The quaternion of an update is exact, or by Picard iterations of fixed order. The exact quaternion
of a rotation vector ``phi`` of length ``a`` is ``[cos(a/2), sin(a/2)/a phi]``. Picard's iteration
of [1]_, stopped after one to four integrals and normalised, leaves these terms of its series
(``a`` for the length of ``phi``):

===== ============================ ======================= ==========================
order scalar                       factor of ``phi``       error of the angle per step
===== ============================ ======================= ==========================
1     1                            1/2                     -a**3/12
2     1 - a**2/8                   1/2                     +a**3/24
3     1 - a**2/8                   1/2 - a**2/48           +a**5/480
4     1 - a**2/8 + a**4/384        1/2 - a**2/48           -a**5/1920
===== ============================ ======================= ==========================

The cross products of increments that the published form carries are in the rotation vector
already: it comes with its coning correction. At 128 Hz and 100 deg/s the orders drift by 5.6,
2.8, 2.6e-5 and 6.5e-6 deg/h, so orders 1 and 2 are for comparisons only.

References
----------
.. [1] G. Yan, J. Weng, X. Yang, Y. Qin, "An accurate numerical solution for strapdown attitude
   algorithm based on Picard iteration", J. Astronautics 38(12), 2017, 1307-1313 (in Chinese).
"""

from __future__ import annotations

from math import atan2, cos, pi, sin, sqrt

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import part

EXACT = 0
"""The order that stands for the exact quaternion."""

_NEAR = 1e-7  # of the squared length to 1: a Newton step leaves 3/8 of its square


@part()
def increment_quaternion(
    px: float, py: float, pz: float, order: int
) -> tuple[float, float, float, float]:
    """Quaternion of a rotation vector, rad.

    Parameters
    ----------
    px, py, pz : float
        Rotation vector, rad.
    order : int
        0 for the exact one, 1 to 4 for Picard's; see the module.

    Returns
    -------
    w, x, y, z : float
        Of unit length.
    """
    square = px * px + py * py + pz * pz
    if order == 0:
        if square < 1e-2:
            # Taylor in the squared half angle (< 2.5e-3): what follows is below 1e-19.
            u = 0.25 * square
            w = 1.0 - u * (0.5 - u * (1.0 / 24.0 - u * (1.0 / 720.0 - u * (1.0 / 40320.0))))
            f = 0.5 - u * (
                1.0 / 12.0 - u * (1.0 / 240.0 - u * (1.0 / 10080.0 - u * (1.0 / 725760.0)))
            )
            return w, f * px, f * py, f * pz
        angle = sqrt(square)
        f = sin(0.5 * angle) / angle
        return cos(0.5 * angle), f * px, f * py, f * pz
    w = 1.0
    f = 0.5
    if order >= 2:
        w -= square / 8.0
    if order >= 3:
        f -= square / 48.0
    if order >= 4:
        w += square * square / 384.0
    scale = 1.0 / sqrt(w * w + f * f * square)
    f *= scale
    return w * scale, f * px, f * py, f * pz


@part()
def to_unit(w: float, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Quaternion brought to length 1."""
    square = w * w + x * x + y * y + z * z
    # After an update the length is 1 but for its rounding: one Newton step towards 1/|q|. Only a
    # motion that no vehicle makes, as of a filter led astray, is worth a root.
    f = 1.5 - 0.5 * square if abs(square - 1.0) < _NEAR else 1.0 / sqrt(square)
    return w * f, x * f, y * f, z * f


@part()
def to_rotation_vector(w: float, x: float, y: float, z: float, out: FloatArray, k: int) -> None:
    """Rotation vector of a quaternion of any length, to row `k` of `out`: from 0 to two pi, rad."""
    length = sqrt(x * x + y * y + z * z)
    # Below, 2 atan2(length, w) / length is 2 / w to the last bit.
    factor = 2.0 / w if length < 1e-9 * w else 2.0 * atan2(length, w) / length
    put(out, k, factor * x, factor * y, factor * z)


@part()
def cross(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float
) -> tuple[float, float, float]:
    """Cross product a x b."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@part()
def row(a: FloatArray, k: int) -> tuple[float, float, float]:
    """Row `k` of an array of shape (n, 3)."""
    return a[k, 0], a[k, 1], a[k, 2]


@part()
def put(a: FloatArray, k: int, x: float, y: float, z: float) -> None:
    """Set row `k` of an array of shape (n, 3)."""
    a[k, 0] = x
    a[k, 1] = y
    a[k, 2] = z


@part(inline="always")
def weighted_sum(
    a: FloatArray, first: int, step: int, weights: FloatArray, which: int, count: int
) -> tuple[float, float, float]:
    """Sum of `count` rows of `a`, from `first` on each `step`, by row `which` of the weights."""
    x = y = z = 0.0
    for j in range(count):
        weight = weights[which, j]
        k = first + step * j
        x += weight * a[k, 0]
        y += weight * a[k, 1]
        z += weight * a[k, 2]
    return x, y, z


@part()
def product(
    pw: float, px: float, py: float, pz: float, qw: float, qx: float, qy: float, qz: float
) -> tuple[float, float, float, float]:
    """Hamilton product p q.

    Returns
    -------
    w, x, y, z : float
    """
    return (
        pw * qw - px * qx - py * qy - pz * qz,
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
    )


@part()
def dcm(
    w: float, x: float, y: float, z: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Direction cosine matrix of a unit quaternion.

    Returns
    -------
    c00, c01, c02, c10, c11, c12, c20, c21, c22 : float
        Row by row.
    """
    return (
        w * w + x * x - y * y - z * z,
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        w * w - x * x + y * y - z * z,
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        w * w - x * x - y * y + z * z,
    )


@part()
def wrapped_angle(angle: float) -> float:
    """An angle of a few turns reduced to (-pi, pi]; one inside is unchanged."""
    while angle > pi:
        angle -= 2.0 * pi
    while angle <= -pi:
        angle += 2.0 * pi
    return angle
