"""Increments from the samples of a log, segment by segment, for filters."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sinstool.config import ProcessConfig
from sinstool.core.streams import Imu
from sinstool.core.timeline import segments
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.strapdown.segment_samples import SampleSettings, SegmentSamples
from sinstool.methods.strapdown.velocity import Increments, IncrementStage
from sinstool.survey.source import Source, nominal_interval, rate_blocks


class SegmentIncrements:
    """Increments of a log's segments, with their samples."""

    def __init__(self, source: Source, config: ProcessConfig, algorithm: ConingAlgorithm) -> None:
        self._source = source
        self._config = config
        self._settings = SampleSettings(
            algorithm=algorithm,
            gyro_kind=config.input.sample_kind,
            nominal_ns=nominal_interval(source, config),
            max_gap_ns=source.survey.max_gap_ns,
        )
        self.samples = 0

    def from_time(
        self, start_ns: int, end_ns: int | None = None, progress: Any = None
    ) -> Iterator[tuple[Increments, Imu, Imu | None]]:
        """Increments from a sample on.

        Parameters
        ----------
        start_ns : int
            Time of the sample at which the first update begins.
        progress : callable, optional
            Called with the bytes read.

        Yields
        ------
        Increments, Imu, Imu or None
            Updates, the samples at their ends, and, where they are the first of a segment, the
            sample at which it begins.
        """
        config, source = self._config, self._source
        blocks = rate_blocks(source, config, start_ns, progress)
        stage: IncrementStage | None = None
        waiting: SegmentSamples | None = None
        opening: Imu | None = None
        for piece in segments(blocks, source.survey.max_gap_ns):
            if end_ns is not None and int(piece.imu.time_ns[0]) > end_ns:
                break
            if piece.starts:
                if stage is not None and waiting is not None:
                    yield from _answer(stage.finish(), waiting, opening)
                stage = IncrementStage(self._settings.stage)
                waiting = SegmentSamples(int(piece.imu.time_ns[0]))
                opening = piece.imu.rows(slice(0, 1))
            assert stage is not None and waiting is not None
            imu = piece.imu
            self.samples += len(imu)
            made = stage.push(imu.gyro, imu.accel, waiting.push(imu))
            yield from _answer(made, waiting, opening)
            if len(made.sample):
                opening = None
        if stage is not None and waiting is not None:
            yield from _answer(stage.finish(), waiting, opening)


def _answer(
    made: Increments, waiting: SegmentSamples, opening: Imu | None
) -> Iterator[tuple[Increments, Imu, Imu | None]]:
    """Updates with their samples, if there are any."""
    if len(made.sample):
        yield made, waiting.take(made.sample), opening
