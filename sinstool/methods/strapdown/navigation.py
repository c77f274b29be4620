"""Attitude, velocity and position over the Earth from rotation vectors and velocity increments.

Local-level mechanisation in NED on the WGS-84 ellipsoid with Earth rate, transport rate and
normal gravity with its change with height; [1]_ and [2]_. One update works in axes that start
as NED and then keep their azimuth: their transport rate has no component about down, so nothing
becomes singular at a pole. At its end the position follows from the turned up vector, and velocity
and attitude are turned by the angle between those axes and NED there. That angle is finite
everywhere, so a flight over a pole is handled correctly. Exactly at a pole, north is defined by the
longitude.

Order of an update, all rates at its middle:

1. specific force into ``n``: ``(I - 1/2 zeta x) C_nb dv_b``, ``zeta`` the turn of ``n``;
2. velocity with gravity and Coriolis terms at half the update, extrapolated from its start;
3. position and ``zeta`` by the trapezoid of velocities;
4. attitude ``q_nb <- exp(-zeta) q_nb exp(phi)``.

The vertical channel is not damped here, so an error in height grows as ``cosh(sqrt(2 g / R) t)``; a
damping network may correct the state between updates.

References
----------
.. [1] P. G. Savage, "Strapdown inertial navigation integration algorithm design part 2:
   velocity and position algorithms", J. Guidance, Control, and Dynamics 21(2), 1998, 208-221.
.. [2] P. D. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
   Systems", 2nd ed., 2013, section 5.4.
"""

from __future__ import annotations

from math import atan2, cos, hypot, pi, sin, sqrt

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray
from sinstool.core.earth import (
    EARTH_RATE,
    ECCENTRICITY_SQUARED,
    NORTH_GRAVITY_PER_HEIGHT,
    SEMI_MAJOR_AXIS,
)
from sinstool.core.gravity import normal_gravity
from sinstool.core.parts import kernel, part
from sinstool.core.quaternion_kernels import (
    EXACT,
    cross,
    increment_quaternion,
    product,
    to_unit,
    wrapped_angle,
)
from sinstool.core.rotation import normalise

# Indices of a state, a float64 array of SIZE numbers
LATITUDE, LONGITUDE, HEIGHT = 0, 1, 2
V_NORTH, V_EAST, V_DOWN = 3, 4, 5
Q_W, Q_X, Q_Y, Q_Z = 6, 7, 8, 9
SIZE = 10


# Largest change of longitude, and square of the turn over the Earth, of one update for which the
# short series are exact in float64: 640 m, and as near a pole as 10 000 times the way of an update.
_SMALL_TURN = 1e-4
_SMALL_WAY = 1e-8


def initial_state(
    latitude: float, longitude: float, height: float, velocity_n: ArrayLike, q_nb: ArrayLike
) -> FloatArray:
    """State at the start of a navigation.

    Parameters
    ----------
    latitude, longitude : float
        WGS-84, rad.
    height : float
        Ellipsoidal, m.
    velocity_n : array_like, shape (3,)
        Against the Earth in NED, m/s.
    q_nb : array_like, shape (4,)
        Attitude; normalised here.

    Returns
    -------
    ndarray, shape (SIZE,)
        For :func:`step`.

    Raises
    ------
    ValueError
        If a shape is wrong, a number is not finite, the latitude is beyond a pole or the
        quaternion is zero.
    """
    velocity = np.asarray(velocity_n, dtype=np.float64)
    attitude = normalise(q_nb)
    if velocity.shape != (3,) or attitude.shape != (4,):
        raise ValueError(f"Expected shapes (3,) and (4,), got {velocity.shape}, {attitude.shape}.")
    state = np.concatenate([[latitude, longitude, height], velocity, attitude])
    if not np.all(np.isfinite(state)):
        raise ValueError("Found a number that is not finite in the initial state.")
    if abs(latitude) > 0.5 * pi:
        raise ValueError(f"Expected `latitude` within a quarter turn, got {latitude} rad.")
    state[LONGITUDE] = wrapped_angle(float(longitude))
    return state


