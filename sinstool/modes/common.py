"""What the kinds of runs share."""

from __future__ import annotations

from collections.abc import Callable

from sinstool.alignment.initial import Alignment
from sinstool.config import ProcessConfig
from sinstool.source import Source
from sinstool.timeline import SECOND
from sinstool.writers.topics import Frames

Progress = Callable[[float], None]


def nominal_interval(source: Source, config: ProcessConfig) -> float:
    """Interval of the Imu's samples, ns: as told, else the median of the log."""
    rate = config.input.imu_rate
    return (source.survey.interval_ns if rate is None else SECOND / rate) or SECOND


def odometry_frames(
    source: Source, alignment: Alignment, config: ProcessConfig, body: str
) -> Frames:
    """Frames of a run: ``map`` where heading counts from north, else ``odom``."""
    referenced = alignment.north_referenced and source.latitude is not None
    return Frames(
        config.output.world,
        "map" if referenced else "odom",
        body,
        config.input.body_axes,
    )


def share(
    progress: Progress | None, size: int, begin: float, part: float = 0.5
) -> Callable[[int], None] | None:
    """Progress of one pass over the log, in bytes of it."""
    if progress is None:
        return None
    return lambda position: progress(begin + part * min(1.0, position / max(size, 1)))
