"""The first attitude of a run, by the method that options and log allow."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.config.align import IN_FLIGHT
from sinstool.core.arrays import IntArray
from sinstool.core.choices import log_choice
from sinstool.core.earth import EARTH_RATE, earth_rate_n
from sinstool.core.errors import AlignmentError
from sinstool.core.rotation import conjugate, exp, log, multiply
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.io.readers.frames import turn_body
from sinstool.methods.alignment import initial
from sinstool.methods.alignment.initial import Alignment, tilted
from sinstool.methods.alignment.still import STEADY_TURN, StillSpan
from sinstool.methods.sensor_errors import IMU_GRADES, LOW_COST, Grade
from sinstool.survey.grade import sensor_grade
from sinstool.survey.receiver_ahead import RECEIVER_CLOCK
from sinstool.survey.rest import longest_rest
from sinstool.survey.source import Source, rate_blocks

# Alignment in motion and gyrocompassing are imported where they are used: most logs need neither,
# and they take as long to import as an hour of attitude.
if TYPE_CHECKING:
    from sinstool.methods.alignment.gyrocompass import Gyrocompass
    from sinstool.methods.alignment.in_motion import MotionAlignment

# The shortest rest for an automatic gyrocompass, s.
GYROCOMPASS_S = 30.0
# Two headings agree within this many sigmas.
AGREE_SIGMAS = 4.0
# A filter is linear in its errors: with a larger sigma of the attitude it starts later.
FILTER_SIGMA = 10.0 * DEGREE
# A filter that starts within this time of a fix, s, starts at it.
AT_FIX_S = 0.03
# A mean rate at rest beyond this, rad/s (45 deg/h), is a gyro bias, not the Earth's rate in an
# unknown direction.
PLAIN_BIAS = 3.0 * EARTH_RATE
NO_BIAS = f"{initial.NOT_STILL}, so no gyro bias is removed"


def align(source: Source, config: ProcessConfig, gnss: GnssEpochs | None = None) -> Alignment:
    """First attitude and gyro bias.

    Parameters
    ----------
    source : Source
        With all of GNSS for alignment in motion.
    gnss : GnssEpochs, optional
        Instead of those of the log, where the method is ``auto``.

    Raises
    ------
    AlignmentError
        What was asked for cannot be had from this log.
    """
    alignment = _aligned(source, config, gnss or source.aiding.gnss)
    log_choice("gyro bias", _BIAS_FROM.get(alignment.bias_source, alignment.bias_source))
    return alignment


_BIAS_FROM = {
    "still": "the mean rate of the rest at the beginning, less the Earth's where that is known",
    "rest": "the mean rate of the longest rest",
    "alignment": "what the alignment found",
    "given": "as configured",
    "none": "none known, none removed",
}


def _aligned(source: Source, config: ProcessConfig, gnss: GnssEpochs | None) -> Alignment:
    options, survey = config.align, source.survey
    path = source.path
    if options.align in IN_FLIGHT:
        return in_flight(source, config, options.align)
    if options.align == "gyrocompass":
        return at_rest(source, config)
    if options.align == "auto":
        seen = _north_seen(source, config, gnss)
        if seen is not None:
            return seen
    if options.align == "fixed":
        assert options.initial_attitude is not None
        roll, pitch, heading = (v * DEGREE for v in options.initial_attitude)
        alignment = initial.from_angles((roll, pitch, heading), survey.first_ns)
    elif options.align == "log":
        if survey.orientation is None:
            raise AlignmentError(
                f"{path}: topic {survey.topic} holds no orientation",
                "use --align level or --align fixed",
            )
        if survey.orientation_fault is not None:
            raise AlignmentError(
                f"{path}: --align log: the orientation in topic {survey.topic}"
                f" {survey.orientation_fault.text}",
                "leave --align out, or give the attitude with --align fixed",
            )
        alignment = initial.from_log(survey.orientation, survey.orientation_ns)
    elif survey.lead_in is not None:
        bias = _accel_bias(source, config)
        alignment = initial.from_still(survey.lead_in, survey.first_ns, bias)
    elif options.align == "level":
        raise AlignmentError(
            f"{path}: the log does not begin at rest, so its tilt cannot be levelled",
            "choose a beginning at rest with --start, or use --align log, fixed or auto",
        )
    elif survey.oriented:
        assert survey.orientation is not None
        alignment = initial.from_log(survey.orientation, survey.orientation_ns)
    else:
        alignment = initial.from_motion(survey.windows, survey.first_ns)
    return _with_bias(alignment, source, config)


def rest_held(source: Source, alignment: Alignment) -> StillSpan | None:
    """The rest at the log's beginning through which an attitude stays the same.

    An attitude found in motion is carried back to its end, and is that of its beginning, too.
    """
    still = source.survey.lead_in
    in_motion = alignment.method in IN_FLIGHT
    if still is None or not (alignment.bias_source == "still" or in_motion):
        return None
    return still if alignment.time_ns < still.end_ns else None


def _accel_bias(source: Source, config: ProcessConfig) -> float:
    """Sigma of the bias of an accelerometer, as stated or of the IMU's grade, m/s^2."""
    if config.in_flight.sigma_ba is not None:
        return config.in_flight.sigma_ba
    noise = IMU_GRADES[sensor_grade(source, config).grade]
    return float(np.hypot(noise.accel_bias, noise.accel_instability))


