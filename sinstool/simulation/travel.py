"""A vehicle that moves over the Earth, from its velocity and Euler angles as functions of time.

Velocity and attitude are given in axes ``w`` that start as NED turned by an azimuth and keep
their azimuth: their turn against the Earth has no component about down. So nothing is special
at a pole or the date line; only the answers are in NED. Position follows from the velocity,
and the samples of the IMU from

    omega_ib_b = omega_wb_b + C_bw (omega_ie_w + omega_ew_w),
    f_b = C_bw (dv_w/dt + (2 omega_ie_w + omega_ew_w) x v_w - g_w)

at the nodes of Gauss and Legendre within every interval: exact to rounding for all that changes
little within an interval (five nodes: below 1e-12 of a sinusoid that turns 1 rad in it).

References
----------
.. [1] P. D. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
   Systems", 2nd ed., 2013, sections 2.4 and 5.3.5 (wander azimuth).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import atan2, cos, hypot, sin, sqrt

import numpy as np

from sinstool.core import earth, rotation
from sinstool.core.arrays import ArrayLike, FloatArray, IntArray
from sinstool.core.gravity import normal_gravity
from sinstool.core.parts import njit
from sinstool.core.quaternion_kernels import cross
from sinstool.simulation.truth import ImuTruth, Trajectory, check_times

COLUMNS = 12
"""Of a motion: velocity, its derivative, roll-pitch-yaw, their derivatives; see Motion."""

Motion = Callable[[FloatArray], FloatArray]
"""Seconds since the start, shape (n,), into shape (n, COLUMNS), all in ``w``: velocity (north,
east, down; m/s), acceleration (m/s^2), roll, pitch and yaw (rad) and their rates (rad/s)."""

_NODES = 5
_ROWS = 8192  # intervals at a time


class Levels:
    """A quantity that changes smoothly between levels, four times differentiable.

    Parameters
    ----------
    first : float
        Level before the first change.
    changes : sequence of tuple of 3 float
        When each change begins, s, how long it takes, s, and the level it leads to. In order;
        no two overlap.

    Raises
    ------
    ValueError
        If changes overlap or take no time.
    """

    def __init__(self, first: float, changes: Sequence[tuple[float, float, float]]) -> None:
        table = np.array([(-np.inf, 1.0, first), *changes], dtype=np.float64)
        self._start, self._duration, self._level = table.T
        self._start[0] = min(0.0, self._start[1] if len(changes) else 0.0) - 1.0
        self._before = np.concatenate([[first], self._level[:-1]])
        ends = self._start + self._duration
        if np.any(self._duration <= 0.0) or np.any(self._start[1:] < ends[:-1]):
            raise ValueError("Expected changes in order that do not overlap.")
        passed = np.diff(self._start) * self._before[:-1]
        step = self._level - self._before
        risen = (np.diff(self._start) - 0.5 * self._duration[:-1]) * step[:-1]
        self._total = np.concatenate([[0.0], np.cumsum(passed + risen)])
        self._step = step
        self._zero = 0.0
        self._zero = float(self.integral(np.zeros(1))[0])

    def _at(self, t: FloatArray) -> tuple[IntArray, FloatArray]:
        i = np.maximum(np.searchsorted(self._start, t, side="right") - 1, 0)
        return i, np.clip((t - self._start[i]) / self._duration[i], 0.0, 1.0)

    def value(self, t: FloatArray) -> FloatArray:
        """Level at times."""
        i, u = self._at(t)
        s = u**5 * (126.0 + u * (-420.0 + u * (540.0 + u * (-315.0 + u * 70.0))))
        # from the nearer end, so that a level reached is that level to the last bit
        low = self._before[i] + self._step[i] * s
        return np.asarray(np.where(u < 1.0, low, self._level[i]))

    def slope(self, t: FloatArray) -> FloatArray:
        """First derivative."""
        i, u = self._at(t)
        return np.asarray(self._step[i] / self._duration[i] * 630.0 * (u * (1.0 - u)) ** 4)

    def curvature(self, t: FloatArray) -> FloatArray:
        """Second derivative."""
        i, u = self._at(t)
        bend = 2520.0 * (u * (1.0 - u)) ** 3 * (1.0 - 2.0 * u)
        return np.asarray(self._step[i] / self._duration[i] ** 2 * bend)

    def integral(self, t: FloatArray) -> FloatArray:
        """Integral from time 0."""
        i, u = self._at(t)
        passed = t - self._start[i]
        risen = u**6 * (21.0 + u * (-60.0 + u * (67.5 + u * (-35.0 + u * 7.0))))
        late = np.maximum(passed - self._duration[i], 0.0)
        total = self._total[i] + self._before[i] * passed
        total += self._step[i] * (self._duration[i] * risen + late)
        return np.asarray(total - self._zero)


def travel(
    motion: Motion,
    time_ns: ArrayLike,
    latitude: float,
    longitude: float,
    height: float,
    azimuth: float = 0.0,
) -> Trajectory:
    """Exact samples and truth of a motion.

    Parameters
    ----------
    motion : Motion
        Also evaluated in the interval before the start.
    time_ns : array_like of int64, shape (n,)
        Instants, increasing, two at least.
    latitude, longitude : float
        Of the first instant, WGS-84, rad.
    height : float
        Ellipsoidal, m.
    azimuth : float, optional
        Of the first axis of ``w`` at the first instant, from north, rad.

    Raises
    ------
    ValueError
        If time does not increase.
    """
    times, interval = check_times(time_ns)
    n = len(times)
    end = (times - times[0]) * 1e-9
    at, weight = np.polynomial.legendre.leggauss(_NODES)
    node, weight = 0.5 * (1.0 + at), 0.5 * weight
    inner = _collocation(node)
    q_en = rotation.multiply(
        [np.cos(0.5 * longitude), 0.0, 0.0, np.sin(0.5 * longitude)],
        rotation.exp([0.0, -latitude - 0.5 * np.pi, 0.0]),
    )
    place = np.empty(5)
    place[:4] = rotation.multiply(q_en, rotation.exp([0.0, 0.0, azimuth]))
    place[4] = height
    out = np.empty((n, 22))
    # Back by one interval, so that row 0 too is the end of one
    back = np.append(-interval[0] * node, -interval[0])
    _travel_kernel(motion(back)[np.newaxis], -interval[:1], inner, weight, place, np.empty((1, 22)))
    for begin in range(0, n, _ROWS):
        rows = slice(begin, begin + _ROWS)
        t = np.empty((len(end[rows]), _NODES + 1))
        t[:, :-1] = end[rows, None] - interval[rows, None] * (1.0 - node)
        t[:, -1] = end[rows]
        states = np.ascontiguousarray(motion(t.ravel()).reshape(*t.shape, COLUMNS))
        _travel_kernel(states, interval[rows], inner, weight, place, out[rows])
    mean_rate = out[:, 3:6]
    return Trajectory(
        imu=ImuTruth(
            time_ns=times,
            interval=interval,
            gyro_rate=out[:, 0:3].copy(),
            gyro_mean_rate=mean_rate.copy(),
            gyro_increment=mean_rate * interval[:, None],
            specific_force=out[:, 6:9].copy(),
            mean_specific_force=out[:, 9:12].copy(),
            q_nb=out[:, 18:22].copy(),
        ),
        latitude=out[:, 12].copy(),
        longitude=out[:, 13].copy(),
        height=out[:, 14].copy(),
        velocity_n=out[:, 15:18].copy(),
    )


def _collocation(node: FloatArray) -> FloatArray:
    """Weights of the values at the nodes for the integral from 0 to each node."""
    powers = np.arange(len(node))
    values = node[np.newaxis, :] ** powers[:, np.newaxis]
    integrals = node[np.newaxis, :] ** (powers + 1)[:, np.newaxis] / (powers + 1)[:, np.newaxis]
    return np.ascontiguousarray(np.linalg.solve(values, integrals).T)


@njit(cache=True, nogil=True)
def _turn(p1: float, p2: float, p3: float, h: float, v1: float, v2: float) -> tuple[float, float]:
    """Rate of ``w`` against the Earth about its first two axes; `p` is the Earth's axis in it."""
    square = 1.0 - earth.ECCENTRICITY_SQUARED * p3 * p3
    transverse = earth.SEMI_MAJOR_AXIS / sqrt(square)
    rn = transverse + h
    rm = transverse * (1.0 - earth.ECCENTRICITY_SQUARED) / square + h
    # 1/rm - 1/rn over the squared cosine of latitude: no direction of north is needed
    more = transverse * earth.ECCENTRICITY_SQUARED / square / (rn * rm) * (v1 * p1 + v2 * p2)
    return v2 / rn + more * p2, -(v1 / rn + more * p1)


