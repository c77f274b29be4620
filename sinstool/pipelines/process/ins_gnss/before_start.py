"""The time before a filter's start: its state carried back over the samples."""

from __future__ import annotations

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.finding import Finding, Severity
from sinstool.core.streams import Imu, Solution, concatenate, take_rows
from sinstool.core.timeline import SECOND
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.ins_gnss.carried_back import carried_back, navigated_back
from sinstool.methods.ins_gnss.constraints import REST_VELOCITY
from sinstool.methods.ins_gnss.settings import Start
from sinstool.methods.ins_gnss.smoothed_epochs import SmoothedEpochs
from sinstool.methods.ins_gnss.smoother import corrected_navigation
from sinstool.methods.ins_gnss.states import (
    ACCEL_BIAS,
    ATTITUDE,
    GYRO_BIAS,
    POSITION,
    VELOCITY,
    FilterKind,
)
from sinstool.methods.strapdown.navigation import (
    HEIGHT,
    LATITUDE,
    LONGITUDE,
    Q_W,
    Q_Z,
    V_DOWN,
    V_NORTH,
)
from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.survey.imu import Survey
from sinstool.survey.increments import SegmentIncrements
from sinstool.survey.source import Source

# Further back the position is of no use any more.
MAX_NS = 300 * SECOND
# Share of a log with fixes without a solution beyond which it is no solution of this log.
MOST_WITHOUT = 0.5
# What is carried back for no longer than this is as good as the start.
BRIEF_NS = SECOND
# Where a log has fixes, a solution less certain than this, m, is of no use.
USELESS_M = 100.0


def corrected_start(
    start: Start, error: np.ndarray, covariance: np.ndarray, kind: FilterKind
) -> Start:
    """A start less the error that a smoother finds in it.

    Parameters
    ----------
    error : ndarray, shape (n,)
        Of the filter's states at the start.
    covariance : ndarray, shape (n, n)
        Of the corrected states.
    """
    nav = corrected_navigation(start.nav[np.newaxis], error[np.newaxis])[0]
    p, v, a = (slice(first, first + 3) for first in (POSITION, VELOCITY, ATTITUDE))
    gyro, accel = (
        slice(kind.first(block), kind.first(block) + 3) for block in (GYRO_BIAS, ACCEL_BIAS)
    )

    def block(part: slice) -> np.ndarray:
        square = 0.5 * (covariance[part, part] + covariance[part, part].T)
        values, vectors = np.linalg.eigh(square)
        return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)

    return Start(
        nav,
        block(p),
        block(v),
        block(a),
        start.gyro_bias + error[gyro],
        start.accel_bias + error[accel],
        float(np.sqrt(np.max(np.diag(block(gyro))))),
        float(np.sqrt(np.max(np.diag(block(accel))))),
    )


def before_start(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    prepared: FilterStart,
    start: Start,
    rests: bool,
) -> Solution | None:
    """Solutions at the samples up to, and at, the one at which a filter starts.

    Parameters
    ----------
    start : Start
        That of the filter, or as corrected by a smoother.
    rests : bool
        The vehicle stands all the time before the start: its position there is kept.

    Returns
    -------
    Solution or None
        None where the log has no such samples. Samples before a gap, or more than five minutes
        before the start, are left out.
    """
    first = max(source.survey.first_ns, prepared.time_ns - MAX_NS)
    steps = SegmentIncrements(source, config, algorithm)
    made: list[Increments] = []
    samples: list[Imu] = []
    for increments, imu, opening in steps.from_time(first):
        if opening is not None:  # a segment begins here: nothing before the gap can be reached
            if int(opening.time_ns[0]) > prepared.time_ns:
                break
            made, samples = [], [opening]
        before = increments.time_ns <= prepared.time_ns
        made.append(take_rows(increments, before))
        samples.append(imu.rows(before))
        if not before.all():
            break
    if not made or int(samples[0].time_ns[0]) > prepared.time_ns:
        return None
    updates = concatenate(made)
    if len(updates.time_ns) and int(updates.time_ns[-1]) != prepared.time_ns:
        return None  # the start is no end of an update
    rows = navigated_back(start, updates)
    if rests:
        rows[:, [LATITUDE, LONGITUDE, HEIGHT]] = start.nav[[LATITUDE, LONGITUDE, HEIGHT]]
        rows[:, V_NORTH : V_DOWN + 1] = 0.0
    imu = concatenate(samples)
    nodes, covariance = carried_back(start, prepared.settings.imu, updates, rows[:, Q_W : Q_Z + 1])
    seconds = (prepared.time_ns - imu.time_ns) / SECOND
    at = np.clip(np.searchsorted(nodes, seconds), 1, len(nodes) - 1)
    share = ((nodes[at] - seconds) / (nodes[at] - nodes[at - 1]))[:, None, None]

    def block(part: slice) -> np.ndarray:
        c = covariance[:, part, part]
        return np.asarray(share * c[at - 1] + (1.0 - share) * c[at])

    position, velocity, attitude = (block(slice(k, k + 3)) for k in (0, 3, 6))
    if rests:
        position = np.broadcast_to(start.covariance_position_n, position.shape)
        velocity = np.broadcast_to(REST_VELOCITY**2 * np.eye(3), velocity.shape)
    vertical = None
    if prepared.reference is not None:
        vertical = np.stack([rows[:, HEIGHT], -rows[:, V_DOWN], np.zeros(len(rows))], axis=1)
    return Solution(
        imu.time_ns,
        imu.log_time_ns,
        rows[:, Q_W : Q_Z + 1],
        imu.gyro - start.gyro_bias,
        imu.accel - start.accel_bias,
        np.stack([rows[:, LATITUDE], rows[:, LONGITUDE], rows[:, HEIGHT]], axis=1),
        rows[:, V_NORTH : V_DOWN + 1],
        vertical,
        position,
        velocity,
        attitude,
    )


