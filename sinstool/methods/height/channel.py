"""A vertical channel inside a mechanisation: its steps at IMU and barometer samples.

The host owns height and upward velocity and advances them free of any damping. The channel
owns the correction A and everything that decides whether a barometer is used::

    host advances height, v_up by one step          (NED: v_up = -v_down)
    dh, dv = propagate(state, parameters, events, time, dt, height, v_up, dv_up)
    height += dh;  v_up += dv
    for every barometer sample stamped up to time:
        what, dh, dv = baro_sample(state, parameters, events, time, height, v_up, ...)
        height += dh;  v_up += dv
    out = smooth_height(state, time, height)

Phases: INIT until two samples agree, ENGAGED, and COAST where no sample was good for a while.
A coast does not start from the current correction, which holds the noise of the barometer, but
from that of a *shadow channel*: the same network with a longer time constant, fed with the same
acceleration. A *witness* (:mod:`.frozen`) tells a frozen sensor from a vehicle at rest.

Times are seconds on one clock, chosen by the host. All functions are compiled, take and return
scalars, and allocate nothing; the arrays are those of :mod:`~sinstool.methods.height.layout`.
"""

from __future__ import annotations

import math

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import part
from sinstool.methods.height import layout
from sinstool.methods.height.frozen import (
    NOW_FROZEN,
    STILL_FROZEN,
    check_frozen,
    return_to_witness,
)
from sinstool.methods.height.history import at_stamp, note_interval, remember, shift_history
from sinstool.methods.height.network import pole_matched_gains
from sinstool.methods.height.phases import ROUNDING, record, start_coast

GATE_MEMORY = 30.0  # s, time constant of the running RMS of accepted differences
RECENT = 1.0  # s, time constant of their running mean, which is subtracted from a jump
JUMP_SAMPLES = 5  # consecutive rejected samples that agree make a jump of the barometer
JUMP_TIME = 0.75  # s, and they span at least this long
# m, and they agree to this: a barometer that still moves has not jumped yet.
LEVEL = 4.0
COAST_TIME = 2.0  # s without a good sample before a coast
COAST_INTERVALS = 5.0  # or this many usual intervals, whichever is longer
# With a slow barometer the sample that confirms a jump comes just as the coast would begin.
COAST_INTERVALS_STREAK = 7.0
VALID_COAST = 300.0  # s
# What the height drifts by in a coast, as an acceleration, m/s^2: cheap sensors in a tilted body
# are off by less. A larger difference after it is a jump of the barometer.
DRIFT = 1.0
STEP_FADE = 20.0  # s
# A growing time constant is the time since the start over this. With tau = t/g the error of the
# height goes as t^m, m the largest root of (m - 2) ((m + 3g) (m - 1) + 3g^2) + g^3: -0.8 for 6,
# but for 4 it is positive.
GROWTH = 6.0


@part()
def propagate(
    state: FloatArray,
    parameters: FloatArray,
    events: FloatArray,
    time: float,
    dt: float,
    height: float,
    v_up: float,
    dv_up: float,
) -> tuple[float, float]:
    """Take part in one IMU step.

    Parameters
    ----------
    state, parameters, events : ndarray
        See :mod:`~sinstool.methods.height.layout`; state and events are changed.
    time : float
        At the end of the step, s.
    dt : float
        Length of the step, s.
    height, v_up : float
        The host's at the end of the step, m and m/s, not yet corrected over this step.
    dv_up : float
        What the step added to v_up, m/s, gravity at the host's height included.

    Returns
    -------
    d_height, d_v_up : float
        To be added to the host's height and upward velocity.
    """
    correction = state[layout.S_CORRECTION]
    dh = -0.5 * correction * dt * dt
    dv = -correction * dt
    phase = int(state[layout.S_PHASE])
    state[layout.S_TIMES + phase] += dt
    before = height - (v_up - 0.5 * dv_up) * dt  # the host's height when the step began

    if phase == layout.ENGAGED and parameters[layout.P_SHADOW_TAU] > 0.0:
        # Same acceleration, but gravity at its own height.
        v = state[layout.S_SHADOW_V]
        pull = (
            parameters[layout.P_W2] * (state[layout.S_SHADOW_H] - before) - state[layout.S_SHADOW_A]
        )
        faster = v + dv_up + pull * dt
        state[layout.S_SHADOW_H] += 0.5 * (v + faster) * dt
        state[layout.S_SHADOW_V] = faster
    if state[layout.S_WITNESS_ON] > 0.0:
        v = state[layout.S_WITNESS_V]
        pull = (
            parameters[layout.P_W2] * (state[layout.S_WITNESS_H] - before)
            - state[layout.S_WITNESS_A]
        )
        faster = v + dv_up + pull * dt
        state[layout.S_WITNESS_H] += 0.5 * (v + faster) * dt
        state[layout.S_WITNESS_V] = faster

    if phase == layout.ENGAGED:
        silent = time - state[layout.S_LAST_USED]
        intervals = COAST_INTERVALS if state[layout.S_STREAK] == 0.0 else COAST_INTERVALS_STREAK
        if silent > max(COAST_TIME, intervals * state[layout.S_NOMINAL]) + ROUNDING:
            record(state, events, layout.EVENT_COAST, time, silent, 0.0)
            if parameters[layout.P_SHADOW_TAU] > 0.0:
                dv = state[layout.S_SHADOW_V] - v_up
                state[layout.S_CORRECTION] = state[layout.S_SHADOW_A]
            start_coast(state, time)
    elif phase == layout.COAST:
        length = time - state[layout.S_COAST_SINCE]
        if length > VALID_COAST and state[layout.S_INVALID] == 0.0:
            state[layout.S_INVALID] = 1.0
            record(state, events, layout.EVENT_INVALID, time, length, 0.0)

    remember(state, time, height + dh, v_up + dv)
    return dh, dv


