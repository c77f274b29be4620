"""Rest, wheels and axles that cannot slide as measurements of an INS/GNSS filter.

With v the axes of the vehicle (forward, right, down, at the middle of its unsteered axle),
``C_vb`` from body axes to them, r and q its yaw and pitch rate, V its speed forward and l how far
the IMU is ahead of the axle, the velocity in them is ``v_v = C_vb C_bn v`` at the IMU, and

    lateral    0 = v_v,y - r l + kappa r V^2 + noise
    vertical   0 = v_v,z + q l - k_z a_x V + noise
    wheels     u (1 + s) = v_v,x + noise
    rest       0 = v + noise,   C_bn omega_ie = omega + noise

with the sideslip kappa of the axle per lateral acceleration, the squat k_z of the body per forward
acceleration a_x, and the scale s of the wheels' speed u. Errors as in
:mod:`~sinstool.methods.ins_gnss.states`: ``C_vb = (I + [mu x]) C_vb used``, so that

    d v_v = C_vb C_bn (dv - v x psi) + v_v x mu.

What a tyre does lasts for seconds: noise is given as a power density, ``sigma^2 1 s`` of the slow
error, and a constraint's variance is that over the time since the one before. So it says no more
than the slow error allows, at any rate.

References
----------
.. [1] G. Dissanayake, S. Sukkarieh, E. Nebot, H. Durrant-Whyte, "The aiding of a low-cost strapdown
   inertial measurement unit using vehicle model constraints for land vehicle applications", IEEE
   Trans. Robotics and Automation 17(5), 2001, 731-747.
.. [2] P. D. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
   Systems", 2nd ed., 2013, chapter 15.
"""

from __future__ import annotations

from math import cos, sin, sqrt

import numpy as np

from sinstool.core import earth
from sinstool.core.arrays import FloatArray
from sinstool.core.parts import part
from sinstool.core.quaternion_kernels import cross, dcm
from sinstool.methods.ins_gnss import instants, layout, states, update
from sinstool.methods.ins_gnss.layout import Memory, Model
from sinstool.methods.strapdown.navigation import LATITUDE, Q_W, V_NORTH

LOW_PASS = 0.1  # s, of rate and force: vibration is not the vehicle's motion
ROLLING = 1.0  # m/s, from which on a vehicle is held not to slide
# A filter that is so fast, m/s and sigmas, is not at rest, whatever the IMU feels
MOVES, MOVES_SIGMAS = 0.5, 3.0
GATE = 4.0  # sigmas, of a single row: a skid, a pothole
LONGEST = 2.0  # s since the constraint before: noise of a slower one is no smaller
# Wheels slip as they pull and brake: so much of the speed beyond this acceleration, m/s^2
PULLS, PULL_SLIP = 1.0, 0.01
NOT_USED = 1e12


@part()
def follow(
    m: Memory,
    d: float,
    px: float,
    py: float,
    pz: float,
    ux: float,
    uy: float,
    uz: float,
) -> None:
    """Low-pass of rate and force over an update with its increments.

    Parameters
    ----------
    d : float
        s.
    px, py, pz, ux, uy, uz : float
        Rotation vector and velocity increment, sensor errors taken off, rad and m/s.
    """
    share = min(d / LOW_PASS, 1.0)
    m.rolling[0] += share * (px / d - m.rolling[0])
    m.rolling[1] += share * (py / d - m.rolling[1])
    m.rolling[2] += share * (pz / d - m.rolling[2])
    m.rolling[3] += share * (ux / d - m.rolling[3])
    m.rolling[4] += share * (uy / d - m.rolling[4])
    m.rolling[5] += share * (uz / d - m.rolling[5])
    # As measured: the bias may change before a constraint is made of it
    e = m.sensors
    m.turned[0] += px + e[0] * d
    m.turned[1] += py + e[1] * d
    m.turned[2] += pz + e[2] * d
    m.turned[3] += d


