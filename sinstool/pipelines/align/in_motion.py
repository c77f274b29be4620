"""Attitude of a vehicle in motion, from its log and the options."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.earth import horizontal_metres
from sinstool.core.errors import AlignmentError
from sinstool.core.rotation import wrapped
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE, STANDARD_GRAVITY
from sinstool.io.readers.frames import turn_body
from sinstool.methods.alignment import in_motion, measurements
from sinstool.methods.alignment.in_motion import MotionAlignment, align_in_motion
from sinstool.methods.alignment.inflight_types import (
    REFUSE_SIGMA,
    AlignmentSettings,
    GateLimits,
    GnssFixes,
    ImuIncrements,
)
from sinstool.methods.alignment.span_reader import MOST_SAMPLES, SpanReader
from sinstool.methods.allan.coefficients import as_measured
from sinstool.methods.receiver_priors import ARM_USUAL_M
from sinstool.methods.sensor_errors import (
    CALIBRATED,
    IMU_GRADES,
    LOW_COST,
    Grade,
    SensorGrade,
    as_if_aligned,
    without,
)
from sinstool.survey.grade import gyro_walk_shown, measured_noise, velocity_walk_shown
from sinstool.survey.imu import Survey
from sinstool.survey.rest import REST_S, longest_rest, rest_end
from sinstool.survey.source import Source, rate_blocks

# A boost exceeds this specific force.
LIFT_OFF = 2.0 * STANDARD_GRAVITY
# A boost adds to the speed at least the share BOOSTED of the specific force beyond 1 g, integrated,
# and at least LEAST_BOOST, m/s; the fixes that show it are no further apart than it is long, plus
# SEEN_NS.
BOOSTED, LEAST_BOOST, SEEN_NS = 0.5, 8.0, 10 * SECOND
# Time read before a start: for the sample before the first one; and before a lift-off, for a moment
# of rest.
BEFORE_START_NS = SECOND
BEFORE_LIFT_OFF_NS = 10 * SECOND
# A gyro bias measured at rest may change by this, rad/s (45 deg/h, 1 sigma): between the rests of
# recorded drives of a few minutes those of two consumer grade IMUs moved by 20 to 70 deg/h.
AFTER_REST = 45.0 * DEGREE / 3600.0
# If the first motion does not show the attitude, alignment begins again this much later, s.
LATER_S = (60.0, 120.0, 180.0, 240.0, 300.0, 420.0, 600.0)
NEVER_CALM = (
    "the flight after lift-off is never as calm, or not for as long, as the gate asks for: aligned"
    " with all of the motion, which the fixes do not contradict"
)
# Bias of a cheap gyro in a log without rest, if that of its grade is too small, rad/s (1 sigma).
UNKNOWN_BIAS = 0.5 * DEGREE


def align_moving(
    source: Source,
    config: ProcessConfig,
    grade: Grade,
    method: str,
    at: str | int,
    gnss: GnssEpochs | None = None,
    refuse_sigma: float = REFUSE_SIGMA,
    sample_s: float = 0.0,
    likely_bias: np.ndarray | None = None,
    lasting: bool = False,
) -> MotionAlignment:
    """Align a log's vehicle in motion.

    From the time after its first motion, unless a gate or options say when to begin; if that shows
    no heading, from a later time. A launched vehicle may never fly as calmly as the gate asks for:
    then all of its motion counts, if no sensor was saturated and the fixes fit.

    Parameters
    ----------
    source : Source
        With all of GNSS.
    method : {'svd', 'quest', 'davenport', 'triad'}
    at : {'end', 'start'} or int
        When the attitude holds.
    gnss : GnssEpochs, optional
        Instead of those of the log.
    refuse_sigma : float
        About its worst axis, rad: an attitude that is less certain is not given.
    sample_s : float, optional
        By how much samples may be of another time, s, as likely as not.
    likely_bias : ndarray, shape (3,), optional
        Gyro bias, rad/s, that other fixes of the same log have shown: searched for anew only if it
        does not explain these.
    lasting : bool, optional
        The sigma of heading allows for errors of velocities that last, as far as they show.

    Returns
    -------
    MotionAlignment
        Of whatever status.

    Raises
    ------
    AlignmentError
        The log has no GNSS to align with.
    """
    survey = source.survey
    latency = config.gnss.gnss_latency or 0.0
    try:
        fixes, notes = measurements.gnss_fixes(
            gnss or source.aiding.gnss, survey.first_ns, survey.last_ns, latency
        )
    except AlignmentError as exc:
        raise AlignmentError(f"{source.log.path}: {exc.message}", exc.hint) from exc

    wanted = _Wanted(
        source,
        config,
        grade,
        method,
        at,
        fixes,
        tuple(notes),
        refuse_sigma,
        sample_s,
        likely_bias,
        lasting,
    )
    if config.in_flight.gate != "auto":
        return _through(config.in_flight.gate, wanted)
    lively = float(np.linalg.norm(survey.accel_max)) > LIFT_OFF
    if not (lively and _lifts_off(source, fixes)):
        return _through("off", wanted)
    gated = _through("paper", wanted)
    if gated.good or survey.saturated:
        return gated
    with suppress(AlignmentError):
        whole = _through("off", replace(wanted, notes=(*wanted.notes, NEVER_CALM)))
        if whole.good and whole.consistent:
            return whole
    return gated


@dataclass(frozen=True)
class _Wanted:
    """What is to be aligned: the arguments of :func:`align_moving`, with fixes and notes."""

    source: Source
    config: ProcessConfig
    grade: Grade
    method: str
    at: str | int
    fixes: GnssFixes
    notes: tuple[str, ...]
    refuse_sigma: float
    sample_s: float
    likely_bias: np.ndarray | None
    lasting: bool


def _through(gate: str, wanted: _Wanted) -> MotionAlignment:
    """An alignment with a gate: ``paper``, ``mask`` or ``off``."""
    source, config, fixes, notes = wanted.source, wanted.config, wanted.fixes, wanted.notes
    grade, refuse_sigma = wanted.grade, wanted.refuse_sigma
    options, survey = config.in_flight, source.survey
    first = survey.first_ns
    bias, at_rest = bias_at_rest(source, config, grade)
    start = None if options.align_start is None else first + round(options.align_start * SECOND)
    end = None if options.align_end is None else first + round(options.align_end * SECOND)
    later: list[int] = []
    if gate == "off" and start is None:
        rest = survey.lead_in
        still = first if rest is None else rest_end(rest, survey.spans, survey.windows)
        start = in_motion.first_motion(fixes, first, still)
        if start is not None:
            last = int(fixes.time_ns[-1]) if end is None else end
            later = [ns for s in LATER_S if (ns := start + round(s * SECOND)) < last]
    walks = gyro_walk_shown(source, REST_S) or 0.0, velocity_walk_shown(source)
    errors = sensor_errors(config, grade, at_rest, walks)
    doubtful = grade in LOW_COST and not at_rest and options.sigma_bg is None

    def begun(
        begin: int | None,
        notes: tuple[str, ...],
        sigma: float = refuse_sigma,
        known: in_motion.Known | None = None,
        around: bool = False,
        likely: np.ndarray | None = None,
    ) -> MotionAlignment:
        settings = _settings(config, errors, wanted.method, gate, wanted.at, begin, survey)
        settings = replace(settings, sample_s=wanted.sample_s, lasting=wanted.lasting)
        return align_in_motion(
            SpanReader(
                rate_blocks(source, config, _reading_from(source, gate, begin)),
                MOST_SAMPLES if end is None else None,
            ),
            config.input.sample_kind,
            _interval_ns(source) / SECOND,
            fixes,
            replace(settings, refuse_sigma=sigma, around=around),
            bias if likely is None else likely,
            in_motion.spans(gate, begin, end, first, int(fixes.time_ns[-1])),
            UNKNOWN_BIAS if doubtful and likely is None else None,
            CALIBRATED if doubtful else None,
            notes,
            known,
        )

    if doubtful and wanted.likely_bias is not None:
        with suppress(AlignmentError):
            same = begun(start, notes, likely=wanted.likely_bias)
            if same.fits:
                return replace(same, bias_by_motion=True)
    known: in_motion.Known | None = None
    if doubtful and refuse_sigma > REFUSE_SIGMA:
        known = {}
        # With the usual limit first: if the answer is good, a wider limit would not change it, but
        # where it depends on an assumed bias. It decides only whether another bias is searched for.
        with suppress(AlignmentError):
            sure = begun(start, notes, REFUSE_SIGMA, known)
            if sure.good and not sure.bias_assumed:
                return sure
    try:
        moving = begun(start, notes, known=known)
    except AlignmentError as exc:
        moving, refused = None, exc
    del known
    for begin in () if moving is not None and moving.good else later:
        assert start is not None
        skipped = (
            f"the first {(begin - start) / SECOND:.0f} s of motion do not show the attitude:"
            " aligned with what follows"
        )
        try:
            made = begun(begin, (*notes, skipped))
        except AlignmentError:
            continue
        if made.good:
            return made
    if moving is not None and not moving.good:
        # A vehicle slower than the effect of sensor errors shows its heading to the refinement
        with suppress(AlignmentError):
            slow = begun(start, notes, around=True)
            if slow.good:
                return slow
    if moving is not None:
        return moving
    try:
        raise refused
    finally:
        del refused  # it refers to this frame, which refers to it


def _lifts_off(source: Source, fixes: GnssFixes) -> bool:
    """Whether a log shows a boost: above 2 g for half a second, and faster after it.

    In a car's corner, an aircraft's pull-up or on skis the specific force is as large, but the
    speed hardly changes. A log without fixes before or beside such a time counts as one with a
    boost.
    """
    windows, lively = source.survey.windows, np.flatnonzero(_beyond_lift_off(source))
    when, speed = _speeds(fixes)
    force = np.linalg.norm(windows.accel, axis=1) - STANDARD_GRAVITY
    length_ns = int(np.median(np.diff(windows.start_ns))) if len(windows) > 1 else SECOND // 2
    unseen = bool(len(lively))
    for boost in np.split(lively, np.flatnonzero(np.diff(lively) > 1) + 1) if unseen else ():
        begin, end = int(windows.start_ns[boost[0]]), int(windows.start_ns[boost[-1]]) + length_ns
        before, after = np.searchsorted(when, begin, "right") - 1, np.searchsorted(when, end)
        if before < 0:
            return True
        if after == len(when) or when[after] - when[before] > end - begin + SEEN_NS:
            continue
        unseen = False
        least = BOOSTED * float(force[boost].sum()) * length_ns / SECOND
        if speed[after] - speed[before] > max(least, LEAST_BOOST):
            return True
    return unseen


def _speeds(fixes: GnssFixes) -> tuple[np.ndarray, np.ndarray]:
    """Speeds of fixes, m/s, and when: from their positions where they have no velocity."""
    known = np.isfinite(fixes.velocity_n).all(axis=1)
    if known.any():
        return fixes.time_ns[known], np.linalg.norm(fixes.velocity_n[known], axis=1)
    north, east = horizontal_metres(
        np.diff(fixes.latitude), wrapped(np.diff(fixes.longitude)), fixes.latitude[:-1]
    )
    seconds = np.diff(fixes.time_ns) / SECOND
    way = np.sqrt(north**2 + east**2 + np.diff(fixes.height) ** 2)
    return fixes.time_ns[1:], way / np.maximum(seconds, 1e-3)


def _beyond_lift_off(source: Source) -> np.ndarray:
    """Half-seconds with a mean specific force above 2 g."""
    return np.asarray(np.linalg.norm(source.survey.windows.accel, axis=1) > LIFT_OFF)


def bias_at_rest(source: Source, config: ProcessConfig, grade: Grade) -> tuple[np.ndarray, bool]:
    """Gyro bias before any alignment, rad/s, and whether a rest or the user gave it.

    A rest anywhere in the log shows the bias of a gyro that does not feel the Earth's rotation;
    that of better gyros is left to the refinement.
    """
    option, survey = config.align.gyro_bias, source.survey
    if not isinstance(option, str):
        return turn_body(np.array(option), config.input.body_axes), True
    if option == "none" or grade not in LOW_COST:
        return np.zeros(3), False
    if survey.lead_in is not None:
        return survey.lead_in.gyro.copy(), True
    rest = longest_rest(survey.spans, source.aiding.gnss)
    return (np.zeros(3), False) if rest is None else (rest.gyro.copy(), True)


def _reading_from(source: Source, gate: str, start_ns: int | None) -> int:
    """Time of the first sample to read: shortly before the alignment's own beginning, ns.

    A log that is short enough to be read as a whole is, up to a beginning that the gate finds.
    """
    survey = source.survey
    if start_ns is not None:
        return max(survey.first_ns, start_ns - BEFORE_START_NS)
    if gate == "paper" and survey.count > MOST_SAMPLES:
        lively = np.flatnonzero(_beyond_lift_off(source))
        if len(lively):
            lift_off = int(survey.windows.start_ns[lively[0]])
            return max(survey.first_ns, lift_off - BEFORE_LIFT_OFF_NS)
    return survey.first_ns


def increments(
    source: Source,
    config: ProcessConfig,
    gyro_bias: np.ndarray,
    end_ns: int,
    begin_ns: int | None = None,
    most: int | None = None,
) -> ImuIncrements:
    """Samples of a span as increments, less a gyro bias.

    Parameters
    ----------
    gyro_bias : ndarray, shape (3,)
        rad/s.
    begin_ns : int, optional
        By default the first sample.
    most : int, optional
        The first so many at most.
    """
    first_ns = source.survey.first_ns
    begin_ns = first_ns if begin_ns is None else begin_ns
    # From a little earlier, as the first increment needs the sample before it.
    blocks = rate_blocks(source, config, max(first_ns, begin_ns - BEFORE_START_NS))
    imu = measurements.increments(
        SpanReader(blocks, most).until(end_ns),
        config.input.sample_kind,
        _interval_ns(source) / SECOND,
        gyro_bias,
    )
    return imu.rows(slice(int(np.searchsorted(imu.time_ns, begin_ns)), None))


def _interval_ns(source: Source) -> float:
    """Interval of the first sample."""
    return source.survey.interval_ns or SECOND


def imu_noise(config: ProcessConfig, grade: Grade, scale_states: bool = False) -> SensorGrade:
    """Noise of a grade, overridden by a noise file or by options.

    Parameters
    ----------
    scale_states : bool, optional
        See :func:`~sinstool.methods.allan.coefficients.as_measured`.
    """
    options, noise, measured = config.in_flight, IMU_GRADES[grade], measured_noise(config)
    if measured is not None:
        noise = as_measured(measured, noise, scale_states)
    changes: dict[str, float] = {}
    if options.arw is not None:
        changes["angle_random_walk"] = options.arw * DEGREE / 60.0
    if options.vrw is not None:
        changes["velocity_random_walk"] = options.vrw * 1e-6 * STANDARD_GRAVITY
    if options.sigma_bg is not None:
        changes["gyro_bias"] = options.sigma_bg * DEGREE / 3600.0
        changes["gyro_instability"] = min(noise.gyro_instability, 0.1 * changes["gyro_bias"])
    if options.sigma_ba is not None:
        changes["accel_bias"] = options.sigma_ba
        changes["accel_instability"] = min(noise.accel_instability, 0.1 * options.sigma_ba)
    if options.sigma_sf is not None:
        changes["accel_scale"] = changes["gyro_scale"] = options.sigma_sf
    if config.filter.sigma_misalignment is not None:
        angle = 1e-3 * config.filter.sigma_misalignment
        changes["gyro_misalignment"] = changes["accel_misalignment"] = angle
    if options.bias_time is not None:
        changes["bias_time_s"] = options.bias_time
        changes["gyro_instability"] = changes.get("gyro_bias", noise.gyro_bias)
        changes["accel_instability"] = changes.get("accel_bias", noise.accel_bias)
        changes["scale_wander"] = 1.0
    return replace(noise, **changes)


def sensor_errors(
    config: ProcessConfig, grade: Grade, at_rest: bool, walks: tuple[float, float] = (0.0, 0.0)
) -> SensorGrade:
    """Errors of the sensors: as the options say, else those of the grade.

    Parameters
    ----------
    at_rest : bool
        A rest shows the gyro bias.
    walks : tuple of float
        Random walks seen at rest, of angle, rad/sqrt(s), and of velocity, (m/s)/sqrt(s), taken
        where they are more than the grade's.
    """
    options, noise = config.in_flight, imu_noise(config, grade)
    gyro_bias, accel_bias = noise.gyro_bias, noise.accel_bias
    angle, velocity = noise.angle_random_walk, noise.velocity_random_walk
    if options.sigma_bg is None:
        gyro_bias = float(np.hypot(gyro_bias, noise.gyro_instability))
        gyro_bias = min(gyro_bias, AFTER_REST) if at_rest else gyro_bias
    if options.sigma_ba is None:
        accel_bias = float(np.hypot(accel_bias, noise.accel_instability))
    used = replace(
        noise,
        gyro_bias=gyro_bias,
        accel_bias=accel_bias,
        angle_random_walk=max(angle, walks[0]) if options.arw is None else angle,
        velocity_random_walk=max(velocity, walks[1]) if options.vrw is None else velocity,
    )
    aligned = without(as_if_aligned(used), "drift")
    return replace(aligned, gyro_misalignment=used.gyro_misalignment)


def _settings(
    config: ProcessConfig,
    errors: SensorGrade,
    method: str,
    gate: str,
    at: str | int,
    start: int | None,
    survey: Survey,
) -> AlignmentSettings:
    options, gnss, first = config.in_flight, config.gnss, survey.first_ns
    return AlignmentSettings(
        method=method,
        vectors=options.vectors,
        window_s=options.window,
        fade_s=options.fade or float("inf"),
        gate=gate,
        limits=GateLimits(
            f_set=options.f_set,
            f_step_set=options.df_set,
            w_set=options.w_set * DEGREE,
            w_step_set=options.dw_set * DEGREE,
            t_set1=options.t_set1,
            n_set1=options.n_set1,
            t_set2=options.t_set2,
            n_set2=options.n_set2,
            smooth=options.gate_smooth,
        ),
        start_ns=start,
        max_gap_ns=survey.max_gap_ns,
        t0_ns=None if options.lift_off is None else first + round(options.lift_off * SECOND),
        sigma_stop=None if options.sigma_stop is None else options.sigma_stop * DEGREE,
        gnss_sigma_v=gnss.gnss_sigma_v,
        gnss_latency_s=gnss.gnss_latency or 0.0,
        lever_arm_b=gnss.lever_arm or (0.0, 0.0, 0.0),
        grade=errors,
        kappa=options.kappa,
        refine=options.refine == "kf",
        # Where nobody says where the antenna is, it may be a metre away
        refine_lever_sigma=ARM_USUAL_M if gnss.lever_arm is None else 0.0,
        at=at,
        gyro_limit=None if options.gyro_range is None else options.gyro_range * DEGREE,
        accel_limit=options.accel_range,
    )
