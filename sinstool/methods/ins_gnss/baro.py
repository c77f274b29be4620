"""Barometer in an INS/GNSS filter: through the damping network, or as a measurement.

The vertical channel decides which samples move the navigation; the filter has a say, as it knows
how good both heights are, and keeps its covariance true to what was done.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import part
from sinstool.methods.height import layout as height_layout
from sinstool.methods.height.channel import baro_sample
from sinstool.methods.height.channel import feedback as channel_feedback
from sinstool.methods.ins_gnss import instants, layout
from sinstool.methods.ins_gnss.layout import Memory, Model
from sinstool.methods.ins_gnss.model import baro_correction
from sinstool.methods.ins_gnss.states import I_BARO, I_CORRECTION, POSITION, VELOCITY
from sinstool.methods.ins_gnss.update import apply_measurement, project
from sinstool.methods.strapdown.navigation import HEIGHT, V_DOWN

_D = POSITION + 2
_VD = VELOCITY + 2

LEAST_BARO_SIGMA = 0.05  # m, of a row: no barometer is free of noise
# Consecutive differences that are rejected before the reference is taken to have moved
JUMP_ROWS: Any = np.int64(5)
FAST_BARO = 0.05  # s: faster samples act on the covariance together, at the substep's end
LEAST_BARO_GATE = 3.0  # m: samples closer than this are never unlikely
JUMPS_APART = 30.0  # s between jumps of a barometer that is sound otherwise
DOUBT = 0.25  # of a jump


@part()
def correction_row(m: Memory, model: Model) -> None:
    """Measurement row of the network's correction, which is known and should be 0."""
    a = model.where[I_CORRECTION]
    instants.clear_rows(m, layout.ONE_ROW)
    m.h[0, a] = 1.0
    m.nu[0] = m.channel[height_layout.S_CORRECTION] - m.x[a]
    m.r[0] = model.correction_variance
    project(m, layout.ONE_ROW)
    apply_measurement(m, layout.ONE_ROW, 0.0)


