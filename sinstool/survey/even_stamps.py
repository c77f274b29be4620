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

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import ceil

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.order_statistics import MEDIAN_OVER_MEAN, SIGMA_PER_MAD, median, quantile
from sinstool.core.streams import Imu, concatenate
from sinstool.core.timeline import GAP_INTERVALS, SECOND
from sinstool.survey.late_stamps import LONGEST, MISSED, Late

# Length of a line through the stamps, s, and its least number of samples.
LINE_S, LEAST_SAMPLES = 2.0, 64
# No IMU samples more often than each so many ns: stamps of less are no times.
LEAST_NS = 10_000.0
# The product of the delay of the promptest samples and their number, over the usual delay, beyond
# which it is no chance (1e-10).
PROMPT = 24.0
# Least number of prompt samples that are compared, and rounds in which what is missing is found, as
# it makes delays look longer.
LEAST_PROMPT, ROUNDS = 16, 4
# Numbers of samples of half a stretch by which an interval is estimated, the least number of
# batches in it, and the sigmas beyond which an interval is longer than another.
HALVES, LEAST_BATCHES, LACKING = (8, LEAST_SAMPLES // 2, 3 * LEAST_SAMPLES), 4, 4.0
# Largest share of samples that may be missing one by one.
MOST_MISSING = 0.1
# Intervals are the same if so many samples are moved by less than this share of one.
SAME = 0.01
# Samples compared before and after a long interval, at most, and most intervals compared together.
MOST_NEARBY, ROWS = 2000, 1000
# Largest ratio of the variation of the lines' durations to that of independent intervals.
STEADY = 0.5
# Samples after which it is decided whether rates belong to the stamps.
SHOWN = 200_000


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


def even_stamps(
    blocks: Iterable[Imu], increments: bool, surely: bool = False, slight: bool = False
) -> EvenStamps | None:
    """Even times of samples, if their sensor takes them evenly.

    Parameters
    ----------
    blocks : iterable of Imu
        In the order of their stamps.
    increments : bool
        Samples are increments, not rates.
    surely : bool, optional
        The sensor is known to take them evenly.
    slight : bool, optional
        Stamps vary by little, and none is given where that turns less than the sensor's noise.

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
    if _usual_interval(stamp_ns)[0] < LEAST_NS:
        return None
    even = _lines(stamp_ns, False)
    if not surely:
        imu = concatenate(shown)
        if not _steady(even, stamp_ns):
            return None
        (block,) = even.applied([imu])
        late = Late(imu, block.time_ns, even.usual_ns)
        if late.follow_stamps(increments) or late.lack_samples:
            return None
        if slight and not late.matter(increments):
            return None
    return _lines(stamp_ns, True)


def _usual_interval(stamp_ns: IntArray, halves: Sequence[int] = HALVES) -> tuple[float, float]:
    """Interval of most samples and its sigma, ns: most stretches have all of their samples.

    Halves of stretches are compared by their means. Of samples that come in batches, a single
    stamp is late by up to a batch, so half a stretch holds whole batches: of as many samples as
    there are to each interval longer than the mean.

    Parameters
    ----------
    halves : sequence of int, optional
        Numbers of samples that are tried.
    """
    steps = np.diff(stamp_ns).astype(np.float64)
    steps = np.minimum(steps, quantile(steps, 0.99))  # gaps aside
    batch = round(len(steps) / np.count_nonzero(steps >= steps.mean()))
    sums = np.concatenate([[0], np.cumsum(stamp_ns - stamp_ns[0])])
    best: tuple[float, float] | None = None
    for half in halves:
        whole = batch * max(ceil(half / batch), LEAST_BATCHES)
        found = _by_halves(sums, min(whole, len(stamp_ns) // 4))
        # The longer, the better, unless most stretches lack samples and look longer
        if best is None or not _longer(found, best):
            best = found if best is None or found[1] < best[1] else best
    assert best is not None
    return best


def _longer(found: tuple[float, float], than: tuple[float, float]) -> bool:
    return found[0] - than[0] > LACKING * float(np.hypot(found[1], than[1]))


def _by_halves(sums: IntArray, half: int) -> tuple[float, float]:
    """Interval and its sigma, ns, by the means of both halves of stretches.

    Parameters
    ----------
    sums : ndarray, shape (n + 1,)
        Of all stamps before each one.
    """
    means = (sums[half:] - sums[:-half]) / half
    steps = means[half:] - means[:-half]
    usual = float(median(steps))
    # Of a median, by the median deviation of stretches, of which so many do not overlap
    off = float(median(np.abs(steps - usual)))
    sigma = MEDIAN_OVER_MEAN * SIGMA_PER_MAD * off / np.sqrt(len(sums) / (2 * half))
    return usual / half, sigma / half


def _lines(stamp_ns: IntArray, single: bool) -> EvenStamps:
    """Lines through the stamps, broken where samples are missing.

    Parameters
    ----------
    single : bool
        Whether single samples may be missing, too: else only many in a row.
    """
    interval_ns, _ = _usual_interval(stamp_ns, HALVES[1:2])
    gaps, skipped = _missing(stamp_ns, interval_ns, np.inf)
    if single:
        interval_ns, sigma_ns = _usual_interval(stamp_ns)
    for _ in range(ROUNDS if single else 0):
        some, few = _missing(stamp_ns, interval_ns, sigma_ns)
        if few[-1] > MOST_MISSING * len(stamp_ns):
            break
        gaps, skipped, before = some, few, interval_ns
        # Samples that are missing everywhere make the usual interval look longer
        moved = np.rint(interval_ns * skipped).astype(np.int64)
        interval_ns, sigma_ns = _usual_interval(stamp_ns - moved)
        if abs(interval_ns - before) * LEAST_SAMPLES < SAME * before:
            break
    width = _width(interval_ns)
    while True:
        even = _broken_at(gaps, skipped, stamp_ns, interval_ns, width)
        rows = _breaks(gaps, skipped)
        length = {row: seconds for row, (_, seconds) in zip(rows, even.gaps, strict=True)}
        # Between few samples that are late by chance lines may meet, or overlap: nothing is missing
        lacking = np.array([length[row] * SECOND > interval_ns for row in gaps.tolist()], np.bool_)
        if lacking.all():
            return even
        gaps = gaps[lacking]


def _width(interval_ns: float) -> int:
    """Number of samples of a line."""
    return max(LEAST_SAMPLES, round(LINE_S * SECOND / interval_ns))


def _breaks(gaps: IntArray, skipped: IntArray) -> list[int]:
    """First rows after missing samples, many or few."""
    few = np.flatnonzero(np.diff(skipped)) + 1
    rows: list[int] = np.union1d(gaps, few).tolist()
    return rows


def _broken_at(
    gaps: IntArray, skipped: IntArray, stamp_ns: IntArray, interval_ns: float, width: int
) -> EvenStamps:
    """Lines of about `width` samples that are broken before those rows; see :func:`_lines`.

    Parameters
    ----------
    gaps : ndarray of int64
        Rows before which an unknown number of samples is missing.
    skipped : ndarray of int64, shape (n,)
        Samples that are missing before each row, as far as their number is known.
    """
    begin_ns, number = int(stamp_ns[0]), np.arange(len(stamp_ns))
    late = (stamp_ns - begin_ns) - interval_ns * (number + skipped)
    few = np.flatnonzero(np.diff(skipped)) + 1
    breaks = np.concatenate([[0], gaps, [len(stamp_ns)]])
    first, count, time, interval = [], [], [], []
    for begin, end in pairwise(breaks.tolist()):
        usual = np.linspace(begin, end, max(1, round((end - begin) / width)) + 1, dtype=int)
        inside = few[np.searchsorted(few, begin, "right") : np.searchsorted(few, end)]
        edges = np.union1d(usual, inside)
        if end - begin < LEAST_SAMPLES:
            offset = np.full(len(edges), median(late[begin:end]))
        else:
            half = width // 2
            offset = np.array(
                [median(late[max(e - half, begin) : min(e + half, end)]) for e in edges]
            )
        at = offset + interval_ns * (edges + skipped[np.minimum(edges, end - 1)])
        till = offset + interval_ns * (edges + skipped[np.maximum(edges - 1, begin)])
        first += edges[:-1].tolist()
        count += np.diff(edges).tolist()
        time += at[:-1].tolist()
        interval += ((till[1:] - at[:-1]) / np.diff(edges)).tolist()
    start = begin_ns + np.rint(time).astype(np.int64)
    numbers = number - np.repeat(first, count)
    even = EvenStamps(stamp_ns[first], np.array(count), start, np.array(interval), (), 0.0, 0.0)
    times = even.times(np.repeat(np.arange(len(first)), count), numbers)
    off = (stamp_ns - times).astype(np.float64)
    lacking = tuple(
        (int(times[k - 1]), float(times[k] - times[k - 1]) / SECOND) for k in _breaks(gaps, skipped)
    )
    return replace(even, gaps=lacking, jitter_ns=float(off.std()), most_ns=float(np.abs(off).max()))


def _missing(stamp_ns: IntArray, interval_ns: float, sigma_ns: float) -> tuple[IntArray, IntArray]:
    """Where samples are missing: from there on all are later than the promptest before.

    A stall of the computer makes one long interval too, but then the samples that waited arrive at
    once. Where delays are short, even one missing sample shows: that the promptest of n is late by
    t, with delays of which u is usual, has the probability ``exp(-n t / u)``.

    Parameters
    ----------
    interval_ns, sigma_ns : float
        Usual interval and its sigma; with an infinite one no single samples are found.

    Returns
    -------
    gaps : ndarray of int64
        First rows after many missing samples.
    skipped : ndarray of int64, shape (n,)
        Samples before each row that are missing elsewhere, a few together.
    """
    late = (stamp_ns - int(stamp_ns[0])) - interval_ns * np.arange(len(stamp_ns))
    nearby = min(_width(interval_ns) // 2, MOST_NEARBY)
    drift_ns = 2.0 * sigma_ns * nearby
    steps = np.diff(stamp_ns)
    if np.isinf(sigma_ns):
        rows = np.flatnonzero(steps > GAP_INTERVALS * interval_ns) + 1
        return _rises(late, rows, interval_ns, nearby, 0.0, np.inf)
    # Samples that came at once waited for the last of them, which alone may be prompt
    last = np.append(np.flatnonzero(steps > (MISSED - 1.0) * interval_ns), len(late) - 1)
    first = np.concatenate([[0], last[:-1] + 1])
    prompt, nearby = late[last], max(LEAST_PROMPT, nearby * len(last) // len(late))
    rows = np.flatnonzero(steps[first[1:] - 1] > MISSED * interval_ns) + 1
    skipped = np.zeros(len(last), np.int64)
    for _ in range(ROUNDS):
        blocks = prompt - interval_ns * skipped
        blocks = blocks[: len(blocks) - len(blocks) % nearby].reshape(-1, nearby)
        usual = float(median(blocks.mean(axis=1) - blocks.min(axis=1))) if len(blocks) else np.inf
        before = skipped
        gaps, skipped = _rises(prompt, rows, interval_ns, nearby, usual, drift_ns)
        if (skipped == before).all():
            break
    if usual > interval_ns:
        # What is late by more than an interval looks like what follows a lost sample
        gaps, skipped = _rises(prompt, rows, interval_ns, nearby, usual, np.inf)
    return first[gaps], np.repeat(skipped, last - first + 1)


def _rises(
    late: FloatArray,
    rows: IntArray,
    interval_ns: float,
    nearby: int,
    usual_ns: float,
    drift_ns: float,
) -> tuple[IntArray, IntArray]:
    """Rows from which on `late` is larger, by many intervals or by a few; see :func:`_missing`.

    Parameters
    ----------
    late : ndarray, shape (n,)
        Delays of the promptest samples, ns.
    rows : ndarray of int64
        Those that may follow missing samples.
    nearby : int
        Number of samples that are compared before and after.
    usual_ns : float
        Usual delay.
    drift_ns : float
        By which `late` may change over as many samples, as the interval is uncertain.
    """
    limit = (GAP_INTERVALS - 1.0) * interval_ns
    least = (MISSED - 1.0) * interval_ns + drift_ns
    shown = min(max(least, PROMPT * usual_ns / nearby), limit)
    around = sliding_window_view(np.pad(late, nearby, constant_values=np.inf), nearby)
    doubtful = []
    for some in np.array_split(rows, 1 + len(rows) // ROWS):
        rise = around[some + nearby].min(axis=1) - around[some].min(axis=1)
        doubtful += some[rise > shown].tolist()
    gaps, skipped, done, lost = [0], np.zeros(len(late), dtype=np.int64), 0, 0
    for row in doubtful:
        skipped[done:row] = lost
        done = row
        # What lies beyond the gap before says nothing
        begin = max(gaps[-1], row - nearby)
        before = late[begin:row] - interval_ns * skipped[begin:row]
        after = late[row : row + nearby] - interval_ns * lost
        rise = float(after.min() - before.min())
        number = min(len(before), len(after))
        # At an end of the log, or soon after a gap, all may be late by chance
        few = number < nearby
        most = limit + (3.0 * max(np.ptp(before), np.ptp(after)) if few else 0.0)
        shown = max(least, PROMPT * usual_ns / number)
        if rise > most:
            gaps.append(row)
        elif rise > shown and shown < limit:
            lost += max(1, round(rise / interval_ns))
    skipped[done:] = lost
    return np.array(gaps[1:], dtype=np.int64), skipped


def _steady(even: EvenStamps, stamp_ns: IntArray) -> bool:
    """Whether delays of stamps do not add up from sample to sample."""
    whole = even.count >= LEAST_SAMPLES
    steps = np.minimum(np.diff(stamp_ns), LONGEST * even.usual_ns)
    if whole.sum() < 2:
        return len(even.count) == 1 and bool(steps.std())
    apart = ((even.interval_ns - even.usual_ns) * np.sqrt(even.count))[whole].std()
    return bool(apart < STEADY * steps.std())
