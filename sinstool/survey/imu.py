"""The first pass over a log: a survey of its IMU data before any computation.

Rates, gaps, clocks, units, rests and saturation are found in one pass with state that does not
depend on where blocks end. Both `sinstool info` and `sinstool process` begin here, so that `info`
shows what `process` uses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain
from typing import Protocol

import numpy as np

from sinstool.core.english import in_seconds
from sinstool.core.errors import DataError
from sinstool.core.finding import Finding
from sinstool.core.streams import Imu
from sinstool.core.timeline import (
    FIRST_HORIZON,
    GAP_INTERVALS,
    LAST_HORIZON,
    LOST_INTERVALS,
    SECOND,
    Order,
    OrderCounts,
    clock_time,
    mean_rates,
    ordered,
    reblock,
)
from sinstool.io.readers.frames import q_for_log
from sinstool.io.readers.log import Log
from sinstool.io.readers.streams import LARGEST, ImuUnits, Losses, frame_id, read_imu
from sinstool.io.readers.topics import ImuTopic
from sinstool.methods.alignment.still import StillSpan, Windows, lead_in, still_spans
from sinstool.survey.even_stamps import EvenStamps
from sinstool.survey.no_measurements import LeftOut, Suspects
from sinstool.survey.orientation import OrientationFault, orientation_fault
from sinstool.survey.range_ends import STOP_SHARE, crowded, stopped
from sinstool.survey.rest import calmer
from sinstool.survey.tally import CROWD, Tally
from sinstool.survey.unit_evidence import UnitEvidence, unit_evidence

BLOCK_ROWS = 16384
BURSTY_SHARE = 0.05
# A clock was set back if samples alternate between two times this often for each step back.
SET_BACK_RATIO = 10
# Stamps are too coarse if this share of the samples has another's stamp, but other values.
CONFLICTING = 0.3
SENSOR_AXES = tuple(f"{sensor} {axis}" for sensor in ("gyro", "accelerometer") for axis in "xyz")


@dataclass
class _Extent:
    """Extent of all samples in the order of the file, within the span or not."""

    count: int = 0
    low: int = 0
    high: int = 0
    last_log: int = 0
    log_backward: int = 0

    def watch(self, blocks: Iterator[Imu]) -> Iterator[Imu]:
        """The same blocks."""
        for block in blocks:
            low, high = int(block.time_ns.min()), int(block.time_ns.max())
            log_times = block.log_time_ns
            if self.count:
                low, high = min(low, self.low), max(high, self.high)
                log_times = np.concatenate(([self.last_log], log_times))
            self.low, self.high = low, high
            self.last_log = int(log_times[-1])
            self.log_backward += int(np.count_nonzero(log_times[1:] < log_times[:-1]))
            self.count += len(block)
            yield block


@dataclass(frozen=True)
class Survey:
    """The result of the first pass.

    Attributes
    ----------
    count : int
        Usable samples, in order, without duplicates.
    time_source : {'stamp', 'log'}
        Header stamps, or the recorder's times where stamps are unusable.
    time_note : str
        Why stamps are unusable.
    interval_ns : float
        Median interval.
    interval_range_ns : tuple of int
        Smallest and largest interval.
    interval_spread_ns : float
        Half the width of the range in which four fifths of the intervals lie.
    max_gap_ns : int
        Longest interval that is still no gap.
    bursty : bool
        Stamps come in bursts.
    gaps : tuple of (int, float)
        Start (ns) and length (s), in order of time: the thousand longest.
    gap_count, gap_total_s
        Of all of them.
    missed : int
        Intervals of more than 1.5 nominal ones that are no gap: samples are missing there.
    horizon_ns : int
        Look-ahead that puts every late sample in its place.
    clock_offset_s : tuple of float
        Log time minus stamp: smallest and largest.
    held : int
        Samples that repeat the values of the one before; 0 where no more do than independent axes
        that change seldom, as coarse ones do, would by chance.
    gyro_max, accel_max : ndarray, shape (3,)
        Largest magnitude by axis.
    gyro_resolution, accel_resolution : float
        Smallest step from one value of an axis to the next, rad/s and m/s^2; 0 where nothing
        changes.
    saturated : tuple of str
        Axes that stay at their largest value for several samples.
    gyro_stops : ndarray, shape (2, 3)
        Rate, rad/s, positive or negative, from which each gyro may be at the end of its range, as
        its largest values lie close together. A calibration of a saturated gyro does that, but so
        does a motor at its largest speed. Infinite where they do not.
    specific_force_median : float
        Median norm, m/s^2.
    lead_in : StillSpan or None
        The still span that the log begins with.
    orientation : ndarray or None, shape (4,)
        First valid q_nb the log gives; None also where it is the identity in every message.
    orientation_ns : int
        Its time.
    orientation_constant : bool
        It is the same in every message.
    orientation_fault : OrientationFault or None
        How it contradicts the other sensors.
    frame_id : str
        Of the first message.
    gyro_unit : UnitEvidence
        What the turning of gravity says about the unit of the rates.
    even : EvenStamps or None
        Times of samples that a sensor takes evenly, where stamps jitter: intervals and gaps are by
        these, while `first_ns`, windows, spans and orientations keep their stamps.
    left_out : LeftOut or None
        Samples that are no measurements, and are as if they had not been recorded.
    dead_axes : tuple of str
        Axes that never change although all others show noise.
    clock_steps : tuple of Finding
        Clocks that were set while the log was recorded: samples are read without these steps.
    two_sensors : float
        Difference of the specific forces of two sensors whose samples alternate, m/s^2; or 0.
    """

    topic: str
    count: int
    first_ns: int
    last_ns: int
    time_source: str
    time_note: str
    interval_ns: float
    interval_range_ns: tuple[int, int]
    interval_spread_ns: float
    max_gap_ns: int
    bursty: bool
    gaps: tuple[tuple[int, float], ...]
    gap_count: int
    gap_total_s: float
    missed: int
    order: OrderCounts
    horizon_ns: int
    losses: Losses
    clock_offset_s: tuple[float, float]
    held: int
    gyro_max: np.ndarray
    accel_max: np.ndarray
    gyro_resolution: float
    accel_resolution: float
    saturated: tuple[str, ...]
    gyro_stops: np.ndarray
    specific_force_median: float
    windows: Windows
    spans: tuple[StillSpan, ...]
    lead_in: StillSpan | None
    orientation: np.ndarray | None
    orientation_ns: int
    orientation_constant: bool
    orientation_fault: OrientationFault | None
    frame_id: str
    gyro_unit: UnitEvidence
    even: EvenStamps | None = None
    left_out: LeftOut | None = None
    dead_axes: tuple[str, ...] = ()
    clock_steps: tuple[Finding, ...] = ()
    two_sensors: float = 0.0

    @property
    def rate_hz(self) -> float:
        """Rate from the median interval."""
        return 1e9 / self.interval_ns if self.interval_ns else 0.0

    @property
    def oriented(self) -> bool:
        """Whether the log has usable orientations."""
        there = self.orientation is not None and not self.orientation_constant
        return there and self.orientation_fault is None

    @property
    def duration_s(self) -> float:
        """Time covered by samples, gaps left out."""
        return (self.last_ns - self.first_ns) / SECOND - self.gap_total_s

    @property
    def range_ends(self) -> np.ndarray:
        """Where saturated gyros and accelerometers are at the ends of their ranges, shape (6,).

        In rad/s and m/s^2; infinite for all other axes.
        """
        saturated = [name in self.saturated for name in SENSOR_AXES]
        largest = np.concatenate([self.gyro_max, self.accel_max])
        return np.where(saturated, STOP_SHARE * largest, np.inf)


class Watcher(Protocol):
    """Looks at the samples as the first pass reads them, anew each time that it begins again."""

    def watch(self, blocks: Iterator[Imu]) -> Iterator[Imu]:
        """The same blocks."""


def survey(
    log: Log,
    topic: ImuTopic,
    units: ImuUnits,
    *,
    span: Callable[[int], tuple[int | None, int | None]] | None = None,
    max_gap_s: float | None = None,
    increments: bool = False,
    block_rows: int = BLOCK_ROWS,
    progress: Callable[[int], None] | None = None,
    read: Watcher | None = None,
    judged: Watcher | None = None,
    keep_repeated: bool = False,
) -> Survey:
    """Survey a log's IMU topic in one pass.

    Parameters
    ----------
    span : callable, optional
        First and last time (None: open) of the samples that count, from the time of the first
        sample, on whichever clock that is.
    max_gap_s : float, optional
        Longest interval that is no gap; by default three nominal intervals.
    increments : bool
        Samples are increments; they are judged as mean rates over their intervals.
    block_rows : int
        Samples handled at once; the result does not depend on it.
    progress : callable, optional
        Called with the bytes read so far.
    read : Watcher, optional
        Gets the samples as they were read.
    judged : Watcher, optional
        Gets them as they are judged: in the order of time, increments as mean rates.
    keep_repeated : bool, optional
        See :class:`~sinstool.core.timeline.Order`.

    Raises
    ------
    DataError
        The topic has no usable sample in the span.
    """
    log_time, note, horizon = False, "", FIRST_HORIZON
    left_out: LeftOut | None = None
    dead: tuple[str, ...] = ()
    while True:
        losses = Losses()
        order = Order(horizon, keep_repeated)
        tally, extent = Tally(), _Extent()
        blocks = read_imu(
            log, topic.channels, units, losses, path=topic.path, log_time=log_time,
            orientation=tally.wants_orientation, progress=progress,
        )  # fmt: skip
        source = extent.watch(blocks)
        if span is not None:
            source = _spanned(source, span)
        if left_out is not None:
            source = left_out.applied(source)
        source, suspects = reblock(source, block_rows), Suspects()
        in_order = ordered(source if read is None else read.watch(source), order)
        if left_out is None:
            in_order = suspects.watch(in_order)
        measured = mean_rates(in_order) if increments else in_order
        for block in measured if judged is None else judged.watch(measured):
            tally.add(block)
        counts = order.counts
        if not log_time:
            note = _unusable(tally, counts, extent)
            if note:
                log_time, horizon = True, FIRST_HORIZON
                continue
        if tally.count == 0:
            raise _nothing(log, topic, losses, extent)
        if counts.lateness_ns > horizon and horizon < LAST_HORIZON:
            horizon = min(LAST_HORIZON, 1 << int(counts.lateness_ns).bit_length())
            continue
        if left_out is None:
            left_out, dead = suspects.found(), suspects.dead()
            if left_out is not None:
                continue  # as if they had not been recorded
        break
    frame = frame_id(log, topic.channels, topic.path)
    found = _conclude(
        topic, units.body_axes, tally, order, losses, log_time, note, max_gap_s, frame
    )
    return replace(found, left_out=left_out, dead_axes=dead)


def _nothing(log: Log, topic: ImuTopic, losses: Losses, extent: _Extent) -> DataError:
    """Error for a topic without a single usable sample."""
    if extent.count:
        return DataError(
            log.path,
            f"topic {topic.topic} has no usable Imu message between --start and --end",
            f"its samples span {(extent.high - extent.low) / SECOND:.3f} s, from"
            f" {clock_time(extent.low)}",
        )
    detail = f" ({losses.problem})" if losses.problem else ""
    if losses.nonfinite:
        detail = f" ({losses.nonfinite} hold NaN, infinity or more than {LARGEST:.0e})"
    return DataError(log.path, f"topic {topic.topic} has no usable Imu message{detail}")


def _spanned(
    blocks: Iterator[Imu], span: Callable[[int], tuple[int | None, int | None]]
) -> Iterator[Imu]:
    """Only the samples in a span that the first sample's time settles."""
    first = next(blocks, None)
    if first is not None:
        yield from within(chain([first], blocks), *span(int(first.time_ns[0])))