@part()
def baro_difference(
    m: Memory,
    model: Model,
    events: FloatArray,
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
    instants.clear_rows(m, layout.ONE_ROW)
    m.h[0, _D] = -1.0
    m.h[0, _VD] = age
    m.h[0, b] = -1.0
    m.nu[0] = difference + m.x[_D] - age * m.x[_VD] + m.x[b]
    m.r[0] = max(variance, LEAST_BARO_SIGMA * LEAST_BARO_SIGMA)
    project(m, layout.ONE_ROW)
    limit = model.baro_gate
    if m.nu[0] * m.nu[0] > limit * limit * (m.s[0, 0] + m.r[0]):
        streak = m.row_streak + 1.0
        m.row_streak = streak
        if streak < patience:
            return False
        move_reference(m, model, m.nu[0])
        instants.record(m, events, layout.E_BARO_JUMP, -m.nu[0])
        m.row_streak = 0.0
        return False
    m.row_streak = 0.0
    apply_measurement(m, layout.ONE_ROW, 0.0)
    return True


@part()
def move_reference(m: Memory, model: Model, difference: float) -> None:
    """Shift the barometer by a difference, and reset the covariance of its error."""
    b = model.where[I_BARO]
    m.channel[height_layout.S_OFFSET] += difference
    for j in range(m.n):
        m.p[b, j] = 0.0
        m.p[j, b] = 0.0
    m.p[b, b] = model.baro_sigma**2 + m.p[_D, _D]
    m.begun = 1.0


@part()
def note_difference(m: Memory, stamp: float, height: float, reason: int) -> None:
    """Compare height and barometric height; of several samples within an update, the last."""
    if reason != height_layout.ACCEPTED or not np.isfinite(height) or not stamp > m.sample_stamp:
        return
    age = m.now - stamp
    used = height + m.channel[height_layout.S_OFFSET] - m.channel[height_layout.S_BARO_BIAS]
    m.sample = 1.0
    m.sample_stamp = stamp
    m.sample_age = age
    m.sample_difference = m.nav[HEIGHT] + m.nav[V_DOWN] * age - used


@part()
def _unlikely(m: Memory, model: Model, stamp: float, height: float) -> bool:
    """Whether a sample that the channel would use contradicts the filter.

    The channel's gate alone would let a sensor that hangs drag the height along while the
    filter, sure of it, turns the fixes down.
    """
    channel = m.channel
    b = model.where[I_BARO]
    v_up = -m.nav[V_DOWN]
    used = height + channel[height_layout.S_OFFSET] - channel[height_layout.S_BARO_BIAS]
    e = m.nav[HEIGHT] - v_up * (m.now - stamp) - used
    gate = max(
        model.network[height_layout.P_GATE],
        model.network[height_layout.P_GATE_SIGMAS] * sqrt(channel[height_layout.S_SQUARE]),
    )
    if abs(e + model.k4 * v_up) > gate:
        return False  # the channel's own affair: a jump perhaps
    variance = m.p[_D, _D] + 2.0 * m.p[_D, b] + m.p[b, b] + model.baro_white
    e += m.x[_D] + m.x[b]
    return e * e > max(LEAST_BARO_GATE**2, model.baro_gate**2 * variance)


@part()
def network_sample(
    m: Memory,
    model: Model,
    stored: FloatArray,
    events: FloatArray,
    channel_events: FloatArray,
    stamp: float,
    height: float,
    reason: int,
) -> None:
    """Process a barometer sample in the damping network, with its effect on the errors."""
    channel = m.channel
    nav = m.nav
    phase = int(channel[height_layout.S_PHASE])
    before = channel[height_layout.S_CORRECTION]
    offset = channel[height_layout.S_OFFSET]
    now = m.now
    v_up = -nav[V_DOWN]
    # A filter that knows what K4 does keeps the height right, and so e at K4 v_up: no jump.
    model.network[height_layout.P_GATE] = model.channel_gate + abs(model.k4 * v_up)
    if reason == height_layout.ACCEPTED and (
        now < m.distrust or (phase == height_layout.ENGAGED and _unlikely(m, model, stamp, height))
    ):
        reason = height_layout.GATE
    what, dh, dw = baro_sample(
        channel, model.network, channel_events, now, nav[HEIGHT], v_up, stamp, height, reason
    )
    if what == height_layout.NOTHING:
        return
    if what == height_layout.RESTORED:
        # The witness does not know of fixes: where some were used, their navigation stays.
        instants.close_substep(m, model)
        off = before - channel[height_layout.S_CORRECTION]
        instants.record(m, events, layout.E_BARO_FROZEN, dh)
        if m.used_at > channel[height_layout.S_WITNESS_SINCE]:
            channel_feedback(channel, now, -dh, -dw, off)
        else:
            nav[HEIGHT] += dh
            nav[V_DOWN] -= dw
        a = model.where[I_CORRECTION]
        m.p[_D, _D] += dh * dh
        m.p[_VD, _VD] += dw * dw
        m.p[a, a] += off * off
        instants.begin_substep(m)
        return
    if phase != height_layout.ENGAGED:
        # The channel would set the height to the barometer. The filter knows how good both are.
        channel_feedback(channel, now, -dh, -dw, 0.0)
        instants.open_instant(m, model, stored)
        difference = channel[height_layout.S_INNOVATION] - model.k4 * v_up
        used = baro_difference(m, model, events, difference, 0.0, model.baro_white, layout.ONE_ROW)
        if not used:
            after_jump(m, model)
        if phase == height_layout.COAST:
            m.step = dh
            m.step_set = 1.0
        instants.close_instant(m, model, stored)
        return

    nav[HEIGHT] += dh
    nav[V_DOWN] -= dw
    k4_height = model.k4 * v_up
    if (
        what == height_layout.CORRECTED
        and channel[height_layout.S_NOMINAL] < FAST_BARO
        and now > m.from_time
    ):
        for i in range(3):
            gain = channel[height_layout.S_L1 + i]
            m.gains[i] += gain
            m.inputs[i] += gain * k4_height
        m.gain_count += 1.0
        return
    instants.close_substep(m, model)
    if what == height_layout.JUMPED:
        b = model.where[I_BARO]
        # It is known as well as the mean of the differences that showed it; whether the
        # barometer is to be relied on after that, is not.
        mean = (channel[height_layout.S_SQUARE] + model.baro_white) / JUMP_ROWS
        doubt = DOUBT * (channel[height_layout.S_OFFSET] - offset)
        m.p[b, b] += mean + model.baro_sigma**2 + doubt * doubt
        after_jump(m, model)
        instants.record(m, events, layout.E_BARO_JUMP, offset - channel[height_layout.S_OFFSET])
    baro_correction(
        model.where,
        channel[height_layout.S_L1],
        channel[height_layout.S_L2],
        channel[height_layout.S_L3],
        k4_height,
        model.baro_white,
        m.p,
        m.x,
        m.product,
        m.half[0],
    )


@part()
def after_jump(m: Memory, model: Model) -> None:
    """Jumps that follow each other, as of a sensor that hangs: leave it alone for a while.

    Up to the gate, navigation and network were pulled along between the jumps.
    """
    now = m.now
    if now - m.jump_at < JUMPS_APART:
        a = model.where[I_CORRECTION]
        gate = model.channel_gate
        rate = 1.0 / model.network[height_layout.P_TAU]
        m.p[_D, _D] += gate**2
        m.p[_VD, _VD] += (gate * rate) ** 2
        m.p[a, a] += (gate * rate * rate) ** 2
        m.distrust = now + JUMPS_APART
    m.jump_at = now
