"""Substeps and instants of an INS/GNSS filter: propagation, feedback, restart.

An *instant* is the end of an IMU update with measurements. They change the estimate one after
the other; at the end of the instant what was estimated is fed back to navigation, sensors and
network, and a row is stored for a smoother.
"""

from __future__ import annotations

from math import cos, sqrt

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import part
from sinstool.core.quaternion_kernels import dcm, increment_quaternion, product, wrapped_angle
from sinstool.core.units import DEGREE, DEGREE_PER_HOUR, MILLI_G, STANDARD_GRAVITY
from sinstool.methods.height.channel import feedback as channel_feedback
from sinstool.methods.height.layout import S_BARO_BIAS, S_CORRECTION, S_STEP
from sinstool.methods.ins_gnss import layout, states
from sinstool.methods.ins_gnss.layout import Memory, Model
from sinstool.methods.ins_gnss.model import (
    error_rates,
    propagate_covariance,
    propagate_estimate,
    propagate_product,
    radii,
    transition,
)
from sinstool.methods.strapdown.navigation import HEIGHT, LATITUDE, LONGITUDE, Q_W, V_NORTH
from sinstool.methods.strapdown.navigation import SIZE as NAV_SIZE

Matrix = tuple[float, float, float, float, float, float, float, float, float]

_D = states.POSITION + 2
_VD = states.VELOCITY + 2

LARGE_TILT = 2.0 * (5.0 * DEGREE) ** 2  # sum of two variances, rad^2
GAP_TIME = 1.0  # s, correlation time of what the motion may have been in a gap

# A second restart within this time, s, adds these sigmas, m/s, rad, rad/s and m/s^2, to those of
# the start, which were too small.
NOT_HELPED = 120.0
# Each such restart also doubles all sigmas, of the gate and of the output: model and data do not
# fit, and more restarts would not help.
MOST_DOUBT = 1024.0
LOST_VELOCITY = 20.0
LOST_ATTITUDE = 10.0 * DEGREE
LOST_GYRO_BIAS = 100.0 * DEGREE_PER_HOUR
LOST_ACCEL_BIAS = 20.0 * MILLI_G


@part()
def record(m: Memory, events: FloatArray, kind: int, size: float) -> None:
    """Note an event of now; only counted once there is no room."""
    k = m.events
    if k < events.shape[0]:
        events[k, 0] = kind
        events[k, 1] = m.now
        events[k, 2] = size
    m.events = k + 1


@part()
def close_substep(m: Memory, model: Model) -> None:
    """Bring estimate and covariance to the present; begin a new substep."""
    delta = m.now - m.from_time
    nav = m.nav
    if delta > 0.0:
        scale = 1.0 / delta
        counted = m.gain_count > 0.0
        k1 = scale * m.gains[0] if counted else 0.0
        k2 = scale * m.gains[1] if counted else 0.0
        k3 = scale * m.gains[2] if counted else 0.0
        error_rates(
            model.where,
            0.5 * (m.from_latitude + nav[LATITUDE]),
            0.5 * (m.from_height + nav[HEIGHT]),
            0.5 * (m.from_velocity[0] + nav[V_NORTH]),
            0.5 * (m.from_velocity[1] + nav[V_NORTH + 1]),
            0.5 * (m.from_velocity[2] + nav[V_NORTH + 2]),
            m.mean_c,
            m.mean_cf,
            m.mean_cw,
            m.mean_axes,
            scale,
            k1,
            k2,
            k3,
            m.rates,
        )
        transition(model.where, m.rates, model.decay_rate, delta, m.phi, m.decay)
        propagate_covariance(model.where, m.phi, m.decay, model.noise, delta, m.p, m.half)
        propagate_estimate(model.where, m.phi, m.decay, m.x, m.half)
        if m.keep:
            propagate_product(model.where, m.phi, m.decay, m.product, m.half)
        if counted:
            _white_of_many(m, model)
        if model.across_variance + model.turn_variance > 0.0:
            _uncertain_by_turning(m, model)
        if m.shaken > 0.0:
            # An engine that idles, seen by samples that do not resolve it
            for i in range(3):
                m.p[states.VELOCITY + i, states.VELOCITY + i] += (
                    model.vehicle[layout.V_SHAKEN_FORCE] * delta
                )
                m.p[states.ATTITUDE + i, states.ATTITUDE + i] += (
                    model.vehicle[layout.V_SHAKEN_RATE] * delta
                )
        if m.leaning > 0.0:
            first = states.ATTITUDE
            tilt = m.p[first, first] + m.p[first + 1, first + 1]
            down = states.VELOCITY + 2
            # Of second order: a tilt by an angle takes g angle^2 / 2 off the vertical force
            if tilt > LARGE_TILT:
                m.p[down, down] += 0.5 * (STANDARD_GRAVITY * tilt) ** 2 * GAP_TIME * delta
            else:
                m.leaning = 0.0
        if m.in_gap > 0.0:
            m.leaning = 1.0
            # A force and a turn that last for GAP_TIME at a time
            for i in range(3):
                m.p[states.VELOCITY + i, states.VELOCITY + i] += (
                    model.gap_acceleration**2 * GAP_TIME * delta
                )
                turn = model.gap_tilt_rate if i < 2 else model.gap_rate
                m.p[states.ATTITUDE + i, states.ATTITUDE + i] += turn**2 * GAP_TIME * delta
    begin_substep(m)


