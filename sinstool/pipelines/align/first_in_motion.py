"""The first attitude by GNSS velocity, in motion, carried back to where a run begins."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.arrays import IntArray
from sinstool.core.choices import log_choice
from sinstool.core.errors import AlignmentError
from sinstool.core.rotation import exp, multiply
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.alignment import initial
from sinstool.methods.alignment.initial import Alignment, off_level, tilted
from sinstool.methods.alignment.preparation import BRIDGED_NS
from sinstool.methods.alignment.still import StillSpan
from sinstool.methods.sensor_errors import Grade
from sinstool.survey.grade import sensor_grade
from sinstool.survey.receiver_ahead import RECEIVER_CLOCK
from sinstool.survey.source import Source, rate_blocks

# Alignment in motion is imported where it is used: most logs do not need it, and it takes as long
# to import as an hour of attitude.
if TYPE_CHECKING:
    from sinstool.methods.alignment.in_motion import MotionAlignment

# An attitude found in motion denies a rest by more sigmas than this, if the rest is no longer than
# vehicles brake or speed up evenly, s.
MOST_OFF_LEVEL, EVEN_S = 5.0, 10.0
# A filter is linear in its errors: with a larger sigma of the attitude it starts later.
FILTER_SIGMA = 10.0 * DEGREE
# A filter that starts within this time of a fix, s, starts at it.
AT_FIX_S = 0.03
NO_BIAS = f"{initial.NOT_STILL}, so no gyro bias is removed"


def by_velocity(
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
    held = _held_in_rest(moving, source, config, begin_ns, limit)
    time_ns, q_nb, covariance = held or _carried_back(moving, source, config, begin_ns, limit)
    if later_ns is not None and held is None:
        far = (np.abs(later_ns - time_ns) > AT_FIX_S * SECOND).all()
        after = later_ns[(later_ns >= result.t_ns) & (later_ns <= result.t_stop_ns)]
        if far and len(after):
            time_ns, q_nb, covariance = _carried_back(moving, source, config, int(after[0]), limit)
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


def _held_in_rest(
    moving: MotionAlignment, source: Source, config: ProcessConfig, time_ns: int, most_sigma: float
) -> tuple[int, np.ndarray, np.ndarray] | None:
    """Attitude and covariance at a time in a rest at the beginning, through which they stay.

    Returns
    -------
    (int, ndarray, ndarray) or None
        None if the time is not in a rest, if the rest cannot be reached, or if the attitude denies
        it.
    """
    result, still = moving.result, source.survey.lead_in
    if still is None or time_ns > still.end_ns:
        return None
    if result.t_ns <= still.end_ns:
        return time_ns, result.q_nb, result.cov
    reached_ns, q_nb, covariance = _carried_back(moving, source, config, still.end_ns, most_sigma)
    accel_bias = moving.settings.grade.accel_bias
    if reached_ns != still.end_ns or denies_rest(q_nb, covariance, still, accel_bias):
        return None
    return time_ns, *tilted(q_nb, covariance, still.accel, accel_bias)


def denies_rest(
    q_nb: np.ndarray, covariance: np.ndarray, still: StillSpan, accel_bias: float
) -> bool:
    """Whether an attitude found in motion denies that a vehicle rested before.

    A car that brakes evenly for a second or two looks at rest to its IMU, and fixes seldom tell.

    Parameters
    ----------
    q_nb, covariance, accel_bias
        See :func:`~sinstool.methods.alignment.initial.tilted`.
    """
    off = off_level(q_nb, covariance, still.accel, accel_bias)
    return off > MOST_OFF_LEVEL and still.duration_s < EVEN_S


def _carried_back(
    moving: MotionAlignment, source: Source, config: ProcessConfig, time_ns: int, most_sigma: float
) -> tuple[int, np.ndarray, np.ndarray]:
    """Attitude and covariance at a time, or at the original time if that cannot be reached.

    It cannot if the IMU has a gap in between, or if the sigma, rad, would exceed the limit: the
    gyros carry it back, and the sigma grows by their biases. Where nothing limits it, gaps are
    crossed that an alignment crosses, too: the sigma grows by what may have happened there.
    """
    result = moving.result
    if result.t_ns == time_ns:
        return time_ns, result.q_nb, result.cov
    if result.t_ns < time_ns:
        return time_ns, result.attitude_at(np.array([time_ns]))[0], result.cov
    from sinstool.pipelines.align.in_motion import increments

    imu = increments(source, config, moving.refined_bias, result.t_ns, time_ns)
    longest_ns = max(source.survey.max_gap_ns, 0 if np.isfinite(most_sigma) else BRIDGED_NS)
    if not len(imu) or (np.diff(imu.time_ns) > longest_ns).any():
        return result.t_ns, result.q_nb, result.cov
    q_nb, covariance = moving.carried_back(imu)
    if np.sqrt(np.diag(covariance).max()) > most_sigma:
        return result.t_ns, result.q_nb, result.cov
    return time_ns, q_nb, covariance


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