@part()
def baro_sample(
    state: FloatArray,
    parameters: FloatArray,
    events: FloatArray,
    time: float,
    height: float,
    v_up: float,
    stamp: float,
    height_baro: float,
    reason: int,
) -> tuple[int, float, float]:
    """Take a barometer sample.

    Parameters
    ----------
    state, parameters, events : ndarray
        See :mod:`~sinstool.methods.height.layout`; state and events are changed.
    time : float
        Of the host's height and velocity, s.
    height, v_up : float
        The host's, corrected so far, m and m/s.
    stamp : float
        When the sample was measured, s. A sample up to half a second late is compared, and
        corrects, at its own time; a later one is compared with the height extrapolated back to its
        stamp, and corrects at `time`.
    height_baro : float
        Barometric height, m, as computed from the pressure. The channel's own offset and a
        filter's estimate of the bias are in the state, and must not be applied to it.
    reason : int
        ACCEPTED, or one of the other reasons where the caller knows that the sample is unusable.

    Returns
    -------
    what : int
        NOTHING; CORRECTED with the gains in ``state[S_L1:S_L3 + 1]``; RESET of the height to
        the barometer, gains (1, 0, 0); JUMPED, corrected after the barometer's offset was
        changed; RESTORED, as the barometer is frozen: height, velocity and correction A are
        those of the witness.
    d_height, d_v_up : float
        To be added to the host's height and upward velocity. The correction A is changed in the
        state.
    """
    if reason == layout.ACCEPTED and not math.isfinite(height_baro):
        reason = layout.NOT_FINITE
    elif reason == layout.ACCEPTED and not (
        math.isfinite(stamp) and stamp > state[layout.S_LAST_STAMP]
    ):
        reason = layout.STAMP
    if reason != layout.ACCEPTED:
        state[layout.S_COUNTS + reason] += 1.0
        return layout.NOTHING, 0.0, 0.0
    note_interval(state, stamp)

    repeats = check_frozen(state, parameters, time, height, v_up, stamp, height_baro)
    if repeats == NOW_FROZEN:
        return return_to_witness(state, events, time, height, v_up, stamp)
    if repeats == STILL_FROZEN:
        state[layout.S_COUNTS + layout.FROZEN] += 1.0
        return layout.NOTHING, 0.0, 0.0
    h_then, v_then, lag = at_stamp(state, time, height, v_up, stamp)
    used = height_baro + state[layout.S_OFFSET] - state[layout.S_BARO_BIAS]
    e = h_then + parameters[layout.P_K4] * v_then - used
    state[layout.S_INNOVATION] = e
    gate = max(
        parameters[layout.P_GATE],
        parameters[layout.P_GATE_SIGMAS] * math.sqrt(state[layout.S_SQUARE]),
    )

    if state[layout.S_PHASE] != layout.ENGAGED:
        return _begin(state, parameters, events, time, height, v_up, stamp, e, gate)

    # The velocity at the start may be wrong: the height responds to a step of it with a peak of
    # 0.23 tau per m/s.
    since = stamp - state[layout.S_ENGAGED_AT]
    quick = parameters[layout.P_START_TAU]
    gate += 0.25 * parameters[layout.P_START_SPEED] * quick * math.exp(-0.5 * since / quick)
    what = layout.CORRECTED
    if abs(e) > gate:
        length = stamp - state[layout.S_STREAK_SINCE]
        if not _is_level(state, stamp, e):
            state[layout.S_COUNTS + layout.GATE] += 1.0
            return layout.NOTHING, 0.0, 0.0
        jump = state[layout.S_STREAK_SUM] / state[layout.S_STREAK] - state[layout.S_RECENT]
        if _undone(parameters, jump, state[layout.S_TAKEN]):
            # The height had followed the jump that this one takes back, and returns with it.
            record(state, events, layout.EVENT_RETURNED, time, -jump, length)
            return layout.RESET, _set_height(state, time, height, v_up, stamp, jump), 0.0
        state[layout.S_OFFSET] += jump
        state[layout.S_ABSORBED] = jump
        state[layout.S_TAKEN] = 0.0
        e -= jump
        used += jump
        record(state, events, layout.EVENT_JUMP, time, -jump, length)
        what = layout.JUMPED
    state[layout.S_STREAK] = 0.0

    interval = stamp - state[layout.S_LAST_USED]
    tau = min(parameters[layout.P_TAU], max(quick, since / GROWTH))
    l1, l2, l3 = pole_matched_gains(interval, tau, parameters[layout.P_K4], parameters[layout.P_W2])
    # The correction belongs to the stamp; since then it has moved on.
    dv = -(l2 + l3 * lag) * e
    dh = -(l1 + l2 * lag + 0.5 * l3 * lag * lag) * e
    state[layout.S_CORRECTION] += l3 * e
    state[layout.S_L1] = l1
    state[layout.S_L2] = l2
    state[layout.S_L3] = l3
    state[layout.S_SQUARE] += -math.expm1(-interval / GATE_MEMORY) * (
        e * e - state[layout.S_SQUARE]
    )
    state[layout.S_RECENT] += -math.expm1(-interval / RECENT) * (e - state[layout.S_RECENT])
    state[layout.S_LAST_USED] = stamp
    state[layout.S_COUNTS + layout.ACCEPTED] += 1.0

    if parameters[layout.P_SHADOW_TAU] > 0.0:
        v = state[layout.S_SHADOW_V] - (v_up - v_then)
        e = state[layout.S_SHADOW_H] - (height - h_then) - (state[layout.S_SHADOW_V] - v_up) * lag
        e += parameters[layout.P_SHADOW_K4] * v - used
        # It begins as fast as the channel itself, or it would need minutes to settle.
        tau = max(tau, min(parameters[layout.P_SHADOW_TAU], since / GROWTH))
        l1, l2, l3 = pole_matched_gains(
            interval, tau, parameters[layout.P_SHADOW_K4], parameters[layout.P_W2]
        )
        state[layout.S_SHADOW_H] -= (l1 + l2 * lag) * e
        state[layout.S_SHADOW_V] -= (l2 + l3 * lag) * e
        state[layout.S_SHADOW_A] += l3 * e
    shift_history(state, time, dh, dv)
    return what, dh, dv


