"""An INS/GNSS filter, block by block of IMU updates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sinstool.core.arrays import ArrayLike, FloatArray, IntArray
from sinstool.core.errors import ConfigurationError
from sinstool.core.streams import GnssEpochs
from sinstool.methods.height import layout as height_layout
from sinstool.methods.ins_gnss import layout, parameters, results
from sinstool.methods.ins_gnss.constraints import (
    INTERVAL,
    Constraints,
    VehicleEstimate,
    vehicle_estimate,
)
from sinstool.methods.ins_gnss.loop import run
from sinstool.methods.ins_gnss.motion import BRIDGE
from sinstool.methods.ins_gnss.settings import Settings, Start
from sinstool.methods.ins_gnss.states import GYRO_AXES, LAND_VEHICLE, FilterKind
from sinstool.methods.strapdown.followed_rates import followed_rates
from sinstool.methods.strapdown.navigation import SIZE as NAV_SIZE
from sinstool.methods.strapdown.velocity import Increments

_MOST_EVENTS = 4096  # of a block; more are counted
_FIX = 12


@dataclass(frozen=True)
class FilterSummary:
    """Summary of a run so far.

    Attributes
    ----------
    filter : str
        The filter that ran.
    fell_back : bool
        Whether it replaces the configured one, which needs a barometer.
    updates, epochs_used, epochs_gated, epochs_before_start : int
        Updates by the IMU; epochs of GNSS used, rejected by the gate, and before the start.
    restarts : int
        Of the filter.
    mean_nis : float
        Normalised innovation squared over the number of rows, of the epochs used; NaN before the
        first. 1 if the noise is as assumed; slowly varying errors of fixes hardly change it.
    gyro_bias, accel_scale, accel_bias, gyro_scale : ndarray, shape (3,)
        Last estimates, which are removed: rad/s, fraction, m/s^2, fraction.
    gyro_misalignment, accel_misalignment : ndarray, shape (6,), or None
        The same, rad, in the order of :data:`~sinstool.methods.ins_gnss.states.AXES_PAIRS`; None
        without states for them.
    baro_bias : float
        Last estimate of the error of the barometric height, m.
    channel : ChannelSummary
        Of the damping network; without one, of a channel without samples.
    gains : tuple of float or None
        Of the network: continuous K1, K2, K3.
    land_vehicle : VehicleEstimate or None
        Last estimates of a land vehicle.
    rests, held, wheels : int
        Constraints used: at rest, of an axle that does not slide, and of wheels.
    slides, wheel_slips : int
        Number of these that did not hold and were left out.
    """

    filter: str
    fell_back: bool
    updates: int
    epochs_used: int
    epochs_gated: int
    epochs_before_start: int
    restarts: int
    mean_nis: float
    gyro_bias: FloatArray
    accel_scale: FloatArray
    accel_bias: FloatArray
    gyro_scale: FloatArray
    gyro_misalignment: FloatArray | None
    accel_misalignment: FloatArray | None
    baro_bias: float
    channel: height_layout.ChannelSummary
    gains: tuple[float, float, float] | None
    land_vehicle: VehicleEstimate | None
    rests: int
    held: int
    wheels: int
    slides: int
    wheel_slips: int


class InsGnssFilter:
    """Navigation with GNSS, and with a barometer where there is one.

    Parameters
    ----------
    start : Start
        At the start of the first IMU update.
    with_baro : bool
        Whether baro heights will come. Without, a filter that needs them is replaced by
        one without; see :attr:`fell_back`.
    output : bool, optional
        Answer with columns at the IMU updates.
    store : bool, optional
        Answer with what a smoother needs: 3 n^2 numbers for each instant with a measurement,
        16 kB for 26 states.
    constraints : Constraints, optional
        When the vehicle rests, and what cannot slide.

    Attributes
    ----------
    kind : FilterKind
        Of the filter that runs.
    events, channel_events : list
        All so far: FilterEvent, and Event of the vertical channel (times in s since the start).

    Notes
    -----
    The answers do not depend, to the last bit, on where blocks end, as long as fixes and baro
    samples are pushed no later than the IMU updates at or after the time at which they are
    valid. What is newer waits for the next block.
    """

    def __init__(
        self,
        start: Start,
        settings: Settings,
        *,
        with_baro: bool,
        output: bool = True,
        store: bool = False,
        constraints: Constraints | None = None,
    ) -> None:
        self.settings = settings
        self._constraints = constraints
        vehicle = None if constraints is None else constraints.vehicle
        kind = settings.kind
        self.fell_back = kind.needs_baro and not with_baro
        kind = kind if with_baro else kind.without_baro
        self.kind: FilterKind = kind if vehicle is None else kind.on_wheels
        self.events: list[results.FilterEvent] = []
        self.channel_events: list[height_layout.Event] = []
        self._output = output
        self._store = store
        damping = settings.damping
        if not self.kind.network and settings.network is not None and damping.k4 != 0.0:
            raise ConfigurationError(
                f"filter {self.kind.name} has no damping network, but K4 is {damping.k4:g} s",
                "K4 = 0, or one of the network filters",
            )
        p0 = parameters.initial_covariance(self.kind, start, settings, vehicle)
        self._model = layout.new_model(
            self.kind.index,
            height_layout.new_parameters(
                damping, settings.grade, shadow=False, gate=parameters.CHANNEL_GATE
            ),
            parameters.decay_rates(self.kind, settings),
            parameters.noise_densities(self.kind, start, settings),
            p0,
            np.zeros(layout.V_PARAMETERS) if constraints is None else constraints.parameters(),
            parameters.loop_parameters(self.kind, settings),
        )
        self._grid = np.empty((0, 4)) if constraints is None else constraints.grid()
        self._memory = layout.new_memory(
            start.nav,
            np.concatenate([start.gyro_bias, np.zeros(3), start.accel_bias, np.zeros(15)]),
            p0,
            height_layout.new_state(),
            np.zeros(layout.VEHICLE_SIZE) if vehicle is None else vehicle.start_values(),
        )
        self._window = np.zeros((settings.control.window, layout.ROWS))
        self._changes = np.zeros((settings.control.measured_epochs, layout.ROWS + 1))
        self._origin: int | None = None
        # Not used yet: times, fixes, whether they are withheld; times, heights, reasons
        no_time = np.empty(0, dtype=np.int64)
        self._gnss: list[NDArray[Any]] = [no_time, np.empty((0, _FIX)), np.empty(0)]
        self._baro: list[NDArray[Any]] = [no_time, np.empty(0), no_time]

    @property
    def _p(self) -> FloatArray:
        n = self.kind.size
        return np.asarray(self._memory.p[:n, :n])

    # --- its state -----------------------------------------------------------------------

    @property
    def nav(self) -> FloatArray:
        """Navigation state now, shape (10,); without feedback, uncorrected."""
        return self._memory.nav.copy()

    @property
    def estimate(self) -> FloatArray:
        """Estimate of the errors that is not fed back yet, shape (n,)."""
        return self._memory.x[: self.kind.size].copy()

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the errors at the latest substep, shape (n, n)."""
        return self._p.copy()

    @property
    def summary(self) -> FilterSummary:
        """Summary of the run so far."""
        m = self._memory
        rows = m.nis_rows
        sensors = m.sensors
        has_axes = self.kind.first(GYRO_AXES) >= 0
        return FilterSummary(
            filter=self.kind.name,
            fell_back=self.fell_back,
            updates=int(m.updates),
            epochs_used=int(m.epochs_used),
            epochs_gated=int(m.epochs_gated),
            epochs_before_start=int(m.dropped),
            restarts=int(m.restarts),
            mean_nis=float(m.nis_sum / rows) if rows else float("nan"),
            gyro_bias=sensors[:3].copy(),
            accel_scale=sensors[3:6].copy(),
            accel_bias=sensors[6:9].copy(),
            gyro_scale=sensors[9:12].copy(),
            gyro_misalignment=sensors[12:18].copy() if has_axes else None,
            accel_misalignment=sensors[18:].copy() if has_axes else None,
            baro_bias=float(self._memory.channel[height_layout.S_BARO_BIAS]),
            channel=height_layout.summarise(self._memory.channel),
            gains=self.settings.damping.gains if self.kind.network else None,
            land_vehicle=self._vehicle(),
            rests=int(m.rests),
            held=int(m.held),
            wheels=int(m.wheels),
            slides=int(m.slips),
            wheel_slips=int(m.wheel_slips),
        )

    def _vehicle(self) -> VehicleEstimate | None:
        first = self.kind.first(LAND_VEHICLE)
        return vehicle_estimate(self._memory.vehicle, self._p, first) if first >= 0 else None

    # --- data -----------------------------------------------------------------------------

    def push(
        self,
        increments: Increments,
        gnss: GnssEpochs | None = None,
        withheld: ArrayLike | None = None,
        baro_time_ns: ArrayLike = (),
        baro_height: ArrayLike = (),
        baro_reason: ArrayLike | None = None,
    ) -> results.FilterBlock:
        """Go on over the next IMU updates.

        Parameters
        ----------
        increments : Increments
            Compensated, biases not taken off. Updates follow each other, or leave gaps: see
            ``Settings.max_gap``. Without followed rates these are made of what is given here;
            without variances of lost samples there are none.
        gnss : GnssEpochs, optional
            In order of their stamps. Position, velocity or both; a height or a vertical
            velocity may be missing alone. Standard deviations where the receiver gives them.
        withheld : array_like of bool, shape (f,), optional
            Epochs that are compared with the navigation but not used.
        baro_time_ns : array_like of int64, shape (b,), optional
        baro_height : array_like, shape (b,), optional
            m; see :mod:`sinstool.methods.height.reference`.
        baro_reason : array_like of int, shape (b,), optional
            0 for samples to be used; see :mod:`sinstool.methods.height.layout`.

        Raises
        ------
        ValueError
            If shapes do not fit, times of updates or fixes do not increase, or an increment is
            not finite.
        """
        time_ns = np.asarray(increments.time_ns, dtype=np.int64)
        interval = np.ascontiguousarray(increments.interval, dtype=np.float64)
        phi = np.ascontiguousarray(increments.rotation_vector, dtype=np.float64)
        dv = np.ascontiguousarray(increments.velocity_increment, dtype=np.float64)
        followed = increments.followed_rate
        if followed is None:
            followed = followed_rates(time_ns, interval, phi)
        lost = np.empty((0, 6)) if increments.lost is None else increments.lost
        if phi.shape != (len(time_ns), 3) or dv.shape != phi.shape or interval.ndim != 1:
            raise ValueError(f"Expected shapes (n, 3), got {phi.shape} and {dv.shape}.")
        if np.any(np.diff(time_ns) <= 0) or not np.all(interval > 0.0):
            raise ValueError("Expected times of updates to increase.")
        if not (np.all(np.isfinite(phi)) and np.all(np.isfinite(dv))):
            raise ValueError("Found an increment that is not finite.")
        self._take(gnss, withheld, baro_time_ns, baro_height, baro_reason)
        if self._origin is None and len(time_ns):
            self._origin = int(time_ns[0]) - round(float(interval[0]) * 1e9)
            if self._constraints is not None:
                begin = (self._constraints.start_ns - self._origin) * 1e-9
                self._model.vehicle[layout.V_ORIGIN] = begin
        origin = self._origin or 0
        last = int(time_ns[-1]) if len(time_ns) else None
        epochs = 0 if last is None else int(np.searchsorted(self._gnss[0], last, "right"))
        fix_ns, fixes, masks = (column[:epochs] for column in self._gnss)
        baro_ns, heights, reasons = (column[: self._arrived(last)] for column in self._baro)

        n = self.kind.size
        spent = float(interval.sum() + 1.0) if len(time_ns) else 0.0
        if len(time_ns):
            spent = max(spent, (int(time_ns[-1]) - int(time_ns[0])) * 1e-9 + 2.0)
        most = min(self.settings.row_interval, 1.0)
        if self._constraints is not None:
            most = min(most, INTERVAL)
        gaps = int(np.count_nonzero(np.diff(time_ns) * 1e-9 - interval[1:] > BRIDGE)) + 1
        room = int(epochs + 2.0 * spent / most) + 2 * gaps + 8
        stored = layout.new_stored(room if self._store else 1, n)
        channel_events = height_layout.new_events(len(heights))
        events = np.empty((_MOST_EVENTS, layout.EVENT_WIDTH))
        diagnoses = np.full((epochs, layout.DIAGNOSTICS), np.nan)
        out = np.empty((len(time_ns) if self._output else 0, layout.OUTPUT))
        counts = np.zeros(3, dtype=np.int64)
        m = self._memory
        m.keep, m.row, m.events = self._store, 0, 0
        earlier = float(m.channel[height_layout.S_EVENTS])
        m.channel[height_layout.S_EVENTS] = 0.0
        run(
            m,
            self._model,
            stored,
            self._window,
            self._changes,
            self._grid,
            _seconds(time_ns, origin),
            interval,
            phi,
            dv,
            np.ascontiguousarray(followed),
            np.ascontiguousarray(lost),
            _seconds(fix_ns, origin),
            fixes,
            masks,
            _seconds(baro_ns, origin),
            heights,
            reasons,
            channel_events,
            events,
            diagnoses,
            out,
            counts,
        )
        self._note(events[: m.events], channel_events, origin, earlier)
        compared = slice(counts[2], counts[0])
        gnss_out = _diagnostics(fix_ns[compared], diagnoses[compared])
        self._gnss = [column[counts[0] :] for column in self._gnss]
        self._baro = [column[counts[1] :] for column in self._baro]
        return results.FilterBlock(
            _columns(time_ns, out) if self._output else None,
            gnss_out,
            _stored(stored[: m.row], n, origin) if self._store else None,
        )

    def _take(
        self,
        gnss: GnssEpochs | None,
        withheld: ArrayLike | None,
        baro_time_ns: ArrayLike,
        baro_height: ArrayLike,
        baro_reason: ArrayLike | None,
    ) -> None:
        """Queue new measurements."""
        if gnss is not None and len(gnss):
            stamps = np.asarray(gnss.time_ns, dtype=np.int64)
            valid = stamps - round(self.settings.gnss_latency * 1e9)
            if np.any(np.diff(np.concatenate([self._gnss[0][-1:], valid])) < 0):
                raise ValueError("Expected GNSS epochs in the order of their stamps.")
            mask = (
                np.zeros(len(gnss)) if withheld is None else np.asarray(withheld, dtype=np.float64)
            )
            if mask.shape != (len(gnss),):
                raise ValueError(f"Expected `withheld` to have shape ({len(gnss)},).")
            fixes = np.column_stack(
                [
                    gnss.latitude,
                    gnss.longitude,
                    gnss.height,
                    gnss.velocity_n,
                    gnss.sigma_position_n,
                    gnss.sigma_velocity_n,
                ]
            ).astype(np.float64)
            self._gnss = _joined(self._gnss, valid, fixes, mask)
        stamps = np.asarray(baro_time_ns, dtype=np.int64)
        heights = np.asarray(baro_height, dtype=np.float64)
        reasons = (
            np.zeros(len(stamps), dtype=np.int64)
            if baro_reason is None
            else np.asarray(baro_reason, dtype=np.int64)
        )
        if heights.shape != stamps.shape or reasons.shape != stamps.shape:
            raise ValueError("Expected baro times, heights and reasons of one shape (b,).")
        if len(stamps) and self.kind.needs_baro:
            self._baro = _joined(self._baro, stamps, heights, reasons)

    def _arrived(self, last: int | None) -> int:
        """Number of baro samples, in order of arrival, before the first one from later."""
        if last is None:
            return 0
        later = np.flatnonzero(self._baro[0] > last)
        return int(later[0]) if len(later) else len(self._baro[0])

    def _note(
        self, events: FloatArray, channel_events: FloatArray, origin: int, earlier: float
    ) -> None:
        for kind, time, size in events.tolist():
            self.events.append(
                results.FilterEvent(
                    results.EVENT_NAMES[int(kind)], origin + round(time * 1e9), size
                )
            )
        new = int(self._memory.channel[height_layout.S_EVENTS])
        self.channel_events += height_layout.read_events(channel_events[:new])
        self._memory.channel[height_layout.S_EVENTS] = earlier + new


