"""What an INS/GNSS filter starts from: settings, attitude, measurements, and their latency."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sinstool.aiding import Aiding, read_baro
from sinstool.config import ProcessConfig
from sinstool.config.filter import span
from sinstool.errors import AlignmentError, TopicError
from sinstool.gnss_model import gnss_model
from sinstool.height.network import Grade
from sinstool.in_flight import increments as coarse_increments
from sinstool.initialise import align
from sinstool.integration import latency as latencies
from sinstool.integration.filter import InsGnssFilter
from sinstool.integration.latency import Latency
from sinstool.integration.noise import BARO_GRADES, IMU_GRADES, GnssModel
from sinstool.integration.settings import DivergenceControl, Settings
from sinstool.integration.start import Beginning, find_start, start_at
from sinstool.segment_increments import SegmentIncrements
from sinstool.sensor_grade import sensor_grade
from sinstool.source import Source
from sinstool.streams import GnssEpochs
from sinstool.timeline import SECOND
from sinstool.units import DEGREE
from sinstool.vertical import HeightReference, height_reference, network

# A latency is looked for in the first part of a log, of this length at most, and taken where it
# stands out of its uncertainty.
LATENCY_NS = 600 * SECOND
LATENCY_S = 0.01
LATENCY_ROUNDS = 4
LOOSE_POSITION = (5.0, 5.0, 8.0)
LOOSE_VELOCITY = (0.3, 0.3, 0.5)
LATENCY_SIGMAS = 3.0
# What the start is found from.
START_NS = 400 * SECOND


@dataclass(frozen=True)
class Prepared:
    """All that a filter run needs beside the samples.

    Attributes
    ----------
    settings : Settings
    beginning : Beginning
    gnss : GnssEpochs
    withheld : ndarray of bool
    reference : HeightReference or None
        Barometer heights.
    latency : Latency or None
        Where it was estimated.
    grade : str
    grade_why, gnss_why : str
    warnings : tuple of str
    """

    settings: Settings
    beginning: Beginning
    gnss: GnssEpochs
    withheld: np.ndarray
    reference: HeightReference | None
    latency: Latency | None
    grade: Grade
    grade_why: str
    gnss_why: str
    warnings: tuple[str, ...]


def prepare_filter(source: Source, config: ProcessConfig) -> Prepared:
    """Settings, start and measurements of a filter run.

    Raises
    ------
    TopicError, AlignmentError
        The log has no GNSS, or no start can be found in it.
    """
    log = source.log
    gnss = source.aiding.gnss
    if gnss is None or not gnss.has_position.any():
        raise TopicError(
            log.path,
            "--mode ins-gnss: the log has no GNSS fixes",
            "use --mode ins (with --height-damping), or attitude",
        )
    grade, why = sensor_grade(source, config)
    model, gnss_why = gnss_model(gnss, config)
    reference, notes = _barometer(source, config, grade)
    settings = _settings(source, config, grade, model, reference)
    warnings = list(notes)
    found: Latency | None = None
    if config.gnss.gnss_latency is None:
        found, settings, beginning = _with_latency(source, config, settings, gnss)
        if found.status == "at the limit":
            warnings.append(f"{found}: give it with --gnss-latency")
    else:
        beginning = _beginning(source, config, settings, gnss)
    return Prepared(
        settings,
        beginning,
        gnss,
        _withheld(gnss, config, source.survey.first_ns),
        reference,
        found,
        grade,
        why,
        gnss_why,
        tuple(warnings),
    )


def _barometer(
    source: Source, config: ProcessConfig, grade: Grade
) -> tuple[HeightReference | None, list[str]]:
    """Barometer heights, where the log has a barometer and the filter takes one."""
    if config.filter.filter == "plain-15" or config.vertical.height_damping == "gnss":
        return None, []
    aiding: Aiding = source.aiding
    before = len(aiding.warnings)
    read_baro(source.log, config.input, source.survey.time_source == "log", aiding)
    notes = aiding.warnings[before:]
    if aiding.baro is None:
        if config.vertical.height_damping == "baro":
            height_reference(source.log, aiding, config, 0.0)  # says what is missing
        return None, notes
    vertical = config.vertical.model_copy(update={"height_damping": "baro"})
    damped = config.model_copy(update={"vertical": vertical})
    start = source.position[2] or 0.0
    reference, more = height_reference(source.log, aiding, damped, start)
    return reference, [*notes, *more]


def _settings(
    source: Source,
    config: ProcessConfig,
    grade: Grade,
    model: Any,
    reference: HeightReference | None,
) -> Settings:
    told = config.filter
    damping = None
    if reference is not None and told.filter.startswith("network"):
        damping, _ = network(config, grade, source.latitude or 0.0)
    baro = BARO_GRADES[grade]
    if reference is not None and reference.sigma > 0.0:
        baro = replace(baro, white=reference.sigma)
    return Settings(
        filter=told.filter,
        imu=IMU_GRADES[grade],
        gnss=model,
        baro=baro,
        network=damping,
        grade=grade,
        feedback=told.feedback,
        control=DivergenceControl(
            virtual_noise=told.virtual_noise == "on",
            adaptive=told.adaptive,
            schmidt_epsilon=told.schmidt_epsilon,
            restart_after=told.restart_after,
        ),
        lever_arm_b=config.gnss.lever_arm,
        gnss_latency=config.gnss.gnss_latency or 0.0,
    )


def _withheld(gnss: GnssEpochs, config: ProcessConfig, first_ns: int) -> np.ndarray:
    seconds = (gnss.time_ns - first_ns) / SECOND
    mask = np.zeros(len(gnss), np.bool_)
    for text in config.filter.withhold_gnss:
        begin, end = span(text)
        mask |= (seconds >= begin) & (seconds < end)
    return mask


def _beginning(
    source: Source, config: ProcessConfig, settings: Settings, gnss: GnssEpochs
) -> Beginning:
    """Where the filter starts: as aligned, or found in the log.

    Raises
    ------
    AlignmentError
    """
    path = source.log.path
    usable = gnss.rows(~_withheld(gnss, config, source.survey.first_ns))
    first = source.survey.first_ns
    try:
        if config.align.align != "auto":
            return _from_alignment(source, config, settings, usable)
        imu = coarse_increments(source, config, np.zeros(3), first + START_NS)
        return find_start(imu, usable, settings)
    except AlignmentError as exc:
        message = exc.message if str(path) in exc.message else f"{path}: {exc.message}"
        raise AlignmentError(message, exc.hint) from exc


def _from_alignment(
    source: Source, config: ProcessConfig, settings: Settings, gnss: GnssEpochs
) -> Beginning:
    found = align(source, config)
    covariance = found.covariance_n
    if covariance is None:
        tilt = [s if s is not None else 2.0 * DEGREE for s in found.sigma_rad[:2]]
        heading = found.sigma_rad[2]
        if heading is None:
            heading = (2.0 if found.north_referenced else 104.0) * DEGREE
        covariance = np.diag(np.square([*tilt, heading]))
    if not found.north_referenced:
        raise AlignmentError(
            f"{source.log.path}: --align {found.method} gives no heading, and the filter needs one",
            "leave --align out, or use svd, gyrocompass, log or fixed",
        )
    time_ns = found.time_ns
    valid = gnss.time_ns - round(settings.gnss_latency * SECOND)
    first_fix = int(valid[gnss.has_position][0])
    notes: tuple[str, ...] = ()
    if first_fix - time_ns > 2 * SECOND:
        raise AlignmentError(
            f"{source.log.path}: the first fix comes {(first_fix - time_ns) / SECOND:.1f} s after"
            " the attitude that was given",
            "begin later with --start, or leave --align out",
        )
    start = start_at(
        time_ns,
        found.q_nb,
        covariance,
        gnss,
        settings,
        gyro_bias=found.gyro_bias,
        gyro_bias_sigma=settings.imu.gyro_instability if found.bias_source != "none" else None,
    )
    return Beginning(start, time_ns, f"attitude by {found.method}", (*found.warnings, *notes))


def _with_latency(
    source: Source, config: ProcessConfig, settings: Settings, gnss: GnssEpochs
) -> tuple[Latency, Settings, Beginning]:
    """Look for the receiver's latency, and take it where it stands out."""
    beginning = _beginning(source, config, settings, gnss)
    found = _correlated(source, config, settings, beginning, gnss)
    for _ in range(LATENCY_ROUNDS):
        if not _stands_out(found, settings.gnss_latency):
            break
        settings = replace(settings, gnss_latency=found.latency_s)
        beginning = _beginning(source, config, settings, gnss)
        found = _correlated(source, config, settings, beginning, gnss)
    return found, settings, beginning


