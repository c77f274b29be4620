"""Start of an INS/GNSS filter: settings, attitude, measurements, and their latency."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.choices import log_choice
from sinstool.core.errors import AlignmentError, ConfigurationError, TopicError
from sinstool.core.options import span
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.height.pressure import HeightReference
from sinstool.methods.ins_gnss.fix_velocity import (
    message_times,
    split_position_velocity,
)
from sinstool.methods.ins_gnss.settings import (
    BARO_GRADES,
    BaroModel,
    DivergenceControl,
    GnssModel,
    Settings,
    Start,
)
from sinstool.methods.ins_gnss.states import ACCEL_SCALE, filter_kind
from sinstool.methods.sensor_errors import IMU_GRADES, Grade, SensorGrade
from sinstool.pipelines.align.in_motion import imu_noise
from sinstool.pipelines.process.height import height_reference, network
from sinstool.pipelines.process.ins_gnss.between_gaps import start_in_longest
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.first_state import StartFixes, find_start
from sinstool.pipelines.process.ins_gnss.imu_drift import Drift, NoiseFactors
from sinstool.pipelines.process.ins_gnss.imu_fit import fit, next_worse
from sinstool.pipelines.process.ins_gnss.receiver import (
    gnss_model,
    inflate_sigmas,
    times_as_noisy,
    with_lasting_share,
    with_measured_noise,
)
from sinstool.pipelines.process.ins_gnss.timing import significant_lag, white_noise, with_offsets
from sinstool.survey.grade import (
    ImuGrade,
    random_walk,
    random_walks,
    sensor_grade,
    to_align_as,
)
from sinstool.survey.source import Source

# Noise at rest, over what the options say of it, that is worth a warning.
NOISIER = 3.0
# Times the biases of a navigation grade that one judged by its noise may have: data sheets of such
# noise lie a factor of ten and more apart.
OPEN_BIAS = 3.0
OPEN = ("gyro_bias", "gyro_instability", "accel_bias", "accel_instability")
# A grade that drifts so many times as much as its own sigmas say is none of the Imu's.
OTHER_GRADE = 2.0
# A better grade is tried where gyros are so many times as noisy as theirs, and taken where it is
# likelier by this: twice the log, e^5 to 1.
QUIETER, LEAST_GAIN = 0.7, 10.0
# Slow error of a barometer, m, and its correlation time: weather, temperature, a cabin.
AIR_SIGMA, AIR_TIME_S = 10.0, 500.0
# Latencies with which a start is tried one after the other, s.
FIRST_LATENCIES = (0.0, 0.15, -0.15)


def first_start(
    source: Source, config: ProcessConfig, grade: ImuGrade | None = None
) -> FilterStart:
    """Settings, start and measurements of a filter run, with the configured latency or zero.

    Parameters
    ----------
    grade : ImuGrade, optional
        Instead of the one that the log shows at rest.

    Raises
    ------
    ConfigurationError
        Another rate than the stamps' is to be believed.
    TopicError, AlignmentError
        The log has no GNSS, or it shows no start.
    """
    if config.input.imu_rate is not None:
        raise ConfigurationError(
            f"{source.path}: --imu-rate with --mode ins-gnss: only stamps tell which fix belongs"
            " to which sample",
            "leave --imu-rate out, or give --mode ins or attitude",
        )
    gnss = source.aiding.gnss
    if gnss is None or not gnss.has_position.any():
        raise TopicError(
            source.path,
            "--mode ins-gnss: the log has no GNSS fixes",
            "use --mode ins (with --height-damping), or attitude",
        )
    here = config if grade is None else to_align_as(config, grade)
    grade = grade or sensor_grade(source, config)
    model, gnss_why = gnss_model(gnss, config)
    reference, remarks = _barometer(source, config)
    settings = _settings(source, config, grade, model, reference)
    lag = config.filter.gnss_velocity_lag
    if lag is None:
        lag = significant_lag(gnss)
    epochs = split_position_velocity(inflate_sigmas(gnss, config), lag)
    withheld = _withheld(message_times(epochs, lag), config, source.survey.first_ns)
    latency, result = _first_latency(source, here, settings, epochs.rows(~withheld))
    start, time_ns, how, notes = result
    best = FilterStart(
        replace(settings, gnss_latency=latency),
        start,
        time_ns,
        how,
        epochs,
        withheld,
        reference,
        None,
        "not observable",
        lag,
        grade,
        gnss_why,
        (*_too_good(source, config, settings), *remarks),
        notes,
    )
    return start_in_longest(source, config, best)


def _first_latency(
    source: Source, config: ProcessConfig, settings: Settings, gnss: GnssEpochs
) -> tuple[float, tuple[Start, int, str, tuple[str, ...]]]:
    """The configured latency, else zero, else the first usual latency with which a start succeeds.

    In rough air no attitude fits velocities that are a fifth of a second off.
    """
    by_option = config.gnss.gnss_latency
    refused: AlignmentError | None = None
    fixes = StartFixes.of(gnss, settings.gnss)
    for latency in FIRST_LATENCIES if by_option is None else (by_option,):
        try:
            timed = replace(settings, gnss_latency=latency)
            return latency, find_start(source, config, timed, fixes)
        except AlignmentError as exc:
            refused = refused or exc
    assert refused is not None
    raise refused


def timed_start(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, first: FilterStart
) -> FilterStart:
    """A start with latency, noise and grade estimated by runs of the filter, unless configured.

    That is the receiver's latency, the share of its noise that is white, and a grade of the Imu
    that innovations do not refute.

    Parameters
    ----------
    first : FilterStart
        Of :func:`first_start`.
    """
    start = _timed(source, config, algorithm, first)
    if config.navigation.imu_grade == "auto":
        start = _drifting(source, config, algorithm, _fitted(source, config, algorithm, start))
    if _stated(config):
        drift = Drift(source, config, algorithm, _by_the_fixes(start))
        start = replace(start, drifts=drift.ratio)
    if start.latency_status == "not settled":
        warning = (
            f"the latency of GNSS did not settle: {1e3 * start.settings.gnss_latency:.0f} ms is"
            f" used, and with it the log shows {start.offsets}: give it with --gnss-latency"
        )
        start = replace(start, warnings=(warning, *start.warnings))
    if max(start.noisier) > 1.0:
        warning = (
            f"fixes are {times_as_noisy(start.noisier)} as noisy as the receiver says, by how they"
            " change, and are weighted accordingly; --gnss-noise-scale overrides this"
        )
        start = replace(start, warnings=(warning, *start.warnings))
    log_choice(
        "filter", f"{start.settings.filter}: {len(start.gnss)} epochs, noise {start.gnss_why}"
    )
    log_choice("start", start.how)
    log_choice("GNSS latency", _latency_why(start))
    return start


def _timed(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, first: FilterStart
) -> FilterStart:
    """A start with the receiver's latency and noise."""
    here = to_align_as(config, first.grade)

    def begin(latency: float, arm_b: np.ndarray | None) -> FilterStart:
        timed = replace(first.settings, gnss_latency=latency)
        if arm_b is not None:
            x, y, z = arm_b.tolist()
            timed = replace(timed, lever_arm_b=(x, y, z))
        initial, time_ns, how, notes = find_start(
            source, here, timed, StartFixes.of(first.used, timed.gnss)
        )
        start = replace(
            first,
            settings=timed,
            start=initial,
            time_ns=time_ns,
            how=how,
            attitude_warnings=notes,
        )
        start = start_in_longest(source, config, start)
        return _with_noise(source, config, algorithm, start)

    noisy = _with_noise(source, config, algorithm, first)
    if noisy.noisier != first.noisier:
        # The start is one at fixes, and may use their speed
        first = noisy
        noisy = begin(first.settings.gnss_latency, None)
    return with_offsets(source, config, algorithm, noisy, begin)


