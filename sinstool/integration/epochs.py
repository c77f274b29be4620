"""Measurements of an INS/GNSS filter: what is measured, whether it is believed, feedback.

An *instant* is the end of an IMU update with measurements. They change the estimate one after
the other; at the end of the instant what was estimated is fed back to navigation, sensors and
network, and a row is stored for a smoother.
"""

from __future__ import annotations

from math import cos, pi, sin, sqrt

import numba
import numpy as np
from numpy.typing import NDArray

from sinstool import earth
from sinstool.height.channel import feedback as channel_feedback
from sinstool.height.layout import (
    S_BARO_BIAS,
    S_CORRECTION,
    S_OFFSET,
    S_STEP,
)
from sinstool.integration.layout import (
    D_GATED,
    D_INNOVATION,
    D_MEASUREMENT,
    D_NIS,
    D_RESTARTED,
    D_ROWS,
    D_SIGMA,
    D_USED,
    D_WITHHELD,
    E_BARO_JUMP,
    E_FAR,
    E_GATED,
    E_RESTART,
    N_BEGUN,
    N_EPOCHS_GATED,
    N_EPOCHS_USED,
    N_FAR,
    N_FROM,
    N_GAIN,
    N_GAINS,
    N_GAP,
    N_HEIGHT,
    N_INSTANT_AT,
    N_KNOWN,
    N_LATITUDE,
    N_NIS_ROWS,
    N_NIS_SUM,
    N_NOW,
    N_OPEN,
    N_RATE,
    N_REJECTED,
    N_RESTARTS,
    N_ROW_STREAK,
    N_STEP,
    N_STEP_SET,
    N_UPDATES,
    N_USED_AT,
    N_VELOCITY,
    N_WINDOW,
    P_ADAPTIVE,
    P_BARO_GATE,
    P_BARO_SIGMA,
    P_BARO_WHITE,
    P_CLOSED,
    P_CORRECTION_VARIANCE,
    P_EPSILON,
    P_FADING,
    P_GAP_ACCELERATION,
    P_GAP_RATE,
    P_GATES,
    P_GNSS_ALL,
    P_GNSS_MARKOV,
    P_GNSS_WHITE,
    P_LEAST,
    P_LEVER,
    P_MOST,
    P_NETWORK,
    P_RESTART_AFTER,
    ROWS,
    Memory,
    Model,
    Stored,
)
from sinstool.integration.model import error_rates, radii, transition
from sinstool.integration.propagation import (
    propagate_covariance,
    propagate_estimate,
    propagate_product,
)
from sinstool.integration.states import (
    ATTITUDE,
    I_ACCEL_BIAS,
    I_ACCEL_SCALE,
    I_BARO,
    I_CORRECTION,
    I_GNSS_POSITION,
    I_GYRO_BIAS,
    POSITION,
    VELOCITY,
)
from sinstool.integration.update import (
    apply_measurement,
    factor,
    normalised_square,
    project,
)
from sinstool.strapdown.increment_quaternion import increment_quaternion
from sinstool.strapdown.navigation import HEIGHT, LATITUDE, LONGITUDE, Q_W, V_NORTH

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_D = POSITION + 2
_VD = VELOCITY + 2
_RATE = earth.EARTH_RATE

LEAST_BARO_SIGMA = 0.05  # m, of a row: no barometer is free of noise
JUMP_ROWS = (
    5  # baro differences rejected in a row, before the barometer's reference is said to have moved
)
FAR = 1000.0  # m between navigation and fixes, beyond which linear errors mean little
FAR_ATTITUDE = pi / 180.0
GAP_TIME = 1.0  # s, correlation time of what the motion may have been in a gap


@numba.njit(cache=True, nogil=True)
def record(events: FloatArray, count: IntArray, kind: int, time: float, size: float) -> None:
    """Note an event; only counted once there is no room."""
    if count[0] < events.shape[0]:
        events[count[0], 0] = kind
        events[count[0], 1] = time
        events[count[0], 2] = size
    count[0] += 1


