"""Attitude of a vehicle in motion, from its log: Imu samples and GNSS made ready for alignment."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.errors import AlignmentError
from sinstool.core.streams import Imu, concatenate
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE, STANDARD_GRAVITY
from sinstool.methods.alignment.inflight import (
    AlignmentSettings,
    GateLimits,
    GnssFixes,
    ImuIncrements,
    InFlightAlignment,
    SensorGrade,
    align_in_flight,
)
from sinstool.methods.height.network import Grade
from sinstool.methods.ins_gnss.noise import IMU_GRADES
from sinstool.survey.source import Source, rate_blocks

# Without a gate, what is used begins when the vehicle does, and is this long at first.
MOVING_M_S = 2.0
BEFORE_S = 5.0
SPANS_S = (200.0, 600.0)
# The largest specific force below this: no lift-off to look for.
LIFT_OFF = 2.0 * STANDARD_GRAVITY
# A gyro bias seen at rest stays what it was within this, rad/s (45 deg/h): between the rests of
# recorded drives of a few minutes those of two consumer grade IMUs moved by 20 to 70 deg/h.
AFTER_REST = 45.0 * DEGREE / 3600.0
# Rests shorter than this say little of a bias.
REST_S = 2.0
# Vertical velocity from height: over so long before and after, as heights are noisy.
CLIMB_S = 2.0


@dataclass(frozen=True)
class Moving:
    """An alignment in motion, and what went into it.

    Attributes
    ----------
    gyro_bias : ndarray, shape (3,)
        Taken off the samples before, rad/s.
    """

    answer: InFlightAlignment
    gyro_bias: np.ndarray
    settings: AlignmentSettings


def align_moving(
    source: Source, config: ProcessConfig, grade: Grade, method: str, at: str | int
) -> Moving:
    """Align a log's vehicle in motion.

    Parameters
    ----------
    source : Source
        With all of GNSS.
    grade : {'mems', 'tactical', 'navigation'}
    method : {'svd', 'quest', 'davenport', 'triad'}
    at : {'end', 'start'} or int
        When the attitude is wanted.

    Returns
    -------
    Moving
        Of whatever status; the first span of time that gives a good one.

    Raises
    ------
    AlignmentError
        The log has no GNSS to align with.
    """
    fixes, notes = gnss_fixes(source, config.gnss.gnss_latency or 0.0)
    bias, from_rest = known_bias(source, config, grade)
    first = source.survey.first_ns
    told = config.in_flight
    gate = told.gate
    if gate == "auto":
        lively = float(np.linalg.norm(source.survey.accel_max)) > LIFT_OFF
        gate = "paper" if lively and _lifts_off(source) else "off"
    start = None if told.align_start is None else first + round(told.align_start * SECOND)
    if gate == "off" and start is None:
        start = _first_motion(fixes, first)
    errors = sensor_errors(config, grade, from_rest, walk_at_rest(source))
    moving = None
    for span in _spans(told.align_end, gate, start, first, int(fixes.time_ns[-1])):
        settings = _settings(config, errors, method, gate, at, start, span, first)
        imu = increments(source, config, bias, span)
        answer = align_in_flight(imu, fixes, settings)
        answer = replace(answer, warnings=(*notes, *answer.warnings))
        if moving is None or _better(answer, moving.answer):
            moving = Moving(answer, bias, settings)
        if answer.status == "ok":
            break
    assert moving is not None
    return moving


def _better(new: InFlightAlignment, old: InFlightAlignment) -> bool:
    return old.status == "failed" or new.sigma_worst < old.sigma_worst


def _spans(
    wanted: float | None, gate: str, start: int | None, first: int, last: int
) -> list[int | None]:
    """Ends to try, one after the other."""
    if wanted is not None:
        return [first + round(wanted * SECOND)]
    if gate == "paper":
        return [None]  # it stops by itself
    begin = first if start is None else start
    ends: list[int | None] = [begin + round(s * SECOND) for s in SPANS_S]
    # a span that holds all of the log is tried once
    inside = [e for e in ends if e is not None and e < last]
    return [*inside, None] if len(inside) < len(ends) else list(inside)


def _lifts_off(source: Source) -> bool:
    """A half-second mean of specific force above 2 g."""
    windows = source.survey.windows
    return bool((np.linalg.norm(windows.accel, axis=1) > LIFT_OFF).any())


def _first_motion(fixes: GnssFixes, first: int) -> int | None:
    speed = np.linalg.norm(fixes.velocity_n[:, :2], axis=1)
    fast = np.flatnonzero(speed > MOVING_M_S)
    if not len(fast):
        return None
    return max(first, int(fixes.time_ns[fast[0]]) - round(BEFORE_S * SECOND))


def gnss_fixes(source: Source, latency_s: float = 0.0) -> tuple[GnssFixes, tuple[str, ...]]:
    """Epochs with velocity; their positions are interpolated where they have none.

    Parameters
    ----------
    source : Source
        With all of GNSS.
    latency_s : float
        By which a fix is older than its stamp; decides which are as old as the samples.

    Returns
    -------
    fixes : GnssFixes
    warnings : tuple of str

    Raises
    ------
    AlignmentError
        There are none within the span of the samples.
    """
    aiding = source.aiding
    gnss = aiding.gnss
    if gnss is None or not gnss.has_position.any():
        raise AlignmentError(
            f"{source.path}: alignment in motion needs GNSS fixes, and the log has none",
            "use --align level, gyrocompass, log or fixed",
        )
    valid_ns = gnss.time_ns - round(latency_s * SECOND)
    inside = (valid_ns >= source.survey.first_ns) & (valid_ns <= source.survey.last_ns)
    known = gnss.rows(gnss.has_position)
    rows = gnss.rows(inside & (gnss.has_velocity if gnss.has_velocity.any() else gnss.has_position))
    if not len(rows):
        raise AlignmentError(
            f"{source.path}: no GNSS fix lies within the span of the Imu's samples",
            "choose another span with --start and --end, or use --align level or log",
        )
    seconds = (rows.time_ns - known.time_ns[0]) / SECOND
    at = (known.time_ns - known.time_ns[0]) / SECOND
    high = np.isfinite(known.height)
    height = np.zeros(len(rows))
    if high.any():
        height = np.interp(seconds, at[high], known.height[high])
    sigma = rows.sigma_velocity_n
    told = np.isfinite(sigma).all(axis=1)
    usual = float(np.median(sigma[told])) if told.any() else 0.0
    sigma_v = None
    if usual > 0.0:
        sigma_v = np.where(told, np.sqrt(np.mean(sigma**2, axis=1)), usual)
    velocity, warnings = _whole_velocity(rows.velocity_n, seconds, at[high], known.height[high])
    longitude = np.interp(seconds, at, np.unwrap(known.longitude))
    fixes = GnssFixes(
        rows.time_ns,
        np.interp(seconds, at, known.latitude),
        (longitude + np.pi) % (2.0 * np.pi) - np.pi,
        height,
        velocity,
        sigma_v,
    )
    return fixes, warnings


def _whole_velocity(
    velocity_n: np.ndarray, seconds: np.ndarray, height_s: np.ndarray, height: np.ndarray
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Velocity with a vertical part, where most fixes have none.

    Where few have none, these are better left out than guessed.
    """
    flat = np.isfinite(velocity_n[:, :2]).all(axis=1) & ~np.isfinite(velocity_n[:, 2])
    if np.count_nonzero(flat) < 0.5 * len(flat):
        return velocity_n, ()
    filled = velocity_n.copy()
    if len(height_s) < 2:
        filled[flat, 2] = 0.0
        return filled, ("the fixes have no vertical velocity and no height: taken as level",)
    ends = [np.interp(seconds[flat] + half, height_s, height) for half in (-CLIMB_S, CLIMB_S)]
    filled[flat, 2] = (ends[0] - ends[1]) / (2.0 * CLIMB_S)
    return filled, (
        f"the fixes have no vertical velocity: taken from height over {2 * CLIMB_S:g} s",
    )


