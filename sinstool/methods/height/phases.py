"""Phases of the vertical channel: what begins and ends them, and the record of that."""

from __future__ import annotations

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import part
from sinstool.methods.height import layout

ROUNDING = 1e-9  # s, of differences of times


@part()
def record(
    state: FloatArray, events: FloatArray, kind: int, time: float, size: float, duration: float
) -> None:
    """Record an event; where the array is full it is only counted."""
    index = int(state[layout.S_EVENTS])
    if index < events.shape[0]:
        events[index, 0] = kind
        events[index, 1] = time
        events[index, 2] = size
        events[index, 3] = duration
    state[layout.S_EVENTS] += 1.0


@part()
def start_coast(state: FloatArray, time: float) -> None:
    """Go on without the barometer."""
    state[layout.S_PHASE] = layout.COAST
    state[layout.S_COAST_SINCE] = time
    state[layout.S_STREAK] = 0.0
    state[layout.S_WAITING] = 0.0
    state[layout.S_WITNESS_ON] = 0.0


@part()
def begin_anew(state: FloatArray) -> None:
    """Wait for the barometer as at the start, since the motion meanwhile is unknown."""
    state[layout.S_PHASE] = layout.INIT
    state[layout.S_WAITING] = 0.0
    state[layout.S_WITNESS_ON] = 0.0


@part()
def height_valid(state: FloatArray) -> bool:
    """Whether the height is valid: engaged, or coasting for no longer than 300 s."""
    return state[layout.S_PHASE] == layout.ENGAGED or (
        state[layout.S_PHASE] == layout.COAST and state[layout.S_INVALID] == 0.0
    )