@part()
def _uncertain_by_turning(m: Memory, model: Model) -> None:
    """Make the attitude less certain across the axis of a turn, as axes of gyros are misaligned.

    About its axis a turn is wrong by scale factors only, so the heading of a car is not affected.
    """
    t = m.mean_cw
    turn = (
        t[0, 0] + t[0, 1] + t[0, 2],
        t[1, 0] + t[1, 1] + t[1, 2],
        t[2, 0] + t[2, 1] + t[2, 2],
    )
    size = sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    if size > 0.0:
        for i in range(3):
            k = states.ATTITUDE + i
            m.p[k, k] += (model.across_variance + model.turn_variance) * size
            for j in range(3):
                along = turn[i] * turn[j] / size
                m.p[k, states.ATTITUDE + j] -= model.across_variance * along


@part(inline="always")
def uncertain(lost: FloatArray) -> bool:
    """Whether any of six variances is not zero."""
    return lost[0] + lost[1] + lost[2] + lost[3] + lost[4] + lost[5] > 0.0


@part()
def lose_samples(
    m: Memory,
    lost: FloatArray,
    c00: float,
    c01: float,
    c02: float,
    c10: float,
    c11: float,
    c12: float,
    c20: float,
    c21: float,
    c22: float,
) -> None:
    """Make attitude and velocity less certain by variances of samples lost or clipped."""
    for first, of in ((states.ATTITUDE, 0), (states.VELOCITY, 3)):
        x, y, z = lost[of], lost[of + 1], lost[of + 2]
        north = m.p[first]
        north[first] += x * c00 * c00 + y * c01 * c01 + z * c02 * c02
        east = m.p[first + 1]
        east[first + 1] += x * c10 * c10 + y * c11 * c11 + z * c12 * c12
        down = m.p[first + 2]
        down[first + 2] += x * c20 * c20 + y * c21 * c21 + z * c22 * c22
        both = x * c00 * c10 + y * c01 * c11 + z * c02 * c12
        north[first + 1] += both
        east[first] += both
        both = x * c00 * c20 + y * c01 * c21 + z * c02 * c22
        north[first + 2] += both
        down[first] += both
        both = x * c10 * c20 + y * c11 * c21 + z * c12 * c22
        east[first + 2] += both
        down[first + 1] += both


@part()
def _white_of_many(m: Memory, model: Model) -> None:
    """White noise and known input of the samples within the substep."""
    a = model.where[states.I_CORRECTION]
    white = model.baro_white / m.gain_count
    where = (_D, _VD, a)
    for i in range(3):
        m.x[where[i]] += m.inputs[i]
        for j in range(3):
            m.p[where[i], where[j]] += m.gains[i] * m.gains[j] * white