@part()
def step(
    state: FloatArray,
    px: float,
    py: float,
    pz: float,
    ux: float,
    uy: float,
    uz: float,
    dt: float,
    order: int,
) -> None:
    """Advance a state by one update; scalars only, to be called from larger kernels.

    Parameters
    ----------
    state : ndarray, shape (SIZE,)
        Advanced in place. It holds no history, so a filter may correct it between updates.
    px, py, pz : float
        Rotation vector of the body against inertial space, in ``b``, rad.
    ux, uy, uz : float
        Integral of the specific force in the body axes of the update's start, m/s; see
        :mod:`sinstool.methods.strapdown.velocity`.
    dt : float
        Duration, s.
    order : int
        0 for the exact quaternion, 1 to 4 for Picard's.
    """
    lat = state[LATITUDE]
    h = state[HEIGHT]
    vn, ve, vd = state[V_NORTH], state[V_EAST], state[V_DOWN]
    w, x, y, z = state[Q_W], state[Q_X], state[Q_Y], state[Q_Z]
    s = sin(lat)
    c = cos(lat)
    half = 0.5 * dt

    # Earth and gravity at the middle of the update
    north = half * vn / SEMI_MAJOR_AXIS
    sm = s + c * north
    cm = c - s * north
    hm = h - half * vd
    s2 = sm * sm
    # The radii multiplied by the root, so that three divisions need not wait for each other
    square = 1.0 - ECCENTRICITY_SQUARED * s2
    root = sqrt(square)
    rn = root / (SEMI_MAJOR_AXIS + hm * root)
    rm = square * root / (SEMI_MAJOR_AXIS * (1.0 - ECCENTRICITY_SQUARED) + hm * square * root)
    gd = normal_gravity(s2, root, hm)
    gn = 2.0 * NORTH_GRAVITY_PER_HEIGHT * hm * sm * cm
    # East as the axes keep their azimuth: they turn about up against those of the meridian.
    on = EARTH_RATE * cm
    oe = -EARTH_RATE * s * (half * ve * rn)
    od = -EARTH_RATE * sm

    # C_nb dv as u + 2 w (q x u) + 2 q x (q x u)
    cx, cy, cz = cross(x, y, z, ux, uy, uz)
    tx, ty, tz = 2.0 * cx, 2.0 * cy, 2.0 * cz
    cx, cy, cz = cross(x, y, z, tx, ty, tz)
    fn, fe, fd = ux + w * tx + cx, uy + w * ty + cy, uz + w * tz + cz

    # Velocity halfway, by the rates at the start ...
    an = 2.0 * on + ve * rn
    ae = 2.0 * oe - vn * rm
    ad = 2.0 * od
    mn = vn + 0.5 * fn + half * (gn - (ae * vd - ad * ve))
    me = ve + 0.5 * fe - half * (ad * vn - an * vd)
    md = vd + 0.5 * fd + half * (gd - (an * ve - ae * vn))
    # ... and at the end, by the rates halfway
    tn = me * rn
    te = -mn * rm
    an = 2.0 * on + tn
    ae = 2.0 * oe + te
    zn = half * (on + tn)
    ze = half * (oe + te)
    zd = half * od
    new_vn = vn + fn - (ze * fd - zd * fe) + dt * (gn - (ae * md - ad * me))
    new_ve = ve + fe - (zd * fn - zn * fd) - dt * (ad * mn - an * md)
    new_vd = vd + fd - (zn * fe - ze * fn) + dt * (gd - (an * me - ae * mn))

    # Position: the turn over the Earth of axes that keep their azimuth
    tn = half * (ve + new_ve) * rn
    te = -half * (vn + new_vn) * rm
    way = tn * tn + te * te
    up_x = c * (1.0 - 0.5 * way) + s * te
    if abs(tn) < _SMALL_TURN * up_x and way < _SMALL_WAY:
        f = 1.0 - way / 6.0
        up_n = -te * f
        up_e = tn * f
        up_x = c * (1.0 - 0.5 * way) - s * up_n
        t = up_e / up_x
        t2 = t * t
        turn = t - t * t2 / 3.0
        sin_lat = up_n - 0.5 * s * up_e * t * (1.0 - 0.25 * t2)
        new_lat = lat + sin_lat + sin_lat * sin_lat * sin_lat / 6.0
        # Heading that the north axis has got, from its east component
        sin_a = (s * (1.0 - 0.5 * te * te) + up_n * c) * t * (1.0 - 0.5 * t2) + 0.5 * tn * te
        cos_a = 1.0 - 0.5 * sin_a * sin_a
        half_w = 1.0 - 0.125 * sin_a * sin_a
        half_z = 0.5 * sin_a * (1.0 + 0.125 * sin_a * sin_a)
    else:
        new_lat, turn, sin_a, cos_a = _far_turn(s, c, tn, te, way)
        a = 0.5 * atan2(sin_a, cos_a)
        half_w = cos(a)
        half_z = sin(a)
    state[LATITUDE] = new_lat
    state[LONGITUDE] = wrapped_angle(state[LONGITUDE] + turn)
    state[HEIGHT] = h - half * (vd + new_vd)
    state[V_NORTH] = cos_a * new_vn - sin_a * new_ve
    state[V_EAST] = sin_a * new_vn + cos_a * new_ve
    state[V_DOWN] = new_vd

    # Attitude in axes that keep their azimuth, then about down to NED
    qw, qx, qy, qz = increment_quaternion(px, py, pz, order)
    bw, bx, by, bz = product(w, x, y, z, qw, qx, qy, qz)
    zn = -0.5 * (dt * on + tn)
    ze = -0.5 * (dt * oe + te)
    zd = -0.5 * dt * od
    square = zn * zn + ze * ze + zd * zd  # of half the angle
    f = 1.0 - square / 6.0 * (1.0 - 0.05 * square)
    zw = 1.0 - 0.5 * square * (1.0 - square / 12.0)
    zn *= f
    ze *= f
    zd *= f
    ew = half_w * zw - half_z * zd
    ex = half_w * zn - half_z * ze
    ey = half_w * ze + half_z * zn
    ez = half_w * zd + half_z * zw
    w, x, y, z = product(ew, ex, ey, ez, bw, bx, by, bz)
    state[Q_W], state[Q_X], state[Q_Y], state[Q_Z] = to_unit(w, x, y, z)


