"""Clocks that were set in the middle of a log: places and sizes of their steps.

A computer without a clock of its own starts at some time, and sets its clock when it reaches a
server. What it stamps, and its times of recording, then run back or leap, while sensors sample on.
The order of the file tells: it is that of arrival. Late messages run back too, but fill a hole when
they are put in their place, while a clock that was set back counts the same time twice.

References
----------
.. [1] D. L. Mills et al., "Network time protocol version 4", RFC 5905, 2010: the step threshold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.order_statistics import MEDIAN_OVER_MEAN, SIGMA_PER_MAD, median
from sinstool.core.timeline import GAP_INTERVALS, SECOND

# Steps below this are lost in the delays of messages, ns.
LEAST_NS = 20_000_000
# Messages on each side that are compared: those of half a second, but so many.
NEAR_NS, FEWEST, FEW, MANY = SECOND // 2, 3, 8, 100
# A step is so many of its standard deviations in size, and the times on both sides of it show it
# but for this share.
SURE, ALIKE = 6.0, 0.3
# A clock that is off by less than this is not set, but goes faster or slower for a while [1]_:
# steps so small that go either way are those of a delay.
SLEWED_NS = 128_000_000
# Who sets a clock more often than this disciplines it.
MOST_STEPS = 20
# Times of recording go at most so many times as fast as stamps, or as slowly.
PACE = 1.3
# Least share of the time that is counted twice for which there are samples of before.
TWICE = 0.5
# No message is recorded before it is stamped, apart from small differences of two clocks: a delay
# below zero is as unlikely as one that is so many times as long.
EARLY = 10.0
# Parts of a recording in the wrong order meet within this, ns; longer delays than this are none.
MEET_NS, SLOWEST_NS = SECOND, 10 * SECOND


@dataclass(frozen=True)
class Step:
    """A step of a clock.

    Attributes
    ----------
    row : int
        The first message behind it, in the order of the file.
    size_ns : int
        By how much it was set forward.
    from_there : bool
        It was right before: there delays of messages are the likelier ones.
    """

    row: int
    size_ns: int
    from_there: bool = False


@dataclass(frozen=True)
class Level:
    """What times behind a row are later than before it.

    Attributes
    ----------
    rise, noise : float
        Difference of the medians and its standard deviation, ns.
    interval : float
        From message to message.
    before : float
        Median before the row.
    """

    rise: float
    noise: float
    interval: float
    before: float

    @property
    def sure(self) -> bool:
        """Whether it is a step at all."""
        return abs(self.rise) > LEAST_NS and abs(self.rise) > SURE * self.noise

    @property
    def unlikely(self) -> tuple[float, float]:
        """How unlikely delays are before the row and behind: as long, or as far below zero."""
        before, behind = (
            max(delay, -EARLY * delay) for delay in (self.before, self.before + self.rise)
        )
        return before, behind


def recorder_steps(log_ns: IntArray) -> list[Step]:
    """Steps back of the clock by which one channel's messages were recorded.

    Parameters
    ----------
    log_ns : ndarray, shape (n,)
        In the order of the file.
    """
    rows = np.flatnonzero(np.diff(log_ns) < -LEAST_NS) + 1
    if len(rows) > MOST_STEPS:
        return []
    found = []
    for row in rows.tolist():
        level = even_level(log_ns, row)
        if level is None or not level.sure or not _again(log_ns, row, level):
            continue
        if _repeated(log_ns, row):
            continue
        leap = float(log_ns[row] - log_ns[row - 1]) - level.interval
        if abs(level.rise - leap) <= ALIKE * abs(level.rise):
            found.append(Step(row, round(level.rise)))
    return found


def stamp_steps(time_ns: IntArray, log_ns: IntArray) -> list[Step]:
    """Steps of the clock by which messages were stamped, against that of the recorder.

    Parameters
    ----------
    time_ns, log_ns : ndarray, shape (n,)
        Stamps and log times, in the order of the file; log times without steps.
    """
    time_ns = time_ns.copy()
    leaps = np.abs(np.diff(time_ns - log_ns))
    rows = np.flatnonzero(leaps > LEAST_NS)
    rows = np.sort(rows[np.argsort(-leaps[rows], kind="stable")[: 5 * MOST_STEPS]]) + 1
    found = []
    for row in rows.tolist():
        step = _stamp_step(time_ns, log_ns, row)
        if step is not None:
            found.append(step)
            move(time_ns, step, row)
    found = _without_delays(found)
    return found if len(found) <= MOST_STEPS else []


def _without_delays(steps: list[Step]) -> list[Step]:
    """The steps without those that only show that a delay comes and goes."""
    small = [step for step in steps if abs(step.size_ns) < SLEWED_NS]
    if len({step.size_ns > 0 for step in small}) < 2:
        return steps
    return [step for step in steps if step not in small]


def _stamp_step(time_ns: IntArray, log_ns: IntArray, row: int) -> Step | None:
    """The step of the stamps before a row; None where it is none, or may be a delay."""
    level = delay_level(time_ns, log_ns, row)
    if level is None or not level.sure or not same_pace(time_ns, log_ns, row):
        return None
    rise, interval = -level.rise, level.interval
    step = float(time_ns[row] - time_ns[row - 1])
    recorded = float(log_ns[row] - log_ns[row - 1])
    # Either may be the steadier measure of what stamps leapt by just there
    usual = interval * max(round(recorded / interval), 1) if interval > 0.0 else recorded
    if min(abs(step - recorded - rise), abs(step - usual - rise)) > ALIKE * abs(rise):
        return None
    if rise < 0.0:
        # Stamps that are too close to each other; what is only recorded late is not
        stepped = step < interval - (1.0 - ALIKE) * abs(rise) and _again(time_ns, row, level)
    else:
        # A queue that lost what it held makes stamps leap too, but they were recorded late before
        soon = not rise - LEAST_NS <= level.before <= rise + SLOWEST_NS
        stepped = (soon or _off_grid(time_ns, row)) and recorded > 0.5 * interval
        between = (time_ns > time_ns[row - 1] + interval / 2) & (time_ns < time_ns[row] - interval)
        stepped &= not between[row:].any()
    if not stepped:
        return None
    before, behind = level.unlikely
    return Step(row, whole_size(time_ns, row, rise, level.noise), before < behind)


def same_pace(time_ns: IntArray, log_ns: IntArray, row: int) -> bool:
    """Whether times of recording go on as stamps do, before a row and behind it.

    Those of a log that was written anew may be of its writing, and after a stall of the recorder
    comes at once what has waited.
    """
    begin, end = _near(log_ns, row)
    if begin is None or end is None:
        return False
    stamped, recorded = (
        float(times[row - 1] - times[begin] + times[end - 1] - times[row])
        for times in (time_ns, log_ns)
    )
    return stamped / PACE < recorded < stamped * PACE


def _off_grid(time_ns: IntArray, row: int) -> bool:
    """Whether stamps of a slow sensor are on a grid, but those before and behind on others."""
    level = even_level(time_ns, row)
    if level is None or level.interval < LEAST_NS:
        return False
    leap = float(time_ns[row] - time_ns[row - 1])
    off = abs(leap - level.interval * round(leap / level.interval))
    return off > max(2.0 * SURE * level.noise, LEAST_NS)


def whole_size(time_ns: IntArray, row: int, rise: float, noise: float) -> int:
    """Size of a step by the intervals of the stamps, where these are steadier than delays."""
    level = even_level(time_ns, row)
    if level is None or level.noise > noise or not level.interval > 0.0:
        return round(rise)
    # Messages may have been lost just there
    lost = round((level.rise - rise) / level.interval)
    return round(level.rise - lost * level.interval)


def even_level(time_ns: IntArray, row: int) -> Level | None:
    """Times about a row, less those of even samples; None where there are too few."""
    begin, end = _near(time_ns, row)
    if begin is None:
        return None
    times = (time_ns[begin:end] - time_ns[row]).astype(np.float64)
    here = row - begin
    spans = (times[here - 1] - times[0], times[-1] - times[here])
    interval = sum(spans) / (len(times) - 2)
    late = times - interval * (np.arange(len(times)) - here)
    return _level(late, here, interval)


def delay_level(time_ns: IntArray, log_ns: IntArray, row: int) -> Level | None:
    """Log times less stamps about a row; None where there are too few."""
    begin, end = _near(log_ns, row)
    if begin is None:
        return None
    delay = (log_ns[begin:end] - time_ns[begin:end]).astype(np.float64)
    # Intervals of stamps: those of recording may be batches
    interval = float(median(np.diff(time_ns[begin:end])))
    return _level(delay, row - begin, interval)


def _near(time_ns: IntArray, row: int) -> tuple[int, int] | tuple[None, None]:
    """First and last of the messages that are compared before a row and behind."""
    around = np.diff(time_ns[max(row - FEW, 0) : row + FEW])
    usual = float(median(around)) if len(around) else 0.0
    count = int(min(max(NEAR_NS / usual, FEW), MANY)) if usual > 0.0 else MANY
    begin, end = max(row - count, 0), min(row + count, len(time_ns))
    if min(row - begin, end - row) < FEWEST:
        return None, None
    return begin, end


def _level(values: FloatArray, row: int, interval: float) -> Level:
    medians, variance = [], 0.0
    for part in (values[:row], values[row:]):
        middle = float(median(part))
        medians.append(middle)
        sigma = MEDIAN_OVER_MEAN * SIGMA_PER_MAD * float(median(np.abs(part - middle)))
        variance += sigma**2 / len(part)
    return Level(medians[1] - medians[0], variance**0.5, interval, medians[0])


def _again(time_ns: IntArray, row: int, level: Level) -> bool:
    """Whether times that ran back count the same time twice, or go where there was none."""
    size = abs(level.rise)
    begin, later, earlier = int(time_ns[row]), time_ns[row:], time_ns[:row]
    # Late messages end where those go on that came before them; batches come all the time
    usual = np.sort(np.diff(earlier[-MANY:]))[-FEWEST:]
    longest = max(GAP_INTERVALS * level.interval, 1.5 * float(usual[0]))
    returns = np.flatnonzero(np.diff(later) > LEAST_NS + longest)
    same = later[: returns[0] + 1] if len(returns) else later
    first, last = int(earlier.min()), int(same.max())
    if last < first:
        # Nothing twice: parts of a recording in the wrong order follow each other
        return bool(first - last > MEET_NS)
    low, high = max(begin, first), min(last, begin + round(size))
    if high - low < 2.0 * level.interval:
        return size < 2.0 * level.interval
    before, behind = (np.count_nonzero((part >= low) & (part <= high)) for part in (earlier, same))
    return bool(0 < behind <= before / TWICE)


def _repeated(log_ns: IntArray, row: int) -> bool:
    """Whether a log holds a part of a recording twice: its times are repeated to the nanosecond."""
    begin, end = row, min(row + MANY, len(log_ns))
    same = np.count_nonzero(np.isin(log_ns[begin:end], log_ns[:row]))
    return bool(same > TWICE * (end - begin))


def move(time_ns: IntArray, step: Step, row: int) -> None:
    """Undo a step at a row, on the side where the clock was wrong."""
    if step.from_there:
        time_ns[row:] -= step.size_ns
    else:
        time_ns[:row] += step.size_ns


def leaps(time_ns: IntArray) -> IntArray:
    """Rows behind intervals that are longer than usual, the longest of them, in order."""
    steps = np.diff(time_ns)
    rows = np.flatnonzero(steps > LEAST_NS)
    if len(rows):
        usual = float(median(steps))
        rows = rows[steps[rows] > max(LEAST_NS + usual, GAP_INTERVALS * usual)]
        rows = rows[np.argsort(-steps[rows], kind="stable")[:MOST_STEPS]]
    return np.sort(rows) + 1
