"""Choose how a log is processed, with reasons: once, from its survey and the configuration.

Nobody else chooses. Some choices can only be made by trying: whether a gyrocompass sees north,
whether motion shows heading, whether a filter finds its start. What a trial finds is part of the
plan, so that it is not made again.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from sinstool.config import ProcessConfig
from sinstool.config.align import IN_FLIGHT
from sinstool.config.unused import listed, unused_options
from sinstool.core.choices import log_choice
from sinstool.core.errors import AlignmentError, TopicError
from sinstool.core.finding import Finding, Severity
from sinstool.core.memory import return_freed_memory
from sinstool.core.options import span
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE_PER_ROOT_HOUR, MICRO_G
from sinstool.methods.alignment.initial import Alignment
from sinstool.methods.sensor_errors import Grade
from sinstool.pipelines.align.first_attitude import align
from sinstool.pipelines.plan import Choice, Plan
from sinstool.survey.antenna import with_antenna
from sinstool.survey.coning import choose_algorithm, coning_reason
from sinstool.survey.grade import (
    measured_noise,
    random_walk_of,
    random_walks,
    sensor_grade,
    stated_noise_denied,
)
from sinstool.survey.gravity import without_gravity
from sinstool.survey.magnetometer import MagneticTopic, choose_magnetometer
from sinstool.survey.needs import has_gnss
from sinstool.survey.source import Source

if TYPE_CHECKING:
    from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart

# The finding about a log with fixes that no filter can start from.
NO_INS_GNSS = "no-ins-gnss"
NO_SOLUTION = "attitude only, as no INS/GNSS solution can be started: "
NO_NORTH = "nothing shows north"
# A log that is shorter holds nothing to smooth.
SHORTEST_S = 3.0


def make_plan(source: Source, config: ProcessConfig) -> Plan:
    """Choose how a log will be processed.

    Raises
    ------
    AlignmentError, TopicError, ConfigurationError, DataError
        What the configuration asks for cannot be had from the log.
    """
    given, config = config, with_antenna(config, source.antenna_b)
    grade = sensor_grade(source, config)
    mode, filter_start, findings = _mode(source, config)
    attitude = _attitude(source, config, mode.value, grade.grade)
    samples = _gyro_samples(given, attitude.value)
    config = as_planned(config, samples.value)
    alignment = None
    if filter_start is None:
        shown = _shown(source, config) if mode.value == "ins" else None
        alignment = align(source, config, shown)
        attitude = _attitude(source, config, mode.value, grade.grade, alignment)
        samples = _gyro_samples(given, attitude.value)
        config = as_planned(config, samples.value)
    first = _first_attitude(source, config, alignment, filter_start)
    algorithm = choose_algorithm(source, config)
    magnetic, doubts = _magnetometer(source, config, attitude, alignment)
    if filter_start is None:  # else its contradictions say so
        doubts = (*doubts, *stated_noise_denied(source, config))
    if magnetic.topic:
        reason = first.reason.replace(NO_NORTH, "only the magnetometer shows north")
        first = replace(first, reason=reason)
    plan = Plan(
        imu_topic=Choice(source.imu_topic.topic, source.imu_topic.reason, "--imu-topic"),
        mode=mode,
        attitude=attitude,
        gyro_samples=samples,
        magnetometer=Choice(magnetic.topic or "none", magnetic.reason, "--magnetometer"),
        first_attitude=first,
        imu_grade=Choice(grade.grade, grade.why, "--imu-grade"),
        imu_noise=_imu_noise(source, config),
        coning=Choice(config.coning.coning, coning_reason(algorithm, config), "--coning"),
        height_reference=_height_reference(config, filter_start),
        wheels=_wheels(source, mode.value),
        vehicle=_vehicle(config, mode.value),
        _algorithm=algorithm,
        _findings=(*findings, *doubts, *_unused(given, mode), *_not_withheld(source, config)),
        _alignment=alignment,
        _filter_start=filter_start,
        _magnetic=magnetic if magnetic.topic else None,
    )
    for name, text in plan.rows():
        log_choice(name, text)
    return plan


def fixed_plan(source: Source, config: ProcessConfig) -> Plan:
    """The plan of `align` with a method: it is tried there, and nothing else is."""
    grade = sensor_grade(source, config)
    untried = "as the method is configured"
    return Plan(
        imu_topic=Choice(source.imu_topic.topic, source.imu_topic.reason, "--imu-topic"),
        mode=Choice("not chosen", untried, "--mode"),
        attitude=Choice("not chosen", untried, "--attitude"),
        gyro_samples=_gyro_samples(config, "not chosen"),
        magnetometer=Choice("not chosen", untried, "--magnetometer"),
        first_attitude=Choice(config.align.align, "as configured", "--align"),
        imu_grade=Choice(grade.grade, grade.why, "--imu-grade"),
        imu_noise=_imu_noise(source, config),
        coning=Choice("not chosen", untried, "--coning"),
        height_reference=Choice("none", "as no height is damped", "--height-damping"),
        wheels=Choice("not chosen", untried, "--wheels"),
        vehicle=Choice("none", "as no filter runs", "--vehicle"),
    )


def turntable_plan(topic: str, config: ProcessConfig) -> Plan:
    """The plan for a log of a rate-biased system on its turntable: there is nothing to choose."""
    mode = Choice("turntable", f"as --hse is given: {config.hse.hse}", "--hse")
    return Plan(
        imu_topic=Choice(topic, "the gyros of the rig", "--imu-topic"),
        mode=mode,
        attitude=Choice("inertial", "as the turntable shows every turn", "--hse"),
        gyro_samples=Choice("increment", "as the rig counts angles", "--hse"),
        magnetometer=Choice("none", "as the turntable shows every turn", "--hse"),
        first_attitude=Choice("whole-turn", "as the table turns", "--hse"),
        imu_grade=Choice("navigation", "as the rig was calibrated", "--imu-grade"),
        imu_noise=Choice("of the grade", "as the rig was calibrated", "--imu-noise"),
        coning=Choice("none", "as the table's encoder gives the motion", "--hse"),
        height_reference=Choice("none", "as only attitude is computed", "--hse"),
        wheels=Choice("none", "as only attitude is computed", "--hse"),
        vehicle=Choice("none", "as no filter runs", "--vehicle"),
        _findings=_unused(config, mode),
    )


def _mode(
    source: Source, config: ProcessConfig
) -> tuple[Choice, FilterStart | None, tuple[Finding, ...]]:
    """The mode, and the start of its filter where it has one."""
    option, mode = "--mode", config.navigation.mode
    if mode != "auto":
        start = _filter_start(source, config) if mode == "ins-gnss" else None
        return Choice(mode, "as configured", option), start, ()
    if not has_gnss(source.log, config.input):
        none = config.input.gnss_topic is not None
        reason = "as --gnss-topic is none" if none else "as the log has no GNSS fixes"
        return Choice("attitude", reason, option), None, ()
    answer, severity = "", Severity.WARNING
    if config.input.imu_rate is not None:
        why = "only stamps tell which fix belongs to which sample, not --imu-rate"
    else:
        try:
            start = _filter_start(source, config)
        except (AlignmentError, TopicError) as exc:
            # The finding is about that log
            why, answer = exc.message.removeprefix(f"{source.path}: "), exc.hint
            if isinstance(exc, AlignmentError) and exc.uncertain and not exc.consistent:
                # Of axes or signs that are wrong the attitude has as much as the fixes
                why += "; fixes and IMU contradict each other: do not trust the attitude"
                severity = Severity.LOST
        else:
            reason = "as the log has GNSS fixes, and they show where it starts"
            return Choice("ins-gnss", reason, option), start, ()
        return_freed_memory()
    reason = "as no INS/GNSS solution can be started"
    finding = Finding(NO_INS_GNSS, f"{NO_SOLUTION}{why}", severity, answer)
    return Choice("attitude", reason, option), None, (finding,)


def _unused(config: ProcessConfig, mode: Choice) -> tuple[Finding, ...]:
    """Options that the chosen mode does not use."""
    unused = unused_options(config, mode.value)
    if not unused:
        return ()
    text = f"{listed(list(unused))} no effect in mode {mode.value}, which was chosen {mode.reason}"
    them = "it" if len(unused) == 1 else "them"
    modes = " or ".join(dict.fromkeys(m for modes in unused.values() for m in modes))
    answer = f"--mode {modes} would use {them}"
    if config.hse.hse is not None:
        answer = f"leave {them} out, or --hse"
    return (Finding("unused-options", text, answer=answer),)


def _not_withheld(source: Source, config: ProcessConfig) -> list[Finding]:
    """Spans of ``--withhold-gnss`` in which there is no fix that could be withheld."""
    gnss, first_ns = source.aiding.gnss, source.survey.first_ns
    findings = []
    for text in config.filter.withhold_gnss:
        begin, end = span(text)
        if gnss is not None:
            seconds = (gnss.time_ns - first_ns) / SECOND
            if ((seconds >= begin) & (seconds < end)).any():
                continue
        said = f"--withhold-gnss {text} withholds nothing, as the log has no fix there"
        findings.append(Finding("nothing-withheld", said))
    return findings


def _attitude(
    source: Source,
    config: ProcessConfig,
    mode: str,
    grade: Grade,
    alignment: Alignment | None = None,
) -> Choice:
    """Whether gravity holds up the attitude; before the first attitude is known, provisionally."""
    option, configured = "--attitude", config.navigation.attitude
    if mode == "ins-gnss":
        return Choice("filtered", "as GNSS corrects it", option)
    if mode == "ins":
        return Choice("inertial", "as velocity and position are integrated with it", option)
    if configured != "auto":
        return Choice(configured, "as configured", option)
    if without_gravity(source):
        return Choice("inertial", "as the specific force is not of gravity's size", option)
    if config.coning.coning != ProcessConfig().coning.coning:
        return Choice(
            "inertial", f"as --coning {config.coning.coning} is chosen, whose effect shows", option
        )
    if source.survey.duration_s < SHORTEST_S:
        return Choice("inertial", f"as the log is shorter than {SHORTEST_S:g} s", option)
    if grade == "navigation" and _holds_alone(source, config, alignment):
        return Choice("inertial", "as the gyros are of navigation grade", option)
    return Choice("smoothed", "as gravity holds roll and pitch better than the gyros", option)


def _holds_alone(source: Source, config: ProcessConfig, alignment: Alignment | None) -> bool:
    """Whether good gyros hold an attitude: it begins right, and the Earth's rate is taken off.

    Without a latitude it turns by 15 deg/h, and without a heading the level part of the Earth's
    rate is taken off in a wrong direction; that of a moving first second is degrees off.
    """
    survey = source.survey
    levelled = survey.lead_in is not None or survey.oriented or source.aiding.gnss is not None
    north = alignment is None or _counts_from_north(alignment, config)
    return source.latitude is not None and north and (levelled or config.align.align != "auto")


def _counts_from_north(alignment: Alignment, config: ProcessConfig) -> bool:
    """Whether heading does: an orientation of the log without a sigma may count from anywhere."""
    return alignment.north_referenced and (
        alignment.sigma_rad[2] is not None or config.align.align != "auto"
    )


def _imu_noise(source: Source, config: ProcessConfig) -> Choice:
    """Source of the sensors' noise."""
    option, measured = "--imu-noise", measured_noise(config)
    if measured is None:
        walks = random_walks(source)
        reason = "as no noise file is given"
        if config.navigation.imu_grade == "auto" and walks is not None:
            shown = f"{walks[1] / MICRO_G:.3g} ug/sqrt(Hz)"
            reason += f"; a filter uses the accelerometer's at rest, {shown}, if that is more"
        return Choice("of the grade", reason, option)
    walk, reason = random_walk_of(measured), "as configured: measured at rest"
    if walk is not None:
        reason += f", {walk / DEGREE_PER_ROOT_HOUR:.2g} deg/sqrt(h) for the gyro"
    return Choice(Path(str(config.navigation.imu_noise)).name, reason, option)