def known_bias(source: Source, config: ProcessConfig, grade: Grade) -> tuple[np.ndarray, bool]:
    """Gyro bias before any alignment, rad/s, and whether a rest showed it.

    A rest anywhere in the log shows the bias of a gyro that does not feel the Earth's rotation;
    better gyros are left to the refinement.
    """
    wanted = config.align.gyro_bias
    if not isinstance(wanted, str):
        from sinstool.io.readers.frames import turn_body

        return turn_body(np.array(wanted), config.input.body_axes), True
    if wanted == "none" or grade != "mems":
        return np.zeros(3), False
    rests = [s for s in source.survey.spans if s.duration_s >= REST_S]
    lead = source.survey.lead_in
    if lead is None and source.aiding.gnss is not None:
        from sinstool.survey.aiding import moving_at

        rests = [s for s in rests if moving_at(source.aiding.gnss, s.start_ns, s.end_ns) is None]
    if lead is not None:
        return lead.gyro.copy(), True
    if not rests:
        return np.zeros(3), False
    longest = max(rests, key=lambda s: s.duration_s)
    return longest.gyro.copy(), True


def increments(
    source: Source, config: ProcessConfig, gyro_bias: np.ndarray, end_ns: int | None
) -> ImuIncrements:
    """Samples up to a time as increments: point rates by the trapezoidal rule.

    Parameters
    ----------
    gyro_bias : ndarray, shape (3,)
        Taken off, rad/s.
    end_ns : int, optional
    """
    kind = config.input.gyro_kind
    nominal = source.survey.interval_ns or SECOND
    blocks = rate_blocks(source, config, source.survey.first_ns, nominal)
    parts: list[Imu] = []
    for block in blocks:
        if end_ns is not None and int(block.time_ns[0]) > end_ns:
            break
        parts.append(block)
    imu = concatenate(parts)
    if end_ns is not None:
        imu = imu.rows(slice(0, int(np.searchsorted(imu.time_ns, end_ns, "right"))))
    step = np.diff(imu.time_ns, prepend=imu.time_ns[0]) / SECOND
    step[0] = nominal / SECOND
    gyro, accel = imu.gyro - gyro_bias, imu.accel
    if kind == "rate":
        gyro, accel = _between(gyro), _between(accel)
    return ImuIncrements(imu.time_ns, gyro * step[:, None], accel * step[:, None])


