"""Start of an INS/GNSS filter, with latency, noise and grade as runs of the filter show them."""

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
from sinstool.pipelines.process.ins_gnss.between_gaps import start_in_longest
from sinstool.pipelines.process.ins_gnss.contradictions import compare_with_log
from sinstool.pipelines.process.ins_gnss.filter_settings import (
    has_scales,
    imu_stated,
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
from sinstool.pipelines.process.ins_gnss.likelier_grade import (
    GradeFits,
    better_grade,
    likelier_low_cost,
)
from sinstool.pipelines.process.ins_gnss.likeliest_attitude import with_likeliest
from sinstool.pipelines.process.ins_gnss.receiver import (
    times_as_noisy,
    velocities_noisier,
    with_lasting_share,
    with_measured_noise,
    with_white_velocity,
)
from sinstool.pipelines.process.ins_gnss.slow_errors import with_slow_errors
from sinstool.pipelines.process.ins_gnss.timing import white_noise, with_offsets
from sinstool.survey.grade import ImuGrade, to_align_as
from sinstool.survey.noise_in_motion import walks_in_motion
from sinstool.survey.source import Source

# A grade that drifts so many times as much as its own sigmas say is none of the Imu's.
OTHER_GRADE = 2.0


def timed_start(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    first: FilterStart,
    start: FilterStart | None = None,
) -> FilterStart:
    """A start with latency, noise and grade estimated by runs of the filter, unless configured.

    That is the receiver's latency, the share of its noise that is white, and a grade of the Imu
    that innovations do not refute.

    Parameters
    ----------
    first : FilterStart
        Of :func:`first_start`.
    start : FilterStart, optional
        What :func:`timed` makes of it, where that is known.
    """
    start = start or timed(source, config, algorithm, first)
    if config.navigation.imu_grade == "auto":
        first, start = _fitted(source, config, algorithm, first, start)
        start = _drifting(source, config, algorithm, first, start)
        # A poor Imu follows fixes wherever they go, until it is known to be a better one
        start = _wandering(source, config, algorithm, start)
    start = with_likeliest(source, config, algorithm, start, start.by_the_fixes)
    start = compare_with_log(source, config, algorithm, start)
    source.samples.made.clear()
    start = replace(start, warnings=(*_warnings(start), *start.warnings))
    log_choice(
        "filter", f"{start.settings.filter}: {len(start.gnss)} epochs, noise {start.gnss_why}"
    )
    log_choice("start", start.how)
    log_choice("GNSS latency", _latency_why(start))
    return start


def _warnings(start: FilterStart) -> list[str]:
    """About settings that the log denies, and what is used instead."""
    warnings = []
    if max(start.slow_errors) > 1.0:
        north, _, down = start.settings.gnss.position_markov
        warnings.append(
            f"compared with the IMU, fixes wander by {north:.2g} m (vertically {down:.2g} m;"
            " 1 sigma) within minutes, more than the receiver states; they are weighted accordingly"
            " (--gnss-lasting overrides this)"
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


def timed(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, first: FilterStart
) -> FilterStart:
    """A start with the receiver's latency and noise.

    Parameters
    ----------
    first : FilterStart
        Of :func:`first_start`.
    """
    here, gnss = to_align_as(config, first.grade), source.aiding.gnss

    def begin(latency: float, arm_b: np.ndarray | None) -> FilterStart:
        x, y, z = np.asarray(config.gnss.lever_arm or np.zeros(3) if arm_b is None else arm_b)
        arm = float(x), float(y), float(z)
        timed = replace(first.settings, gnss_latency=latency, lever_arm_b=arm)
        found = find_start(source, here, timed, StartFixes.of(first.used, timed.gnss))
        start = start_in_longest(source, config, replace(first.at(found), settings=timed))
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
    increments = shown_increments(source, config, algorithm, start)
    shaken = shaking(source, config, algorithm, start)
    return with_slow_errors(start, start.by_the_fixes, increments, shaken)


def _fitted(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    first: FilterStart,
    start: FilterStart,
) -> tuple[FilterStart, FilterStart]:
    """A start with a worse grade of the Imu, where innovations refute the one that a rest shows.

    And the first start with that grade. White noise at rest says little of biases and scale
    factors, and vibration is not there.
    """
    shown = fit(source, config, algorithm, start.by_the_fixes)
    # Slow errors of fixes make up for those of an Imu, too: whichever is likelier
    while shown is not None and (shown.doubted or max(start.slow_errors) > 1.0):
        worse = next_worse(start.grade.grade)
        if worse is None:
            break
        why = f"fits the innovations clearly better than {start.grade.grade}"
        if shown.doubted:
            why = (
                f"with {start.grade.grade} squared innovations are {shown.square:.2g} times as"
                " large as expected"
            )
        try:
            begun = _begun_as(source, config, first, ImuGrade(worse, why), start.lag)
        except AlignmentError:
            break
        other = timed(source, config, algorithm, begun)
        fits = fit(source, config, algorithm, other.by_the_fixes)
        if fits is None or not shown.worse_than(fits):
            break
        log_choice("IMU grade", f"{worse}, {why}")
        first, start, shown = begun, other, fits
    return first, start


def _drifting(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    first: FilterStart,
    start: FilterStart,
) -> FilterStart:
    """A start with Imu noise that explains the drift where fixes are left out.

    Parameters
    ----------
    first : FilterStart
        From which `start` was made.
    """
    if config.in_flight.arw is not None or config.in_flight.vrw is not None:
        return start
    start, drift = _as_quiet_as_in_motion(source, config, algorithm, start)
    worse = next_worse(start.grade.grade)
    if drift.ratio > OTHER_GRADE and worse is not None:
        # Noise at rest says nothing of biases and scale factors
        why = f"drifts {drift.ratio:.2g} times as far without fixes as {start.grade.grade} allows"
        try:
            begun = _begun_as(source, config, first, ImuGrade(worse, why), start.lag)
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
    stated = start.grade.grade in LOW_COST or config.navigation.imu_noise is not None
    if moving is not None and not stated:
        quiet = replace(
            imu,
            angle_random_walk=min(imu.angle_random_walk, moving[0]),
            velocity_random_walk=min(imu.velocity_random_walk, moving[1]),
        )
        quieter = replace(start, settings=replace(start.settings, imu=quiet))
        drift = Drift(source, config, algorithm, quieter.by_the_fixes)
        if drift.tells:
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
    """A start with a low-cost Imu that is calibrated or not, as innovations have it.

    Parameters
    ----------
    first : FilterStart
        From which the start that is judged was made.
    drift, fits : Drift, GradeFits
        Of that start.
    """
    start, judged = fits.start, likelier_low_cost(fits)
    if judged is None or (judged.grade == start.grade.grade and judged.uncalibrated is None):
        return first, start, drift, fits
    log_choice("IMU grade", f"{judged.grade}, {judged.why}")
    first, other = _as_judged(source, config, algorithm, first, start, judged)
    other, drift = _as_quiet_as_in_motion(source, config, algorithm, other)
    return first, other, drift, GradeFits(source, config, algorithm, other, drift.factors())


def _as_judged(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    first: FilterStart,
    start: FilterStart,
    judged: ImuGrade,
) -> tuple[FilterStart, FilterStart]:
    """A first start and a start with an Imu that innovations have judged.

    It is aligned as such a one, unless it was, that is too uncertain for a start, or the fixes are
    clearly likelier with the attitude, the latency and the arm found before: what a receiver does
    is none of the Imu's.
    """
    before = start.grade.grade
    kept = replace(judged, why=f"{start.grade.why}; {judged.why}", aligned_as=before)
    other = as_graded(source, config, start, kept)
    aligned = imu_noise(config, before, has_scales(config))
    same = replace(first, grade=kept), _less_level(other, aligned, other.settings.imu)
    if judged.grade == before:
        return same
    with suppress(AlignmentError):
        begun = _begun_as(source, config, first, judged, start.lag)
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
    """A first start timed anew, unless the fixes are clearly likelier with the `same` as before."""
    anew = timed(source, config, algorithm, begun)
    fits = [fit(source, config, algorithm, start.by_the_fixes) for start in (anew, same)]
    worse = fits[0] is not None and fits[1] is not None and fits[0].worse_than(fits[1])
    return same if worse else anew


def _less_level(start: FilterStart, aligned: SensorGrade, imu: SensorGrade) -> FilterStart:
    """A start that was aligned with better accelerometers than its own, with their sigmas."""
    felt = as_if_aligned(imu).accel_bias ** 2 - as_if_aligned(aligned).accel_bias ** 2
    tilt = max(felt, 0.0) / STANDARD_GRAVITY**2
    covariance = start.start.covariance_attitude_n + np.diag([tilt, tilt, 0.0])
    return replace(start, start=replace(start.start, covariance_attitude_n=covariance))


def _begun_as(
    source: Source, config: ProcessConfig, first: FilterStart, grade: ImuGrade, lag: float
) -> FilterStart:
    """A first start with an Imu of another grade, which is aligned as such a one if that works.

    An alignment that is a little too uncertain may pass with a latency that is wrong.
    """
    with suppress(AlignmentError):
        begun = first_start(source, config, grade, lag)
        if abs(begun.settings.gnss_latency) <= abs(first.settings.gnss_latency):
            return begun
    return regraded(source, config, first, grade)


def _with_noise(
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
