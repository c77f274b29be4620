"""Samples of an IMU topic once they have been surveyed: kept, or read again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from sinstool.core.memory import return_freed_memory
from sinstool.core.streams import Imu
from sinstool.core.timeline import Order, ordered, reblock
from sinstool.io.readers.log import Log
from sinstool.io.readers.streams import ImuUnits, Losses, read_imu
from sinstool.io.readers.topics import ImuTopic
from sinstool.survey.imu import BLOCK_ROWS, Survey, Watcher, within

# An hour at 400 Hz; 96 MB.
CACHED_SAMPLES = 1_500_000

# Samples that share a stamp are moved from it by less.
MOVED_NS = 10_000


class SampleCache:
    """The samples that the first pass read, for the second: all of them, or none if too many.

    Reading them a second time costs more than all that is computed from them. Memory stays
    bounded all the same, by `CACHED_SAMPLES` and not by the log.

    Parameters
    ----------
    beside : Watcher, optional
        Looks at the same samples.

    Attributes
    ----------
    blocks : list of Imu or None
        In the order of the file, without orientation; None when there were too many.
    made : dict
        What several runs need of a part of them, by what it depends on: see
        :func:`~sinstool.survey.increments.first_increments`. Whoever knows that no run comes any
        more empties it.
    """

    def __init__(self, beside: Watcher | None = None) -> None:
        self.blocks: list[Imu] | None = []
        self.made: dict[tuple[Any, ...], Any] = {}
        self._beside = beside

    def watch(self, blocks: Iterator[Imu]) -> Iterator[Imu]:
        """The same blocks."""
        self.blocks = []
        count = 0
        for block in blocks if self._beside is None else self._beside.watch(blocks):
            count += len(block)
            if count > CACHED_SAMPLES and self.blocks is not None:
                self.blocks = None
                return_freed_memory()
            if self.blocks is not None:
                # Columns may be parts of something larger, which must not stay alive with them.
                columns = (block.time_ns, block.log_time_ns, block.gyro, block.accel)
                self.blocks.append(Imu(*map(_alone, columns)))
            yield block


def _alone(column: np.ndarray) -> np.ndarray:
    """The column, copied if it would keep much more than itself alive."""
    owner = column.base
    if owner is None or (isinstance(owner, np.ndarray) and owner.nbytes <= 2 * column.nbytes):
        return column
    return column.copy()


def samples_again(
    log: Log,
    topic: ImuTopic,
    units: ImuUnits,
    survey: Survey,
    samples: SampleCache,
    start_ns: int,
    *,
    progress: Callable[[int], None] | None = None,
    rows: int = BLOCK_ROWS,
    last: bool = False,
) -> Iterator[Imu]:
    """Samples in the order of time, from ``start_ns`` on, in blocks of ``rows``.

    Parameters
    ----------
    survey : Survey
        Of these samples.
    samples : SampleCache
        What of them was kept.
    progress : callable, optional
        Called with the bytes read.
    last : bool, optional
        Nobody is going to ask for them again: those that were kept are let go one by one.
    """
    even = survey.even
    begin_ns = first_ns = max(start_ns, survey.first_ns)
    end_ns = survey.last_ns
    if even is not None:
        # Even times count from the first sample of a line on, which only its own stamp tells
        begin_ns = even.line_before(first_ns)
        end_ns += int(even.most_ns) + 1
    if samples.blocks is not None:
        raw = _kept(samples, log.size, progress, last)
    else:
        log_time = survey.time_source == "log"
        raw = read_imu(
            log, topic.channels, units, Losses(), path=topic.path, log_time=log_time,
            progress=progress,
        )  # fmt: skip
        if survey.left_out is not None:
            raw = survey.left_out.applied(raw)
    kept = survey.order.keep_repeated
    inside = within(raw, begin_ns - MOVED_NS if kept else begin_ns, end_ns)
    blocks = ordered(reblock(inside, rows), Order(survey.horizon_ns, kept))
    if kept:
        blocks = within(blocks, begin_ns, None)
    if even is None:
        return blocks
    # The log's first sample may have been taken before its stamp
    all_ns = None if first_ns <= even.stamp_ns[0] else first_ns
    return within(even.applied(blocks), all_ns, survey.last_ns)


def _kept(
    samples: SampleCache, size: int, progress: Callable[[int], None] | None, last: bool
) -> Iterator[Imu]:
    """The cached blocks; with ``last`` the cache is emptied."""
    waiting = list(reversed(samples.blocks or ()))
    if last:
        samples.blocks = None
    count = len(waiting)
    while waiting:
        if progress is not None:
            progress(size * (count - len(waiting)) // count)
        yield waiting.pop()