@part()
def constrain(m: Memory, model: Model, stored: FloatArray, grid: FloatArray) -> None:
    """Use the constraints that hold now, all that are due at once.

    Parameters
    ----------
    m, model, stored
        See :func:`~sinstool.methods.ins_gnss.instants.open_instant`.
    grid : ndarray, shape (g, 4)
        Columns by the names ``G_...`` of :mod:`~sinstool.methods.ins_gnss.layout`.
    """
    now = m.now
    since = now - m.constrained_at
    m.constrained_at = now
    place = (now - model.vehicle[layout.V_ORIGIN]) / model.vehicle[layout.V_STEP]
    k = int(place)
    m.shaken = 0.0
    if place >= 0.0 and k < grid.shape[0] - 1 and m.in_gap == 0.0:
        weight = 1.0 / min(since, LONGEST)
        m.shaken = grid[k, layout.G_STANDS]
        if grid[k, layout.G_REST] > 0.0 and grid[k + 1, layout.G_REST] > 0.0:
            if grid[k, layout.G_REST] > 1.0 or not _moves(m):
                instants.open_instant(m, model, stored)
                _rest(m, model, weight)
        elif model.where[states.I_LAND_VEHICLE] >= 0 and grid[k, layout.G_ROLLS] > 0.0:
            share = place - k
            speed = (1.0 - share) * grid[k, layout.G_WHEEL] + share * grid[k + 1, layout.G_WHEEL]
            instants.open_instant(m, model, stored)
            _roll(m, model, weight, speed)
    for i in range(4):
        m.turned[i] = 0.0


@part()
def _moves(m: Memory) -> bool:
    """Whether the filter's own speed denies a rest."""
    square, variance = 0.0, 0.0
    for i in range(3):
        square += (m.nav[V_NORTH + i] - m.x[states.VELOCITY + i]) ** 2
        variance += m.p[states.VELOCITY + i, states.VELOCITY + i]
    return square > (MOVES + MOVES_SIGMAS * sqrt(variance)) ** 2


@part()
def _rest(m: Memory, model: Model, weight: float) -> None:
    """Zero velocity, and the Earth's rate alone."""
    nav = m.nav
    c00, c01, c02, c10, c11, c12, c20, c21, c22 = dcm(
        nav[Q_W], nav[Q_W + 1], nav[Q_W + 2], nav[Q_W + 3]
    )
    c_nb = ((c00, c01, c02), (c10, c11, c12), (c20, c21, c22))
    north = earth.EARTH_RATE * cos(nav[LATITUDE])
    down = -earth.EARTH_RATE * sin(nav[LATITUDE])
    gyro = model.where[states.I_GYRO_BIAS]
    length = m.turned[3]
    instants.clear_rows(m, layout.ROWS)
    for i in range(3):
        m.h[i, states.VELOCITY + i] = 1.0
        m.nu[i] = nav[V_NORTH + i] - m.x[states.VELOCITY + i]
        m.r[i] = model.vehicle[layout.V_REST_VELOCITY] * weight
        m.h[3 + i, gyro + i] = 1.0
        still = c_nb[0][i] * north + c_nb[2][i] * down
        m.nu[3 + i] = m.turned[i] / length - m.sensors[i] - still - m.x[gyro + i]
        m.r[3 + i] = model.vehicle[layout.V_REST_RATE] * weight
    rows = 6 if length > 0.0 else 3
    update.project(m, rows)
    if update.apply_measurement(m, rows, 0.0):
        m.rests += 1.0


@part()
def _roll(m: Memory, model: Model, weight: float, speed: float) -> None:
    """Constraint of an axle that moves neither sideways nor up, with the speed by its wheels."""
    rows, pull, nods = rolling_rows(m, model, speed)
    if rows == 0:
        return
    for k in range(rows):
        for j in range(m.n):
            if m.h[k, j] != 0.0:
                m.nu[k] -= m.h[k, j] * m.x[j]
    slip = PULL_SLIP * speed if rows == 3 and abs(pull) > PULLS else 0.0
    m.r[0] = model.vehicle[layout.V_LATERAL] * weight
    axle = model.where[states.I_LAND_VEHICLE] + states.AXLE
    m.r[1] = (model.vehicle[layout.V_VERTICAL] + nods * nods * m.p[axle, axle]) * weight
    m.r[2] = (model.vehicle[layout.V_WHEEL] + slip * slip) * weight
    update.project(m, rows)
    slides = 0.0
    for k in range(rows):
        if m.nu[k] ** 2 > GATE**2 * (m.s[k, k] + m.r[k]):
            m.r[k] = NOT_USED
            if k == 2:
                m.wheel_slips += 1.0
            else:
                slides = 1.0
    if update.apply_measurement(m, rows, 0.0):
        m.slips += slides
        m.held += 1.0
        m.wheels += 1.0 if rows == 3 else 0.0


