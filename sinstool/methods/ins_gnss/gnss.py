"""A GNSS epoch in an INS/GNSS filter: compared, gated, used."""

from __future__ import annotations

from math import cos, pi, sin, sqrt

import numpy as np

from sinstool.core import earth
from sinstool.core.arrays import FloatArray
from sinstool.core.parts import part
from sinstool.core.quaternion_kernels import cross, dcm, wrapped_angle
from sinstool.core.units import STANDARD_GRAVITY
from sinstool.methods.ins_gnss import instants, layout, measurement_noise, states, update
from sinstool.methods.ins_gnss.layout import Memory, Model
from sinstool.methods.ins_gnss.model import radii
from sinstool.methods.strapdown.navigation import HEIGHT, LATITUDE, LONGITUDE, Q_W, V_NORTH

_D = states.POSITION + 2

_RATE = earth.EARTH_RATE
FAR = 1000.0  # m between navigation and fixes, beyond which linear errors mean little
FAR_ATTITUDE = pi / 180.0

# After this long without epochs, s, the navigation is uncertain, not the fix: in an outage an IMU
# has larger errors than the noise of its grade (vibration, the squat of a car that pulls away).
# Until fixes agree again, squared innovations may be larger by this factor before they are
# rejected: a good fix that is rejected costs the time to the restart, and a smoother the outage.
OUTAGE = 5.0
AFTER_OUTAGE = 16.0
AGREE = 10.0  # epochs in succession

MOST_TILT = 0.2  # rad, that a drift is explained by
LEAST_REJECTED = 3.0  # epochs before a restart, however much time they take
ROUNDING = 1e-7  # s, of times


@part()
def gnss_epoch(
    m: Memory,
    model: Model,
    stored: FloatArray,
    window: FloatArray,
    changes: FloatArray,
    events: FloatArray,
    fix: FloatArray,
    back: float,
    withheld: bool,
    diagnosis: FloatArray,
) -> None:
    """A GNSS epoch: used, rejected, or only compared.

    Parameters
    ----------
    m, model, stored
        See :func:`~sinstool.methods.ins_gnss.instants.open_instant`.
    window, changes, events : ndarray
        See :func:`~sinstool.methods.ins_gnss.loop.run`.
    fix : ndarray, shape (12,)
        Latitude, longitude, height, velocity, and their standard deviations; NaN: not there.
    back : float
        How long ago it was valid, s.
    withheld : bool
        Compare only.
    diagnosis : ndarray
        A row, set.
    """
    if withheld:
        if m.open == 0.0:
            instants.close_substep(m, model)
    else:
        instants.open_instant(m, model, stored)

    rows = compare(m, model, fix, back, diagnosis)
    diagnosis[layout.D_ROWS] = rows
    diagnosis[layout.D_WITHHELD] = 1.0 if withheld else 0.0
    diagnosis[layout.D_USED] = 0.0
    diagnosis[layout.D_GATED] = 0.0
    diagnosis[layout.D_RESTARTED] = 0.0
    diagnosis[layout.D_NIS] = np.nan
    if rows == 0:
        return
    update.project(m, rows)
    measured = model.measured > 0.0 and not withheld
    if model.adaptive > 0.0 and not withheld:
        measurement_noise.adapt(m, model, window, rows)
    if measured:
        measurement_noise.note_changes(m, changes, rows)
    if not update.factor(m.s, m.r, rows, m.root):
        # No covariance any more: rounding, or a model that broke
        instants.record(m, events, layout.E_NO_COVARIANCE, 0.0)
        instants.begin_anew(m, model)
        rows = compare(m, model, fix, back, diagnosis)
        update.project(m, rows)
        if not update.factor(m.s, m.r, rows, m.root):
            return
    nis = update.normalised_square(m.root, m.nu, rows, m.work)
    if measured and measurement_noise.often_far(m, nis > model.gates[rows]):
        measurement_noise.use_measured(m, changes, rows)
        if not update.factor(m.s, m.r, rows, m.root):
            return
        nis = update.normalised_square(m.root, m.nu, rows, m.work)
    _spread(m, rows, diagnosis)
    diagnosis[layout.D_NIS] = nis
    if withheld:
        return
    if model.closed == 0.0 and m.far == 0.0:
        _warn_if_far(m, events)
    # Receivers give positions and velocities apart from each other: either may be rejected alone
    alone = 0 if measurement_noise.row_of(m, 0) < 3 else 1
    # A receiver that hangs repeats itself: that the vehicle moves on is no sign of a bad filter
    hangs = alone == 0 and fix[0] == m.latest_fix[0] and fix[1] == m.latest_fix[1]
    m.latest_fix[0] = fix[0]
    m.latest_fix[1] = fix[1]
    if m.now - m.seen_at[alone] > OUTAGE:
        m.after_outage[alone] = AGREE
    m.seen_at[alone] = m.now
    gate = m.doubt * model.gates[rows]
    if m.after_outage[alone] > 0.0:
        m.after_outage[alone] = m.after_outage[alone] - 1.0 if nis <= gate else AGREE
        gate *= AFTER_OUTAGE
    if nis > gate:
        now = m.now
        if m.streak[alone] == 0.0 or hangs:
            m.rejected_since[alone] = now
        m.streak[alone] += 1.0
        for k in range(rows):
            m.rejected[measurement_noise.row_of(m, k)] = m.nu[k]
        wait = model.restart_after
        if instants.lately_restarted(m, model):
            wait /= 3.0
        lasted = now - m.rejected_since[alone]
        if wait == 0.0 or lasted < wait - ROUNDING or m.streak[alone] < LEAST_REJECTED:
            diagnosis[layout.D_GATED] = 1.0
            m.epochs_gated += 1.0
            instants.record(m, events, layout.E_GATED, nis)
            return
        instants.record(m, events, layout.E_RESTART, nis)
        diagnosis[layout.D_RESTARTED] = 1.0
        # If a restart did not help, the filter is wrong, not the fixes
        m.after_outage[alone] = AGREE if instants.lately_restarted(m, model) else 0.0
        instants.begin_anew(m, model)
        rows = compare(m, model, fix, back, diagnosis)
        for i in range(6):
            # so far off, at least, is the navigation
            m.p[i, i] = max(m.p[i, i], m.rejected[i] ** 2)
        if alone == 0 and lasted > 0.0:
            admit_drift(m, lasted)
        update.project(m, rows)
        _spread(m, rows, diagnosis)
    m.streak[alone] = 0.0
    for k in range(rows):
        m.rejected[measurement_noise.row_of(m, k)] = 0.0
    if update.apply_measurement(m, rows, model.epsilon):
        diagnosis[layout.D_USED] = 1.0
        m.epochs_used += 1.0
        m.used_at = m.now
        if diagnosis[layout.D_RESTARTED] == 0.0:
            m.nis_sum += nis
            m.nis_rows += rows