def before_start_finding(survey: Survey, start: FilterStart, earliest: Solution | None) -> Finding:
    """What a solution contains of the time before a filter's start.

    Parameters
    ----------
    start : FilterStart
        Behind the log's first sample.
    earliest : Solution or None
        The first solution, if any is carried back.

    Returns
    -------
    Finding
        Lost if most of the log from its first fix on has no solution, or if one that is carried
        back is of no use beside the fixes there; a note where no more than a second is carried
        back.
    """
    begin_ns, first_ns = survey.first_ns, start.time_ns
    if earliest is not None:
        first_ns = int(earliest.time_ns[0])
    text = before_start_text((first_ns - begin_ns) / SECOND, (start.time_ns - begin_ns) / SECOND)
    fixes = start.used.time_ns[start.used.has_position]
    from_ns = max(begin_ns, int(fixes[0])) if len(fixes) else begin_ns
    answer = "give the first attitude with --align fixed --initial-attitude ROLL,PITCH,HEADING"
    if first_ns - from_ns > MOST_WITHOUT * (survey.last_ns - from_ns):
        span_ns = begin_ns, first_ns
        return Finding("before-start", text, Severity.LOST, answer, "", *span_ns)
    if earliest is not None and earliest.covariance_position_n is not None:
        variance = np.diag(earliest.covariance_position_n[0])[:2]
        sigma = float(np.sqrt(variance.max()))
        unused = int(np.count_nonzero((fixes >= first_ns) & (fixes < start.time_ns - BRIEF_NS)))
        if unused and sigma > USELESS_M:
            text += (
                f"; fixes there ({unused}) are not used, and positions are uncertain by up to"
                f" {sigma:.0f} m (1 sigma)"
            )
            numbers = {"position_m": sigma, "fixes": float(unused)}
            span_ns = first_ns, start.time_ns
            return Finding("before-start", text, Severity.LOST, answer, "", *span_ns, numbers)
    brief = start.time_ns - begin_ns < BRIEF_NS and first_ns <= begin_ns
    return Finding("before-start", text, Severity.NOTE if brief else Severity.WARNING)


def before_start_text(without_s: float, before_s: float) -> str:
    """What a solution contains of the time before a filter's start, in words.

    Parameters
    ----------
    without_s, before_s : float
        From the log's first sample to the first solution, and to the start, s.
    """
    carried = "the solution there is that of the start, carried back by the IMU alone"
    if without_s <= 0.0:
        return f"the first {before_s:.2f} s lie before the filter's start: {carried}"
    lost = f"the first {without_s:.2f} s lie before the filter's start and have no solution"
    if before_s - without_s < 0.01:
        return lost
    return f"{lost}; so do the {before_s - without_s:.2f} s that follow, but {carried}"


def smoothed_start(start: Start, smoothed: SmoothedEpochs) -> Start:
    """A start corrected by smoothing over what follows; unchanged where that is not possible."""
    if not np.isfinite(smoothed.first_error).all():
        return start
    return corrected_start(start, smoothed.first_error, smoothed.first_covariance, smoothed.kind)
