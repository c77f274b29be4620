"""Quaternions, rotation vectors, direction cosine matrices and Euler angles.

Quaternions are Hamilton, unit and scalar first, ``[w, x, y, z]``. A quaternion ``q_nb`` or
a matrix ``C_nb`` takes a vector from ``b`` to ``n``. Every function works on the last axis
and broadcasts over all axes before it.

References
----------
.. [1] M. D. Shuster, "A survey of attitude representations", J. Astronautical Sciences
   41(4), 1993, 439-517.
.. [2] E. Bernardes, S. Viollet, "Quaternion to Euler angles conversion: A direct, general
   and computationally efficient method", PLoS ONE 17(11), 2022.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray

# Below this angle the first two terms of the series of sin(x)/x are exact in float64
# (the third is x**4 / 120 = 5e-20), and squares of the components cannot underflow.
_SMALL_ANGLE = 1e-4

# cos(pitch) that float64 cannot tell from zero: roll and heading are then one angle.
_GIMBAL_LOCK = 1e-15
# Matrices that are converted at a time
_AT_ONCE = 1 << 14


def _last_axis(value: ArrayLike, size: int, what: str) -> FloatArray:
    array = np.asarray(value, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != size:
        raise ValueError(f"Expected `{what}` to have shape (..., {size}), got {array.shape}.")
    return array


def exp(rotation_vector: ArrayLike) -> FloatArray:
    """Quaternion of a rotation vector.

    Parameters
    ----------
    rotation_vector : array_like, shape (..., 3)
        Axis times angle, rad. Any length; more than pi is more than half a turn.

    Returns
    -------
    ndarray, shape (..., 4)
        Unit quaternion.

    Raises
    ------
    ValueError
        If the last axis is not of length 3.

    Notes
    -----
    ``q = [cos(a/2), sin(a/2) / a * rotation_vector]`` with ``a`` the length; see [1]_ of
    the module.
    """
    phi = _last_axis(rotation_vector, 3, "rotation_vector")
    angle = np.linalg.norm(phi, axis=-1, keepdims=True)
    half = 0.5 * angle
    small = angle < _SMALL_ANGLE
    factor = np.where(small, 0.5 - half * half / 12.0, np.sin(half) / np.where(small, 1.0, angle))
    return np.concatenate([np.cos(half), factor * phi], axis=-1)


def log(quaternion: ArrayLike) -> FloatArray:
    """Shortest rotation vector of a quaternion: the inverse of :func:`exp`.

    Parameters
    ----------
    quaternion : array_like, shape (..., 4)
        Not zero; need not be exactly unit, and ``q`` and ``-q`` give the same.

    Returns
    -------
    ndarray, shape (..., 3)
        Rotation vector, rad, of length 0 to pi. At half a turn, where the sign of the axis
        is free, it is that of the vector part as given.

    Raises
    ------
    ValueError
        If the last axis is not of length 4.

    Notes
    -----
    The angle is ``2 atan2(|v|, |w|)``, which unlike ``2 acos(w)`` keeps full precision at
    0 and at pi.
    """
    q = _last_axis(quaternion, 4, "quaternion")
    q = np.where(q[..., :1] < 0.0, -q, q)
    w, v = q[..., :1], q[..., 1:]
    norm_v = np.linalg.norm(v, axis=-1, keepdims=True)
    # Below, 2 atan2(|v|, w) / |v| is 2 / w to the last bit, and |v|**2 might underflow.
    small = norm_v < 1e-9 * w
    factor = np.where(
        small,
        2.0 / np.where(small, w, 1.0),
        2.0 * np.arctan2(norm_v, w) / np.where(small, 1.0, norm_v),
    )
    return np.asarray(factor * v)


def multiply(p: ArrayLike, q: ArrayLike) -> FloatArray:
    """Hamilton product ``p q``: first the rotation ``q``, then ``p``.

    Parameters
    ----------
    p, q : array_like, shape (..., 4)
        Quaternions; shapes broadcast.

    Returns
    -------
    ndarray, shape (..., 4)
        The product, not renormalised. ``q_ac = multiply(q_ab, q_bc)``.

    Raises
    ------
    ValueError
        If a last axis is not of length 4 or the shapes do not broadcast.
    """
    a = _last_axis(p, 4, "p")
    b = _last_axis(q, 4, "q")
    aw, ax, ay, az = (a[..., i] for i in range(4))
    bw, bx, by, bz = (b[..., i] for i in range(4))
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def conjugate(quaternion: ArrayLike) -> FloatArray:
    """Conjugate: of a unit quaternion the inverse rotation.

    Parameters
    ----------
    quaternion : array_like, shape (..., 4)
        Quaternions.

    Returns
    -------
    ndarray, shape (..., 4)
        ``[w, -x, -y, -z]``.

    Raises
    ------
    ValueError
        If the last axis is not of length 4.
    """
    return _last_axis(quaternion, 4, "quaternion") * np.array([1.0, -1.0, -1.0, -1.0])


def normalise(quaternion: ArrayLike) -> FloatArray:
    """Quaternion of length 1 in the same direction.

    Parameters
    ----------
    quaternion : array_like, shape (..., 4)
        Quaternions.

    Returns
    -------
    ndarray, shape (..., 4)
        Unit quaternions; the sign is kept.

    Raises
    ------
    ValueError
        If the last axis is not of length 4, or a quaternion is zero or not finite.
    """
    q = _last_axis(quaternion, 4, "quaternion")
    largest = np.max(np.abs(q), axis=-1, keepdims=True, initial=0.0)
    if not np.all(np.isfinite(largest)) or np.any(largest == 0.0):
        raise ValueError("Found a quaternion of zero or infinite length in `quaternion`.")
    scaled = q / largest  # so that neither very small nor very large components are lost
    return np.asarray(scaled / np.linalg.norm(scaled, axis=-1, keepdims=True))


def rotate(quaternion: ArrayLike, vector: ArrayLike) -> FloatArray:
    """Vectors rotated: ``v_n`` from ``q_nb`` and ``v_b``.

    Parameters
    ----------
    quaternion : array_like, shape (..., 4)
        Unit quaternions.
    vector : array_like, shape (..., 3)
        Vectors; shapes broadcast.

    Returns
    -------
    ndarray, shape (..., 3)
        ``C(q) v``.

    Raises
    ------
    ValueError
        If a last axis has the wrong length or the shapes do not broadcast.
    """
    q = _last_axis(quaternion, 4, "quaternion")
    v = _last_axis(vector, 3, "vector")
    w, u = q[..., :1], q[..., 1:]
    # v + 2 w (u x v) + 2 u x (u x v): two cross products, no matrix
    t = 2.0 * _cross(u, v)
    return np.asarray(v + w * t + _cross(u, t))


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """As `np.cross` of vectors, which for a few of them looks at their axes for longest."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return out


