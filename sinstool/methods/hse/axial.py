"""The coefficient of heading-sensitive error from the rate along the turntable's axis.

Averaged over whole turns, all errors of the gyro's matrices leave X33 alone along the axis:
the gyro measures (1 + X33) (Omega + u), u the Earth rate along the axis. The coefficient of
eq. (14) of the paper of :mod:`sinstool.methods.hse` is lambda2 = -3 X33: the errors that turn up
in heading also turn up in this rate, where they are far easier to measure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sinstool.core.earth import EARTH_RATE
from sinstool.methods.hse.least_squares import least_squares
from sinstool.methods.hse.run import HseRun

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
    """

    c: float
    sigma_c: float
    bias: float | None
    sigma_bias: float | None
    quantile: float

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

    The gyro's bias along the axis is estimated where the rates allow; otherwise it acts as a
    scale error of ``bias/Omega``.

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
    fit = least_squares(
        np.stack(columns, axis=1),
        c * rate,
        sigma_c * np.abs(rate) if weighable else None,
        DISBELIEF,
    )
    sigma = np.sqrt(np.diag(fit.covariance))
    return AxialFit(
        c=float(fit.estimate[0]),
        sigma_c=float(sigma[0]),
        bias=float(fit.estimate[1]) if distinct else None,
        sigma_bias=float(sigma[1]) if distinct else None,
        quantile=fit.quantile,
    )
