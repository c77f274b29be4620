"""Ordered samples for an integration, segment by segment.

A coning stage may complete the update that ends at a sample only some samples, or a block, later.
Until then the samples are held here.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sinstool.core.streams import Imu, Solution, concatenate
from sinstool.core.timeline import SECOND, Piece, mean_rates, means_with_lost, segments
from sinstool.methods.coning.algorithm import ConingAlgorithm, of_rates
from sinstool.methods.coning.stage import ConingStage


@dataclass(frozen=True, kw_only=True)
class SampleSettings:
    """Settings for the integration of samples.

    Attributes
    ----------
    gyro_kind : {'rate', 'mean-rate', 'increment'}
        For ``increment`` the blocks hold integrals, in rad and m/s.
    nominal_ns : float
        Nominal sample interval; that of samples that follow a gap or nothing.
    max_gap_ns : int
        Longest interval that is integrated across.
    gyro_bias : ndarray, shape (3,)
        rad/s, subtracted.
    sample_rate : float or None
        Sampling rate in Hz, used in place of the stamps' intervals.
    still_until_ns : int or None
        Until then the vehicle is known to be at rest: the rate that the gyro measures is its bias,
        and the state does not change.
    uneven : bool
        Whether intervals vary by so much that a long one is no sign of a lost sample.
    """

    algorithm: ConingAlgorithm
    gyro_kind: str
    nominal_ns: float
    max_gap_ns: int
    gyro_bias: np.ndarray = field(default_factory=lambda: np.zeros(3))
    sample_rate: float | None = None
    still_until_ns: int | None = None
    uneven: bool = False

    def stage(self) -> ConingStage:
        """The coning stage of a new segment."""
        return ConingStage(
            self.algorithm, of_rates(self.gyro_kind), nominal_interval=self.nominal_ns / SECOND
        )


def unbiased_segments(blocks: Iterable[Imu], settings: SampleSettings) -> Iterator[Piece]:
    """Rates of a log, cut at gaps, with the gyro bias removed.

    Parameters
    ----------
    blocks : iterable of Imu
        Ordered, without duplicates.
    """
    s = settings
    if s.gyro_kind == "increment":
        blocks = mean_rates(blocks, s.nominal_ns, s.max_gap_ns, s.sample_rate)
    elif s.gyro_kind == "mean-rate" and s.sample_rate is None and not s.uneven:
        blocks = means_with_lost(blocks, s.nominal_ns, s.max_gap_ns)
    for piece in segments(blocks, s.max_gap_ns):
        imu = piece.imu
        unbiased = Imu(imu.time_ns, imu.log_time_ns, imu.gyro - s.gyro_bias, imu.accel)
        yield Piece(unbiased, piece.starts, piece.gap_s)


class SegmentSamples:
    """Samples of a segment whose updates are not complete yet.

    Parameters
    ----------
    start_ns : int
        Time of the segment's first sample.
    sample_rate : float, optional
        Used in place of the stamps, Hz.
    """

    def __init__(self, start_ns: int, sample_rate: float | None = None) -> None:
        self._start_ns = start_ns
        self._sample_rate = sample_rate
        self._held: Imu | None = None
        self._first = 0
        self._count = 0

    def push(self, imu: Imu) -> np.ndarray:
        """Hold the next samples.

        Returns
        -------
        ndarray of int64, shape (n,)
            Their times, ns: the stamps, or those at the given sampling rate.
        """
        self._held = concatenate([self._held, imu]) if self._held else imu
        times = imu.time_ns
        if self._sample_rate is not None:
            number = self._count + np.arange(len(imu))
            times = self._start_ns + np.rint(number * (SECOND / self._sample_rate)).astype(np.int64)
        self._count += len(imu)
        return times

    def take(self, sample: np.ndarray) -> Imu:
        """Samples at the ends of finished updates; they and all earlier ones are released.

        Parameters
        ----------
        sample : ndarray of int, shape (m,)
            Ascending, counted from the segment's first; not empty.
        """
        assert self._held is not None
        rows = sample - self._first
        done = int(rows[-1]) + 1
        if done - int(rows[0]) == len(rows):  # every sample has its update: nothing to pick out
            taken = self._held.rows(slice(done - len(rows), done))
        else:
            taken = self._held.rows(rows)
        self._held = self._held.rows(slice(done, None))
        self._first += done
        return taken


class SegmentRun(ABC):
    """An integration of ordered samples; subclasses decide how to bridge gaps.

    Attributes
    ----------
    updates : int
        Solutions given out; the first sample of a segment is one.
    """

    _stage: Any  # of the running segment, which the kind of run sets when it begins

    def __init__(self, settings: SampleSettings) -> None:
        self.updates = 0
        self.settings = settings
        self._waiting: SegmentSamples | None = None

    def run(self, blocks: Iterable[Imu]) -> Iterator[Solution]:
        """Integrate.

        Parameters
        ----------
        blocks : iterable of Imu
            Ordered, without duplicates.

        Yields
        ------
        Solution
            Not empty; together in order of time.
        """
        for piece in unbiased_segments(blocks, self.settings):
            imu = piece.imu
            if piece.starts:
                yield from self._finish()
                self._waiting = SegmentSamples(int(imu.time_ns[0]), self.settings.sample_rate)
                self.updates += 1
                yield self._begin(imu, piece.gap_s)
            assert self._waiting is not None
            yield from self._answer(self._push(imu, self._waiting.push(imu)))
        yield from self._finish()

    @abstractmethod
    def _begin(self, imu: Imu, gap_s: float) -> Solution:
        """Start a segment: the solution at its first sample, after whatever gap."""

    @abstractmethod
    def _push(self, imu: Imu, times: np.ndarray) -> Any:
        """Updates that are finished with these samples."""

    @abstractmethod
    def _advance(self, updates: Any, taken: Imu) -> Solution:
        """Solutions at finished updates."""

    def _answer(self, updates: Any) -> Iterator[Solution]:
        """Integrate over finished updates and release their samples."""
        if len(updates.sample):
            assert self._waiting is not None
            self.updates += len(updates.sample)
            yield self._advance(updates, self._waiting.take(updates.sample))

    def _finish(self) -> Iterator[Solution]:
        if self._waiting is not None:
            yield from self._answer(self._stage.finish())
            self._waiting = None
