"""A GNSS epoch in an INS/GNSS filter: compared, gated, used."""

from __future__ import annotations

from math import cos, pi, sin, sqrt

import numba
import numpy as np

from sinstool.core import earth
from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.quaternion_kernels import cross, dcm, wrapped_angle
from sinstool.core.units import STANDARD_GRAVITY
from sinstool.methods.ins_gnss import instants, layout, measurement_noise, states, update
from sinstool.methods.ins_gnss.layout import Memory, Model, Stored
from sinstool.methods.ins_gnss.model import radii
from sinstool.methods.strapdown.navigation import HEIGHT, LATITUDE, LONGITUDE, Q_W, V_NORTH

_D = states.POSITION + 2

_RATE = earth.EARTH_RATE
FAR = 1000.0  # m between navigation and fixes, beyond which linear errors mean little
FAR_ATTITUDE = pi / 180.0

# After so long without epochs, s, it is the navigation that is uncertain, and not the fix: what an
# IMU does in an outage is more than the noise of its grade (vibration, the squat of a car
# that pulls away). Until they agree again, innovations may be larger, squared by this factor,
# before they are turned down: a good fix turned down costs the way to the restart, and a smoother
# the outage.
OUTAGE = 5.0
AFTER_OUTAGE = 16.0
AGREE = 10.0  # epochs in succession

MOST_TILT = 0.2  # rad, that a drift is explained by
LEAST_REJECTED = 3.0  # epochs before a restart, however much time they take
ROUNDING = 1e-7  # s, of times


