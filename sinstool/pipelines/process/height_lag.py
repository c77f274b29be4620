"""Whether the barometer of a run lags behind its accelerometer."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray
from sinstool.core.streams import Solution
from sinstool.core.timeline import LONGEST_GAP_NS, SECOND
from sinstool.core.units import STANDARD_GRAVITY
from sinstool.methods.height.lag import GRID_NS, height_lag
from sinstool.methods.height.layout import ACCEPTED
from sinstool.methods.height.reference import HeightReference
from sinstool.methods.height.vertical import upward_specific_force

# No sample shows the climb over a longer interval, ns.
_LONGEST_NS = SECOND // 5
# Least error that is worth a warning, m.
_LEAST_M = 2.0
# A lag that was given is right to this share of it.
_RIGHT = 0.4


class HeightLag:
    """Collects how fast a run climbs by its accelerometer, for comparison with its barometer.

    Parameters
    ----------
    reference : HeightReference or None
        Of the run.
    stated_s : float
        Lag by the options, s.
    """

    def __init__(self, reference: HeightReference | None, stated_s: float) -> None:
        barometer = reference is not None and reference.kind == "baro"
        self._reference = reference if barometer else None
        self._stated_s = stated_s
        self._last: tuple[int, float, float] | None = None  # time, upward force, its integral
        self._first_ns = 0
        self._climb: list[FloatArray] = []
        self._known: list[BoolArray] = []

    def watch(self, solutions: Iterator[Solution]) -> Iterator[Solution]:
        """The same solutions, taken one after the other."""
        for solution in solutions:
            self.push(solution)
            yield solution

    def push(self, solution: Solution, f_up: FloatArray | None = None) -> None:
        """Take the next solutions; their upward specific force, if it is known already."""
        if self._reference is None or not len(solution):
            return
        if f_up is None:
            f_up = upward_specific_force(solution.q_nb, solution.specific_force_b)
        times = solution.time_ns
        before = int(times[0]) if self._last is None else self._last[0]
        gaps = np.flatnonzero(np.diff(times, prepend=before) > LONGEST_GAP_NS)
        if len(gaps):  # begin anew
            times, f_up = times[gaps[-1] :], f_up[gaps[-1] :]
            self._last, self._climb, self._known = None, [], []
        if self._last is not None and times[0] <= self._last[0]:
            return  # a filter that begins anew has solutions before that
        if self._last is None:
            self._last = int(times[0]), float(f_up[0]), 0.0
            self._first_ns = (int(times[0]) // GRID_NS + 1) * GRID_NS
        last_ns, force, climb = self._last
        times, f_up = np.append(last_ns, times), np.append(force, f_up)
        # What is left of gravity is a drift
        mean = 0.5 * (f_up[1:] + f_up[:-1]) - STANDARD_GRAVITY
        climbed = climb + np.append(0.0, np.cumsum(mean * (np.diff(times) / SECOND)))
        begin = last_ns // GRID_NS + 1 if self._climb else self._first_ns // GRID_NS
        grid = np.arange(begin, times[-1] // GRID_NS + 1) * GRID_NS
        after = np.clip(np.searchsorted(times, grid), 1, len(times) - 1)
        self._known.append(times[after] - times[after - 1] <= _LONGEST_NS)
        seconds = (times - times[0]) / SECOND
        self._climb.append(np.interp((grid - times[0]) / SECOND, seconds, climbed))
        self._last = int(times[-1]), float(f_up[-1]), float(climbed[-1])

    def warnings(self) -> list[str]:
        """That the barometer lags, and by how much, if it clearly does."""
        r = self._reference
        if r is None or not self._climb:
            return []
        good = (r.reason == ACCEPTED) & np.isfinite(r.height)
        times, first = np.unique(r.time_ns[good], return_index=True)
        lag = height_lag(
            self._first_ns,
            np.concatenate(self._climb),
            np.concatenate(self._known),
            times,
            r.height[good][first],
        )
        if lag is None or abs(lag.seconds - self._stated_s) <= _RIGHT * lag.seconds:
            return []
        if lag.metres < _LEAST_M:
            return []
        return [
            f"the barometer lags {lag.seconds:.1f} s behind the accelerometer, which puts its"
            f" heights up to {lag.metres:.0f} m off where the vehicle climbs or descends fastest:"
            f" give --baro-lag {lag.seconds:.1f}, or correct the stamps of {r.topic}"
        ]
