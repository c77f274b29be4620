"""Barometer in an INS/GNSS filter: through the damping network, or as a measurement.

The vertical channel decides which samples move the navigation; the filter has a say, as it knows
how good both heights are, and keeps its covariance true to what was done.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numba
import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.methods.height import layout as height_layout
from sinstool.methods.height.channel import baro_sample
from sinstool.methods.height.channel import feedback as channel_feedback
from sinstool.methods.ins_gnss import instants, layout
from sinstool.methods.ins_gnss.layout import Memory, Model, Stored
from sinstool.methods.ins_gnss.model import baro_correction
from sinstool.methods.ins_gnss.states import I_BARO, I_CORRECTION, POSITION, VELOCITY
from sinstool.methods.ins_gnss.update import apply_measurement, project
from sinstool.methods.strapdown.navigation import HEIGHT, V_DOWN

_D = POSITION + 2
_VD = VELOCITY + 2

LEAST_BARO_SIGMA = 0.05  # m, of a row: no barometer is free of noise
# Differences turned down in a row, before the reference is said to have moved
JUMP_ROWS: Any = np.int64(5)
FAST_BARO = 0.05  # s: faster samples act on the covariance together, at the substep's end
LEAST_BARO_GATE = 3.0  # m: samples closer than this are never unlikely
JUMPS_APART = 30.0  # s between jumps of a barometer that is sound otherwise
DOUBT = 0.25  # of a jump


@numba.njit(cache=True, nogil=True)
def correction_row(m: Memory, model: Model) -> None:
    """The network's correction, which is known and ought to be 0."""
    a = model.where[I_CORRECTION]
    instants.clear_rows(m, layout.ONE_ROW)
    m.h[0, a] = 1.0
    m.nu[0] = m.channel[height_layout.S_CORRECTION] - m.x[a]
    m.r[0] = model.parameters[layout.P_CORRECTION_VARIANCE]
    project(m, layout.ONE_ROW)
    apply_measurement(m, layout.ONE_ROW, 0.0)


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
    instants.clear_rows(m, layout.ONE_ROW)
    m.h[0, _D] = -1.0
    m.h[0, _VD] = age
    m.h[0, b] = -1.0
    m.nu[0] = difference + m.x[_D] - age * m.x[_VD] + m.x[b]
    m.r[0] = max(variance, LEAST_BARO_SIGMA * LEAST_BARO_SIGMA)
    project(m, layout.ONE_ROW)
    limit = model.parameters[layout.P_BARO_GATE]
    if m.nu[0] * m.nu[0] > limit * limit * (m.s[0, 0] + m.r[0]):
        number[layout.N_ROW_STREAK] += 1.0
        if number[layout.N_ROW_STREAK] < patience:
            return False
        move_reference(m, model, m.nu[0])
        instants.record(events, count, layout.E_BARO_JUMP, number[layout.N_NOW], -m.nu[0])
        number[layout.N_ROW_STREAK] = 0.0
        return False
    number[layout.N_ROW_STREAK] = 0.0
    apply_measurement(m, layout.ONE_ROW, 0.0)
    return True


@numba.njit(cache=True, nogil=True)
def move_reference(m: Memory, model: Model, difference: float) -> None:
    """Shift the barometer by a difference, and forget what was known of its error."""
    b = model.where[I_BARO]
    m.channel[height_layout.S_OFFSET] += difference
    for j in range(m.p.shape[0]):
        m.p[b, j] = 0.0
        m.p[j, b] = 0.0
    m.p[b, b] = model.parameters[layout.P_BARO_SIGMA] ** 2 + m.p[_D, _D]
    m.numbers[layout.N_BEGUN] = 1.0


@numba.njit(cache=True, nogil=True)
def note_difference(m: Memory, stamp: float, height: float, reason: int) -> None:
    """Compare height and barometric height; of several samples within an update, the last."""
    number = m.numbers
    if (
        reason != height_layout.ACCEPTED
        or not np.isfinite(height)
        or not stamp > number[layout.N_SAMPLE_STAMP]
    ):
        return
    age = number[layout.N_NOW] - stamp
    used = height + m.channel[height_layout.S_OFFSET] - m.channel[height_layout.S_BARO_BIAS]
    number[layout.N_SAMPLE] = 1.0
    number[layout.N_SAMPLE_STAMP] = stamp
    number[layout.N_SAMPLE_AGE] = age
    number[layout.N_SAMPLE_DIFFERENCE] = m.nav[HEIGHT] + m.nav[V_DOWN] * age - used


@numba.njit(cache=True, nogil=True)
def _unlikely(m: Memory, model: Model, stamp: float, height: float) -> bool:
    """Whether the filter says of a sample that the channel would use: it cannot be so.

    The channel's gate alone would let a sensor that hangs drag the height along while the
    filter, sure of it, turns the fixes down.
    """
    channel = m.channel
    par = model.parameters
    b = model.where[I_BARO]
    v_up = -m.nav[V_DOWN]
    used = height + channel[height_layout.S_OFFSET] - channel[height_layout.S_BARO_BIAS]
    e = m.nav[HEIGHT] - v_up * (m.numbers[layout.N_NOW] - stamp) - used
    gate = max(
        model.network[height_layout.P_GATE],
        model.network[height_layout.P_GATE_SIGMAS] * sqrt(channel[height_layout.S_SQUARE]),
    )
    if abs(e + par[layout.P_K4] * v_up) > gate:
        return False  # the channel's own affair: a jump perhaps
    variance = m.p[_D, _D] + 2.0 * m.p[_D, b] + m.p[b, b] + par[layout.P_BARO_WHITE]
    e += m.x[_D] + m.x[b]
    return e * e > max(LEAST_BARO_GATE**2, par[layout.P_BARO_GATE] ** 2 * variance)


