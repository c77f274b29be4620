"""The first attitude of a run, by whatever means its options and its log allow."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.config.align import IN_FLIGHT
from sinstool.core.choices import log_choice
from sinstool.core.earth import earth_rate_n
from sinstool.core.errors import AlignmentError
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.io.readers.frames import turn_body
from sinstool.methods.alignment import initial
from sinstool.methods.alignment.initial import Alignment
from sinstool.methods.alignment.level import tilted
from sinstool.methods.height.network import Grade
from sinstool.survey.grade import sensor_grade
from sinstool.survey.source import Source

# Alignment in motion and gyrocompassing are imported where they are used: most logs need neither,
# and they take as long to import as an hour of attitude.
if TYPE_CHECKING:
    from sinstool.methods.alignment.gyrocompass import Gyrocompass
    from sinstool.methods.alignment.inflight_types import ImuIncrements
    from sinstool.pipelines.align.in_motion import Moving

# An automatic gyrocompass wants a rest that can show north.
GYROCOMPASS_S = 30.0


def align(source: Source, config: ProcessConfig) -> Alignment:
    """First attitude and gyro bias.

    Parameters
    ----------
    source : Source
        With all of GNSS for alignment in motion.

    Raises
    ------
    AlignmentError
        What was asked for cannot be had from this log.
    """
    alignment = _aligned(source, config)
    log_choice("gyro bias", _BIAS_FROM.get(alignment.bias_source, alignment.bias_source))
    return alignment


_BIAS_FROM = {
    "still": "the mean rate of the rest at the beginning, less the Earth's where that is known",
    "rest": "the mean rate of the longest rest",
    "alignment": "what the alignment found",
    "given": "as configured",
    "none": "none known, none removed",
}


def _aligned(source: Source, config: ProcessConfig) -> Alignment:
    options, found = config.align, source.survey
    path = source.path
    if options.align in IN_FLIGHT:
        return in_flight(source, config, options.align)
    if options.align == "gyrocompass":
        return at_rest(source, config)
    if options.align == "auto":
        seen = _north_seen(source, config)
        if seen is not None:
            return seen
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


def _north_seen(source: Source, config: ProcessConfig) -> Alignment | None:
    """An attitude whose heading counts from north, where the log shows one by itself."""
    grade, _ = sensor_grade(source, config)
    gnss, still = source.aiding.gnss, source.survey.lead_in
    if (
        still is not None
        and grade != "mems"
        and still.duration_s >= GYROCOMPASS_S
        and source.latitude is not None
    ):
        found = compass(source, config, grade)
        if found.status in ("ok", "degraded"):
            return _from_compass(found, source)
    if gnss is None or not gnss.has_velocity.any() or not gnss.has_position.any():
        return None
    try:
        from sinstool.pipelines.align.in_motion import align_moving

        moving = align_moving(source, config, grade, "svd", "start")
    except AlignmentError as exc:
        log_choice("alignment", f"not by GNSS velocity: {exc.message}")
        return None
    if moving.answer.status not in ("ok", "degraded"):
        log_choice("alignment", f"not by GNSS velocity, which is {moving.answer.status}")
        return None
    return _from_motion(moving, source, config)


def in_flight(source: Source, config: ProcessConfig, method: str) -> Alignment:
    """Attitude from GNSS velocity, carried back to the log's start.

    Raises
    ------
    AlignmentError
        It cannot be had: with the reasons.
    """
    grade, _ = sensor_grade(source, config)
    from sinstool.pipelines.align.in_motion import align_moving

    moving = align_moving(source, config, grade, method, "start")
    answer = moving.answer
    if answer.status in ("failed", "unobservable"):
        reasons = "; ".join(answer.warnings) or "no reason is known"
        raise AlignmentError(
            f"{source.path}: --align {method}: {answer.status}: {reasons}",
            "choose another span with --align-start and --align-end, or another --align",
        )
    return _from_motion(moving, source, config)


def _from_motion(moving: Moving, source: Source, config: ProcessConfig) -> Alignment:
    answer = moving.answer
    time_ns, q_nb, covariance = _carried_back(moving, source, config)
    bias, source_of_bias = moving.gyro_bias, "rest" if moving.gyro_bias.any() else "none"
    if answer.errors is not None and config.align.gyro_bias == "still":
        bias, source_of_bias = bias + answer.errors.gyro_bias, "alignment"
    if not isinstance(config.align.gyro_bias, str):
        source_of_bias = "given"
    known = answer.status != "level-only"
    sigma = np.sqrt(np.diag(covariance))
    return Alignment(
        q_nb,
        answer.method,
        time_ns,
        (float(sigma[0]), float(sigma[1]), float(sigma[2]) if known else None),
        answer.status,
        known,
        gyro_bias=bias,
        bias_source=source_of_bias,
        warnings=answer.warnings,
        covariance_n=covariance,
        held_ns=answer.t_ns,
    )


def _carried_back(
    moving: Moving, source: Source, config: ProcessConfig
) -> tuple[int, np.ndarray, np.ndarray]:
    """Attitude and covariance at the first sample, or as near to it as the Imu was without a gap.

    A vehicle that rests at first keeps its attitude; in motion gyros carry it back, with what
    their biases may do.
    """
    answer, survey = moving.answer, source.survey
    still = survey.lead_in
    begin = survey.first_ns if still is None else still.end_ns
    if answer.t_ns <= begin:
        return survey.first_ns, answer.q_nb, answer.cov
    from sinstool.methods.alignment.chain import carried
    from sinstool.pipelines.align.in_motion import gnss_fixes, increments

    imu = increments(source, config, moving.gyro_bias + _found_bias(moving), answer.t_ns)
    imu = _from(imu, begin)
    if not len(imu.time_ns) or (np.diff(imu.time_ns) > survey.max_gap_ns).any():
        return answer.t_ns, answer.q_nb, answer.cov
    fixes, _ = gnss_fixes(source, config.gnss.gnss_latency or 0.0)
    q_nb, per_bias, per_scale = carried(imu, fixes, answer.t_ns, answer.q_nb)
    seconds = float(imu.time_ns[-1] - imu.time_ns[0]) / SECOND
    errors = moving.settings.grade
    bias, scale = errors.gyro_bias, errors.gyro_scale
    if answer.errors is not None:
        bias = float(np.max(answer.errors.sigma["gyro_bias"]))
        scale = float(np.max(answer.errors.sigma["gyro_scale"]))
    covariance = answer.cov + errors.angle_random_walk**2 * seconds * np.eye(3)
    for gain, sigma in ((per_bias, bias), (per_scale, scale)):
        covariance = covariance + sigma**2 * gain @ gain.T
    if still is not None:
        q_nb, covariance = tilted(q_nb, covariance, still.accel, errors.accel_bias)
    return survey.first_ns, q_nb, covariance


def _from(imu: ImuIncrements, begin_ns: int) -> ImuIncrements:
    later = imu.time_ns >= begin_ns
    return replace(
        imu,
        time_ns=imu.time_ns[later],
        delta_theta=imu.delta_theta[later],
        delta_velocity=imu.delta_velocity[later],
    )


def _found_bias(moving: Moving) -> np.ndarray:
    errors = moving.answer.errors
    return np.zeros(3) if errors is None else errors.gyro_bias


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
            f"{path}: --align gyrocompass: the log does not begin still",
            "choose a still beginning with --start, or use --align svd where there is GNSS",
        )
    grade, _ = sensor_grade(source, config)
    found = compass(source, config, grade)
    if found.status == "unobservable":
        raise AlignmentError(
            f"{path}: --align gyrocompass: {'; '.join(found.warnings)}",
            "record for longer at rest, or use another --align",
        )
    return _from_compass(found, source)


def compass(source: Source, config: ProcessConfig, grade: Grade) -> Gyrocompass:
    """Gyrocompass over the still lead-in."""
    still, latitude = source.survey.lead_in, source.latitude
    assert still is not None and latitude is not None
    from sinstool.methods.alignment.gyrocompass import GyrocompassSettings, gyrocompass
    from sinstool.pipelines.align.in_motion import increments, sensor_errors

    imu = increments(source, config, np.zeros(3), still.end_ns)
    settings = GyrocompassSettings(grade=sensor_errors(config, grade, False))
    try:
        return gyrocompass(imu, latitude, source.position[2] or 0.0, settings)
    except AlignmentError as exc:
        raise AlignmentError(f"{source.path}: {exc.message}", exc.hint) from exc


def _from_compass(found: Gyrocompass, source: Source) -> Alignment:
    """The body kept its attitude while it was at rest: that at the end is that at the start."""
    still = source.survey.lead_in
    assert still is not None
    known = found.status != "level-only"
    sigma = found.sigma_rad
    return Alignment(
        found.q_nb,
        "gyrocompass",
        source.survey.first_ns,
        (float(sigma[0]), float(sigma[1]), float(sigma[2]) if known else None),
        found.status,
        known,
        gyro_bias=initial.still_bias(still, found.q_nb, earth_rate(source)),
        bias_source="still",
        warnings=found.warnings,
        covariance_n=found.cov,
        held_ns=found.t_ns,
    )


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
    bias = initial.still_bias(still, alignment.q_nb, earth_rate(source))
    return replace(alignment, gyro_bias=bias, bias_source="still")


def earth_rate(source: Source) -> np.ndarray | None:
    """Earth rate in NED, rad/s; None where the latitude is not known."""
    if source.latitude is None:
        return None
    return np.asarray(earth_rate_n(source.latitude))


def seconds_from_start(time_ns: int, source: Source) -> float:
    """Time since the first sample, s."""
    return (time_ns - source.survey.first_ns) / SECOND
