"""The answer of an alignment in flight: the attitude of its best segment, with its covariance."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.errors import AlignmentError
from sinstool.core.rotation import from_dcm, log, to_dcm
from sinstool.core.timeline import clock_time
from sinstool.methods.alignment import refine as refinement
from sinstool.methods.alignment.accumulation import InertialRows
from sinstool.methods.alignment.covariance import axis_sigma, geometry, worst_sigma
from sinstool.methods.alignment.heading_profile import likeliest, profiled
from sinstool.methods.alignment.inflight_types import (
    OK_SIGMA,
    UNIFORM_SIGMA,
    AlignmentSeries,
    AlignmentSettings,
    ImuIncrements,
    RefinedErrors,
    Status,
)
from sinstool.methods.alignment.segments import Candidate
from sinstool.methods.alignment.solution import (
    AttitudeChain,
    Course,
    Segment,
    Solution,
    explain_residuals,
    solution_covariance,
    solve,
)
from sinstool.methods.alignment.wahba import singular_values
from sinstool.methods.receiver_priors import ARM_GIVEN_M, ARM_USUAL_M, LATENCY_S

# Mean squared residual, by what is assumed, beyond which an attitude is inconsistent.
INCONSISTENT_CHI2 = 3.0

REFINE_SIGMA = float(np.deg2rad(20.0))
"""Largest sigma of the solver's attitude, about its worst axis, that leaves the refinement linear.
Errors of the sensors are in it, which the refinement then estimates. From headings all around, only
the tilt needs to be as certain."""


@dataclass(frozen=True)
class InFlightAlignment:
    """An attitude in flight.

    Attributes
    ----------
    status : {'ok', 'degraded', 'level-only', 'unobservable', 'failed'}
        ``ok`` up to 1 deg about the worst axis, ``degraded`` up to 5 deg (`refuse_sigma`) or
        where residuals are inconsistent, ``level-only`` where only roll and pitch are known; the
        latter's `q_nb` holds an arbitrary heading.
    method, vectors : str
        As used.
    t_ns, t_q_ns, t_stop_ns : int
        When the attitude holds; start and end of the segment used.
    q_nb : ndarray, shape (4,)
        With ``w >= 0``; NaN where the status is ``unobservable`` or ``failed``.
    cov : ndarray, shape (3, 3)
        Of psi in NED, rad^2: the attitude found is ``(I + [psi x]) C_nb``. Residuals larger
        than assumed widen it by as much.
    sigma_rad : ndarray, shape (3,)
        About north, east, down.
    sigma_worst : float
        About the worst axis, before an unknown heading is declared so, rad.
    rho : float
        Geometry of the vectors, 0 to 1.
    singular_values : ndarray, shape (3,)
        Of the attitude profile matrix, the last one with its sign.
    n_pairs, n_rejected : int
        Pairs with weight; fixes that the screen rejected.
    residual_rms : float
        Of the pairs, in the units of their vectors.
    chi2 : float
        Mean squared residual by what GNSS noise and sensor errors explain: about 1.
    time_to_align_s : float or None
        From the start to the first fix after which the worst-axis sigma stays below 1 deg.
    residual_ns : ndarray of int64, shape (k,)
        When the newer vector of each pair was taken.
    residuals : ndarray, shape (k, 3)
        Of the solver's pairs, in the units of their vectors, in the body axes of the origin.
    """

    status: Status
    method: str
    vectors: str
    t_ns: int
    t_q_ns: int
    t_stop_ns: int
    q_nb: FloatArray
    cov: FloatArray
    sigma_rad: FloatArray
    sigma_worst: float
    rho: float
    singular_values: FloatArray
    warnings: tuple[str, ...]
    n_pairs: int = 0
    n_rejected: int = 0
    residual_rms: float = np.nan
    chi2: float = np.nan
    time_to_align_s: float | None = None
    errors: RefinedErrors | None = None
    series: AlignmentSeries | None = None
    residual_ns: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    residuals: FloatArray = field(default_factory=lambda: np.empty((0, 3)))

    _chain: AttitudeChain | None = field(default=None, repr=False, compare=False)

    def is_same(self, refuse_sigma: float, other: float) -> bool:
        """Whether what was refused beyond one sigma, rad, would be beyond another, and no more."""
        low, high = sorted((refuse_sigma, other))
        return not low < self.sigma_worst <= high

    def attitude_at(self, time_ns: IntArray) -> FloatArray:
        """Attitude at any times of the unbroken stretch of the log that holds the segment.

        Parameters
        ----------
        time_ns : array_like of int64, shape (n,)
            In any order; also before the start and after the stop of the segment.

        Returns
        -------
        ndarray, shape (n, 4)
            q_nb with ``w >= 0``.

        Raises
        ------
        AlignmentError
            If there is no alignment.
        ValueError
            If a time lies outside the stretch.
        """
        if self._chain is None:
            raise AlignmentError("there is no attitude", "the alignment is " + self.status)
        return self._chain.attitude(time_ns)


def answer(best: Candidate, settings: AlignmentSettings, warnings: list[str]) -> InFlightAlignment:
    """The alignment by a segment, refined, with all that is uncertain in its covariance.

    Parameters
    ----------
    warnings : list of str
        What was noted so far; more are added.
    """
    segment, solution = best.segment, best.solution
    origin = int(best.stretch.imu.time_ns[0])
    chain = AttitudeChain(best.stretch.imu, origin, solution.dcm, best.positions)
    t_ns, at = _place(best, settings, chain)
    covariance = solution_covariance(solution, segment, at, settings)
    errors, lacking = None, np.zeros((3, 3))
    if settings.refine:
        hindrance = _hindrance(best, settings, covariance)
        if hindrance:
            warnings.append(f"not refined: {hindrance}")
        else:
            result, errors, lacking = _refined(best, settings)
            reference = segment.rows.rows(slice(result.row, result.row + 1))
            chain = replace(chain, dcm=result.dcm, refined=(result.state, reference))
            covariance = refinement.theta_covariance(
                result.covariance, reference, at, settings.grade
            )
    if errors is None and settings.vectors in ("diff", "diffc"):
        covariance = covariance + _coarse(solution, segment, settings)
    misfit = solution.chi2 if errors is None else errors.chi2
    inconsistent = misfit > INCONSISTENT_CHI2
    if inconsistent:
        # The filter's measure has an end, as it inflates what does not fit.
        misfit = max(misfit, solution.chi2)
        warnings.append(
            f"the first attitude is inconsistent: its residuals are {misfit:.1f} times as large as"
            f" the assumed noise explains; {explain_residuals(solution, segment)}"
        )
    if inconsistent or errors is not None:
        covariance = max(misfit, 1.0) * covariance
    covariance = covariance + lacking + _misaligned(segment, at, settings.grade.gyro_misalignment)
    c_ni = chain.dcm_ni(np.array([t_ns]))[0]
    turn = c_ni @ chain.dcm
    c_nb = c_ni @ chain.dcm_ib(at)[0]
    covariance = turn @ covariance @ turn.T
    if settings.sample_s:
        rate = c_nb @ chain.rate(t_ns)
        covariance = covariance + 0.5 * settings.sample_s**2 * np.outer(rate, rate)
    worst = float(worst_sigma(covariance))
    status = _status(covariance, settings.refuse_sigma)
    if status == "ok" and inconsistent:
        status = "degraded"
    if settings.refine and errors is None and best.many_rejected and status in ("ok", "degraded"):
        # So many do not fit by chance, and no refinement has held its heading against others
        status = _without_heading(covariance)
    warnings += _doubts(status, covariance)
    if status == "level-only":
        covariance = covariance.copy()
        covariance[2, :] = covariance[:, 2] = 0.0
        covariance[2, 2] = UNIFORM_SIGMA**2
    series = None if best.course is None else _series(best, best.course)
    return InFlightAlignment(
        status=status,
        method=settings.method,
        vectors="int" if settings.method == "triad" else settings.vectors,
        t_ns=t_ns,
        t_q_ns=best.start_ns,
        t_stop_ns=best.stop_ns,
        q_nb=np.full(4, np.nan) if status == "unobservable" else from_dcm(c_nb),
        cov=covariance,
        sigma_rad=axis_sigma(covariance),
        sigma_worst=worst,
        rho=float(geometry(solution.sums.second)),
        singular_values=singular_values(solution.sums.profile),
        n_pairs=solution.n_pairs,
        n_rejected=best.rejected,
        residual_rms=solution.residual_rms,
        chi2=solution.chi2,
        time_to_align_s=None if series is None else _time_to_align(series, best.start_ns),
        errors=errors,
        warnings=tuple(warnings),
        series=series,
        residual_ns=best.fixes.time_ns[solution.pairs.newer],
        residuals=solution.residuals,
        _chain=None if status == "unobservable" else chain,
    )


def _place(
    best: Candidate, settings: AlignmentSettings, chain: AttitudeChain
) -> tuple[int, InertialRows]:
    """Time at which the attitude is wanted, and the inertial side there: a single row."""
    if settings.at == "end":
        return int(best.fixes.time_ns[-1]), best.segment.rows.rows(slice(-1, None))
    t_ns = best.start_ns if isinstance(settings.at, str) else settings.at
    times = chain.imu.time_ns
    if not times[0] <= t_ns <= times[-1]:
        raise AlignmentError(
            f"no attitude can be given at {clock_time(t_ns)}",
            f"the gyros carry it from {clock_time(int(times[0]))} for"
            f" {(times[-1] - times[0]) * 1e-9:.1f} s only",
        )
    return t_ns, chain.rows_at(t_ns)


def _hindrance(best: Candidate, settings: AlignmentSettings, covariance: FloatArray) -> str:
    """Why a solver's attitude, with its covariance, cannot be refined; empty if it can."""
    if settings.vectors == "pos":
        return "that needs velocity"
    level = settings.around and _level_known(covariance, best)
    if best.sigma_worst > REFINE_SIGMA and not level:
        return "the attitude to start from is not known well enough"
    return ""


