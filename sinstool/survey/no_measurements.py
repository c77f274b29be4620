"""Samples of an IMU that are no measurements: of a sensor that hangs, and single wrong values.

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

from sinstool.core.arrays import ROUNDING, BoolArray, FloatArray, IntArray
from sinstool.core.order_statistics import SIGMA_PER_MAD
from sinstool.core.parts import kernel, part
from sinstool.core.streams import Imu
from sinstool.survey.stuck_axes import AXES, AxisRuns, StuckAxis

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
# An axis is dead if it has one value in a log of so many samples.
LEAST_DEAD = 500
# A sample each so many shows usual steps, which are counted in bins of an eighth of an octave.
EACH, PER_OCTAVE, BINS = 32, 8.0, 1024
# Of the mean specific force, m/s^2.
LEAST_FORCE = 1.0
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
    stuck : tuple of StuckAxis
        Single axes that repeat a value while the others measure.
    """

    first_ns: IntArray
    last_ns: IntArray
    hung: int
    wrong: int
    stuck: tuple[StuckAxis, ...] = ()

    def applied(self, blocks: Iterator[Imu]) -> Iterator[Imu]:
        """The other samples."""
        for block in blocks:
            span = np.searchsorted(self.first_ns, block.time_ns, side="right") - 1
            out = (span >= 0) & (block.time_ns <= self.last_ns[span])
            if not out.any():
                yield block
            elif not out.all():
                yield block.rows(~out)


@dataclass(frozen=True)
class _Run:
    """Samples that are alike: times of the second and of the last, how many, and the leap after."""

    second_ns: int
    last_ns: int
    count: int
    values: FloatArray
    leap: FloatArray


