"""The rate along the axis over runs, by a gyro whose bias walks or drifts meanwhile.

A bias that changes by little within a run, and by more from the first run to the last, looks like
an error in proportion to the rate where the rates rise in time. Two things tell them apart: rates
in another order, and the slopes of the rate within each run, which an error in proportion does not
have. Both enter here: the mean rate and the slope of each run are linear functionals of the bias,
beside their own noise, so that the error of scale is a generalised least-squares estimate.

The bias is constant, or a random walk, or has a drift of its own in each log, even or not quite, as
gyros have that warm up; by how much is unknown. The restricted likelihood (restricted, as the
parameters are unknown, too) is computed for each of these and for several sizes, and the estimates
are averaged with it as weight, so that a change that the runs do not exclude is part of the sigma.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray
from sinstool.core.order_statistics import median
from sinstool.methods.hse.run import HseRun

# Standard deviations of the change over a run, over that of the noise of its mean, and how likely a
# constant bias is before any run is seen; all sizes of a walk and of a drift are as likely
_RATIOS = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
_CONSTANT = 0.2
# Warming up is no straight line: a third kind is one that walks by this share of its variance too
_BENT = 0.1
# Nothing is known of the time between logs without stamps, and a bias does not walk for ever, s
_BETWEEN_LOGS_S = 3600.0
_STEPS = 40  # of a run
# Slopes are not surer than this, over what the noise of the mean rate makes: without any noise the
# covariance would be singular
_LEAST_SLOPE = 1e-2


def fit_walking_bias(
    runs: Sequence[HseRun], design: FloatArray, rate_error: FloatArray, sigma: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Fit the errors of the rate along the axis beside a bias that walks.

    Parameters
    ----------
    runs : sequence of HseRun
        With ``axial_drift`` and its sigma in their quality, where their turns show it.
    design : ndarray, shape (n, p)
        Errors of the mean rates for each parameter.
    rate_error : ndarray, shape (n,)
        rad/s, means over the runs.
    sigma : ndarray, shape (n,)
        Of their noise, rad/s.

    Returns
    -------
    estimate : ndarray, shape (p,)
        A constant is the mean bias over the runs.
    covariance : ndarray, shape (p, p)
        Scaled by chi-squared over the degrees of freedom where that is above 1 (Birge 1932).
        Both are None together where no run shows a slope.
    """
    slope = np.array([run.quality.get("axial_drift", np.nan) for run in runs])
    slope_sigma = np.array([run.quality.get("axial_drift_sigma", np.nan) for run in runs])
    dof = np.array([run.n_turns - 2.0 for run in runs])
    known = (slope_sigma > 0.0) & (dof > 2.0)
    if not known.any():
        return None
    # Student's t is wider than the normal distribution by this
    slope_variance = slope_sigma[known] ** 2 * dof[known] / (dof[known] - 2.0)
    duration = np.array([run.duration_s for run in runs])
    least = _LEAST_SLOPE * np.sqrt(12.0) * sigma[known] / duration[known]
    slope_variance = np.maximum(slope_variance, least**2)
    white = np.concatenate([sigma**2, slope_variance])
    observed = np.concatenate([rate_error, slope[known]])
    rows = np.concatenate([design, np.zeros((int(known.sum()), design.shape[1]))])
    length = float(median(duration))
    unit = float(median(sigma**2))
    walk = 3.0 / length * _covariance_of_walk(runs, known)
    line = _covariance_of_lines(runs, known) / length**2
    kinds = (walk, line, line + _BENT * walk)
    changes = [ratio**2 * unit * kind for kind in kinds for ratio in _RATIOS]
    found = [_generalised(rows, observed, np.diag(white) + one) for one in (0.0, *changes)]
    likelihood = np.array([one[2] for one in found])
    weights = np.exp(likelihood - likelihood.max())
    weights[0] *= _CONSTANT / (1.0 - _CONSTANT) * len(changes)
    weights /= weights.sum()
    estimates = np.array([one[0] for one in found])
    mean = weights @ estimates
    off = estimates - mean
    covariance = np.einsum("k,kij->ij", weights, [one[1] for one in found])
    return mean, covariance + np.einsum("k,ki,kj->ij", weights, off, off)


