"""Start of an INS/GNSS filter, with latency, noise and grade estimated by runs of the filter."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.choices import log_choice
from sinstool.core.errors import AlignmentError
from sinstool.core.units import STANDARD_GRAVITY
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.sensor_errors import LOW_COST, SensorGrade, as_if_aligned, next_worse
from sinstool.pipelines.align.in_motion import imu_noise
from sinstool.pipelines.process.ins_gnss.between_gaps import before_short_gaps, start_in_longest
from sinstool.pipelines.process.ins_gnss.contradictions import compare_with_log
from sinstool.pipelines.process.ins_gnss.filter_settings import (
    has_scales,
    noise_stated,
    receiver_stated,
)
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.first_start import as_graded, first_start, regraded
from sinstool.pipelines.process.ins_gnss.imu_drift import (
    Drift,
    shaking,
    shown_increments,
)
from sinstool.pipelines.process.ins_gnss.imu_fit import fit
from sinstool.pipelines.process.ins_gnss.initial_state import StartFixes, find_start
from sinstool.pipelines.process.ins_gnss.lasting_velocity import with_lasting_velocity
from sinstool.pipelines.process.ins_gnss.likelier_grade import (
    GradeFits,
    better_grade,
    likelier_calibration,
)
from sinstool.pipelines.process.ins_gnss.likeliest_attitude import with_likeliest
from sinstool.pipelines.process.ins_gnss.receiver import (
    times_as_noisy,
    velocities_noisier,
    with_lasting_share,
    with_measured_noise,
    with_white_velocity,
)
from sinstool.pipelines.process.ins_gnss.slow_errors import (
    as_stated,
    with_expected_slow_errors,
    with_slow_errors,
)
from sinstool.pipelines.process.ins_gnss.timing import with_offsets
from sinstool.pipelines.process.ins_gnss.white_noise import white_noise
from sinstool.survey.grade import ImuGrade, to_align_as
from sinstool.survey.noise_in_motion import walks_in_motion
from sinstool.survey.source import Source

# If the navigation drifts this many times as far as its sigmas, the IMU is of a worse grade.
OTHER_GRADE = 2.0
# If its noise by the drift is this share of what was assumed, the antenna is searched for anew.
MUCH_QUIETER = 0.5


def timed_start(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    first: FilterStart,
    start: FilterStart | None = None,
) -> FilterStart:
    """A start with latency, noise and grade estimated by runs of the filter, unless configured.

    These are the receiver's latency, the white share of its noise, and a grade of the IMU that
    innovations and drift do not contradict.

    Parameters
    ----------
    first : FilterStart
        By :func:`first_start`.
    start : FilterStart, optional
        By :func:`timed` from `first`, if it is known.
    """
    start = start or timed(source, config, algorithm, first)
    if config.navigation.imu_grade == "auto":
        first, start = with_fitting_grade(source, config, algorithm, first, start)
        start = drifting(source, config, algorithm, first, start)
        # With a poor IMU the slow errors of fixes do not show, and drift with one that is too good
        # looks like them: once more with the sensors that the drift shows
        start = _wandering(source, config, algorithm, as_stated(start))
    start = with_likeliest(source, config, algorithm, start, start.by_the_fixes)
    # Contradictions are judged without allowing for what does not show
    start = with_expected_slow_errors(compare_with_log(source, config, algorithm, start))
    start = with_lasting_velocity(source, config, algorithm, start)
    source.samples.made.clear()
    start = replace(start, warnings=(*_warnings(start), *start.warnings))
    log_choice(
        "filter", f"{start.settings.filter}: {len(start.gnss)} epochs, noise {start.gnss_why}"
    )
    log_choice("start", start.how)
    log_choice("GNSS latency", _latency_why(start))
    return start


def _warnings(start: FilterStart) -> list[str]:
    """Warnings about noise and latency that the log contradicts, and what is used instead."""
    warnings = []
    if max(start.slow_errors) > 1.0:
        north, _, down = start.settings.gnss.position_markov
        warnings.append(
            f"compared with the IMU, fixes wander by {north:.2g} m (vertically {down:.2g} m;"
            " 1 sigma) within minutes, more than the receiver states; they are weighted accordingly"
            " (--gnss-lasting overrides this)"
        )
    model = start.settings.gnss
    if start.slow_velocity[0] > 1.0 and model.velocity_markov[0] > model.velocity_white[0]:
        warnings.append(
            "compared with the IMU and the positions, velocities of the receiver are off by"
            f" {model.velocity_markov[0]:.2g} m/s (1 sigma) for a minute at a time, more than the"
            " receiver states; they are weighted accordingly (--gnss-noise-scale overrides this)"
        )
    if max(start.noisier_velocity) > 1.0:
        warnings.append(
            "from epoch to epoch, velocities scatter"
            f" {times_as_noisy(start.noisier_velocity)} as much as the receiver states; they are"
            " weighted accordingly (--gnss-noise-scale overrides this)"
        )
    if max(start.noisier) > 1.0:
        warnings.append(
            f"from epoch to epoch, fixes scatter {times_as_noisy(start.noisier)} as much as the"
            " receiver states; they are weighted accordingly (--gnss-noise-scale overrides this)"
        )
    if start.latency_status == "not settled":
        warnings.append(
            "the estimate of the GNSS latency did not converge:"
            f" {1e3 * start.settings.gnss_latency:.0f} ms is used, but an estimate about it gives"
            f" {start.offsets}: give the latency with --gnss-latency"
        )
    return warnings


def earliest_start(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm
) -> FilterStart:
    """A first start, carried back over gaps that precede it.

    Raises
    ------
    AlignmentError
        The log shows none.
    """
    return before_short_gaps(source, config, algorithm, first_start(source, config))


def timed(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, first: FilterStart
) -> FilterStart:
    """A start with the receiver's latency and noise.

    Parameters
    ----------
    first : FilterStart
        By :func:`first_start`.
    """
    here, gnss = to_align_as(config, first.grade), source.aiding.gnss

    def begin(latency: float, arm_b: np.ndarray | None) -> FilterStart:
        x, y, z = np.asarray(config.gnss.lever_arm or np.zeros(3) if arm_b is None else arm_b)
        arm = float(x), float(y), float(z)
        timed = replace(first.settings, gnss_latency=latency, lever_arm_b=arm)
        fixes = StartFixes.of(first.used, timed.gnss)
        aligned = first.alignment if first.placed else None
        found = find_start(source, here, timed, fixes, aligned, near=first.alignment)
        start = start_in_longest(source, config, replace(first.at(found), settings=timed))
        return likelier(start)[1]

    def likelier(start: FilterStart) -> tuple[FilterStart, FilterStart]:
        """The start with its likeliest attitude, without and with the noise of the fixes.

        Attitudes are compared with that noise: with less, chance decides between them.
        """
        noisy = with_noise(source, config, algorithm, start)
        best = with_likeliest(source, config, algorithm, start, noisy)
        return best, noisy if best is start else with_noise(source, config, algorithm, best)

    first, noisy = likelier(first)
    if noisy.noisier != first.noisier:
        # The start is one at fixes, and may use their speed
        first = noisy
        noisy = begin(first.settings.gnss_latency, None)
    timed = with_offsets(source, config, algorithm, noisy, begin)
    # Velocities at a wrong time look noisy; with the right noise, the latency is estimated again
    shown = white_noise(source, config, algorithm, timed)
    if shown is not None and gnss is not None:
        quieter, timed = timed, with_white_velocity(timed, gnss, config, shown.velocity)
        if velocities_noisier(quieter, timed):
            first = timed
            noisy = begin(first.settings.gnss_latency, None)
            timed = with_offsets(source, config, algorithm, noisy, begin)
    return _wandering(source, config, algorithm, without_trial(timed))


def without_trial(start: FilterStart) -> FilterStart:
    """A start with the likeliest latency, if that of the fixes it was found at was a mere trial.

    The log does not show the latency then, and the one tried may be far beyond its prior.
    """
    shown = start.offsets
    if shown is None or start.latency_status != "not observable":
        return start
    tried = start.settings.gnss_latency
    return start if tried == 0.0 else start.with_latency(shown.latency_s)


def _wandering(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> FilterStart:
    """A start with slow errors of fixes as large as innovations show them.

    Not if options give the noise of the fixes, or that of the IMU in figures: a wrong value for one
    would be attributed to the other. So would what a grade lacks that an option gives: the slow
    errors are those that are likeliest with it or with a worse one.
    """
    if receiver_stated(config) or noise_stated(config):
        return start
    increments = shown_increments(source, config, algorithm, start)
    shaken = shaking(source, config, algorithm, start)

    def wandering(start: FilterStart) -> FilterStart:
        return with_slow_errors(start, start.by_the_fixes, increments, shaken)

    found = wandering(start)
    if config.navigation.imu_grade == "auto" or max(found.slow_errors) <= 1.0:
        return found
    shown = fit(source, config, algorithm, found.by_the_fixes)
    grade, stated = next_worse(start.grade.grade), start.settings.imu
    while grade is not None and shown is not None:
        imu = imu_noise(config, grade, has_scales(config))
        other = wandering(replace(start, settings=replace(start.settings, imu=imu)))
        fits = fit(source, config, algorithm, other.by_the_fixes)
        if fits is not None and shown.worse_than(fits):
            found, shown = other, fits
        grade = next_worse(grade)
    return replace(found, settings=replace(found.settings, imu=stated))


def with_fitting_grade(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    first: FilterStart,
    start: FilterStart,
) -> tuple[FilterStart, FilterStart]:
    """A start with a worse grade of the IMU, if innovations refute the grade by its noise at rest.

    White noise at rest says little about biases and scale factors, and does not include vibration.

    Returns
    -------
    first, start : FilterStart
        Both with that grade.
    """
    shown, grade = fit(source, config, algorithm, start.by_the_fixes), next_worse(start.grade.grade)
    # Errors of the IMU may have been taken for slow errors of fixes: the likelier ones are kept
    while (
        grade is not None and shown is not None and (shown.doubted or max(start.slow_errors) > 1.0)
    ):
        why = f"fits the innovations clearly better than {start.grade.grade}"
        if shown.doubted:
            why = (
                f"with {start.grade.grade} squared innovations are {shown.square:.2g} times as"
                " large as expected"
            )
        with suppress(AlignmentError):
            begun = begun_as(source, config, first, ImuGrade(grade, why), start.lag)
            other = timed(source, config, algorithm, begun)
            fits = fit(source, config, algorithm, other.by_the_fixes)
            if fits is not None and shown.worse_than(fits):
                log_choice("IMU grade", f"{grade}, {why}")
                first, start, shown = begun, other, fits
            # A filter that diverges is about as unlikely with slightly worse sensors: go on then
            elif fits is None or not fits.doubted:
                break
        grade = next_worse(grade)
    return first, start


def drifting(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    first: FilterStart,
    start: FilterStart,
) -> FilterStart:
    """A start with the grade and noise of the IMU that explain the drift without fixes.

    Parameters
    ----------
    first : FilterStart
        The first start, from which `start` was made.
    """
    if config.in_flight.arw is not None or config.in_flight.vrw is not None:
        return start
    start, drift = _as_quiet_as_in_motion(source, config, algorithm, start)
    worse = next_worse(start.grade.grade)
    if drift.ratio > OTHER_GRADE and worse is not None:
        # Noise at rest says nothing about biases and scale factors
        why = f"drifts {drift.ratio:.2g} times as far without fixes as {start.grade.grade} allows"
        try:
            begun = begun_as(source, config, first, ImuGrade(worse, why), start.lag)
            other = timed(source, config, algorithm, begun)
        except AlignmentError:
            begun, other = first, start
        other, less = _as_quiet_as_in_motion(source, config, algorithm, other)
        if less.ratio < drift.ratio:
            first, start, drift = begun, other, less
    fits = GradeFits(source, config, algorithm, start, drift.factors())
    first, start, drift, fits = _calibrated(source, config, algorithm, first, drift, fits)
    factors = fits.factors
    better = better_grade(fits, drift)
    if better is not None:
        try:
            why, before = "by its drift without fixes", start.grade.grade
            judged = ImuGrade(better, why, by_drift=True, aligned_as=before)
            begun = regraded(source, config, first, judged)
            same = as_graded(source, config, start, judged)
            start = _timed_unless(source, config, algorithm, begun, same)
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
    start = replace(
        start,
        settings=replace(start.settings, imu=used.imu, control=used.control),
        grade=replace(start.grade, why=why),
        noisier_gyros=factors.gyro if start.grade.grade in LOW_COST else 1.0,
    )
    if min(factors.gyro, factors.accel) > MUCH_QUIETER or not start.arm_matters:
        return start
    # A quieter filter shows more of the antenna's place, and is turned further by a wrong one
    settings = replace(
        first.settings, imu=used.imu, control=used.control, grade=start.settings.grade
    )
    begun = replace(first, settings=settings, grade=start.grade, noisier_gyros=start.noisier_gyros)
    with suppress(AlignmentError):
        return _timed_unless(source, config, algorithm, begun, start)
    return start


def _as_quiet_as_in_motion(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> tuple[FilterStart, Drift]:
    """A start whose sensors are no noisier than in motion, and its drift without fixes.

    If the log shows too little drift, the start stays as it is: nothing would then enlarge noise
    that is too small. Slow errors of fixes are estimated before this, as with too little noise of
    the sensors they would come out too large.
    """
    moving, imu = walks_in_motion(source), start.settings.imu
    stated = start.grade.grade in LOW_COST or config.navigation.imu_noise is not None
    if moving is not None and not stated:
        quiet = replace(
            imu,
            angle_random_walk=min(imu.angle_random_walk, moving[0]),
            velocity_random_walk=min(imu.velocity_random_walk, moving[1]),
        )
        quieter = replace(start, settings=replace(start.settings, imu=quiet))
        drift = Drift(source, config, algorithm, quieter.by_the_fixes)
        if drift.conclusive:
            return quieter, drift
    return start, Drift(source, config, algorithm, start.by_the_fixes)


def _calibrated(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    first: FilterStart,
    drift: Drift,
    fits: GradeFits,
) -> tuple[FilterStart, FilterStart, Drift, GradeFits]:
    """A start with an IMU that is calibrated as well as innovations show.

    Parameters
    ----------
    first : FilterStart
        The first start, from which the judged start was made.
    drift, fits : Drift, GradeFits
        Of the judged start.
    """
    start, judged = fits.start, likelier_calibration(fits)
    if judged is None or replace(judged, why="") == ImuGrade(start.grade.grade, ""):
        return first, start, drift, fits
    log_choice("IMU grade", f"{judged.grade}, {judged.why}")
    first, other = as_judged(source, config, algorithm, first, start, judged)
    other, drift = _as_quiet_as_in_motion(source, config, algorithm, other)
    return first, other, drift, GradeFits(source, config, algorithm, other, drift.factors())


def as_judged(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    first: FilterStart,
    start: FilterStart,
    judged: ImuGrade,
) -> tuple[FilterStart, FilterStart]:
    """A first start and a start with the grade that innovations show.

    The IMU is aligned anew with that grade, unless the grade is unchanged, the attitude is then too
    uncertain for a start, or the fixes are clearly likelier with the attitude, latency and arm of
    before: latency and arm belong to the receiver, whatever the IMU.
    """
    before = start.grade.grade
    kept = replace(judged, why=f"{start.grade.why}; {judged.why}", aligned_as=before)
    other = as_graded(source, config, start, kept)
    aligned = imu_noise(config, before, has_scales(config))
    same = replace(first, grade=kept), less_level(other, aligned, other.settings.imu)
    if judged.grade == before:
        return same
    with suppress(AlignmentError):
        begun = begun_as(source, config, first, judged, start.lag)
        anew = _timed_unless(source, config, algorithm, begun, same[1])
        return same if anew is same[1] else (begun, anew)
    return same


def _timed_unless(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    begun: FilterStart,
    same: FilterStart,
) -> FilterStart:
    """A start by :func:`timed`, unless the fixes are clearly likelier with the start `same`."""
    anew = timed(source, config, algorithm, begun)
    fits = [fit(source, config, algorithm, start.by_the_fixes) for start in (anew, same)]
    worse = fits[0] is not None and fits[1] is not None and fits[0].worse_than(fits[1])
    return same if worse else anew


def less_level(start: FilterStart, aligned: SensorGrade, imu: SensorGrade) -> FilterStart:
    """A start with the sigmas of tilt of its own accelerometers, if aligned with better ones."""
    felt = as_if_aligned(imu).accel_bias ** 2 - as_if_aligned(aligned).accel_bias ** 2
    tilt = max(felt, 0.0) / STANDARD_GRAVITY**2
    covariance = start.start.covariance_attitude_n + np.diag([tilt, tilt, 0.0])
    return replace(start, start=replace(start.start, covariance_attitude_n=covariance))


def begun_as(
    source: Source, config: ProcessConfig, first: FilterStart, grade: ImuGrade, lag: float
) -> FilterStart:
    """A first start with another grade of the IMU, aligned with that grade if possible.

    Not if it needs a larger latency: an alignment that is too uncertain at the right latency may
    pass with a wrong one.
    """
    if first.placed:
        return regraded(source, config, first, grade)
    with suppress(AlignmentError):
        begun = first_start(source, config, grade, lag)
        if abs(begun.settings.gnss_latency) <= abs(first.settings.gnss_latency):
            return begun
    return regraded(source, config, first, grade)


def with_noise(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> FilterStart:
    """A start with the white share of the fixes' noise, configured or estimated."""
    gnss, share = source.aiding.gnss, config.filter.gnss_lasting
    if share is not None:
        return with_lasting_share(start, share)
    shown = white_noise(source, config, algorithm, start)
    start = replace(start, white=shown)
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
