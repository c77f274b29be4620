"""Data collected for figures while a log is inspected, in bounded memory."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.envelope import Envelope
from sinstool.core.streams import Imu
from sinstool.core.timeline import GAP_INTERVALS, SECOND
from sinstool.core.units import DEGREE
from sinstool.io.readers.frames import turn_body

# Bins of messages over time; they merge in pairs at twice this number.
BINS = 2000


FIRST_BIN_NS = 10_000_000


# A point of a topic's rate is the mean over so many messages at least.
MESSAGES = 20.0


# Of a topic's rate over time.
POINTS = 300


# Steps back of stamps that are drawn.
STEPS = 2000


# Relative width of the bins of intervals, from 100 ns on.
FINE = 1e-3


SHORTEST_NS = 100.0


FINE_BINS = int(np.log(1e15 / SHORTEST_NS) / FINE) + 1


BARS = 50


INCREMENTS = (
    "Increments, each divided by the time since the sample before; those after a gap are left out."
)


class _Watcher(ABC):
    """Looks at every block, anew each time that reading begins again."""

    _envelope: Envelope

    def watch(self, blocks: Iterator[Imu]) -> Iterator[Imu]:
        """The same blocks."""
        self._clear()
        for block in blocks:
            self._add(block)
            yield block

    def curves(self, origin_ns: int) -> tuple[FloatArray, FloatArray]:
        """Seconds and columns, through the lowest and the highest of each group."""
        return self._envelope.curves(origin_ns)

    @property
    def rows_per_group(self) -> int:
        """Samples of a group of :meth:`curves`."""
        return self._envelope.rows_per_group

    @abstractmethod
    def _clear(self) -> None: ...

    @abstractmethod
    def _add(self, block: Imu) -> None: ...


class Values(_Watcher):
    """Readings of one IMU topic in the order of time, in the log's axes.

    Parameters
    ----------
    body_axes : {'flu', 'frd'}
        Of the log.
    increments : bool
        What comes were increments, each divided by the time since the sample before. After a
        gap, that is not the time in which it grew, and it is left out.
    """

    def __init__(self, body_axes: str, increments: bool = False) -> None:
        self._body_axes = body_axes
        self.increments = increments
        self._clear()

    def _clear(self) -> None:
        # rate, deg/s; force and its norm, m/s²
        self._envelope = Envelope(7)
        self._last: int | None = None
        self._longest = np.inf

    def _add(self, block: Imu) -> None:
        accel = turn_body(block.accel, self._body_axes)
        norm = np.linalg.norm(accel, axis=1)
        gyro = turn_body(block.gyro, self._body_axes) / DEGREE
        values = np.column_stack([gyro, accel, norm])
        if self.increments:
            values[self._after_gap(block.time_ns)] = np.nan
        self._envelope.push(block.time_ns, values)

    def _after_gap(self, time_ns: IntArray) -> BoolArray:
        """Whether each sample follows a longer interval than usual at the log's beginning."""
        steps = np.diff(time_ns, prepend=time_ns[0] if self._last is None else self._last)
        if np.isinf(self._longest) and len(time_ns) > 1:
            self._longest = GAP_INTERVALS * float(np.median(steps[1:]))
        self._last = int(time_ns[-1])
        return np.asarray(steps > self._longest)