def _gyro_samples(config: ProcessConfig, attitude: str) -> Choice:
    """Kind of the gyro samples."""
    option, kind = "--gyro-kind", config.input.gyro_kind
    if kind != "auto":
        return Choice(kind, "as configured", option)
    if attitude == "smoothed":
        # Whether stamps are those of instants or of intervals' ends no log shows by itself.
        return Choice("mean-rate", "as sensors filter what lies between samples", option)
    return Choice(config.input.sample_kind, "the default", option)


def as_planned(config: ProcessConfig, gyro_samples: str) -> ProcessConfig:
    """The configuration with gyro samples read as the plan says."""
    options = config.input.model_copy(update={"gyro_kind": gyro_samples})
    return config.model_copy(update={"input": options})


def _magnetometer(
    source: Source, config: ProcessConfig, attitude: Choice, alignment: Alignment | None
) -> tuple[MagneticTopic, tuple[Finding, ...]]:
    """The magnetometer that shows a smoothed attitude its heading, and why none does."""
    name = config.navigation.magnetometer
    if attitude.value == "filtered":
        return MagneticTopic("", "as GNSS shows the heading"), ()
    if attitude.value != "smoothed":
        return MagneticTopic("", f"as the attitude is {attitude.value}"), ()
    if name is None and alignment is not None and _counts_from_north(alignment, config):
        return MagneticTopic("", "as the first attitude counts from north already"), ()
    chosen = choose_magnetometer(source.log, name, source.imu_topic, source.body_frame)
    if not chosen.doubtful:
        return chosen, ()
    text = f"no magnetometer is used, {chosen.reason}"
    return chosen, (Finding("magnetometer", text, answer="choose one with --magnetometer"),)


