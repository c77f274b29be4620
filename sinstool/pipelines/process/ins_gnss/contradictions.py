"""Contradictions between a log and the start of a filter: options, attitude, clock of the fixes.

With wrong settings a filter may be far off, and its sigmas do not show it. Each contradiction is
measured once the start is final, and becomes a finding of the run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.earth import earth_rate_n
from sinstool.core.errors import AlignmentError
from sinstool.core.finding import Finding, Severity
from sinstool.core.rotation import conjugate, log, multiply
from sinstool.core.units import DEGREE
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.fix_velocity import velocity_noise_bound
from sinstool.methods.ins_gnss.latency import MAX_SIGMA_S
from sinstool.methods.sensor_errors import Grade, SensorGrade, next_worse
from sinstool.pipelines.align.in_motion import imu_noise
from sinstool.pipelines.process.ins_gnss.filter_settings import (
    has_scales,
    imu_stated,
    noise_stated,
    receiver_stated,
)
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart, LikelierGrade
from sinstool.pipelines.process.ins_gnss.first_start import first_start
from sinstool.pipelines.process.ins_gnss.imu_drift import Drift
from sinstool.pipelines.process.ins_gnss.imu_fit import Fit, fit
from sinstool.pipelines.process.ins_gnss.late_gyros import late_gyros, settled_delay
from sinstool.pipelines.process.ins_gnss.likeliest_attitude import denied_attitude
from sinstool.pipelines.process.ins_gnss.timing import motion_from
from sinstool.pipelines.process.ins_gnss.white_noise import white_noise
from sinstool.survey.grade import BRIEF_REST_S
from sinstool.survey.oddities import SATURATION
from sinstool.survey.receiver_ahead import RECEIVER_CLOCK
from sinstool.survey.rest import longest_rest
from sinstool.survey.source import Source

# Drift without fixes over its sigma: beyond this, options make the IMU better than it is.
MOST_DRIFT = 2.0
# Decrease of -2 log likelihood with a worse grade beyond which a stated one is too good. What
# innovations do not have in common with any model changes it by tens.
MOST_UNLIKELY = 100.0
# Sigmas of a gyro bias beyond which a rest of BRIEF_REST_S denies it; a vehicle at rest leans by so
# much meanwhile, rad.
MOST_AT_REST, LEANS = 5.0, 3e-4
# Least difference of attitude that is reported: in sigmas; with another latency, rad; with another
# arm, rad. Sigmas include the turn of a filter by a wrong arm, but not that of its start.
MOST_TURNED, LEAST_TURNED, LEAST_BY_ARM = 4.0, 2.0 * DEGREE, 5.0 * DEGREE
# The difference of two attitudes is this percentile over time.
MOST_OF_IT = 90.0
# Noise of velocities compared with the IMU, over the bound by the receiver's own positions, beyond
# which they do not fit.
MOST_UNEXPLAINED = 1.3
# Noise of gyros over that of a low-cost grade beyond which they are no gyros: 10 deg/sqrt(h) is six
# times what data sheets of the noisiest chips give.
MOST_NOISIER = 3.5
# Slow errors of fixes over those that the receiver states beyond which a latency that the log seems
# to show does not refute another clock.
MOST_WANDERING = 3.0


def compare_with_log(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> FilterStart:
    """A start with the measures that :func:`contradictions` compares with their limits."""
    if imu_stated(config):
        drift = Drift(source, config, algorithm, start.by_the_fixes)
        likelier = _likelier(source, config, algorithm, start)
        known = config.align.gyro_bias not in ("still", "none")
        start = replace(
            start,
            drifts=drift.ratio,
            likelier=likelier,
            bias_at_rest=0.0 if known else _bias_at_rest(source, start.settings.imu),
        )
    start = settled_delay(source, config, algorithm, start)
    return replace(
        start,
        turned=_turned(source, config, algorithm, start),
        unexplained=_unexplained(source, config, algorithm, start),
    )


def _likelier(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> LikelierGrade | None:
    """A worse grade than that of an option with which the innovations are far likelier.

    Errors of scale factors and axes show as the vehicle turns, where fixes are never missing and
    no drift without them shows anything. All grades are compared with a state for each error. None
    if the innovations are as large as expected, and where another option may be wrong instead. A
    lever arm that seems to be wrong may seem so because of the grade, if with a worse one the given
    arm is as likely as that of the log.
    """
    if config.navigation.imu_grade == "auto" or noise_stated(config):
        return None
    if receiver_stated(config) or _late(start):
        return None

    def fitted(grade: Grade, start: FilterStart) -> Fit | None:
        imu = imu_noise(config, grade, has_scales(config))
        settings = replace(start.settings, imu=imu, filter="network-29a")
        return fit(source, config, algorithm, replace(start, settings=settings))

    shown = start.by_the_fixes
    same = shown.settings == start.settings
    stated, grade = fitted(start.grade.grade, shown), next_worse(start.grade.grade)
    best: LikelierGrade | None = None
    while grade is not None and stated is not None and stated.doubted:
        other = fitted(grade, start)
        moved = other if same else fitted(grade, shown)
        if other is not None and moved is not None and not other.worse_than(moved):
            gain = stated.epochs * (stated.cost - other.cost)
            if gain > (MOST_UNLIKELY if best is None else best.gain):
                best = LikelierGrade(grade, gain)
        grade = next_worse(grade)
    return best


def _bias_at_rest(source: Source, imu: SensorGrade) -> float:
    """Least gyro bias that the longest rest allows, over its sigma; 0 without such a rest.

    About the vertical the rate of the Earth is known there, and about the level at most so large.
    """
    rest = longest_rest(source.survey.spans, source.aiding.gnss)
    if rest is None or rest.duration_s < BRIEF_REST_S or source.latitude is None:
        return 0.0
    up = rest.accel / np.linalg.norm(rest.accel)
    upward = float(rest.gyro @ up)
    level = float(np.linalg.norm(rest.gyro - upward * up))
    north, _, down = earth_rate_n(source.latitude)
    off = max(abs(upward + float(down)), level - float(north))
    by_chance = rest.gyro_std / np.sqrt(rest.samples)
    leans = LEANS / rest.duration_s
    return off / float(np.linalg.norm([imu.gyro_bias, imu.gyro_instability, by_chance, leans]))


def _turned(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> tuple[float, float]:
    """Turn of the attitude, in sigmas and in rad, by a latency or arm that the log contradicts.

    The difference to a filter that starts with the latency and arm of the log; 0 if the log
    contradicts neither. A start from fixes with a wrong time or place may be far off, whatever its
    sigmas.
    """
    shown = start.offsets
    if shown is None or not (_late(start) or shown.arm_contradicts):
        return 0.0, 0.0
    settings = start.by_the_fixes.settings
    gnss = {"gnss_latency": settings.gnss_latency, "lever_arm": settings.lever_arm_b}
    timed = config.model_copy(update={"gnss": config.gnss.model_copy(update=gnss)})
    try:
        other = first_start(source, timed, start.grade, start.lag)
    except AlignmentError:
        return 0.0, 0.0
    return _attitudes_apart(source, config, algorithm, (start, other))


def _late(start: FilterStart) -> bool:
    """Whether the log shows another latency than a given one."""
    shown, given = start.offsets, start.latency_status == "given"
    return given and shown is not None and shown.latency_contradicts(start.settings.gnss_latency)


def _unexplained(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> float:
    """Noise of velocities compared with the IMU, over the bound by the receiver's own positions.

    If it is much more with any latency and lever arm, the attitude is wrong, or the fixes belong to
    another time.
    """
    gnss = source.aiding.gnss
    most = np.nan if gnss is None else velocity_noise_bound(gnss)
    if not start.velocity_noise[0] > most:
        return 0.0
    shown = white_noise(source, config, algorithm, start.by_the_fixes)
    return 0.0 if shown is None else float(np.nan_to_num(shown.velocity[0] / most))


def _attitudes_apart(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, starts: Sequence[FilterStart]
) -> tuple[float, float]:
    """Difference of the attitudes of filters from two starts, in sigmas and in rad.

    About the axis of NED on which they differ most, over the first part of the log: the percentile
    `MOST_OF_IT`.
    """
    runs = []
    for start in starts:
        motion = motion_from(source, config, algorithm, start.time_ns)
        if motion is None:
            return 0.0, 0.0
        run = InsGnssFilter(start.start, start.settings, with_baro=False)
        updates = run.push(motion, start.used).updates
        assert updates is not None
        runs.append(updates)
    one, other = runs
    row = np.searchsorted(other.time_ns, one.time_ns)
    both = (row > 0) & (row < len(other))
    if not both.any():
        return 0.0, 0.0
    row = row[both]
    turn = np.abs(log(multiply(one.q_nb[both], conjugate(other.q_nb[row]))))
    covariance = one.covariance_attitude_n[both] + other.covariance_attitude_n[row]
    sigmas = turn / np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    most = np.percentile(sigmas, MOST_OF_IT, axis=0)
    axis = int(np.argmax(most))
    return float(most[axis]), float(np.percentile(turn[:, axis], MOST_OF_IT))


def contradictions(start: FilterStart, survey: Sequence[Finding]) -> list[Finding]:
    """Findings where a log contradicts the start of a filter, its settings or its fixes.

    Parameters
    ----------
    survey : sequence of Finding
        About the log.
    """
    return [
        *(drifts_too_far(start.drifts) or far_likelier(start) or denied_at_rest(start)),
        *turned_by_offsets(start),
        *late_gyros(start),
        *denied_attitude(start),
        *unexplained_velocities(start),
        *impossible_gyros(start, survey),
        *of_another_clock(survey, start),
    ]


def drifts_too_far(ratio: float) -> list[Finding]:
    """A drift without fixes that is far more than the options about the IMU allow.

    Parameters
    ----------
    ratio : float
        Drift over its sigma.
    """
    if ratio <= MOST_DRIFT:
        return []
    return [
        Finding(
            "imu-options",
            f"without fixes, the navigation drifts {ratio:.1f} times as far as the options about"
            " the IMU allow: do not trust the attitude and its sigmas",
            Severity.LOST,
            "leave --imu-grade, --imu-noise, --arw and --vrw out, or correct them",
            numbers={"drift_over_sigma": ratio},
        )
    ]


def far_likelier(start: FilterStart) -> list[Finding]:
    """A worse grade of the IMU with which the fixes are far likelier than with the stated one."""
    if start.likelier is None:
        return []
    other, stated = start.likelier.grade, start.grade.grade
    return [
        Finding(
            "imu-options",
            f"the fixes are far likelier with an IMU of grade {other} than with --imu-grade"
            f" {stated}: do not trust the sigmas",
            Severity.LOST,
            "leave --imu-grade out, or correct it",
            numbers={"log_likelihood_gain": 0.5 * start.likelier.gain},
        )
    ]


def denied_at_rest(start: FilterStart) -> list[Finding]:
    """Gyros whose bias at rest is far beyond what options about the IMU allow.

    The heading of such gyros follows from the Earth's rate, and their bias from motion.
    """
    if start.bias_at_rest <= MOST_AT_REST:
        return []
    return [
        Finding(
            "imu-options",
            f"at rest, the bias of the gyros is at least {start.bias_at_rest:.0f} times the sigma"
            " that the options about the IMU give it: do not trust the attitude and its sigmas",
            Severity.LOST,
            "leave --imu-grade and --imu-noise out, correct them, or give --sigma-bg",
            numbers={"bias_over_sigma": start.bias_at_rest},
        )
    ]


def turned_by_offsets(start: FilterStart) -> list[Finding]:
    """An attitude turned by a latency or lever arm that the log contradicts."""
    sigmas, angle = start.turned
    shown, settings = start.offsets, start.settings
    if shown is None or sigmas <= MOST_TURNED:
        return []
    if angle <= (LEAST_BY_ARM if shown.arm_contradicts else LEAST_TURNED):
        return []
    if shown.arm_contradicts:
        kind, option, value = "stated-lever-arm", "--lever-arm", "a lever arm of"
        one = ",".join(f"{x:.2f}" for x in shown.arm_b.tolist()) + " m"
        other = ",".join(f"{x:.2f}" for x in settings.lever_arm_b) + " m"
    else:
        kind, option, value = "stated-latency", "--gnss-latency", "a GNSS latency of"
        one, other = (f"{1e3 * x:.0f} ms" for x in (shown.latency_s, settings.gnss_latency))
    return [
        Finding(
            kind,
            f"the log shows {value} {one}; the attitude with it differs by {angle / DEGREE:.0f} deg"
            f" ({sigmas:.0f} sigmas) from the attitude with {option} {other}: do not trust the"
            " attitude and its sigmas",
            Severity.LOST,
            f"correct {option}",
            numbers={"attitude_deg": angle / DEGREE, "attitude_over_sigma": sigmas},
        )
    ]


def unexplained_velocities(start: FilterStart) -> list[Finding]:
    """Velocities that fit the receiver's own positions, and not the IMU."""
    if start.unexplained <= MOST_UNEXPLAINED:
        return []
    return [
        Finding(
            "velocities-do-not-fit",
            "compared with the IMU, the receiver's velocities are"
            f" {start.unexplained:.1f} times as noisy as its own positions allow, and none of the"
            " latencies and lever arms tried explains it: do not trust the attitude and its sigmas",
            Severity.LOST,
            "check the clocks (--gnss-clock-offset, --gnss-latency), the axes and units of the IMU",
            numbers={"noise_ratio": start.unexplained},
        )
    ]


