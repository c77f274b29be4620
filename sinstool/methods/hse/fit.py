"""Calibration of heading-sensitive error from runs at several rates.

With ``dpsi = psi_hat - psi`` and ``lambda1 = Omega - w sin L`` (w the Earth rate) the model is

    dpsi = lambda1 lambda2 C23 / (3 w cos L)

as printed in the paper of :mod:`sinstool.methods.hse`, eqs. (14) to (16). With this sign
``lambda2`` is minus the sum of the errors of the user's K_g, the matrix that turns the rates of the
raw triad into those of orthogonal axes.

Three methods estimate ``lambda2``:

``heading``
    The paper's: the slope of heading against rate. By default all runs are fitted at once, each
    with its own tilt and weight; with ``form="paper"`` a straight line is fitted to the mean at
    each rate, eq. (15).
``joint``
    The same at several positions that lean differently, with a delay of the encoder as a further
    parameter. A delay shifts heading by ``Omega tau``, which at a single position looks like
    heading-sensitive error.
``axial``
    The rate along the axis; see :mod:`sinstool.methods.hse.axial`. Always fitted, as a check.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy import special

from sinstool.core.arrays import BoolArray, FloatArray
from sinstool.core.errors import ConfigurationError
from sinstool.methods.hse.axial import drift_of_bias, fit_axial
from sinstool.methods.hse.fit_result import FitOptions, HseFit, RunFit
from sinstool.methods.hse.least_squares import LeastSquares, lack_of_fit
from sinstool.methods.hse.model import (
    ROUNDING,
    HeadingModel,
    RunColumns,
    distinct_rates,
    run_columns,
)
from sinstool.methods.hse.run import HseRun
from sinstool.methods.hse.statistics import drifts, trend_t

# Smallest range of rates that determines a slope, rad/s
MIN_RATE_SPAN = np.radians(10.0)


def _times(runs: Sequence[HseRun], options: FitOptions) -> FloatArray:
    """Start of each run, s after that of the first log, or of its own where starts are unknown."""
    starts = [r.log_start_ns for r in runs]
    own = np.array([r.t_start_s for r in runs])
    stamped = [s for s in starts if s is not None]
    if len(stamped) == len(starts):
        own = own + np.array([(s - min(stamped)) * 1e-9 for s in stamped])
    elif options.drift and len({r.source for r in runs}) > 1:
        raise ConfigurationError(
            "a drift with time cannot be fitted: the logs' starts are unknown",
            "leave out the drift, or fit runs of one log",
        )
    return own


def _interval(value: float, sigma: float, quantile: float) -> tuple[float, float] | None:
    if not np.isfinite(sigma):
        return None
    return value - quantile * sigma, value + quantile * sigma


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _left_out(
    runs: Sequence[HseRun], options: FitOptions, times: FloatArray
) -> tuple[BoolArray, list[str]]:
    ids = [r.id for r in runs]
    double = sorted({i for i in ids if ids.count(i) > 1})
    if double:
        raise ConfigurationError(f"two runs are called {double[0]!r}", "give each log its own name")
    unknown = [i for i in options.exclude if i not in ids]
    if unknown:
        raise ConfigurationError(
            f"no run is called {unknown[0]!r}", f"the runs are {', '.join(ids)}"
        )
    reasons = [""] * len(runs)
    for i, one in enumerate(runs):
        if one.id in options.exclude:
            reasons[i] = "excluded"
        elif times[i] < options.skip_warmup_s:
            reasons[i] = "warm-up"
    return np.array([not r for r in reasons], dtype=bool), reasons


def _trends(runs: Sequence[HseRun], use: BoolArray) -> Iterator[str]:
    for one, used in zip(runs, use, strict=True):
        if not used or one.per_turn_heading is None:
            continue
        if drifts(one.per_turn_heading):
            t = trend_t(one.per_turn_heading)
            yield (
                f"the heading of run {one.id} drifts from turn to turn (t = {t:.1f}): the system"
                " warms up or the base tilts; leave it out, or skip the warm-up"
            )


def fit(runs: Sequence[HseRun], options: FitOptions | None = None) -> HseFit:
    """Calibrate heading-sensitive error.

    Parameters
    ----------
    runs : sequence of HseRun
        Of one system with one set of matrices.

    Returns
    -------
    HseFit
        The figures from headings are None with fewer than two rates;
        :func:`sinstool.methods.hse.status.judge` decides whether the result may be used.

    Raises
    ------
    ConfigurationError
        If there is no run, or none is left; if identifiers repeat or an excluded one is
        unknown; or if a drift is asked for of logs whose starts are unknown.
    """
    options = options or FitOptions()
    if not runs:
        raise ConfigurationError("there is no run to calibrate with", "give logs with whole turns")
    times = _times(runs, options)
    use, reasons = _left_out(runs, options, times)
    data = run_columns(runs, times)
    paper = options.form == "paper" and options.method == "heading"
    if paper:
        _one_position(data, use, reasons)
    if not use.any():
        raise ConfigurationError(
            "every run is left out", "exclude fewer runs, or skip less of the warm-up"
        )
    warnings = list(_trends(runs, use))
    model = HeadingModel(data, use, options.method == "joint", options.drift and not paper)
    warnings += model.notes
    if paper and options.drift:
        warnings.append("the drift is not estimated: the paper's line has none")
    weighted = options.weights == "turns" and not paper
    if weighted and not np.all(np.isfinite(data.sigma[use]) & (data.sigma[use] > 0.0)):
        weighted = False
        warnings.append(
            "some runs have too few turns to show their scatter, so all runs get the same weight"
        )
    solved = _solve(model, data, use, weighted, options, runs, reasons, warnings)
    used = [r for r, u in zip(runs, use, strict=True) if u]
    drifted = _headings_by_drift(data, use, used)
    if solved is not None and drifted.any():
        moved = model.solve(replace(data, offset=drifted), use, weighted).estimate
        solved = replace(solved, covariance=solved.covariance + np.outer(moved, moved))
    method = "joint" if model.joint else "heading"
    result = HseFit(
        method="axial" if options.method == "axial" else method,
        form=options.form if options.method == "heading" else "regressor",
        observable=model.observable,
        axial=fit_axial(used, weighted=options.weights == "turns"),
        latitude=float(np.mean([r.latitude for r in used])),
        C23=model.C23,
        sigma_C23=model.sigma_C23,
        C23_spread=model.spread,
        rates=distinct_rates(data.rate[use]),
        rate_span=float(np.ptp(data.rate[use])),
        max_rate=float(np.max(np.abs(data.rate[use]))),
        tilt=float(max(np.hypot(r.theta, r.gamma) for r in used)),
        runs=tuple(runs),
        run_fits=_run_fits(model, data, use, solved, reasons),
        warnings=tuple(warnings),
    )
    if solved is not None:
        result = _from_headings(result, model, data, use, solved, weighted)
        if paper:
            result = _paper(result, model, data, use, drifted)
    if options.method == "axial":
        result = _from_axial(result, model)
    return result


def _solve(
    model: HeadingModel,
    data: RunColumns,
    use: BoolArray,
    weighted: bool,
    options: FitOptions,
    runs: Sequence[HseRun],
    reasons: list[str],
    warnings: list[str],
) -> LeastSquares | None:
    """Fit headings; ``use``, ``reasons`` and ``warnings`` record what is left out."""
    rate = data.rate[use]
    if len(distinct_rates(rate)) < 2 or float(np.ptp(rate)) < MIN_RATE_SPAN:
        return None
    try:
        if options.reject_outliers:
            for i, t in model.reject(data, use, weighted, options.outlier_alpha):
                reasons[i] = f"outlier (studentised residual {t:.1f})"
                warnings.append(f"run {runs[i].id} is left out: {reasons[i]}")
        return model.solve(data, use, weighted)
    except np.linalg.LinAlgError as error:
        warnings.append(f"headings cannot be fitted: {error}")
        return None


def _headings_by_drift(data: RunColumns, use: BoolArray, used: Sequence[HseRun]) -> FloatArray:
    """What a drift of the bias along the axis, as the turns show it, adds to each heading, rad.

    An error of the rate along the axis turns heading as heading-sensitive error does, eq. (13) of
    the paper: it cannot be told from it where the rates rise from run to run.
    """
    added = np.zeros_like(data.offset)
    added[use] = -3.0 * data.gain[use] * data.C23[use] * drift_of_bias(used)
    return added


def _one_position(data: RunColumns, use: BoolArray, reasons: list[str]) -> None:
    """Leave out all but the position that leans most: the paper's line is for one position."""
    at = data.position[use]
    if not len(at):
        return
    lean = [abs(float(data.C23[use & (data.position == k)].mean())) for k in np.unique(at)]
    best = np.unique(at)[int(np.argmax(lean))]
    for i in np.flatnonzero(use & (data.position != best)):
        use[i] = False
        reasons[i] = "another position"


