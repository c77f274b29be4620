"""Single axes of an IMU that repeat one value for a while, as the others measure on.

A bus or a chip may lose one axis: its value stays what it was, while the other two of its sensor
show what the vehicle does. Integrated, it is a rotation, or an acceleration, that never was.

An axis may repeat its value by right as well. One that is rounded coarsely does so at rest, and so
does one at the end of its range. So an axis counts as stuck only where its noise must exceed the
step to which it is rounded: its usual noise, times the share of their usual motion that the other
two axes show meanwhile. What shakes a sensor, or noise of its own, leaves no axis alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.parts import kernel

AXES = tuple(f"{sensor} {axis}" for sensor in ("gyro", "accelerometer") for axis in "xyz")
# So many alike in a row: of a noise of half the step of rounding, one sample repeats the one before
# in 6 of 10 cases, and so many never do. An axis may be quieter than the others beside what is
# usual, so more noise than that has to be expected, in steps.
LEAST_ALIKE, IN_STEPS = 50, 2.0
# More are not listed, and fewer are named.
MOST, NAMED = 5_000, 3


@dataclass(frozen=True)
class StuckAxis:
    """An axis that repeats one value: times of the second and of the last sample, and how many."""

    axis: int
    second_ns: int
    last_ns: int
    count: int

    def __str__(self) -> str:
        return f"{AXES[self.axis]} for {(self.last_ns - self.second_ns) * 1e-9:.2g} s"


def longest(stuck: Sequence[StuckAxis]) -> str:
    """The longest of them, in words."""
    named = sorted(stuck, key=lambda one: one.second_ns - one.last_ns)
    more = f", and {len(stuck) - NAMED} more" if len(stuck) > NAMED else ""
    return ", ".join(str(one) for one in named[:NAMED]) + more


class AxisRuns:
    """Looks for values that repeat along single axes, in blocks of samples of any length."""

    def __init__(self) -> None:
        # By axis: how many of the last are alike, and the time of the second of them
        self._open = np.zeros((6, 2), np.int64)
        # Way from sample to sample of all axes since the log began, and when a run began
        self._way, self._began = np.zeros(6), np.zeros((6, 6))
        self._most, self._last, self._last_ns = np.zeros(6), np.zeros(6), 0
        self._runs: list[tuple[IntArray, FloatArray]] = []
        self._listed = 0

    def add(self, times: IntArray, values: FloatArray) -> None:
        """Add samples, shape (n, 6), in order."""
        runs, moved = np.empty((len(times), 4), np.int64), np.empty((len(times), 7))
        state = self._open, self._way, self._began, self._most, self._last
        count = _runs_of_axes(times, values, self._last_ns, *state, runs, moved)
        self._last_ns = int(times[-1]) if len(times) else self._last_ns
        count = min(count, MOST - self._listed)
        if count > 0:
            self._listed += count
            self._runs.append((runs[:count].copy(), moved[:count].copy()))

    def constant(self, count: int) -> list[int]:
        """Axes that have one value in all samples, of which there were so many."""
        return np.flatnonzero(self._open[:, 0] == count).tolist()

    def _all(self) -> Iterator[tuple[int, int, int, int, float, FloatArray]]:
        """Axis, second and last time, count, value and ways of the others: also of open runs."""
        for runs, moved in self._runs:
            for (axis, second, last, count), row in zip(runs.tolist(), moved, strict=True):
                yield axis, second, last, count, float(row[6]), row[:6]
        for axis, (count, second) in enumerate(self._open.tolist()):
            if count >= LEAST_ALIKE:
                value, way = float(self._last[axis]), self._way - self._began[axis]
                yield axis, second, self._last_ns, count, value, way

    def stuck(self, step: FloatArray, noise: FloatArray, rounded: FloatArray) -> list[StuckAxis]:
        """Runs of axes that do not measure.

        Parameters
        ----------
        step, noise : ndarray, shape (6,)
            Usual way from one sample to the next, and that of it which is white noise.
        rounded : ndarray, shape (6,)
            Smallest step that is not 0.
        """
        found = []
        for axis, second, last, count, value, way in self._all():
            own = 3 * (axis // 3)
            others = [k for k in range(own, own + 3) if k != axis]
            usual = step[others] * count
            if step[axis] == 0.0 or not usual.all() or abs(value) >= self._most[axis]:
                continue
            share = min(1.0, float(np.min(way[others] / usual)))
            if share * noise[axis] >= IN_STEPS * rounded[axis]:
                found.append(StuckAxis(axis, second, last, count))
        return found


@kernel(vectorizes=False)
def _runs_of_axes(times, values, before_ns, run, way, began, most, last, runs, moved):  # type: ignore[no-untyped-def]
    """Find runs of alike values along each axis; returns how many long ones end here.

    Of each go axis, times of the second and of the last sample and the count to `runs`; the ways of
    all axes meanwhile and the value to `moved`. There is room for one run a sample.
    """
    found = 0
    for i in range(len(times)):
        for k in range(6):
            way[k] += abs(values[i, k] - last[k]) if run[k, 0] > 0 else 0.0
        for k in range(6):
            value = values[i, k]
            most[k] = max(most[k], abs(value))
            if run[k, 0] > 0 and value == last[k]:
                if run[k, 0] == 1:
                    run[k, 1] = times[i]
                run[k, 0] += 1
                continue
            if run[k, 0] >= LEAST_ALIKE and found < len(runs):
                runs[found, 0] = k
                runs[found, 1] = run[k, 1]
                runs[found, 2] = times[i - 1] if i > 0 else before_ns
                runs[found, 3] = run[k, 0]
                for j in range(6):
                    moved[found, j] = way[j] - began[k, j]
                moved[found, 6] = last[k]
                found += 1
            run[k, 0] = 1
            for j in range(6):
                began[k, j] = way[j]
        for k in range(6):
            last[k] = values[i, k]
    return found