@part()
def feedback(
    state: FloatArray, time: float, d_height: float, d_v_up: float, d_correction: float
) -> None:
    """Account for a filter's correction of the host: its changes of height, v_up and A.

    Late samples are compared with where the host would have been, so the past must follow; A
    is changed here.
    """
    state[layout.S_CORRECTION] += d_correction
    state[layout.S_SHADOW_A] += d_correction
    shift_history(state, time, d_height, d_v_up)


@part()
def smooth_height(state: FloatArray, time: float, height: float) -> float:
    """Height for the output: a step made on re-engaging fades with a time constant of 20 s."""
    if state[layout.S_STEP] == 0.0:
        return height
    return height + state[layout.S_STEP] * math.exp(-(time - state[layout.S_STEP_TIME]) / STEP_FADE)


@part()
def _begin(
    state: FloatArray,
    parameters: FloatArray,
    events: FloatArray,
    time: float,
    height: float,
    v_up: float,
    stamp: float,
    e: float,
    gate: float,
) -> tuple[int, float, float]:
    """Take a sample, off by `e`, before the start or in a coast; returns as `baro_sample`."""
    # |e| may be anything before the start and after a coast: let two samples agree.
    near = state[layout.S_PHASE] == layout.COAST and abs(e) <= gate
    if not near and state[layout.S_WAITING] > 0.0:
        apart = parameters[layout.P_START_SPEED] * (stamp - state[layout.S_WAITING_STAMP])
        near = abs(e - state[layout.S_WAITING_E]) <= gate + apart
    if not near:
        state[layout.S_WAITING] = 1.0
        state[layout.S_WAITING_E] = e
        state[layout.S_WAITING_STAMP] = stamp
        state[layout.S_COUNTS + layout.WAITING] += 1.0
        return layout.NOTHING, 0.0, 0.0
    if _too_far(state, parameters, stamp, e) and not _is_level(state, stamp, e):
        state[layout.S_COUNTS + layout.GATE] += 1.0
        return layout.NOTHING, 0.0, 0.0
    dh = _engage(state, parameters, events, time, height, v_up, stamp, e)
    state[layout.S_COUNTS + layout.ACCEPTED] += 1.0
    return layout.RESET if dh != 0.0 else layout.CORRECTED, dh, 0.0