def within(blocks: Iterable[Imu], start_ns: int | None, end_ns: int | None) -> Iterator[Imu]:
    """Only the samples in a span of time (both ends included)."""
    for block in blocks:
        if start_ns is None and end_ns is None:
            yield block
            continue
        keep = np.ones(len(block), np.bool_)
        if start_ns is not None:
            keep &= block.time_ns >= start_ns
        if end_ns is not None:
            keep &= block.time_ns <= end_ns
        if keep.all():
            yield block  # as nearly always: a mask would copy it
        elif keep.any():
            yield block.rows(keep)


def _unusable(tally: Tally, counts: OrderCounts, extent: _Extent) -> str:
    """Reason not to use the header stamps; empty if they can be used."""
    if extent.count > 1 and extent.low == extent.high:
        return f"all header stamps are {extent.low} ns"
    total = tally.count + counts.duplicates + counts.late
    if counts.differing_duplicates > CONFLICTING * total:
        return f"{counts.differing_duplicates} of {total} samples repeat the stamp before them"
    if counts.lateness_ns > LAST_HORIZON:
        return f"header stamps jump back by {counts.lateness_ns / SECOND:.1f} s"
    # Late messages fill a hole when put in their place. A clock that was set back counts the
    # same seconds twice: by stamp, samples from before and after then alternate.
    disorder = counts.backward + extent.log_backward
    if counts.backward and tally.log_descents > SET_BACK_RATIO * disorder:
        return (
            f"header stamps run back by {in_seconds(counts.lateness_ns / SECOND, 3)} and over the"
            " same time again"
        )
    return ""


