"""A start carried back over IMU gaps that a filter bridges, to where its log begins.

Where a log has a gap every few seconds, no part of it between two gaps may be long enough to show
an attitude, except one late in the log. That attitude is carried back over a few gaps, in which
the vehicle turned by an unknown angle, until it is as uncertain as a filter can start from. From
there a smoother finds it as accurately as the next minutes show it, and it is carried on.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.choices import log_choice
from sinstool.core.errors import AlignmentError
from sinstool.core.streams import concatenate, take_rows
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.alignment.initial import Alignment
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.ins_gnss.carried_back import carried_back, navigated_back
from sinstool.methods.ins_gnss.instants import GAP_TIME
from sinstool.methods.ins_gnss.motion import BESIDE
from sinstool.methods.ins_gnss.settings import Start
from sinstool.methods.strapdown.joined_updates import JOINED_S, joined_updates
from sinstool.methods.strapdown.navigation import Q_W, Q_Z
from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.iterated_start import (
    SmoothedStart,
    iterated,
    smoothed_over,
)
from sinstool.pipelines.process.ins_gnss.timing import motion_from
from sinstool.survey.grade import to_align_as
from sinstool.survey.increments import SegmentIncrements
from sinstool.survey.source import Source

# Sigmas up to which a smoother finds a tilt and a heading again, rad.
TILT_SIGMA, HEADING_SIGMA = 35.0 * DEGREE, 20.0 * DEGREE
# A step goes back no further than this; a smoother finds its attitude from so much that follows.
MOST_NS, SMOOTHED_NS = 120 * SECOND, 150 * SECOND
# By how much -2 log likelihood of a fix may rise from step to step.
MOST_RISE = 3.0
# A start this shortly after a fix has its position.
AT_FIX_NS = SECOND // 5


def start_over_gaps(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    start: FilterStart,
    first_ns: int,
) -> FilterStart:
    """A start as early as it can be carried back over gaps.

    Parameters
    ----------
    first_ns : int
        No earlier than this.

    Returns
    -------
    FilterStart
        The start that was given if it cannot be carried back over the gap before it.
    """
    begun, smoothed = start, _smoothed(source, config, algorithm, start)
    while smoothed is not None:
        step = _step(source, config, algorithm, start, smoothed, first_ns)
        if step is None:
            break
        start, smoothed = step
    if start is begun:
        return start
    seconds = (begun.time_ns - start.time_ns) / SECOND
    how = f"{begun.how}; carried back over gaps of the IMU by another {seconds:.0f} s"
    log_choice("start before gaps", how)
    return replace(start, how=how)


def _step(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    start: FilterStart,
    smoothed: SmoothedStart,
    first_ns: int,
) -> tuple[FilterStart, SmoothedStart] | None:
    """A start before at least one more gap, and smoothed; None where that is too uncertain."""
    if not any(first_ns < ns < start.time_ns for ns, _ in source.survey.gaps):
        return None
    begin_ns = max(first_ns, start.time_ns - MOST_NS)
    updates, bridged = _updates(source, config, algorithm, begin_ns, start.time_ns)
    if updates is None:
        return None
    q_nb, covariance = _carried(smoothed.start, start, updates, bridged)
    tilt = np.sqrt(np.linalg.eigvalsh(covariance[:, :2, :2])[:, -1])
    crossed = np.cumsum(bridged[::-1], dtype=np.int64)[::-1]
    rows = _after_fixes(start, updates.time_ns)
    sure = (tilt < TILT_SIGMA) & (np.sqrt(covariance[:, 2, 2]) < HEADING_SIGMA)
    rows = rows[(sure & ~bridged & (crossed > 0))[rows]]
    for row in choices_of_rows(rows, crossed):
        alignment = _alignment(start.alignment, smoothed.start, q_nb[row], covariance[row])
        alignment = replace(alignment, time_ns=int(updates.time_ns[row]))
        earlier = _begun(source, config, algorithm, start, alignment)
        if earlier is not None:
            again = _smoothed(source, config, algorithm, earlier)
            # A wrong attitude makes the fixes that follow unlikely: then over fewer gaps
            if again is not None and _rise(smoothed, again) < MOST_RISE:
                return earlier, again
    return None


def choices_of_rows(rows: IntArray, crossed: IntArray) -> list[int]:
    """The earliest of some rows, and the earliest over half as many gaps, and so on."""
    most, chosen = int(crossed[rows].max(initial=0)), list[int]()
    while most:
        within = rows[crossed[rows] <= most]
        if len(within) and int(within[0]) not in chosen:
            chosen.append(int(within[0]))
        most //= 2
    return chosen


def _rise(before: SmoothedStart, after: SmoothedStart) -> float:
    """By how much -2 log likelihood of a fix has risen."""
    return after.cost / after.epochs - before.cost / before.epochs


def _begun(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    start: FilterStart,
    alignment: Alignment,
) -> FilterStart | None:
    """The same filter from another attitude; None without fixes near it."""
    try:
        begun = start.from_attitude(source, to_align_as(config, start.grade), alignment)
    except AlignmentError:
        return None
    return replace(begun, start=iterated(begun, _following(source, config, algorithm, begun)))


def _following(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> Increments | None:
    """Increments of the next minutes."""
    motion = motion_from(source, config, algorithm, start.time_ns)
    if motion is None:
        return None
    return take_rows(motion, motion.time_ns <= start.time_ns + SMOOTHED_NS)


def _smoothed(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> SmoothedStart | None:
    """The start as smoothed over what follows."""
    motion = _following(source, config, algorithm, start)
    return (
        None
        if motion is None
        else smoothed_over(start, joined_updates(motion, JOINED_S, start.valid_ns))
    )


def _updates(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, begin_ns: int, end_ns: int
) -> tuple[Increments | None, BoolArray]:
    """Updates of a time, those that bridge its gaps among them, and which these are."""
    steps = SegmentIncrements(source, config, algorithm)
    made = [part for part, _, _ in steps.from_time(begin_ns, end_ns + SECOND)]
    nothing = None, np.zeros(0, dtype=np.bool_)
    if not made:
        return nothing
    # A little more, as the start may be the first sample after a gap
    updates = concatenate(made)
    after = int(np.searchsorted(updates.time_ns, end_ns + round(BESIDE * SECOND), "right"))
    updates = take_rows(updates, slice(0, max(after, 1)))
    whole, bridged = with_bridges(updates)
    inside = whole.time_ns <= end_ns
    if not inside.any() or int(whole.time_ns[inside][-1]) != end_ns:
        return nothing  # the start is no end of an update
    return take_rows(whole, inside), bridged[inside]


def with_bridges(updates: Increments) -> tuple[Increments, BoolArray]:
    """Updates with another for each gap, of the mean motion on both sides as in a filter."""
    dt = updates.interval
    waited = np.diff(updates.time_ns) / SECOND - dt[1:]
    after = np.flatnonzero(waited > 0.5 * dt[1:]) + 1
    number = max(1, round(BESIDE / float(np.median(dt))))
    edges = np.concatenate([[0], after, [len(dt)]])
    motion = np.column_stack([updates.rotation_vector, updates.velocity_increment])
    between = np.empty((len(after), 6))
    for k, row in enumerate(after):
        sides = (
            slice(max(edges[k], row - number), row),
            slice(row, min(edges[k + 2], row + number)),
        )
        means = [motion[side].sum(axis=0) / dt[side].sum() for side in sides]
        between[k] = 0.5 * waited[row - 1] * (means[0] + means[1])
    ends = updates.time_ns[after] - np.rint(dt[after] * SECOND).astype(np.int64)
    motion = np.insert(motion, after, between, axis=0)
    whole = Increments(
        np.insert(updates.sample, after, updates.sample[after - 1]),
        np.insert(updates.time_ns, after, ends),
        np.insert(dt, after, waited[after - 1]),
        motion[:, :3],
        motion[:, 3:],
        lost=None if updates.lost is None else np.insert(updates.lost, after, 0.0, axis=0),
    )
    return whole, np.insert(np.zeros(len(dt), np.bool_), after, True)


def _carried(
    corrected: Start, start: FilterStart, updates: Increments, bridged: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Attitude at each update's end, and its covariance, rad^2."""
    q_nb = navigated_back(corrected, updates)[:, Q_W : Q_Z + 1]
    rates = np.array([start.settings.gap_tilt_rate] * 2 + [start.settings.gap_rate])
    turned = rates**2 * GAP_TIME * updates.interval[:, None]
    unseen = np.where(bridged[:, None], turned, 0.0)
    seconds, nodes = carried_back(corrected, start.settings.imu, updates, q_nb, unseen)
    before = (updates.time_ns[-1] - updates.time_ns) / SECOND
    # Of a step with a gap in it, all of which may lie behind the row, the covariance is the larger
    at = np.clip(np.searchsorted(seconds, before), 0, len(seconds) - 1)
    return q_nb[1:], nodes[at, 6:, 6:]


def _after_fixes(start: FilterStart, time_ns: IntArray) -> IntArray:
    """The first update's end after each position, in order."""
    late = start.late_ns
    valid = start.used.time_ns[start.used.has_position] - late
    row = np.searchsorted(time_ns, valid)
    inside = row < len(time_ns)
    row, valid = row[inside], valid[inside]
    return np.asarray(row[time_ns[row] - valid < AT_FIX_NS])


def _alignment(
    like: Alignment, corrected: Start, q_nb: FloatArray, covariance: FloatArray
) -> Alignment:
    """An alignment with this attitude and the gyro bias of a corrected start."""
    sigma = np.sqrt(np.diag(covariance))
    return replace(
        like,
        q_nb=q_nb,
        covariance_n=covariance,
        sigma_rad=(float(sigma[0]), float(sigma[1]), float(sigma[2])),
        gyro_bias=corrected.gyro_bias,
        gyro_bias_sigma=corrected.gyro_bias_sigma,
        bias_source="alignment",
    )