def _north_seen(source: Source, config: ProcessConfig, gnss: GnssEpochs | None) -> Alignment | None:
    """An attitude whose heading counts from north, if the log shows one.

    By the Earth's rotation at rest or by GNSS velocity in motion: that which knows the heading
    better, unless they contradict each other. If the log neither begins at rest nor has an
    orientation, the tilt by GNSS velocity will do.
    """
    grade = sensor_grade(source, config).grade
    still, at_rest = source.survey.lead_in, None
    if (
        still is not None
        and grade not in LOW_COST
        and still.duration_s >= GYROCOMPASS_S
        and source.latitude is not None
    ):
        compassed = compass(source, config, grade)
        if compassed.status in ("ok", "degraded"):
            at_rest = _from_compass(compassed, source)
    moving = _by_velocity(source, config, grade, gnss)
    if at_rest is None or moving is None:
        return at_rest or moving
    return moving if _knows_better(moving, at_rest) else at_rest


def _knows_better(one: Alignment, other: Alignment) -> bool:
    """Whether an alignment knows the heading better than another one that it agrees with."""
    sigma, other_sigma = one.sigma_rad[2], other.sigma_rad[2]
    if sigma is None or other_sigma is None or one.time_ns > other.time_ns:
        return False
    if sigma >= other_sigma:
        return False
    turn = log(multiply(one.q_nb, conjugate(other.q_nb)))
    return bool(abs(turn[2]) < AGREE_SIGMAS * np.hypot(sigma, other_sigma))


def _by_velocity(
    source: Source, config: ProcessConfig, grade: Grade, gnss: GnssEpochs | None
) -> Alignment | None:
    """An attitude by GNSS velocity in motion, if the log shows one."""
    if gnss is None or not gnss.has_velocity.any() or not gnss.has_position.any():
        return None
    try:
        from sinstool.pipelines.align.in_motion import align_moving

        moving = align_moving(source, config, grade, "svd", "start", gnss)
    except AlignmentError as exc:
        log_choice("alignment", f"not by GNSS velocity: {exc.message}")
        return None
    survey = source.survey
    level = survey.lead_in is not None or survey.oriented
    if not moving.good and (moving.result.status != "level-only" or level):
        log_choice("alignment", f"not by GNSS velocity, which is {moving.result.status}")
        return None
    return _from_motion(moving, source, config)


