"""A log, opened and surveyed: the topic that is meant, its units, and its samples in order."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from sinstool.config import InputOptions, ProcessConfig, parse_time
from sinstool.errors import DataError, TopicError
from sinstool.oddities import oddities
from sinstool.readers.log import Log
from sinstool.readers.streams import ImuUnits, Losses, first_fix, read_imu, reblock
from sinstool.readers.topics import ImuTopic, choose_imu, fix_channels
from sinstool.streams import Imu
from sinstool.survey import BLOCK_ROWS, Kept, Survey, survey, within
from sinstool.timeline import Order, ordered
from sinstool.units import DEGREE, STANDARD_GRAVITY


@dataclass(frozen=True)
class Source:
    """A log, opened and surveyed: what every later step starts from.

    Attributes
    ----------
    log : Log
    topic : ImuTopic
    units : ImuUnits
    survey : Survey
    latitude : float or None
        Radians; None where neither the user nor the log gives one.
    position : tuple
        Latitude, longitude (deg) and height (m), None where unknown.
    warnings : tuple of str
    kept : Kept
        What the survey read, where it is not too much to keep.
    """

    log: Log
    topic: ImuTopic
    units: ImuUnits
    survey: Survey
    latitude: float | None
    position: tuple[float | None, float | None, float | None]
    warnings: tuple[str, ...]
    kept: Kept


def prepare(
    log: Log, config: ProcessConfig, progress: Callable[[int], None] | None = None
) -> Source:
    """Choose topics, survey the Imu and refuse what cannot be processed.

    Raises
    ------
    TopicError, DataError
    """
    options = config.input
    topic = choose_imu(log, options.imu_topic)
    units = imu_units(options)
    warnings: list[str] = []
    if topic.note:
        warnings.append(f"Imu topic {topic.topic}: {topic.note}")
    kept = Kept()
    found = survey(
        log,
        topic,
        units,
        span=time_span(log, options),
        max_gap_s=options.max_gap,
        increments=options.gyro_kind == "increment",
        progress=progress,
        kept=kept,
    )
    for oddity in oddities(found, options):
        if oddity.fatal:
            raise DataError(log.path, oddity.text, oddity.answer)
        warnings.append(str(oddity))
    position = _position(log, config, warnings)
    latitude = None if position[0] is None else position[0] * DEGREE
    return Source(log, topic, units, found, latitude, position, tuple(warnings), kept)


def imu_units(options: InputOptions) -> ImuUnits:
    """Scale factors and axes of the Imu topic."""
    return ImuUnits(
        options.body_axes,
        DEGREE if options.gyro_unit == "deg/s" else 1.0,
        STANDARD_GRAVITY if options.accel_unit == "g" else 1.0,
    )


def time_span(
    log: Log, options: InputOptions
) -> Callable[[int], tuple[int | None, int | None]] | None:
    """--start and --end, as a function of the time of the first sample; None: all of the log."""
    if options.start is None and options.end is None:
        return None

    def resolve(first_ns: int) -> tuple[int | None, int | None]:
        start = None if options.start is None else parse_time(options.start, first_ns)
        end = None if options.end is None else parse_time(options.end, first_ns)
        if start is not None and end is not None and end <= start:
            raise DataError(log.path, "--end is not after --start", "choose a longer span")
        return start, end

    return resolve


def _position(
    log: Log, config: ProcessConfig, warnings: list[str]
) -> tuple[float | None, float | None, float | None]:
    """Where the vehicle is: as told, else the log's first fix."""
    told = config.align
    if told.latitude is not None:
        return told.latitude, told.longitude, told.height
    try:
        channels = fix_channels(log, config.input.gnss_topic)
    except TopicError as exc:
        if config.input.gnss_topic is not None:
            raise
        warnings.append(f"{exc}; no latitude is taken from them")
        return None, None, None
    fix = first_fix(log, channels) if channels else None
    if fix is None:
        return None, None, None
    return (
        float(fix.latitude[0] / DEGREE),
        float(fix.longitude[0] / DEGREE),
        float(fix.height[0]) if np.isfinite(fix.height[0]) else None,
    )


def imu_blocks(
    source: Source,
    config: ProcessConfig,
    start_ns: int,
    progress: Callable[[int], None] | None = None,
    rows: int = BLOCK_ROWS,
) -> Iterator[Imu]:
    """Ordered samples of the second pass, from ``start_ns`` on, in blocks of ``rows``."""
    found = source.survey
    if source.kept.blocks is not None:
        raw = _again(source.kept.blocks, source.log.size, progress)
    else:
        raw = read_imu(
            source.log,
            source.topic.channels,
            source.units,
            Losses(),
            path=source.topic.path,
            log_time=found.time_source == "log",
            progress=progress,
        )
    inside = within(raw, max(start_ns, found.first_ns), found.last_ns)
    return ordered(reblock(inside, rows), Order(found.horizon_ns))


def _again(blocks: list[Imu], size: int, progress: Callable[[int], None] | None) -> Iterator[Imu]:
    for number, block in enumerate(blocks):
        if progress is not None:
            progress(size * number // len(blocks))
        yield block
