"""The compiled loop of an INS/GNSS filter over IMU updates.

At each update: the mechanisation's step with sensor errors taken off; the vertical channel's
part; barometer samples; GNSS epochs that were valid since the update before, compared with the
navigation at their own time; the network's correction or baro differences as measurements where
they are due; feedback; output. Estimate and covariance follow in substeps.
"""

from __future__ import annotations

from math import ceil, cos, pi

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.parts import kernel, part
from sinstool.core.quaternion_kernels import dcm, wrapped_angle
from sinstool.methods.height.channel import propagate
from sinstool.methods.height.layout import S_BARO_BIAS
from sinstool.methods.ins_gnss import baro, instants, land_vehicle, layout, motion
from sinstool.methods.ins_gnss.gnss import gnss_epoch
from sinstool.methods.ins_gnss.layout import Memory, Model
from sinstool.methods.ins_gnss.model import errors_of, radii
from sinstool.methods.ins_gnss.motion import BRIDGE
from sinstool.methods.ins_gnss.output_line import write_line
from sinstool.methods.ins_gnss.states import ATTITUDE, I_BARO, I_GYRO_AXES, POSITION, VELOCITY
from sinstool.methods.strapdown.navigation import (
    HEIGHT,
    LATITUDE,
    LONGITUDE,
    Q_W,
    V_DOWN,
    V_NORTH,
    step,
)
from sinstool.methods.strapdown.velocity import remove_bias

MAX_ROW_INTERVAL = 1.25  # s, longest time between rows for a smoother
ROUNDING = 1e-7  # s, of times and intervals: they are whole nanoseconds