def _run_fits(
    model: HeadingModel,
    data: RunColumns,
    use: BoolArray,
    solved: LeastSquares | None,
    reasons: Sequence[str],
) -> tuple[RunFit, ...]:
    if solved is None:
        return tuple(
            RunFit(bool(u), r, int(k)) for u, r, k in zip(use, reasons, data.position, strict=True)
        )
    residual = data.offset - model.design @ solved.estimate
    place = np.cumsum(use) - 1
    result = []
    for i, used in enumerate(use):
        in_model = data.position[i] in model.positions
        result.append(
            RunFit(
                used=bool(used),
                reason=reasons[i],
                position=int(data.position[i]),
                residual=float(residual[i]) if in_model else None,
                leverage=float(solved.leverage[place[i]]) if used else None,
                studentised=_finite(solved.studentised[place[i]]) if used else None,
            )
        )
    return tuple(result)


def _from_headings(
    result: HseFit,
    model: HeadingModel,
    data: RunColumns,
    use: BoolArray,
    solved: LeastSquares,
    weighted: bool,
) -> HseFit:
    sigma = np.sqrt(np.diag(solved.covariance))
    slope, deviation = float(solved.estimate[model.slope]), float(sigma[model.slope])
    k, sigma_k = slope, deviation
    if model.observable:
        result = _with_lambda2(result, model, slope, deviation, solved.quantile)
        k, sigma_k = slope * model.gain, deviation * abs(model.gain)
    if model.joint:
        tau = model.names.index("tau")
        result = replace(result, delay=float(solved.estimate[tau]), sigma_delay=_finite(sigma[tau]))
    exact = solved.dof == 0
    rounding = float(np.max(np.abs(solved.residual))) < ROUNDING
    cells = data.cell[use]
    varying = None if model.varying is None else model.varying[use]
    lof = None
    if not rounding:
        lof = lack_of_fit(
            model.design[use],
            data.offset[use],
            cells,
            data.sigma[use] if weighted else None,
            varying,
        )
    psi0 = (data.reference[model.positions] + solved.estimate[: model.slope]) % (2.0 * np.pi)
    return replace(
        _with_slope(result, k, sigma_k, solved.quantile),
        psi0=tuple(float(p) for p in psi0),
        parameters=tuple(model.names),
        covariance=solved.covariance,
        dof=solved.dof,
        chi2=solved.chi2 if weighted or exact else None,
        s=float(np.sqrt(np.mean(solved.residual**2) * use.sum() / solved.dof))
        if solved.dof
        else None,
        r2=_r2(data, use, solved, weighted),
        F_lof=lof[0] if lof else None,
        p_lof=lof[1] if lof else None,
        condition=solved.condition,
        distribution=_distribution(solved, exact),
    )