def _doubts(status: Status, covariance: FloatArray) -> list[str]:
    """What is to be said of an attitude that is not certain in all axes."""
    worst = min(float(worst_sigma(covariance)), UNIFORM_SIGMA)
    if status == "level-only":
        heading = min(float(np.sqrt(covariance[2, 2])), UNIFORM_SIGMA)
        return [
            "heading is not known: it needs horizontal acceleration, a turn, or one to several"
            f" minutes; its predicted sigma is {np.rad2deg(heading):.0f} deg"
        ]
    if status == "unobservable":
        return [
            "the first attitude is unknown: about its least certain axis its sigma is"
            f" {np.rad2deg(worst):.0f} deg"
        ]
    if status == "degraded":
        return [
            "about its least certain axis, the first attitude is only known to"
            f" {np.rad2deg(worst):.1f} deg (1 sigma)"
        ]
    return []


def _status(covariance: FloatArray, refuse_sigma: float) -> Status:
    worst = float(worst_sigma(covariance))
    if worst <= OK_SIGMA:
        return "ok"
    if worst <= refuse_sigma:
        return "degraded"
    return _without_heading(covariance)


def _without_heading(covariance: FloatArray) -> Status:
    return "level-only" if worst_sigma(covariance[:2, :2]) <= OK_SIGMA else "unobservable"