@njit(cache=True, nogil=True)
def _sense(
    p1: float, p2: float, p3: float, h: float, r1: float, r2: float, state: FloatArray
) -> tuple[float, float, float, float, float, float]:
    """Angular rate and specific force in ``b``."""
    sin2 = p3 * p3
    g3 = normal_gravity(sin2, sqrt(1.0 - earth.ECCENTRICITY_SQUARED * sin2), h)
    # over the cosine of latitude; p3 is minus its sine
    north = -2.0 * earth.NORTH_GRAVITY_PER_HEIGHT * h * p3
    o1 = earth.EARTH_RATE * p1
    o2 = earth.EARTH_RATE * p2
    o3 = earth.EARTH_RATE * p3
    c1, c2, c3 = cross(2.0 * o1 + r1, 2.0 * o2 + r2, 2.0 * o3, state[0], state[1], state[2])
    f1 = state[3] + c1 - north * p1
    f2 = state[4] + c2 - north * p2
    f3 = state[5] + c3 - g3
    o1 += r1
    o2 += r2
    sr, cr = sin(state[6]), cos(state[6])
    sp, cp = sin(state[7]), cos(state[7])
    sy, cy = sin(state[8]), cos(state[8])
    c11, c12, c13 = cp * cy, cp * sy, -sp
    c21, c22, c23 = sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp
    c31, c32, c33 = cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp
    return (
        state[9] - sp * state[11] + c11 * o1 + c12 * o2 + c13 * o3,
        cr * state[10] + sr * cp * state[11] + c21 * o1 + c22 * o2 + c23 * o3,
        -sr * state[10] + cr * cp * state[11] + c31 * o1 + c32 * o2 + c33 * o3,
        c11 * f1 + c12 * f2 + c13 * f3,
        c21 * f1 + c22 * f2 + c23 * f3,
        c31 * f1 + c32 * f2 + c33 * f3,
    )


