"""The whole way from a log to a solution, readable from top to bottom.

`process` opens the log, surveys it, refuses what would go wrong, aligns, streams attitude into
the output beside the input's own messages, and returns what a summary needs.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np

import sinstool
from sinstool.alignment import initial
from sinstool.alignment.initial import Alignment
from sinstool.attitude import AttitudeRun, AttitudeSettings
from sinstool.config import InputOptions, ProcessConfig, dump_toml, parse_time
from sinstool.coning.registry import algorithm
from sinstool.earth import earth_rate_n
from sinstool.errors import AlignmentError, DataError, OutputError, TopicError
from sinstool.oddities import oddities
from sinstool.readers import open_log
from sinstool.readers.frames import turn_body
from sinstool.readers.log import Log
from sinstool.readers.streams import (
    ImuUnits,
    Losses,
    first_fix,
    frame_id,
    read_imu,
    reblock,
)
from sinstool.readers.topics import ImuTopic, choose_imu, fix_channels
from sinstool.rotation import to_euler
from sinstool.streams import Imu, Solution
from sinstool.survey import BLOCK_ROWS, Kept, Survey, survey, within
from sinstool.timeline import Order, ordered
from sinstool.transforms import tf_parent
from sinstool.units import DEGREE, STANDARD_GRAVITY
from sinstool.writers.copy import Copier
from sinstool.writers.mcap import McapWriter
from sinstool.writers.solution import TOPICS, Frames, SolutionWriter
from sinstool.writers.whole import WholeFile, check_output

HASH_BYTES = 2**20
Progress = Callable[[float], None]


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


def process(
    path: Path, output: Path, config: ProcessConfig, progress: Progress | None = None
) -> dict[str, Any]:
    """Recorded IMU to corrected attitude.

    Parameters
    ----------
    path : Path
        The log.
    output : Path
        MCAP to write; appears when complete.
    config : ProcessConfig
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    dict
        The summary: the keys of ``--json``.

    Raises
    ------
    SinstoolError
        With one line that says what was wrong and what to do; no output is left behind.
    """
    with ExitStack() as stack:
        log = stack.enter_context(open_log(path, config.input.salvage))
        check_output(output, [path], config.output.overwrite)
        pool = stack.enter_context(ThreadPoolExecutor(1, thread_name_prefix="sinstool-hash"))
        stop = Event()
        stack.callback(stop.set)  # a run that fails does not wait for the hash of a large log
        digest = pool.submit(sha256, path, stop)
        source = prepare(log, config, _share(progress, log.size, 0.0))
        emits, warnings = _emits(source, config)
        alignment = align(source, config)
        settings = _settings(source, alignment, config)
        run = AttitudeRun(alignment.q_nb, settings)
        frames = _frames(source, alignment, config)
        whole = stack.enter_context(WholeFile(output))
        only = config.output.only_results
        encoding = "cdr" if only else source.topic.channels[0].message_encoding
        writer = McapWriter(
            whole.stream,
            "ros1" if encoding == "ros1" else "ros2",
            f"sinstool/{sinstool.__version__}",
            config.output.compression,
        )
        stack.callback(writer.abort)
        copier = None if only else Copier(log, writer)
        solutions = SolutionWriter(
            writer, encoding, emits, frames, copier.advance if copier else lambda _: None
        )
        final: Solution | None = None
        blocks = imu_blocks(source, config, alignment.time_ns, _share(progress, log.size, 0.5))
        for solution in run.run(blocks):
            solutions.push(solution)
            final = solution
        solutions.finish()
        if copier:
            copier.finish()
        identity = {"name": path.name, "size": str(log.size), "sha256": digest.result()}
        writer.add_metadata(
            "sinstool",
            {
                "version": sinstool.__version__,
                "config": dump_toml(config),
                **{f"input_{key}": value for key, value in identity.items()},
            },
        )
        writer.finish()
        assert final is not None
        notes = [*source.warnings, *alignment.warnings, *warnings, *_run_warnings(source, run)]
        summary = {
            "input": {"path": str(path), "size": log.size, "sha256": identity["sha256"]},
            "output": {
                "path": str(output),
                "topics": [TOPICS[name].topic for name in emits],
                "attitudes": solutions.written,
                "frame": frames.reference_id,
            },
            "imu": _imu_summary(source),
            "alignment": _alignment_summary(alignment),
            "coning": _coning_summary(settings, run),
            "hse": None,
            "height": None,
            "filter": None,
            "final": _final_summary(final, source),
            "lost": _lost(source),
            "warnings": notes,
        }
    if progress:
        progress(1.0)
    return summary


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


def align(source: Source, config: ProcessConfig) -> Alignment:
    """First attitude and gyro bias.

    Raises
    ------
    AlignmentError
        What was asked for cannot be had from this log.
    """
    options, found = config.align, source.survey
    path = source.log.path
    if options.align == "fixed":
        assert options.initial_attitude is not None
        roll, pitch, heading = (v * DEGREE for v in options.initial_attitude)
        alignment = initial.from_given((roll, pitch, heading), found.first_ns)
    elif options.align == "log":
        if found.orientation is None:
            raise AlignmentError(
                f"{path}: topic {found.topic} holds no orientation",
                "use --align level or --align fixed",
            )
        alignment = initial.from_log(found.orientation, found.orientation_ns)
    elif found.lead_in is not None:
        alignment = initial.from_still(found.lead_in, found.first_ns)
    elif options.align == "level":
        raise AlignmentError(
            f"{path}: the log does not begin still, so its tilt cannot be levelled",
            "choose a still beginning with --start, or use --align log, fixed or auto",
        )
    elif found.orientation is not None and not found.orientation_constant:
        alignment = initial.from_log(found.orientation, found.orientation_ns)
    else:
        alignment = initial.from_motion(found.windows, found.first_ns)
    return _with_bias(alignment, source, config)


def _with_bias(alignment: Alignment, source: Source, config: ProcessConfig) -> Alignment:
    wanted = config.align.gyro_bias
    if wanted == "none":
        return alignment
    if not isinstance(wanted, str):
        bias = turn_body(np.array(wanted), config.input.body_axes)
        return replace(alignment, gyro_bias=bias, bias_source="given")
    still = source.survey.lead_in
    if still is None:
        note = "the log does not begin still, so no gyro bias is removed"
        return replace(alignment, warnings=(*alignment.warnings, note))
    bias = initial.still_bias(still, alignment.q_nb, _earth_rate(source))
    return replace(alignment, gyro_bias=bias, bias_source="still")


def _earth_rate(source: Source) -> np.ndarray | None:
    if source.latitude is None:
        return None
    return np.asarray(earth_rate_n(source.latitude))


def _settings(source: Source, alignment: Alignment, config: ProcessConfig) -> AttitudeSettings:
    options = config.coning.sp_options()
    if "beta" in options:
        options["beta"] = tuple(turn_body(np.array(options["beta"]), config.input.body_axes))
    rate = config.input.imu_rate
    nominal = source.survey.interval_ns if rate is None else 1e9 / rate
    return AttitudeSettings(
        algorithm(config.coning.coning, **options),
        config.input.gyro_kind,
        nominal or 1e9,
        source.survey.max_gap_ns,
        alignment.gyro_bias,
        _earth_rate(source),
        rate,
        source.survey.lead_in.end_ns
        if source.survey.lead_in is not None and alignment.bias_source == "still"
        else None,
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


def _frames(source: Source, alignment: Alignment, config: ProcessConfig) -> Frames:
    referenced = alignment.north_referenced and source.latitude is not None
    body = frame_id(source.log, source.topic.channels, source.topic.path)
    return Frames(
        config.output.world,
        "map" if referenced else "odom",
        body or "imu_link",
        config.input.body_axes,
    )


def _emits(source: Source, config: ProcessConfig) -> tuple[list[str], list[str]]:
    """Topics to write, and what had to be left out of them."""
    emits = list(config.output.emit)
    warnings: list[str] = []
    if config.output.only_results:
        return emits, warnings
    present = {c.topic for c in source.log.channels.values()}
    clash = sorted(present & {TOPICS[name].topic for name in emits if name != "tf"})
    if clash:
        raise OutputError(
            f"{source.log.path} holds results of sinstool already ({', '.join(clash)})",
            "process the original log, or add --only-results",
        )
    if "tf" in emits:
        body = frame_id(source.log, source.topic.channels, source.topic.path) or "imu_link"
        parent = tf_parent(source.log, body)
        if parent is not None:
            emits.remove("tf")
            warnings.append(
                f"/tf is not written: in the log {body} has the parent {parent} already, and a"
                " frame can have only one"
            )
    return emits, warnings


def _share(progress: Progress | None, size: int, begin: float) -> Callable[[int], None] | None:
    """Progress of one of the two passes over the log, in bytes of it."""
    if progress is None:
        return None
    return lambda position: progress(begin + 0.5 * min(1.0, position / max(size, 1)))


def sha256(path: Path, stop: Event | None = None) -> str:
    """SHA-256 of a log, given up when ``stop`` is set.

    Of a directory: of the lines ``<sha256>  <relative name>`` of its files, sorted by name.
    """
    if path.is_dir():
        names = sorted(p.relative_to(path).as_posix() for p in path.rglob("*") if p.is_file())
        listing = "".join(f"{sha256(path / name, stop)}  {name}\n" for name in names)
        return hashlib.sha256(listing.encode()).hexdigest()
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while not (stop and stop.is_set()) and (part := stream.read(HASH_BYTES)):
            digest.update(part)
    return digest.hexdigest()


# -- the summary ---------------------------------------------------------------------------


def _imu_summary(source: Source) -> dict[str, Any]:
    s = source.survey
    return {
        "topic": s.topic,
        "n": s.count,
        "rate_hz": s.rate_hz,
        "first_ns": str(s.first_ns),
        "last_ns": str(s.last_ns),
        "time_source": s.time_source,
        "gaps": s.gap_count,
        "gap_total_s": s.gap_total_s,
        "duplicates": s.order.duplicates,
        "backward": s.order.backward,
        "dropped": s.order.duplicates + s.order.late + s.losses.malformed + s.losses.nonfinite,
    }


def _alignment_summary(a: Alignment) -> dict[str, Any]:
    roll, pitch, heading = to_euler(a.q_nb) / DEGREE
    return {
        "method": a.method,
        "time_ns": str(a.time_ns),
        "roll_deg": float(roll),
        "pitch_deg": float(pitch),
        "heading_deg": float(heading),
        "sigma_deg": [None if s is None else s / DEGREE for s in a.sigma_rad],
        "status": a.status,
        "north_referenced": a.north_referenced,
        "gyro_bias_rad_s": a.gyro_bias.tolist(),
        "gyro_bias_source": a.bias_source,
    }


def _coning_summary(settings: AttitudeSettings, run: AttitudeRun) -> dict[str, Any]:
    chosen = settings.algorithm
    return {
        "algorithm": chosen.name,
        "samples_per_update": chosen.samples,
        "gyro_kind": settings.gyro_kind,
        "takes": chosen.takes,
        "updates": run.updates,
        "source": chosen.source,
    }


def _final_summary(final: Solution, source: Source) -> dict[str, Any]:
    roll, pitch, heading = to_euler(final.q_nb[-1]) / DEGREE
    latitude, longitude, height = source.position
    return {
        "time_ns": str(int(final.time_ns[-1])),
        "q_wxyz_ned_frd": final.q_nb[-1].tolist(),
        "roll_deg": float(roll),
        "pitch_deg": float(pitch),
        "heading_deg": float(heading),
        "lat_deg": latitude,
        "lon_deg": longitude,
        "height_m": height,
    }


def _lost(source: Source) -> dict[str, Any]:
    s = source.survey
    return {
        "parts": list(source.log.lost),
        "malformed": s.losses.malformed,
        "not_finite": s.losses.nonfinite,
        "late": s.order.late,
    }


def _run_warnings(source: Source, run: AttitudeRun) -> list[str]:
    notes = [f"lost: {part}" for part in source.log.lost]
    if run.missed_rotation:
        notes.append(
            "attitude is held across gaps: at the rates on either side the vehicle turned by"
            f" {run.missed_rotation / DEGREE:.3g} deg during them"
        )
    if source.latitude is None:
        notes.append("no latitude is known, so the Earth's rate is not removed; give --latitude")
    return notes


def something_lost(summary: dict[str, Any]) -> bool:
    """Whether a summary tells of lost data: exit status 3."""
    lost = summary["lost"]
    return bool(lost["parts"] or lost["malformed"] or lost["not_finite"] or lost["late"])
