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
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.ins_gnss.fix_velocity import (
    message_times,
    split_position_velocity,
    velocity_noise_bound,
)
from sinstool.methods.ins_gnss.settings import (
    Settings,
    Start,
)
from sinstool.methods.sensor_errors import Grade
from sinstool.pipelines.align.in_motion import imu_noise
from sinstool.pipelines.process.ins_gnss.between_gaps import start_in_longest
from sinstool.pipelines.process.ins_gnss.filter_settings import (
    as_in_motion,
    barometer,
    filter_settings,
    has_scales,
    imu_stated,
    receiver_stated,
    too_good,
)
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.first_state import StartFixes, find_start
from sinstool.pipelines.process.ins_gnss.imu_drift import Drift, NoiseFactors, shown_increments
from sinstool.pipelines.process.ins_gnss.imu_fit import fit, next_worse
from sinstool.pipelines.process.ins_gnss.likeliest_attitude import with_likeliest
from sinstool.pipelines.process.ins_gnss.receiver import (
    gnss_model,
    inflate_sigmas,
    times_as_noisy,
    velocities_noisier,
    with_lasting_share,
    with_measured_noise,
    with_white_velocity,
)
from sinstool.pipelines.process.ins_gnss.slow_errors import with_slow_errors
from sinstool.pipelines.process.ins_gnss.timing import (
    attitudes_apart,
    significant_lag,
    white_noise,
    with_offsets,
)
from sinstool.survey.grade import (
    ImuGrade,
    sensor_grade,
    to_align_as,
)
from sinstool.survey.noise_in_motion import walks_in_motion
from sinstool.survey.source import Source

# A grade that drifts so many times as much as its own sigmas say is none of the Imu's.
OTHER_GRADE = 2.0
# A better grade is tried where gyros are so many times as noisy as theirs, and taken where it is
# likelier by this: twice the log, e^5 to 1.
QUIETER, LEAST_GAIN = 0.7, 10.0
# Latencies with which a start is tried one after the other, s.
FIRST_LATENCIES = (0.0, 0.15, -0.15)


