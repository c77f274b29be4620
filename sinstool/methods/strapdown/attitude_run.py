"""Ordered Imu blocks in, attitude out: segments, rotation vectors and propagation joined.

This is the streaming heart of `process --mode attitude`: what it carries from block to block is
the coning stage of the running segment, the attitude, and the samples not yet answered for.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from sinstool.core.streams import Imu, Solution
from sinstool.methods.coning.stage import ConingStage, RotationVectors
from sinstool.methods.strapdown.attitude import AttitudePropagator
from sinstool.methods.strapdown.segment_samples import (
    SampleSettings,
    SegmentSamples,
    unbiased_segments,
)


@dataclass(frozen=True, kw_only=True)
class AttitudeSettings(SampleSettings):
    """What an attitude run needs to know.

    Attributes
    ----------
    omega_ie_n : ndarray, shape (3,) or None
        Earth rate to remove, rad/s in NED.
    """

    omega_ie_n: np.ndarray | None = None


class AttitudeRun:
    """Attitude from ordered samples.

    Parameters
    ----------
    q_nb : ndarray, shape (4,)
        Attitude at the first sample.

    Attributes
    ----------
    samples, updates : int
        Taken in and given out (the first sample of a segment is given out too).
    missed_rotation : float
        What the vehicle turned during gaps if it went on as it did on either side, rad.
    """

    def __init__(self, q_nb: np.ndarray, settings: AttitudeSettings) -> None:
        self.settings = settings
        self.samples = 0
        self.updates = 0
        self.missed_rotation = 0.0
        self._propagator = AttitudePropagator(q_nb, settings.omega_ie_n)
        self._stage: ConingStage | None = None
        self._waiting: SegmentSamples | None = None
        self._last_rate = np.zeros(3)

    def run(self, blocks: Iterable[Imu]) -> Iterator[Solution]:
        """Attitude at every update instant.

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
            self.samples += len(imu)
            if piece.starts:
                yield from self._finish()
                yield self._begin(imu, piece.gap_s)
            assert self._stage is not None and self._waiting is not None
            yield from self._answer(self._stage.push(imu.gyro, self._waiting.push(imu)))
            self._last_rate = imu.gyro[-1]
        yield from self._finish()

    def _begin(self, imu: Imu, gap_s: float) -> Solution:
        """Start a segment; its first sample has the attitude the last segment ended with."""
        if gap_s > 0.0:
            mean = 0.5 * (self._last_rate + imu.gyro[0])
            self.missed_rotation += float(np.linalg.norm(mean)) * gap_s
        self._stage = self.settings.stage()
        self._waiting = SegmentSamples(int(imu.time_ns[0]), self.settings.sample_rate)
        self.updates += 1
        return _solution(imu.rows(slice(0, 1)), self._propagator.q_nb[None, :])

    def _answer(self, vectors: RotationVectors) -> Iterator[Solution]:
        """Propagate over finished updates and let go of the samples they answer for."""
        if not len(vectors.sample):
            return
        assert self._waiting is not None
        q = np.empty((len(vectors.sample), 4))
        until = self.settings.still_until_ns
        still = 0 if until is None else int(np.searchsorted(vectors.time_ns, until, "right"))
        q[:still] = self._propagator.q_nb
        q[still:] = self._propagator.push(vectors.rotation_vector[still:], vectors.interval[still:])
        self.updates += len(q)
        yield _solution(self._waiting.take(vectors.sample), q)

    def _finish(self) -> Iterator[Solution]:
        if self._stage is not None:
            yield from self._answer(self._stage.finish())
            self._stage = None

    @property
    def q_nb(self) -> np.ndarray:
        """Attitude after the last update."""
        return self._propagator.q_nb


def _solution(imu: Imu, q_nb: np.ndarray) -> Solution:
    return Solution(imu.time_ns, imu.log_time_ns, q_nb, imu.gyro, imu.accel)