@numba.njit(cache=True, nogil=True)
def close_substep(m: Memory, model: Model, keep: bool) -> None:
    """Bring estimate and covariance to the present; begin a new substep."""
    number = m.numbers
    delta = number[N_NOW] - number[N_FROM]
    nav = m.nav
    if delta > 0.0:
        scale = 1.0 / delta
        counted = number[N_GAINS] > 0.0
        k1 = scale * number[N_GAIN] if counted else 0.0
        k2 = scale * number[N_GAIN + 1] if counted else 0.0
        k3 = scale * number[N_GAIN + 2] if counted else 0.0
        error_rates(
            model.where,
            0.5 * (number[N_LATITUDE] + nav[LATITUDE]),
            0.5 * (number[N_HEIGHT] + nav[HEIGHT]),
            0.5 * (number[N_VELOCITY] + nav[V_NORTH]),
            0.5 * (number[N_VELOCITY + 1] + nav[V_NORTH + 1]),
            0.5 * (number[N_VELOCITY + 2] + nav[V_NORTH + 2]),
            m.mean_c,
            m.mean_cf,
            scale,
            k1,
            k2,
            k3,
            m.rates,
        )
        transition(model.where, m.rates, model.decay_rate, delta, m.phi, m.decay)
        propagate_covariance(model.where, m.phi, m.decay, model.noise, delta, m.p, m.half)
        propagate_estimate(model.where, m.phi, m.decay, m.x, m.half)
        if keep:
            propagate_product(model.where, m.phi, m.decay, m.product, m.half)
        if counted:
            _white_of_many(m, model)
        if number[N_GAP] > 0.0:
            # A force and a turn that last for GAP_TIME at a time
            for i in range(3):
                m.p[VELOCITY + i, VELOCITY + i] += (
                    model.parameters[P_GAP_ACCELERATION] ** 2 * GAP_TIME * delta
                )
                m.p[ATTITUDE + i, ATTITUDE + i] += (
                    model.parameters[P_GAP_RATE] ** 2 * GAP_TIME * delta
                )
    begin_substep(m)


@numba.njit(cache=True, nogil=True)
def _white_of_many(m: Memory, model: Model) -> None:
    """White noise and known input of samples that were counted within the substep."""
    number = m.numbers
    a = model.where[I_CORRECTION]
    white = model.parameters[P_BARO_WHITE] / number[N_GAINS]
    where = (_D, _VD, a)
    for i in range(3):
        m.x[where[i]] += number[N_KNOWN + i]
        for j in range(3):
            m.p[where[i], where[j]] += number[N_GAIN + i] * number[N_GAIN + j] * white


@numba.njit(cache=True, nogil=True)
def begin_substep(m: Memory) -> None:
    """Forget the averages, and note where the substep begins."""
    number = m.numbers
    number[N_FROM] = number[N_NOW]
    number[N_LATITUDE] = m.nav[LATITUDE]
    number[N_HEIGHT] = m.nav[HEIGHT]
    number[N_GAINS] = 0.0
    for i in range(3):
        number[N_VELOCITY + i] = m.nav[V_NORTH + i]
        number[N_GAIN + i] = 0.0
        number[N_KNOWN + i] = 0.0
        for j in range(3):
            m.mean_c[i, j] = 0.0
            m.mean_cf[i, j] = 0.0


@numba.njit(cache=True, nogil=True)
def open_instant(m: Memory, model: Model, stored: Stored, row: int, keep: bool) -> None:
    """Bring the filter to the present for a measurement, if that is not done yet."""
    if m.numbers[N_OPEN] > 0.0:
        return
    close_substep(m, model, keep)
    n = m.p.shape[0]
    for i in range(n):
        m.dx[i] = 0.0
    if keep:
        for i in range(n):
            for j in range(n):
                stored.transition[row, i, j] = m.product[i, j]
                stored.before[row, i, j] = m.p[i, j]
    m.numbers[N_OPEN] = 1.0