def first_start(
    source: Source,
    config: ProcessConfig,
    grade: ImuGrade | None = None,
    lag: float | None = None,
) -> FilterStart:
    """Settings, start and measurements of a filter run, with the configured latency or zero.

    Parameters
    ----------
    grade : ImuGrade, optional
        Instead of the one that the log shows at rest.
    lag : float, optional
        By which velocities are taken to be stamped later than positions, s, where that has been
        found out already.

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
    reference, remarks = barometer(source, config)
    settings = filter_settings(source, config, grade, model, reference)
    if lag is None:
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
        (*too_good(source, config, settings), *remarks),
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
        # A poor Imu follows fixes wherever they go, until it is known to be a better one
        start = _wandering(source, config, algorithm, start)
    if imu_stated(config):
        drift = Drift(source, config, algorithm, _by_the_fixes(start))
        start = replace(start, drifts=drift.ratio)
    start = with_likeliest(source, config, algorithm, start, _by_the_fixes(start))
    start = replace(
        start,
        turned=_turned(source, config, algorithm, start),
        unexplained=_unexplained(source, config, algorithm, start),
    )
    source.samples.made.clear()
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
    if max(start.noisier_velocity) > 1.0:
        warning = (
            f"velocities are {times_as_noisy(start.noisier_velocity)} as noisy as the receiver"
            " says, by how they change, and are weighted accordingly; --gnss-noise-scale overrides"
            " this"
        )
        start = replace(start, warnings=(warning, *start.warnings))
    if max(start.slow_errors) > 1.0:
        north, _, down = start.settings.gnss.position_markov
        warning = (
            f"fixes wander by {north:.2g} m (vertically {down:.2g} m; 1 sigma) within minutes, more"
            " than the receiver says, by how the navigation of the IMU differs from them, and are"
            " weighted accordingly; --gnss-lasting overrides this"
        )
        start = replace(start, warnings=(warning, *start.warnings))
    log_choice(
        "filter", f"{start.settings.filter}: {len(start.gnss)} epochs, noise {start.gnss_why}"
    )
    log_choice("start", start.how)
    log_choice("GNSS latency", _latency_why(start))
    return start


def _turned(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> tuple[float, float]:
    """How far a latency that was given or a lever arm, if the log contradicts it, turns attitude.

    In sigmas and in rad. A start from fixes of a wrong time or place may be anywhere, whatever its
    sigmas.
    """
    shown, given = start.offsets, start.latency_status == "given"
    if shown is None:
        return 0.0, 0.0
    late = given and shown.latency_contradicts(start.settings.gnss_latency)
    if not (late or shown.arm_contradicts):
        return 0.0, 0.0
    settings = _by_the_fixes(start).settings
    gnss = {"gnss_latency": settings.gnss_latency, "lever_arm": settings.lever_arm_b}
    timed = config.model_copy(update={"gnss": config.gnss.model_copy(update=gnss)})
    try:
        other = first_start(source, timed, start.grade, start.lag)
    except AlignmentError:
        return 0.0, 0.0
    return attitudes_apart(source, config, algorithm, (start, other))


def _unexplained(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> float:
    """Noise of velocities beside the Imu over the most that the receiver's own positions allow.

    Where that is much, and neither a latency nor a lever arm explains it, the attitude does not fit
    or the fixes are of another time.
    """
    gnss = source.aiding.gnss
    most = np.nan if gnss is None else velocity_noise_bound(gnss)
    if not start.velocity_noise[0] > most:
        return 0.0
    shown = white_noise(source, config, algorithm, _by_the_fixes(start))
    return 0.0 if shown is None else float(np.nan_to_num(shown.velocity[0] / most))


def _timed(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, first: FilterStart
) -> FilterStart:
    """A start with the receiver's latency and noise."""
    here, gnss = to_align_as(config, first.grade), source.aiding.gnss

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
        start = with_likeliest(source, config, algorithm, start, start)
        return _with_noise(source, config, algorithm, start)

    first = with_likeliest(source, config, algorithm, first, first)
    noisy = _with_noise(source, config, algorithm, first)
    if noisy.noisier != first.noisier:
        # The start is one at fixes, and may use their speed
        first = noisy
        noisy = begin(first.settings.gnss_latency, None)
    timed = with_offsets(source, config, algorithm, noisy, begin)
    # Velocities at a wrong time look noisy, and noisy ones hardly show the time
    shown = white_noise(source, config, algorithm, timed)
    if shown is not None and gnss is not None:
        quieter, timed = timed, with_white_velocity(timed, gnss, config, shown.velocity)
        if velocities_noisier(quieter, timed):
            first = timed
            noisy = begin(first.settings.gnss_latency, None)
            timed = with_offsets(source, config, algorithm, noisy, begin)
    return _wandering(source, config, algorithm, timed)