@numba.njit(cache=True, nogil=True)
def network_sample(
    m: Memory,
    model: Model,
    stored: Stored,
    row: int,
    keep: bool,
    stamp: float,
    height: float,
    reason: int,
    channel_events: FloatArray,
    events: FloatArray,
    count: IntArray,
) -> int:
    """A barometer sample for the damping network, and what it does to the errors."""
    number = m.numbers
    par = model.parameters
    channel = m.channel
    nav = m.nav
    phase = int(channel[height_layout.S_PHASE])
    before = channel[height_layout.S_CORRECTION]
    offset = channel[height_layout.S_OFFSET]
    now = number[layout.N_NOW]
    v_up = -nav[V_DOWN]
    # A filter that knows what K4 does keeps the height right, and so e at K4 v_up: no jump.
    model.network[height_layout.P_GATE] = par[layout.P_CHANNEL_GATE] + abs(par[layout.P_K4] * v_up)
    if reason == height_layout.ACCEPTED and (
        now < number[layout.N_DISTRUST]
        or (phase == height_layout.ENGAGED and _unlikely(m, model, stamp, height))
    ):
        reason = height_layout.GATE
    what, dh, dw = baro_sample(
        channel, model.network, channel_events, now, nav[HEIGHT], v_up, stamp, height, reason
    )
    if what == height_layout.NOTHING:
        return row
    if what == height_layout.RESTORED:
        # The witness does not know of fixes: where some were used, their navigation stays.
        instants.close_substep(m, model, keep)
        off = before - channel[height_layout.S_CORRECTION]
        instants.record(events, count, layout.E_BARO_FROZEN, now, dh)
        if number[layout.N_USED_AT] > channel[height_layout.S_WITNESS_SINCE]:
            channel_feedback(channel, now, -dh, -dw, off)
        else:
            nav[HEIGHT] += dh
            nav[V_DOWN] -= dw
        a = model.where[I_CORRECTION]
        m.p[_D, _D] += dh * dh
        m.p[_VD, _VD] += dw * dw
        m.p[a, a] += off * off
        instants.begin_substep(m)
        return row
    if phase != height_layout.ENGAGED:
        # The channel would set the height to the barometer. The filter knows how good both are.
        channel_feedback(channel, now, -dh, -dw, 0.0)
        instants.open_instant(m, model, stored, row, keep)
        difference = channel[height_layout.S_INNOVATION] - par[layout.P_K4] * v_up
        used = baro_difference(
            m, model, events, count, difference, 0.0, par[layout.P_BARO_WHITE], layout.ONE_ROW
        )
        if not used:
            _after_jump(m, model)
        if phase == height_layout.COAST:
            number[layout.N_STEP] = dh
            number[layout.N_STEP_SET] = 1.0
        return instants.close_instant(m, model, stored, row, keep)

    nav[HEIGHT] += dh
    nav[V_DOWN] -= dw
    k4_height = par[layout.P_K4] * v_up
    if (
        what == height_layout.CORRECTED
        and channel[height_layout.S_NOMINAL] < FAST_BARO
        and now > number[layout.N_FROM]
    ):
        for i in range(3):
            gain = channel[height_layout.S_L1 + i]
            number[layout.N_GAIN + i] += gain
            number[layout.N_INPUT + i] += gain * k4_height
        number[layout.N_GAINS] += 1.0
        return row
    instants.close_substep(m, model, keep)
    if what == height_layout.JUMPED:
        b = model.where[I_BARO]
        # It is known as well as the mean of the differences that showed it; whether the
        # barometer is to be relied on after that, is not.
        mean = (channel[height_layout.S_SQUARE] + par[layout.P_BARO_WHITE]) / JUMP_ROWS
        doubt = DOUBT * (channel[height_layout.S_OFFSET] - offset)
        m.p[b, b] += mean + par[layout.P_BARO_SIGMA] ** 2 + doubt * doubt
        _after_jump(m, model)
        instants.record(
            events, count, layout.E_BARO_JUMP, now, offset - channel[height_layout.S_OFFSET]
        )
    baro_correction(
        model.where,
        channel[height_layout.S_L1],
        channel[height_layout.S_L2],
        channel[height_layout.S_L3],
        k4_height,
        par[layout.P_BARO_WHITE],
        m.p,
        m.x,
        m.product,
        m.half[0],
    )
    return row


@numba.njit(cache=True, nogil=True)
def _after_jump(m: Memory, model: Model) -> None:
    """Jumps that follow each other, as of a sensor that hangs: leave it alone for a while.

    Up to the gate, navigation and network were pulled along between the jumps.
    """
    number = m.numbers
    now = number[layout.N_NOW]
    if now - number[layout.N_JUMP_AT] < JUMPS_APART:
        a = model.where[I_CORRECTION]
        gate = model.parameters[layout.P_CHANNEL_GATE]
        rate = 1.0 / model.network[height_layout.P_TAU]
        m.p[_D, _D] += gate**2
        m.p[_VD, _VD] += (gate * rate) ** 2
        m.p[a, a] += (gate * rate * rate) ** 2
        number[layout.N_DISTRUST] = now + JUMPS_APART
    number[layout.N_JUMP_AT] = now