@kernel()
def run(
    m: Memory,
    model: Model,
    stored: FloatArray,
    window: FloatArray,
    changes: FloatArray,
    grid: FloatArray,
    time: FloatArray,
    interval: FloatArray,
    phi: FloatArray,
    dv: FloatArray,
    followed: FloatArray,
    lost: FloatArray,
    fix_time: FloatArray,
    fixes: FloatArray,
    withheld: FloatArray,
    baro_time: FloatArray,
    baro_height: FloatArray,
    baro_reason: IntArray,
    channel_events: FloatArray,
    events: FloatArray,
    diagnoses: FloatArray,
    out: FloatArray,
    counts: IntArray,
) -> None:
    """Filter a block of IMU updates.

    Parameters
    ----------
    m : Memory
        Changed.
    stored : ndarray
        Rows for a smoother, set if the memory says so.
    window : ndarray, shape (N, 6)
        Squares of innovations.
    changes : ndarray, shape (N or 0, 7)
        Of innovations over their sigma, squared and halved, and a column to sort in.
    grid : ndarray, shape (g, 4)
        Of a vehicle with constraints, by time; without points, it has none.
    time, interval : ndarray, shape (n,)
        End of each update and its duration, s.
    phi, dv : ndarray, shape (n, 3)
        Rotation vectors, rad, and velocity increments, m/s.
    followed : ndarray, shape (n, 3)
        Rates that swing the antenna at the end of each update, rad/s.
    lost : ndarray, shape (n, 6) or (0, 6)
        Variances of rotation vectors and velocity increments by lost samples.
    fix_time : ndarray, shape (f,)
        When GNSS epochs are valid, s, in order.
    fixes : ndarray, shape (f, 12)
        Latitude, longitude, height, velocity, and their standard deviations; NaN: not there.
    withheld : ndarray, shape (f,)
        Not 0: compare only.
    baro_time, baro_height : ndarray, shape (b,)
        s, in order of arrival, and m.
    baro_reason : ndarray of int64, shape (b,)
        See :func:`sinstool.methods.height.channel.baro_sample`.
    channel_events : ndarray
        Of the vertical channel.
    events : ndarray
        Of the filter.
    diagnoses : ndarray, shape (f, DIAGNOSTICS)
        A row for each epoch used up.
    out : ndarray, shape (n, OUTPUT) or (0, OUTPUT)
        Set, if it has rows.
    counts : ndarray of int64, shape (3,)
        Set: epochs and baro samples used up, epochs left out.
    """
    fix_next = 0
    baro_next = 0
    first_fix = 0
    constrained = grid.shape[0] > 0
    has_axes = model.where[I_GYRO_AXES] >= 0
    for k in range(len(time)):
        dt = interval[k]
        begin = time[k] - dt
        if m.started == 0.0:
            _begin(m, begin)
            motion.begin(m, dt, phi[k], dv[k], followed[k])
            while fix_next < len(fix_time) and fix_time[fix_next] < begin:
                fix_next += 1
                m.dropped += 1.0
            first_fix = fix_next
        gap = begin - m.now
        bridges = 0
        if gap > model.max_gap and gap > 0.5 * dt + ROUNDING:
            instants.record(m, events, layout.E_GAP_RESTART, gap)
            _carry_over(m, model, gap)
            motion.begin(m, dt, phi[k], dv[k], followed[k])
            while fix_next < len(fix_time) and fix_time[fix_next] < begin - dt:
                # Fixes within the gap do not show where the vehicle is after it
                diagnoses[fix_next, layout.D_ROWS] = 0.0
                fix_next += 1
        elif gap > 0.5 * dt + ROUNDING:
            bridges = ceil(gap / BRIDGE)
            instants.record(m, events, layout.E_GAP, gap)
            _close_side(m, model, stored, bridges)
            m.in_gap = 1.0
            motion.bridge_gap(m, gap, time, interval, phi, dv, k)

        for bridge in range(bridges + 1):
            # Remove sensor errors
            if bridge < bridges:
                d = gap / bridges
                px, py, pz, ux, uy, uz = motion.in_gap(m, d, dt)
                now = m.now + d
            else:
                if bridges > 0:
                    _close_side(m, model, stored, bridges)
                d = dt
                px, py, pz = phi[k, 0], phi[k, 1], phi[k, 2]
                ux, uy, uz = dv[k, 0], dv[k, 1], dv[k, 2]
                now = time[k]
            gx, gy, gz = errors_of(m.sensors, 0, 9, 12, d, px, py, pz)
            ax, ay, az = errors_of(m.sensors, 6, 3, 18, d, ux, uy, uz)
            px, py, pz, ux, uy, uz = remove_bias(px, py, pz, ux, uy, uz, gx, gy, gz, ax, ay, az)
            nav = m.nav
            w = nav[Q_W]
            x = nav[Q_W + 1]
            y = nav[Q_W + 2]
            z = nav[Q_W + 3]
            c00, c01, c02, c10, c11, c12, c20, c21, c22 = dcm(w, x, y, z)
            _integrate_row(m, 0, has_axes, c00, c01, c02, d, px, py, pz, ux, uy, uz)
            _integrate_row(m, 1, has_axes, c10, c11, c12, d, px, py, pz, ux, uy, uz)
            _integrate_row(m, 2, has_axes, c20, c21, c22, d, px, py, pz, ux, uy, uz)

            lat0 = nav[LATITUDE]
            lon0 = nav[LONGITUDE]
            h0 = nav[HEIGHT]
            vn0 = nav[V_NORTH]
            ve0 = nav[V_NORTH + 1]
            vd0 = nav[V_DOWN]
            step(nav[:], px, py, pz, ux, uy, uz, d, 0)
            if len(lost) > 0 and bridge == bridges and instants.uncertain(lost[k]):
                instants.lose_samples(m, lost[k], c00, c01, c02, c10, c11, c12, c20, c21, c22)
            m.now = now
            if model.has_network > 0.0:
                dh, dw = propagate(
                    m.channel,
                    model.network,
                    channel_events,
                    now,
                    d,
                    nav[HEIGHT],
                    -nav[V_DOWN],
                    vd0 - nav[V_DOWN],
                )
                nav[HEIGHT] += dh
                nav[V_DOWN] -= dw
            inverse = 1.0 / d

            share = model.baro_decay * d
            m.channel[S_BARO_BIAS] *= 1.0 - share + 0.5 * share * share
            while baro_next < len(baro_time) and baro_time[baro_next] <= now:
                _take_pressure(
                    m,
                    model,
                    stored,
                    events,
                    channel_events,
                    baro_time[baro_next],
                    baro_height[baro_next],
                    baro_reason[baro_next],
                )
                baro_next += 1

            # GNSS, and what is measured besides where it is due: with a fix rather than alone
            wait = model.row_interval - ROUNDING
            if fix_next < len(fix_time) and fix_time[fix_next] <= now:
                wait *= 0.5
            if m.sample > 0.0:
                m.sample = 0.0
                if now - m.baro_at >= wait:
                    m.baro_at = now
                    instants.open_instant(m, model, stored)
                    baro.baro_difference(
                        m,
                        model,
                        events,
                        m.sample_difference,
                        m.sample_age,
                        model.baro_white,
                        baro.JUMP_ROWS,
                    )
            if fix_next < len(fix_time) and fix_time[fix_next] <= now:
                turn = wrapped_angle(nav[LONGITUDE] - lon0)
                m.moved[0] = (nav[LATITUDE] - lat0) * inverse
                m.moved[1] = turn * inverse
                m.moved[2] = (nav[HEIGHT] - h0) * inverse
                m.moved[3] = (nav[V_NORTH] - vn0) * inverse
                m.moved[4] = (nav[V_NORTH + 1] - ve0) * inverse
                m.moved[5] = (nav[V_DOWN] - vd0) * inverse
                motion.swing_over(
                    m, d, dt, phi[k], followed[k], px, py, pz, bridges > 0, bridge == bridges
                )
                while fix_next < len(fix_time) and fix_time[fix_next] <= now:
                    gnss_epoch(
                        m,
                        model,
                        stored,
                        window,
                        changes,
                        events,
                        fixes[fix_next],
                        now - fix_time[fix_next],
                        withheld[fix_next] != 0.0,
                        diagnoses[fix_next],
                    )
                    fix_next += 1
            if constrained:
                land_vehicle.follow(m, d, px, py, pz, ux, uy, uz)
                due = model.vehicle[layout.V_INTERVAL] - ROUNDING
                if m.open > 0.0:
                    due *= 0.5
                if now - m.constrained_at >= due:
                    land_vehicle.constrain(m, model, stored, grid)
            if model.correction_row > 0.0 and now - m.row_at >= wait:
                m.row_at = now
                instants.open_instant(m, model, stored)
                baro.correction_row(m, model)
            _end_step(m, model, stored, now)

        motion.go_on(m, dt, phi[k], dv[k], followed[k])
        m.updates += 1.0

        if len(out) > 0:
            write_line(m, model, out[k], now, inverse, px, py, pz, ux, uy, uz)
    counts[0] = fix_next
    counts[1] = baro_next
    counts[2] = first_fix