def in_flight(
    source: Source,
    config: ProcessConfig,
    method: str,
    gnss: GnssEpochs | None = None,
    time_ns: int | None = None,
    later_ns: IntArray | None = None,
    near: Alignment | None = None,
) -> Alignment:
    """Attitude from GNSS velocity, carried back.

    Parameters
    ----------
    gnss : GnssEpochs, optional
        Instead of those of the log.
    time_ns : int, optional
    later_ns : ndarray of int64, shape (n,), optional
        See :func:`_from_motion`.
    near : Alignment, optional
        With fixes that differ little, or are of a slightly different time.

    Raises
    ------
    AlignmentError
        It cannot be had: with the reasons.
    """
    grade = sensor_grade(source, config).grade
    from sinstool.methods.alignment.inflight_answer import INCONSISTENT_CHI2
    from sinstool.methods.alignment.inflight_types import REFUSE_SIGMA
    from sinstool.pipelines.align.in_motion import align_moving

    # A filter corrects the heading later, so for it a less certain one will do
    refused = REFUSE_SIGMA if time_ns is None else FILTER_SIGMA
    likely = near.gyro_bias if near is not None and near.bias_searched else None
    moving = align_moving(source, config, grade, method, "start", gnss, refused, likely_bias=likely)
    result = moving.result
    if result.status in ("failed", "unobservable"):
        reasons = "; ".join(result.warnings) or "no reason is known"
        answer = "choose another span with --align-start and --align-end, or another --align"
        misfit = max(result.chi2, result.errors.chi2 if result.errors is not None else 0.0)
        clock = next((f for f in source.findings if f.kind == RECEIVER_CLOCK), None)
        if clock is not None:
            answer = f"{clock.answer} ({clock.text}), or {answer}"
        raise AlignmentError(
            f"{source.path}: motion does not show the attitude (by {method}: {result.status}):"
            f" {reasons}",
            answer,
            uncertain=result.status == "unobservable",
            consistent=not misfit > INCONSISTENT_CHI2,
        )
    return _from_motion(moving, source, config, time_ns, later_ns)


def _from_motion(
    moving: MotionAlignment,
    source: Source,
    config: ProcessConfig,
    time_ns: int | None = None,
    later_ns: IntArray | None = None,
) -> Alignment:
    """An alignment in motion as a first attitude.

    Parameters
    ----------
    time_ns : int, optional
        Time to which it is carried back for a filter, unless there is a gap of the samples in
        between or the gyros are not good enough; by default the first sample, however far.
    later_ns : ndarray of int64, shape (n,), optional
        Times of fixes. If the attitude holds at none of them and the vehicle does not rest, it is
        carried on to the first of them: how an antenna swings between two fixes does not show.
    """
    result = moving.result
    begin_ns = source.survey.first_ns if time_ns is None else time_ns
    limit = np.inf if time_ns is None else FILTER_SIGMA
    reached = _carried_back(moving, source, config, begin_ns, limit)
    still = source.survey.lead_in
    rests = still is not None and reached[0] <= still.end_ns
    if later_ns is not None and not rests:
        far = (np.abs(later_ns - reached[0]) > AT_FIX_S * SECOND).all()
        after = later_ns[(later_ns >= result.t_ns) & (later_ns <= result.t_stop_ns)]
        if far and len(after):
            reached = _carried_back(moving, source, config, int(after[0]), limit)
    time_ns, q_nb, covariance = reached
    time_ns, q_nb = _at_sample(source, config, time_ns, q_nb, moving.refined_bias)
    bias, source_of_bias = moving.gyro_bias, "rest" if moving.gyro_bias.any() else "none"
    bias_sigma = None
    if config.align.gyro_bias == "still" and result.errors is not None:
        bias, source_of_bias = moving.refined_bias, "alignment"
        shown = float(np.max(result.errors.sigma["gyro_bias"]))
        bias_sigma = max(shown, moving.bias_assumed)
    elif moving.bias_by_motion:
        source_of_bias, bias_sigma = "alignment", moving.settings.grade.gyro_bias
    if not isinstance(config.align.gyro_bias, str):
        source_of_bias = "given"
    north = result.status != "level-only"
    sigma = np.sqrt(np.diag(covariance))
    return Alignment(
        q_nb,
        result.method,
        time_ns,
        (float(sigma[0]), float(sigma[1]), float(sigma[2]) if north else None),
        result.status,
        north,
        gyro_bias=bias,
        bias_source=source_of_bias,
        warnings=result.warnings,
        covariance_n=covariance,
        held_ns=result.t_ns,
        gyro_bias_sigma=bias_sigma,
        bias_searched=moving.bias_by_motion,
    )


