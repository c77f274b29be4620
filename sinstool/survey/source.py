"""A log, opened and surveyed: the topic to use, its units, and its samples in order."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from sinstool.config import InputOptions, ProcessConfig
from sinstool.config.logs import parse_time
from sinstool.core.choices import log_choice
from sinstool.core.errors import DataError, TopicError
from sinstool.core.finding import Finding, Severity
from sinstool.core.memory import return_freed_memory
from sinstool.core.streams import Imu
from sinstool.core.timeline import SECOND, mean_rates, means_with_lost
from sinstool.core.units import DEGREE, STANDARD_GRAVITY
from sinstool.io.readers.log import Log
from sinstool.io.readers.message_types import FIX_TYPES, SENSOR_TYPES
from sinstool.io.readers.streams import ImuUnits, first_fix
from sinstool.io.readers.topics import NONE, ImuTopic, choose_imu, unread_topics
from sinstool.io.readers.transforms import StaticRotation, in_vehicle, tf_parent
from sinstool.survey.aiding import AidingData, aiding_channels, read_barometer
from sinstool.survey.antenna import antenna_b
from sinstool.survey.clock_correction import may_have_stepped, remove_clock_steps
from sinstool.survey.clock_steps import LEAST_NS
from sinstool.survey.clocks import against_gnss
from sinstool.survey.gnss import LEFT_OUT, read_gnss
from sinstool.survey.gyro_signs import gyro_sign_findings
from sinstool.survey.imu import BLOCK_ROWS, Survey, Watcher, survey
from sinstool.survey.magnetometer import magnetic_channels
from sinstool.survey.needs import (
    may_need_barometer,
    may_need_magnetometer,
    may_need_mount,
    may_write_tf,
    needs_all_gnss,
)
from sinstool.survey.oddities import oddities
from sinstool.survey.rest import crept, moving_at, rest_end, settled, shaken_rest
from sinstool.survey.samples import MOVED_NS, SampleCache, samples_again
from sinstool.survey.stamps_of_receipt import (
    even_where_late,
    fill_the_rate,
    sampled_unevenly,
    say_only_order,
)
from sinstool.survey.two_sensors import apart, may_alternate
from sinstool.survey.wheels import WheelSpeeds, read_wheels

# Samples that are too many to keep are read again for leaps of their times of so many s only.
READ_AGAIN_S = 0.25


@dataclass(frozen=True)
class Source:
    """A log, opened and surveyed: the start of every later step.

    Attributes
    ----------
    log : Log
        For the passes that follow; what a run needs to know of it is in the fields below.
    aiding : AidingData
        GNSS of the whole log, or of its beginning, and the barometer where one may be needed.
    latitude : float or None
        Radians; None where neither the user nor the log gives one.
    position : tuple
        Latitude, longitude (deg) and height (m), None where unknown.
    findings : tuple of Finding
        What is odd about the log.
    body_frame : str
        Frame id of the IMU's messages.
    encoding : str
        Of the IMU's messages: cdr or ros1.
    tf_parent : str or None
        Parent of the body's frame in the log's own transforms, where one may be in the way.
    in_vehicle : StaticRotation or None
        How the body's frame is turned in the vehicle by the log's static transforms, where a mode
        may use that.
    antenna_b : tuple of float or None
        Place of the antenna by the log's static transforms, where a mode may use that.
    samples : SampleCache
        What the survey read, where it is not too much to keep.
    """

    log: Log
    imu_topic: ImuTopic
    units: ImuUnits
    survey: Survey
    aiding: AidingData
    latitude: float | None
    position: tuple[float | None, float | None, float | None]
    findings: tuple[Finding, ...]
    body_frame: str
    encoding: str
    tf_parent: str | None
    in_vehicle: StaticRotation | None
    antenna_b: tuple[float, float, float] | None
    samples: SampleCache

    @property
    def path(self) -> Path:
        """The log's."""
        return self.log.path