@part()
def admit_drift(m: Memory, lasted: float) -> None:
    """Raise sigmas of velocity and tilt until each alone explains a drift from the fixes."""
    level = 0.0
    for i in range(3):
        far = m.rejected[i]
        velocity = (far / lasted) ** 2
        m.p[states.VELOCITY + i, states.VELOCITY + i] = max(
            m.p[states.VELOCITY + i, states.VELOCITY + i], velocity
        )
        level += far * far if i < 2 else 0.0
    tilt = min(4.0 * level / (STANDARD_GRAVITY * lasted * lasted) ** 2, MOST_TILT**2)
    for i in range(2):
        m.p[states.ATTITUDE + i, states.ATTITUDE + i] = max(
            m.p[states.ATTITUDE + i, states.ATTITUDE + i], tilt
        )


@part()
def compare(m: Memory, model: Model, fix: FloatArray, back: float, diagnosis: FloatArray) -> int:
    """Innovation and H of a fix; how many rows it has."""
    index = model.where
    nav = m.nav
    moved = m.moved
    gyro = index[states.I_GYRO_BIAS]
    eta = index[states.I_GNSS_POSITION]
    lx = model.lever[0]
    ly = model.lever[1]
    lz = model.lever[2]

    c00, c01, c02, c10, c11, c12, c20, c21, c22 = dcm(
        nav[Q_W], nav[Q_W + 1], nav[Q_W + 2], nav[Q_W + 3]
    )
    # Rate and arm when the fix was valid, the arm in the body axes of now
    rx = m.rate[0] - back * moved[6]
    ry = m.rate[1] - back * moved[7]
    rz = m.rate[2] - back * moved[8]
    sx, sy, sz = cross(rx, ry, rz, lx, ly, lz)
    ax = lx - back * sx
    ay = ly - back * sy
    az = lz - back * sz
    an = c00 * ax + c01 * ay + c02 * az
    ae = c10 * ax + c11 * ay + c12 * az
    ad = c20 * ax + c21 * ay + c22 * az

    lat = nav[LATITUDE] - back * moved[0]
    lon = nav[LONGITUDE] - back * moved[1]
    h = nav[HEIGHT] - back * moved[2]
    rm, rn = radii(lat, h)
    across = rn * cos(lat)
    # The arm swings with the rate against the Earth
    on = c00 * rx + c01 * ry + c02 * rz - _RATE * cos(lat)
    oe = c10 * rx + c11 * ry + c12 * rz
    od = c20 * rx + c21 * ry + c22 * rz + _RATE * sin(lat)
    bn, be, bd = cross(on, oe, od, an, ae, ad)

    level = np.isfinite(fix[0]) and np.isfinite(fix[1])
    values = (
        (lat - fix[0]) * rm + an,
        (wrapped_angle(lon - fix[1]) if level else 0.0) * across + ae,
        fix[2] - h + ad,
        nav[V_NORTH] - back * moved[3] + bn - fix[3],
        nav[V_NORTH + 1] - back * moved[4] + be - fix[4],
        nav[V_NORTH + 2] - back * moved[5] + bd - fix[5],
    )
    # What a turn does to the arm, and to its swing
    arm = ((0.0, -ad, ae), (ad, 0.0, -an), (-ae, an, 0.0))
    swing = ((0.0, -bd, be), (bd, 0.0, -bn), (-be, bn, 0.0))
    c_nb = ((c00, c01, c02), (c10, c11, c12), (c20, c21, c22))
    instants.clear_rows(m, layout.ROWS)
    if model.measured > 0.0:
        for i in range(layout.ROWS):
            m.ratio[i] = 1.0
    rows = 0
    for i in range(6):
        diagnosis[layout.D_INNOVATION + i] = np.nan
        diagnosis[layout.D_SIGMA + i] = np.nan
        diagnosis[layout.D_MEASUREMENT + i] = np.nan
        diagnosis[layout.D_RATIO + i] = np.nan
        if not np.isfinite(fix[i]) or (i < 2 and not level) or (i == 2 and not np.isfinite(fix[0])):
            continue
        value = values[i]
        m.h[rows, i] = 1.0
        turn = arm[i] if i < 3 else swing[i - 3]
        for j in range(3):
            m.h[rows, states.ATTITUDE + j] = turn[j]
        if i < 3:
            m.h[rows, states.VELOCITY + i] = -back
        else:
            # -C [l x]
            r0, r1, r2 = c_nb[i - 3]
            gx, gy, gz = cross(r0, r1, r2, lx, ly, lz)
            m.h[rows, gyro], m.h[rows, gyro + 1], m.h[rows, gyro + 2] = -gx, -gy, -gz
        if eta >= 0:
            m.h[rows, eta + i] = -1.0
        for j in range(m.n):
            if m.h[rows, j] != 0.0:
                value -= m.h[rows, j] * m.x[j]
        m.nu[rows] = value
        m.r[rows] = m.ratio[i] * _white_variance(model, i, fix[6 + i], eta >= 0)
        diagnosis[layout.D_INNOVATION + i] = value
        diagnosis[layout.D_MEASUREMENT + i] = sqrt(m.r[rows])
        rows += 1
    return rows