@part()
def begin_substep(m: Memory) -> None:
    """Forget the averages, and note where the substep begins."""
    m.from_time = m.now
    m.from_latitude = m.nav[LATITUDE]
    m.from_height = m.nav[HEIGHT]
    m.gain_count = 0.0
    for i in range(3):
        m.from_velocity[i] = m.nav[V_NORTH + i]
        m.gains[i] = 0.0
        m.inputs[i] = 0.0
        for j in range(3):
            m.mean_c[i, j] = 0.0
            m.mean_cf[i, j] = 0.0
            m.mean_cw[i, j] = 0.0
        for j in range(12):
            m.mean_axes[i, j] = 0.0


@part()
def open_instant(m: Memory, model: Model, stored: FloatArray) -> None:
    """Bring the filter to the present for a measurement, if that is not done yet."""
    if m.open > 0.0:
        return
    close_substep(m, model)
    n = m.n
    for i in range(n):
        m.dx[i] = 0.0
    if m.keep:
        row = m.row
        transition_at = layout.R_STATES + 2 * n
        before_at = transition_at + n * n
        for i in range(n):
            for j in range(n):
                stored[row, transition_at + i * n + j] = m.product[i, j]
                stored[row, before_at + i * n + j] = m.p[i, j]
    m.open = 1.0


@part()
def close_instant(m: Memory, model: Model, stored: FloatArray) -> None:
    """Feed back, store a row."""
    if m.open == 0.0:
        return
    m.open = 0.0
    m.instant_at = m.now
    d_height = 0.0
    if model.closed > 0.0:
        d_height = m.x[_D]
        turn_errors(m, stored)
        _feed_back(m, model)
    if m.step_set > 0.0:
        # The channel thought that all of the difference would go out of the height.
        m.channel[S_STEP] += m.step - d_height
        m.step_set = 0.0
    begin_substep(m)
    if not m.keep:
        return
    n = m.n
    row = m.row
    after_at = layout.R_STATES + 2 * n * (n + 1)
    for i in range(n):
        stored[row, layout.R_STATES + i] = m.dx[i]
        stored[row, layout.R_STATES + n + i] = m.x[i]
        for j in range(n):
            stored[row, after_at + i * n + j] = m.p[i, j]
            m.product[i, j] = 1.0 if i == j else 0.0
    for i in range(NAV_SIZE):
        stored[row, layout.R_NAV + i] = m.nav[i]
    for i in range(9):
        stored[row, layout.R_SENSORS + i] = m.sensors[i]
    stored[row, layout.R_SENSORS + 9] = m.channel[S_CORRECTION]
    stored[row, layout.R_SENSORS + 10] = m.channel[S_BARO_BIAS]
    for i in range(15):
        stored[row, layout.R_SENSORS + 11 + i] = m.sensors[9 + i]
    stored[row, layout.R_TIME] = m.now
    stored[row, layout.R_UPDATE] = m.updates
    stored[row, layout.R_RESTART] = m.begun
    m.begun = 0.0
    m.row = row + 1


@part()
def corrected(nav: FloatArray, x: FloatArray, out: FloatArray) -> None:
    """Write a navigation state, corrected by the estimated errors, into another."""
    rm, rn = radii(nav[LATITUDE], nav[HEIGHT])
    across = rn * cos(nav[LATITUDE])
    out[LATITUDE] = nav[LATITUDE] - x[states.POSITION] / rm
    out[LONGITUDE] = wrapped_angle(nav[LONGITUDE] - x[states.POSITION + 1] / across)
    out[HEIGHT] = nav[HEIGHT] + x[_D]
    for i in range(3):
        out[V_NORTH + i] = nav[V_NORTH + i] - x[states.VELOCITY + i]
    pw, px, py, pz = increment_quaternion(
        x[states.ATTITUDE], x[states.ATTITUDE + 1], x[states.ATTITUDE + 2], 0
    )
    out[Q_W], out[Q_W + 1], out[Q_W + 2], out[Q_W + 3] = product(
        pw, px, py, pz, nav[Q_W], nav[Q_W + 1], nav[Q_W + 2], nav[Q_W + 3]
    )