def prepare(
    log: Log,
    config: ProcessConfig,
    progress: Callable[[int], None] | None = None,
    surveyed: tuple[Survey, SampleCache] | None = None,
    gyro_only: bool = False,
) -> Source:
    """Choose topics, survey the IMU, and refuse a log that cannot be processed.

    Parameters
    ----------
    progress : callable, optional
        Called with the bytes read.
    surveyed : tuple, optional
        The survey of the IMU topic that is chosen and its samples, where they exist already.
    gyro_only : bool, optional
        Nothing else is needed than the gyro's samples, and the latitude where the log begins.

    Raises
    ------
    TopicError, DataError
    """
    options = config.input
    topic = choose_imu(log, options.imu_topic)
    units = imu_units(options)
    findings: list[Finding] = []
    if not topic.obvious:
        text = f"IMU topic {topic.topic}: {topic.reason}"
        findings.append(Finding("imu-topic", text, topic=topic.topic))
    if not gyro_only:
        for name, why in unread_topics(log, *SENSOR_TYPES).items():
            text = f"not used, as it cannot be read: {why}"
            findings.append(Finding("unread-topic", text, Severity.WARNING, topic=name))
    all_gnss = not gyro_only and needs_all_gnss(log, config)
    needs_baro = not gyro_only and may_need_barometer(log, config)
    needs_wheels = all_gnss and config.navigation.mode in ("auto", "ins-gnss")
    if all_gnss:
        log.cache(aiding_channels(log, needs_baro, needs_wheels))
    elif not gyro_only and may_need_magnetometer(config):
        log.cache(magnetic_channels(log))
    survey_, samples = surveyed or survey_samples(log, topic, options, progress)
    long = samples.blocks is None  # what was read of it lies about in pieces that were freed
    if long:
        return_freed_memory()
    for oddity in oddities(survey_, options):
        if oddity.severity == Severity.FAILED:
            raise DataError(log.path, oddity.text, oddity.answer)
        findings.append(oddity)
    aiding = _gnss(log, config, survey_, None if all_gnss else lead_in_end(survey_))
    if needs_baro:
        barometer = read_barometer(log, config.input, survey_.time_source == "log")
        aiding = replace(aiding, barometer=barometer)
    if needs_wheels:
        aiding = _with_wheels(log, config, aiding, survey_.time_source == "log")
    findings += gyro_sign_findings(survey_.windows, survey_.topic)
    findings += [*aiding.findings, *against_gnss(log.path, options, survey_, aiding)]
    survey_, aiding, steady = _truly_at_rest(survey_, aiding)
    findings += steady
    position = _position(log, config, aiding)
    body = survey_.frame_id or "imu_link"
    source = Source(
        log=log,
        imu_topic=topic,
        units=units,
        survey=survey_,
        aiding=aiding,
        latitude=None if position[0] is None else position[0] * DEGREE,
        position=position,
        findings=tuple(findings),
        body_frame=body,
        encoding=topic.channels[0].message_encoding,
        tf_parent=tf_parent(log, body) if may_write_tf(config) else None,
        in_vehicle=in_vehicle(log, body) if all_gnss and may_need_mount(config) else None,
        antenna_b=antenna_b(log, config, body, aiding.fix_topic) if all_gnss else None,
        samples=samples,
    )
    _explain(source, config)
    if long:
        return_freed_memory()
    return source


def lead_in_end(survey_: Survey) -> int:
    """End of the rest at the beginning, or the time of the first sample."""
    rest = survey_.lead_in
    return survey_.first_ns if rest is None else rest_end(rest, survey_.spans, survey_.windows)


def _truly_at_rest(survey_: Survey, aiding: AidingData) -> tuple[Survey, AidingData, list[Finding]]:
    """A survey without a rest at its beginning in which GNSS moves, with one that is shaken.

    Of a rest in which it does not, GNSS without what the receiver gave before it had settled.
    """
    rest, gnss = survey_.lead_in, aiding.gnss
    if gnss is None:
        return (replace(survey_, lead_in=None) if rest and rest.lull else survey_), aiding, []
    if rest is None:
        shaken = shaken_rest(survey_.windows, gnss, survey_.first_ns)
        return replace(survey_, lead_in=shaken), aiding, []
    end_ns = lead_in_end(survey_)
    speed = moving_at(gnss, rest.start_ns, end_ns)
    if speed is None:  # what creeps may rest later
        speed = crept(gnss, rest.start_ns, rest.end_ns)
    if speed is None:
        gnss, findings = settled(gnss, rest.start_ns, end_ns)
        return survey_, replace(aiding, gnss=gnss), findings
    seems = f"the IMU seems at rest for the first {rest.duration_s:.1f} s"
    text = f"{seems}, but GNSS moves at {speed:.1f} m/s: this is steady motion, not rest"
    if gnss.time_ns[0] > end_ns:
        text = (
            f"{seems}, but the first fixes, which come after it, move at {speed:.1f} m/s: it may"
            " be steady motion, and is not taken for rest"
        )
    finding = Finding("moving-rest", text, numbers={"speed_m_s": speed})
    return replace(survey_, lead_in=None), aiding, [finding]


