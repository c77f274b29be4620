"""The inertial side: attitude, velocity and their sensitivities in frozen body axes.

``ib0`` is the body frame frozen against inertial space at the first sample. One loop over the
samples integrates there the attitude ``C = C_b^ib0``, the specific force ``alpha``, and how
both answer to errors of the sensors; every form of in-flight alignment is made from the rows
that it leaves at the times asked for. Differences of rows do not depend on where the frame
was frozen, so that one pass serves every start of an alignment.

References
----------
.. [1] P. G. Savage, "Strapdown inertial navigation integration algorithm design", J.
   Guidance, Control, and Dynamics 21(1) and 21(2), 1998: coning and sculling with the
   previous interval.
.. [2] Y. Wu, X. Pan, "Velocity/position integration formula part I: application to in-flight
   coarse alignment", IEEE Trans. Aerospace and Electronic Systems 49(2), 2013.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sinstool.core.arrays import ArrayLike, BoolArray, FloatArray, IntArray
from sinstool.core.parts import kernel, part
from sinstool.core.quaternion_kernels import cross, dcm, product, row, to_unit
from sinstool.core.rotation import skew, to_dcm
from sinstool.core.streams import take_rows

# A row, and the head of the state, is: time, attitude, alpha, its integral, sensitivities.
_TIME = 0
_Q, _ALPHA, _XI = 1, 5, 8
_A, _G, _AG, _GG, _KA = 11, 20, 29, 38, 47
_FORCE, _RATE = 56, 59
_SHARE, _MIDDLE = 62, 63  # of the fix in its interval; whether force and rate are settled
ROW = 64
# Behind the sensitivities the state has the previous increments, their interval, and whether there
# was a sample at all.
_THETA, _VELOCITY, _INTERVAL, _BEGUN = 56, 59, 62, 63
STATE = 64


@dataclass(frozen=True)
class InertialRows:
    """The inertial side at given times; all in ``ib0`` unless said otherwise.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Seconds from the origin.
    q : ndarray, shape (n, 4)
        Takes a vector from ``b`` to ``ib0``.
    alpha : ndarray, shape (n, 3)
        Integral of ``C f``, m/s: eq. (4) of Qu et al. in its integrated form.
    xi : ndarray, shape (n, 3)
        Integral of alpha, m.
    gyro_bias_attitude : ndarray, shape (n, 3, 3)
        A, integral of ``C``: attitude error per gyro bias, s.
    gyro_bias_velocity : ndarray, shape (n, 3, 3)
        G, integral of ``[C f x] A``, m/s per rad/s; also minus what alpha gains per gyro bias.
        The integral of C is also what alpha gains per accelerometer bias.
    gyro_scale_attitude : ndarray, shape (n, 3, 3)
        Integral of ``C diag(omega)``, rad.
    gyro_scale_velocity : ndarray, shape (n, 3, 3)
        Integral of ``[C f x]`` times the previous one, m/s.
    accel_scale_velocity : ndarray, shape (n, 3, 3)
        Integral of ``C diag(f)``, m/s.
    force_b : ndarray, shape (n, 3)
        Specific force, body axes, between the middles of the intervals.
    swing : ndarray, shape (n, 3, 3)
        Rate of ``C``, ``C [omega x]``: velocity of the antenna against the IMU per lever arm, 1/s.
    """

    time_s: FloatArray
    q: FloatArray
    alpha: FloatArray
    xi: FloatArray
    gyro_bias_attitude: FloatArray
    gyro_bias_velocity: FloatArray
    gyro_scale_attitude: FloatArray
    gyro_scale_velocity: FloatArray
    accel_scale_velocity: FloatArray
    force_b: FloatArray
    swing: FloatArray

    def __len__(self) -> int:
        return len(self.time_s)

    def rows(self, which: slice | BoolArray | IntArray) -> InertialRows:
        """Rows by slice, mask or index array."""
        return take_rows(self, which)

    def append_to(self, rows: InertialRows) -> InertialRows:
        """These rows after others of the same frame."""
        joined = zip(vars(rows).values(), vars(self).values(), strict=True)
        return InertialRows(*(np.concatenate([before, after]) for before, after in joined))

    def at_antenna(self, lever_arm_b: ArrayLike) -> InertialRows:
        """Integrals of the specific force that the antenna feels.

        Parameters
        ----------
        lever_arm_b : array_like, shape (3,)
            From the IMU to the antenna, FRD, m.

        Returns
        -------
        InertialRows
            With ``alpha + C (omega x l)`` and ``xi + C l``; what they are at the first row
            cancels in differences.
        """
        lever = np.asarray(lever_arm_b, dtype=np.float64)
        if not np.any(lever):
            return self
        xi = self.xi + to_dcm(self.q) @ lever
        return replace(self, alpha=self.alpha + self.swing @ lever, xi=xi)

    @staticmethod
    def from_table(table: FloatArray) -> InertialRows:
        """Rows as the kernel writes them, shape (n, 64)."""

        def matrix(start: int) -> FloatArray:
            return table[:, start : start + 9].reshape(-1, 3, 3)

        return InertialRows(
            table[:, 0] * 1e-9,
            table[:, _Q:_ALPHA],
            table[:, _ALPHA:_XI],
            table[:, _XI:_A],
            matrix(_A),
            matrix(_G),
            matrix(_AG),
            matrix(_GG),
            matrix(_KA),
            table[:, _FORCE:_RATE],
            to_dcm(table[:, _Q:_ALPHA]) @ skew(table[:, _RATE:_SHARE]),
        )


def accumulate(
    time_ns: ArrayLike,
    delta_theta: ArrayLike,
    delta_velocity: ArrayLike,
    epochs_ns: ArrayLike,
    origin_ns: int,
) -> InertialRows:
    """Integrate the increments of a stretch; results at a list of times.

    Parameters
    ----------
    time_ns : array_like of int64, shape (n,)
        Ends of the intervals, increasing; a row that does not advance time is passed over.
    delta_theta, delta_velocity : array_like, shape (n, 3)
        Increments in body axes, rad and m/s. The very first sample only serves as the
        history of the second.
    epochs_ns : array_like of int64, shape (m,)
        When rows are asked for, not decreasing; those outside the samples get none.
    origin_ns : int
        From which `time_s` of the rows counts.

    Returns
    -------
    InertialRows
        Force and rate of a row in the second half of the last interval are extrapolated from
        before it.

    Raises
    ------
    ValueError
        If `epochs_ns` decreases.
    """
    time = np.ascontiguousarray(time_ns, dtype=np.int64) - origin_ns
    theta = np.ascontiguousarray(delta_theta, dtype=np.float64)
    velocity = np.ascontiguousarray(delta_velocity, dtype=np.float64)
    epochs = np.asarray(epochs_ns, dtype=np.int64) - origin_ns
    if epochs.ndim != 1 or np.any(np.diff(epochs) < 0):
        raise ValueError("Expected `epochs_ns` to be one increasing column.")
    state = np.zeros(STATE)
    state[_Q] = 1.0
    out = np.zeros((len(epochs), ROW))
    count = _accumulate_kernel(time, theta, velocity, epochs, state, out)
    return InertialRows.from_table(out[:count])


@part()
def _advance(src, dst, tx, ty, tz, vx, vy, vz, ox, oy, oz, ux, uy, uz, step):  # type: ignore[no-untyped-def]
    """State `src` over `step` seconds into `dst` (which may be `src`).

    t and v are the increments; o and u what coning and sculling with the previous interval add.
    """
    w, x, y, z = src[_Q], src[_Q + 1], src[_Q + 2], src[_Q + 3]
    c00, c01, c02, c10, c11, c12, c20, c21, c22 = dcm(w, x, y, z)

    # Velocity turned within the interval: exact for constant rate and force.
    turn = tx * tx + ty * ty + tz * tz
    once = 0.5 - turn / 24.0
    twice = 1.0 / 6.0 - turn / 120.0
    ax, ay, az = cross(tx, ty, tz, vx, vy, vz)
    bx, by, bz = cross(tx, ty, tz, ax, ay, az)
    bx = vx + once * ax + twice * bx + ux
    by = vy + once * ay + twice * by + uy
    bz = vz + once * az + twice * bz + uz
    dx = c00 * bx + c01 * by + c02 * bz
    dy = c10 * bx + c11 * by + c12 * bz
    dz = c20 * bx + c21 * by + c22 * bz

    px, py, pz = tx + ox, ty + oy, tz + oz
    square = px * px + py * py + pz * pz
    if square < 0.05:
        u = 0.25 * square  # Taylor in the squared half angle: what follows is below 1e-16
        cosine = 1.0 + u * (-0.5 + u * (1.0 / 24.0 + u * (-1.0 / 720.0 + u / 40320.0)))
        scale = 0.5 * (
            1.0 + u * (-1.0 / 6.0 + u * (1.0 / 120.0 + u * (-1.0 / 5040.0 + u / 362880.0)))
        )
    else:
        angle = np.sqrt(square)
        cosine = np.cos(0.5 * angle)
        scale = np.sin(0.5 * angle) / angle
    w, x, y, z = to_unit(*product(w, x, y, z, cosine, px * scale, py * scale, pz * scale))
    dst[_Q], dst[_Q + 1], dst[_Q + 2], dst[_Q + 3] = w, x, y, z

    dst[_XI] = src[_XI] + step * (src[_ALPHA] + 0.5 * dx)
    dst[_XI + 1] = src[_XI + 1] + step * (src[_ALPHA + 1] + 0.5 * dy)
    dst[_XI + 2] = src[_XI + 2] + step * (src[_ALPHA + 2] + 0.5 * dz)
    dst[_ALPHA] = src[_ALPHA] + dx
    dst[_ALPHA + 1] = src[_ALPHA + 1] + dy
    dst[_ALPHA + 2] = src[_ALPHA + 2] + dz

    # The mean of C over the interval.
    d00, d01, d02, d10, d11, d12, d20, d21, d22 = dcm(w, x, y, z)
    c00, c01, c02 = 0.5 * (c00 + d00), 0.5 * (c01 + d01), 0.5 * (c02 + d02)
    c10, c11, c12 = 0.5 * (c10 + d10), 0.5 * (c11 + d11), 0.5 * (c12 + d12)
    c20, c21, c22 = 0.5 * (c20 + d20), 0.5 * (c21 + d21), 0.5 * (c22 + d22)
    for j in range(3):
        if j == 0:
            m0, m1, m2, rate, force = c00, c10, c20, tx, vx
        elif j == 1:
            m0, m1, m2, rate, force = c01, c11, c21, ty, vy
        else:
            m0, m1, m2, rate, force = c02, c12, c22, tz, vz
        # Attitude per gyro bias, then per gyro scale; velocity follows from the middle of each.
        for at, error in ((_A + j, step), (_AG + j, rate)):
            h0 = src[at] + 0.5 * m0 * error
            h1 = src[at + 3] + 0.5 * m1 * error
            h2 = src[at + 6] + 0.5 * m2 * error
            dst[at + 9] = src[at + 9] + dy * h2 - dz * h1
            dst[at + 12] = src[at + 12] + dz * h0 - dx * h2
            dst[at + 15] = src[at + 15] + dx * h1 - dy * h0
            dst[at] = src[at] + m0 * error
            dst[at + 3] = src[at + 3] + m1 * error
            dst[at + 6] = src[at + 6] + m2 * error
        dst[_KA + j] = src[_KA + j] + m0 * force
        dst[_KA + 3 + j] = src[_KA + 3 + j] + m1 * force
        dst[_KA + 6 + j] = src[_KA + 6 + j] + m2 * force


@kernel()
def _accumulate_kernel(time, theta, velocity, epochs, state, out):  # type: ignore[no-untyped-def]
    """Integrate all samples; returns the number of rows written."""
    rows = 0
    complete = 0
    upcoming = 0
    count = epochs.shape[0]
    for k in range(time.shape[0]):
        now = float(time[k])
        if state[_BEGUN] == 0.0:
            while upcoming < count and epochs[upcoming] < time[k]:
                upcoming += 1
            while upcoming < count and epochs[upcoming] == time[k]:
                for i in range(out.shape[1]):
                    out[rows, i] = 0.0
                out[rows, _TIME] = now
                out[rows, _Q] = 1.0
                out[rows, _SHARE] = 1.0
                upcoming += 1
                rows += 1
            state[_BEGUN] = 1.0
            state[_TIME] = now
            for i in range(3):
                state[_THETA + i] = theta[k, i]
                state[_VELOCITY + i] = velocity[k, i]
            continue
        step = (now - state[_TIME]) * 1e-9
        if step <= 0.0:
            continue
        before = state[_INTERVAL]
        if before == 0.0:
            before = step
        # With unequal intervals the previous increments stand for the same duration.
        even = step / before
        tx, ty, tz = row(theta, k)
        vx, vy, vz = row(velocity, k)
        qx, qy, qz = state[_THETA], state[_THETA + 1], state[_THETA + 2]
        qx, qy, qz = qx * even, qy * even, qz * even
        rx, ry, rz = state[_VELOCITY], state[_VELOCITY + 1], state[_VELOCITY + 2]
        rx, ry, rz = rx * even, ry * even, rz * even
        # Distance between the middles of both intervals, and thus rates of change.
        apart = 0.5 * (before + step)

        while complete < rows:
            share = (out[complete, _SHARE] - 0.5) * before / apart
            for i in range(3):
                old = state[_VELOCITY + i] / before
                out[complete, _FORCE + i] = old + share * (velocity[k, i] / step - old)
                old = state[_THETA + i] / before
                out[complete, _RATE + i] = old + share * (theta[k, i] / step - old)
            out[complete, _MIDDLE] = 1.0
            complete += 1

        # Rate and force linear in time through both increments: coning, sculling, and parts.
        ratio = step / apart
        ox = (qy * tz - qz * ty) * ratio / 12.0
        oy = (qz * tx - qx * tz) * ratio / 12.0
        oz = (qx * ty - qy * tx) * ratio / 12.0
        ux = (qy * vz - qz * vy + ry * tz - rz * ty) * ratio / 12.0
        uy = (qz * vx - qx * vz + rz * tx - rx * tz) * ratio / 12.0
        uz = (qx * vy - qy * vx + rx * ty - ry * tx) * ratio / 12.0
        while upcoming < count and epochs[upcoming] <= time[k]:
            s = (float(epochs[upcoming]) - state[_TIME]) * 1e-9 / step
            bend = 0.5 * (s * s - s) * ratio
            cube = s * s * s
            target = out[rows]
            _advance(
                state, target,
                s * tx + bend * (tx - qx), s * ty + bend * (ty - qy), s * tz + bend * (tz - qz),
                s * vx + bend * (vx - rx), s * vy + bend * (vy - ry), s * vz + bend * (vz - rz),
                cube * ox, cube * oy, cube * oz, cube * ux, cube * uy, cube * uz,
                s * step,
            )  # fmt: skip
            target[_TIME] = float(epochs[upcoming])
            target[_SHARE] = s
            share = (s - 0.5) * ratio
            for i in range(3):
                new = velocity[k, i] / step
                target[_FORCE + i] = new + share * (new - state[_VELOCITY + i] / before)
                new = theta[k, i] / step
                target[_RATE + i] = new + share * (new - state[_THETA + i] / before)
            target[_MIDDLE] = 0.0
            if s <= 0.5:
                target[_MIDDLE] = 1.0
                complete += 1
            upcoming += 1
            rows += 1
        _advance(state, state, tx, ty, tz, vx, vy, vz, ox, oy, oz, ux, uy, uz, step)
        state[_TIME] = now
        state[_INTERVAL] = step
        for i in range(3):
            state[_THETA + i] = theta[k, i]
            state[_VELOCITY + i] = velocity[k, i]
    return rows
