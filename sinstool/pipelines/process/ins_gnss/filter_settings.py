"""Settings of an INS/GNSS filter: sensors, barometer and options, before any run of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.units import DEGREE
from sinstool.methods.height.reference import HeightReference
from sinstool.methods.ins_gnss.settings import (
    BARO_GRADES,
    BaroModel,
    DivergenceControl,
    GnssModel,
    Settings,
)
from sinstool.methods.ins_gnss.states import ACCEL_SCALE, filter_kind
from sinstool.methods.sensor_errors import (
    IMU_GRADES,
    LOW_COST,
    Grade,
    SensorGrade,
    misaligned,
    next_worse,
    partly_calibrated,
)
from sinstool.pipelines.align.in_motion import imu_noise
from sinstool.pipelines.process.height import height_reference, network
from sinstool.survey.grade import NOISIER, ImuGrade, gyro_walk_shown, random_walks
from sinstool.survey.motion_in_gaps import motion_in_gaps
from sinstool.survey.noise_in_motion import walks_in_motion
from sinstool.survey.source import Source

# Times the biases of a navigation grade that one judged by its noise may have: data sheets of such
# noise lie a factor of ten and more apart.
OPEN_BIAS = 3.0
OPEN_BY_DRIFT = ("gyro_bias", "accel_bias", "gyro_misalignment", "accel_misalignment")
OPEN = ("gyro_bias", "gyro_instability", "accel_bias", "accel_instability")
# Slow error of a barometer, m, and its correlation time: weather, temperature, a cabin.
AIR_SIGMA, AIR_TIME_S = 10.0, 500.0


def filter_settings(
    source: Source,
    config: ProcessConfig,
    judged: ImuGrade,
    model: GnssModel,
    reference: HeightReference | None,
) -> Settings:
    """Settings of a filter for a log, as options and the judged grade of the IMU have them."""
    options, grade = config.filter, judged.grade
    damping = None
    if reference is not None and options.filter.startswith("network"):
        damping, _ = network(config, grade, source.latitude or 0.0)
    baro = _baro_model(config, grade, model, reference)
    settings = Settings(
        filter=options.filter,
        imu=imu_noise_of(source, config, judged),
        gnss=model,
        baro=baro,
        network=damping,
        grade=grade,
        feedback=options.feedback,
        control=DivergenceControl(
            virtual_noise=options.virtual_noise == "on"
            or (
                options.virtual_noise == "auto"
                and grade in LOW_COST
                and config.navigation.imu_noise is None
            ),
            adaptive=options.adaptive,
            schmidt_epsilon=options.schmidt_epsilon,
            restart_after=options.restart_after,
        ),
        lever_arm_b=config.gnss.lever_arm or (0.0, 0.0, 0.0),
    )
    moved = motion_in_gaps(source.survey, settings.max_gap)
    if moved is None:
        return settings
    return replace(
        settings,
        gap_acceleration=max(settings.gap_acceleration, moved.force),
        gap_tilt_rate=max(settings.gap_tilt_rate, moved.tilt),
        gap_rate=max(settings.gap_rate, moved.heading),
    )


def imu_noise_of(source: Source, config: ProcessConfig, grade: ImuGrade) -> SensorGrade:
    """Errors of the sensors: of a grade, with no less white noise than the log shows.

    That is what a rest shows, or motion, where that is less, but for a MEMS grade. Noise tells a
    navigation grade from others, but leaves its biases open, and scale factors are then no better
    than those of the grade below.
    """
    noise, walks = of_grade(config, grade), _walks_at_rest(source)
    options, file = config.in_flight, config.navigation.imu_noise
    if grade.by_drift:
        # Which says little of the biases at the start, and of how the axes lie in the case
        below = imu_noise(config, next_worse(grade.grade) or grade.grade, has_scales(config))
        noise = replace(noise, **{name: getattr(below, name) for name in OPEN_BY_DRIFT})
        return as_in_motion(source, noise)
    if config.navigation.imu_grade != "auto" or walks is None:
        return noise
    moving = None if grade.grade in LOW_COST or file is not None else walks_in_motion(source)
    if moving is not None:
        walks = min(walks[0], moving[0]), min(walks[1], moving[1])
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


def _walks_at_rest(source: Source) -> tuple[float, float] | None:
    """Random walks of angle and velocity at rest; the former without what stays within an angle."""
    walks, shown = random_walks(source), gyro_walk_shown(source)
    return None if walks is None or shown is None else (shown, walks[1])


def of_grade(config: ProcessConfig, grade: ImuGrade) -> SensorGrade:
    """Errors of a grade, with the axes and the calibration that innovations show."""
    if grade.uncalibrated is None:
        return misaligned(imu_noise(config, grade.grade, has_scales(config)), grade.misaligned)
    bare, calibrated = (imu_noise(config, one, has_scales(config)) for one in LOW_COST)
    return partly_calibrated(calibrated, bare, grade.uncalibrated)


def as_in_motion(source: Source, noise: SensorGrade) -> SensorGrade:
    """Errors of a grade with the white noise that the log shows in motion, if it does.

    That of accelerometers is no less than the grade's, as it stands in for cross-axis errors.
    """
    moving = walks_in_motion(source)
    if moving is None:
        return noise
    accel = max(noise.velocity_random_walk, moving[1])
    return replace(noise, angle_random_walk=moving[0], velocity_random_walk=accel)


def as_noisy_as(imu: SensorGrade, other: SensorGrade) -> SensorGrade:
    """Errors of sensors with the noise of others, white and slow."""
    names = (
        "angle_random_walk",
        "velocity_random_walk",
        "gyro_instability",
        "accel_instability",
        "bias_time_s",
    )
    share = min(1.0, other.scale_wander * other.accel_scale / imu.accel_scale)
    return replace(imu, scale_wander=share, **{name: getattr(other, name) for name in names})


def has_scales(config: ProcessConfig) -> bool:
    """Whether the filter has states for the scale factors of the accelerometers."""
    return filter_kind(config.filter.filter).first(ACCEL_SCALE) >= 0


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


def barometer(source: Source, config: ProcessConfig) -> tuple[HeightReference | None, list[str]]:
    """Barometer heights, where the log has a barometer and the filter takes one."""
    if config.filter.filter == "plain-15" or config.vertical.height_damping == "gnss":
        return None, []
    barometer = source.aiding.barometer
    notes = [str(finding) for finding in barometer.findings]
    if barometer.stream is None and barometer.problem is None:
        if config.vertical.height_damping == "baro":
            height_reference(source, config, 0.0)  # says what is missing
        return None, notes
    asked = config.vertical.height_damping == "baro" or config.input.baro_topic is not None
    if barometer.problem is not None and not asked:
        # A position without a barometer is better than none
        why = str(barometer.problem).removeprefix(f"{source.path}: ")
        return None, [*notes, f"no barometer is used: {why}"]
    vertical = config.vertical.model_copy(update={"height_damping": "baro"})
    damped = config.model_copy(update={"vertical": vertical})
    start = source.position[2] or 0.0
    reference, more = height_reference(source, damped, start)
    return reference, [*notes, *more]


def imu_stated(config: ProcessConfig) -> bool:
    """Whether options say how good the IMU is."""
    return config.navigation.imu_grade != "auto" or noise_stated(config)


def noise_stated(config: ProcessConfig) -> bool:
    """Whether options give the noise of the IMU in figures."""
    walks = (config.in_flight.arw, config.in_flight.vrw)
    return config.navigation.imu_noise is not None or any(walk is not None for walk in walks)


def receiver_stated(config: ProcessConfig) -> bool:
    """Whether options say how noisy the fixes are."""
    options = config.filter
    return (
        options.gnss_lasting is not None
        or options.gnss_sigma is not None
        or options.gnss_noise_scale != 1.0
    )


def too_good(source: Source, config: ProcessConfig, settings: Settings) -> list[str]:
    """Warnings of sensors whose configured noise is far below their noise at rest.

    Accelerometers feel an engine or people more than gyros do.
    """
    if not imu_stated(config):
        return []
    walks, imu = random_walks(source), settings.imu
    accel = None if walks is None else walks[1]
    sensors = (
        ("the gyro's", gyro_walk_shown(source), imu.angle_random_walk, 60.0 / DEGREE, "deg", "arw"),
        ("the accelerometers'", accel, imu.velocity_random_walk, 60.0, "m/s", "vrw"),
    )
    return [
        f"{whose} noise at rest is {size * shown:.2g} {unit}/sqrt(h), but the filter was set to"
        f" {size * assumed:.2g} (--imu-grade, --imu-noise, --{option}):"
        f"{' unless an engine or people shake the IMU there,' if unit == 'm/s' else ''} its sigmas"
        " will be too small; leave that option out"
        for whose, shown, assumed, size, unit, option in sensors
        if shown is not None and shown >= NOISIER * assumed
    ]