def part_of(source: Source, config: ProcessConfig, start_ns: int, end_ns: int) -> Source:
    """A part of a log as if it were a log of its own, but for its GNSS and its barometer.

    Raises
    ------
    DataError
        There is no usable sample in it.
    """
    whole = source.survey
    even, end_ns = whole.even, min(end_ns, whole.last_ns + 1)
    span = {"start": f"{start_ns} ns", "end": f"{end_ns} ns"}
    if even is not None:  # from the first sample of a line on, as late as the last may be
        span["start"] = f"{even.line_before(start_ns) - MOVED_NS} ns"
        span["end"] = f"{end_ns + int(even.most_ns) + 1} ns"
    options = config.input.model_copy(update={**span, "imu_stamps": "kept"})
    survey_, samples = survey_samples(
        source.log,
        source.imu_topic,
        options,
        look_for_steps=False,
        keep_repeated=whole.order.keep_repeated,
    )
    survey_, _, _ = _truly_at_rest(survey_, source.aiding)
    # What a gap is, and how far samples are apart, is known from all of the log
    survey_ = replace(survey_, interval_ns=whole.interval_ns, max_gap_ns=whole.max_gap_ns)
    if even is not None:
        first_ns = even.sample_from(max(start_ns, whole.first_ns))
        survey_ = replace(survey_, first_ns=first_ns, last_ns=end_ns, even=even)
    return replace(source, survey=survey_, samples=samples)


def survey_samples(
    log: Log,
    topic: ImuTopic,
    options: InputOptions,
    progress: Callable[[int], None] | None = None,
    read: Watcher | None = None,
    judged: Watcher | None = None,
    look_for_steps: bool = True,
    keep_repeated: bool = False,
) -> tuple[Survey, SampleCache]:
    """Read an IMU topic once: its survey, and its samples.

    Parameters
    ----------
    read, judged : Watcher, optional
        See :func:`~sinstool.survey.imu.survey`.
    look_for_steps : bool, optional
        Look whether a clock was set in the log; by default it is not known.
    keep_repeated : bool, optional
        See :class:`~sinstool.core.timeline.Order`; by default it is not known.

    Raises
    ------
    DataError
        There is not one usable sample.
    """
    samples, units = SampleCache(read), imu_units(options)
    increments = options.sample_kind == "increment"
    find = partial(
        survey,
        log,
        topic,
        units,
        span=time_span(log, options),
        max_gap_s=options.max_gap,
        increments=increments,
        progress=progress,
        read=samples,
        judged=judged,
        keep_repeated=keep_repeated,
    )
    found = find()
    if look_for_steps and _may_have_stepped(found, samples):
        steps = remove_clock_steps(log, topic)
        if steps:
            found = replace(find(), clock_steps=steps)
    even = partial(even_where_late, log, topic, units, samples, options)
    usual = even(found)
    if say_only_order(found, options):
        found = even(replace(find(keep_repeated=True), clock_steps=found.clock_steps))
        if found.even is None and not fill_the_rate(usual, options):
            found = usual
    else:
        found = usual
    if may_alternate(found.windows):
        again = samples_again(log, topic, units, found, samples, found.first_ns)
        found = replace(found, two_sensors=apart(again, found.count / found.duration_s))
    return found, samples


def _may_have_stepped(found: Survey, samples: SampleCache) -> bool:
    """Whether a clock may have been set while the log was recorded."""
    if found.time_source == "stamp" and samples.blocks:
        return may_have_stepped([(block.time_ns, block.log_time_ns) for block in samples.blocks])
    low, high = found.clock_offset_s
    longest_s = max((length for _, length in found.gaps), default=0.0)
    back = found.order.lateness_ns > LEAST_NS or found.time_source == "log"
    return back or max(longest_s, high - low) > READ_AGAIN_S