def _refined(
    best: Candidate, settings: AlignmentSettings
) -> tuple[refinement.Refined, RefinedErrors, FloatArray]:
    """The refinement, its errors, and what its covariance of theta lacks."""
    segment = best.segment
    lever_sigma, latency_sigma = settings.refine_lever_sigma, settings.refine_latency_sigma
    if settings.around:
        given = bool(np.any(settings.lever_arm_b))
        lever_sigma = max(lever_sigma, ARM_GIVEN_M if given else ARM_USUAL_M)
        latency_sigma = max(latency_sigma, LATENCY_S)
    use = np.ones(len(segment), dtype=bool)
    if settings.gate == "mask":
        use[1:] = np.diff(segment.not_calm) == 0
    beta = segment.beta()

    @cache
    def refiner(backward: bool) -> refinement.Refiner:
        return refinement.Refiner(
            segment.rows,
            beta,
            segment.sigma,
            use,
            settings.grade,
            max(refinement.START_SIGMA, 3.0 * min(best.sigma_worst, REFINE_SIGMA)),
            lever_sigma,
            latency_sigma,
            backward,
        )

    def refine(dcm: FloatArray, held: FloatArray | None = None) -> refinement.Refined:
        # A heading is held where the answer is, and all fixes are seen from there
        return refiner((settings.at == "start") == (held is None))(dcm, held)

    down_i = segment.dcm_ni()[0 if settings.at == "start" else -1, 2]
    begun = likeliest(refine, best.solution.dcm, down_i) if settings.around else None
    first = begun or refine(best.solution.dcm)
    lasting = settings.around or settings.lasting
    result, lacking = profiled(refine, first, down_i, 3 * int(use.sum()), lasting)
    x, sigma = result.state, np.sqrt(np.diag(result.covariance))
    parts = {
        "gyro_bias": slice(refinement.BG, refinement.BG + 3),
        "accel_bias": slice(refinement.BA, refinement.BA + 3),
        "gyro_scale": slice(refinement.KG, refinement.KG + 3),
        "accel_scale": slice(refinement.KA, refinement.KA + 3),
        "lever_arm_b": slice(refinement.LEVER, refinement.LEVER + 3),
    }
    errors = RefinedErrors(
        **{name: x[part] for name, part in parts.items()},
        latency_s=float(x[refinement.TAU]),
        sigma={
            **{name: sigma[part] for name, part in parts.items()},
            "latency_s": float(sigma[refinement.TAU]),
        },
        inflated=result.inflated,
        chi2=result.chi2,
    )
    return result, errors, lacking


