"""Errors and covariances between the rows that a filter stored and a smoother smoothed, compiled.

Of a few updates there are many states: in one loop each of their numbers is touched once.
"""

from __future__ import annotations

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.parts import kernel
from sinstool.core.quaternion_kernels import increment_quaternion, product, row, to_unit
from sinstool.methods.ins_gnss.states import ATTITUDE, AXES_PAIRS, POSITION, VELOCITY

# Where an update lies: between two rows, before the first, or where nothing is known beyond the
# filter.
BETWEEN, BEFORE, ALONE = 0, 1, 2


@kernel()
def errors_between(
    error: FloatArray,
    error_before: FloatArray,
    first_error: FloatArray,
    left: IntArray,
    right: IntArray,
    place: IntArray,
    share: FloatArray,
    seconds: FloatArray,
    linear_down: bool,
    out: FloatArray,
) -> None:
    """Errors at updates: linear in time, positions by a cubic of Hermite.

    Parameters
    ----------
    error, error_before : ndarray, shape (m, n)
        After a row's measurements, and before them.
    first_error : ndarray, shape (n,)
        At the start of the run.
    left, right : ndarray of int64, shape (u,)
        Rows on either side.
    place : ndarray of int64, shape (u,)
        `BETWEEN`, `BEFORE` (there is no left row, but the start) or `ALONE` (the error is 0).
    share : ndarray, shape (u,)
        Of the time between the rows, 0 to 1.
    seconds : ndarray, shape (u,)
        Between the rows; velocity errors times it are the slopes of position errors.
    linear_down : bool
        The vertical position error does not follow the velocity's.
    out : ndarray, shape (u, n)
        Gets them.
    """
    count, n = out.shape
    for i in range(count):
        if place[i] == ALONE:
            for j in range(n):
                out[i, j] = 0.0
            continue
        before = first_error if place[i] == BEFORE else error[left[i]]
        after = error_before[right[i]]
        s, length = share[i], seconds[i]
        for j in range(n):
            out[i, j] = before[j] + s * (after[j] - before[j])
        for k in range(2 if linear_down else 3):
            p = before[POSITION + k]
            moved = after[POSITION + k] - p
            v0, v1 = length * before[VELOCITY + k], length * after[VELOCITY + k]
            out[i, POSITION + k] = p + s * (
                v0 + s * (3.0 * moved - 2.0 * v0 - v1 + s * (v0 + v1 - 2.0 * moved))
            )


@kernel()
def covariances_between(
    corner: FloatArray,
    first: FloatArray,
    left: IntArray,
    right: IntArray,
    place: IntArray,
    share: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    attitude: FloatArray,
) -> None:
    """Covariances of position, velocity and attitude at updates, linear in time.

    Parameters
    ----------
    corner : ndarray, shape (m, k, k)
        Of rows; the three blocks are among their first states.
    first : ndarray, shape (n, n)
        At the start of the run.
    left, right, place, share
        As :func:`errors_between` takes them.
    position, velocity, attitude : ndarray, shape (u, 3, 3)
        Get them; where `place` is `ALONE` they stay as they are.
    """
    for i in range(len(place)):
        if place[i] == ALONE:
            continue
        before = first if place[i] == BEFORE else corner[left[i]]
        after, s = corner[right[i]], share[i]
        for j in range(3):
            for k in range(3):
                c = before[POSITION + j, POSITION + k]
                position[i, j, k] = c + s * (after[POSITION + j, POSITION + k] - c)
                c = before[VELOCITY + j, VELOCITY + k]
                velocity[i, j, k] = c + s * (after[VELOCITY + j, VELOCITY + k] - c)
                c = before[ATTITUDE + j, ATTITUDE + k]
                attitude[i, j, k] = c + s * (after[ATTITUDE + j, ATTITUDE + k] - c)


@kernel()
def take_off(
    error: FloatArray,
    scale: int,
    axes: int,
    accel_bias: int,
    gyro_bias: int,
    velocity: FloatArray,
    rate: FloatArray,
    force: FloatArray,
) -> None:
    """Take errors off velocities and what the IMU feels, in place.

    Parameters
    ----------
    error : ndarray, shape (n, states)
    scale, axes, accel_bias, gyro_bias : int
        First of the states of the accelerometers' scale, their axes and bias, and of the gyros'
        bias; negative where there are none.
    velocity, rate, force : ndarray, shape (n, 3)
    """
    for i in range(len(error)):
        felt = row(force, i)
        for k in range(3):
            velocity[i, k] -= error[i, VELOCITY + k]
            if scale >= 0:
                force[i, k] *= 1.0 - error[i, scale + k]
        if axes >= 0:
            for k, (axis, other) in enumerate(AXES_PAIRS):
                force[i, axis] -= error[i, axes + k] * felt[other]
        for k in range(3):
            force[i, k] -= error[i, accel_bias + k]
            rate[i, k] -= error[i, gyro_bias + k]


@kernel()
def turn(error: FloatArray, q: FloatArray, out: FloatArray) -> None:
    """Turn attitudes by psi.

    Parameters
    ----------
    error : ndarray, shape (n, states)
    q : ndarray, shape (n, 4)
        ``q_nb``.
    out : ndarray, shape (n, 4)
        Gets them.
    """
    for i in range(len(error)):
        pw, px, py, pz = increment_quaternion(
            error[i, ATTITUDE], error[i, ATTITUDE + 1], error[i, ATTITUDE + 2], 0
        )
        w, x, y, z = product(pw, px, py, pz, q[i, 0], q[i, 1], q[i, 2], q[i, 3])
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = to_unit(w, x, y, z)