def _joined(queue: list[NDArray[Any]], *more: NDArray[Any]) -> list[NDArray[Any]]:
    return [np.concatenate(pair) for pair in zip(queue, more, strict=True)]


def _seconds(time_ns: IntArray, origin: int) -> FloatArray:
    return np.asarray((time_ns - origin) * 1e-9, dtype=np.float64)


def _columns(time_ns: IntArray, out: FloatArray) -> results.UpdateColumns:
    def block(number: int) -> FloatArray:
        first = layout.O_COVARIANCE + 9 * number
        return out[:, first : first + 9].reshape(-1, 3, 3)

    return results.UpdateColumns(
        time_ns,
        out[:, 0],
        out[:, 1],
        out[:, 2],
        out[:, 3:6],
        out[:, 6:NAV_SIZE],
        out[:, layout.O_RATE : layout.O_RATE + 3],
        out[:, layout.O_FORCE : layout.O_FORCE + 3],
        out[:, layout.O_CORRECTION],
        block(0),
        block(1),
        block(2),
    )


def _diagnostics(time_ns: IntArray, rows: FloatArray) -> results.GnssDiagnostics:
    return results.GnssDiagnostics(
        time_ns,
        rows[:, layout.D_INNOVATION : layout.D_INNOVATION + 6],
        rows[:, layout.D_SIGMA : layout.D_SIGMA + 6],
        rows[:, layout.D_MEASUREMENT : layout.D_MEASUREMENT + 6],
        rows[:, layout.D_RATIO : layout.D_RATIO + 6],
        rows[:, layout.D_NIS],
        rows[:, layout.D_ROWS].astype(np.int64),
        rows[:, layout.D_USED] > 0.0,
        rows[:, layout.D_GATED] > 0.0,
        rows[:, layout.D_RESTARTED] > 0.0,
        rows[:, layout.D_WITHHELD] > 0.0,
    )


def _stored(rows: FloatArray, n: int, origin: int) -> results.StoredEpochs:
    at = layout.R_STATES

    def columns(*shape: int) -> FloatArray:
        nonlocal at
        first, at = at, at + math.prod(shape)
        # No copy: a smoother packs them
        return rows[:, first:at].reshape(-1, *shape)

    correction, estimate = columns(n), columns(n)
    return results.StoredEpochs(
        time_ns=origin + np.round(rows[:, layout.R_TIME] * 1e9).astype(np.int64),
        update=rows[:, layout.R_UPDATE].astype(np.int64),
        transition=columns(n, n),
        covariance_before=columns(n, n),
        covariance_after=columns(n, n),
        correction=correction,
        estimate=estimate,
        nav=rows[:, layout.R_NAV : layout.R_SENSORS],
        sensors=rows[:, layout.R_SENSORS : layout.R_STATES],
        restart=rows[:, layout.R_RESTART] > 0.0,
    )