def _explain(source: Source, config: ProcessConfig) -> None:
    """Log the survey's results, for ``-v``."""
    survey_, latitude = source.survey, source.position[0]
    log_choice(
        "time",
        f"{'header stamps' if survey_.time_source == 'stamp' else 'log times'}, a sample each"
        f" {survey_.interval_ns / 1e6:.6g} ms; longer than {survey_.max_gap_ns / 1e6:.6g} ms is a"
        " gap",
    )
    still = survey_.lead_in
    log_choice(
        "rest", "none at the beginning" if still is None else f"the first {still.duration_s:.1f} s"
    )
    by_user = config.align.latitude is not None
    where = "--latitude" if by_user else f"first fix of {source.aiding.fix_topic}"
    log_choice(
        "latitude",
        "not known: the Earth's rate stays in"
        if latitude is None
        else f"{latitude:.6f} deg, by {where}",
    )


def imu_units(options: InputOptions) -> ImuUnits:
    """Scale factors and axes of the IMU topic."""
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


def _gnss(log: Log, config: ProcessConfig, survey_: Survey, until_ns: int | None) -> AidingData:
    """GNSS of a log: all of it, or enough for the vehicle's position and velocity at the start."""
    try:
        return read_gnss(log, config.input, survey_.time_source == "log", until_ns)
    except TopicError as exc:
        named = config.input.gnss_topic or config.input.velocity_topic
        if named is not None or until_ns is None:
            raise
        text = f"{exc}; their latitude is not used"
        return AidingData(findings=(Finding("gnss-topics", text),))


def _with_wheels(log: Log, config: ProcessConfig, aiding: AidingData, log_time: bool) -> AidingData:
    """Add the wheels, and drop findings about them as a velocity over ground."""

    def read(options: InputOptions) -> WheelSpeeds:
        return read_wheels(log, options, aiding.gnss, aiding.velocity_topic, log_time)

    wheels = read(config.input)
    topic = wheels.topic
    if config.input.wheels == NONE and any(f.kind == LEFT_OUT for f in aiding.findings):
        # A topic of wheels that are not to be used is one all the same
        topic = read(config.input.model_copy(update={"wheels": None})).topic
    findings = tuple(
        f for f in aiding.findings if f.kind != LEFT_OUT or not topic or f.topic != topic
    )
    return replace(aiding, wheels=wheels, findings=findings)


def _position(
    log: Log, config: ProcessConfig, aiding: AidingData
) -> tuple[float | None, float | None, float | None]:
    """Position of the vehicle: as configured, else the log's first fix."""
    options = config.align
    if options.latitude is not None:
        return options.latitude, options.longitude, options.height
    fixes = aiding.gnss
    if fixes is not None and fixes.has_position.any():
        fix = fixes.rows(np.flatnonzero(fixes.has_position)[:1])
        latitude, longitude, height = fix.latitude[0], fix.longitude[0], fix.height[0]
    elif aiding.fix_topic:  # none so early, but perhaps later
        first = first_fix(log, tuple(log.channels_of(aiding.fix_topic, *FIX_TYPES)))
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


def nominal_interval(source: Source, config: ProcessConfig) -> float:
    """Interval of the IMU's samples, ns: as configured, else the median of the log."""
    rate = config.input.imu_rate
    return (source.survey.interval_ns if rate is None else SECOND / rate) or SECOND


def imu_blocks(
    source: Source,
    start_ns: int,
    progress: Callable[[int], None] | None = None,
    rows: int = BLOCK_ROWS,
    *,
    last: bool = False,
) -> Iterator[Imu]:
    """Ordered samples of the second pass, from ``start_ns`` on, in blocks of ``rows``.

    Where nobody is going to ask for them again, which ``last`` says, those that were kept are let
    go one by one; whoever asks all the same has the log read anew.
    """
    return samples_again(
        source.log,
        source.imu_topic,
        source.units,
        source.survey,
        source.samples,
        start_ns,
        progress=progress,
        rows=rows,
        last=last,
    )


def rate_blocks(
    source: Source,
    config: ProcessConfig,
    start_ns: int,
    progress: Callable[[int], None] | None = None,
    *,
    last: bool = False,
) -> Iterator[Imu]:
    """As :func:`imu_blocks`, with increments and means as mean rates since the sample before."""
    blocks = imu_blocks(source, start_ns, progress, last=last)
    kind, rate = config.input.sample_kind, config.input.imu_rate
    if kind == "rate" or (kind == "mean-rate" and rate is not None):
        return blocks
    nominal_ns, max_gap_ns = nominal_interval(source, config), source.survey.max_gap_ns
    if kind == "mean-rate":
        if sampled_unevenly(source.survey):
            return blocks
        return means_with_lost(blocks, nominal_ns, max_gap_ns)
    return mean_rates(blocks, nominal_ns, max_gap_ns, rate)