def _coarse(solution: Solution, segment: Segment, settings: AlignmentSettings) -> FloatArray:
    """Covariance, rad^2 in ``ib0``, by fixes too far apart for differences of their velocities.

    A backward difference lags by half its interval, a central one is smoothed by the square of it:
    with every other fix that grows by as much as it is, or by more.
    """
    other = solve(segment.take(np.arange((len(segment) - 1) % 2, len(segment), 2)), settings)
    if other is None:
        return np.asarray(UNIFORM_SIGMA**2 * np.eye(3))
    off = log(from_dcm(solution.dcm.T @ other.dcm))
    return np.outer(off, off)


def _misaligned(segment: Segment, at: InertialRows, angle: float) -> FloatArray:
    """Covariance, rad^2, by gyros whose axes are off by an angle: so far they lean in a radian."""
    share = float(np.abs(segment.rows.q @ at.q[0]).min())
    turned = 2.0 * np.arccos(min(share, 1.0))
    return np.asarray(np.square(angle * min(turned, 1.0)) * np.eye(3))


def _level_known(covariance: FloatArray, best: Candidate) -> bool:
    """Whether it is only about the vertical that a solver's attitude may be far off."""
    down_b = best.solution.dcm.T @ best.segment.dcm_ni()[0, 2]
    level = np.eye(3) - np.outer(down_b, down_b)
    return bool(worst_sigma(level @ covariance @ level) <= REFINE_SIGMA)


def _series(best: Candidate, path: Course) -> AlignmentSeries:
    segment = best.segment.take(path.rows)
    turn = segment.dcm_ni() @ path.dcm
    covariance = turn @ path.covariance @ np.swapaxes(turn, -1, -2)
    calm = np.diff(best.segment.not_calm, prepend=best.segment.not_calm[0]) == 0
    return AlignmentSeries(
        best.fixes.time_ns[path.rows],
        from_dcm(turn @ to_dcm(segment.rows.q)),
        axis_sigma(covariance),
        worst_sigma(covariance),
        geometry(path.second),
        path.singular,
        calm[path.rows],
    )


def _time_to_align(series: AlignmentSeries, start_ns: int) -> float | None:
    above = np.flatnonzero(series.sigma_worst > OK_SIGMA)
    first = int(above[-1]) + 1 if len(above) else 0
    if first >= len(series.time_ns):
        return None
    return float(series.time_ns[first] - start_ns) * 1e-9


def failed(
    settings: AlignmentSettings, imu: ImuIncrements, warnings: list[str]
) -> InFlightAlignment:
    """No alignment; the warnings say why."""
    nothing = float("nan")
    begin, end = int(imu.time_ns[0]), int(imu.time_ns[-1])
    return InFlightAlignment(
        status="failed",
        method=settings.method,
        vectors=settings.vectors,
        t_ns=end,
        t_q_ns=begin,
        t_stop_ns=end,
        q_nb=np.full(4, nothing),
        cov=np.full((3, 3), nothing),
        sigma_rad=np.full(3, nothing),
        sigma_worst=nothing,
        rho=nothing,
        singular_values=np.full(3, nothing),
        warnings=tuple(warnings),
    )