def _at_sample(
    source: Source, config: ProcessConfig, time_ns: int, q_nb: np.ndarray, gyro_bias: np.ndarray
) -> tuple[int, np.ndarray]:
    """Time of the first sample from a time on, with which a run begins, and the attitude there."""
    for block in rate_blocks(source, config, time_ns):
        sample_ns = int(block.time_ns[0])
        if sample_ns - time_ns > source.survey.max_gap_ns:
            break
        turned = (block.gyro[0] - gyro_bias) * (sample_ns - time_ns) / SECOND
        return sample_ns, multiply(q_nb, exp(turned))
    return time_ns, q_nb


def _carried_back(
    moving: MotionAlignment, source: Source, config: ProcessConfig, time_ns: int, most_sigma: float
) -> tuple[int, np.ndarray, np.ndarray]:
    """Attitude and covariance at a time, or at the original time if that cannot be reached.

    It cannot if the IMU has a gap in between, or if the sigma, rad, would exceed the limit.

    A vehicle that rests at the beginning keeps its attitude through the rest; through motion the
    gyros carry it back, and the sigma grows by their biases.
    """
    result, still = moving.result, source.survey.lead_in
    resting = still is not None and time_ns <= still.end_ns
    begin = still.end_ns if still is not None and resting else time_ns
    if result.t_ns <= begin:
        if resting or result.t_ns == time_ns:
            return time_ns, result.q_nb, result.cov
        return time_ns, result.attitude_at(np.array([time_ns]))[0], result.cov
    from sinstool.pipelines.align.in_motion import increments

    imu = increments(source, config, moving.refined_bias, result.t_ns, begin)
    if not len(imu) or (np.diff(imu.time_ns) > source.survey.max_gap_ns).any():
        return result.t_ns, result.q_nb, result.cov
    q_nb, covariance = moving.carried_back(imu)
    if np.sqrt(np.diag(covariance).max()) > most_sigma:
        return result.t_ns, result.q_nb, result.cov
    if still is not None and resting:
        q_nb, covariance = tilted(q_nb, covariance, still.accel, moving.settings.grade.accel_bias)
    return time_ns, q_nb, covariance


def at_rest(source: Source, config: ProcessConfig) -> Alignment:
    """Attitude from the Earth's rotation.

    Raises
    ------
    AlignmentError
        The log does not begin still, its latitude is not known, or not even tilt shows.
    """
    path = source.path
    if source.latitude is None:
        raise AlignmentError(
            f"{path}: --align gyrocompass needs the latitude, and the log has no fix",
            "give --latitude",
        )
    if source.survey.lead_in is None:
        raise AlignmentError(
            f"{path}: --align gyrocompass: the log does not begin at rest",
            "choose a beginning at rest with --start, or use --align svd where there is GNSS",
        )
    grade = sensor_grade(source, config).grade
    compassed = compass(source, config, grade)
    if compassed.status == "unobservable":
        raise AlignmentError(
            f"{path}: --align gyrocompass: {'; '.join(compassed.warnings)}",
            "record for longer at rest, or use another --align",
            uncertain=True,
        )
    return _from_compass(compassed, source)


def compass(source: Source, config: ProcessConfig, grade: Grade) -> Gyrocompass:
    """Gyrocompass over the still lead-in."""
    still, latitude = source.survey.lead_in, source.latitude
    assert still is not None and latitude is not None
    from sinstool.methods.alignment.gyrocompass import gyrocompass
    from sinstool.methods.alignment.span_reader import MOST_SAMPLES
    from sinstool.pipelines.align.in_motion import increments, sensor_errors

    imu = increments(source, config, np.zeros(3), still.end_ns, most=MOST_SAMPLES)
    errors = sensor_errors(config, grade, False)
    try:
        return gyrocompass(imu, latitude, source.position[2] or 0.0, errors)
    except AlignmentError as exc:
        raise AlignmentError(f"{source.path}: {exc.message}", exc.hint) from exc


