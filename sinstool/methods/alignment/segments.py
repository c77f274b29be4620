"""Segments of a log for alignment: choose them, screen fixes, apply the gate, solve."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray
from sinstool.core.order_statistics import median
from sinstool.core.rotation import skew, to_dcm
from sinstool.core.streams import take_rows
from sinstool.core.timeline import clock_time
from sinstool.core.units import STANDARD_GRAVITY
from sinstool.methods.alignment import gate, preparation
from sinstool.methods.alignment.accumulation import InertialRows, accumulate
from sinstool.methods.alignment.covariance import worst_sigma
from sinstool.methods.alignment.derived_rates import GRID_S, slopes
from sinstool.methods.alignment.inflight_types import (
    AlignmentSettings,
    GnssFixes,
    ImuIncrements,
)
from sinstool.methods.alignment.pairs import window_rows
from sinstool.methods.alignment.solution import (
    Course,
    Segment,
    Solution,
    course,
    solution_covariance,
    solve,
)
from sinstool.methods.sensor_errors import LIKELY, SensorGrade
from sinstool.methods.strapdown.followed_rates import followed_rates

MANY_REJECTED = 0.2
NEIGHBOURS = 5
SIGMAS = 5.0
LENGTH_SHARE = 0.002
"""Allowed difference of lengths, relative: scale factors, curved paths, errors of the lever arm."""


@dataclass(frozen=True)
class Candidate:
    """A segment that was solved.

    Attributes
    ----------
    stretch : Stretch
        In which it lies.
    fixes : GnssFixes
        Those of the segment.
    positions : GnssFixes
        All of the stretch.
    start_ns, stop_ns : int
        Of the gate.
    rejected : int
        Fixes that the screen left out.
    sigma_worst : float
        At the last fix, rad.
    """

    stretch: preparation.Stretch
    segment: Segment
    fixes: GnssFixes
    positions: GnssFixes
    start_ns: int
    stop_ns: int
    rejected: int
    solution: Solution
    course: Course | None
    sigma_worst: float
    warnings: list[str]

    @property
    def many_rejected(self) -> bool:
        """Whether too many fixes do not fit to be outliers of a receiver."""
        return self.rejected > MANY_REJECTED * (self.rejected + len(self.fixes))


def plausible_fixes(
    alpha: FloatArray, beta: FloatArray, sigma: FloatArray, share: float = LENGTH_SHARE
) -> BoolArray:
    """Fixes whose velocity agrees with most of its neighbours; needs no attitude.

    A rotation leaves lengths as they are: between two fixes the integrated vector must be as long
    in the inertial measurements as in the velocities, whatever the attitude.

    Parameters
    ----------
    alpha, beta : ndarray, shape (n, 3)
        Both integrated sides at the fixes, m/s.
    sigma : ndarray, shape (n,)
        Velocity noise, m/s per axis.
    share : float, optional
        By which the accelerometers may be off, as a fraction of the specific force.

    Returns
    -------
    ndarray of bool, shape (n,)
        At least half of the tests against up to 5 fixes on each side pass:
        ``| |d beta| - |d alpha| | <= 5 sqrt(s_k^2 + s_j^2) + share |d alpha|``. A fix without
        neighbours passes.
    """
    count = len(alpha)
    passed, tests = np.zeros(count), np.zeros(count)
    for shift in range(1, min(NEIGHBOURS, count - 1) + 1):
        length_a = np.linalg.norm(alpha[shift:] - alpha[:-shift], axis=-1)
        length_b = np.linalg.norm(beta[shift:] - beta[:-shift], axis=-1)
        limit = SIGMAS * np.hypot(sigma[shift:], sigma[:-shift]) + share * length_a
        good = np.abs(length_b - length_a) <= limit
        passed[shift:] += good
        passed[:-shift] += good
        tests[shift:] += 1
        tests[:-shift] += 1
    return np.asarray(2.0 * passed >= tests)


def _share(grade: SensorGrade) -> float:
    """By how much accelerometers may be off, as a fraction of a specific force of about 1 g."""
    likely = LIKELY * float(np.hypot(grade.accel_scale, grade.accel_bias / STANDARD_GRAVITY))
    return max(LENGTH_SHARE, likely)


def candidates(
    stretch: preparation.Stretch,
    fixes: GnssFixes,
    settings: AlignmentSettings,
    lift_off_ns: int,
    reasons: list[str],
) -> list[Candidate]:
    """Segments of one stretch that can be solved.

    Parameters
    ----------
    fixes : GnssFixes
        Of the whole log.
    reasons : list of str
        Gains why others could not.
    """
    imu = stretch.imu
    origin = int(imu.time_ns[0])
    inside = fixes.rows((fixes.time_ns >= origin) & (fixes.time_ns <= imu.time_ns[-1]))
    where = f"{(imu.time_ns[-1] - origin) * 1e-9:.1f} s from {clock_time(origin)}"
    if (imu.time_ns[-1] - origin) * 1e-9 < preparation.MIN_SPAN_S - 1.0 or len(inside) < 3:
        reasons.append(f"{where}: too short, or without fixes")
        return []
    rows, followed = _as_received(imu, inside)
    if not followed.all() and _long_enough(rows.time_s[followed]):
        # How the vehicle moved in the rest of their windows no IMU shows
        rows, inside = rows.rows(followed), inside.rows(followed)
    rows = rows.at_antenna(settings.lever_arm_b)
    motion = gate.dynamics(imu, settings.limits.smooth)
    restless = np.cumsum(~motion.within(settings.limits).all(axis=0), dtype=np.int64)
    sample = np.searchsorted(imu.time_ns, inside.time_ns)
    everything = Segment(
        rows,
        inside.latitude,
        inside.longitude,
        inside.height,
        inside.velocity_n,
        np.asarray(inside.sigma_v),
        preparation.noise_level(np.asarray(inside.sigma_v), float(median(np.diff(rows.time_s)))),
        restless[np.minimum(sample, len(restless) - 1)],
    )
    good = np.ones(len(rows), dtype=bool)
    if settings.screen and settings.vectors != "pos":
        share = _share(settings.grade)
        good = plausible_fixes(rows.alpha, everything.beta(), everything.sigma, share)
    edges, _ = preparation.gap_edges(rows.time_s[good])
    borders = rows.time_s[good][edges]
    begin_s = np.concatenate([[-np.inf], borders])
    end_s = np.concatenate([borders, [np.inf]])
    segments = []
    for begin, end in zip(begin_s, end_s, strict=True):
        part = (rows.time_s >= begin) & (rows.time_s < end)
        candidate = _candidate(
            stretch, everything, inside, motion, part, good, settings, lift_off_ns, reasons
        )
        if candidate is not None:
            segments.append(candidate)
    return segments


def _long_enough(time_s: FloatArray) -> bool:
    return len(time_s) >= 3 and float(time_s[-1] - time_s[0]) >= preparation.MIN_SPAN_S


def _as_received(imu: ImuIncrements, fixes: GnssFixes) -> tuple[InertialRows, BoolArray]:
    """The inertial side at fixes, whose velocities follow the motion as `fixes` says.

    Returns
    -------
    rows : InertialRows
    followed : ndarray of bool, shape (m,)
        Where the samples cover all of the time over which a velocity is a mean. Elsewhere a row is
        that of the fix itself.
    """
    origin_ns, asked_ns = int(imu.time_ns[0]), fixes.time_ns
    if fixes.derived_s is not None:
        every = max(round(GRID_S * 1e9 / float(median(np.diff(imu.time_ns)))), 1)
        asked_ns = np.union1d(asked_ns, imu.time_ns[1::every])
    made = accumulate(imu.time_ns, imu.delta_theta, imu.delta_velocity, asked_ns, origin_ns)
    rows = made.rows(np.searchsorted(asked_ns, fixes.time_ns))
    # The loops of a receiver do not follow vibration
    interval = np.diff(imu.time_ns, prepend=2 * imu.time_ns[0] - imu.time_ns[1]) * 1e-9
    rates = followed_rates(imu.time_ns, interval, imu.delta_theta)
    seconds = (imu.time_ns - origin_ns) * 1e-9
    rate_b = np.column_stack([np.interp(rows.time_s, seconds, column) for column in rates.T])
    rows = replace(rows, swing=to_dcm(rows.q) @ skew(rate_b))
    if fixes.derived_s is None:
        return rows, np.ones(len(rows), dtype=np.bool_)
    values = np.concatenate([made.xi, to_dcm(made.q).reshape(-1, 9)], axis=1)
    slope, whole = slopes(made.time_s, values, rows.time_s, fixes.derived_s)
    alpha = np.where(whole[:, None], slope[:, :3], rows.alpha)
    swing = np.where(whole[:, None, None], slope[:, 3:].reshape(-1, 3, 3), rows.swing)
    return replace(rows, alpha=alpha, swing=swing), whole


def _bounds(
    motion: gate.Dynamics, first: int, last: int, settings: AlignmentSettings, lift_off_ns: int
) -> tuple[int, int] | str:
    """Samples of start and stop between two samples, or why there are none."""
    view = take_rows(motion, slice(first, last + 1))
    limits = settings.limits
    start: int | None = 0
    if settings.gate != "off" and settings.start_ns is None:
        if settings.gate == "paper":
            start = gate.find_start(view, limits, lift_off_ns)
        else:
            start = int(np.searchsorted(view.time_ns, lift_off_ns))
    if start is None or start >= len(view.time_ns):
        return "no start found; " + gate.why_no_start(view, limits, lift_off_ns)
    stop = None if settings.gate == "off" else gate.find_stop(view, limits, start)
    return first + start, first + (len(view.time_ns) - 1 if stop is None else stop)


def _candidate(
    stretch: preparation.Stretch,
    everything: Segment,
    inside: GnssFixes,
    motion: gate.Dynamics,
    part: BoolArray,
    good: BoolArray,
    settings: AlignmentSettings,
    lift_off_ns: int,
    reasons: list[str],
) -> Candidate | None:
    time_ns = inside.time_ns
    first_fix, last_fix = np.flatnonzero(part)[[0, -1]]
    first = 0 if first_fix == 0 else int(np.searchsorted(motion.time_ns, time_ns[first_fix]))
    last = len(motion.time_ns) - 1
    if last_fix < len(time_ns) - 1:
        last = int(np.searchsorted(motion.time_ns, time_ns[last_fix]))
    bounds = _bounds(motion, first, last, settings, lift_off_ns)
    if isinstance(bounds, str):
        reasons.append(bounds)
        return None
    start_ns, stop_ns = int(motion.time_ns[bounds[0]]), int(motion.time_ns[bounds[1]])
    chosen = part & (time_ns >= start_ns) & (time_ns <= stop_ns)
    usable = chosen & good
    segment, fixes = everything.take(usable), inside.rows(usable)
    if settings.gate == "mask" and len(segment) > 1:
        # Before the first pair over calm flight nothing counts.
        length = window_rows(segment.rows.time_s, settings.window_s)
        length = min(length if settings.vectors == "win" else 1, len(segment) - 1)
        calm = segment.not_calm[length:] == segment.not_calm[:-length]
        begin = int(np.argmax(calm))
        segment, fixes = segment.take(slice(begin, None)), fixes.rows(slice(begin, None))
    slack = 2.0 * float(median(np.diff(time_ns))) * 1e-9
    span = float(segment.rows.time_s[-1] - segment.rows.time_s[0]) if len(segment) else 0.0
    if span < preparation.MIN_SPAN_S - slack:
        reasons.append(
            f"only {span:.1f} s with fixes after the start: {preparation.MIN_SPAN_S:g} s are needed"
        )
        return None
    path = course(segment, settings) if settings.series or settings.sigma_stop else None
    if settings.sigma_stop is not None and path is not None:
        count = _enough(segment, path, settings.sigma_stop)
        if count is not None:
            segment, fixes = segment.take(slice(0, count)), fixes.rows(slice(0, count))
            path = path.until(count)
            stop_ns = int(fixes.time_ns[-1])
    solution = solve(segment, settings)
    if solution is None:
        reasons.append("no pair of vectors to compare: no calm window, or fixes too far apart")
        return None
    at_end = segment.rows.rows(slice(-1, None))
    sigma = float(worst_sigma(solution_covariance(solution, segment, at_end, settings)))
    rejected = int((chosen & ~good).sum())
    warnings = []
    if rejected > MANY_REJECTED * chosen.sum():
        warnings.append(
            f"{rejected} of {int(chosen.sum())} fixes rejected as outliers: check latency, lever"
            " arm, units and --gnss-sigma-v"
        )
    longest = preparation.gap_edges(segment.rows.time_s)[1]
    if longest > preparation.SILENT_GAP_S:
        warnings.append(f"fixes are missing for {longest:.1f} s in the span used for alignment")
    return Candidate(
        stretch, segment, fixes, inside, start_ns, stop_ns, rejected, solution, path, sigma,
        warnings,
    )  # fmt: skip


def _enough(segment: Segment, path: Course, sigma: float) -> int | None:
    """Fixes up to the first at which the sigma is small enough and the vehicle calm."""
    calm = np.diff(segment.not_calm, prepend=segment.not_calm[0] - 1)[path.rows] == 0
    done = np.flatnonzero((worst_sigma(path.covariance) < sigma) & calm)
    return int(path.rows[done[0]]) + 1 if len(done) else None