def _distribution(solved: LeastSquares, exact: bool) -> str:
    if exact:
        return "turns" if np.all(np.isfinite(solved.covariance)) else ""
    return "t" if solved.student else "z"


def _r2(data: RunColumns, use: BoolArray, solved: LeastSquares, weighted: bool) -> float | None:
    """Share of the scatter about the means of the positions that the fit explains."""
    weight = data.sigma[use] ** -2 if weighted else np.ones(int(use.sum()))
    position, offset = data.position[use], data.offset[use]
    total = 0.0
    for k in np.unique(position):
        here = position == k
        mean = np.average(offset[here], weights=weight[here])
        total += float(np.sum(weight[here] * (offset[here] - mean) ** 2))
    left = float(np.sum(weight * solved.residual**2))
    return 1.0 - left / total if total > 0.0 else None


def _paper(
    result: HseFit, model: HeadingModel, data: RunColumns, use: BoolArray, drifted: FloatArray
) -> HseFit:
    """Slope of the unweighted line through the mean at each rate, steps 1 to 3 of section 2."""
    cell, offset = data.cell[use], data.offset[use]
    cells, member = np.unique(cell, return_inverse=True)
    count = np.bincount(member)
    mean = np.bincount(member, offset) / count
    rate = np.bincount(member, data.rate[use]) / count
    design = np.stack([np.ones_like(rate), rate], axis=1)
    line = np.linalg.pinv(design)
    estimate = line @ mean
    scatter = float(np.sum((offset - mean[member]) ** 2))
    dof = len(offset) - len(cells)
    if dof:  # the repeats show the scatter, whether or not the means lie on a line
        variance, student = scatter / dof / count, True
    elif len(cells) > 2:
        dof = len(cells) - 2
        variance, student = np.sum((mean - design @ estimate) ** 2) / dof / count, True
    else:
        variance, student = data.sigma[use] ** 2, False
    moved = line @ (np.bincount(member, drifted[use]) / count)
    covariance = (line * variance) @ line.T + np.outer(moved, moved)
    quantile = float(special.stdtrit(dof, 0.975) if student else special.ndtri(0.975))
    k, sigma_k = float(estimate[1]), float(np.sqrt(covariance[1, 1]))
    result = replace(
        _with_slope(result, k, sigma_k, quantile),
        psi0=(float((data.reference[model.positions[0]] + estimate[0]) % (2.0 * np.pi)),),
        parameters=("psi0[0]", "K"),
        covariance=covariance,
        dof=dof,
        distribution="t" if student else ("turns" if np.isfinite(sigma_k) else ""),
    )
    if not model.observable:
        return result
    return _with_lambda2(result, model, k / model.gain, sigma_k / model.gain, quantile)