class Sampling(_Watcher):
    """Intervals and clocks of one IMU topic, in the order of the file.

    Parameters
    ----------
    values : Values
        Of the same topic.
    """

    def __init__(self, topic: str, values: Values) -> None:
        self.topic = topic
        self.values = values
        self._clear()

    def _clear(self) -> None:
        # interval and delay, ms
        self._envelope = Envelope(2)
        self._newest: int | None = None
        self._before: int | None = None
        self._intervals = np.zeros(FINE_BINS, np.int64)
        self.back: list[tuple[int, float]] = []
        self.least_delay_ns: int | None = None

    def _add(self, block: Imu) -> None:
        times = block.time_ns
        before = times[0] if self._before is None else self._before
        steps = np.diff(times, prepend=before).astype(np.float64)
        if self._before is None:
            steps[0] = np.nan
        newest = np.maximum.accumulate(times)
        if self._newest is not None:
            newest = np.maximum(newest, self._newest)
        self._before, self._newest = int(times[-1]), int(newest[-1])
        for k in np.flatnonzero(steps < 0.0)[: STEPS - len(self.back)]:
            self.back.append((int(newest[k]), float(-steps[k]) / 1e6))
        on = steps[steps > 0.0]
        place = (np.log(np.maximum(on, SHORTEST_NS) / SHORTEST_NS) / FINE).astype(np.intp)
        self._intervals += np.bincount(np.minimum(place, FINE_BINS - 1), minlength=FINE_BINS)
        delay = block.log_time_ns - times
        least = int(delay.min())
        if self.least_delay_ns is None or least < self.least_delay_ns:
            self.least_delay_ns = least
        shown = np.column_stack([np.where(steps > 0.0, steps, np.nan) / 1e6, delay / 1e6])
        self._envelope.push(newest, shown)

    def shares(self) -> tuple[FloatArray, FloatArray, int]:
        """Counts of the intervals: the usual ones in bins, and the others.

        Returns
        -------
        middles : ndarray, shape (k,)
            Of bins about the usual ones, ms.
        counts : ndarray, shape (k,)
        outside : int
            Intervals beyond them.
        """
        total = int(self._intervals.sum())
        if not total:
            return np.empty(0), np.empty(0), 0
        cumulated = np.cumsum(self._intervals)
        low, median, high = (
            SHORTEST_NS * np.exp(FINE * (np.searchsorted(cumulated, share * total) + 0.5)) / 1e6
            for share in (0.001, 0.5, 0.999)
        )
        half = max(1.3 * (median - low), 1.3 * (high - median), 0.02 * median)
        half = min(half, 3.0 * median)
        edges = np.linspace(max(median - half, 0.0), median + half, BARS + 1)
        filled = np.flatnonzero(self._intervals)
        at = SHORTEST_NS * np.exp(FINE * (filled + 0.5)) / 1e6
        counts, _ = np.histogram(at, edges, weights=self._intervals[filled])
        middles = 0.5 * (edges[1:] + edges[:-1])
        return middles, counts, total - int(counts.sum())


class Traffic:
    """Messages over time by topic."""

    def __init__(self) -> None:
        self.width_ns = FIRST_BIN_NS
        self.first_ns: int | None = None
        self._counts: dict[str, IntArray] = {}

    def add(self, topic: str, log_time_ns: IntArray) -> None:
        """Count messages of a topic; those earlier than the first of all count as its."""
        if self.first_ns is None:
            self.first_ns = int(log_time_ns[0])
        since = np.maximum(log_time_ns - self.first_ns, 0)
        while int(since.max()) >= 2 * BINS * self.width_ns:
            self.width_ns *= 2
            for name, counts in self._counts.items():
                merged = counts.reshape(-1, 2).sum(axis=1)
                self._counts[name] = np.concatenate([merged, np.zeros(BINS, np.int64)])
        if topic not in self._counts:
            self._counts[topic] = np.zeros(2 * BINS, np.int64)
        self._counts[topic] += np.bincount(since // self.width_ns, minlength=2 * BINS)

    def rates(self) -> Iterator[tuple[str, FloatArray, FloatArray]]:
        """Yield each topic's name, times (s) and rates (Hz; NaN where there is no message)."""
        filled = [np.flatnonzero(counts)[-1] + 1 for counts in self._counts.values()]
        used = max(filled, default=0)
        for topic, counts in sorted(self._counts.items()):
            total = int(counts.sum())
            bins = int(np.ceil(max(used / POINTS, MESSAGES * used / total)))
            whole = used // bins
            if not whole or total < MESSAGES:
                continue
            width = bins * self.width_ns / SECOND
            sums = counts[: whole * bins].reshape(whole, bins).sum(axis=1)
            rate = np.where(sums > 0, sums / width, np.nan)
            yield topic, (np.arange(whole) + 0.5) * width, rate
