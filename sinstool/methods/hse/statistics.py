"""Statistics of repeated headings: scatter within and between positions, sinusoid, trend.

All in the unit of the values given; azimuths in rad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from sinstool.core.arrays import ArrayLike, FloatArray, IntArray
from sinstool.core.rotation import wrapped
from sinstool.methods.hse.least_squares import least_squares
from sinstool.methods.hse.run import by_angle

# Smaller than this is the rounding of a heading, rad.
ROUNDING = 1e-15


@dataclass(frozen=True)
class Scatter:
    """Scatter of values at several positions.

    Attributes
    ----------
    n : int
        Number of values.
    std : float
        Of all values, with n - 1.
    rms : float
        About zero, with n.
    means : ndarray, shape (m,)
        Of each position, in ascending order of its number.
    within_std : float
        Pooled, about the mean of each position, with n - m.
    within_dof : int
        n - m.
    between_std : float
        Of the means, with m - 1.
    """

    n: int
    mean: float
    peak_to_peak: float
    std: float
    rms: float
    means: FloatArray
    peak_to_peak_of_means: float
    within_std: float
    within_dof: int
    between_std: float


def scatter(values: ArrayLike, position: ArrayLike) -> Scatter:
    """Scatter of values at positions.

    Parameters
    ----------
    values : array_like, shape (n,)
        At least one.
    position : array_like of int, shape (n,)
        Number of the position of each.

    Returns
    -------
    Scatter
        Deviations without a degree of freedom are NaN.
    """
    x = np.asarray(values, dtype=np.float64)
    number = np.asarray(position)
    _, member = np.unique(number, return_inverse=True)
    means = np.bincount(member, x) / np.bincount(member)
    n, m = len(x), len(means)
    within = float(np.sum((x - means[member]) ** 2))
    return Scatter(
        n=n,
        mean=float(x.mean()),
        peak_to_peak=float(np.ptp(x)),
        std=float(x.std(ddof=1)) if n > 1 else np.nan,
        rms=float(np.sqrt(np.mean(x * x))),
        means=means,
        peak_to_peak_of_means=float(np.ptp(means)),
        within_std=float(np.sqrt(within / (n - m))) if n > m else np.nan,
        within_dof=n - m,
        between_std=float(means.std(ddof=1)) if m > 1 else np.nan,
    )


@dataclass(frozen=True)
class Sinusoid:
    """``offset + cosine cos(azimuth) + sine sin(azimuth)``, fitted.

    Attributes
    ----------
    amplitude : float
        The fit is ``offset + amplitude cos(azimuth - phase)``.
    phase : float
        Azimuth of its crest, rad, in (-pi, pi].
    sigma_offset, sigma_amplitude : float
        By the residuals; that of the amplitude is along its own direction. NaN without a
        degree of freedom.
    residual_std : float
        With n - 3.
    dof : int
        n - 3.
    F, p : float
        Test of the amplitude against none: ratio of mean squares with 2 and n - 3, and the
        probability to exceed it by chance.
    """

    offset: float
    cosine: float
    sine: float
    amplitude: float
    phase: float
    sigma_offset: float
    sigma_amplitude: float
    residual_std: float
    dof: int
    F: float
    p: float

    def __call__(self, azimuth: ArrayLike) -> FloatArray:
        """Values of the fit at azimuths, rad."""
        a = np.asarray(azimuth, dtype=np.float64)
        return np.asarray(self.offset + self.cosine * np.cos(a) + self.sine * np.sin(a))


def fit_sinusoid(azimuth: ArrayLike, values: ArrayLike) -> Sinusoid:
    """Fit the sinusoid of heading-sensitive error over the headings of a level stand.

    Parameters
    ----------
    azimuth : array_like, shape (n,)
        rad.
    values : array_like, shape (n,)

    Raises
    ------
    ValueError
        If there are fewer than three distinct azimuths.
    """
    a = np.asarray(azimuth, dtype=np.float64)
    x = np.asarray(values, dtype=np.float64)
    design = np.stack([np.ones_like(a), np.cos(a), np.sin(a)], axis=1)
    try:
        fit = least_squares(design, x)
    except np.linalg.LinAlgError as error:
        raise ValueError(f"A sinusoid needs three azimuths: {error}.") from error
    offset, cosine, sine = (float(v) for v in fit.estimate)
    amplitude = float(np.hypot(cosine, sine))
    along = np.array([cosine, sine]) / amplitude if amplitude > 0.0 else np.array([1.0, 0.0])
    total = float(np.sum((x - x.mean()) ** 2))
    ratio, p = np.nan, np.nan
    if fit.dof and fit.chi2 > 0.0:
        ratio = max(total - fit.chi2, 0.0) / 2.0 / (fit.chi2 / fit.dof)
        p = float(special.fdtrc(2, fit.dof, ratio))
    return Sinusoid(
        offset=offset,
        cosine=cosine,
        sine=sine,
        amplitude=amplitude,
        phase=float(np.arctan2(sine, cosine)),
        sigma_offset=float(np.sqrt(fit.covariance[0, 0])),
        sigma_amplitude=float(np.sqrt(along @ fit.covariance[1:, 1:] @ along)),
        residual_std=fit.s,
        dof=fit.dof,
        F=float(ratio),
        p=p,
    )


def trend_t(values: ArrayLike) -> float:
    """Slope of consecutive values over its standard deviation.

    Parameters
    ----------
    values : array_like, shape (n,)
        Headings turn by turn, rad; unwrapped here.

    Returns
    -------
    float
        Follows Student's t with n - 2 where the values only scatter. 0 with fewer than four
        values or without scatter.
    """
    x = np.unwrap(np.asarray(values, dtype=np.float64))
    n = len(x)
    if n < 4:
        return 0.0
    time = np.arange(n) - 0.5 * (n - 1)
    square = float(time @ time)
    centred = x - x.mean()
    slope = float(time @ centred) / square
    residual = centred - slope * time
    s = float(np.sqrt(residual @ residual / (n - 2)))
    if s > ROUNDING:
        return slope * float(np.sqrt(square)) / s
    return float(np.copysign(np.inf, slope)) if abs(slope) > ROUNDING else 0.0


# By chance once in so many runs; and a scatter below this is rounding, rad.
TREND_P = 1e-4
SMALLEST_SPREAD = 5e-10


def drifts(values: ArrayLike) -> bool:
    """Whether consecutive values have a trend that chance seldom makes.

    Parameters
    ----------
    values : array_like, shape (n,)
        Headings turn by turn, rad.

    Returns
    -------
    bool
        By Student's t of the slope; few values have a large one by chance.
    """
    x = np.unwrap(np.asarray(values, dtype=np.float64))
    if len(x) < 4 or float(np.ptp(x)) < SMALLEST_SPREAD:
        return False
    return bool(2.0 * special.stdtr(len(x) - 2, -abs(trend_t(x))) < TREND_P)


@dataclass(frozen=True)
class Column:
    """Headings less azimuth of one treatment.

    Attributes
    ----------
    values : ndarray, shape (n,)
        rad, less their mean.
    mean : float
        What was subtracted: the azimuth of ``b0`` where the stand shows zero, rad, in
        [-pi, pi).
    sinusoid : Sinusoid or None
        None with fewer than three azimuths.
    """

    values: FloatArray
    mean: float
    scatter: Scatter
    sinusoid: Sinusoid | None


@dataclass(frozen=True)
class ValidationTable:
    """Headings at azimuths before and after correction.

    Attributes
    ----------
    ids : tuple of str
        Of the rows.
    azimuth : ndarray, shape (n,)
        Shown by the stand, rad.
    position : ndarray of int, shape (n,)
        Number of the azimuth of each row, ascending with it.
    position_azimuth : ndarray, shape (m,)
        Mean of the rows of each position, rad, in [0, 2 pi).
    """

    ids: tuple[str, ...]
    azimuth: FloatArray
    position: IntArray
    position_azimuth: FloatArray
    before: Column
    after: Column


def validation_table(
    azimuth: ArrayLike, heading: ArrayLike, corrected: ArrayLike, ids: Sequence[str] | None = None
) -> ValidationTable:
    """Compare headings before and after correction, as table 1 of the paper does.

    Yu et al., J. NUDT 35(4), 2013, 161-165: the system is turned to several azimuths on a stand
    and aligned a few times at each. What is left of heading less azimuth, less its mean, shows
    heading-sensitive error as a sinusoid of azimuth.

    Parameters
    ----------
    azimuth : array_like, shape (n,)
        Shown by the stand, rad; rows within 0.5 deg are repeats at one position.
    heading, corrected : array_like, shape (n,)
        Before and after correction, rad.
    ids : sequence of str, optional
        Names of the rows; their numbers without.

    Returns
    -------
    ValidationTable
        In the order of the rows given.

    Raises
    ------
    ValueError
        If the columns differ in length or are empty.
    """
    a = np.asarray(azimuth, dtype=np.float64)
    before, after = np.asarray(heading, np.float64), np.asarray(corrected, np.float64)
    if a.ndim != 1 or not len(a) or a.shape != before.shape or a.shape != after.shape:
        raise ValueError(f"Expected equal columns, got {a.shape}, {before.shape}, {after.shape}.")
    names = tuple(ids) if ids is not None else tuple(str(i + 1) for i in range(len(a)))
    if len(names) != len(a):
        raise ValueError(f"Expected {len(a)} names, got {len(names)}.")
    group = by_angle(a)
    start = np.array([a[np.argmax(group == k)] for k in range(group.max() + 1)])
    mean = start + np.array(
        [wrapped(a[group == k] - start[k]).mean() for k in range(group.max() + 1)]
    )
    mean %= 2.0 * np.pi
    mean[2.0 * np.pi - mean < 1e-12] = 0.0
    order = np.argsort(mean)
    position = np.argsort(order)[group]
    return ValidationTable(
        ids=names,
        azimuth=a,
        position=position,
        position_azimuth=mean[order],
        before=_column(a, before, position),
        after=_column(a, after, position),
    )


def _column(azimuth: FloatArray, heading: FloatArray, position: IntArray) -> Column:
    difference = wrapped(heading - azimuth)
    # from the first row on: values either side of 180 deg are neighbours
    offset = wrapped(difference - difference[0])
    values = offset - offset.mean()
    sinusoid = None
    if position.max() >= 2:
        sinusoid = fit_sinusoid(azimuth, values)
    return Column(
        values=values,
        mean=float(wrapped(difference[0] + offset.mean())),
        scatter=scatter(values, position),
        sinusoid=sinusoid,
    )
