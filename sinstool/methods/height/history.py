"""The last second of a vertical channel: its heights, and the rate of samples.

A barometer sample that comes late is compared with height and velocity at its own stamp, found
in a ring of past states. Compiled; the arrays are those of :mod:`~sinstool.methods.height.layout`.
"""

from __future__ import annotations

import math

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import part
from sinstool.methods.height import layout

MAX_AGE = 0.5  # s, up to which a late sample is used at its own time
HISTORY_SPACING = 0.005  # s: the ring reaches back further than MAX_AGE


@part()
def note_interval(state: FloatArray, stamp: float) -> None:
    """Add the interval since the last sample to a ring, and update the median of the ring."""
    interval = stamp - state[layout.S_LAST_STAMP]
    state[layout.S_LAST_STAMP] = stamp
    if not math.isfinite(interval):
        return
    number = int(state[layout.S_INTERVALS])
    state[layout.S_INTERVALS + 1 + number % layout.INTERVALS] = interval
    state[layout.S_INTERVALS] += 1.0
    filled = min(number + 1, layout.INTERVALS)
    # The value of middle rank, found by counting instead of sorting
    for i in range(filled):
        value = state[layout.S_INTERVALS + 1 + i]
        rank = 0
        for j in range(filled):
            other = state[layout.S_INTERVALS + 1 + j]
            if other < value or (other == value and j < i):
                rank += 1
        if rank == filled // 2:
            state[layout.S_NOMINAL] = value
            return


@part()
def remember(state: FloatArray, time: float, height: float, v_up: float) -> None:
    """Store height and velocity at a time, unless the last entry is less than 5 ms old."""
    number = int(state[layout.S_HISTORY])
    if number > 0:
        latest = layout.S_HISTORY + 1 + 3 * ((number - 1) % layout.HISTORY)
        if time - state[latest] < HISTORY_SPACING:
            return
    slot = layout.S_HISTORY + 1 + 3 * (number % layout.HISTORY)
    state[slot] = time
    state[slot + 1] = height
    state[slot + 2] = v_up
    state[layout.S_HISTORY] += 1.0


@part()
def shift_history(state: FloatArray, time: float, dh: float, dv: float) -> None:
    """Move the past along a line that meets a correction made at a time."""
    filled = min(int(state[layout.S_HISTORY]), layout.HISTORY)
    for i in range(filled):
        slot = layout.S_HISTORY + 1 + 3 * i
        state[slot + 1] += dh + dv * (state[slot] - time)
        state[slot + 2] += dv


@part()
def at_stamp(
    state: FloatArray, time: float, height: float, v_up: float, stamp: float
) -> tuple[float, float, float]:
    """Height and velocity at a stamp, and the time over which a correction must be propagated.

    The time is 0 for a sample that is too old, or newer than the state: it corrects at once.
    """
    age = time - stamp
    number = int(state[layout.S_HISTORY])
    filled = min(number, layout.HISTORY)
    if age <= 0.0 or age > MAX_AGE or filled == 0:
        return height - v_up * age, v_up, 0.0
    t1 = time
    h1 = height
    v1 = v_up
    for i in range(1, filled + 1):
        slot = layout.S_HISTORY + 1 + 3 * ((number - i) % layout.HISTORY)
        t0 = state[slot]
        h0 = state[slot + 1]
        v0 = state[slot + 2]
        if t0 <= stamp:
            span = t1 - t0
            if span <= 0.0:
                return h0, v0, age
            # cubic through both ends with their velocities
            s = (stamp - t0) / span
            rise = h1 - h0
            b = 3.0 * rise - span * (2.0 * v0 + v1)
            c = span * (v0 + v1) - 2.0 * rise
            return h0 + s * (span * v0 + s * (b + s * c)), v0 + s * (v1 - v0), age
        t1 = t0
        h1 = h0
        v1 = v0
    return height - v_up * age, v_up, age