@numba.njit(cache=True, nogil=True)
def close_instant(m: Memory, model: Model, stored: Stored, row: int, keep: bool) -> int:
    """Feed back, store a row; return the number of rows then."""
    number = m.numbers
    if number[N_OPEN] == 0.0:
        return row
    number[N_OPEN] = 0.0
    number[N_INSTANT_AT] = number[N_NOW]
    d_height = 0.0
    if model.parameters[P_CLOSED] > 0.0:
        d_height = m.x[_D]
        _feed_back(m, model)
    if number[N_STEP_SET] > 0.0:
        # The channel thought that all of the difference would go out of the height.
        m.channel[S_STEP] += number[N_STEP] - d_height
        number[N_STEP_SET] = 0.0
    begin_substep(m)
    if not keep:
        return row
    n = m.p.shape[0]
    for i in range(n):
        stored.correction[row, i] = m.dx[i]
        stored.estimate[row, i] = m.x[i]
        for j in range(n):
            stored.after[row, i, j] = m.p[i, j]
            m.product[i, j] = 1.0 if i == j else 0.0
    for i in range(m.nav.shape[0]):
        stored.nav[row, i] = m.nav[i]
    for i in range(9):
        stored.sensors[row, i] = m.sensors[i]
    stored.sensors[row, 9] = m.channel[S_CORRECTION]
    stored.sensors[row, 10] = m.channel[S_BARO_BIAS]
    stored.time[row] = number[N_NOW]
    stored.update[row] = int(number[N_UPDATES])
    stored.restart[row] = number[N_BEGUN]
    number[N_BEGUN] = 0.0
    return row + 1


@numba.njit(cache=True, nogil=True)
def corrected(nav: FloatArray, x: FloatArray, out: FloatArray) -> None:
    """A navigation with the estimated errors taken off, into another."""
    rm, rn = radii(nav[LATITUDE], nav[HEIGHT])
    across = rn * cos(nav[LATITUDE])
    lon = nav[LONGITUDE] - x[POSITION + 1] / across
    if lon > pi:
        lon -= 2.0 * pi
    elif lon <= -pi:
        lon += 2.0 * pi
    out[LATITUDE] = nav[LATITUDE] - x[POSITION] / rm
    out[LONGITUDE] = lon
    out[HEIGHT] = nav[HEIGHT] + x[_D]
    for i in range(3):
        out[V_NORTH + i] = nav[V_NORTH + i] - x[VELOCITY + i]
    pw, px, py, pz = increment_quaternion(x[ATTITUDE], x[ATTITUDE + 1], x[ATTITUDE + 2], 0)
    w = nav[Q_W]
    a = nav[Q_W + 1]
    b = nav[Q_W + 2]
    c = nav[Q_W + 3]
    out[Q_W] = pw * w - px * a - py * b - pz * c
    out[Q_W + 1] = pw * a + px * w + py * c - pz * b
    out[Q_W + 2] = pw * b - px * c + py * w + pz * a
    out[Q_W + 3] = pw * c + px * b - py * a + pz * w


@numba.njit(cache=True, nogil=True)
def _feed_back(m: Memory, model: Model) -> None:
    """Navigation, sensors and network by what was estimated, which then is 0."""
    index = model.where
    x = m.x
    corrected(m.nav, x, m.nav)
    gyro = index[I_GYRO_BIAS]
    factor_at = index[I_ACCEL_SCALE]
    bias = index[I_ACCEL_BIAS]
    for i in range(3):
        m.sensors[i] += x[gyro + i]
        m.sensors[6 + i] += x[bias + i]
        x[gyro + i] = 0.0
        x[bias + i] = 0.0
        if factor_at >= 0:
            m.sensors[3 + i] += x[factor_at + i]
            x[factor_at + i] = 0.0
    b = index[I_BARO]
    if b >= 0:
        m.channel[S_BARO_BIAS] += x[b]
        x[b] = 0.0
    a = index[I_CORRECTION]
    if model.parameters[P_NETWORK] > 0.0:
        d_a = -x[a] if a >= 0 else 0.0
        channel_feedback(m.channel, m.numbers[N_NOW], x[_D], x[_VD], d_a)
        if a >= 0:
            x[a] = 0.0
    for i in range(9):
        x[i] = 0.0


@numba.njit(cache=True, nogil=True)
def clear_rows(m: Memory, rows: int) -> None:
    """H of no entries."""
    for i in range(rows):
        for j in range(m.h.shape[1]):
            m.h[i, j] = 0.0


@numba.njit(cache=True, nogil=True)
def begin_anew(m: Memory, model: Model) -> None:
    """Covariance as at the start; navigation and sensors stay, GNSS errors are forgotten."""
    n = m.p.shape[0]
    for i in range(n):
        for j in range(n):
            m.p[i, j] = model.p0[i, j]
    first = model.where[I_GNSS_POSITION]
    if first >= 0:
        for i in range(first, n):
            m.x[i] = 0.0
    for i in range(ROWS):
        m.ratio[i] = 1.0
    m.numbers[N_WINDOW] = 0.0
    m.numbers[N_REJECTED] = 0.0
    m.numbers[N_RESTARTS] += 1.0
    m.numbers[N_BEGUN] = 1.0