def _conclude(
    topic: ImuTopic,
    body_axes: str,
    tally: Tally,
    order: Order,
    losses: Losses,
    log_time: bool,
    note: str,
    max_gap_s: float | None,
    frame: str,
) -> Survey:
    intervals = int(tally.histogram.sum())
    nominal, median = tally.nominal_interval()
    bursty = False
    limit = GAP_INTERVALS * nominal
    if max_gap_s is not None:
        limit = max_gap_s * SECOND
    elif intervals and tally.above(limit)[0] > BURSTY_SHARE * intervals:
        bursty = True
        limit = GAP_INTERVALS * tally.quantile(0.99)
    gap_count, gap_ns = tally.above(limit)
    missed = 0 if bursty else max(0, tally.above(LOST_INTERVALS * nominal)[0] - gap_count)
    is_gap = tally.long_step > limit
    windows = tally.windows.finish()
    spans = still_spans(windows)
    begin = lead_in(spans, tally.first_ns)
    if begin is not None and calmer(spans, begin):
        # It begins in a steady turn
        begin = None
    # Values that are no measurements at all may be too large to be squared.
    with np.errstate(over="ignore"):
        usual = np.sqrt(np.mean(np.hstack((windows.gyro, windows.accel)) ** 2, axis=0))
    saturated = tuple(
        name
        for name, row, size in zip(SENSOR_AXES, tally.extremes, usual, strict=True)
        if stopped(row, size)
    )
    constant = tally.orientation is not None and not tally.orientation_varies and tally.count > 1
    placeholder = constant and _is_identity(tally.orientation, body_axes)
    steps = tally.extremes[:, 4].reshape(2, 3).min(axis=1)
    gyro_step, accel_step = np.where(np.isfinite(steps), steps, 0.0).tolist()
    return Survey(
        topic=topic.topic,
        count=tally.count,
        first_ns=tally.first_ns,
        last_ns=tally.last_ns,
        time_source="log" if log_time else "stamp",
        time_note=note,
        interval_ns=median,
        interval_range_ns=(tally.shortest if intervals else 0, tally.longest),
        interval_spread_ns=0.5 * (tally.quantile(0.9) - tally.quantile(0.1)),
        max_gap_ns=int(limit),
        bursty=bursty,
        gaps=tuple(
            (int(s), int(d) / SECOND)
            for s, d in zip(tally.long_start[is_gap], tally.long_step[is_gap], strict=True)
        ),
        gap_count=gap_count,
        gap_total_s=gap_ns / SECOND,
        missed=missed,
        order=order.counts,
        horizon_ns=order.horizon_ns,
        losses=losses,
        clock_offset_s=(tally.offset_low / SECOND, tally.offset_high / SECOND),
        held=_held(tally),
        gyro_max=tally.extremes[:3, 0].copy(),
        accel_max=tally.extremes[3:, 0].copy(),
        gyro_resolution=gyro_step,
        accel_resolution=accel_step,
        saturated=saturated,
        gyro_stops=np.where(crowded(tally.crowds), CROWD * tally.crowds[..., 0], np.inf),
        specific_force_median=tally.force_median(),
        windows=windows,
        spans=tuple(spans),
        lead_in=begin,
        orientation=None if placeholder else tally.orientation,
        orientation_ns=tally.orientation_ns,
        orientation_constant=constant,
        orientation_fault=None
        if placeholder
        else orientation_fault(tally.orientations, tally.first_ns, windows),
        frame_id=frame,
        gyro_unit=unit_evidence(windows),
    )


def _held(tally: Tally) -> int:
    """Samples that repeat the one before, unless they do by chance.

    A driver that sends a sample again repeats all axes at once: as many samples as the axis that
    repeats most seldom. Of axes that are coarse, each by itself, the shares multiply.
    """
    shares = tally.extremes[:, 10] / max(tally.count - 1, 1)
    middle = np.sqrt(shares.min() * shares.prod())
    return tally.held if tally.held >= middle * (tally.count - 1) else 0


def _is_identity(q_nb: np.ndarray | None, body_axes: str) -> bool:
    """Whether a log wrote 1 and three zeros, in whichever order it keeps a quaternion."""
    if q_nb is None:
        return False
    written = q_for_log(q_nb, body_axes, "enu" if body_axes == "flu" else "ned")
    return bool(np.abs(written).max() > 1.0 - 1e-12)