@part(inline="always")
def _integrate_row(
    m: Memory,
    i: int,
    has_axes: bool,
    c0: float,
    c1: float,
    c2: float,
    d: float,
    px: float,
    py: float,
    pz: float,
    ux: float,
    uy: float,
    uz: float,
) -> None:
    """Add a step to row i of the substep's integrals: C_nb alone, times angle, times velocity."""
    mc = m.mean_c
    mc[i, 0] += d * c0
    mc[i, 1] += d * c1
    mc[i, 2] += d * c2
    mf = m.mean_cf
    mf[i, 0] += ux * c0
    mf[i, 1] += uy * c1
    mf[i, 2] += uz * c2
    mw = m.mean_cw
    mw[i, 0] += px * c0
    mw[i, 1] += py * c1
    mw[i, 2] += pz * c2
    if has_axes:
        ma = m.mean_axes
        ma[i, 0] += c0 * py
        ma[i, 1] += c0 * pz
        ma[i, 2] += c1 * px
        ma[i, 3] += c1 * pz
        ma[i, 4] += c2 * px
        ma[i, 5] += c2 * py
        ma[i, 6] += c0 * uy
        ma[i, 7] += c0 * uz
        ma[i, 8] += c1 * ux
        ma[i, 9] += c1 * uz
        ma[i, 10] += c2 * ux
        ma[i, 11] += c2 * uy


