"""The coefficient of heading-sensitive error from the rate along the turntable's axis.

Averaged over whole turns, all errors of the gyro's matrices leave X33 alone along the axis:
the gyro measures (1 + X33) (Omega + u), u the Earth rate along the axis. The coefficient of
eq. (14) of the paper of :mod:`sinstool.methods.hse` is lambda2 = -3 X33: the errors that turn up
in heading also turn up in this rate, where they are far easier to measure.

So does a bias of the gyros that drifts as they warm up, where the rates rise from run to run. The
turns of each run show such a drift: :mod:`sinstool.methods.hse.bias_walk`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from sinstool.core.arrays import FloatArray
from sinstool.core.earth import EARTH_RATE
from sinstool.methods.hse.bias_walk import fit_walking_bias
from sinstool.methods.hse.least_squares import least_squares
from sinstool.methods.hse.run import HseRun
from sinstool.methods.hse.statistics import TREND_P

# Rates must differ by this share of the largest for the gyro's bias to be separable.
DISTINCT_RATES = 0.1
# Sigmas from the scatter of turns are rejected early, as they do not include the drift of the bias
# between runs.
DISBELIEF = 0.5


@dataclass(frozen=True)
class AxialFit:
    """Error of the rate along the axis over several runs.

    Attributes
    ----------
    c : float
        X33, relative.
    sigma_c : float
        NaN when neither the turns nor the runs show it.
    bias : float or None
        Of the gyro along the axis, rad/s; None when it was not estimated, so that it is part of
        ``c``.
    sigma_bias : float or None
        Of ``bias``, rad/s.
    quantile : float
        Standard deviations in half of a 95 % interval.
    drift : float
        By which the bias drifts in a log at most, rad/s, as the turns show; 0 if they show none.
    """

    c: float
    sigma_c: float
    bias: float | None
    sigma_bias: float | None
    quantile: float
    drift: float = 0.0

    @property
    def lambda2(self) -> float:
        """Coefficient of heading-sensitive error, rad."""
        return -3.0 * self.c

    @property
    def sigma_lambda2(self) -> float:
        """Standard deviation of ``lambda2``, rad."""
        return 3.0 * self.sigma_c


def earth_rate_along_axis(run: HseRun) -> float:
    """Earth rate along the (down) axis of the table, rad/s."""
    down = np.cos(run.theta) * np.cos(run.gamma)
    north = np.cos(run.heading) * np.sin(run.theta) * np.cos(run.gamma)
    north += np.sin(run.heading) * np.sin(run.gamma)
    return float(EARTH_RATE * (north * np.cos(run.latitude) - down * np.sin(run.latitude)))


def fit_axial(runs: Sequence[HseRun], weighted: bool) -> AxialFit:
    """Fit the error of the rate along the axis as ``c (Omega + u) + bias``.

    The gyro's bias along the axis is estimated where the rates allow, as one that may change from
    run to run where the turns show how much; otherwise it acts as a scale error of ``bias/Omega``.
    Without weights, a drift of it that the turns show widens the sigmas by what it changes.

    Parameters
    ----------
    runs : sequence of HseRun
        At least one.
    weighted : bool
        Weight the runs by the scatter of their turns, where all runs have one.
    """
    rate = np.array([r.rate + earth_rate_along_axis(r) for r in runs])
    c = np.array([r.c_axial for r in runs])
    sigma_c = np.array([r.sigma_c_axial for r in runs])
    weighable = weighted and bool(np.all(np.isfinite(sigma_c) & (sigma_c > 0.0)))
    distinct = np.ptp(rate) > DISTINCT_RATES * np.max(np.abs(rate))
    columns = [rate, np.ones_like(rate)] if distinct else [rate]
    design = np.stack(columns, axis=1)
    sigmas = sigma_c * np.abs(rate) if weighable else None
    fit = least_squares(design, c * rate, sigmas, DISBELIEF)
    estimate, sigma = fit.estimate, np.sqrt(np.diag(fit.covariance))
    drifted = drift_of_bias(runs)
    walking = None
    if sigmas is not None and distinct:
        walking = fit_walking_bias(runs, design, c * rate, sigmas)
    if walking is not None:
        estimate, sigma = walking[0], np.sqrt(np.diag(walking[1]))
    elif drifted.any():
        without = least_squares(design, c * rate - drifted, sigmas, DISBELIEF)
        sigma = np.hypot(sigma, without.estimate - fit.estimate)
    return AxialFit(
        c=float(estimate[0]),
        sigma_c=float(sigma[0]),
        bias=float(estimate[1]) if distinct else None,
        sigma_bias=float(sigma[1]) if distinct else None,
        quantile=fit.quantile,
        drift=float(np.ptp(drifted)),
    )


def drift_of_bias(runs: Sequence[HseRun]) -> FloatArray:
    """By how much the bias along the axis has drifted since the first run of each log, rad/s.

    Parameters
    ----------
    runs : sequence of HseRun
        With ``axial_drift`` in their quality.

    Returns
    -------
    ndarray, shape (n,)
        The integral of the slopes over the turns of the runs; zeros where these are only noise.
    """
    slope = np.array([run.quality.get("axial_drift", np.nan) for run in runs])
    sigma = np.array([run.quality.get("axial_drift_sigma", np.nan) for run in runs])
    drifted = np.zeros(len(runs))
    known = sigma > 0.0
    if not known.any():
        return drifted
    # Student's t of each as a deviate of the normal distribution, so that their squares add up
    dof = np.array([run.n_turns - 2.0 for run in runs])[known]
    p = special.stdtr(dof, -np.abs(slope[known] / sigma[known]))
    chi2 = float(np.sum(special.ndtri(np.maximum(p, 1e-300)) ** 2))
    if special.chdtrc(len(dof), chi2) > TREND_P:
        return drifted
    slope[~known] = slope[known].mean()
    middle = np.array([run.t_start_s + 0.5 * run.duration_s for run in runs])
    for source in {run.source for run in runs}:
        rows = np.array([k for k, run in enumerate(runs) if run.source == source])
        rows = rows[np.argsort(middle[rows])]
        steps = 0.5 * (slope[rows][1:] + slope[rows][:-1]) * np.diff(middle[rows])
        drifted[rows[1:]] = np.cumsum(steps)
    return drifted