def _shown(source: Source, config: ProcessConfig) -> GnssEpochs | None:
    # Takes as long to import as a filter
    from sinstool.pipelines.process.ins_start import fixes_that_show

    return fixes_that_show(source, config)


def _filter_start(source: Source, config: ProcessConfig) -> FilterStart:
    # The filter takes longer to import than most logs without GNSS to process.
    from sinstool.pipelines.process.ins_gnss.first_start import first_start

    return first_start(source, config)


def _first_attitude(
    source: Source,
    config: ProcessConfig,
    alignment: Alignment | None,
    filter_start: FilterStart | None,
) -> Choice:
    option, method = "--align", config.align.align
    if alignment is None:
        assert filter_start is not None
        chosen = "svd" if method == "auto" else method
        how = filter_start.how.removeprefix(f"attitude by {chosen}").strip(" ;")
        return Choice(chosen, how or "as configured", option)
    if method != "auto":
        return Choice(alignment.method, "as configured", option)
    return Choice(alignment.method, _why(alignment, source), option)


def _why(alignment: Alignment, source: Source) -> str:
    """Property of the log that made `auto` choose this first attitude."""
    still = source.survey.lead_in
    rest = "" if still is None else f"the first {still.duration_s:.1f} s are at rest"
    if alignment.method == "gyrocompass":
        return f"as {rest}, the latitude is known and the gyros see the Earth's rotation"
    if alignment.method in IN_FLIGHT:
        shown = "heading" if alignment.north_referenced else f"tilt, and {NO_NORTH}"
        return f"as motion and GNSS velocity show {shown}"
    if rest:
        return f"as {rest} and {NO_NORTH}"
    if alignment.method == "log":
        return "as the log does not begin at rest and its IMU topic holds orientations"
    return "as the log neither begins at rest nor holds orientations: tilt from its first second"


def _height_reference(config: ProcessConfig, filter_start: FilterStart | None) -> Choice:
    option, damping = "--height-damping", config.vertical.height_damping
    if filter_start is not None and filter_start.reference is not None:
        reason = "as the log has a barometer"
        return Choice("baro", reason if damping == "off" else "as configured", option)
    if filter_start is not None:
        return Choice("none", "as the fixes of the filter hold the height", option)
    if damping == "off":
        return Choice("none", "as no height is damped", option)
    return Choice(damping, "as configured", option)


def _wheels(source: Source, mode: str) -> Choice:
    if mode != "ins-gnss":
        return Choice("none", f"as the mode is {mode}", "--wheels")
    wheels = source.aiding.wheels
    return Choice(wheels.topic or "none", wheels.reason, "--wheels")


def _vehicle(config: ProcessConfig, mode: str) -> Choice:
    """Motions that the vehicle is assumed not to make."""
    option, configured = "--vehicle", config.filter.vehicle
    if mode != "ins-gnss":
        return Choice("none", "as no filter runs", option)
    if config.filter.feedback == "none":
        return Choice("none", "as --feedback is none", option)
    if configured != "auto":
        return Choice(configured, "as configured", option)
    return Choice("auto", "which a first run without constraints decides", option)
