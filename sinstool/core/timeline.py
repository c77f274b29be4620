"""Samples in the order of measurement, without duplicates, split at gaps.

Logs are written in the order in which messages arrive. `Order` puts them in the order of their
stamps with a bounded look-ahead, drops repeated stamps, and counts what it met; `segments` then
cuts the ordered samples wherever more time passed than can be integrated across.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise
from typing import Generic, TypeVar

import numpy as np

from sinstool.core.memory import return_freed_memory
from sinstool.core.streams import Imu, Stream, concatenate

SECOND = 1_000_000_000
# Grids of times reach over gaps up to this, ns. One of years, as by a clock that is set while
# recording, would fill the memory.
LONGEST_GAP_NS = 6 * 3600 * SECOND
# Samples are held back this long at first; a log that needs more is read again with more.
FIRST_HORIZON = SECOND
# Stamps that run back further than this are a clock that was set, not late messages.
LAST_HORIZON = 64 * SECOND
# An interval of more than this many nominal ones is a gap: two samples or more are missing, and
# what the vehicle did meanwhile is not in the log.
GAP_INTERVALS = 3.0
# In an interval of more than this many nominal ones, a sample was lost.
LOST_INTERVALS = 1.5
# When a stream of more samples than this has been joined, freed memory is returned to the system.
LONG_STREAM = 100_000
S = TypeVar("S", bound=Stream)
_NEVER = int(np.iinfo(np.int64).min)


def longest_part(time_ns: np.ndarray) -> slice:
    """Rows of the part with most rows, of those that gaps above `LONGEST_GAP_NS` lie between."""
    edges = [0, *(np.flatnonzero(np.diff(time_ns) > LONGEST_GAP_NS) + 1).tolist(), len(time_ns)]
    return max((slice(a, b) for a, b in pairwise(edges)), key=lambda part: part.stop - part.start)


def clock_time(time_ns: int) -> str:
    """A time for messages: UTC, or seconds for a clock that counts from boot."""
    if time_ns > 946684800 * SECOND:  # 2000-01-01: recorders' own clocks start at zero
        when = datetime.fromtimestamp(time_ns // SECOND, UTC)
        return f"{when:%Y-%m-%d %H:%M:%S}.{time_ns % SECOND // 10**6:03d} UTC"
    return f"{time_ns / SECOND:.3f} s"


@dataclass
class OrderCounts:
    """Counts of late and repeated samples in `Order`.

    Attributes
    ----------
    backward : int
        Samples stamped earlier than the one before them in the file.
    lateness_ns : int
        Largest time by which one of them was older than the newest sample seen before it.
    duplicates : int
        Samples dropped because an earlier sample of the file has the same time.
    differing_duplicates : int
        Those of them whose gyro values differ from those of the sample kept.
    late : int
        Samples dropped because they lay further behind the newest than the horizon.
    keep_repeated : bool
        Samples with a repeated time and other values are kept, a nanosecond later.
    """

    backward: int = 0
    lateness_ns: int = 0
    duplicates: int = 0
    differing_duplicates: int = 0
    late: int = 0
    keep_repeated: bool = False


class Order:
    """Samples by time, from blocks in the order of the file.

    Parameters
    ----------
    horizon_ns : int
        Largest time by which a sample may be older than the newest one and still be put in order.
    keep_repeated : bool, optional
        Keep samples with a repeated time and other values, a nanosecond after the one before: their
        times say nothing but the order.
    """

    def __init__(self, horizon_ns: int = FIRST_HORIZON, keep_repeated: bool = False) -> None:
        self.horizon_ns = horizon_ns
        self.counts = OrderCounts(keep_repeated=keep_repeated)
        # samples that later ones may still precede, in order
        self.held: Imu | None = None
        self._newest = self._last_seen = self._last_out = self._last_stamp = _NEVER
        self._last_gyro, self._last_accel = np.zeros(3), np.zeros(3)

    def push(self, block: Imu) -> Imu:
        """Add a block; return the samples that no later one can precede."""
        block = self._punctual(block)
        if not len(block):
            return block
        held = block if self.held is None else concatenate([self.held, block])
        self._newest = max(self._newest, int(block.time_ns.max()))
        ordered = held
        if (held.time_ns[1:] < held.time_ns[:-1]).any():
            ordered = held.rows(np.argsort(held.time_ns, kind="stable"))
        ready = int(np.searchsorted(ordered.time_ns, self._newest - self.horizon_ns, side="right"))
        self.held = ordered.rows(slice(ready, None))
        return self._give(ordered.rows(slice(0, ready)))

    def finish(self) -> Imu | None:
        """The remaining samples; None if there were none at all."""
        held = self.held
        if held is None:
            return None
        self.held = held.rows(slice(0, 0))
        return self._give(held)

    def _punctual(self, block: Imu) -> Imu:
        """Count samples out of order; drop those that lie further back than the horizon.

        The rule does not depend on which samples have been returned already, so that the result
        does not depend on where blocks end.
        """
        times = block.time_ns
        if len(times) and times[0] >= self._newest and (times[1:] >= times[:-1]).all():
            self._last_seen = int(times[-1])
            return block  # the usual case, made fast
        before = np.concatenate(([self._last_seen], times[:-1]))
        newest = np.maximum.accumulate(np.concatenate(([self._newest], times)))[:-1]
        self._last_seen = int(times[-1])
        self.counts.backward += int(np.count_nonzero(times < before))
        behind = np.where(newest > times, newest - times, 0)
        lateness = int(behind.max())
        if not lateness:
            return block
        self.counts.lateness_ns = max(self.counts.lateness_ns, lateness)
        if lateness <= self.horizon_ns:
            return block
        late = behind > self.horizon_ns
        self.counts.late += int(np.count_nonzero(late))
        return block.rows(~late)

    def _give(self, block: Imu) -> Imu:
        """Drop samples with a repeated time, except the first in the file; note the last time."""
        if not len(block):
            return block
        if self.counts.keep_repeated:
            block = self._apart(block)
        times = block.time_ns
        fresh = np.diff(times, prepend=self._last_out) > 0
        if self._last_out == _NEVER:
            fresh[0] = True
        if not fresh.all():
            repeated = np.flatnonzero(~fresh)
            self.counts.duplicates += len(repeated)
            # row of the sample kept: row 0 is the last sample of the previous block
            last_fresh = np.maximum.accumulate(np.where(fresh, np.arange(1, len(times) + 1), 0))
            before = np.vstack((self._last_gyro, block.gyro))[last_fresh[repeated]]
            differs = (block.gyro[repeated] != before).any(axis=1)
            self.counts.differing_duplicates += int(np.count_nonzero(differs))
            block = block.rows(fresh)
        if len(block):
            self._last_out = int(block.time_ns[-1])
            self._last_gyro, self._last_accel = block.gyro[-1].copy(), block.accel[-1].copy()
        return block

    def _apart(self, block: Imu) -> Imu:
        """Move samples that repeat a time a nanosecond behind the one before, but drop copies."""
        times = block.time_ns
        last = int(times[0]) - 1 if self._last_out == _NEVER else self._last_out
        repeats = np.diff(times, prepend=self._last_stamp) <= 0
        if self._last_out == _NEVER:
            repeats[0] = False
        self._last_stamp = int(times[-1])
        if not repeats.any() and times[0] > last:
            return block
        turned = np.diff(block.gyro, axis=0, prepend=self._last_gyro[None])
        pushed = np.diff(block.accel, axis=0, prepend=self._last_accel[None])
        copies = repeats & ~(turned.any(axis=1) | pushed.any(axis=1))
        self.counts.duplicates += int(np.count_nonzero(copies))
        block = block.rows(~copies)
        count = np.arange(len(block))
        moved = np.maximum.accumulate(np.maximum(block.time_ns - count, last + 1)) + count
        return replace(block, time_ns=moved)


def ordered(blocks: Iterable[Imu], order: Order) -> Iterator[Imu]:
    """All samples of a stream in the order of time, through an `Order`."""
    for block in blocks:
        if len(out := order.push(block)):
            yield out
    rest = order.finish()
    if rest is not None and len(rest):
        yield rest


@dataclass(frozen=True)
class Piece:
    """The part of a block that belongs to one segment.

    Attributes
    ----------
    imu : Imu
        Its samples.
    starts : bool
        Whether the segment begins with it.
    gap_s : float
        Length of the gap before it, s; 0 if there is none.
    """

    imu: Imu
    starts: bool
    gap_s: float


def segments(blocks: Iterable[Imu], max_gap_ns: int) -> Iterator[Piece]:
    """Cut ordered samples at gaps.

    Parameters
    ----------
    blocks : iterable of Imu
        Ordered, without duplicates.
    max_gap_ns : int
        Longest interval that is not a gap.

    Yields
    ------
    Piece
        In order; a segment may come in several pieces, of which the first has ``starts``.
    """
    last: int | None = None
    for block in blocks:
        times = block.time_ns
        steps = np.diff(times, prepend=times[0] if last is None else last)
        cuts = np.flatnonzero(steps > max_gap_ns)
        edges = [0, *cuts.tolist(), len(times)]
        for begin, end in pairwise(edges):
            if begin == end:
                continue
            is_cut = bool(steps[begin] > max_gap_ns)
            first = last is None and begin == 0
            gap = float(steps[begin]) / SECOND if is_cut else 0.0
            yield Piece(block.rows(slice(begin, end)), first or is_cut, gap)
        last = int(times[-1])


def mean_rates(
    blocks: Iterable[Imu],
    nominal_ns: float | None = None,
    max_gap_ns: int | None = None,
    sample_rate: float | None = None,
) -> Iterator[Imu]:
    """Increments as mean rates over their own intervals.

    Parameters
    ----------
    blocks : iterable of Imu
        Ordered; gyro in rad and accel in m/s over the interval that ends at each stamp.
    nominal_ns : float, optional
        Interval of the first sample, and with `max_gap_ns` of samples after a gap. By default the
        first sample has the interval after it (a second if it is the only one), and a sample after
        a gap the interval between its stamp and the one before.
    max_gap_ns : int, optional
        Longest interval that is not a gap.
    sample_rate : float, optional
        Rate of all increments, Hz, which replaces the intervals between stamps.

    Yields
    ------
    Imu
        gyro in rad/s and accel in m/s^2.
    """
    last: int | None = None
    for block in _begun(blocks):
        times = block.time_ns
        step = np.diff(times, prepend=times[0] if last is None else last).astype(np.float64)
        if last is None:
            step[0] = nominal_ns or (step[1] if len(step) > 1 else SECOND)
        if nominal_ns is not None and max_gap_ns is not None:
            step[step > max_gap_ns] = nominal_ns
        if sample_rate is not None:
            step[:] = SECOND / sample_rate
        seconds = (step / SECOND)[:, None]
        yield Imu(
            times, block.log_time_ns, block.gyro / seconds, block.accel / seconds, block.orientation
        )
        last = int(times[-1])


def means_with_lost(blocks: Iterable[Imu], nominal_ns: float, max_gap_ns: int) -> Iterator[Imu]:
    """Mean rates in which a sample after a lost one is the mean over both intervals.

    A mean says nothing about the interval before its own. The lost mean is taken as the average of
    its neighbours; if it were taken equal to the one after it, the attitude of a rocking vehicle
    would change by more than the noise of good gyros. If a stamp is only late, the interval before
    or after it is shorter by as much, and nothing was lost.

    Parameters
    ----------
    blocks : iterable of Imu
        Ordered; means over an interval that ends at each stamp.
    nominal_ns : float
        That interval.
    max_gap_ns : int
        Longest interval that is not a gap; a mean after a gap is left as it is.

    Yields
    ------
    Imu
        All samples; each block ends one sample earlier than it came, and the last sample is a block
        of its own.
    """
    past: Imu | None = None  # two samples that were yielded, and one that was not
    for block in blocks:
        known = block if past is None else concatenate([past, block])
        given = 0 if past is None else len(past) - 1
        past = known.rows(slice(max(len(known) - 3, 0), None))
        if len(known) - 1 > given:
            yield _with_lost(known, slice(given, len(known) - 1), nominal_ns, max_gap_ns)
    if past is not None:
        yield _with_lost(past, slice(len(past) - 1, None), nominal_ns, max_gap_ns)


def _with_lost(known: Imu, which: slice, nominal_ns: float, max_gap_ns: int) -> Imu:
    """Some rows of samples, with means over both intervals after lost samples."""
    step = np.diff(known.time_ns)
    two = np.append(step[:-1] + step[1:], max_gap_ns) > (LOST_INTERVALS + 1.0) * nominal_ns
    lone = (step > LOST_INTERVALS * nominal_ns) & (step <= max_gap_ns)
    late = np.flatnonzero(lone & two & np.append(True, two[:-1])[: len(step)])
    late = late[late + 1 >= which.start]
    rows = known.rows(which)
    late = late[late + 1 < which.start + len(rows)]
    if not len(late):
        return rows
    lost = np.rint(step[late] / nominal_ns)[:, None] - 1.0
    means = []
    for values in (known.gyro, known.accel):
        own = values[which].copy()
        before, after = values[late], values[late + 1]
        own[late + 1 - which.start] = (after + 0.5 * lost * (before + after)) / (1.0 + lost)
        means.append(own)
    return replace(rows, gyro=means[0], accel=means[1])


def _begun(blocks: Iterable[Imu]) -> Iterator[Imu]:
    """The same samples, the first two of them in one block."""
    rest = iter(blocks)
    first = next(rest, None)
    while first is not None and len(first) < 2:
        second = next(rest, None)
        if second is None:
            break
        first = concatenate([first, second])
    if first is not None:
        yield first
    yield from rest


@dataclass(frozen=True)
class SortedStream(Generic[S]):
    """A slow stream held in memory, sorted by time.

    Attributes
    ----------
    backward : int
        Samples that were stamped earlier than the one before them in the file.
    repeated : int
        Samples that repeat a stamp.
    """

    stream: S
    backward: int
    repeated: int


def sorted_stream(
    blocks: Iterable[S], by_log_time: bool = False, repeats: bool = False
) -> SortedStream[S] | None:
    """A stream of one piece, sorted by stamp.

    Parameters
    ----------
    blocks : iterable of Stream
        In the order of the file.
    by_log_time : bool
        Use the times of the recorder as stamps.
    repeats : bool
        Keep samples that repeat a stamp; by default the first in the file stays.

    Returns
    -------
    SortedStream or None
        None if there are no samples.
    """
    parts = [b for b in blocks if len(b)]
    if not parts:
        return None
    stream = concatenate(parts)
    if len(stream) > LONG_STREAM:
        del parts
        return_freed_memory()
    if by_log_time:
        stream = replace(stream, time_ns=stream.log_time_ns)
    steps = np.diff(stream.time_ns)
    backward = int(np.count_nonzero(steps < 0))
    if backward:
        stream = stream.rows(np.argsort(stream.time_ns, kind="stable"))
        steps = np.diff(stream.time_ns)
    repeated = int(np.count_nonzero(steps == 0))
    if repeated and not repeats:
        stream = stream.rows(np.concatenate(([True], steps > 0)))
    return SortedStream(stream, backward, repeated)


def reblock(blocks: Iterator[S], rows: int) -> Iterator[S]:
    """The same samples in blocks of a given number of rows (the last may be shorter)."""
    waiting: list[S] = []
    count = 0
    for block in blocks:
        waiting.append(block)
        count += len(block)
        while count >= rows:
            joined = concatenate(waiting)
            yield joined.rows(slice(0, rows))
            waiting = [joined.rows(slice(rows, None))]
            count -= rows
    if count:
        yield concatenate(waiting)