@njit(cache=True, nogil=True)
def _travel_kernel(
    states: FloatArray,
    interval: FloatArray,
    inner: FloatArray,
    weight: FloatArray,
    place: FloatArray,
    out: FloatArray,
) -> None:
    """Integrate positions and samples; `place` is q_ew and height, carried along."""
    nodes = weight.shape[0]
    turn = np.zeros((nodes, 2))
    for k in range(out.shape[0]):
        dt = interval[k]
        w, x, y, z, h = place[0], place[1], place[2], place[3], place[4]
        # Earth's axis in w at the start
        p1 = 2.0 * (x * z - w * y)
        p2 = 2.0 * (y * z + w * x)
        p3 = w * w - x * x - y * y + z * z
        for j in range(nodes):
            turn[j, 0], turn[j, 1] = _turn(p1, p2, p3, h, states[k, j, 0], states[k, j, 1])
        s0 = s1 = s2 = s3 = s4 = s5 = 0.0
        # The turn depends on the place by 1e-6 of itself: the second round is for long intervals.
        for rounds in range(2):
            for j in range(nodes):
                a1 = 0.0
                a2 = 0.0
                hj = h
                for i in range(nodes):
                    a1 += inner[j, i] * turn[i, 0]
                    a2 += inner[j, i] * turn[i, 1]
                    hj -= dt * inner[j, i] * states[k, i, 2]
                a1 *= dt
                a2 *= dt
                # exp(-a x) p to second order
                d1 = -a2 * p3
                d2 = a1 * p3
                d3 = a2 * p1 - a1 * p2
                n1 = p1 + d1 - 0.5 * a2 * d3
                n2 = p2 + d2 + 0.5 * a1 * d3
                n3 = p3 + d3 + 0.5 * (a2 * d1 - a1 * d2)
                turn[j, 0], turn[j, 1] = _turn(n1, n2, n3, hj, states[k, j, 0], states[k, j, 1])
                if rounds == 1:
                    o1, o2, o3, f1, f2, f3 = _sense(
                        n1, n2, n3, hj, turn[j, 0], turn[j, 1], states[k, j]
                    )
                    s0 += weight[j] * o1
                    s1 += weight[j] * o2
                    s2 += weight[j] * o3
                    s3 += weight[j] * f1
                    s4 += weight[j] * f2
                    s5 += weight[j] * f3
        a1 = 0.0
        a2 = 0.0
        for j in range(nodes):
            a1 += 0.5 * dt * weight[j] * turn[j, 0]
            a2 += 0.5 * dt * weight[j] * turn[j, 1]
            h -= dt * weight[j] * states[k, j, 2]
        square = a1 * a1 + a2 * a2
        c = 1.0 - 0.5 * square * (1.0 - square / 12.0)
        f = 1.0 - square / 6.0
        a1 *= f
        a2 *= f
        w, x, y, z = (
            w * c - x * a1 - y * a2,
            x * c + w * a1 - z * a2,
            y * c + w * a2 + z * a1,
            z * c + x * a2 - y * a1,
        )
        f = 1.0 / sqrt(w * w + x * x + y * y + z * z)
        w, x, y, z = w * f, x * f, y * f, z * f
        place[0], place[1], place[2], place[3], place[4] = w, x, y, z, h
        p1 = 2.0 * (x * z - w * y)
        p2 = 2.0 * (y * z + w * x)
        p3 = w * w - x * x - y * y + z * z
        v1 = states[k, nodes, 0]
        v2 = states[k, nodes, 1]
        r1, r2 = _turn(p1, p2, p3, h, v1, v2)
        o1, o2, o3, f1, f2, f3 = _sense(p1, p2, p3, h, r1, r2, states[k, nodes])
        out[k, 0], out[k, 1], out[k, 2] = o1, o2, o3
        out[k, 3], out[k, 4], out[k, 5] = s0, s1, s2
        out[k, 6], out[k, 7], out[k, 8] = f1, f2, f3
        out[k, 9], out[k, 10], out[k, 11] = s3, s4, s5
        out[k, 12] = atan2(-p3, hypot(p1, p2))
        out[k, 13] = atan2(-2.0 * (y * z - w * x), -2.0 * (x * z + w * y))
        out[k, 14] = h
        # Heading of the first axis of w
        heading = atan2(-p2, p1)
        ch, sh = cos(heading), sin(heading)
        out[k, 15] = ch * v1 - sh * v2
        out[k, 16] = sh * v1 + ch * v2
        out[k, 17] = states[k, nodes, 2]
        heading = 0.5 * (heading + states[k, nodes, 8])
        pitch, roll = 0.5 * states[k, nodes, 7], 0.5 * states[k, nodes, 6]
        cy, sy = cos(heading), sin(heading)
        cp, sp = cos(pitch), sin(pitch)
        cr, sr = cos(roll), sin(roll)
        out[k, 18] = cy * cp * cr + sy * sp * sr
        out[k, 19] = cy * cp * sr - sy * sp * cr
        out[k, 20] = cy * sp * cr + sy * cp * sr
        out[k, 21] = sy * cp * cr - cy * sp * sr
