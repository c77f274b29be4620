"""Times of samples that a sensor takes evenly, from stamps of their receipt.

Many drivers stamp a sample when it reaches the computer, milliseconds late and never equally so.
As rates over such intervals, samples are wrong by what their stamps jitter; intervals look like
gaps where nothing is missing. A sensor's own clock is steady: against it stamps are late by
amounts that do not add up. So the time of a sample is taken from a line through the stamps of two
seconds, sample by sample, and lines that follow each other meet.

Not all stamps that jitter are of receipt: where a computer asks a sensor for its value, at times
that vary, the stamps are right. Then the rates fit the stamps, and not even times: between its
neighbours a rate changes as its own stamp says. The two are told apart by a regression.

References
----------
.. [1] S. Sinha et al., "Lab streaming layer", time synchronisation: "dejittering" of stamps by a
   line through them, broken where samples are missing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from math import ceil

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.order_statistics import median, quantile
from sinstool.core.streams import Imu, concatenate
from sinstool.core.timeline import GAP_INTERVALS, SECOND

# Length of a line through the stamps, s, and its least number of samples.
LINE_S, LEAST_SAMPLES = 2.0, 64
# No Imu samples more often than each so many ns: stamps of less are no times.
LEAST_NS = 10_000.0
# Samples compared before and after a long interval, at most, and most intervals compared together.
MOST_NEARBY, ROWS = 2000, 1000
# Largest ratio of the variation of the lines' durations to that of independent intervals; an
# interval counts as at most so many usual ones.
STEADY, LONGEST = 0.5, 10.0
# A regression on the stamps gives 0 for even samples and 1 if the stamps are right: the limit
# between both, the sigmas from 0 beyond which it counts, and the samples after which it is decided.
HALF_WAY, BELIEVED, SHOWN = 0.5, 4.0, 200_000


@dataclass(frozen=True)
class EvenStamps:
    """Even times of samples, in lines.

    Attributes
    ----------
    stamp_ns : ndarray, shape (c,)
        Stamp of the first sample of each line, in order.
    count : ndarray, shape (c,)
        Number of samples of each line.
    time_ns : ndarray, shape (c,)
        Even time of the first sample.
    interval_ns : ndarray, shape (c,)
        From sample to sample.
    gaps : tuple of (int, float)
        Where samples are missing: the even time before the gap, ns, and its length, s.
    jitter_ns, most_ns : float
        Differences of stamps from even times: standard deviation, and the largest.
    """

    stamp_ns: IntArray
    count: IntArray
    time_ns: IntArray
    interval_ns: FloatArray
    gaps: tuple[tuple[int, float], ...]
    jitter_ns: float
    most_ns: float

    @property
    def usual_ns(self) -> float:
        """The interval of most samples."""
        return float(np.average(self.interval_ns, weights=self.count))

    def times(self, line: IntArray, number: IntArray) -> IntArray:
        """Even times of samples, by their line and their number in it."""
        later = np.rint(self.interval_ns[line] * number).astype(np.int64)
        return np.asarray(self.time_ns[line] + later)

    def sample_from(self, time_ns: int) -> int:
        """Time of the first sample that is not before a time; that of the last one at most."""
        line = max(int(np.searchsorted(self.time_ns, time_ns, side="right")) - 1, 0)
        number = ceil(max(time_ns - int(self.time_ns[line]), 0) / self.interval_ns[line])
        # Of one or two that rounding makes doubtful
        for k in (number - 1, number):
            if 0 <= k < self.count[line]:
                at = int(self.times(np.array([line]), np.array([k]))[0])
                if at >= time_ns:
                    return at
        if line + 1 < len(self.time_ns):
            return int(self.time_ns[line + 1])
        return self.last_ns

    @property
    def last_ns(self) -> int:
        """Time of the last sample."""
        last = len(self.time_ns) - 1
        return int(self.times(np.array([last]), self.count[-1:] - 1)[0])

    def line_before(self, time_ns: int) -> int:
        """Stamp of the first sample of the line to which a time belongs."""
        line = max(int(np.searchsorted(self.time_ns, time_ns, side="right")) - 1, 0)
        return int(self.stamp_ns[line])

    def applied(self, blocks: Iterable[Imu]) -> Iterator[Imu]:
        """The same samples at their even times.

        Parameters
        ----------
        blocks : iterable of Imu
            In the order of their stamps, from the first sample of a line on.
        """
        line, number = -1, 0
        for block in blocks:
            first = np.searchsorted(self.stamp_ns, block.time_ns, side="right") - 1
            begins = np.flatnonzero(np.diff(first, prepend=line) != 0)
            # Number of each sample in its line: from where that begins, or goes on
            row = np.arange(len(block))
            begun = np.concatenate([[-number], begins])
            numbers = row - begun[np.searchsorted(begins, row, side="right")]
            yield replace(block, time_ns=self.times(first, numbers))
            line, number = int(first[-1]), int(numbers[-1]) + 1


def even_stamps(blocks: Iterable[Imu], increments: bool, surely: bool = False) -> EvenStamps | None:
    """Even times of samples, if their sensor takes them evenly.

    Parameters
    ----------
    blocks : iterable of Imu
        In the order of their stamps.
    increments : bool
        Samples are increments, not rates.
    surely : bool, optional
        The sensor is known to take them evenly.

    Returns
    -------
    EvenStamps or None
        None where stamps vary as if each interval were another, or where the rates belong to the
        stamps as they are.
    """
    stamps: list[IntArray] = []
    shown: list[Imu] = []
    seen = 0
    for block in blocks:
        stamps.append(block.time_ns)
        if seen < SHOWN:
            shown.append(replace(block, orientation=None))
        seen += len(block)
    if seen < 2 * LEAST_SAMPLES:
        return None
    stamp_ns = np.concatenate(stamps)
    interval_ns = _usual_interval(stamp_ns)
    if interval_ns < LEAST_NS:
        return None
    even = _lines(stamp_ns, interval_ns)
    if surely:
        return even
    if not _steady(even, stamp_ns):
        return None
    return None if _right(even, concatenate(shown), increments) else even


def _usual_interval(stamp_ns: IntArray) -> float:
    """Interval of most samples, ns: where few are missing, most stretches have them all.

    Halves of stretches are compared by their means. Of samples that come in batches, a single
    stamp is late by up to a batch, and always by as much where the batches divide a stretch. Half a
    stretch holds a batch at least: as many as there are to each interval longer than the mean.
    """
    steps = np.diff(stamp_ns).astype(np.float64)
    steps = np.minimum(steps, quantile(steps, 0.99))  # gaps aside
    batch = len(steps) / np.count_nonzero(steps >= steps.mean())
    half = min(max(LEAST_SAMPLES // 2, ceil(2.0 * batch)), len(stamp_ns) // 4)
    sums = np.concatenate([[0], np.cumsum(stamp_ns - stamp_ns[0])])
    means = (sums[half:] - sums[:-half]) / half
    return float(median(means[half:] - means[:-half])) / half


def _lines(stamp_ns: IntArray, interval_ns: float) -> EvenStamps:
    """Lines through the stamps, broken where samples are missing."""
    begin_ns = int(stamp_ns[0])
    late = (stamp_ns - begin_ns) - interval_ns * np.arange(len(stamp_ns))
    width = max(LEAST_SAMPLES, round(LINE_S * SECOND / interval_ns))
    missing = _missing(stamp_ns, late, interval_ns, min(width // 2, MOST_NEARBY))
    while True:
        even = _broken_at(missing, stamp_ns, late, interval_ns, width)
        # Between few samples that are late by chance lines may meet, or overlap: nothing is missing
        lacking = np.array([seconds * SECOND > interval_ns for _, seconds in even.gaps], np.bool_)
        if lacking.all():
            return even
        missing = missing[lacking]


def _broken_at(
    missing: IntArray, stamp_ns: IntArray, late: FloatArray, interval_ns: float, width: int
) -> EvenStamps:
    """Lines of about `width` samples that are broken before those rows."""
    begin_ns = int(stamp_ns[0])
    breaks = np.concatenate([[0], missing, [len(stamp_ns)]])
    first, count, time, interval = [], [], [], []
    for begin, end in pairwise(breaks.tolist()):
        edges = np.linspace(begin, end, max(1, round((end - begin) / width)) + 1, dtype=int)
        edges = edges[np.append(True, np.diff(edges) > 0)]
        if end - begin < LEAST_SAMPLES:
            offset = np.full(len(edges), median(late[begin:end]))
        else:
            half = width // 2
            offset = np.array(
                [median(late[max(e - half, begin) : min(e + half, end)]) for e in edges]
            )
        at = offset + interval_ns * edges
        first += edges[:-1].tolist()
        count += np.diff(edges).tolist()
        time += at[:-1].tolist()
        interval += (np.diff(at) / np.diff(edges)).tolist()
    start = begin_ns + np.rint(time).astype(np.int64)
    numbers = np.arange(len(stamp_ns)) - np.repeat(first, count)
    even = EvenStamps(stamp_ns[first], np.array(count), start, np.array(interval), (), 0.0, 0.0)
    times = even.times(np.repeat(np.arange(len(first)), count), numbers)
    off = (stamp_ns - times).astype(np.float64)
    gaps = tuple(
        (int(times[k - 1]), float(times[k] - times[k - 1]) / SECOND) for k in breaks[1:-1].tolist()
    )
    return replace(even, gaps=gaps, jitter_ns=float(off.std()), most_ns=float(np.abs(off).max()))


def _missing(stamp_ns: IntArray, late: FloatArray, interval_ns: float, nearby: int) -> IntArray:
    """First samples after gaps: from there on all are later than the promptest before.

    A stall of the computer makes one long interval too, but then the samples that waited arrive at
    once.
    """
    rows = np.flatnonzero(np.diff(stamp_ns) > GAP_INTERVALS * interval_ns) + 1
    limit = (GAP_INTERVALS - 1.0) * interval_ns
    around = sliding_window_view(np.pad(late, nearby, constant_values=np.inf), nearby)
    doubtful = []
    for some in np.array_split(rows, 1 + len(rows) // ROWS):
        rise = around[some + nearby].min(axis=1) - around[some].min(axis=1)
        doubtful += some[rise > limit].tolist()
    missing = [0]
    for row in doubtful:
        # What lies beyond the gap before says nothing
        before, after = late[max(missing[-1], row - nearby) : row], late[row : row + nearby]
        # At an end of the log, or soon after a gap, all may be late by chance
        few = min(len(before), len(after)) < nearby
        most = limit + (3.0 * max(np.ptp(before), np.ptp(after)) if few else 0.0)
        if after.min() - before.min() > most:
            missing.append(row)
    return np.array(missing[1:], dtype=np.int64)


def _steady(even: EvenStamps, stamp_ns: IntArray) -> bool:
    """Whether delays of stamps do not add up from sample to sample."""
    whole = even.count >= LEAST_SAMPLES
    steps = np.minimum(np.diff(stamp_ns), LONGEST * even.usual_ns)
    if whole.sum() < 2:
        return len(even.count) == 1 and bool(steps.std())
    apart = ((even.interval_ns - even.usual_ns) * np.sqrt(even.count))[whole].std()
    return bool(apart < STEADY * steps.std())


def _right(even: EvenStamps, imu: Imu, increments: bool) -> bool:
    """Whether the rates follow the stamps: by their change where intervals vary."""
    (block,) = even.applied([imu])
    late = (imu.time_ns - block.time_ns) / SECOND
    interval = even.usual_ns / SECOND
    kept = slice(3, len(imu) - 3)
    between = _between(late[:, None])[kept]
    residual = _between(imu.gyro)[kept]
    if increments:
        # An increment is as long as its own interval
        mean = np.cumsum(imu.gyro, axis=0)
        rate = (mean[6:] - mean[:-6]) / (6.0 * interval)
        expected = rate * _between(np.diff(late, prepend=late[0])[:, None])[kept]
    else:
        slope = (imu.gyro[6:] - imu.gyro[:-6]) / (6.0 * interval)
        expected = slope * between
    # Across a gap neither rates nor times belong together
    whole = (
        np.convolve(np.diff(block.time_ns) > GAP_INTERVALS * even.usual_ns, np.ones(6))[5:-5] < 1
    )
    residual, expected = residual[whole], expected[whole]
    square = float(np.sum(expected**2))
    if not square:
        return False
    factor = float(np.sum(residual * expected)) / square
    sigma = float(np.sqrt(np.sum((residual - factor * expected) ** 2 * expected**2))) / square
    return factor > HALF_WAY and factor > BELIEVED * sigma


def _between(values: FloatArray) -> FloatArray:
    """Each value less the mean of its neighbours; zero at both ends."""
    out = np.zeros_like(values)
    out[1:-1] = values[1:-1] - 0.5 * (values[2:] + values[:-2])
    return out
