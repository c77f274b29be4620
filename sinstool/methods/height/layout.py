"""Data of a vertical channel as arrays: its state, its parameters, its events.

Compiled loops take flat arrays of numbers. This module defines the index of each number, makes the
arrays, and turns the events and the state that come out into named values. The kernels are in
:mod:`~sinstool.methods.height.channel`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.methods.height.network import HeightNetwork
from sinstool.methods.sensor_errors import Grade

# --- phases -------------------------------------------------------------------------------
INIT, ENGAGED, COAST = 0, 1, 2
PHASES = ("init", "engaged", "coast")

# --- what became of a barometer sample ----------------------------------------------------
ACCEPTED, NOT_FINITE, OUT_OF_RANGE, STAMP, GATE, FROZEN, WAITING = range(7)
REASONS = ("accepted", "not_finite", "out_of_range", "stamp", "gate", "frozen", "waiting")
"""In order: accepted; NaN or infinite; outside the range of air pressures; stamped no later than
the sample before; too far from the inertial height; repeated by a frozen sensor; held back until
the next sample confirms it, before (re-)engaging."""

# What a sample did that a filter around the channel must know (see channel.baro_sample).
NOTHING, CORRECTED, RESET, JUMPED, RESTORED = range(5)

# --- events -------------------------------------------------------------------------------
(
    EVENT_ENGAGED,
    EVENT_COAST,
    EVENT_REENGAGED,
    EVENT_JUMP,
    EVENT_FROZEN,
    EVENT_INVALID,
    EVENT_IMU_GAP,
    EVENT_RETURNED,
) = range(8)
EVENT_KINDS = ("engaged", "coast", "re-engaged", "jump", "frozen", "invalid", "imu-gap", "returned")
EVENT_WIDTH = 4

# --- state --------------------------------------------------------------------------------
S_PHASE = 0
S_CORRECTION = 1  # A, m/s^2, taken off the upward acceleration
S_OFFSET = 2  # of absorbed jumps, added to the barometric height, m
S_BARO_BIAS = 3  # a filter's estimate, taken off the barometric height, m
S_LAST_USED = 4  # stamp of the sample accepted last, s
S_LAST_STAMP = 5  # of the sample looked at last, s
S_SQUARE = 6  # mean square of accepted differences, m^2
S_STREAK = 7  # rejected in a row, agreeing with each other
S_STREAK_SINCE = 8
S_STREAK_SUM = 9
S_COAST_SINCE = 10
S_INVALID = 11  # 1 while the coast is too long for the height to mean anything
S_STEP = 12  # height taken out of the output slowly, m, at the time S_STEP_TIME
S_STEP_TIME = 13
S_ENGAGED_AT = 14
S_SHADOW_H = 15
S_SHADOW_V = 16
S_SHADOW_A = 17
S_SAME_VALUE = 18  # barometric height that repeats, and since when
S_SAME_SINCE = 19
S_WITNESS_ON = 20
S_WITNESS_SINCE = 21
S_WITNESS_START = 22
S_WITNESS_H = 23
S_WITNESS_V = 24
S_WITNESS_A = 25
S_FROZEN = 26
S_WAITING = 27  # 1 where a sample waits to be confirmed; its difference and stamp
S_WAITING_E = 28
S_WAITING_STAMP = 29
S_L1 = 30  # gains that the sample last accepted was used with
S_L2 = 31
S_L3 = 32
S_INNOVATION = 33  # e of the sample looked at last, m
S_NOMINAL = 34  # median interval of the samples, s; 0 before there is one
S_EVENTS = 35  # number of events so far, recorded or not
S_RECENT = 36  # mean of accepted differences over the last second, m
S_WITNESS_MOST = 37
S_WITNESS_OFFSET = 38
S_CHANGES = 39  # of the barometer's value, and the longest it stayed the same before one, s
S_LONGEST = 40
S_SAME_LAST = 41  # stamp of the latest sample with the value that repeats
S_COUNTS = 42  # seven, by REASONS
S_TIMES = 49  # three, seconds in each phase
S_INTERVALS = 52  # number, then a ring of the latest
INTERVALS = 9
S_HISTORY = S_INTERVALS + 1 + INTERVALS  # number, then a ring of (time, height, v_up)
HISTORY = 128
S_TAKEN = S_HISTORY + 1 + 3 * HISTORY  # height that re-engaging removed last, m
S_ABSORBED = S_TAKEN + 1  # and the jump that was absorbed last
STATE_SIZE = S_ABSORBED + 1

# --- parameters ---------------------------------------------------------------------------
P_TAU = 0
P_K4 = 1
P_W2 = 2
P_SHADOW_TAU = 3  # 0: no shadow channel
P_SHADOW_K4 = 4
P_GATE = 5
P_GATE_SIGMAS = 6
P_START_TAU = 7
P_START_SPEED = 8
PARAMETERS = 9

SHADOW_TAU: dict[str, float] = {
    "consumer": 10.0,
    "mems": 10.0,
    "industrial": 15.0,
    "tactical": 30.0,
    "navigation": 60.0,
}
"""Time constant of the shadow channel for each grade of IMU, s."""

GATE_SIGMAS = 5.0
"""Differences up to this multiple of their running RMS are never rejected."""

START_SQUARE = 9.0
"""Initial mean square of the differences, m^2 (3 m)."""


def new_state() -> FloatArray:
    """State of a channel that has seen nothing.

    Returns
    -------
    ndarray, shape (STATE_SIZE,)
        Plain numbers: copy it to keep it.
    """
    state = np.zeros(STATE_SIZE)
    state[S_LAST_USED] = -np.inf
    state[S_LAST_STAMP] = -np.inf
    state[S_SAME_VALUE] = np.nan
    state[S_SQUARE] = START_SQUARE
    return state


def new_parameters(
    network: HeightNetwork,
    grade: Grade = "mems",
    *,
    baro_lag: float = 0.0,
    shadow: bool = True,
    gate: float = 8.0,
) -> FloatArray:
    """Parameters of a channel.

    Parameters
    ----------
    network : HeightNetwork
        ``k4`` with the lag of the barometer already taken off.
    grade : {"consumer", "mems", "industrial", "tactical", "navigation"}, optional
        Sets the time constant of the shadow channel.
    baro_lag : float, optional
        Known first-order lag of the barometer, s, which the shadow channel cancels as well.
    shadow : bool, optional
        Keep a shadow channel, and coast from it. Set to False for a channel that a filter
        corrects: the filter estimates the same errors better, and must apply every change itself.
    gate : float, optional
        Differences up to this are never rejected, m.

    Returns
    -------
    ndarray, shape (PARAMETERS,)
    """
    p = np.zeros(PARAMETERS)
    p[P_TAU], p[P_K4], p[P_W2] = network.tau, network.k4, network.w2
    # A shadow that is faster than the channel itself would be noisier, not quieter.
    p[P_SHADOW_TAU] = max(SHADOW_TAU[grade], network.tau) if shadow else 0.0
    p[P_SHADOW_K4] = -baro_lag
    p[P_GATE], p[P_GATE_SIGMAS], p[P_START_SPEED] = gate, GATE_SIGMAS, 1.0
    p[P_START_TAU] = network.tau
    return p


def new_events(baro_samples: int, steps: int = 0) -> FloatArray:
    """Room for all events that so many barometer samples (and IMU steps) can cause.

    Parameters
    ----------
    baro_samples : int
        A sample can cause two events; it can be followed by a coast that becomes invalid.
    steps : int, optional
        IMU steps that may be gaps: only the standalone channel records these.

    Returns
    -------
    ndarray, shape (n, 4)
        Rows of kind, time, and two values: see :class:`Event`.
    """
    return np.empty((4 * baro_samples + steps + 4, EVENT_WIDTH))


@dataclass(frozen=True)
class Event:
    """Something that happened to a vertical channel.

    Attributes
    ----------
    kind : str
        One of ``EVENT_KINDS``.
    time : float
        On the channel's clock, s.
    size : float
        engaged: offset of the barometer then, m; coast: time since the last good sample, s;
        re-engaged: height removed, m; jump: how far the barometer jumped, m; returned: how far it
        came back, and the height with it, m; frozen: height given back, m; invalid: length of
        the coast so far, s; imu-gap: its length, s.
    duration : float
        re-engaged: length of the coast, s; jump: time it took to be sure, s; frozen: how long
        the value has not changed, s; otherwise 0.
    """

    kind: str
    time: float
    size: float
    duration: float


def read_events(rows: FloatArray) -> list[Event]:
    """Recorded events as named values.

    Parameters
    ----------
    rows : ndarray, shape (n, 4)
        The filled part of an event array.
    """
    return [Event(EVENT_KINDS[int(kind)], t, size, span) for kind, t, size, span in rows.tolist()]


@dataclass(frozen=True)
class ChannelSummary:
    """Counts and last state of a run of a vertical channel.

    Attributes
    ----------
    phase : str
        ``init``, ``engaged`` or ``coast``, now.
    samples : dict of int
        Number of barometer samples by ``REASONS``.
    seconds : dict of float
        Time in each phase.
    correction : float
        A, m/s^2.
    offset : float
        Shift of the barometer by absorbed jumps, m.
    difference_rms : float
        Of recent accepted samples, m.
    """

    phase: str
    samples: dict[str, int]
    seconds: dict[str, float]
    correction: float
    offset: float
    difference_rms: float


def summarise(state: FloatArray) -> ChannelSummary:
    """Counts and last state of a channel, for reports.

    Parameters
    ----------
    state : ndarray, shape (STATE_SIZE,)
    """
    counts = state[S_COUNTS : S_COUNTS + len(REASONS)]
    times = state[S_TIMES : S_TIMES + len(PHASES)]
    return ChannelSummary(
        phase=PHASES[int(state[S_PHASE])],
        samples={name: int(count) for name, count in zip(REASONS, counts, strict=True)},
        seconds={name: float(time) for name, time in zip(PHASES, times, strict=True)},
        correction=float(state[S_CORRECTION]),
        offset=float(state[S_OFFSET]),
        difference_rms=float(np.sqrt(state[S_SQUARE])),
    )
