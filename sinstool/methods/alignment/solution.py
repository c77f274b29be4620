"""Solution of one segment: pairs, attitude, covariance, at the end and at every fix."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sinstool.core.arrays import ArrayLike, BoolArray, FloatArray, IntArray
from sinstool.core.rotation import exp, from_dcm, to_dcm
from sinstool.core.streams import take_rows
from sinstool.methods.alignment import pairs as pairing
from sinstool.methods.alignment.accumulation import InertialRows, accumulate
from sinstool.methods.alignment.covariance import (
    attitude_covariance,
    drifting_noise,
    residuals_of_sensors,
    triad_attitude,
    triad_covariance,
)
from sinstool.methods.alignment.inflight_types import AlignmentSettings, GnssFixes, ImuIncrements
from sinstool.methods.alignment.pairs import (
    PairSums,
    running_centred_sums,
    running_sums,
    total_sums,
)
from sinstool.methods.alignment.reference import dcm_ni, position_reference, velocity_reference
from sinstool.methods.alignment.refine import theta_at
from sinstool.methods.alignment.wahba import SOLVERS, singular_values

POSITION_SERIES_S = 2.0
MIN_POSITION_COURSE_S = 5.0


@dataclass(frozen=True)
class Segment:
    """Both sides at the fixes of a segment.

    Attributes
    ----------
    rows : InertialRows
        At the antenna.
    latitude, longitude, height : ndarray, shape (n,)
    sigma, level : ndarray, shape (n,)
        Velocity noise of the fixes, and what is usual around them, m/s.
    velocity_n : ndarray, shape (n, 3)
    not_calm : ndarray of int64, shape (n,)
        Count of samples up to each fix that were not calm.
    """

    rows: InertialRows
    latitude: FloatArray
    longitude: FloatArray
    height: FloatArray
    velocity_n: FloatArray
    sigma: FloatArray
    level: FloatArray
    not_calm: IntArray

    def __len__(self) -> int:
        return len(self.rows)

    def take(self, which: slice | BoolArray | IntArray) -> Segment:
        """Rows by slice or mask."""
        return take_rows(self, which)

    def beta(self) -> FloatArray:
        """Integrated GNSS side from the first fix, m/s."""
        return velocity_reference(
            self.rows.time_s, self.latitude, self.longitude, self.height, self.velocity_n
        )

    def dcm_ni(self) -> FloatArray:
        """``C_i^n`` at the fixes, shape (n, 3, 3)."""
        return dcm_ni(self.latitude, self.longitude, self.rows.time_s)


@dataclass(frozen=True)
class Solution:
    """``C_ib0^i`` of a segment.

    Attributes
    ----------
    dcm : ndarray, shape (3, 3)
    sums : PairSums
        For ``triad`` those of its two vectors.
    residuals : ndarray, shape (k, 3)
        Of the pairs with weight, in ``ib0``.
    pairs : Pairs
        Those with weight.
    """

    dcm: FloatArray
    sums: PairSums
    elapsed_s: float
    n_pairs: int
    residual_rms: float
    chi2: float
    """Mean squared residual by what GNSS noise and sensor errors explain: about 1."""
    residuals: FloatArray
    pairs: pairing.Pairs


def make_pairs(segment: Segment, settings: AlignmentSettings) -> pairing.Pairs:
    """Pairs of a segment, one for each fix; those without weight included."""
    rows, usual = segment.rows, settings.gnss_sigma_v
    mask = segment.not_calm if settings.gate == "mask" else None
    kind = settings.vectors
    if kind in ("diff", "diffc"):
        position = (segment.latitude, segment.longitude, segment.height)
        return pairing.differentiated_pairs(
            kind == "diffc", rows, position, segment.velocity_n, segment.level, usual, mask,
            settings.lever_arm_b,
        )  # fmt: skip
    if kind in ("cen", "pos"):
        end_s = rows.time_s
        fade = np.exp((end_s - end_s[-1]) / settings.fade_s)
        if kind == "pos":
            beta = position_reference(end_s, segment.latitude, segment.longitude, segment.height)
            return pairing.centred_pairs(rows, beta, fade, line=True)
        weight = fade * (usual / segment.sigma) ** 2
        return pairing.centred_pairs(rows, segment.beta(), weight, line=False)
    length = pairing.window_rows(rows.time_s, settings.window_s)
    return pairing.integrated_pairs(kind, rows, segment.beta(), segment.level, length, usual, mask)


def _sums(pairs: pairing.Pairs, segment: Segment, settings: AlignmentSettings) -> PairSums:
    # Centred pairs hold their fading already, as it decides about the mean.
    fade = np.inf if settings.vectors in ("cen", "pos") else settings.fade_s
    sums = total_sums(pairs, segment.rows.time_s, segment.sigma, fade)
    if settings.vectors == "pos":
        noise = drifting_noise(
            pairs,
            segment.rows.time_s,
            settings.gnss_sigma_p,
            settings.gnss_drift_p,
            settings.gnss_drift_s,
        )
        sums = replace(sums, noise=noise)
    return sums


def solve(segment: Segment, settings: AlignmentSettings) -> Solution | None:
    """Attitude of a whole segment; None where there is no pair."""
    if len(segment) < 3:
        return None
    pairs = make_pairs(segment, settings)
    weighty = pairs.weight > 0.0
    if not weighty.any():
        return None
    sums = _sums(pairs, segment, settings)
    if settings.method == "triad":
        last = np.array([len(segment) - 1])
        dcm = triad_attitude(segment.rows, segment.beta(), last)[0][0]
        if not np.isfinite(dcm).all():
            return None
    elif not np.any(sums.profile):
        return None
    else:
        dcm = SOLVERS[settings.method](sums.profile)
    pairs = pairs.rows(weighty)
    residuals = pairs.beta @ dcm - pairs.alpha
    if settings.vectors == "pos":
        variance = np.full(len(pairs), settings.gnss_sigma_p**2 + settings.gnss_drift_p**2)
    else:
        variance = segment.sigma[pairs.newer] ** 2
        variance = variance + np.where(pairs.older >= 0, segment.sigma[pairs.older] ** 2, 0.0)
        variance = variance * pairs.scale**2
    explained = 3.0 * variance + residuals_of_sensors(sums, pairs, settings.grade, settings.kappa)
    square = np.sum(residuals**2, axis=1)
    time = segment.rows.time_s
    return Solution(
        dcm,
        sums,
        float(time[-1] - time[0]),
        len(pairs),
        float(np.sqrt(square.mean())),
        float(np.mean(square / explained)),
        residuals,
        pairs,
    )


def solution_covariance(
    solution: Solution, segment: Segment, at: InertialRows, settings: AlignmentSettings
) -> FloatArray:
    """Covariance in ``ib0`` of the attitude at the one row `at`, shape (3, 3)."""
    if settings.method == "triad":
        last = np.array([len(segment) - 1])
        joined = at.append_to(segment.rows)
        middle = triad_attitude(segment.rows, segment.beta(), last)[1]
        sigma = np.append(segment.sigma, segment.sigma[-1])
        return triad_covariance(
            joined, sigma, middle, last, last + 1, settings.grade, settings.kappa
        )[0]
    return attitude_covariance(
        solution.sums,
        at.gyro_bias_attitude[0],
        at.gyro_scale_attitude[0],
        np.asarray(solution.elapsed_s),
        settings.grade,
        settings.kappa,
    )


@dataclass(frozen=True)
class Course:
    """The solution at each fix, from the data before it.

    Attributes
    ----------
    rows : ndarray of int64, shape (k,)
        Rows of the segment at which there is one.
    dcm : ndarray, shape (k, 3, 3)
        ``C_ib0^i``.
    covariance : ndarray, shape (k, 3, 3)
        In ``ib0``.
    second, singular : ndarray, shapes (k, 3, 3) and (k, 3)
    """

    rows: IntArray
    dcm: FloatArray
    covariance: FloatArray
    second: FloatArray
    singular: FloatArray

    def until(self, count: int) -> Course:
        """The course over the first rows of the segment."""
        return take_rows(self, slice(0, int(np.searchsorted(self.rows, count))))


def course(segment: Segment, settings: AlignmentSettings) -> Course:
    """Solve at every fix (for ``pos``, every two seconds)."""
    rows = segment.rows
    if settings.vectors == "pos":
        return _position_course(segment, settings)
    sums = sums_so_far(segment, settings)
    ends = np.flatnonzero(sums.count > 1.0)
    ends = ends[np.any(sums.profile[ends] != 0.0, axis=(-2, -1))]
    sums = take_rows(sums, ends)
    elapsed = rows.time_s[ends] - rows.time_s[0]
    if settings.method == "triad":
        good = ends >= 2
        ends, sums = ends[good], take_rows(sums, good)
        dcm, middle = triad_attitude(rows, segment.beta(), ends)
        covariance = triad_covariance(
            rows, segment.sigma, middle, ends, ends, settings.grade, settings.kappa
        )
        good = np.asarray(np.isfinite(dcm).all(axis=(-2, -1)))
        ends, dcm, covariance = ends[good], dcm[good], covariance[good]
        sums = take_rows(sums, good)
    else:
        dcm = SOLVERS[settings.method](sums.profile)
        covariance = attitude_covariance(
            sums,
            rows.gyro_bias_attitude[ends],
            rows.gyro_scale_attitude[ends],
            elapsed,
            settings.grade,
            settings.kappa,
        )
    return Course(ends, dcm, covariance, sums.second, singular_values(sums.profile))


def sums_so_far(segment: Segment, settings: AlignmentSettings) -> PairSums:
    """Sums after each fix."""
    if settings.vectors == "cen":
        return running_centred_sums(
            segment.rows, segment.beta(), segment.sigma, settings.fade_s, settings.gnss_sigma_v
        )
    pairs = make_pairs(segment, settings)
    return running_sums(pairs, segment.rows.time_s, segment.sigma, settings.fade_s)


def _position_course(segment: Segment, settings: AlignmentSettings) -> Course:
    time = segment.rows.time_s
    marks = np.arange(time[0] + MIN_POSITION_COURSE_S, time[-1], POSITION_SERIES_S)
    ends = np.unique(np.append(np.searchsorted(time, marks), len(time) - 1))
    parts = []
    for end in ends:
        part = segment.take(slice(0, int(end) + 1))
        solution = solve(part, settings)
        if solution is None:
            continue
        at = part.rows.rows(slice(int(end), None))
        parts.append((end, solution, solution_covariance(solution, part, at, settings)))
    if not parts:
        empty = np.empty((0, 3, 3))
        return Course(np.empty(0, dtype=np.int64), empty, empty, empty, np.empty((0, 3)))
    profile = np.stack([s.sums.profile for _, s, _ in parts])
    return Course(
        np.array([end for end, _, _ in parts]),
        np.stack([s.dcm for _, s, _ in parts]),
        np.stack([c for _, _, c in parts]),
        np.stack([s.sums.second for _, s, _ in parts]),
        singular_values(profile),
    )


def explain_residuals(solution: Solution, segment: Segment) -> str:
    """Explain large residuals: late fixes, or a missing lever arm.

    Returns
    -------
    str
        For a warning. A fix that is late lacks force times latency; one at a lever arm has rate
        times lever arm too much.
    """
    rows, pairs = segment.rows, solution.pairs
    c = to_dcm(rows.q)
    late = -np.einsum("nij,nj->ni", c, rows.force_b)[:, :, None]
    effects = np.concatenate([late, rows.swing], axis=2)
    difference = effects[pairs.newer] - np.where(
        (pairs.older >= 0)[:, None, None], effects[pairs.older], effects.mean(axis=0)
    )
    difference = difference * pairs.scale[:, None, None]
    target = solution.residuals.reshape(-1)
    best, text = (
        0.5 * float(target @ target),
        "check latency, lever arm, units, outliers and the IMU's grade",
    )
    for part in (slice(0, 1), slice(1, 4)):
        columns = difference[:, :, part].reshape(len(target), -1)
        fit = np.linalg.lstsq(columns, target, rcond=None)[0]
        left = float(np.sum((target - columns @ fit) ** 2))
        if left < best:
            best = left
            if len(fit) == 1:
                text = f"they look like fixes {fit[0] * 1e3:.0f} ms late"
            else:
                text = "they look like an antenna at " + ", ".join(f"{x:.2f}" for x in fit) + " m"
    return text


def position_between(fixes: GnssFixes, time_ns: IntArray) -> tuple[FloatArray, FloatArray]:
    """Latitude and longitude between fixes, and a little beyond them.

    Parameters
    ----------
    time_ns : ndarray of int64, shape (n,)

    Returns
    -------
    latitude, longitude : ndarray, shape (n,)
        rad.

    Notes
    -----
    Interpolates the normal of the ellipsoid, which knows no date line and no pole. Beyond the
    ends it goes on as over the outermost second, for a second; then it stays.
    """
    cl = np.cos(fixes.latitude)
    normal = np.stack(
        [cl * np.cos(fixes.longitude), cl * np.sin(fixes.longitude), np.sin(fixes.latitude)]
    )
    origin = fixes.time_ns[0]
    x = (time_ns - origin) * 1e-9
    fix_s = (fixes.time_ns - origin) * 1e-9
    if len(fix_s) > 1:
        near = min(int(np.searchsorted(fix_s, 1.0)), len(fix_s) - 1)
        far = max(int(np.searchsorted(fix_s, fix_s[-1] - 1.0, side="right")) - 1, 0)
        before = 2.0 * normal[:, :1] - normal[:, near : near + 1]
        after = 2.0 * normal[:, -1:] - normal[:, far : far + 1]
        normal = np.concatenate([before, normal, after], axis=1)
        fix_s = np.concatenate([[-fix_s[near]], fix_s, [2.0 * fix_s[-1] - fix_s[far]]])
    n0, n1, n2 = (np.interp(x, fix_s, part) for part in normal)
    return np.arctan2(n2, np.hypot(n0, n1)), np.arctan2(n1, n0)


@dataclass(frozen=True)
class AttitudeChain:
    """Rotations that carry an attitude through its stretch of the log.

    Attributes
    ----------
    origin_ns : int
        At which ``i`` is frozen.
    dcm : ndarray, shape (3, 3)
        ``C_ib0^i``.
    fixes : GnssFixes
        All of the stretch.
    refined : tuple of (ndarray, InertialRows) or None
        State of the refinement and the one row at which it holds.
    """

    imu: ImuIncrements
    origin_ns: int
    dcm: FloatArray
    fixes: GnssFixes
    refined: tuple[FloatArray, InertialRows] | None = None

    def rows_at(self, time_ns: ArrayLike) -> InertialRows:
        """Inertial side at increasing times.

        Raises
        ------
        ValueError
            If a time lies outside the stretch.
        """
        times = np.atleast_1d(np.asarray(time_ns, dtype=np.int64))
        inside = (times >= self.imu.time_ns[0]) & (times <= self.imu.time_ns[-1])
        if not inside.all():
            raise ValueError(
                "Expected times within the samples of the segment,"
                f" {self.imu.time_ns[0]} to {self.imu.time_ns[-1]} ns."
            )
        imu = self.imu
        return accumulate(imu.time_ns, imu.delta_theta, imu.delta_velocity, times, self.origin_ns)

    def rate(self, time_ns: int) -> FloatArray:
        """Rate of the body at a time, as the samples on both sides of it have it, rad/s, (3,)."""
        times = self.imu.time_ns
        k = min(max(int(np.searchsorted(times, time_ns)), 1), len(times) - 1)
        first = max(k - 1, 1)
        seconds = float(times[k] - times[first - 1]) * 1e-9
        return np.asarray(self.imu.delta_theta[first : k + 1].sum(axis=0) / seconds)

    def attitude(self, time_ns: ArrayLike) -> FloatArray:
        """Attitude at any times of the stretch.

        Parameters
        ----------
        time_ns : array_like of int64, shape (n,)
            In any order.

        Returns
        -------
        ndarray, shape (n, 4)
            q_nb with ``w >= 0``.

        Raises
        ------
        ValueError
            If a time lies outside the stretch.
        """
        times = np.atleast_1d(np.asarray(time_ns, dtype=np.int64))
        order = np.argsort(times, kind="stable")
        rows = self.rows_at(times[order])
        q = np.empty((len(times), 4))
        q[order] = from_dcm(self.dcm_ni(times[order]) @ self.dcm_ib(rows))
        return q

    def dcm_ni(self, time_ns: IntArray) -> FloatArray:
        """``C_i^n`` at each of some times."""
        latitude, longitude = position_between(self.fixes, time_ns)
        return dcm_ni(
            latitude, longitude, np.asarray((time_ns - self.origin_ns) * 1e-9, dtype=np.float64)
        )

    def dcm_ib(self, rows: InertialRows) -> FloatArray:
        """``C_b^i`` at each of some rows."""
        chain = to_dcm(rows.q)
        if self.refined is not None:
            state, reference = self.refined
            chain = to_dcm(exp(-theta_at(state, reference, rows))) @ chain
        return np.asarray(self.dcm @ chain)


def carried(
    imu: ImuIncrements, fixes: GnssFixes, time_ns: int, q_nb: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """An attitude at the last sample, carried back to the first.

    Parameters
    ----------
    imu : ImuIncrements
        Without gaps, gyro bias taken off.
    fixes : GnssFixes
        Positions around these times.
    time_ns : int
        At which the attitude holds: up to the last sample.
    q_nb : ndarray, shape (4,)

    Returns
    -------
    q_nb : ndarray, shape (4,)
        At the first sample.
    per_bias, per_scale : ndarray, shape (3, 3)
        By how much gyro biases (s) and scale factors (rad) turn it, in NED, up to sign.
    """
    origin = int(imu.time_ns[0])
    chain = AttitudeChain(imu, origin, np.eye(3), fixes)
    at = np.array([origin, min(time_ns, int(imu.time_ns[-1]))])
    rows, turn = chain.rows_at(at), chain.dcm_ni(at)
    start = turn[1].T @ to_dcm(q_nb) @ to_dcm(rows.q[1]).T
    c_nb = turn[0] @ start
    return (
        from_dcm(c_nb @ to_dcm(rows.q[0])),
        c_nb @ (rows.gyro_bias_attitude[1] - rows.gyro_bias_attitude[0]),
        c_nb @ (rows.gyro_scale_attitude[1] - rows.gyro_scale_attitude[0]),
    )