@part()
def _begin(m: Memory, begin: float) -> None:
    """Start at a time: nothing was measured before."""
    m.started = 1.0
    m.now = begin
    m.row_at = begin
    m.baro_at = begin
    m.constrained_at = begin
    m.used_at = -np.inf
    m.seen_at[0] = np.inf
    m.seen_at[1] = np.inf
    m.sample_stamp = -np.inf
    m.jump_at = -np.inf
    m.distrust = -np.inf
    m.restart_at = -np.inf
    m.latest_fix[0] = np.nan
    m.doubt = 1.0
    instants.begin_substep(m)


@part()
def _close_side(m: Memory, model: Model, stored: FloatArray, bridges: int) -> None:
    """End the motion on one side of a gap's beginning or end."""
    instants.close_substep(m, model)
    m.in_gap = 0.0
    if bridges > 1:
        # What a smoother corrects may be another thing on each side
        instants.open_instant(m, model, stored)
        instants.close_instant(m, model, stored)


@part()
def _take_pressure(
    m: Memory,
    model: Model,
    stored: FloatArray,
    events: FloatArray,
    channel_events: FloatArray,
    time: float,
    height: float,
    reason: int,
) -> None:
    """Give a sample of the barometer to the network, or note it as a measurement."""
    if model.has_network > 0.0:
        baro.network_sample(m, model, stored, events, channel_events, time, height, reason)
    if model.baro_row > 0.0:
        baro.note_difference(m, time, height, reason)


@part(inline="always")
def _end_step(m: Memory, model: Model, stored: FloatArray, now: float) -> None:
    """End an instant of measurements, or a substep that has lasted long enough."""
    instants.close_instant(m, model, stored)
    if now - m.instant_at >= MAX_ROW_INTERVAL - ROUNDING:
        # Nothing was measured; a smoother needs rows that are not far apart
        instants.open_instant(m, model, stored)
        instants.close_instant(m, model, stored)
    elif now - m.from_time >= model.substep - ROUNDING:
        instants.close_substep(m, model)


@part()
def _carry_over(m: Memory, model: Model, gap: float) -> None:
    """Carry the state straight over a gap too long to bridge, with large sigmas after it."""
    instants.close_substep(m, model)
    nav = m.nav
    rm, rn = radii(nav[LATITUDE], nav[HEIGHT])
    instants.begin_anew(m, model)
    nav[LATITUDE] += gap * nav[V_NORTH] / rm
    eastward = gap * nav[V_NORTH + 1] / (rn * cos(nav[LATITUDE]))
    nav[LONGITUDE] = wrapped_angle(nav[LONGITUDE] + eastward)
    speed2 = nav[V_NORTH] ** 2 + nav[V_NORTH + 1] ** 2 + nav[V_DOWN] ** 2
    force = model.gap_acceleration**2
    v2 = speed2 + force * gap
    r2 = v2 * gap * gap
    for i in range(3):
        m.p[POSITION + i, POSITION + i] += r2
        m.p[VELOCITY + i, VELOCITY + i] += v2
        rate = model.gap_tilt_rate if i < 2 else model.gap_rate
        m.p[ATTITUDE + i, ATTITUDE + i] += min(rate**2 * gap, 1.0)
    # A vehicle rolls and pitches to and fro, but may keep on turning
    m.p[ATTITUDE + 2, ATTITUDE + 2] += min((model.gap_rate * gap) ** 2, pi * pi / 3.0)
    b = model.where[I_BARO]
    if b >= 0:
        m.p[b, b] += model.baro_sigma**2 if m.p[b, b] == 0.0 else 0.0
    m.now += gap
    instants.begin_substep(m)