@part()
def advance(
    state: FloatArray, phi: FloatArray, dv: FloatArray, dt: FloatArray, k: int, order: int
) -> None:
    """Advance a state by update `k` of a block; see :func:`step`.

    Parameters
    ----------
    state : ndarray, shape (SIZE,)
        Advanced in place.
    phi, dv : ndarray, shape (n, 3)
        Rotation vectors, rad, and velocity increments, m/s.
    dt : ndarray, shape (n,)
        s.
    """
    step(state, phi[k, 0], phi[k, 1], phi[k, 2], dv[k, 0], dv[k, 1], dv[k, 2], dt[k], order)


@part()
def _far_turn(
    s: float, c: float, tn: float, te: float, way: float
) -> tuple[float, float, float, float]:
    """Position after a turn of any size, and the heading of the axes that were NED.

    `s`, `c` are of the latitude before, `tn`, `te` the turn and `way` its square. Returned are
    the latitude after, the change of longitude, and sine and cosine of the heading of the axis
    that was north.
    """
    angle = sqrt(way)
    if angle < 1e-4:
        f = 1.0 - way / 6.0
        k = 0.5 - way / 24.0
    else:
        f = sin(angle) / angle
        k = 2.0 * (sin(0.5 * angle) / angle) ** 2
    up_n = -te * f
    up_e = tn * f
    # Up in the axes of the meridian before: outward in the equator's plane, east, polar
    ca = 1.0 - k * way
    up_x = ca * c - up_n * s
    up_z = ca * s + up_n * c
    turn = atan2(up_e, up_x)
    sin_turn = sin(turn)
    cos_turn = cos(turn)
    mixed = k * tn * te
    sin_a = (s * (1.0 - k * te * te) + c * up_n) * sin_turn + mixed * cos_turn
    cos_a = (s * mixed + c * up_e) * sin_turn + (1.0 - k * tn * tn) * cos_turn
    return atan2(up_z, hypot(up_x, up_e)), turn, sin_a, cos_a


ROUNDS = 5
"""Each reduces the error by a factor of about the rotation of the body in one update, rad."""


def navigate_backward(
    state: FloatArray, phi: FloatArray, dv: FloatArray, dt: FloatArray, out: FloatArray
) -> None:
    """Undo the updates of a block, the last first: the states before a given one.

    An update of :func:`step` is undone by finding the state that it takes to the later one. The
    step is the identity but for terms of first order in its duration, so that the fixed point
    converges by that factor at each round.

    Parameters
    ----------
    state : ndarray, shape (SIZE,)
        At the end of the block; replaced by the state at its start.
    phi, dv : ndarray, shape (n, 3)
        Rotation vectors, rad, and velocity increments, m/s, with biases removed.
    dt : ndarray, shape (n,)
        s.
    out : ndarray, shape (n, SIZE)
        Gets the state at the **start** of each update.
    """
    _undo(state, phi, dv, dt, out, np.empty(SIZE))


@kernel()
def _undo(
    state: FloatArray,
    phi: FloatArray,
    dv: FloatArray,
    dt: FloatArray,
    out: FloatArray,
    trial: FloatArray,
) -> None:
    for k in range(out.shape[0] - 1, -1, -1):
        before = out[k]
        for i in range(SIZE):
            before[i] = state[i]
        for _ in range(ROUNDS):
            for i in range(SIZE):
                trial[i] = before[i]
            advance(trial, phi, dv, dt, k, EXACT)
            for i in range(V_DOWN + 1):
                before[i] += state[i] - trial[i]
            before[LONGITUDE] = wrapped_angle(before[LONGITUDE])
            before[LATITUDE] = min(max(before[LATITUDE], -0.5 * np.pi), 0.5 * np.pi)
            # the turn of n that is left, from the left
            w, x, y, z = state[Q_W], state[Q_X], state[Q_Y], state[Q_Z]
            ew, ex, ey, ez = product(w, x, y, z, trial[Q_W], -trial[Q_X], -trial[Q_Y], -trial[Q_Z])
            w, x, y, z = before[Q_W], before[Q_X], before[Q_Y], before[Q_Z]
            w, x, y, z = to_unit(*product(ew, ex, ey, ez, w, x, y, z))
            before[Q_W], before[Q_X], before[Q_Y], before[Q_Z] = w, x, y, z
        for i in range(SIZE):
            state[i] = before[i]