@numba.njit(cache=True, nogil=True)
def correction_row(m: Memory, model: Model) -> None:
    """The network's correction, which is known and ought to be 0."""
    a = model.where[I_CORRECTION]
    clear_rows(m, 1)
    m.h[0, a] = 1.0
    m.nu[0] = m.channel[S_CORRECTION] - m.x[a]
    m.r[0] = model.parameters[P_CORRECTION_VARIANCE]
    project(m, 1)
    apply_measurement(m, 1, 0.0)


@numba.njit(cache=True, nogil=True)
def baro_difference(
    m: Memory,
    model: Model,
    events: FloatArray,
    count: IntArray,
    difference: float,
    age: float,
    variance: float,
    patience: int,
) -> bool:
    """Height less barometric height, so long ago, as a measurement.

    Not used where it is further off than the gate. When `patience` of them in a row were,
    the barometer's reference is moved. Returns whether it was used.
    """
    b = model.where[I_BARO]
    number = m.numbers
    clear_rows(m, 1)
    m.h[0, _D] = -1.0
    m.h[0, _VD] = age
    m.h[0, b] = -1.0
    m.nu[0] = difference + m.x[_D] - age * m.x[_VD] + m.x[b]
    m.r[0] = max(variance, LEAST_BARO_SIGMA * LEAST_BARO_SIGMA)
    project(m, 1)
    limit = model.parameters[P_BARO_GATE]
    if m.nu[0] * m.nu[0] > limit * limit * (m.s[0, 0] + m.r[0]):
        number[N_ROW_STREAK] += 1.0
        if number[N_ROW_STREAK] < patience:
            return False
        move_reference(m, model, m.nu[0])
        record(events, count, E_BARO_JUMP, number[N_NOW], -m.nu[0])
        number[N_ROW_STREAK] = 0.0
        return False
    number[N_ROW_STREAK] = 0.0
    apply_measurement(m, 1, 0.0)
    return True


@numba.njit(cache=True, nogil=True)
def move_reference(m: Memory, model: Model, difference: float) -> None:
    """Shift the barometer by a difference, and forget what was known of its error."""
    b = model.where[I_BARO]
    m.channel[S_OFFSET] += difference
    for j in range(m.p.shape[0]):
        m.p[b, j] = 0.0
        m.p[j, b] = 0.0
    m.p[b, b] = model.parameters[P_BARO_SIGMA] ** 2 + m.p[_D, _D]
    m.numbers[N_BEGUN] = 1.0


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
        if number[N_OPEN] == 0.0:
            close_substep(m, model, keep)
    else:
        open_instant(m, model, stored, stored_row, keep)

    rows = _compare(m, model, fix, back, moved, diagnosis)
    diagnosis[D_ROWS] = rows
    diagnosis[D_WITHHELD] = 1.0 if withheld else 0.0
    diagnosis[D_USED] = 0.0
    diagnosis[D_GATED] = 0.0
    diagnosis[D_RESTARTED] = 0.0
    diagnosis[D_NIS] = np.nan
    if rows == 0:
        return
    project(m, rows)
    if par[P_ADAPTIVE] > 0.0 and not withheld:
        _adapt(m, model, rows)
    _spread(m, rows, diagnosis)
    if not factor(m.s, m.r, rows, m.root):
        return
    nis = normalised_square(m.root, m.nu, rows, m.gain[:, 0])
    diagnosis[D_NIS] = nis
    if withheld:
        return
    if par[P_CLOSED] == 0.0 and number[N_FAR] == 0.0:
        _warn_if_far(m, events, count)
    if nis > par[P_GATES + rows]:
        number[N_REJECTED] += 1.0
        if par[P_RESTART_AFTER] == 0.0 or number[N_REJECTED] < par[P_RESTART_AFTER]:
            diagnosis[D_GATED] = 1.0
            number[N_EPOCHS_GATED] += 1.0
            record(events, count, E_GATED, number[N_NOW], nis)
            return
        record(events, count, E_RESTART, number[N_NOW], nis)
        diagnosis[D_RESTARTED] = 1.0
        begin_anew(m, model)
        rows = _compare(m, model, fix, back, moved, diagnosis)
        for i in range(6):
            # so far off, at least, is the navigation
            if diagnosis[D_INNOVATION + i] == diagnosis[D_INNOVATION + i]:
                off = diagnosis[D_INNOVATION + i] ** 2
                m.p[i, i] = max(m.p[i, i], off)
        project(m, rows)
        _spread(m, rows, diagnosis)
    number[N_REJECTED] = 0.0
    if apply_measurement(m, rows, par[P_EPSILON]):
        diagnosis[D_USED] = 1.0
        number[N_EPOCHS_USED] += 1.0
        number[N_USED_AT] = number[N_NOW]
        if diagnosis[D_RESTARTED] == 0.0:
            number[N_NIS_SUM] += nis
            number[N_NIS_ROWS] += rows