def _fitted(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> FilterStart:
    """A start with a worse grade of the Imu, where innovations refute the one that a rest shows.

    White noise at rest says little of biases and scale factors, and vibration is not there.
    """
    shown = fit(source, config, algorithm, _by_the_fixes(start))
    while shown is not None and shown.doubted:
        worse = next_worse(start.grade.grade)
        if worse is None:
            break
        why = (
            f"as for a {start.grade.grade} one innovations squared are {shown.square:.2g} times"
            " what was expected"
        )
        try:
            first = first_start(source, config, ImuGrade(worse, why))
        except AlignmentError:
            break
        other = _timed(source, config, algorithm, first)
        fits = fit(source, config, algorithm, _by_the_fixes(other))
        if fits is None or not shown.worse_than(fits):
            break
        log_choice("IMU grade", f"{worse}, {why}")
        start, shown = other, fits
    return start


def _drifting(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> FilterStart:
    """A start with Imu noise that explains the drift where fixes are left out."""
    if config.in_flight.arw is not None or config.in_flight.vrw is not None:
        return start
    drift = Drift(source, config, algorithm, _by_the_fixes(start))
    worse = next_worse(start.grade.grade)
    if drift.ratio > OTHER_GRADE and worse is not None:
        # Noise at rest says nothing of biases and scale factors
        why = f"as a {start.grade.grade} one drifts {drift.ratio:.2g} times too much without fixes"
        try:
            other = _timed(
                source, config, algorithm, first_start(source, config, ImuGrade(worse, why))
            )
        except AlignmentError:
            other = start
        less = Drift(source, config, algorithm, _by_the_fixes(other))
        if less.ratio < drift.ratio:
            start, drift = other, less
    factors = drift.factors()
    better = _better(config, drift, factors, start.grade.grade)
    if better is not None:
        try:
            why, before = "by its drift without fixes", start.grade.grade
            judged = ImuGrade(better, why, by_drift=True, aligned_as=before)
            first = first_start(source, config, judged)
            start = _timed(source, config, algorithm, first)
            drift = Drift(source, config, algorithm, _by_the_fixes(start))
            factors = drift.factors()
            log_choice("IMU grade", f"{better}, {judged.why}")
        except AlignmentError:
            pass
    if factors.ordinary:
        return start
    log_choice("IMU noise", f"{factors} that of the grade, judged by its drift without fixes")
    judged_by = "" if start.grade.by_drift else ", judged by its drift without fixes"
    why = f"{start.grade.why}; {factors} as noisy{judged_by}"
    used = drift.used(factors)
    return replace(
        start,
        settings=replace(start.settings, imu=used.imu, control=used.control),
        grade=replace(start.grade, why=why),
    )


def _better(
    config: ProcessConfig, drift: Drift, factors: NoiseFactors, grade: Grade
) -> Grade | None:
    """A better grade that explains a drift clearly better than quieter sensors of this one do.

    An idling engine makes good sensors look poor at rest, and without a rest they are taken for
    poor. Quiet sensors of a poor grade have its scale factors, angles and biases all the same.
    """
    if factors.gyro >= QUIETER or config.navigation.imu_noise is not None:
        return None
    order: tuple[Grade, ...] = get_args(Grade)  # from the worst on
    scales = _has_scales(config)
    gains = {
        other: drift.gain(factors, imu_noise(config, other, scales))
        for other in order[order.index(grade) + 1 :]
    }
    best = max(gains, key=lambda other: gains[other], default=None)
    return best if best is not None and gains[best] > LEAST_GAIN else None


def _by_the_fixes(start: FilterStart) -> FilterStart:
    """A start with estimated lever arm and latency, lest wrong options be blamed on the Imu."""
    shown, settings = start.offsets, start.settings
    if shown is None:
        return start
    if shown.arm_contradicts:
        x, y, z = shown.arm_b.tolist()
        settings = replace(settings, lever_arm_b=(x, y, z))
    if shown.latency_contradicts(settings.gnss_latency):
        settings = replace(settings, gnss_latency=shown.latency_s)
    return replace(start, settings=settings)


def _with_noise(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> FilterStart:
    """A start with the white share of the fixes' noise, configured or estimated."""
    gnss, share = source.aiding.gnss, config.filter.gnss_lasting
    if share is not None:
        return with_lasting_share(start, share)
    shown = white_noise(source, config, algorithm, start)
    return (
        start if shown is None or gnss is None else with_measured_noise(start, gnss, config, shown)
    )


def _latency_why(start: FilterStart) -> str:
    """The latency that is used, and where it comes from."""
    velocity = f", velocities {start.lag:+.3f} s later than positions" if start.lag else ""
    used = f"{start.settings.gnss_latency:+.3f} s"
    if start.latency_status == "given":
        return f"{used}, as configured{velocity}"
    if start.offsets is None or not start.offsets.observable:
        return f"{used}; not observable in this log: the motion changes too little{velocity}"
    return f"{used}; found in the log: {start.offsets}{velocity}"


def _barometer(source: Source, config: ProcessConfig) -> tuple[HeightReference | None, list[str]]:
    """Barometer heights, where the log has a barometer and the filter takes one."""
    if config.filter.filter == "plain-15" or config.vertical.height_damping == "gnss":
        return None, []
    barometer = source.aiding.barometer
    notes = [str(finding) for finding in barometer.findings]
    if barometer.stream is None and barometer.problem is None:
        if config.vertical.height_damping == "baro":
            height_reference(source, config, 0.0)  # says what is missing
        return None, notes
    vertical = config.vertical.model_copy(update={"height_damping": "baro"})
    damped = config.model_copy(update={"vertical": vertical})
    start = source.position[2] or 0.0
    reference, more = height_reference(source, damped, start)
    return reference, [*notes, *more]


def _settings(
    source: Source,
    config: ProcessConfig,
    judged: ImuGrade,
    model: GnssModel,
    reference: HeightReference | None,
) -> Settings:
    options, grade = config.filter, judged.grade
    damping = None
    if reference is not None and options.filter.startswith("network"):
        damping, _ = network(config, grade, source.latitude or 0.0)
    baro = _baro_model(config, grade, model, reference)
    return Settings(
        filter=options.filter,
        imu=_imu(source, config, judged),
        gnss=model,
        baro=baro,
        network=damping,
        grade=grade,
        feedback=options.feedback,
        control=DivergenceControl(
            virtual_noise=options.virtual_noise == "on"
            or (
                options.virtual_noise == "auto"
                and grade == "mems"
                and config.navigation.imu_noise is None
            ),
            adaptive=options.adaptive,
            schmidt_epsilon=options.schmidt_epsilon,
            restart_after=options.restart_after,
        ),
        lever_arm_b=config.gnss.lever_arm,
    )


def _has_scales(config: ProcessConfig) -> bool:
    """Whether the filter has states for the scale factors of the accelerometers."""
    return filter_kind(config.filter.filter).first(ACCEL_SCALE) >= 0


def _imu(source: Source, config: ProcessConfig, grade: ImuGrade) -> SensorGrade:
    """Errors of the sensors: of a grade that a rest shows, no less than the noise there.

    Noise tells a navigation grade from others, but leaves its biases open, and scale factors are
    then no better than those of the grade below.
    """
    noise, walks = imu_noise(config, grade.grade, _has_scales(config)), random_walks(source)
    options, file = config.in_flight, config.navigation.imu_noise
    if grade.by_drift:
        # Which says little of the biases at the start
        below = imu_noise(config, next_worse(grade.grade) or grade.grade, _has_scales(config))
        return replace(noise, gyro_bias=below.gyro_bias, accel_bias=below.accel_bias)
    if config.navigation.imu_grade != "auto" or walks is None:
        return noise
    if options.vrw is None:
        noise = replace(noise, velocity_random_walk=max(noise.velocity_random_walk, walks[1]))
    if grade.grade == "navigation" and file is None:
        if options.arw is None:
            noise = replace(noise, angle_random_walk=max(noise.angle_random_walk, walks[0]))
        judged, below = IMU_GRADES[grade.grade], IMU_GRADES["tactical"]
        changes = {name: OPEN_BIAS * getattr(judged, name) for name in OPEN}
        changes |= {name: getattr(below, name) for name in ("gyro_scale", "accel_scale")}
        # What options say stays
        same = {name for name in changes if getattr(noise, name) == getattr(judged, name)}
        noise = replace(noise, **{name: changes[name] for name in same})
    return noise


def _stated(config: ProcessConfig) -> bool:
    """Whether options say how good the Imu is."""
    options = config.navigation
    return (
        options.imu_grade != "auto"
        or options.imu_noise is not None
        or config.in_flight.arw is not None
        or config.in_flight.vrw is not None
    )


def _too_good(source: Source, config: ProcessConfig, settings: Settings) -> list[str]:
    """Warning of a gyro whose configured noise is far below its noise at rest."""
    shown, assumed = random_walk(source), settings.imu.angle_random_walk
    if not _stated(config) or shown is None or shown < NOISIER * assumed:
        return []
    size = 60.0 / DEGREE
    return [
        f"the gyro's noise at rest is {size * shown:.2g} deg/sqrt(h), but the filter was set to"
        f" {size * assumed:.2g} (--imu-grade, --imu-noise, --arw): its sigmas will be too"
        " small; leave that option out"
    ]


def _baro_model(
    config: ProcessConfig, grade: Grade, gnss: GnssModel, reference: HeightReference | None
) -> BaroModel:
    """Errors of the barometric heights: of the air, and of what they were set by."""
    sigma = AIR_SIGMA if config.filter.baro_sigma is None else config.filter.baro_sigma
    if reference is not None and reference.baro is not None and reference.baro.mode == "gnss":
        # The fixes of half a minute, whose slow error is one and the same
        sigma = float(np.hypot(sigma, gnss.position_markov[2]))
    white = BARO_GRADES[grade].white
    if reference is not None and reference.sigma > 0.0:
        white = reference.sigma
    return BaroModel(sigma, AIR_TIME_S, white)


def _withheld(time_ns: np.ndarray, config: ProcessConfig, first_ns: int) -> np.ndarray:
    """Messages that the user withholds from the filter, to score it."""
    seconds = (time_ns - first_ns) / SECOND
    mask = np.zeros(len(time_ns), np.bool_)
    for text in config.filter.withhold_gnss:
        begin, end = span(text)
        mask |= (seconds >= begin) & (seconds < end)
    return mask
