"""Weighted linear least squares with diagnostics.

Covariance, leverage, externally studentised residuals and the test for lack of fit, as in
Seber and Lee, "Linear Regression Analysis", 2nd ed., 2003, chapters 3, 4 and 10.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from sinstool.core.arrays import FloatArray, IntArray

# Below this ratio of singular values of the normalised columns two columns are one.
RANK_TOLERANCE = 1e-9
# Given standard deviations are disbelieved where chi-squared is less probable than this.
DISBELIEF = 0.01


@dataclass(frozen=True)
class LeastSquares:
    """Estimate of ``p`` parameters from ``n`` observations.

    Attributes
    ----------
    estimate : ndarray, shape (p,)
    covariance : ndarray, shape (p, p)
        With standard deviations given: scaled by max(1, chi2/dof), so that scatter beyond
        them is not overlooked (Birge 1932). Without: scaled by chi2/dof; NaN if dof is 0.
    residual : ndarray, shape (n,)
        Observed less fitted.
    leverage : ndarray, shape (n,)
        Diagonal of the hat matrix; sums to p.
    studentised : ndarray, shape (n,)
        Residual over its standard deviation, from a fit without this observation; follows
        Student's t with dof - 1. NaN where that fit is not possible.
    chi2 : float
        Weighted sum of squared residuals; of the unweighted ones without given deviations.
    dof : int
        n - p.
    s : float
        sqrt(chi2/dof): unit of the observations without given deviations, else 1.
    condition : float
        Condition number of the weighted design with columns of length 1.
    student : bool
        The scatter is estimated from the residuals.
    quantile : float
        Standard deviations in half of a 95 % interval.
    """

    estimate: FloatArray
    covariance: FloatArray
    residual: FloatArray
    leverage: FloatArray
    studentised: FloatArray
    chi2: float
    dof: int
    s: float
    condition: float
    student: bool
    quantile: float


def _weighted(
    design: FloatArray, observed: FloatArray, sigma: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    if sigma is None:
        return design, observed
    return design / sigma[:, None], observed / sigma


def least_squares(
    design: FloatArray,
    observed: FloatArray,
    sigma: FloatArray | None = None,
    disbelief: float = DISBELIEF,
) -> LeastSquares:
    """Fit ``observed = design @ parameters``.

    Parameters
    ----------
    design : ndarray, shape (n, p)
    observed : ndarray, shape (n,)
    sigma : ndarray, shape (n,), optional
        Standard deviations of the observations; equal and unknown without.
    disbelief : float
        The deviations are disbelieved where chi-squared is less probable than this.

    Returns
    -------
    LeastSquares
        Its interval is Student's t with dof where the scatter is estimated from the residuals
        (no deviations given, or those given are disbelieved), else normal.

    Raises
    ------
    numpy.linalg.LinAlgError
        If there are fewer observations than parameters or the columns are dependent.
    """
    n, p = design.shape
    if n < p:
        raise np.linalg.LinAlgError(f"{n} observations for {p} parameters")
    rows, values = _weighted(design, observed, sigma)
    length = np.linalg.norm(rows, axis=0)
    if not np.all(length > 0.0):
        raise np.linalg.LinAlgError("a column of the design is zero")
    u, singular, vt = np.linalg.svd(rows / length, full_matrices=False)
    if singular[-1] < RANK_TOLERANCE * singular[0]:
        raise np.linalg.LinAlgError("columns of the design are dependent")
    estimate = vt.T @ ((u.T @ values) / singular) / length
    root = (vt.T / singular) / length[:, None]
    residual = observed - design @ estimate
    weighted = residual if sigma is None else residual / sigma
    leverage = np.sum(u * u, axis=1)
    chi2 = float(weighted @ weighted)
    dof = n - p
    variance = chi2 / dof if dof else np.nan
    if sigma is None:
        scale = variance
        estimated = True
    else:
        scale = max(1.0, variance) if dof else 1.0
        estimated = dof > 0 and bool(special.chdtrc(dof, chi2) < disbelief)
    student = estimated and dof > 0
    quantile = special.stdtrit(dof, 0.975) if student else special.ndtri(0.975)
    return LeastSquares(
        estimate=estimate,
        covariance=scale * (root @ root.T),
        residual=residual,
        leverage=leverage,
        studentised=_studentised(weighted, leverage, chi2, dof),
        chi2=chi2,
        dof=dof,
        s=float(np.sqrt(variance)),
        condition=float(singular[0] / singular[-1]),
        student=student,
        quantile=float(quantile),
    )


def _studentised(residual: FloatArray, leverage: FloatArray, chi2: float, dof: int) -> FloatArray:
    """Externally studentised residuals; Seber and Lee, eq. (10.5)."""
    result = np.full(len(residual), np.nan)
    if dof < 2:
        return result
    free = leverage < 1.0 - 1e-9  # an observation that alone holds a parameter has no residual
    square = residual[free] ** 2 / (1.0 - leverage[free])
    # rounding must not make a perfect fit of the others negative
    others = np.maximum((chi2 - square) / (dof - 1), 1e-24 * chi2)
    with np.errstate(invalid="ignore", divide="ignore"):
        result[free] = np.sign(residual[free]) * np.sqrt(square / others)
    return result


def outlier_limit(n: int, dof: int, alpha: float) -> float:
    """Bound of the largest externally studentised residual of ``n``.

    Parameters
    ----------
    n : int
        Number of observations.
    dof : int
        Of the fit with all of them.
    alpha : float
        Probability that the largest of sound observations passes it, at most (Bonferroni).

    Returns
    -------
    float
        Infinite where ``dof < 2``.
    """
    if dof < 2:
        return float("inf")
    return float(special.stdtrit(dof - 1, 1.0 - alpha / (2.0 * n)))


def lack_of_fit(
    design: FloatArray,
    observed: FloatArray,
    cells: IntArray,
    sigma: FloatArray | None = None,
    also: FloatArray | None = None,
) -> tuple[float, float] | None:
    """F-test of a fit against the means of its repeats; Seber and Lee, section 4.4.

    Parameters
    ----------
    design : ndarray, shape (n, p)
    observed : ndarray, shape (n,)
    cells : ndarray of int, shape (n,)
        Number of the cell; observations in a cell are repeats.
    sigma : ndarray, shape (n,), optional
        Standard deviations of the observations.
    also : ndarray, shape (n, k), optional
        Columns of the design that vary among repeats, such as time.

    Returns
    -------
    F, p : float
        The ratio of the mean squares and the probability to exceed it by chance; None where
        there are no repeats or no more cells than parameters.
    """
    means = (cells[:, None] == np.unique(cells)[None, :]).astype(np.float64)
    full = means if also is None else np.hstack([means, also])
    rows, values = _weighted(full, observed, sigma)
    solution, _, rank, _ = np.linalg.lstsq(rows, values, rcond=1e-12)
    pure = float(np.sum((values - rows @ solution) ** 2))
    n, p = design.shape
    more, free = int(rank) - p, n - int(rank)
    if more < 1 or free < 1:
        return None
    total = least_squares(design, observed, sigma).chi2
    if pure <= 1e-24 * float(values @ values):
        return None  # repeats that agree to rounding say nothing of scatter
    ratio = max(total - pure, 0.0) / more / (pure / free)
    return float(ratio), float(special.fdtrc(more, free, ratio))