@numba.njit(cache=True, nogil=True)
def _compare(
    m: Memory,
    model: Model,
    fix: FloatArray,
    back: float,
    moved: FloatArray,
    diagnosis: FloatArray,
) -> int:
    """Innovation and H of a fix; how many rows it has."""
    par = model.parameters
    index = model.where
    number = m.numbers
    nav = m.nav
    gyro = index[I_GYRO_BIAS]
    eta = index[I_GNSS_POSITION]
    lx = par[P_LEVER]
    ly = par[P_LEVER + 1]
    lz = par[P_LEVER + 2]

    w = nav[Q_W]
    x = nav[Q_W + 1]
    y = nav[Q_W + 2]
    z = nav[Q_W + 3]
    c00 = w * w + x * x - y * y - z * z
    c01 = 2.0 * (x * y - w * z)
    c02 = 2.0 * (x * z + w * y)
    c10 = 2.0 * (x * y + w * z)
    c11 = w * w - x * x + y * y - z * z
    c12 = 2.0 * (y * z - w * x)
    c20 = 2.0 * (x * z - w * y)
    c21 = 2.0 * (y * z + w * x)
    c22 = w * w - x * x - y * y + z * z
    # Rate and arm when the fix was valid, the arm in the body axes of now
    rx = number[N_RATE] - back * moved[6]
    ry = number[N_RATE + 1] - back * moved[7]
    rz = number[N_RATE + 2] - back * moved[8]
    sx = ry * lz - rz * ly
    sy = rz * lx - rx * lz
    sz = rx * ly - ry * lx
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
    bn = oe * ad - od * ae
    be = od * an - on * ad
    bd = on * ae - oe * an

    clear_rows(m, ROWS)
    rows = 0
    for i in range(6):
        diagnosis[D_INNOVATION + i] = np.nan
        diagnosis[D_SIGMA + i] = np.nan
        diagnosis[D_MEASUREMENT + i] = np.nan
        if not np.isfinite(fix[i]):
            continue
        if i < 2 and not (np.isfinite(fix[0]) and np.isfinite(fix[1])):
            continue
        if i == 2 and not np.isfinite(fix[0]):
            continue
        if i == 0:
            value = (lat - fix[0]) * rm + an
            p0, p1, p2 = 0.0, -ad, ae
        elif i == 1:
            turn = lon - fix[1]
            if turn > pi:
                turn -= 2.0 * pi
            elif turn < -pi:
                turn += 2.0 * pi
            value = turn * across + ae
            p0, p1, p2 = ad, 0.0, -an
        elif i == 2:
            value = fix[2] - h + ad
            p0, p1, p2 = -ae, an, 0.0
        elif i == 3:
            value = nav[V_NORTH] - back * moved[3] + bn - fix[3]
            p0, p1, p2 = 0.0, -bd, be
        elif i == 4:
            value = nav[V_NORTH + 1] - back * moved[4] + be - fix[4]
            p0, p1, p2 = bd, 0.0, -bn
        else:
            value = nav[V_NORTH + 2] - back * moved[5] + bd - fix[5]
            p0, p1, p2 = -be, bn, 0.0
        m.h[rows, i] = 1.0
        m.h[rows, ATTITUDE] = p0
        m.h[rows, ATTITUDE + 1] = p1
        m.h[rows, ATTITUDE + 2] = p2
        if i < 3:
            m.h[rows, VELOCITY + i] = -back
        else:
            # -C [l x]
            if i == 3:
                r0, r1, r2 = c00, c01, c02
            elif i == 4:
                r0, r1, r2 = c10, c11, c12
            else:
                r0, r1, r2 = c20, c21, c22
            m.h[rows, gyro] = -(r1 * lz - r2 * ly)
            m.h[rows, gyro + 1] = -(r2 * lx - r0 * lz)
            m.h[rows, gyro + 2] = -(r0 * ly - r1 * lx)
        if eta >= 0:
            m.h[rows, eta + i] = -1.0
        for j in range(m.h.shape[1]):
            if m.h[rows, j] != 0.0:
                value -= m.h[rows, j] * m.x[j]
        m.nu[rows] = value
        m.r[rows] = m.ratio[i] * _white_variance(par, i, fix[6 + i], eta >= 0)
        diagnosis[D_INNOVATION + i] = value
        diagnosis[D_MEASUREMENT + i] = sqrt(m.r[rows])
        rows += 1
    return rows


