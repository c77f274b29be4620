"""The motion that constraints are tested on: short means of the IMU, a smoothed track."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.timeline import LONGEST_GAP_NS
from sinstool.methods.ins_gnss.constraints import STEP_NS
from sinstool.methods.strapdown.velocity import Increments

# Rows of a track that are further apart leave a gap.
LONGEST_NS = 2_500_000_000
LONGEST_GAP = LONGEST_GAP_NS // STEP_NS
# Rows whose own sigma is larger than so many medians lie in outages.
OUTAGE = 1.5


@dataclass(frozen=True)
class Means:
    """Rate and specific force of a body, as means over consecutive steps of `STEP_NS`.

    Attributes
    ----------
    start_ns : int
        Where the first step begins.
    rate, force : ndarray, shape (g, 3)
        rad/s and m/s^2; NaN where nothing was measured.
    """

    start_ns: int
    rate: FloatArray
    force: FloatArray

    def __len__(self) -> int:
        return len(self.rate)

    @property
    def time_ns(self) -> IntArray:
        """Middle of each step."""
        return self.start_ns + STEP_NS // 2 + STEP_NS * np.arange(len(self), dtype=np.int64)


class MeansStage:
    """Takes increments, block by block, and makes means of them.

    Of parts of a log that are more than `LONGEST_GAP` steps apart, that with most steps counts.

    Parameters
    ----------
    start_ns : int
        Where the first step begins.
    """

    def __init__(self, start_ns: int) -> None:
        self._start_ns = start_ns
        self._sums: list[tuple[int, FloatArray]] = []

    def push(self, increments: Increments) -> None:
        """Take the next updates."""
        if not len(increments.interval):
            return
        middle = increments.time_ns - np.round(0.5e9 * increments.interval).astype(np.int64)
        step = (middle - self._start_ns) // STEP_NS
        columns = (
            increments.interval,
            *increments.rotation_vector.T,
            *increments.velocity_increment.T,
        )
        edges = [0, *(np.flatnonzero(np.diff(step) > LONGEST_GAP) + 1).tolist(), len(step)]
        for begin, end in pairwise(edges):
            first = int(step[begin])
            sums = [np.bincount(step[begin:end] - first, column[begin:end]) for column in columns]
            self._sums.append((first, np.stack(sums, axis=1)))

    def finish(self) -> Means:
        """The means of all steps."""
        begin, parts = self._longest()
        length = max((first + len(sums) for first, sums in parts), default=begin) - begin
        total = np.zeros((length, 7))
        for first, sums in parts:
            total[first - begin : first - begin + len(sums)] += sums
        # A step of which less than half was measured has no mean
        seconds = np.where(total[:, :1] > 0.5e-9 * STEP_NS, total[:, :1], np.nan)
        start_ns = self._start_ns + begin * STEP_NS
        return Means(start_ns, total[:, 1:4] / seconds, total[:, 4:] / seconds)

    def _longest(self) -> tuple[int, list[tuple[int, FloatArray]]]:
        """Its first step, and the sums of the longest part."""
        parts: list[tuple[int, list[tuple[int, FloatArray]]]] = [(0, [])]
        end = 0
        for first, sums in self._sums:
            if first - end > LONGEST_GAP:
                parts.append((first, []))
            parts[-1][1].append((first, sums))
            end = first + len(sums)
        return max(parts, key=lambda part: sum(len(sums) for _, sums in part[1]))


@dataclass(frozen=True)
class Track:
    """A smoothed navigation at some instants.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (m,)
    velocity_n : ndarray, shape (m, 3)
        m/s, NED.
    dcm_nb : ndarray, shape (m, 3, 3)
    covariance : ndarray, shape (m, 6, 6)
        Of velocity and attitude, by the filter's signs.
    """

    time_ns: IntArray
    velocity_n: FloatArray
    dcm_nb: FloatArray
    covariance: FloatArray

    @property
    def speed(self) -> FloatArray:
        """m/s, the vertical one included."""
        return np.asarray(np.linalg.norm(self.velocity_n, axis=1))

    @property
    def speed_sigma(self) -> FloatArray:
        """Largest standard deviation of the velocity's components, m/s."""
        variance = np.diagonal(self.covariance, axis1=1, axis2=2)[:, :3]
        return np.asarray(np.sqrt(np.maximum(variance.max(axis=1), 0.0)))

    @property
    def outside_outages(self) -> BoolArray:
        """Whether fixes are near a row, as its sigma shows, shape (m,)."""
        sigma = self.speed_sigma
        return np.asarray(sigma < OUTAGE * np.median(sigma))

    @property
    def velocity_b(self) -> FloatArray:
        """Velocity in body axes, m/s."""
        return np.einsum("mij,mi->mj", self.dcm_nb, self.velocity_n)


def between(track: Track, values: FloatArray, time_ns: IntArray, longest_ns: int) -> FloatArray:
    """Values of a track at other times, linear between its rows; NaN in its gaps.

    Parameters
    ----------
    values : ndarray, shape (m,)
    time_ns : ndarray of int64, shape (g,)
    longest_ns : int
        Longest distance of rows that are no gap.

    Returns
    -------
    ndarray, shape (g,)
    """
    out: FloatArray = np.interp(time_ns, track.time_ns, values, left=np.nan, right=np.nan)
    after = np.clip(np.searchsorted(track.time_ns, time_ns), 1, len(track.time_ns) - 1)
    out[track.time_ns[after] - track.time_ns[after - 1] > longest_ns] = np.nan
    return out


def within(mask: BoolArray, before: int, after: int) -> BoolArray:
    """Points that have a marked one among so many `before` and `after` them."""
    marked = np.concatenate([[0], np.cumsum(mask)])
    at = np.arange(len(mask))
    low = np.clip(at - before, 0, len(mask))
    high = np.clip(at + after + 1, 0, len(mask))
    return np.asarray(marked[high] > marked[low])