def _from_axial(result: HseFit, model: HeadingModel) -> HseFit:
    """The axial lambda2 as the one that counts, with the slope of heading that follows."""
    axial = result.axial
    lambda2, sigma = axial.lambda2, axial.sigma_lambda2
    k, sigma_k = lambda2 * model.gain, sigma * abs(model.gain)
    return replace(
        _with_slope(result, k, sigma_k, axial.quantile),
        lambda2=lambda2,
        sigma_lambda2=_finite(sigma),
        ci95_lambda2=_interval(lambda2, sigma, axial.quantile),
    )


def _with_slope(result: HseFit, k: float, sigma: float, quantile: float) -> HseFit:
    """The result with a slope of heading against rate."""
    return replace(result, K=k, sigma_K=_finite(sigma), ci95_K=_interval(k, sigma, quantile))


def _with_lambda2(
    result: HseFit, model: HeadingModel, lambda2: float, deviation: float, quantile: float
) -> HseFit:
    """The result with a coefficient from headings; the lean's uncertainty adds to its sigma."""
    sigma = float(np.hypot(deviation, lambda2 * model.relative_C23))
    return replace(
        result,
        lambda2=lambda2,
        sigma_lambda2=_finite(sigma),
        ci95_lambda2=_interval(lambda2, sigma, quantile),
        lambda2_heading=lambda2,
        sigma_lambda2_heading=_finite(sigma),
    )