@part()
def rolling_rows(m: Memory, model: Model, speed: float) -> tuple[int, float, float]:
    """Innovation and H of a vehicle that rolls; how many rows, and how it speeds up and nods.

    Parameters
    ----------
    m : Memory
        `nu` and `h` are set, the estimate not taken off.
    speed : float
        Of the wheels, m/s; NaN where unknown.

    Returns
    -------
    rows : int
        0 where it is too slow to tell; else lateral, vertical and, if there are any, wheels.
    forward : float
        m/s^2.
    nods : float
        rad/s.
    """
    nav, memory, rolling = m.nav, m.vehicle, m.rolling
    first = model.where[states.I_LAND_VEHICLE]
    gyro = model.where[states.I_GYRO_BIAS]
    c00, c01, c02, c10, c11, c12, c20, c21, c22 = dcm(
        nav[Q_W], nav[Q_W + 1], nav[Q_W + 2], nav[Q_W + 3]
    )
    vn, ve, vd = nav[V_NORTH], nav[V_NORTH + 1], nav[V_NORTH + 2]
    # Of vectors in NED to those of the vehicle, by rows
    b, v, w, f = m.axes, m.along, m.about, m.pull
    for i in range(3):
        x, y, z = memory[3 * i], memory[3 * i + 1], memory[3 * i + 2]
        b[i, 0] = x * c00 + y * c01 + z * c02
        b[i, 1] = x * c10 + y * c11 + z * c12
        b[i, 2] = x * c20 + y * c21 + z * c22
        v[i] = b[i, 0] * vn + b[i, 1] * ve + b[i, 2] * vd
        w[i] = x * rolling[0] + y * rolling[1] + z * rolling[2]
        f[i] = x * rolling[3] + y * rolling[4] + z * rolling[5]
    if abs(v[0]) < ROLLING:
        return 0, 0.0, 0.0
    forward = f[0] + b[0, 2] * earth.NORMAL_GRAVITY_EQUATOR
    axle, sideslip, squat = memory[9], memory[10], memory[11]
    rows = 3 if np.isfinite(speed) else 2
    instants.clear_rows(m, layout.ROWS)
    m.nu[0] = v[1] - w[2] * axle + sideslip * w[2] * v[0] * v[0]
    m.nu[1] = v[2] + w[1] * axle - squat * forward * v[0]
    m.nu[2] = v[0] - (1.0 + memory[12]) * speed if rows == 3 else 0.0
    for k in range(rows):
        # Of velocity across or along, and of the speed in sideslip and squat
        i = (1, 2, 0)[k]
        along = (2.0 * sideslip * w[2] * v[0], -squat * forward, 0.0)[k]
        b0, b1, b2 = b[i, 0] + along * b[0, 0], b[i, 1] + along * b[0, 1], b[i, 2] + along * b[0, 2]
        p0, p1, p2 = cross(vn, ve, vd, b0, b1, b2)
        m.h[k, states.VELOCITY], m.h[k, states.VELOCITY + 1] = b0, b1
        m.h[k, states.VELOCITY + 2] = b2
        m.h[k, states.ATTITUDE], m.h[k, states.ATTITUDE + 1] = p0, p1
        m.h[k, states.ATTITUDE + 2] = p2
    # Gravity in the forward acceleration
    lean = squat * v[0] * earth.NORMAL_GRAVITY_EQUATOR
    m.h[1, states.ATTITUDE] += lean * b[0, 1]
    m.h[1, states.ATTITUDE + 1] -= lean * b[0, 0]
    for j in range(3):
        m.h[0, gyro + j] = (sideslip * v[0] * v[0] - axle) * memory[6 + j]
        m.h[1, gyro + j] = axle * memory[3 + j]
    # [v x] mu, mu without roll
    m.h[0, first + states.MOUNT_YAW] = -v[0]
    m.h[1, first + states.MOUNT_PITCH] = v[0]
    m.h[0, first + states.AXLE] = w[2]
    # The vertical says nothing of the axle: on its springs the body pitches and heaves together
    m.h[0, first + states.SIDESLIP] = -w[2] * v[0] * v[0]
    m.h[1, first + states.SQUAT] = forward * v[0]
    if rows == 3:
        m.h[2, first + states.MOUNT_PITCH] = -v[2]
        m.h[2, first + states.MOUNT_YAW] = v[1]
        m.h[2, first + states.WHEEL_SCALE] = speed
    return rows, forward, w[1]