@numba.njit(cache=True, nogil=True)
def _white_variance(par: FloatArray, i: int, sigma: float, slow_states: bool) -> float:
    """Variance of a row's white noise, from what the receiver says, if it does.

    A receiver speaks of all of its error. Where the slow part has states of its own, the rest
    is left for the white one; a receiver that claims less than the model has the model's share.
    """
    white = par[P_GNSS_WHITE + i]
    if not (np.isfinite(sigma) and sigma > 0.0):
        return white if slow_states else par[P_GNSS_ALL + i]
    square = sigma * sigma
    if not slow_states:
        return square
    slow = par[P_GNSS_MARKOV + i]
    if square >= white + slow:
        return square - slow
    return square * white / (white + slow)


@numba.njit(cache=True, nogil=True)
def _adapt(m: Memory, model: Model, rows: int) -> None:
    """Measurement variances from innovations; see DivergenceControl."""
    par = model.parameters
    number = m.numbers
    slot = int(number[N_WINDOW]) % m.window.shape[0]
    for i in range(ROWS):
        m.window[slot, i] = -1.0
    for k in range(rows):
        i = 0
        while m.h[k, i] != 1.0:
            i += 1
        given = m.r[k] / m.ratio[i]
        square = m.nu[k] * m.nu[k]
        m.window[slot, i] = square
        if par[P_ADAPTIVE] == 1.0:
            found = (square - m.s[k, k]) / given
            found = min(max(found, par[P_LEAST]), par[P_MOST])
            m.ratio[i] += (1.0 - par[P_FADING]) * (found - m.ratio[i])
        elif number[N_WINDOW] + 1.0 >= m.window.shape[0]:
            total = 0.0
            many = 0
            for j in range(m.window.shape[0]):
                if m.window[j, i] >= 0.0:
                    total += m.window[j, i]
                    many += 1
            found = (total / many - m.s[k, k]) / given
            m.ratio[i] = min(max(found, par[P_LEAST]), par[P_MOST])
        m.r[k] = given * m.ratio[i]
    number[N_WINDOW] += 1.0


@numba.njit(cache=True, nogil=True)
def _spread(m: Memory, rows: int, diagnosis: FloatArray) -> None:
    """Note what the innovations should be."""
    for k in range(rows):
        i = 0
        while m.h[k, i] != 1.0:
            i += 1
        diagnosis[D_SIGMA + i] = sqrt(m.s[k, k] + m.r[k])
        diagnosis[D_MEASUREMENT + i] = sqrt(m.r[k])


@numba.njit(cache=True, nogil=True)
def _warn_if_far(m: Memory, events: FloatArray, count: IntArray) -> None:
    """Without feedback: is the navigation still where a linear filter can correct it?"""
    x = m.x
    far = sqrt(x[POSITION] ** 2 + x[POSITION + 1] ** 2 + x[_D] ** 2)
    turned = sqrt(x[ATTITUDE] ** 2 + x[ATTITUDE + 1] ** 2 + x[ATTITUDE + 2] ** 2)
    if far > FAR or turned > FAR_ATTITUDE:
        m.numbers[N_FAR] = 1.0
        record(events, count, E_FAR, m.numbers[N_NOW], far)