def impossible_gyros(start: FilterStart, survey: Sequence[Finding]) -> list[Finding]:
    """A drift without fixes that no gyro explains, whatever its grade.

    Gyros whose axes or signs are wrong, or of another time, are estimated as noisy ones, and so are
    those of which an autopilot logs ten samples a second, taken at instants. The filter then
    follows the fixes, and all innovations are as large as its sigmas say; its attitude is not. So
    it is where sensors lose what is beyond their range.
    """
    if start.noisier_gyros <= MOST_NOISIER:
        return []
    text = (
        "without fixes, the navigation drifts as if the gyros were"
        f" {start.noisier_gyros:.1f} times as noisy as those of bare chips, which none are: "
    )
    if any(finding.kind == SATURATION for finding in survey):
        text += "what is beyond the range of a saturated sensor is lost"
        answer = "use a larger range"
    else:
        text += (
            "gyros, accelerometers and fixes do not belong together, or samples of single instants"
            " are too rare for the motion"
        )
        answer = (
            "check axes, signs and units of the IMU, the clocks (--gnss-clock-offset), and whether"
            " the fixes are good; log more than 50 samples a second"
        )
    return [
        Finding(
            "gyros-do-not-fit",
            f"{text}; do not trust the attitude and its sigmas",
            Severity.LOST,
            answer,
            numbers={"gyro_noise": start.noisier_gyros},
        )
    ]


def of_another_clock(survey: Sequence[Finding], start: FilterStart) -> list[Finding]:
    """Fixes stamped by another clock than the IMU's, unless the motion shows that they fit.

    Parameters
    ----------
    survey : sequence of Finding
        About the log.

    Returns
    -------
    list of Finding
        The finding of the survey, with its consequence for the run.
    """
    clock = next((f for f in survey if f.kind == RECEIVER_CLOCK), None)
    shown = start.offsets
    if clock is None or (
        shown is not None
        and start.latency_status in ("found", "given")
        and shown.sigma_s <= MAX_SIGMA_S
        # Fixes at the times of others seem to wander
        and max(start.slow_errors) <= MOST_WANDERING
        and not shown.latency_contradicts(start.settings.gnss_latency)
    ):
        return []
    text = (
        f"{clock.text}, so every fix is used at a time that is wrong by as much: do not trust the"
        " solution"
    )
    return [replace(clock, text=text, severity=Severity.LOST)]
