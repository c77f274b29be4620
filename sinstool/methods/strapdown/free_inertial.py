"""Attitude, velocity and position from ordered IMU blocks, for `process --mode ins`.

It runs the mechanisation, and a vertical channel that a barometer or GNSS heights may damp.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core import earth
from sinstool.core.parts import kernel
from sinstool.core.rotation import wrapped
from sinstool.core.streams import Imu, Solution
from sinstool.core.timeline import SECOND
from sinstool.methods.height import layout
from sinstool.methods.height.channel import baro_sample, propagate, smooth_height
from sinstool.methods.height.layout import ChannelSummary, Event
from sinstool.methods.height.phases import begin_anew
from sinstool.methods.height.reference import HeightReference
from sinstool.methods.height.vertical import MAX_GAP, MAX_HOLD, beginning_quickly
from sinstool.methods.strapdown.navigation import (
    HEIGHT,
    LATITUDE,
    LONGITUDE,
    Q_W,
    Q_Z,
    SIZE,
    V_DOWN,
    V_EAST,
    V_NORTH,
    advance,
    step,
)
from sinstool.methods.strapdown.segment_samples import SampleSettings, SegmentRun
from sinstool.methods.strapdown.velocity import Increments, IncrementStage

# Beyond these limits no vehicle goes: an undamped channel has diverged.
MAX_HEIGHT_M = 1e6
MAX_SPEED_M_S = 2e4


@dataclass(frozen=True, kw_only=True)
class InsSettings(SampleSettings):
    """Settings of an inertial navigation.

    Attributes
    ----------
    order : int
        Of the attitude's quaternion: 0 exact, 1 to 4 Picard's.
    parameters : ndarray or None
        Of the vertical channel; None leaves it undamped.
    reference : HeightReference or None
        Heights that damp the vertical channel.
    """

    order: int = 0
    parameters: np.ndarray | None = None
    reference: HeightReference | None = None


class InsRun(SegmentRun):
    """Inertial navigation from ordered samples.

    Parameters
    ----------
    state : ndarray, shape (SIZE,)
        At the first sample; see :func:`sinstool.methods.strapdown.navigation.initial_state`.

    Attributes
    ----------
    events : list of Event
        Of the vertical channel; times in s since the first sample.
    gaps_s : float
        Total length of the gaps that were bridged without data, s.
    diverged_ns : int or None
        Time from which the state is held because it has left the Earth, ns.
    """

    settings: InsSettings

    def __init__(self, state: np.ndarray, settings: InsSettings) -> None:
        super().__init__(settings)
        self.events: list[Event] = []
        self.gaps_s = 0.0
        self.diverged_ns: int | None = None
        self._state = state.copy()
        self._channel = layout.new_state()
        self._parameters = settings.parameters
        self._time = 0.0
        self._origin: int | None = None
        self._last: tuple[np.ndarray, np.ndarray] | None = None
        self._height = (np.empty(0),) * 3 + (np.empty(0, np.int64),)
        self._next_height = 0

    @property
    def channel(self) -> ChannelSummary:
        """Summary of the vertical channel."""
        return layout.summarise(self._channel)

    @property
    def first_ns(self) -> int:
        """Time that events count from."""
        return self._origin or 0

    def _begin(self, imu: Imu, gap_s: float) -> Solution:
        if self._origin is None:
            self._origin = int(imu.time_ns[0])
            self._take_reference(self._origin)
        if gap_s > 0.0:
            self._carry_over(imu, gap_s)
        self._stage = IncrementStage(self.settings.stage)
        self._time = (int(imu.time_ns[0]) - self._origin) / SECOND
        return self._solution(imu.rows(slice(0, 1)), self._row())

    def _push(self, imu: Imu, times: np.ndarray) -> Increments:
        self._last = (imu.gyro[-1], imu.accel[-1])
        return self._stage.push(imu.gyro, imu.accel, times)

    def _take_reference(self, origin: int) -> None:
        reference = self.settings.reference
        if reference is None:
            return
        later = reference.arrival_ns >= origin
        self._height = (
            (reference.arrival_ns[later] - origin) / SECOND,
            (reference.time_ns[later] - origin) / SECOND,
            np.ascontiguousarray(reference.height[later], dtype=np.float64),
            np.ascontiguousarray(reference.reason[later], dtype=np.int64),
        )

    def _carry_over(self, imu: Imu, gap_s: float) -> None:
        """Bring the state over a gap.

        In a short gap the vehicle is assumed to move with the mean rate and specific force of both
        sides; in a long one, to keep its attitude and velocity. After a very long one the vertical
        velocity is unknown, and the vertical channel starts again.
        """
        self.gaps_s += gap_s
        still = self.settings.still_until_ns
        if still is not None and int(imu.time_ns[0]) <= still:
            return
        if self.diverged_ns is not None:
            return
        s = self._state
        before = float(s[V_DOWN])
        if gap_s <= MAX_HOLD and self._last is not None:
            phi = 0.5 * (self._last[0] + imu.gyro[0]) * gap_s
            dv = 0.5 * (self._last[1] + imu.accel[0]) * gap_s
            step(s, *phi.tolist(), *dv.tolist(), gap_s, self.settings.order)  # type: ignore[call-arg]
            gained = before - float(s[V_DOWN])
        else:
            meridian, transverse = earth.radii_of_curvature(s[LATITUDE])
            north = float(s[V_NORTH]) * gap_s / (float(meridian) + s[HEIGHT])
            s[LATITUDE] = np.clip(s[LATITUDE] + north, -0.5 * np.pi, 0.5 * np.pi)
            across = (float(transverse) + s[HEIGHT]) * max(np.cos(s[LATITUDE]), 1e-9)
            longitude = s[LONGITUDE] + s[V_EAST] * gap_s / across
            s[LONGITUDE] = wrapped(longitude)
            s[HEIGHT] -= before * gap_s
            # the correction, which the channel is about to take off, is no motion either
            gained = float(self._channel[layout.S_CORRECTION]) * gap_s
            s[HEIGHT] += 0.5 * gained * gap_s
            s[V_DOWN] -= gained
        if self._parameters is None:
            return
        time = self._time + gap_s
        self.events.append(Event(layout.EVENT_KINDS[layout.EVENT_IMU_GAP], time, gap_s, 0.0))
        events = layout.new_events(0)
        self._channel[layout.S_EVENTS] = 0.0
        dh, dv_up = propagate(
            self._channel, self._parameters, events, time, gap_s, s[HEIGHT], -s[V_DOWN], gained
        )
        s[HEIGHT] += dh
        s[V_DOWN] -= dv_up
        self.events += layout.read_events(events[: int(self._channel[layout.S_EVENTS])])
        if gap_s > MAX_GAP:
            begin_anew(self._channel)
            self._parameters = beginning_quickly(self._parameters)

    def _advance(self, increments: Increments, taken: Imu) -> Solution:
        # Heights use the stamps, even where the rate of the user runs ahead of them.
        time_ns = taken.time_ns
        out = np.empty((len(increments.sample), SIZE + 2))
        until = self.settings.still_until_ns
        still = 0 if until is None else int(np.searchsorted(time_ns, until, "right"))
        out[:still] = self._row()
        if still:
            # samples from before the vehicle moved say nothing about how it moved
            at_rest = (int(time_ns[still - 1]) - (self._origin or 0)) / SECOND
            skipped = int(np.searchsorted(self._height[0], at_rest, "right"))
            self._next_height = max(self._next_height, skipped)
        if still < len(out):
            self._navigate(increments, still, time_ns[still:], out)
        return self._solution(taken, out)

    def _navigate(
        self, increments: Increments, first: int, time_ns: np.ndarray, out: np.ndarray
    ) -> None:
        settings = self.settings
        end = (time_ns - (self._origin or 0)) / SECOND
        damped = self._parameters is not None
        parameters = self._parameters if damped else np.zeros(layout.PARAMETERS)
        events = layout.new_events(len(self._height[0]) - self._next_height if damped else 0)
        self._channel[layout.S_EVENTS] = 0.0
        self._next_height, ran_away = navigate(
            self._state,
            np.empty(SIZE),
            self._channel,
            parameters,
            events,
            damped,
            increments.rotation_vector[first:],
            increments.velocity_increment[first:],
            increments.interval[first:],
            end,
            *self._height,
            self._next_height,
            settings.order,
            self.diverged_ns is not None,
            out[first:],
        )
        if ran_away >= 0:
            self.diverged_ns = int(time_ns[ran_away])
        self._time = float(end[-1])
        self.events += layout.read_events(events[: int(self._channel[layout.S_EVENTS])])

    def _row(self) -> np.ndarray:
        """The state as the kernel would write it."""
        height = smooth_height(self._channel, self._time, self._state[HEIGHT])
        return np.array([*self._state, height, self._channel[layout.S_CORRECTION]])[None, :]

    def _solution(self, imu: Imu, rows: np.ndarray) -> Solution:
        position = rows[:, LATITUDE : HEIGHT + 1].copy()
        vertical = None
        if self.settings.parameters is not None:
            position[:, 2] = rows[:, SIZE]
            vertical = np.stack([rows[:, SIZE], -rows[:, V_DOWN], rows[:, SIZE + 1]], axis=1)
        return Solution(
            imu.time_ns,
            imu.log_time_ns,
            rows[:, Q_W : Q_Z + 1],
            imu.gyro,
            imu.accel,
            position,
            rows[:, V_NORTH : V_DOWN + 1],
            vertical,
        )


@kernel()
def navigate(  # type: ignore[no-untyped-def]
    state,
    held,
    channel,
    parameters,
    events,
    damped,
    phi,
    dv,
    dt,
    end,
    arrival,
    stamp,
    height,
    reason,
    next_height,
    order,
    gone,
    out,
):
    """Mechanisation and vertical channel over a block.

    Parameters
    ----------
    state : ndarray, shape (SIZE,)
        Advanced in place; see :func:`sinstool.methods.strapdown.navigation.initial_state`.
    held : ndarray, shape (SIZE,)
        Room for the state before an update.
    channel, parameters, events : ndarray
        Of the vertical channel; see :mod:`sinstool.methods.height.layout`.
    damped : bool
        Whether the channel corrects the state.
    phi, dv : ndarray, shape (n, 3)
        Rotation vectors, rad, and velocity increments, m/s.
    dt, end : ndarray, shape (n,)
        Durations, and the times of the ends, s.
    arrival, stamp, height, reason : ndarray, shape (m,)
        Of the height samples: s, s, m, and why one is not to be used.
    next_height : int
        The first of them that was not used yet.
    order : int
        Of the attitude's quaternion; see :mod:`sinstool.core.quaternion_kernels`.
    gone : bool
        Whether the state left the Earth before: it is held then.
    out : ndarray, shape (n, SIZE + 2)
        Gets the state at the end of every update, the smooth height and the correction.

    Returns
    -------
    next_height : int
    ran_away : int
        The update at which the state left the Earth, or -1.
    """
    ran_away = -1
    for k in range(out.shape[0]):
        if not gone:
            for i in range(SIZE):
                held[i] = state[i]
            before = state[V_DOWN]
            advance(state, phi, dv, dt, k, order)
            if damped:
                h, v = state[HEIGHT], -state[V_DOWN]
                dh, ddv = propagate(channel, parameters, events, end[k], dt[k], h, v, v + before)
                h += dh
                v += ddv
                while next_height < arrival.shape[0] and arrival[next_height] <= end[k]:
                    _, dh, ddv = baro_sample(
                        channel,
                        parameters,
                        events,
                        end[k],
                        h,
                        v,
                        stamp[next_height],
                        height[next_height],
                        reason[next_height],
                    )
                    h += dh
                    v += ddv
                    next_height += 1
                state[HEIGHT] = h
                state[V_DOWN] = -v
            speed = abs(state[V_NORTH]) + abs(state[V_EAST]) + abs(state[V_DOWN])
            if not (abs(state[HEIGHT]) < MAX_HEIGHT_M and speed < MAX_SPEED_M_S):
                ran_away = k
                gone = True
                for i in range(SIZE):
                    state[i] = held[i]
                state[V_NORTH] = 0.0
                state[V_EAST] = 0.0
                state[V_DOWN] = 0.0
        for i in range(SIZE):
            out[k, i] = state[i]
        out[k, SIZE] = smooth_height(channel, end[k], state[HEIGHT])
        out[k, SIZE + 1] = channel[layout.S_CORRECTION]
    return next_height, ran_away