@numba.njit(cache=True, nogil=True)
def gnss_epoch(
    m: Memory,
    model: Model,
    stored: Stored,
    stored_row: int,
    keep: bool,
    fix: FloatArray,
    back: float,
    moved: FloatArray,
    withheld: bool,
    diagnosis: FloatArray,
    events: FloatArray,
    count: IntArray,
) -> None:
    """A GNSS epoch: used, rejected, or only compared.

    Parameters
    ----------
    m, model, stored, stored_row, keep
        See :func:`open_instant`.
    fix : ndarray, shape (12,)
        Latitude, longitude, height, velocity, and their standard deviations; NaN: not there.
    back : float
        How long ago it was valid, s.
    moved : ndarray, shape (9,)
        Changes of latitude, longitude, height, velocity and angular rate per second since then.
    withheld : bool
        Compare only.
    diagnosis : ndarray
        A row, set.
    events, count : ndarray
    """
    number = m.numbers
    par = model.parameters
    if withheld:
        if number[layout.N_OPEN] == 0.0:
            instants.close_substep(m, model, keep)
    else:
        instants.open_instant(m, model, stored, stored_row, keep)

    rows = _compare(m, model, fix, back, moved, diagnosis)
    diagnosis[layout.D_ROWS] = rows
    diagnosis[layout.D_WITHHELD] = 1.0 if withheld else 0.0
    diagnosis[layout.D_USED] = 0.0
    diagnosis[layout.D_GATED] = 0.0
    diagnosis[layout.D_RESTARTED] = 0.0
    diagnosis[layout.D_NIS] = np.nan
    if rows == 0:
        return
    update.project(m, rows)
    measured = m.changes.shape[0] > 0 and not withheld
    if par[layout.P_ADAPTIVE] > 0.0 and not withheld:
        measurement_noise.adapt(m, model, rows)
    if measured:
        measurement_noise.note_changes(m, rows)
    if not update.factor(m.s, m.r, rows, m.root):
        # No covariance any more: rounding, or a model that broke
        instants.record(events, count, layout.E_NO_COVARIANCE, number[layout.N_NOW], 0.0)
        instants.begin_anew(m, model)
        rows = _compare(m, model, fix, back, moved, diagnosis)
        update.project(m, rows)
        if not update.factor(m.s, m.r, rows, m.root):
            return
    nis = update.normalised_square(m.root, m.nu, rows, m.gain[:, 0])
    if measured and measurement_noise.often_far(m, nis > par[layout.P_GATES + rows]):
        measurement_noise.use_measured(m, rows)
        if not update.factor(m.s, m.r, rows, m.root):
            return
        nis = update.normalised_square(m.root, m.nu, rows, m.gain[:, 0])
    _spread(m, rows, diagnosis)
    diagnosis[layout.D_NIS] = nis
    if withheld:
        return
    if par[layout.P_CLOSED] == 0.0 and number[layout.N_FAR] == 0.0:
        _warn_if_far(m, events, count)
    # Receivers give positions and velocities apart from each other: either may be rejected alone
    alone = 0 if measurement_noise.row_of(m, 0) < 3 else 1
    streak = layout.N_REJECTED if alone == 0 else layout.N_REJECTED_VELOCITIES
    # A receiver that hangs repeats itself: that the vehicle moves on is no sign of a bad filter
    hangs = alone == 0 and fix[0] == number[layout.N_FIX] and fix[1] == number[layout.N_FIX + 1]
    number[layout.N_FIX] = fix[0]
    number[layout.N_FIX + 1] = fix[1]
    if number[layout.N_NOW] - number[layout.N_SEEN_AT + alone] > OUTAGE:
        number[layout.N_AFTER_OUTAGE + alone] = AGREE
    number[layout.N_SEEN_AT + alone] = number[layout.N_NOW]
    gate = number[layout.N_DOUBT] * par[layout.P_GATES + rows]
    if number[layout.N_AFTER_OUTAGE + alone] > 0.0:
        number[layout.N_AFTER_OUTAGE + alone] = (
            number[layout.N_AFTER_OUTAGE + alone] - 1.0 if nis <= gate else AGREE
        )
        gate *= AFTER_OUTAGE
    if nis > gate:
        now = number[layout.N_NOW]
        if number[streak] == 0.0 or hangs:
            number[layout.N_REJECTED_SINCE + alone] = now
        number[streak] += 1.0
        for k in range(rows):
            m.rejected[measurement_noise.row_of(m, k)] = m.nu[k]
        wait = par[layout.P_RESTART_AFTER]
        if instants.lately_restarted(m, model):
            wait /= 3.0
        lasted = now - number[layout.N_REJECTED_SINCE + alone]
        if wait == 0.0 or lasted < wait - ROUNDING or number[streak] < LEAST_REJECTED:
            diagnosis[layout.D_GATED] = 1.0
            number[layout.N_EPOCHS_GATED] += 1.0
            instants.record(events, count, layout.E_GATED, number[layout.N_NOW], nis)
            return
        instants.record(events, count, layout.E_RESTART, number[layout.N_NOW], nis)
        diagnosis[layout.D_RESTARTED] = 1.0
        # Where a restart did not help, the fixes are believed rather than the filter
        number[layout.N_AFTER_OUTAGE + alone] = (
            AGREE if instants.lately_restarted(m, model) else 0.0
        )
        instants.begin_anew(m, model)
        rows = _compare(m, model, fix, back, moved, diagnosis)
        for i in range(6):
            # so far off, at least, is the navigation
            m.p[i, i] = max(m.p[i, i], m.rejected[i] ** 2)
        if alone == 0 and lasted > 0.0:
            _admit_drift(m, lasted)
        update.project(m, rows)
        _spread(m, rows, diagnosis)
    number[streak] = 0.0
    for k in range(rows):
        m.rejected[measurement_noise.row_of(m, k)] = 0.0
    if update.apply_measurement(m, rows, par[layout.P_EPSILON]):
        diagnosis[layout.D_USED] = 1.0
        number[layout.N_EPOCHS_USED] += 1.0
        number[layout.N_USED_AT] = number[layout.N_NOW]
        if diagnosis[layout.D_RESTARTED] == 0.0:
            number[layout.N_NIS_SUM] += nis
            number[layout.N_NIS_ROWS] += rows