@part()
def _engage(
    state: FloatArray,
    parameters: FloatArray,
    events: FloatArray,
    time: float,
    height: float,
    v_up: float,
    stamp: float,
    e: float,
) -> float:
    """Begin with a sample, or begin again: height or offset are set; return the height's change."""
    if state[layout.S_PHASE] == layout.INIT:
        state[layout.S_ENGAGED_AT] = stamp
        record(state, events, layout.EVENT_ENGAGED, time, state[layout.S_OFFSET], 0.0)
    else:
        if _undone(parameters, e, state[layout.S_ABSORBED]):
            # It is back from a jump that was absorbed: so is its offset.
            e += state[layout.S_ABSORBED]
            state[layout.S_OFFSET] -= state[layout.S_ABSORBED]
            state[layout.S_ABSORBED] = 0.0
        if _too_far(state, parameters, stamp, e):
            silent = stamp - state[layout.S_LAST_USED]
            state[layout.S_OFFSET] += e
            state[layout.S_ABSORBED] = e
            record(state, events, layout.EVENT_JUMP, time, -e, silent)
            e = 0.0
        else:
            length = time - state[layout.S_COAST_SINCE]
            record(state, events, layout.EVENT_REENGAGED, time, e, length)
    return _set_height(state, time, height, v_up, stamp, e)


@part()
def _is_level(state: FloatArray, stamp: float, e: float) -> bool:
    """Whether enough differences in a row, this one included, agree."""
    count = state[layout.S_STREAK]
    if count == 0.0 or abs(e - state[layout.S_STREAK_SUM] / count) > LEVEL:
        count = 0.0
        state[layout.S_STREAK_SINCE] = stamp
        state[layout.S_STREAK_SUM] = 0.0
    state[layout.S_STREAK] = count + 1.0
    state[layout.S_STREAK_SUM] += e
    long = stamp - state[layout.S_STREAK_SINCE] >= JUMP_TIME - ROUNDING
    return count + 1.0 >= JUMP_SAMPLES and long


@part()
def _too_far(state: FloatArray, parameters: FloatArray, stamp: float, e: float) -> bool:
    """Whether a difference after a coast is more than the height drifts by.

    A filter that corrects the host knows better how far its height may be off.
    """
    silent = stamp - state[layout.S_LAST_USED]
    most = parameters[layout.P_GATE] + 0.5 * DRIFT * silent * silent
    coasts = state[layout.S_PHASE] == layout.COAST and parameters[layout.P_SHADOW_TAU] > 0.0
    return coasts and abs(e) > most


@part()
def _undone(parameters: FloatArray, step: float, before: float) -> bool:
    """Whether a step undoes the one before; never where a filter corrects the host."""
    alone = parameters[layout.P_SHADOW_TAU] > 0.0 and before != 0.0
    return alone and abs(step + before) <= parameters[layout.P_GATE]


@part()
def _set_height(
    state: FloatArray, time: float, height: float, v_up: float, stamp: float, e: float
) -> float:
    """Take a difference out of the height; return its change."""
    dh = -e
    state[layout.S_L1] = 1.0
    if state[layout.S_PHASE] != layout.INIT:
        # The output stays where it is, and what the height loses fades.
        state[layout.S_STEP] = smooth_height(state, time, 0.0) + e
        state[layout.S_STEP_TIME] = time
        state[layout.S_TAKEN] = e if state[layout.S_PHASE] == layout.COAST else 0.0
    state[layout.S_L2] = 0.0
    state[layout.S_L3] = 0.0
    state[layout.S_PHASE] = layout.ENGAGED
    state[layout.S_INVALID] = 0.0
    state[layout.S_WAITING] = 0.0
    state[layout.S_STREAK] = 0.0
    state[layout.S_RECENT] = 0.0
    state[layout.S_LAST_USED] = stamp
    state[layout.S_SHADOW_H] = height + dh
    state[layout.S_SHADOW_V] = v_up
    state[layout.S_SHADOW_A] = state[layout.S_CORRECTION]
    shift_history(state, time, dh, 0.0)
    return dh