@part()
def turn_errors(m: Memory, stored: FloatArray) -> None:
    """Turn the errors of attitude with the attitude, as it is corrected.

    What an accelerometer's bias tilts, it tilts in the body. Where heading gets known by many
    degrees at once, tilts would else stay where they were in NED, as if the body had turned
    against its biases, and the next fixes would tell the two apart. With psi of the body, C^T psi,
    as in the left-invariant filter [1]_, nothing is to be turned; in NED it is exp(x) psi.

    References
    ----------
    .. [1] A. Barrau, S. Bonnabel, "The invariant extended Kalman filter as a stable observer",
       IEEE Trans. Automatic Control 62(4), 2017, 1797-1812.
    """
    x = m.x
    w, qx, qy, qz = increment_quaternion(
        x[states.ATTITUDE], x[states.ATTITUDE + 1], x[states.ATTITUDE + 2], 0
    )
    c = dcm(w, qx, qy, qz)
    n, a = m.n, states.ATTITUDE
    p = m.p
    for j in range(n):
        p[a, j], p[a + 1, j], p[a + 2, j] = _turned(c, p[a, j], p[a + 1, j], p[a + 2, j])
    for i in range(n):
        p[i, a], p[i, a + 1], p[i, a + 2] = _turned(c, p[i, a], p[i, a + 1], p[i, a + 2])
    p[a, a + 1], p[a, a + 2], p[a + 1, a + 2] = p[a + 1, a], p[a + 2, a], p[a + 2, a + 1]
    if not m.keep:
        return
    # What a smoother gets of before this instant is in the same axes
    row = stored[m.row]
    transition_at = layout.R_STATES + 2 * n
    before_at = transition_at + n * n
    for first in (transition_at, before_at):
        k = first + a * n
        for j in range(k, k + n):
            row[j], row[j + n], row[j + 2 * n] = _turned(c, row[j], row[j + n], row[j + 2 * n])
    for k in range(before_at + a, before_at + n * n, n):
        row[k], row[k + 1], row[k + 2] = _turned(c, row[k], row[k + 1], row[k + 2])
    k = before_at + a * n + a
    row[k + 1], row[k + 2], row[k + n + 2] = row[k + n], row[k + 2 * n], row[k + 2 * n + 1]
    dx = m.dx
    dx[a], dx[a + 1], dx[a + 2] = _turned(c, dx[a], dx[a + 1], dx[a + 2])


