"""Whether a barometer is frozen: it repeats its value while the vehicle moves.

The *witness*, a height that is integrated without the barometer, tells a frozen sensor from a
vehicle at rest.
"""

from __future__ import annotations

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import part
from sinstool.methods.height import layout
from sinstool.methods.height.history import shift_history
from sinstool.methods.height.phases import ROUNDING, record, start_coast
from sinstool.methods.height.pressure import FROZEN_TIME

FROZEN_SPEED = 1.0  # m/s, mean vertical speed while a frozen sensor repeats its value
FROZEN_UNUSUAL = 5.0  # times as long as the sensor ever kept a value before
FROZEN_CHANGES = 20.0  # changes of its value before that longest time is known
FROZEN_SETTLED = 20.0  # s after engaging before a witness can be trusted
# What a sample shows.
NOT_FROZEN, STILL_FROZEN, NOW_FROZEN = 0, 1, 2


@part()
def check_frozen(
    state: FloatArray,
    parameters: FloatArray,
    time: float,
    height: float,
    v_up: float,
    stamp: float,
    height_baro: float,
) -> int:
    """Whether a sample shows that the sensor is frozen; watches how long it repeats its value.

    Parameters
    ----------
    state, parameters, time, height, v_up, stamp, height_baro
        See :func:`~sinstool.methods.height.channel.baro_sample`.

    Returns
    -------
    int
        NOT_FROZEN; STILL_FROZEN, as before; or NOW_FROZEN, for the first time.
    """
    if height_baro != state[layout.S_SAME_VALUE]:
        if state[layout.S_FROZEN] == 0.0 and state[layout.S_CHANGES] > 0.0:
            held = state[layout.S_SAME_LAST] - state[layout.S_SAME_SINCE]
            state[layout.S_LONGEST] = max(state[layout.S_LONGEST], held)
        state[layout.S_CHANGES] += 1.0
        state[layout.S_SAME_VALUE] = height_baro
        state[layout.S_SAME_SINCE] = stamp
        state[layout.S_WITNESS_ON] = 0.0
        state[layout.S_FROZEN] = 0.0
        state[layout.S_SAME_LAST] = stamp
    elif state[layout.S_FROZEN] > 0.0:
        return STILL_FROZEN
    elif (
        state[layout.S_PHASE] == layout.ENGAGED
        and stamp - state[layout.S_ENGAGED_AT] >= FROZEN_SETTLED
    ):
        state[layout.S_SAME_LAST] = stamp
        if state[layout.S_WITNESS_ON] > 0.0:
            moved = abs(state[layout.S_WITNESS_H] - state[layout.S_WITNESS_START])
            state[layout.S_WITNESS_MOST] = max(state[layout.S_WITNESS_MOST], moved)
            # A coarse or noiseless sensor also repeats its value at rest: the repetition must be
            # longer than is usual for this sensor.
            held = stamp - state[layout.S_SAME_SINCE]
            if (
                state[layout.S_WITNESS_MOST] > FROZEN_SPEED * FROZEN_TIME
                and held >= max(FROZEN_TIME, FROZEN_UNUSUAL * state[layout.S_LONGEST]) - ROUNDING
                and state[layout.S_CHANGES] >= FROZEN_CHANGES
            ):
                return NOW_FROZEN
            if time - state[layout.S_WITNESS_SINCE] >= FROZEN_TIME:
                state[layout.S_WITNESS_ON] = 0.0  # it drifts: a new one, below
        if state[layout.S_WITNESS_ON] == 0.0:
            _call_witness(state, parameters, time, height, v_up)
    return NOT_FROZEN


@part()
def _call_witness(
    state: FloatArray, parameters: FloatArray, time: float, height: float, v_up: float
) -> None:
    state[layout.S_WITNESS_ON] = 1.0
    state[layout.S_WITNESS_MOST] = 0.0
    state[layout.S_WITNESS_OFFSET] = state[layout.S_OFFSET]
    state[layout.S_WITNESS_SINCE] = time
    state[layout.S_WITNESS_START] = height
    state[layout.S_WITNESS_H] = height
    if parameters[layout.P_SHADOW_TAU] > 0.0:
        state[layout.S_WITNESS_V] = state[layout.S_SHADOW_V]
        state[layout.S_WITNESS_A] = state[layout.S_SHADOW_A]
    else:
        state[layout.S_WITNESS_V] = v_up
        state[layout.S_WITNESS_A] = state[layout.S_CORRECTION]


@part()
def return_to_witness(
    state: FloatArray, events: FloatArray, time: float, height: float, v_up: float, stamp: float
) -> tuple[int, float, float]:
    """Return to the witness, which the frozen sensor has not touched, and coast."""
    dh = state[layout.S_WITNESS_H] - height
    dv = state[layout.S_WITNESS_V] - v_up
    state[layout.S_CORRECTION] = state[layout.S_WITNESS_A]
    state[layout.S_OFFSET] = state[layout.S_WITNESS_OFFSET]
    state[layout.S_ABSORBED] = 0.0
    state[layout.S_FROZEN] = 1.0
    record(state, events, layout.EVENT_FROZEN, time, dh, stamp - state[layout.S_SAME_SINCE])
    start_coast(state, time)
    state[layout.S_COUNTS + layout.FROZEN] += 1.0
    shift_history(state, time, dh, dv)
    return layout.RESTORED, dh, dv