class Suspects:
    """Looks at samples in the order of time, in blocks of any length, and says which are none."""

    def __init__(self) -> None:
        # The last samples of the block before, and room for those of the next
        self._near_ns = np.zeros(2 * BESIDE, np.int64)
        self._near = np.zeros((2 * BESIDE, 6))
        self._held = 0
        self._runs: list[_Run] = []
        # Of the last samples that are alike how many there are, and the time of the second
        self._open = np.zeros(2, np.int64)
        self._lengths = np.zeros(64, np.int64)
        self._zeros: list[IntArray] = []
        self._axes = AxisRuns()
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
        held, rows = self._held, self._held + len(times)
        if rows > len(self._near):
            kept_ns, kept = self._near_ns[:held], self._near[:held]
            self._near_ns, self._near = np.empty(rows, np.int64), np.empty((rows, 6))
            self._near_ns[:held], self._near[:held] = kept_ns, kept
        near_ns, near = self._near_ns[:rows], self._near[:rows]
        near_ns[held:] = times
        self._take_in(near_ns, near, np.ascontiguousarray(gyro), np.ascontiguousarray(accel))
        self._count += len(times)
        self._axes.add(near_ns[held:], near[held:])
        if rows > 2 * BESIDE:
            _count_steps(near, (self._count - rows) % EACH, self._steps, self._sixths)
            self._find_leaps(near_ns, near)
        self._held = min(rows, 2 * BESIDE)
        near_ns[: self._held] = near_ns[rows - self._held :].copy()
        near[: self._held] = near[rows - self._held :].copy()

    def _take_in(
        self, near_ns: IntArray, near: FloatArray, gyro: FloatArray, accel: FloatArray
    ) -> None:
        """Put samples beside those before: which are zero, and rows of those that are alike."""
        zeros, runs = np.empty(len(gyro), np.int64), np.empty((len(gyro), 3), np.int64)
        force, zero_count, run_count = _take_in(
            near_ns, near, gyro, accel, self._open, self._lengths, zeros, runs
        )
        self._force += force
        if zero_count:
            self._zeros.append(zeros[:zero_count])
        for second_ns, count, after in runs[: min(run_count, MOST - len(self._runs))].tolist():
            values = near[after - 1].copy()
            self._runs.append(
                _Run(second_ns, int(near_ns[after - 1]), count, values, near[after] - values)
            )

    def _find_leaps(self, near_ns: IntArray, near: FloatArray) -> None:
        """Single values that leap far off their neighbours and back."""
        at, axis = (np.empty(len(near), np.int64) for _ in range(2))
        count = _isolated(near, at, axis)
        if not count:
            return
        at, axis = at[:count], axis[:count]
        beside = np.r_[-BESIDE:0, 1 : BESIDE + 1]
        moved = np.ptp(near[at[:, None] + beside], axis=1)
        off = np.abs(near[at] - 0.5 * (near[at - 1] + near[at + 1]))
        there, back = (np.abs(near[at, axis] - near[at + step, axis]) for step in (-1, 1))
        leap = np.minimum(there, back)
        seconds = (near_ns[at + 1] - near_ns[at - 1]) * 0.5e-9
        turn = (axis < 3) & (leap * seconds > TURN)
        off[np.arange(count), axis] = 0.0
        single = (off <= CALM * moved).all(axis=1) | turn
        for k in np.flatnonzero(single).tolist():
            if len(self._leaps) < MOST:
                self._leaps.append((int(near_ns[at[k]]), int(axis[k]), float(leap[k])))

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
        step, noise = _quantile(self._steps, 0.5), _quantile(self._sixths, 0.5)
        stuck = tuple(self._axes.stuck(step, noise, _smallest(self._steps)))
        spans += [(one.second_ns, one.last_ns) for one in stuck]
        if not spans:
            return None
        first, last = np.array(sorted(spans), np.int64).T
        return LeftOut(first.copy(), np.maximum.accumulate(last), hung, len(wrong), stuck)

    def dead(self) -> tuple[str, ...]:
        """Axes of a sensor that never change although all others show noise.

        A simulation may have no noise, and an IMU no gyros.
        """
        if self._count < LEAST_DEAD:
            return ()
        step, noise = _quantile(self._steps, 0.5), _quantile(self._sixths, 0.5)
        shows: BoolArray = (noise > WHITE * step) & (noise > 0.0) & (step > 0.0)
        constant = self._axes.constant(self._count)
        if not np.delete(shows, constant).all():
            return ()
        sensors = np.asarray(shows.reshape(2, 3).any(axis=1))
        return tuple(AXES[k] for k in constant if sensors[k // 3])

    def _hangs(self) -> list[_Run]:
        """Runs of alike samples that are none."""
        step, noise = _quantile(self._steps, 0.5), _quantile(self._sixths, 0.5)
        shows = (noise > WHITE * step) & (noise > 0.0) & (step > 0.0)
        if not self._runs or not shows.any():
            return []
        usual = int(np.searchsorted(np.cumsum(self._lengths), 0.5 * self._lengths.sum()))
        least = max(LEAST_ALIKE, MORE_THAN_USUAL * usual)
        sigma = SIGMA_PER_MAD * step[shows]
        return [
            run
            for run in self._runs
            if run.count >= least and np.sum((run.leap[shows] / sigma) ** 2) > LEAP_SQUARED
        ]


@kernel(vectorizes=False)
def _take_in(near_ns, near, gyro, accel, run, lengths, zeros, runs):  # type: ignore[no-untyped-def]
    """Put samples at the end of those near, and look for zeros and for samples that are alike.

    `run` holds how many of the last are alike, and the time of the second of them. Where a run
    ends its length is counted; of a long one that time, the length and the row after go to `runs`.
    Returns the sum of the sizes of the forces, and how many zeros and long runs there are.
    """
    held = len(near) - len(gyro)
    force, zero_count, run_count = 0.0, 0, 0
    for i in range(len(gyro)):
        row = held + i
        nothing, alike = True, row > 0
        for k in range(6):
            value = gyro[i, k] if k < 3 else accel[i, k - 3]
            near[row, k] = value
            nothing = nothing and value == 0.0
            alike = alike and value == near[row - 1, k]
        force += np.sqrt(near[row, 3] ** 2 + near[row, 4] ** 2 + near[row, 5] ** 2)
        if nothing:
            zeros[zero_count] = near_ns[row]
            zero_count += 1
        if alike:
            if run[0] == 1:
                run[1] = near_ns[row]
            run[0] += 1
            continue
        if run[0] > 0:
            lengths[min(run[0], len(lengths) - 1)] += 1
        if run[0] >= LEAST_ALIKE:
            runs[run_count] = run[1], run[0], row
            run_count += 1
        run[0] = 1
    return force, zero_count, run_count


@kernel(vectorizes=False)
def _count_steps(near, before, steps, sixths):  # type: ignore[no-untyped-def]
    """Count usual steps from sample to sample, and the noise in them, where samples change.

    `before` is how many samples, of as many as one is taken from, came before the first.
    """
    for row in range(BESIDE, len(near) - BESIDE):
        if (before + row) % EACH:
            continue
        changes = True
        for j in range(row - 3, row + 3):
            alike = True
            for k in range(6):
                alike = alike and near[j, k] == near[j + 1, k]
            changes = changes and not alike
        if not changes:
            continue
        for k in range(6):
            rounding = ROUNDING * abs(near[row, k])
            sixth = -20.0 * near[row, k]
            for j, weight in ((1, 15.0), (2, -6.0), (3, 1.0)):
                sixth += weight * (near[row - j, k] + near[row + j, k])
            steps[k, _bin(near[row + 1, k] - near[row, k], rounding)] += 1
            sixths[k, _bin(sixth * np.sqrt(2.0) / SIXTH, rounding)] += 1


@part()
def _bin(size, rounding):  # type: ignore[no-untyped-def]
    """Bin of a size, of an eighth of an octave; the first for one that is nothing but rounding."""
    if abs(size) <= rounding:
        return 0
    return int(min(max(np.log2(abs(size)) * PER_OCTAVE + BINS / 2, 0.0), BINS - 1.0))


@kernel()
def _isolated(values, rows, columns):  # type: ignore[no-untyped-def]
    """Rows and columns of values that leap off their neighbours and back, and how many they are.

    These neighbours move by little beside it. As many are found as there is room for.
    """
    count = 0
    for k in range(6):
        before = abs(values[BESIDE - 1, k] - values[BESIDE - 2, k])
        there = values[BESIDE, k] - values[BESIDE - 1, k]
        for i in range(BESIDE, len(values) - BESIDE):
            back = values[i + 1, k] - values[i, k]
            # The rarest first, as a processor guesses which way it goes
            if SHARE * abs(there) > before and there * back < 0.0:
                least = most = values[i + 1, k]
                for j in range(1, BESIDE + 1):
                    for beside in (values[i - j, k], values[i + j, k]):
                        least, most = min(least, beside), max(most, beside)
                after = abs(values[i + 2, k] - values[i + 1, k])
                small = most - least < SHARE * 0.5 * abs(there - back)
                if small and SHARE * abs(back) > after and count < len(rows):
                    rows[count], columns[count] = i, k
                    count += 1
            before, there = abs(there), back
    return count


def _quantile(counted: IntArray, share: float) -> FloatArray:
    """Sizes that a share of those counted do not exceed, by axis; 0 where none was counted."""
    sums = np.cumsum(counted, axis=1)
    place = (sums < share * sums[:, -1:]).sum(axis=1)
    return np.where((place > 0) & (sums[:, -1] > 0), _size(place), 0.0)


def _smallest(counted: IntArray) -> FloatArray:
    """Smallest size that is not 0, by axis; of those counted."""
    return _size(1 + (counted[:, 1:] > 0).argmax(axis=1))


def _size(place: IntArray) -> FloatArray:
    """Size in the middle of a bin."""
    return np.exp2((place + 0.5 - BINS / 2) / PER_OCTAVE)