def _between(samples: np.ndarray) -> np.ndarray:
    """Means of each sample and the one before it."""
    mean = samples.copy()
    mean[1:] = 0.5 * (samples[1:] + samples[:-1])
    return mean


def walk_at_rest(source: Source) -> float:
    """Angular random walk that the longest rest shows, rad/sqrt(s); 0 without a rest."""
    spans = [s for s in source.survey.spans if s.duration_s >= REST_S]
    if not spans:
        return 0.0
    longest = max(spans, key=lambda s: s.samples)
    return float(longest.gyro_std * np.sqrt(source.survey.interval_ns / SECOND / 3.0))


def sensor_errors(
    config: ProcessConfig,
    grade: Grade,
    bias_known: bool,
    angle_walk: float = 0.0,
) -> SensorGrade:
    """Errors of the sensors: as told, else those of the grade.

    Parameters
    ----------
    grade : {'mems', 'tactical', 'navigation'}
    bias_known : bool
        A rest has shown the gyro bias.
    angle_walk : float
        Angular random walk seen at rest, rad/sqrt(s), taken where it is more than the grade's.
    """
    noise, told = IMU_GRADES[grade], config.in_flight
    angle_walk = max(noise.angle_random_walk, angle_walk)
    gyro_bias = float(np.hypot(noise.gyro_bias, noise.gyro_instability))
    if bias_known:
        gyro_bias = min(gyro_bias, AFTER_REST)
    accel_bias = float(np.hypot(noise.accel_bias, noise.accel_instability))
    scale = noise.accel_scale if told.sigma_sf is None else told.sigma_sf
    return SensorGrade(
        gyro_bias if told.sigma_bg is None else told.sigma_bg * DEGREE / 3600.0,
        accel_bias if told.sigma_ba is None else told.sigma_ba,
        scale,
        scale,
        angle_walk if told.arw is None else told.arw * DEGREE / 60.0,
        noise.velocity_random_walk if told.vrw is None else told.vrw * 1e-6 * STANDARD_GRAVITY,
        noise.instability_time,
    )


def _settings(
    config: ProcessConfig,
    errors: SensorGrade,
    method: str,
    gate: str,
    at: str | int,
    start: int | None,
    end: int | None,
    first: int,
) -> AlignmentSettings:
    told, gnss = config.in_flight, config.gnss
    optional: dict[str, Any] = {}
    if told.fade is not None:
        optional["fade_s"] = told.fade
    return AlignmentSettings(
        method=method,
        vectors=told.vectors,
        window_s=told.window,
        gate=gate,
        limits=GateLimits(
            f_set=told.f_set,
            f_step_set=told.df_set,
            w_set=told.w_set * DEGREE,
            w_step_set=told.dw_set * DEGREE,
            t_set1=told.t_set1,
            n_set1=told.n_set1,
            t_set2=told.t_set2,
            n_set2=told.n_set2,
            smooth=told.gate_smooth,
        ),
        start_ns=start,
        end_ns=end,
        t0_ns=None if told.lift_off is None else first + round(told.lift_off * SECOND),
        sigma_stop=None if told.sigma_stop is None else told.sigma_stop * DEGREE,
        gnss_sigma_v=gnss.gnss_sigma_v,
        gnss_latency_s=gnss.gnss_latency or 0.0,
        lever_arm_b=gnss.lever_arm,
        grade=errors,
        kappa=told.kappa,
        refine=told.refine == "kf",
        at=at,
        gyro_limit=None if told.gyro_range is None else told.gyro_range * DEGREE,
        accel_limit=told.accel_range,
        **optional,
    )
