"""Counts of the first pass over a log: histograms and extremes of ordered samples.

All state is of bounded size (except for 112 bytes each half second) and does not depend on where
blocks end.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sinstool.core.arrays import ROUNDING
from sinstool.core.parts import kernel, part
from sinstool.core.streams import Imu
from sinstool.methods.alignment.still import WINDOW_NS, WindowStage

# Interval histogram: relative bin width 1/1000 from 100 ns to 10^6 s.
_LOW, _HIGH, _STEP = np.log(100.0), np.log(1e15), 1e-3
_BINS = int((_HIGH - _LOW) / _STEP) + 1
# Norm-of-specific-force histogram: 1 mm/s^2 bins up to 100 m/s^2.
_FORCE_BINS, _FORCE_STEP = 100_000, 1e-3
MAX_GAPS_LISTED = 1000
# Columns: see `_extremes`
_NO_EXTREMES = [0.0, 0.0, 0.0, np.nan, np.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
# Values within this many steps of the largest are just below it.
NEAR_STEPS = 8.0
# A calibration spreads the end of a gyro's range: values above CROWD, as a share of the largest,
# are at the end, and those from BELOW_CROWD to it show how many values are usual there.
CROWD, BELOW_CROWD = 0.98, 0.90
# Orientations are kept of this long, one of each window, to be compared with the other sensors; and
# for longer, up to a limit, until LEAST_TURNED of them are turned by 60 deg from the first: on one
# heading wrong ones may look right.
ORIENTED_NS, MOST_ORIENTED_NS = 20_000_000_000, 300_000_000_000
LEAST_TURNED, COS_TURNED = 20, 0.866


@dataclass
class Tally:
    """Everything the pass accumulates."""

    count: int = 0
    first_ns: int = 0
    last_ns: int = 0
    histogram: np.ndarray = field(default_factory=lambda: np.zeros(_BINS, np.int64))
    sums: np.ndarray = field(default_factory=lambda: np.zeros(_BINS, np.int64))
    shortest: int = np.iinfo(np.int64).max
    longest: int = 0
    long_start: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    long_step: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    force: np.ndarray = field(default_factory=lambda: np.zeros(_FORCE_BINS, np.int64))
    offset_low: int = np.iinfo(np.int64).max
    offset_high: int = np.iinfo(np.int64).min
    extremes: np.ndarray = field(default_factory=lambda: np.tile(_NO_EXTREMES, (6, 1)))
    crowds: np.ndarray = field(default_factory=lambda: np.zeros((2, 3, 6)))
    held: int = 0
    windows: WindowStage = field(default_factory=WindowStage)
    orientation: np.ndarray | None = None
    orientation_ns: int = 0
    orientation_varies: bool = False
    orientations: dict[int, np.ndarray] = field(default_factory=dict)
    turned: int = 0
    last_log: int = np.iinfo(np.int64).min
    log_descents: int = 0

    def wants_orientation(self) -> bool:
        """Whether more orientations are of use: see `ORIENTED_NS`; and to see if they vary."""
        if self.orientation is None or not self.orientation_varies:
            return True
        most = ORIENTED_NS if self.turned >= LEAST_TURNED else MOST_ORIENTED_NS
        return self.last_ns < self.orientation_ns + most

    def add(self, block: Imu) -> None:
        """Add a block of ordered samples."""
        times = block.time_ns
        if self.count == 0:
            self.first_ns = int(times[0])
        else:
            self._add_intervals(np.concatenate(([self.last_ns], times[:1])))
        self._add_intervals(times)
        self.count += len(times)
        self.last_ns = int(times[-1])
        offset = block.log_time_ns - times
        self.offset_low = min(self.offset_low, int(offset.min()))
        self.offset_high = max(self.offset_high, int(offset.max()))
        log_times = np.concatenate(([self.last_log], block.log_time_ns))
        self.log_descents += int(np.count_nonzero(log_times[1:] < log_times[:-1]))
        self.last_log = int(log_times[-1])
        _count_forces(block.accel, self.force)
        self.held += _extremes(block.gyro, block.accel, self.extremes, self.crowds)
        self.windows.push(times, block.gyro, block.accel)
        self._add_orientation(block)

    def _add_intervals(self, times: np.ndarray) -> None:
        if len(times) < 2:
            return
        steps = np.diff(times)
        shortest, longest = _count_intervals(steps, self.histogram, self.sums)
        self.shortest, self.longest = min(self.shortest, shortest), max(self.longest, longest)
        start, step = times[:-1], steps
        if len(self.long_step) == MAX_GAPS_LISTED:
            # of equal intervals the first stays, so only longer ones can replace one
            longer = steps > self.long_step.min()
            start, step = start[longer], step[longer]
            if not len(step):
                return
        start = np.concatenate((self.long_start, start))
        step = np.concatenate((self.long_step, step))
        if len(step) > MAX_GAPS_LISTED:
            keep = np.sort(np.argsort(-step, kind="stable")[:MAX_GAPS_LISTED])
            start, step = start[keep], step[keep]
        self.long_start, self.long_step = start, step

    def _add_orientation(self, block: Imu) -> None:
        q = block.orientation
        if q is None or not self.wants_orientation():
            return
        rows = np.flatnonzero(np.isfinite(q[:, 0]))
        if not len(rows):
            return
        if self.orientation is None:
            self.orientation = q[rows[0]].copy()
            self.orientation_ns = int(block.time_ns[rows[0]])
        self.orientation_varies |= bool((q[rows] != self.orientation).any())
        # The first of each window
        rows = rows[block.time_ns[rows] < self.orientation_ns + MOST_ORIENTED_NS]
        windows = (block.time_ns[rows] - self.first_ns) // WINDOW_NS
        for window, row in zip(*np.unique(windows, return_index=True), strict=True):
            if int(window) not in self.orientations:
                self.orientations[int(window)] = q[rows[row]].copy()
                # The cosine of half the angle, in whatever order the numbers are
                self.turned += abs(float(q[rows[row]] @ self.orientation)) < COS_TURNED

    def quantile(self, share: float) -> float:
        """Interval below which a share of all intervals lies: the mean of its histogram bin."""
        total = int(self.histogram.sum())
        if not total:
            return 0.0
        k = int(np.searchsorted(np.cumsum(self.histogram), share * total))
        k = min(k, _BINS - 1)
        return float(self.sums[k]) / max(int(self.histogram[k]), 1)

    def nominal_interval(self) -> tuple[float, float]:
        """Nominal and median interval, ns.

        Where arrival jitters over decades the median says little; the mean of the shorter 99 %
        is then the larger of the two and the one that gaps are judged by.
        """
        median = self.quantile(0.5)
        total = int(self.histogram.sum())
        if not total:
            return 0.0, 0.0
        upto = int(np.searchsorted(np.cumsum(self.histogram), 0.99 * total)) + 1
        shorter = float(self.sums[:upto].sum()) / max(int(self.histogram[:upto].sum()), 1)
        return max(median, shorter), median

    def above(self, limit: float) -> tuple[int, int]:
        """Number of intervals above a limit, and their sum, ns.

        Exact among the thousand longest; beyond those, to the histogram's bin.
        """
        if (
            not len(self.long_step)
            or self.long_step.min() <= limit
            or len(self.long_step) < MAX_GAPS_LISTED
        ):
            longer = self.long_step[self.long_step > limit]
            return len(longer), int(longer.sum())
        k = int((np.log(max(limit, 1.0)) - _LOW) / _STEP) + 1
        return int(self.histogram[k:].sum()), int(self.sums[k:].sum())

    def force_median(self) -> float:
        """Median norm of the specific force, m/s^2."""
        total = int(self.force.sum())
        if not total:
            return 0.0
        place = int(np.searchsorted(np.cumsum(self.force), 0.5 * total))
        if place == _FORCE_BINS - 1:  # all that is larger, as of wrong increments
            return float(np.median(np.linalg.norm(self.windows.finish().accel, axis=1)))
        return (place + 0.5) * _FORCE_STEP


@part()
def _crowd(value, before, of):  # type: ignore[no-untyped-def]
    """Count a value close to the largest; the columns are those of ``crowds`` in `_extremes`."""
    if value > of[0]:
        if of[0] < CROWD * value:
            of[2] = of[1] if of[0] >= BELOW_CROWD * value else 0.0
            of[1] = of[3] = of[4] = of[5] = 0.0
        of[0] = value
    if value >= CROWD * of[0] > 0.0:
        of[1] += 1.0
        if before >= CROWD * of[0]:
            of[5] += abs(value - before)
        elif before < CROWD * of[0]:  # nothing is before the first sample of a log
            of[3] += 1.0
            of[4] += value - before
    elif value >= BELOW_CROWD * of[0] > 0.0:
        of[2] += 1.0


@kernel(vectorizes=False)
def _count_intervals(steps, histogram, sums):  # type: ignore[no-untyped-def]
    """Count intervals, ns, in bins of their logarithm, and add them up; the ends of their range."""
    shortest = longest = steps[0]
    for step in steps:
        place = min(max(int((np.log(step) - _LOW) / _STEP), 0), _BINS - 1) if step > 0 else 0
        histogram[place] += 1
        sums[place] += step
        shortest, longest = min(shortest, step), max(longest, step)
    return shortest, longest


@kernel(vectorizes=False)
def _count_forces(accel, counts):  # type: ignore[no-untyped-def]
    """Count sizes of specific forces in bins of `_FORCE_STEP`; the last has all that are larger."""
    for x, y, z in accel:
        size = np.sqrt(x * x + y * y + z * z) / _FORCE_STEP
        counts[int(size) if size < _FORCE_BINS - 1 else _FORCE_BINS - 1] += 1


@kernel()
def _extremes(gyro, accel, state, crowds):  # type: ignore[no-untyped-def]
    """Largest magnitude per axis and the longest run at it; counts repeats of all six values.

    A repeated sample is no measurement and does not extend a run.

    Columns of ``state``: largest magnitude, longest run at it, present run, last value, smallest
    step from one value to another, number of values at the largest magnitude and just below it, of
    all others their number and how many differ from the one before, the largest value with its
    sign, and how many values are those of the sample before. The sign counts: integers end at
    -32768 and 32767, so one stop is just below the other.

    ``crowds``, of positive and of negative rates of each axis: the largest; how many are above
    `CROWD` of it; of those below, how many are above `BELOW_CROWD` of it; how often the first were
    reached from below; the sums of these steps, and of the steps between them.
    """
    held = 0
    for i in range(gyro.shape[0]):
        same = True
        for a in range(6):
            value = gyro[i, a] if a < 3 else accel[i, a - 3]
            if value != state[a, 3]:
                same = False
            else:
                state[a, 10] += 1.0
        if same:
            held += 1
            continue
        for a in range(6):
            value = gyro[i, a] if a < 3 else accel[i, a - 3]
            step = abs(value - state[a, 3])
            if ROUNDING * abs(value) < step < state[a, 4]:
                state[a, 4] = step
            size = abs(value)
            near = NEAR_STEPS * state[a, 4]
            if size > state[a, 0]:
                # The former largest value is now below it: just below, or one of the others
                if size > state[a, 0] + near or value * state[a, 9] < 0.0:
                    state[a, 6] = 0.0
                else:
                    state[a, 6] += state[a, 5]
                state[a, 0] = size
                state[a, 9] = value
                state[a, 1] = 1.0
                state[a, 2] = 1.0
                state[a, 5] = 1.0
            elif size == state[a, 0]:
                state[a, 2] += 1.0
                state[a, 1] = max(state[a, 1], state[a, 2])
                state[a, 5] += 1.0
            else:
                state[a, 2] = 0.0
                if size >= state[a, 0] - near:
                    if value * state[a, 9] >= 0.0:
                        state[a, 6] += 1.0
                else:
                    state[a, 7] += 1.0
                    if step > 0.0:
                        state[a, 8] += 1.0
            if a < 3:
                _crowd(value, state[a, 3], crowds[0, a])
                _crowd(-value, -state[a, 3], crowds[1, a])
            state[a, 3] = value
    return held