def _generalised(
    design: FloatArray, observed: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Generalised least squares: estimate, covariance, log of the restricted likelihood."""
    # Rates and slopes have units apart by the length of a run: to unit diagonal
    unit = np.sqrt(np.diag(covariance))
    root = np.linalg.cholesky(covariance / np.outer(unit, unit))
    rows = np.linalg.solve(root, design / unit[:, None])
    values = np.linalg.solve(root, observed / unit)
    scale = np.linalg.norm(rows, axis=0)
    inverse = np.linalg.inv(rows.T @ rows / np.outer(scale, scale)) / np.outer(scale, scale)
    estimate = inverse @ rows.T @ values
    residual = values - rows @ estimate
    chi2 = float(residual @ residual)
    likelihood = -np.log(unit).sum() - np.log(np.diag(root)).sum() - 0.5 * chi2
    likelihood += 0.5 * np.linalg.slogdet(inverse)[1]
    dof = len(observed) - design.shape[1]
    return estimate, max(1.0, chi2 / dof) * inverse, float(likelihood)


def _covariance_of_walk(runs: Sequence[HseRun], known: BoolArray) -> FloatArray:
    """Covariance of the means of a unit random walk over runs, and of its slopes in some, s.

    Means are less their mean. A functional that weights the walk by f(t) weights its steps at u by
    the integral of f from u on.
    """
    starts = _starts(runs)
    order = np.argsort(starts)
    n, length = len(runs), np.array([run.duration_s for run in runs])
    middle = (np.arange(_STEPS) + 0.5) / _STEPS
    mean, slope, duration = [], [], list[FloatArray]()
    end = starts[order[0]]
    for place, k in enumerate(order):
        later = np.zeros(n)
        later[order[place:]] = 1.0
        mean.append(later[None])
        slope.append(np.zeros((1, n)))
        duration.append(np.array([max(starts[k] - end, 0.0)]))
        inside = np.tile(later, (_STEPS, 1))
        inside[:, k] = 1.0 - middle
        tilted = np.zeros((_STEPS, n))
        tilted[:, k] = 6.0 * middle * (1.0 - middle) / length[k]
        mean.append(inside)
        slope.append(tilted)
        duration.append(np.full(_STEPS, length[k] / _STEPS))
        end = starts[k] + length[k]
    means = np.concatenate(mean)
    means -= means.mean(axis=1, keepdims=True)
    functionals = np.concatenate([means, np.concatenate(slope)[:, known]], axis=1)
    return np.asarray((functionals.T * np.concatenate(duration)) @ functionals)


def _covariance_of_lines(runs: Sequence[HseRun], known: BoolArray) -> FloatArray:
    """The same of lines through each log, whose slopes are independent with variance 1, s^2."""
    middle = np.array([run.t_start_s + 0.5 * run.duration_s for run in runs])
    sources = [run.source for run in runs]
    lines = []
    for source in dict.fromkeys(sources):
        here = np.array([one == source for one in sources])
        means = np.where(here, middle - middle[here].mean(), 0.0)
        lines.append(np.concatenate([means, here[known].astype(np.float64)]))
    return np.asarray(np.transpose(lines) @ np.array(lines))


def _starts(runs: Sequence[HseRun]) -> FloatArray:
    """Starts of the runs on one line of time, on which logs lie an hour apart at most, s."""
    logs: dict[str, list[int]] = {}
    for k, run in enumerate(runs):
        logs.setdefault(run.source, []).append(k)
    stamps = {log: runs[of[0]].log_start_ns for log, of in logs.items()}
    stamped = [stamp for stamp in stamps.values() if stamp is not None]
    ordered = list(logs)
    if len(stamped) == len(logs):
        ordered.sort(key=lambda log: stamps[log] or 0)
    starts = np.zeros(len(runs))
    line, before, ended_ns = 0.0, 0.0, None
    for log in ordered:
        begins = min(runs[k].t_start_s for k in logs[log])
        ends = max(runs[k].t_start_s + runs[k].duration_s for k in logs[log])
        stamp = stamps[log] if len(stamped) == len(logs) else None
        apart = _BETWEEN_LOGS_S
        if stamp is not None and ended_ns is not None:
            apart = min(max(1e-9 * (stamp - ended_ns) + begins, 0.0), _BETWEEN_LOGS_S)
        line = before + apart
        for k in logs[log]:
            starts[k] = line + runs[k].t_start_s - begins
        before = line + ends - begins
        ended_ns = None if stamp is None else stamp + round(1e9 * ends)
    return starts