def _wandering(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> FilterStart:
    """A start with slow errors of fixes as large as they are beside its Imu.

    What options say of either stays: a wrong word about one would be blamed on the other.
    """
    if imu_stated(config) or receiver_stated(config):
        return start
    by_fixes = _by_the_fixes(start)
    increments = shown_increments(source, config, algorithm, by_fixes)
    return with_slow_errors(start, by_fixes, increments)


def _fitted(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> FilterStart:
    """A start with a worse grade of the Imu, where innovations refute the one that a rest shows.

    White noise at rest says little of biases and scale factors, and vibration is not there.
    """
    shown = fit(source, config, algorithm, _by_the_fixes(start))
    # Slow errors of fixes make up for those of an Imu, too: whichever is likelier
    while shown is not None and (shown.doubted or max(start.slow_errors) > 1.0):
        worse = next_worse(start.grade.grade)
        if worse is None:
            break
        why = f"innovations are clearly likelier than as a {start.grade.grade} one"
        if shown.doubted:
            why = (
                f"as for a {start.grade.grade} one innovations squared are {shown.square:.2g} times"
                " what was expected"
            )
        try:
            first = first_start(source, config, ImuGrade(worse, why), start.lag)
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
    start, drift = _as_quiet_as_in_motion(source, config, algorithm, start)
    worse = next_worse(start.grade.grade)
    if drift.ratio > OTHER_GRADE and worse is not None:
        # Noise at rest says nothing of biases and scale factors
        why = f"as a {start.grade.grade} one drifts {drift.ratio:.2g} times too much without fixes"
        try:
            first = first_start(source, config, ImuGrade(worse, why), start.lag)
            other = _timed(source, config, algorithm, first)
        except AlignmentError:
            other = start
        other, less = _as_quiet_as_in_motion(source, config, algorithm, other)
        if less.ratio < drift.ratio:
            start, drift = other, less
    factors = drift.factors()
    better = _better(source, config, drift, factors, start.grade.grade)
    if better is not None:
        try:
            why, before = "by its drift without fixes", start.grade.grade
            judged = ImuGrade(better, why, by_drift=True, aligned_as=before)
            first = first_start(source, config, judged, start.lag)
            start = _timed(source, config, algorithm, first)
            start, drift = _as_quiet_as_in_motion(source, config, algorithm, start)
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


def _as_quiet_as_in_motion(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> tuple[FilterStart, Drift]:
    """A start whose sensors are no noisier than motion shows, and its drift, which says what is.

    Where a log shows too little of that the start stays as it is. Slow errors of fixes have been
    judged before, as sensors that are taken for too quiet put the blame on them.
    """
    moving, imu = walks_in_motion(source), start.settings.imu
    stated = start.grade.grade == "mems" or config.navigation.imu_noise is not None
    if moving is not None and not stated:
        quiet = replace(
            imu,
            angle_random_walk=min(imu.angle_random_walk, moving[0]),
            velocity_random_walk=min(imu.velocity_random_walk, moving[1]),
        )
        quieter = replace(start, settings=replace(start.settings, imu=quiet))
        drift = Drift(source, config, algorithm, _by_the_fixes(quieter))
        if drift.tells:
            return quieter, drift
    return start, Drift(source, config, algorithm, _by_the_fixes(start))


def _better(
    source: Source, config: ProcessConfig, drift: Drift, factors: NoiseFactors, grade: Grade
) -> Grade | None:
    """A better grade that explains a drift clearly better than quieter sensors of this one do.

    An idling engine makes good sensors look poor at rest, and without a rest they are taken for
    poor. Quiet sensors of a poor grade have its scale factors, angles and biases all the same.
    """
    if factors.gyro >= QUIETER or config.navigation.imu_noise is not None:
        return None
    order: tuple[Grade, ...] = get_args(Grade)  # from the worst on
    scales = has_scales(config)
    others = order[order.index(grade) + 1 :]
    sensors = {o: as_in_motion(source, imu_noise(config, o, scales)) for o in others}
    gains = drift.gains(factors, sensors)
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
    if shown is None or gnss is None or not np.isfinite(shown.position[0]):
        return start
    return with_measured_noise(start, gnss, config, shown.position)


def _latency_why(start: FilterStart) -> str:
    """The latency that is used, and where it comes from."""
    velocity = f", velocities {start.lag:+.3f} s later than positions" if start.lag else ""
    used = f"{start.settings.gnss_latency:+.3f} s"
    if start.latency_status == "given":
        return f"{used}, as configured{velocity}"
    if start.offsets is None or not start.offsets.observable:
        return f"{used}; not observable in this log: the motion changes too little{velocity}"
    return f"{used}; found in the log: {start.offsets}{velocity}"


def _withheld(time_ns: np.ndarray, config: ProcessConfig, first_ns: int) -> np.ndarray:
    """Messages that the user withholds from the filter, to score it."""
    seconds = (time_ns - first_ns) / SECOND
    mask = np.zeros(len(time_ns), np.bool_)
    for text in config.filter.withhold_gnss:
        begin, end = span(text)
        mask |= (seconds >= begin) & (seconds < end)
    return mask
