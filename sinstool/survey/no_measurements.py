"""Samples of an Imu that are no measurements: of a sensor that hangs, and single wrong values.

A driver whose sensor does not answer sends the last sample again, or zeros. A bus that loses a bit
makes one value of one sample anything. Both are integrated as if the vehicle had moved so.

Noise makes it all but impossible that six values repeat to the last bit several times. So samples
that do are none, if noise is what makes neighbours differ otherwise, and if the sensor leaps when
it goes on: what a simulator without noise gives at rest goes on smoothly, and what is repeated
while nothing moves is right all the same.

A blow moves more than one of six values, so one that leaps far off its neighbours and back, alone,
is none. Nor is a rate that makes a turn of a degree and more within one sample, with nothing before
and after: a blow gives a body another rate, and does not take it back.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.parts import kernel
from sinstool.core.streams import Imu

# So many alike in a row, and so many times what is usual where a driver is faster than the sensor.
LEAST_ALIKE, MORE_THAN_USUAL = 5, 3.0
# Sixth differences show noise; its share of the steps from sample to sample is 1 for white noise,
# and next to nothing for what is smooth.
WHITE = 0.1
SIXTH = np.sqrt(924.0)
# A leap beyond what noise makes: the sum of squares over six values, in sigmas; and that of one
# value from its neighbours, in steps that nine of ten do not exceed.
LEAP_SQUARED, FAR = 60.0, 30.0
# Neighbours on either side that a single value is held against: they change by less than this share
# of it meanwhile. Of its sample the other five leap by no more than so many times what their
# neighbours do, or it is a turn by such an angle, rad.
BESIDE, SHARE, CALM, TURN = 6, 0.1, 3.0, 0.0175
# A sample each so many shows usual steps, which are counted in bins of an eighth of an octave.
EACH, PER_OCTAVE, BINS = 32, 8.0, 1024
# Of the mean specific force, m/s^2.
LEAST_FORCE = 1.0
# The median of what is normal, in sigmas.
MEDIAN = 0.6745
# More are not listed.
MOST = 20_000


@dataclass(frozen=True)
class LeftOut:
    """Times of samples that are no measurements.

    Attributes
    ----------
    first_ns, last_ns : ndarray, shape (k,)
        Spans, both ends included, in order and apart.
    hung, wrong : int
        Samples of a sensor that hangs, and with a single wrong value.
    """

    first_ns: IntArray
    last_ns: IntArray
    hung: int
    wrong: int

    def applied(self, blocks: Iterator[Imu]) -> Iterator[Imu]:
        """The other samples."""
        for block in blocks:
            span = np.searchsorted(self.first_ns, block.time_ns, side="right") - 1
            out = (span >= 0) & (block.time_ns <= self.last_ns[span])
            if not out.any():
                yield block
            elif not out.all():
                yield block.rows(~out)


@dataclass
class _Run:
    """Samples that are alike: of the second and of the last the time, and how many there are."""

    second_ns: int
    last_ns: int
    count: int
    values: FloatArray
    leap: FloatArray


class Suspects:
    """Looks at samples in the order of time, in blocks of any length, and says which are none."""

    def __init__(self) -> None:
        self._near_ns = np.zeros(0, np.int64)
        self._near = np.zeros((0, 6))
        self._runs: list[_Run] = []
        self._open: _Run | None = None
        self._lengths = np.zeros(64, np.int64)
        self._zeros: list[IntArray] = []
        # Time, axis and size
        self._leaps: list[tuple[int, int, float]] = []
        self._steps, self._sixths = (np.zeros((6, BINS), np.int64) for _ in range(2))
        self._force = 0.0
        self._count = 0

    def watch(self, blocks: Iterator[Imu]) -> Iterator[Imu]:
        """The same blocks."""
        for block in blocks:
            self._add(block.time_ns, block.gyro, block.accel)
            yield block

    def _add(self, times: IntArray, gyro: FloatArray, accel: FloatArray) -> None:
        held = len(self._near)
        near = np.empty((held + len(times), 6))
        near[:held], near[held:, :3], near[held:, 3:] = self._near, gyro, accel
        self._near, self._near_ns = near, np.concatenate([self._near_ns, times])
        values = near[held:]
        zero, same = (np.zeros(len(times), np.bool_) for _ in range(2))
        self._force += _compare(values, zero, same)
        if zero.any():
            self._zeros.append(times[zero])
        self._find_alike(times, values, same)
        self._count += len(times)
        if len(near) > 2 * BESIDE:
            self._count_steps()
            self._find_leaps()
            self._near_ns = self._near_ns[-2 * BESIDE :]
            self._near = near[-2 * BESIDE :].copy()

    def _find_alike(self, times: IntArray, values: FloatArray, same: BoolArray) -> None:
        """Rows of samples that are alike, across blocks."""
        run = self._open
        same[0] = run is not None and (values[0] == run.values).all()
        first = np.flatnonzero(~same)
        edges = np.append(first, len(times))
        if run is not None and edges[0]:  # goes on from the block before
            run.second_ns = run.second_ns if run.count > 1 else int(times[0])
            run.count, run.last_ns = run.count + int(edges[0]), int(times[edges[0] - 1])
        if not len(first):
            return
        if run is not None:
            run.leap = values[first[0]] - run.values
            self._close(run)
        counts = np.diff(edges)
        self._lengths += np.bincount(np.minimum(counts[:-1], 63), minlength=64)
        for k in np.flatnonzero(counts[:-1] >= LEAST_ALIKE).tolist():
            a, b = int(first[k]), int(edges[k + 1])
            leap = values[b] - values[a]
            self._keep(_Run(int(times[a + 1]), int(times[b - 1]), b - a, values[a].copy(), leap))
        a, count = int(first[-1]), int(counts[-1])
        second = int(times[a + 1]) if count > 1 else 0
        self._open = _Run(second, int(times[-1]), count, values[a].copy(), np.zeros(6))

    def _close(self, run: _Run) -> None:
        self._lengths[min(run.count, 63)] += 1
        if run.count >= LEAST_ALIKE:
            self._keep(run)

    def _keep(self, run: _Run) -> None:
        if len(self._runs) < MOST:
            self._runs.append(run)

    def _count_steps(self) -> None:
        """Usual steps from sample to sample, and the noise in them."""
        begin = self._count - len(self._near)
        at = np.arange(BESIDE, len(self._near) - BESIDE)
        at = at[(begin + at) % EACH == 0]
        seven = self._near[at[:, None] + np.arange(-3, 4)]
        changing = (np.diff(seven, axis=1) != 0.0).any(axis=2).all(axis=1)
        seven = seven[changing]
        for kept, size in (
            (self._steps, seven[:, 4] - seven[:, 3]),
            (self._sixths, np.diff(seven, n=6, axis=1)[:, 0] / SIXTH * np.sqrt(2.0)),
        ):
            with np.errstate(divide="ignore"):
                place = np.log2(np.abs(size)) * PER_OCTAVE + BINS / 2
            place = np.clip(place, 0, BINS - 1).astype(np.int64)
            for axis in range(6):
                kept[axis] += np.bincount(place[:, axis], minlength=BINS)

    def _find_leaps(self) -> None:
        """Single values that leap far off their neighbours and back."""
        at, axis = (np.empty(len(self._near), np.int64) for _ in range(2))
        count = _lone(self._near, at, axis)
        if not count:
            return
        at, axis = at[:count], axis[:count]
        beside = np.r_[-BESIDE:0, 1 : BESIDE + 1]
        moved = np.ptp(self._near[at[:, None] + beside], axis=1)
        off = np.abs(self._near[at] - 0.5 * (self._near[at - 1] + self._near[at + 1]))
        there, back = (
            np.abs(self._near[at, axis] - self._near[at + step, axis]) for step in (-1, 1)
        )
        leap = np.minimum(there, back)
        seconds = (self._near_ns[at + 1] - self._near_ns[at - 1]) * 0.5e-9
        turn = (axis < 3) & (leap * seconds > TURN)
        off[np.arange(count), axis] = 0.0
        single = (off <= CALM * moved).all(axis=1) | turn
        for k in np.flatnonzero(single).tolist():
            if len(self._leaps) < MOST:
                self._leaps.append((int(self._near_ns[at[k]]), int(axis[k]), float(leap[k])))

    def found(self) -> LeftOut | None:
        """What is to be left out; None where nothing is."""
        # Neither of data without gravity, nor of increments, nor of a topic of zeros that is told
        zeros = np.concatenate(self._zeros) if self._zeros else np.zeros(0, np.int64)
        if not self._force > LEAST_FORCE * self._count or 2 * len(zeros) > self._count:
            return None
        spans = [(t, t) for t in zeros[:MOST].tolist()]
        hung = len(spans)
        for run in self._hangs():
            if run.values.any():
                spans.append((run.second_ns, run.last_ns))
                hung += run.count - 1
        usual = _quantile(self._steps, 0.9)
        wrong = {t for t, axis, leap in self._leaps if leap > FAR * usual[axis] > 0.0}
        wrong -= set(zeros.tolist())
        spans += [(t, t) for t in wrong]
        if not spans:
            return None
        first, last = np.array(sorted(spans), np.int64).T
        return LeftOut(first.copy(), np.maximum.accumulate(last), hung, len(wrong))

    def _hangs(self) -> list[_Run]:
        """Runs of alike samples that are none."""
        step, noise = _quantile(self._steps, 0.5), _quantile(self._sixths, 0.5)
        shows = (noise > WHITE * step) & (noise > 0.0) & (step > 0.0)
        if not self._runs or not shows.any():
            return []
        usual = int(np.searchsorted(np.cumsum(self._lengths), 0.5 * self._lengths.sum()))
        least = max(LEAST_ALIKE, MORE_THAN_USUAL * usual)
        sigma = step[shows] / MEDIAN
        return [
            run
            for run in self._runs
            if run.count >= least and np.sum((run.leap[shows] / sigma) ** 2) > LEAP_SQUARED
        ]


@kernel()
def _compare(values, zero, same):  # type: ignore[no-untyped-def]
    """Rows that are zero, rows like the one before, and the sum of the sizes of the forces."""
    force = 0.0
    for i in range(len(values)):
        nothing, alike = True, i > 0
        for k in range(6):
            nothing = nothing and values[i, k] == 0.0
            alike = alike and values[i, k] == values[i - 1, k]
        zero[i], same[i] = nothing, alike
        force += np.sqrt(values[i, 3] ** 2 + values[i, 4] ** 2 + values[i, 5] ** 2)
    return force


@kernel()
def _lone(values, rows, columns):  # type: ignore[no-untyped-def]
    """Rows and columns of values that leap off their neighbours and back, and how many they are.

    These neighbours move by little beside it. As many are found as there is room for.
    """
    count = 0
    for i in range(BESIDE, len(values) - BESIDE):
        for k in range(6):
            there = values[i, k] - values[i - 1, k]
            back = values[i + 1, k] - values[i, k]
            if (
                there * back >= 0.0
                or SHARE * abs(there) <= abs(values[i - 1, k] - values[i - 2, k])
                or SHARE * abs(back) <= abs(values[i + 2, k] - values[i + 1, k])
            ):
                continue
            least = most = values[i + 1, k]
            for j in range(1, BESIDE + 1):
                for beside in (values[i - j, k], values[i + j, k]):
                    least, most = min(least, beside), max(most, beside)
            if most - least < SHARE * 0.5 * abs(there - back) and count < len(rows):
                rows[count], columns[count] = i, k
                count += 1
    return count


def _quantile(counted: IntArray, share: float) -> FloatArray:
    """Sizes that a share of those counted do not exceed, by axis; 0 where none was counted."""
    sums = np.cumsum(counted, axis=1)
    place = (sums < share * sums[:, -1:]).sum(axis=1)
    size = np.exp2((place + 0.5 - BINS / 2) / PER_OCTAVE)
    return np.where((place > 0) & (sums[:, -1] > 0), size, 0.0)