@numba.njit(cache=True, nogil=True)
def _admit_drift(m: Memory, lasted: float) -> None:
    """Sigmas of velocity and tilt no less than what explains a drift from the fixes, by itself."""
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


@numba.njit(cache=True, nogil=True)
def _compare(
    m: Memory, model: Model, fix: FloatArray, back: float, moved: FloatArray, diagnosis: FloatArray
) -> int:
    """Innovation and H of a fix; how many rows it has."""
    par = model.parameters
    index = model.where
    number = m.numbers
    nav = m.nav
    gyro = index[states.I_GYRO_BIAS]
    eta = index[states.I_GNSS_POSITION]
    lx = par[layout.P_LEVER]
    ly = par[layout.P_LEVER + 1]
    lz = par[layout.P_LEVER + 2]

    c00, c01, c02, c10, c11, c12, c20, c21, c22 = dcm(
        nav[Q_W], nav[Q_W + 1], nav[Q_W + 2], nav[Q_W + 3]
    )
    # Rate and arm when the fix was valid, the arm in the body axes of now
    rx = number[layout.N_RATE] - back * moved[6]
    ry = number[layout.N_RATE + 1] - back * moved[7]
    rz = number[layout.N_RATE + 2] - back * moved[8]
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
    if m.changes.shape[0] > 0:
        m.ratio[:] = 1.0
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
        for j in range(m.h.shape[1]):
            if m.h[rows, j] != 0.0:
                value -= m.h[rows, j] * m.x[j]
        m.nu[rows] = value
        m.r[rows] = m.ratio[i] * _white_variance(par, i, fix[6 + i], eta >= 0)
        diagnosis[layout.D_INNOVATION + i] = value
        diagnosis[layout.D_MEASUREMENT + i] = sqrt(m.r[rows])
        rows += 1
    return rows


@numba.njit(cache=True, nogil=True)
def _white_variance(par: FloatArray, i: int, sigma: float, slow_states: bool) -> float:
    """Variance of a row's white noise, from what the receiver says, if it does.

    A receiver speaks of all of its error. Where the slow part has states of its own, the rest
    is left for the white one; a receiver that claims less than the model has the model's share.
    """
    white = par[layout.P_GNSS_WHITE + i]
    if not (np.isfinite(sigma) and sigma > 0.0):
        return white if slow_states else par[layout.P_GNSS_ALL + i]
    square = sigma * sigma
    if not slow_states:
        return square
    slow = par[layout.P_GNSS_MARKOV + i]
    if square >= white + slow:
        return square - slow
    return square * white / (white + slow)


@numba.njit(cache=True, nogil=True)
def _spread(m: Memory, rows: int, diagnosis: FloatArray) -> None:
    """Note what the innovations should be."""
    for k in range(rows):
        i = measurement_noise.row_of(m, k)
        diagnosis[layout.D_SIGMA + i] = sqrt(m.s[k, k] + m.r[k])
        diagnosis[layout.D_MEASUREMENT + i] = sqrt(m.r[k])
        diagnosis[layout.D_RATIO + i] = m.ratio[i]


@numba.njit(cache=True, nogil=True)
def _warn_if_far(m: Memory, events: FloatArray, count: IntArray) -> None:
    """Without feedback: is the navigation still where a linear filter can correct it?"""
    x = m.x
    far = sqrt(x[states.POSITION] ** 2 + x[states.POSITION + 1] ** 2 + x[_D] ** 2)
    turned = sqrt(
        x[states.ATTITUDE] ** 2 + x[states.ATTITUDE + 1] ** 2 + x[states.ATTITUDE + 2] ** 2
    )
    if far > FAR or turned > FAR_ATTITUDE:
        m.numbers[layout.N_FAR] = 1.0
        instants.record(events, count, layout.E_FAR, m.numbers[layout.N_NOW], far)