@part()
def _turned(c: Matrix, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A vector turned by a matrix, which is given by rows."""
    return (
        c[0] * x + c[1] * y + c[2] * z,
        c[3] * x + c[4] * y + c[5] * z,
        c[6] * x + c[7] * y + c[8] * z,
    )


@part()
def _feed_back(m: Memory, model: Model) -> None:
    """Correct navigation, sensors and network by the estimates, which are then 0."""
    index = model.where
    x = m.x
    corrected(m.nav, x, m.nav)
    gyro = index[states.I_GYRO_BIAS]
    factor_at = index[states.I_ACCEL_SCALE]
    bias = index[states.I_ACCEL_BIAS]
    gyro_factor = index[states.I_GYRO_SCALE]
    for i in range(3):
        m.sensors[i] += x[gyro + i]
        m.sensors[6 + i] += x[bias + i]
        x[gyro + i] = 0.0
        x[bias + i] = 0.0
        if factor_at >= 0:
            m.sensors[3 + i] += x[factor_at + i]
            x[factor_at + i] = 0.0
        if gyro_factor >= 0:
            m.sensors[9 + i] += x[gyro_factor + i]
            x[gyro_factor + i] = 0.0
    axes = index[states.I_GYRO_AXES]
    if axes >= 0:
        # Those of the accelerometers follow those of the gyros
        for i in range(12):
            m.sensors[12 + i] += x[axes + i]
            x[axes + i] = 0.0
    if index[states.I_LAND_VEHICLE] >= 0:
        feed_back_vehicle(m.vehicle, x, index[states.I_LAND_VEHICLE])
    b = index[states.I_BARO]
    if b >= 0:
        m.channel[S_BARO_BIAS] += x[b]
        x[b] = 0.0
    a = index[states.I_CORRECTION]
    if model.has_network > 0.0:
        d_a = -x[a] if a >= 0 else 0.0
        channel_feedback(m.channel, m.now, x[_D], x[_VD], d_a)
        if a >= 0:
            x[a] = 0.0
    for i in range(9):
        x[i] = 0.0


@part()
def feed_back_vehicle(vehicle: FloatArray, x: FloatArray, first: int) -> None:
    """Correct mount, axle, sideslip, squat and wheel scale by the estimates, which are then 0."""
    pitch, yaw = x[first + states.MOUNT_PITCH], x[first + states.MOUNT_YAW]
    w, qx, qy, qz = increment_quaternion(0.0, pitch, yaw, 0)
    c00, c01, c02, c10, c11, c12, c20, c21, c22 = dcm(w, qx, qy, qz)
    for j in range(3):
        a, b, c = vehicle[j], vehicle[3 + j], vehicle[6 + j]
        vehicle[j] = c00 * a + c01 * b + c02 * c
        vehicle[3 + j] = c10 * a + c11 * b + c12 * c
        vehicle[6 + j] = c20 * a + c21 * b + c22 * c
    for i in range(states.AXLE, states.WHEEL_SCALE + 1):
        vehicle[9 + i - states.AXLE] += x[first + i]
    for i in range(states.WHEEL_SCALE + 1):
        x[first + i] = 0.0


@part()
def lately_restarted(m: Memory, model: Model) -> bool:
    """Whether the latest restart is so recent that it did not help; larger sigmas then follow."""
    since = m.now - m.restart_at
    return model.escalate > 0.0 and since < NOT_HELPED


@part()
def begin_anew(m: Memory, model: Model) -> None:
    """Restart with the covariance of the start; navigation and sensors stay, GNSS errors are
    zeroed.

    If a restart shortly before did not help, the sigmas of the start were too small: they are
    enlarged to what a vehicle can have done.
    """
    n = m.n
    for i in range(n):
        for j in range(n):
            m.p[i, j] = model.p0[i, j]
    if lately_restarted(m, model):
        gyro, accel = model.where[states.I_GYRO_BIAS], model.where[states.I_ACCEL_BIAS]
        for i in range(3):
            m.p[states.VELOCITY + i, states.VELOCITY + i] += LOST_VELOCITY**2
            m.p[states.ATTITUDE + i, states.ATTITUDE + i] += LOST_ATTITUDE**2
            m.p[gyro + i, gyro + i] += LOST_GYRO_BIAS**2
            m.p[accel + i, accel + i] += LOST_ACCEL_BIAS**2
        m.doubt = min(4.0 * m.doubt, MOST_DOUBT)
    m.restart_at = m.now
    first = model.where[states.I_GNSS_POSITION]
    if first >= 0:
        for i in range(first, min(first + layout.ROWS, n)):
            m.x[i] = 0.0
            # Unlike at the start, the navigation is not that of a fix
            for j in range(first):
                m.p[i, j] = 0.0
                m.p[j, i] = 0.0
    for i in range(layout.ROWS):
        m.ratio[i] = 1.0
        m.latest[i] = np.nan
    for i in range(2):
        m.far_share[i] = 0.0
        m.streak[i] = 0.0
    m.window_seen = 0.0
    m.restarts += 1.0
    m.begun = 1.0


@part()
def clear_rows(m: Memory, rows: int) -> None:
    """H of no entries."""
    for i in range(rows):
        for j in range(m.n):
            m.h[i, j] = 0.0