def _from_compass(answer: Gyrocompass, source: Source) -> Alignment:
    """Attitude at the start of a rest: the same as at its end, as the body did not move."""
    still = source.survey.lead_in
    assert still is not None
    north = answer.status != "level-only"
    sigma = answer.sigma_rad
    return Alignment(
        answer.q_nb,
        "gyrocompass",
        source.survey.first_ns,
        (float(sigma[0]), float(sigma[1]), float(sigma[2]) if north else None),
        answer.status,
        north,
        gyro_bias=initial.still_bias(still, answer.q_nb, earth_rate(source)),
        bias_source="still",
        warnings=answer.warnings,
        covariance_n=answer.cov,
        held_ns=answer.t_ns,
    )


def _with_bias(alignment: Alignment, source: Source, config: ProcessConfig) -> Alignment:
    option = config.align.gyro_bias
    if option == "none":
        return alignment
    if not isinstance(option, str):
        bias = turn_body(np.array(option), config.input.body_axes)
        return replace(alignment, gyro_bias=bias, bias_source="given")
    still = source.survey.lead_in
    if still is not None:
        bias = initial.still_bias(still, alignment.q_nb, earth_rate(source))
        alignment = replace(alignment, gyro_bias=bias, bias_source="still")
        size = float(np.linalg.norm(bias))
        if size > STEADY_TURN:
            note = (
                f"the mean rate of the first {still.duration_s:.1f} s, {size / DEGREE:.1f} deg/s,"
                " is removed as the gyro's bias, although it is large for a bias: if the sensor"
                " turned at this rate, add --gyro-bias none, or choose a beginning at rest with"
                " --start"
            )
            alignment = replace(alignment, warnings=(*alignment.warnings, note))
        return alignment
    rest = longest_rest(source.survey.spans, source.aiding.gnss)
    note = NO_BIAS
    if rest is not None:
        # Without a heading the horizontal part of the Earth's rate has no known direction
        down = earth_rate(source)
        down = None if down is None else down * [0.0, 0.0, 1.0]
        bias = initial.still_bias(rest, initial.level(rest.accel), down)
        if np.linalg.norm(bias) > PLAIN_BIAS:
            at = seconds_from_start(rest.start_ns, source)
            note = (
                f"{initial.NOT_STILL}: the gyro bias is the mean rate of its longest rest,"
                f" {rest.duration_s:.1f} s from {at:.1f} s on"
            )
            alignment = replace(alignment, gyro_bias=bias, bias_source="rest")
    return replace(alignment, warnings=(*alignment.warnings, note))


def with_bias_in_motion(
    alignment: Alignment, source: Source, config: ProcessConfig, gnss: GnssEpochs
) -> Alignment:
    """A given attitude with a gyro bias from changes of GNSS velocity.

    Unchanged if these show none.
    """
    grade = sensor_grade(source, config).grade
    from sinstool.pipelines.align.in_motion import align_moving

    try:
        moving = align_moving(source, config, grade, "svd", "start", gnss)
    except AlignmentError:
        return alignment
    if not moving.good or moving.result.errors is None:
        return alignment
    return replace(
        alignment,
        gyro_bias=moving.refined_bias,
        gyro_bias_sigma=float(np.max(moving.result.errors.sigma["gyro_bias"])),
        bias_source="alignment",
        warnings=tuple(text for text in alignment.warnings if text != NO_BIAS),
    )


def earth_rate(source: Source) -> np.ndarray | None:
    """Earth rate in NED, rad/s; None without a latitude."""
    if source.latitude is None:
        return None
    return np.asarray(earth_rate_n(source.latitude))


def seconds_from_start(time_ns: int, source: Source) -> float:
    """Time since the first sample, s."""
    return (time_ns - source.survey.first_ns) / SECOND