def to_dcm(quaternion: ArrayLike) -> FloatArray:
    """Direction cosine matrix of a unit quaternion.

    Parameters
    ----------
    quaternion : array_like, shape (..., 4)
        Unit quaternions ``q_nb``.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        ``C_nb``.

    Raises
    ------
    ValueError
        If the last axis is not of length 4.
    """
    q = _last_axis(quaternion, 4, "quaternion")
    w, x, y, z = (q[..., i] for i in range(4))
    matrix = np.empty((*q.shape[:-1], 3, 3))
    matrix[..., 0, 0] = w * w + x * x - y * y - z * z
    matrix[..., 0, 1] = 2.0 * (x * y - w * z)
    matrix[..., 0, 2] = 2.0 * (x * z + w * y)
    matrix[..., 1, 0] = 2.0 * (x * y + w * z)
    matrix[..., 1, 1] = w * w - x * x + y * y - z * z
    matrix[..., 1, 2] = 2.0 * (y * z - w * x)
    matrix[..., 2, 0] = 2.0 * (x * z - w * y)
    matrix[..., 2, 1] = 2.0 * (y * z + w * x)
    matrix[..., 2, 2] = w * w - x * x - y * y + z * z
    return matrix


def from_dcm(matrix: ArrayLike) -> FloatArray:
    """Quaternion of a direction cosine matrix.

    Parameters
    ----------
    matrix : array_like, shape (..., 3, 3)
        Rotation matrices ``C_nb``, orthogonal up to rounding.

    Returns
    -------
    ndarray, shape (..., 4)
        Unit ``q_nb`` with ``w >= 0``.

    Raises
    ------
    ValueError
        If the shape is wrong or a determinant is not positive.

    Notes
    -----
    Of the four ways to divide, that by the largest component is taken (Shepperd's method,
    see [1]_ of the module), so no angle is special.
    """
    c = np.asarray(matrix, dtype=np.float64)
    if c.ndim < 2 or c.shape[-2:] != (3, 3):
        raise ValueError(f"Expected `matrix` to have shape (..., 3, 3), got {c.shape}.")
    flat = c.reshape(-1, 3, 3)
    q = np.empty((len(flat), 4))
    # So many at a time, as each is in memory several times meanwhile
    for first in range(0, len(flat), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        q[some] = _from_some(flat[some])
    return q.reshape(*c.shape[:-2], 4)


def _from_some(c: FloatArray) -> FloatArray:
    """Quaternions of matrices, shape (n, 3, 3)."""
    if not np.all(np.linalg.det(c) > 0.0):
        raise ValueError("Found a matrix without positive determinant in `matrix`.")
    c00, c11, c22 = c[..., 0, 0], c[..., 1, 1], c[..., 2, 2]
    # Row i of `rows` is 4 q_i [w, x, y, z]; its own component is the diagonal 4 q_i**2.
    d0 = c[..., 2, 1] - c[..., 1, 2]
    d1 = c[..., 0, 2] - c[..., 2, 0]
    d2 = c[..., 1, 0] - c[..., 0, 1]
    s0 = c[..., 2, 1] + c[..., 1, 2]
    s1 = c[..., 0, 2] + c[..., 2, 0]
    s2 = c[..., 1, 0] + c[..., 0, 1]
    rows = np.stack(
        [
            np.stack([1.0 + c00 + c11 + c22, d0, d1, d2], axis=-1),
            np.stack([d0, 1.0 + c00 - c11 - c22, s2, s1], axis=-1),
            np.stack([d1, s2, 1.0 - c00 + c11 - c22, s0], axis=-1),
            np.stack([d2, s1, s0, 1.0 - c00 - c11 + c22], axis=-1),
        ],
        axis=-2,
    )
    largest = np.argmax(np.diagonal(rows, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(rows, largest[..., np.newaxis, np.newaxis], axis=-2)[..., 0, :]
    q = normalise(q)
    return np.where(q[..., :1] < 0.0, -q, q)


def from_euler(roll_pitch_heading: ArrayLike) -> FloatArray:
    """Quaternion ``q_nb`` of the 3-2-1 Euler angles of FRD in NED.

    Parameters
    ----------
    roll_pitch_heading : array_like, shape (..., 3)
        Angles, rad: roll positive right wing down, pitch positive nose up, heading
        positive from North to East.

    Returns
    -------
    ndarray, shape (..., 4)
        Unit ``q_nb``: heading about z, then pitch about y, then roll about x.

    Raises
    ------
    ValueError
        If the last axis is not of length 3.
    """
    half = 0.5 * _last_axis(roll_pitch_heading, 3, "roll_pitch_heading")
    cr, cp, ch = (np.cos(half[..., i]) for i in range(3))
    sr, sp, sh = (np.sin(half[..., i]) for i in range(3))
    return np.stack(
        [
            ch * cp * cr + sh * sp * sr,
            ch * cp * sr - sh * sp * cr,
            ch * sp * cr + sh * cp * sr,
            sh * cp * cr - ch * sp * sr,
        ],
        axis=-1,
    )


def to_euler(quaternion: ArrayLike) -> FloatArray:
    """Roll, pitch and heading of FRD in NED from ``q_nb``.

    Parameters
    ----------
    quaternion : array_like, shape (..., 4)
        Unit quaternions ``q_nb``.

    Returns
    -------
    ndarray, shape (..., 3)
        Roll in [-pi, pi], pitch in [-pi/2, pi/2], heading in [-pi, pi], rad. With the nose
        straight up or down roll and heading are one angle: all of it is called heading
        and roll is 0.

    Raises
    ------
    ValueError
        If the last axis is not of length 4.

    Notes
    -----
    Works from the half sum and half difference of heading and roll, [2]_ of the module, so
    that near straight up and down the attitude of the answer is still right to rounding;
    the matrix elements used commonly lose half the digits there.
    """
    q = _last_axis(quaternion, 4, "quaternion")
    w, x, y, z = (q[..., i] for i in range(4))
    length_difference = np.hypot(w + y, z - x)  # cos(pitch/2) + sin(pitch/2)
    length_sum = np.hypot(w - y, z + x)  # cos(pitch/2) - sin(pitch/2)
    pitch = 2.0 * np.arctan2(length_difference - length_sum, length_difference + length_sum)
    half_difference = np.arctan2(z - x, w + y)  # (heading - roll) / 2
    half_sum = np.arctan2(z + x, w - y)  # (heading + roll) / 2
    up = length_sum < _GIMBAL_LOCK
    down = length_difference < _GIMBAL_LOCK
    half_sum = np.where(up, half_difference, half_sum)
    half_difference = np.where(down, half_sum, half_difference)
    roll = half_sum - half_difference
    heading = half_sum + half_difference
    return np.stack([_less_a_turn(roll), pitch, _less_a_turn(heading)], axis=-1)


def tilt_and_heading(quaternion: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Rotations in NED or ENU, such as errors of attitude: a tilt, then a turn about the vertical.

    Parameters
    ----------
    quaternion : array_like, shape (..., 4)
        In navigation axes: ``q_nb`` of one attitude times the conjugate of that of another.

    Returns
    -------
    tilt : ndarray, shape (..., 2)
        First two elements of the level rotation vector, rad; its length is the angle between the
        verticals.
    heading : ndarray, shape (...)
        In (-pi, pi], rad; 0 of what turns upside down, which can be put down to the tilt alone.
    """
    q = _last_axis(quaternion, 4, "quaternion")
    size = np.hypot(q[..., :1], q[..., 3:])
    turn = q * [1.0, 0.0, 0.0, 1.0] / np.where(size > 0.0, size, 1.0)
    turn = np.where(size > 0.0, turn, [1.0, 0.0, 0.0, 0.0])
    tilt = log(multiply(conjugate(turn), q))[..., :2]
    return tilt, wrapped(2.0 * np.arctan2(turn[..., 3], turn[..., 0]))


def _less_a_turn(angle: FloatArray) -> FloatArray:
    """Angle in [-2 pi, 2 pi] brought into [-pi, pi]; one inside keeps its last bit."""
    angle = np.where(angle > np.pi, angle - 2.0 * np.pi, angle)
    return np.where(angle < -np.pi, angle + 2.0 * np.pi, angle)


def wrapped(angle: ArrayLike) -> FloatArray:
    """Angles less whole turns.

    Parameters
    ----------
    angle : array_like, shape (...)
        rad.

    Returns
    -------
    ndarray, shape (...)
        In (-pi, pi], rad. The date line is a longitude of +180 degrees.
    """
    inside = np.pi - np.mod(np.pi - np.asarray(angle), 2.0 * np.pi)
    return np.where(inside <= -np.pi, np.pi, inside)  # a last bit beyond pi is a whole turn off


def skew(vector: ArrayLike) -> FloatArray:
    """Matrix of the cross product, ``[v x]``.

    Parameters
    ----------
    vector : array_like, shape (..., 3)

    Returns
    -------
    ndarray, shape (..., 3, 3)
        ``skew(v) @ w`` is ``cross(v, w)``.

    Raises
    ------
    ValueError
        If the last axis is not of length 3.
    """
    v = _last_axis(vector, 3, "vector")
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out
