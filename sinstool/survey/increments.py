"""Increments from the samples of a log, segment by segment, for filters."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, cast

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.streams import Imu, concatenate, take_rows
from sinstool.core.timeline import SECOND, segments
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.strapdown.clipped_samples import ClippedSamples
from sinstool.methods.strapdown.followed_rates import with_followed
from sinstool.methods.strapdown.lost_samples import LostSamples
from sinstool.methods.strapdown.segment_samples import SampleSettings, SegmentSamples
from sinstool.methods.strapdown.velocity import Increments, IncrementStage
from sinstool.survey.source import Source, nominal_interval, rate_blocks
from sinstool.survey.stamps_of_receipt import sampled_unevenly


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
            uneven=sampled_unevenly(source.survey),
        )

    def from_time(
        self, start_ns: int, end_ns: int | None = None, progress: Any = None
    ) -> Iterator[tuple[Increments, Imu, Imu | None]]:
        """Increments from a sample on.

        Parameters
        ----------
        start_ns : int
            Time of the sample at which the first update begins.
        end_ns : int, optional
            Updates end no later than this.
        progress : callable, optional
            Called with the bytes read.

        Yields
        ------
        Increments, IMU, IMU or None
            Updates, the samples at their ends, and, where they are the first of a segment, the
            sample at which it begins.
        """
        # A little more than is asked for, as rates follow what comes after
        read_ns = None if end_ns is None else end_ns + SECOND
        for increments, (imu, opening) in with_followed(self._made(start_ns, read_ns, progress)):
            if end_ns is None or int(increments.time_ns[-1]) <= end_ns:
                yield increments, imu, opening
                continue
            rows = slice(0, int(np.searchsorted(increments.time_ns, end_ns, "right")))
            if rows.stop:
                yield take_rows(increments, rows), imu.rows(rows), opening
            return

    def _made(
        self, start_ns: int, end_ns: int | None, progress: Any
    ) -> Iterator[tuple[Increments, tuple[Imu, Imu | None]]]:
        """Increments without the rates for which those that follow must be known."""
        config, source = self._config, self._source
        blocks = rate_blocks(source, config, start_ns, progress)
        stage: IncrementStage | None = None
        sample_s = self._settings.nominal_ns / SECOND
        lost = LostSamples(self._settings.algorithm.samples * sample_s, sample_s)
        clipped = ClippedSamples(source.survey.range_ends, sample_s)
        waiting: SegmentSamples | None = None
        opening: Imu | None = None
        for piece in segments(blocks, source.survey.max_gap_ns):
            if end_ns is not None and int(piece.imu.time_ns[0]) > end_ns:
                break
            if piece.starts:
                if stage is not None and waiting is not None:
                    yield from _answer(stage.finish(), lost, clipped, waiting, opening)
                lost.begin()
                clipped.begin()
                stage = IncrementStage(self._settings.stage)
                waiting = SegmentSamples(int(piece.imu.time_ns[0]))
                opening = piece.imu.rows(slice(0, 1))
            assert stage is not None and waiting is not None
            imu = piece.imu
            clipped.push(imu.gyro, imu.accel)
            made = stage.push(imu.gyro, imu.accel, waiting.push(imu))
            yield from _answer(made, lost, clipped, waiting, opening)
            if len(made.sample):
                opening = None
        if stage is not None and waiting is not None:
            yield from _answer(stage.finish(), lost, clipped, waiting, opening)


def first_increments(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    start_ns: int,
    span_ns: int,
    gap_ns: int,
) -> Increments | None:
    """Increments of some minutes from a sample on, up to a gap; None without any.

    All at once, so that what is made of them does not depend on where a reader's blocks end. They
    are kept with the samples until others are asked for from another sample on, as runs of the same
    minutes follow each other.

    Parameters
    ----------
    start_ns : int
        Time of the sample at which the first update begins.
    span_ns, gap_ns : int
        So many minutes; the longest time between updates.
    """
    made = source.samples.made
    key = config.input.sample_kind, id(algorithm), start_ns, span_ns, gap_ns
    if key not in made:
        if any(kept[2] != start_ns for kept in made):
            made.clear()
        steps = SegmentIncrements(source, config, algorithm).from_time(start_ns, start_ns + span_ns)
        made[key] = _up_to_gap(steps, start_ns, gap_ns)
    return cast("Increments | None", made[key])


def _up_to_gap(
    steps: Iterator[tuple[Increments, Imu, Imu | None]], start_ns: int, gap_ns: int
) -> Increments | None:
    parts: list[Increments] = []
    last_ns = start_ns
    for increments, _, _ in steps:
        if int(increments.time_ns[0]) - last_ns > gap_ns:
            break
        last_ns = int(increments.time_ns[-1])
        parts.append(increments)
    return concatenate(parts) if parts else None


def _answer(
    made: Increments,
    lost: LostSamples,
    clipped: ClippedSamples,
    waiting: SegmentSamples,
    opening: Imu | None,
) -> Iterator[tuple[Increments, tuple[Imu, Imu | None]]]:
    """Updates with their samples, if there are any."""
    if len(made.sample):
        yield clipped.marked(lost.marked(made)), (waiting.take(made.sample), opening)