@part()
def _white_variance(model: Model, i: int, sigma: float, slow_states: bool) -> float:
    """Variance of a row's white noise, from the stated sigma if there is one.

    A receiver states its whole error. If the slow part has states of its own, the rest is white;
    for a receiver that states less than the model has, the white share of the model is used.
    """
    white = model.gnss_white[i]
    if not (np.isfinite(sigma) and sigma > 0.0):
        return white if slow_states else model.gnss_all[i]
    square = sigma * sigma
    if not slow_states:
        return square
    slow = model.gnss_markov[i]
    if square >= white + slow:
        return square - slow
    return square * white / (white + slow)


@part()
def _spread(m: Memory, rows: int, diagnosis: FloatArray) -> None:
    """Record the expected size of the innovations."""
    for k in range(rows):
        i = measurement_noise.row_of(m, k)
        diagnosis[layout.D_SIGMA + i] = sqrt(m.s[k, k] + m.r[k])
        diagnosis[layout.D_MEASUREMENT + i] = sqrt(m.r[k])
        diagnosis[layout.D_RATIO + i] = m.ratio[i]


@part()
def _warn_if_far(m: Memory, events: FloatArray) -> None:
    """Without feedback: is the navigation still where a linear filter can correct it?"""
    x = m.x
    far = sqrt(x[states.POSITION] ** 2 + x[states.POSITION + 1] ** 2 + x[_D] ** 2)
    turned = sqrt(
        x[states.ATTITUDE] ** 2 + x[states.ATTITUDE + 1] ** 2 + x[states.ATTITUDE + 2] ** 2
    )
    if far > FAR or turned > FAR_ATTITUDE:
        m.far = 1.0
        instants.record(m, events, layout.E_FAR, far)
