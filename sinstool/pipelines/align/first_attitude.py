"""The first attitude of a run, by the method that options and log allow."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.config.align import IN_FLIGHT
from sinstool.core.choices import log_choice
from sinstool.core.earth import EARTH_RATE
from sinstool.core.errors import AlignmentError
from sinstool.core.rotation import conjugate, log, multiply
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.io.readers.frames import turn_body
from sinstool.methods.alignment import initial
from sinstool.methods.alignment.initial import Alignment
from sinstool.methods.alignment.still import STEADY_TURN, StillSpan
from sinstool.methods.sensor_errors import IMU_GRADES, LOW_COST
from sinstool.pipelines.align.earth_rotation import (
    by_earth_rotation,
    compass,
    earth_rate,
    from_compass,
)
from sinstool.pipelines.align.first_in_motion import NO_BIAS, by_velocity, in_flight
from sinstool.survey.grade import sensor_grade
from sinstool.survey.rest import longest_rest
from sinstool.survey.source import Source

if TYPE_CHECKING:
    from sinstool.methods.alignment.gyrocompass import Gyrocompass

# The shortest rest for an automatic gyrocompass, s.
GYROCOMPASS_S = 30.0
# Two headings agree within this many sigmas.
AGREE_SIGMAS = 4.0
# A mean rate at rest beyond this, rad/s (45 deg/h), is a gyro bias, not the Earth's rate in an
# unknown direction.
PLAIN_BIAS = 3.0 * EARTH_RATE


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
        return by_earth_rotation(source, config)
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
    compassed = north_at_rest(source, config)
    at_rest = None if compassed is None else from_compass(compassed, source)
    moving = by_velocity(source, config, grade, gnss)
    if at_rest is None or moving is None:
        return at_rest or moving
    return moving if _knows_better(moving, at_rest) else at_rest


def north_at_rest(source: Source, config: ProcessConfig) -> Gyrocompass | None:
    """North by the Earth's rotation, if the log begins with a rest that shows it."""
    grade, still = sensor_grade(source, config).grade, source.survey.lead_in
    if still is None or still.duration_s < GYROCOMPASS_S:
        return None
    if grade in LOW_COST or source.latitude is None:
        return None
    compassed = compass(source, config, grade)
    return compassed if compassed.status in ("ok", "degraded") else None


def _knows_better(one: Alignment, other: Alignment) -> bool:
    """Whether an alignment knows the heading better than another one that it agrees with."""
    sigma, other_sigma = one.sigma_rad[2], other.sigma_rad[2]
    if sigma is None or other_sigma is None or one.time_ns > other.time_ns:
        return False
    if sigma >= other_sigma:
        return False
    turn = log(multiply(one.q_nb, conjugate(other.q_nb)))
    return bool(abs(turn[2]) < AGREE_SIGMAS * np.hypot(sigma, other_sigma))


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


def seconds_from_start(time_ns: int, source: Source) -> float:
    """Time since the first sample, s."""
    return (time_ns - source.survey.first_ns) / SECOND
