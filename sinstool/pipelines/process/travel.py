"""Duration, distance, speed and accuracy of a run, collected from streamed solutions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.earth import horizontal_metres
from sinstool.core.order_statistics import median
from sinstool.core.rotation import wrapped
from sinstool.core.streams import Solution
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE

if TYPE_CHECKING:
    from sinstool.methods.ins_gnss.results import GnssDiagnostics

# Most values kept for medians; of a longer run every second one is kept, and so on.
MOST_SIGMAS = 8192
# An outage: the next fix that is used comes later than this many usual intervals, and this many
# seconds.
MISSED, LEAST_OUTAGE_S = 3.0, 2.0


@dataclass(frozen=True)
class Spread:
    """A standard deviation over a run.

    Attributes
    ----------
    median, largest : float
        In the unit of its key.
    """

    median: float
    largest: float


@dataclass(frozen=True)
class Accuracy:
    """One standard deviation, by the run's own covariances.

    Attributes
    ----------
    tilt_deg : Spread
        About the worse of north and east.
    heading_deg : Spread
        About down.
    horizontal_m, height_m : Spread or None
        The worse of north and east, and down; None if a run has no position.
    """

    tilt_deg: Spread
    heading_deg: Spread
    horizontal_m: Spread | None
    height_m: Spread | None


@dataclass(frozen=True)
class Travel:
    """Duration, distance and accuracy of a run.

    Attributes
    ----------
    duration_s : float
        From the first solution to the last.
    distance_m, mean_speed_m_s, largest_speed_m_s : float or None
        Over ground; the distance is that between places one second apart, so that noise at rest
        does not add up. None where a run has no position.
    accuracy : Accuracy or None
        None where a run has no covariances.
    """

    duration_s: float
    distance_m: float | None
    mean_speed_m_s: float | None
    largest_speed_m_s: float | None
    accuracy: Accuracy | None


@dataclass(frozen=True)
class Outages:
    """Times without a fix that the filter used.

    Attributes
    ----------
    count : int
        Number of outages.
    total_s, longest_s : float
        0 without any.
    """

    count: int
    total_s: float
    longest_s: float


def find_outages(epochs: Sequence[GnssDiagnostics]) -> Outages:
    """Times without fixes, between the first that was used and the last.

    Parameters
    ----------
    epochs : sequence of GnssDiagnostics
        In the order of time.
    """
    used = [part.time_ns[part.used] for part in epochs]
    steps = np.diff(np.concatenate([np.empty(0, np.int64), *used])) / SECOND
    if not len(steps):
        return Outages(0, 0.0, 0.0)
    long = steps[steps > max(MISSED * float(median(steps)), LEAST_OUTAGE_S)]
    return Outages(len(long), float(long.sum()), float(long.max(initial=0.0)))


@dataclass
class Odometer:
    """Collects a :class:`Travel`; its memory does not grow with the log."""

    _first_ns: int | None = None
    _last_ns: int = 0
    _distance: float = 0.0
    _fastest: float | None = None
    _place: FloatArray | None = None
    _second: int = -1
    _stride: int = 1
    _sigmas: list[FloatArray] = field(default_factory=list)

    def push(self, solution: Solution) -> None:
        """Take the next solutions, in the order of time."""
        if not len(solution):
            return
        if self._first_ns is None:
            self._first_ns = int(solution.time_ns[0])
        self._last_ns = int(solution.time_ns[-1])
        # The first of each second
        second = (solution.time_ns - self._first_ns) // SECOND
        rows = np.flatnonzero(np.diff(second, prepend=self._second) > 0)
        self._second = int(second[-1])
        if solution.velocity_n is not None and solution.position is not None:
            fastest = float(np.hypot(*solution.velocity_n[:, :2].T).max())
            self._fastest = fastest if self._fastest is None else max(self._fastest, fastest)
            self._move(solution.position[rows])
        if solution.covariance_attitude_n is not None:
            self._keep(solution, rows[second[rows] % self._stride == 0])

    def _move(self, places: FloatArray) -> None:
        """Add the way through places, each a second or more after the one before."""
        if self._place is not None:
            places = np.concatenate([self._place[None], places])
        if len(places):
            self._place = places[-1]
        step = np.diff(places, axis=0)
        north, east = horizontal_metres(
            step[:, 0], wrapped(step[:, 1]), places[:-1, 0], places[:-1, 2]
        )
        self._distance += float(np.hypot(north, east).sum())

    def _keep(self, solution: Solution, rows: IntArray) -> None:
        attitude = solution.covariance_attitude_n
        assert attitude is not None
        variances = [np.einsum("nii->ni", attitude[rows]) / DEGREE**2]
        if solution.covariance_position_n is not None:
            variances.append(np.einsum("nii->ni", solution.covariance_position_n[rows]))
        self._sigmas += list(np.sqrt(np.concatenate(variances, axis=1)))
        while len(self._sigmas) > MOST_SIGMAS:
            self._sigmas = self._sigmas[::2]
            self._stride *= 2

    def travel(self) -> Travel:
        """The distance, accuracy and outages collected so far."""
        duration = 0.0 if self._first_ns is None else (self._last_ns - self._first_ns) / SECOND
        moved = self._fastest is not None
        return Travel(
            duration_s=duration,
            distance_m=self._distance if moved else None,
            mean_speed_m_s=self._distance / duration if moved and duration > 0.0 else None,
            largest_speed_m_s=self._fastest,
            accuracy=self._accuracy(),
        )

    def _accuracy(self) -> Accuracy | None:
        if not self._sigmas:
            return None
        sigmas = np.array(self._sigmas)
        sigmas = sigmas[np.isfinite(sigmas).all(axis=1)]
        if not len(sigmas):
            return None
        placed = sigmas.shape[1] > 3
        return Accuracy(
            tilt_deg=_spread(sigmas[:, :2].max(axis=1)),
            heading_deg=_spread(sigmas[:, 2]),
            horizontal_m=_spread(sigmas[:, 3:5].max(axis=1)) if placed else None,
            height_m=_spread(sigmas[:, 5]) if placed else None,
        )


def _spread(values: FloatArray) -> Spread:
    return Spread(float(median(values)), float(values.max()))
