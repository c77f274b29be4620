"""Samples of a log into increments, segment by segment, for filters that run over all of it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sinstool.config import ProcessConfig
from sinstool.coning.stage import ConingStage
from sinstool.coning_choice import choose_algorithm
from sinstool.modes.common import nominal_interval
from sinstool.source import Source, imu_blocks
from sinstool.strapdown.velocity import Increments, IncrementStage
from sinstool.streams import Imu, concatenate
from sinstool.timeline import SECOND, mean_rates, segments


class SegmentIncrements:
    """Increments of a log's segments, with the samples they answer for.

    Parameters
    ----------
    source : Source
    config : ProcessConfig
    """

    def __init__(self, source: Source, config: ProcessConfig) -> None:
        self._source = source
        self._config = config
        self._nominal = nominal_interval(source, config)
        self.algorithm = choose_algorithm(source, config, self._nominal)
        self.samples = 0

    def from_time(
        self, start_ns: int, end_ns: int | None = None, progress: Any = None
    ) -> Iterator[tuple[Increments, Imu, Imu | None]]:
        """Increments from a sample on.

        Parameters
        ----------
        start_ns : int
            Time of the sample at which the first update begins.
        end_ns : int, optional
        progress : callable, optional
            Called with the bytes read.

        Yields
        ------
        Increments, Imu, Imu or None
            Updates, the samples at their ends, and, where they are the first of a segment, the
            sample at which it begins.
        """
        config, source = self._config, self._source
        blocks: Any = imu_blocks(source, config, start_ns, progress)
        kind = config.input.gyro_kind
        if kind == "increment":
            blocks = mean_rates(blocks, self._nominal, source.survey.max_gap_ns)
        stage: IncrementStage | None = None
        held: Imu | None = None
        first = 0
        opening: Imu | None = None
        for piece in segments(blocks, source.survey.max_gap_ns):
            if end_ns is not None and int(piece.imu.time_ns[0]) > end_ns:
                break
            if piece.starts:
                if stage is not None and held is not None:
                    yield from _answer(stage.finish(), held, first, opening)
                stage = IncrementStage(self._stage)
                held, first = None, 0
                opening = piece.imu.rows(slice(0, 1))
            assert stage is not None
            imu = piece.imu
            self.samples += len(imu)
            held = imu if held is None else concatenate([held, imu])
            made = stage.push(imu.gyro, imu.accel, imu.time_ns)
            yield from _answer(made, held, first, opening)
            if len(made.sample):
                opening = None
                done = int(made.sample[-1]) + 1 - first
                held, first = held.rows(slice(done, None)), first + done
        if stage is not None and held is not None:
            yield from _answer(stage.finish(), held, first, opening)

    def _stage(self) -> ConingStage:
        kind = "rate" if self._config.input.gyro_kind == "rate" else "mean-rate"
        return ConingStage(
            self.algorithm,
            kind,  # type: ignore[arg-type]
            nominal_interval=self._nominal / SECOND,
        )


def _answer(
    made: Increments, held: Imu, first: int, opening: Imu | None
) -> Iterator[tuple[Increments, Imu, Imu | None]]:
    """Updates with their samples, if there are any."""
    if len(made.sample):
        yield made, held.rows(made.sample - first), opening
