"""A log, opened and surveyed: the topic that is meant, its units, and its samples in order."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from sinstool.config import InputOptions, ProcessConfig, parse_time
from sinstool.core.choices import log_choice
from sinstool.core.errors import DataError, TopicError
from sinstool.core.streams import Imu
from sinstool.core.timeline import Order, mean_rates, ordered, reblock
from sinstool.core.units import DEGREE, STANDARD_GRAVITY
from sinstool.io.readers.log import Log
from sinstool.io.readers.message_types import FIX_TYPE, VELOCITY_TYPES
from sinstool.io.readers.streams import ImuUnits, Losses, first_fix, read_imu
from sinstool.io.readers.topics import ImuTopic, choose_imu, choose_optional
from sinstool.survey.aiding import Aiding, aiding_channels, moving_at, read_gnss
from sinstool.survey.imu import BLOCK_ROWS, Kept, Survey, survey, within
from sinstool.survey.oddities import oddities


@dataclass(frozen=True)
class Source:
    """A log, opened and surveyed: what every later step starts from.

    Attributes
    ----------
    latitude : float or None
        Radians; None where neither the user nor the log gives one.
    position : tuple
        Latitude, longitude (deg) and height (m), None where unknown.
    kept : Kept
        What the survey read, where it is not too much to keep.
    aiding : Aiding
        GNSS of the whole log, or of its beginning.
    """

    log: Log
    topic: ImuTopic
    units: ImuUnits
    survey: Survey
    latitude: float | None
    position: tuple[float | None, float | None, float | None]
    warnings: tuple[str, ...]
    kept: Kept
    aiding: Aiding


def prepare(
    log: Log,
    config: ProcessConfig,
    progress: Callable[[int], None] | None = None,
    whole_gnss: bool = False,
) -> Source:
    """Choose topics, survey the Imu and refuse what cannot be processed.

    Parameters
    ----------
    progress : callable, optional
        Called with the bytes read.
    whole_gnss : bool
        Read all of GNSS, not only where the log begins.

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
    if whole_gnss:
        log.cache(aiding_channels(log))
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
    aiding = _gnss(log, config, found, whole_gnss, warnings)
    if found.lead_in is not None:
        speed = moving_at(aiding.gnss, found.lead_in.start_ns, found.lead_in.end_ns)
        if speed is not None:
            warnings.append(
                f"the Imu seems at rest for the first {found.lead_in.duration_s:.1f} s, but GNSS"
                f" moves at {speed:.1f} m/s: steady motion, not taken for rest"
            )
            found = replace(found, lead_in=None)
    log_choice(
        "time",
        f"{'header stamps' if found.time_source == 'stamp' else 'log times'}, a sample each"
        f" {found.interval_ns / 1e6:.6g} ms; longer than {found.max_gap_ns / 1e6:.6g} ms is a gap",
    )
    still = found.lead_in
    log_choice(
        "rest", "none at the beginning" if still is None else f"the first {still.duration_s:.1f} s"
    )
    position = _position(log, config, aiding)
    told = config.align.latitude is not None
    where = "--latitude" if told else f"first fix of {aiding.fix_topic}"
    log_choice(
        "latitude",
        "not known: the Earth's rate stays in"
        if position[0] is None
        else f"{position[0]:.6f} deg, by {where}",
    )
    latitude = None if position[0] is None else position[0] * DEGREE
    return Source(log, topic, units, found, latitude, position, tuple(warnings), kept, aiding)


def has_gnss(log: Log, options: InputOptions) -> bool:
    """Whether a log has one topic with fixes and one with velocity."""
    try:
        return bool(
            choose_optional(log, "--gnss-topic", options.gnss_topic, FIX_TYPE)
            and choose_optional(log, "--velocity-topic", options.velocity_topic, *VELOCITY_TYPES)
        )
    except TopicError:
        return False


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


def _gnss(
    log: Log, config: ProcessConfig, found: Survey, whole: bool, warnings: list[str]
) -> Aiding:
    """GNSS of a log: all of it, or what says where and how the vehicle began."""
    aiding = Aiding()
    begun = found.first_ns if found.lead_in is None else found.lead_in.end_ns
    until = None if whole else begun
    try:
        read_gnss(log, config.input, found.time_source == "log", aiding, until)
    except TopicError as exc:
        named = config.input.gnss_topic or config.input.velocity_topic
        if named is not None or whole:
            raise
        warnings.append(f"{exc}; no latitude is taken from them")
        return Aiding()
    warnings += aiding.warnings
    return aiding


def _position(
    log: Log, config: ProcessConfig, aiding: Aiding
) -> tuple[float | None, float | None, float | None]:
    """Where the vehicle is: as told, else the log's first fix."""
    told = config.align
    if told.latitude is not None:
        return told.latitude, told.longitude, told.height
    fixes = aiding.gnss
    if fixes is not None and fixes.has_position.any():
        fix = fixes.rows(np.flatnonzero(fixes.has_position)[:1])
        latitude, longitude, height = fix.latitude[0], fix.longitude[0], fix.height[0]
    elif aiding.fix_topic:  # none so early, but perhaps later
        first = first_fix(log, tuple(log.channels_of(aiding.fix_topic)))
        if first is None:
            return None, None, None
        degree = DEGREE if config.input.gnss_unit == "rad" else 1.0
        latitude, longitude = first.latitude[0] / degree, first.longitude[0] / degree
        height = first.height[0]
    else:
        return None, None, None
    return (
        float(latitude / DEGREE),
        float(longitude / DEGREE),
        float(height) if np.isfinite(height) else None,
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


def rate_blocks(
    source: Source,
    config: ProcessConfig,
    start_ns: int,
    nominal_ns: float,
    progress: Callable[[int], None] | None = None,
) -> Iterator[Imu]:
    """As :func:`imu_blocks`, with increments as mean rates over their own intervals.

    ``nominal_ns`` is the interval of samples that follow a gap or nothing.
    """
    blocks = imu_blocks(source, config, start_ns, progress)
    if config.input.gyro_kind != "increment":
        return blocks
    return mean_rates(blocks, nominal_ns, source.survey.max_gap_ns, config.input.imu_rate)


def _again(blocks: list[Imu], size: int, progress: Callable[[int], None] | None) -> Iterator[Imu]:
    for number, block in enumerate(blocks):
        if progress is not None:
            progress(size * number // len(blocks))
        yield block
