"""Medians and quantiles of plain arrays.

NumPy's own functions import its masked arrays, which takes a twentieth of the time that a short log
takes, and spend longer on checking the axis than on a short column.
"""

from __future__ import annotations

from math import floor

import numpy as np

from sinstool.core.arrays import ArrayLike

# Of normal values: their sigma over their median absolute deviation (MAD), and the sigma of the
# median of many over that of their mean.
SIGMA_PER_MAD, MEDIAN_OVER_MEAN = 1.4826, 1.2533


def median(values: ArrayLike, axis: int | None = None) -> np.ndarray:
    """Median of all values or along an axis; NaN where a value is NaN.

    Parameters
    ----------
    values : array_like
        At least one along the axis.
    """
    return quantile(values, 0.5, axis)


def quantile(values: ArrayLike, share: float, axis: int | None = None) -> np.ndarray:
    """Quantile by linear interpolation, of all values or along an axis; NaN where a value is NaN.

    Parameters
    ----------
    values : array_like
        At least one along the axis.
    share : float
        Fraction of the values below the quantile, 0 to 1.
    axis : int, optional
        By default all values.
    """
    array = np.asarray(values, dtype=np.float64)
    if axis is None:
        array, axis = array.ravel(), 0
    last = array.shape[axis] - 1
    if last < 0:
        return np.asarray(np.full(np.delete(array.shape, axis), np.nan))[()]
    place = share * last
    low = floor(place)
    part = place - low
    high = low + 1 if part else low
    # NaN are sorted last
    ordered = np.partition(array, sorted({low, high, last}), axis=axis)
    below, above, most = (ordered.take(k, axis=axis) for k in (low, high, last))
    with np.errstate(invalid="ignore"):
        step = np.where(below == above, 0.0, above - below)
        if part == 0.5:
            between = 0.5 * (below + above)
        else:
            between = below + part * step if part < 0.5 else above - (1.0 - part) * step
    return np.where(np.isnan(most), np.nan, between)[()]