def _stands_out(found: Latency, known: float) -> bool:
    if found.status == "not observable":
        return False
    return abs(found.latency_s - known) > max(LATENCY_S, LATENCY_SIGMAS * found.sigma_s)


def _correlated(
    source: Source,
    config: ProcessConfig,
    settings: Settings,
    beginning: Beginning,
    gnss: GnssEpochs,
) -> Latency:
    """Latency by which the Imu's velocity and that of GNSS run alike."""
    if not gnss.has_velocity.any():
        return Latency(0.0, float("inf"), "not observable", 0)
    end = beginning.time_ns + LATENCY_NS
    # Loosely: fixes at the wrong time must not spoil the biases that are taken off.
    plain = replace(
        settings,
        filter="plain-15",
        network=None,
        gnss=GnssModel(position_white=LOOSE_POSITION, velocity_white=LOOSE_VELOCITY),
        control=replace(settings.control, gate_probability=1.0),
    )
    loose = replace(
        gnss,
        sigma_position_n=np.full_like(gnss.sigma_position_n, np.nan),
        sigma_velocity_n=np.full_like(gnss.sigma_velocity_n, np.nan),
    )
    run = InsGnssFilter(beginning.start, plain, with_baro=False)
    steps = SegmentIncrements(source, config)
    given = False
    parts: list[tuple[np.ndarray, ...]] = []
    last_q = beginning.start.nav[6:10]
    for increments, _, _ in steps.from_time(beginning.time_ns, end):
        block = run.push(increments, None if given else loose)
        given = True
        out = block.updates
        if out is None or not len(out):
            continue
        parts.append(
            (
                out.time_ns,
                np.concatenate([last_q[None, :], out.q_nb[:-1]]),
                increments.velocity_increment
                - run.summary.accel_bias * increments.interval[:, None],
                increments.interval,
                out.latitude,
                out.height,
                out.velocity_n,
            )
        )
        last_q = out.q_nb[-1]
    if not parts:
        return Latency(0.0, float("inf"), "not observable", 0)
    time_ns, q, dv, dt, latitude, height, velocity = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    inertial = latencies.inertial_velocity(q, dv, dt, latitude, height, velocity)
    rows = gnss.rows((gnss.time_ns >= beginning.time_ns) & (gnss.time_ns <= end))
    return latencies.correlate(time_ns, inertial, rows.time_ns, rows.velocity_n)
