"""A separate vertical channel: height and vertical velocity from attitude and barometer.

Without a solution for horizontal motion, the upward specific force of an attitude solution, less
gravity, is integrated twice and tied to the barometer by the damping network. The correction A
absorbs the Coriolis and centripetal terms, 0.04 m/s^2 at 250 m/s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import ArrayLike, BoolArray, FloatArray, IntArray
from sinstool.core.earth import normal_gravity
from sinstool.core.parts import kernel
from sinstool.core.rotation import rotate
from sinstool.methods.height import layout
from sinstool.methods.height.channel import baro_sample, propagate, smooth_height
from sinstool.methods.height.layout import ChannelSummary, Event
from sinstool.methods.height.network import HeightNetwork, gravity_gradient
from sinstool.methods.height.phases import begin_anew, height_valid, record
from sinstool.methods.sensor_errors import Grade

MAX_HOLD = 0.5  # s between IMU samples over which the specific force can be held
MAX_GAP = 5.0  # s, after which the velocity is unknown and the channel starts again

START_TAU = 2.4  # s; the paper's, which settles within ten seconds
START_SPEED = 10.0  # m/s

# Index of each of the host's own numbers
_TIME, _HEIGHT, _V_UP, _F_UP, _STARTED = range(5)


def upward_specific_force(q_nb: ArrayLike, specific_force_b: ArrayLike) -> FloatArray:
    """Component of the specific force along the local vertical, up.

    Parameters
    ----------
    q_nb : array_like, shape (n, 4)
    specific_force_b : array_like, shape (n, 3)
        m/s^2.

    Returns
    -------
    ndarray, shape (n,)
        m/s^2; at rest it equals gravity.
    """
    return np.asarray(-rotate(q_nb, specific_force_b)[..., 2])


@dataclass(frozen=True)
class HeightColumns:
    """Height at IMU samples.

    Attributes
    ----------
    height : ndarray, shape (n,)
        m, without steps where the channel re-engaged.
    v_up : ndarray, shape (n,)
        Vertical velocity, m/s, up.
    correction : ndarray, shape (n,)
        A, taken off the upward acceleration, m/s^2.
    valid : ndarray of bool, shape (n,)
        False before the channel has engaged, and when it has coasted for too long.
    """

    height: FloatArray
    v_up: FloatArray
    correction: FloatArray
    valid: BoolArray


def beginning_quickly(parameters: FloatArray) -> FloatArray:
    """Parameters of a vertical channel whose velocity at the start is unknown.

    Its time constant begins short and grows to that of the network.

    Parameters
    ----------
    parameters : ndarray
        See :func:`sinstool.methods.height.layout.new_parameters`.

    Returns
    -------
    ndarray
    """
    quick = parameters.copy()
    quick[layout.P_START_TAU] = min(
        max(START_TAU, 2.0 * abs(quick[layout.P_K4])), quick[layout.P_TAU]
    )
    quick[layout.P_START_SPEED] = START_SPEED
    return quick


class VerticalChannel:
    """Height and vertical velocity from blocks of upward specific force and baro heights.

    The results are the same, bit for bit, wherever blocks end, as long as a barometer sample is
    pushed no later than the IMU samples that follow it.

    Parameters
    ----------
    network : HeightNetwork
        Its ``w2`` should be that of the latitude.
    latitude : float
        Geodetic, rad, for gravity; the correction absorbs the error of a wrong one.
    grade : {"consumer", "mems", "industrial", "tactical", "navigation"}, optional
    height, v_up : float, optional
        At the start, m and m/s. Once the channel engages, the height is the barometer's.
    baro_lag : float, optional
        Known first-order lag of the barometer, s; already taken off the network's ``k4``.
    point_samples : bool, optional
        Specific force is that at the instant of each sample (trapezoidal rule); otherwise the
        mean over the interval that the sample ends.
    quick_start : bool, optional
        Begin with a short time constant that grows, for a vertical velocity and an accelerometer
        bias that are unknown; otherwise the gains are the network's from the first sample on.

    Attributes
    ----------
    events : list of Event
        All so far, times in s since the first IMU sample.
    """

    def __init__(
        self,
        network: HeightNetwork,
        latitude: float,
        grade: Grade = "mems",
        *,
        height: float = 0.0,
        v_up: float = 0.0,
        baro_lag: float = 0.0,
        point_samples: bool = True,
        quick_start: bool = True,
    ) -> None:
        self.network = network
        self.events: list[Event] = []
        parameters = layout.new_parameters(network, grade, baro_lag=baro_lag)
        self._parameters = beginning_quickly(parameters) if quick_start else parameters
        self._state = layout.new_state()
        self._host = np.array([0.0, height, v_up, 0.0, 0.0])
        # gamma(h) = g0 + g1 h + g2 h^2 exactly, as normal_gravity is quadratic
        g0 = float(normal_gravity(latitude))
        g1 = -gravity_gradient(latitude)
        g2 = (float(normal_gravity(latitude, 1000.0)) - g0 - 1000.0 * g1) / 1e6
        self._gravity = np.array([g0, g1, g2])
        self._point = point_samples
        self._origin: int | None = None
        self._last_ns: int | None = None
        self._available: int | None = None  # up to which barometer samples have arrived
        self._pending: list[tuple[IntArray, IntArray, FloatArray, IntArray]] = []

    @property
    def summary(self) -> ChannelSummary:
        """Summary of the run so far."""
        return layout.summarise(self._state)

    def push(
        self,
        time_ns: ArrayLike,
        f_up: ArrayLike,
        baro_time_ns: ArrayLike = (),
        baro_height: ArrayLike = (),
        baro_reason: ArrayLike | None = None,
        baro_arrival_ns: ArrayLike | None = None,
    ) -> HeightColumns:
        """Advance over the next IMU samples.

        Parameters
        ----------
        time_ns : array_like of int, shape (n,)
            Of the IMU samples, increasing.
        f_up : array_like, shape (n,)
            :func:`upward_specific_force`, m/s^2.
        baro_time_ns : array_like of int, shape (m,), optional
            When barometer samples were measured, in order of arrival. Samples that are newer
            than the last IMU sample are kept for the next block.
        baro_height : array_like, shape (m,), optional
            m; see :mod:`~sinstool.methods.height.reference`.
        baro_reason : array_like of int, shape (m,), optional
            :func:`~sinstool.methods.height.pressure.pressure_reason`: 0 for samples to be used.
        baro_arrival_ns : array_like of int, shape (m,), optional
            When the samples became known, if they came late; by default when measured. A
            sample never overtakes one before it.

        Returns
        -------
        HeightColumns
            One row for each IMU sample.

        Raises
        ------
        ValueError
            If times do not increase or a specific force is not finite.
        """
        now = np.ascontiguousarray(time_ns, dtype=np.int64)
        force = np.ascontiguousarray(f_up, dtype=np.float64)
        if not np.all(np.isfinite(force)):
            raise ValueError("Expected `f_up` to be finite.")
        first = self._last_ns if self._last_ns is not None else now[0] - 1 if len(now) else 0
        if np.any(np.diff(now, prepend=first) <= 0):
            raise ValueError("Expected `time_ns` to increase.")
        self._take(baro_time_ns, baro_height, baro_reason, baro_arrival_ns)
        out = np.empty((len(now), 4))
        if not len(now):
            return _columns(out)
        if self._origin is None:
            self._origin = int(now[0])
        self._last_ns = int(now[-1])
        ready = self._ready(self._last_ns)
        events = layout.new_events(len(ready[0]), len(now))
        self._state[layout.S_EVENTS] = 0.0
        _run(
            self._state,
            self._parameters,
            events,
            self._host,
            self._gravity,
            self._point,
            self._seconds(now),
            force,
            self._seconds(ready[0]),
            self._seconds(ready[1]),
            ready[2],
            ready[3],
            out,
        )
        self.events += layout.read_events(events[: int(self._state[layout.S_EVENTS])])
        return _columns(out)

    def _seconds(self, time_ns: IntArray) -> FloatArray:
        assert self._origin is not None  # set by the first sample
        return np.asarray((time_ns - self._origin) * 1e-9)

    def _take(
        self,
        time: ArrayLike,
        height: ArrayLike,
        reason: ArrayLike | None,
        arrival: ArrayLike | None,
    ) -> None:
        stamps = np.asarray(time, dtype=np.int64)
        heights = np.asarray(height, dtype=np.float64)
        reasons = np.zeros(len(stamps), np.int64) if reason is None else np.asarray(reason)
        available = stamps if arrival is None else np.maximum(np.asarray(arrival, np.int64), stamps)
        if not len(stamps):
            return
        available = np.maximum.accumulate(available)
        if self._available is not None:
            available = np.maximum(available, self._available)
        self._available = int(available[-1])
        self._pending.append((available, stamps, heights, reasons.astype(np.int64)))

    def _ready(self, until: int) -> tuple[IntArray, IntArray, FloatArray, IntArray]:
        """Remove from the queue, and return, the barometer samples up to a time."""
        if not self._pending:
            none = np.empty(0, np.int64)
            return none, none, np.empty(0), none
        available, stamps, heights, reasons = (
            np.concatenate([part[i] for part in self._pending]) for i in range(4)
        )
        n = int(np.searchsorted(available, until, side="right"))
        rest = (available[n:], stamps[n:], heights[n:], reasons[n:])
        self._pending = [rest] if len(rest[0]) else []
        return available[:n], stamps[:n], heights[:n], reasons[:n]


def _columns(out: FloatArray) -> HeightColumns:
    return HeightColumns(out[:, 0], out[:, 1], out[:, 2], out[:, 3] > 0.0)


@kernel()
def _run(
    state: FloatArray,
    parameters: FloatArray,
    events: FloatArray,
    host: FloatArray,
    gravity: FloatArray,
    point: bool,
    time: FloatArray,
    f_up: FloatArray,
    available: FloatArray,
    stamps: FloatArray,
    heights: FloatArray,
    reasons: IntArray,
    out: FloatArray,
) -> None:
    h = host[_HEIGHT]
    v = host[_V_UP]
    next_baro = 0
    for k in range(time.shape[0]):
        t = time[k]
        if host[_STARTED] == 0.0:
            host[_STARTED] = 1.0
        else:
            dt = t - host[_TIME]
            middle = h + 0.5 * v * dt
            pull = gravity[0] + middle * (gravity[1] + middle * gravity[2])
            dv = ((0.5 * (f_up[k] + host[_F_UP]) if point else f_up[k]) - pull) * dt
            if dt > MAX_HOLD:
                # Nothing is known of the gap: assume no acceleration, and do not correct it.
                dv = state[layout.S_CORRECTION] * dt
                record(state, events, layout.EVENT_IMU_GAP, t, dt, 0.0)
                if dt > MAX_GAP:
                    begin_anew(state)
            h += (v + 0.5 * dv) * dt
            v += dv
            dh, ddv = propagate(state, parameters, events, t, dt, h, v, dv)
            h += dh
            v += ddv
        host[_TIME] = t
        host[_F_UP] = f_up[k]
        while next_baro < available.shape[0] and available[next_baro] <= t:
            _, dh, ddv = baro_sample(
                state,
                parameters,
                events,
                t,
                h,
                v,
                stamps[next_baro],
                heights[next_baro],
                reasons[next_baro],
            )
            h += dh
            v += ddv
            next_baro += 1
        out[k, 0] = smooth_height(state, t, h)
        out[k, 1] = v
        out[k, 2] = state[layout.S_CORRECTION]
        out[k, 3] = 1.0 if height_valid(state) else 0.0
    host[_HEIGHT] = h
    host[_V_UP] = v
