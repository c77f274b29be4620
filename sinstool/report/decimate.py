"""Thinning of curves for a page; every extreme stays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sinstool.core.arrays import BoolArray, FloatArray

IndexArray = NDArray[np.intp]

FEWEST = 8


def thin(x: FloatArray, y: FloatArray, limit: int, log_x: bool = False) -> IndexArray:
    """Choose which points of a curve to draw.

    The curve is cut into stretches; of each the lowest and the highest point stay, so that no
    peak is lost however narrow it is, and one hole where there are any. The first and the last
    point stay.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        NaN and infinity make holes. Where `x` goes back somewhere, as along a path, the extremes
        of `x` stay too.
    limit : int
        How many points to keep at most, 8 or more.
    log_x : bool, optional
        The axis is logarithmic: places not above 0 are holes.

    Returns
    -------
    ndarray of int, shape (m,)
        Ascending, m at most `limit`.

    Raises
    ------
    ValueError
        If `limit` is too small, or `x` and `y` differ in length.
    """
    if limit < FEWEST:
        raise ValueError(f"at least {FEWEST} points, not {limit}.")
    if x.shape != y.shape or x.ndim != 1:
        raise ValueError(f"x is {x.shape}, y is {y.shape}.")
    n = x.size
    if n <= limit:
        return np.arange(n)

    usable = np.isfinite(x) & (x > 0.0) if log_x else np.isfinite(x)
    whole = usable & np.isfinite(y)
    places = x[usable]
    path = bool(np.any(places[1:] < places[:-1]))
    holes = not bool(np.all(whole))

    points_of_each = (4 if path else 2) + holes
    stretches = max(1, (limit - 2) // points_of_each)
    place = np.linspace(0.0, 1.0, n)
    if not path and places.size:
        place = 0.5 * (place + _along(x, usable, log_x))
    stretch = np.minimum((place * stretches).astype(np.intp), stretches - 1)

    rows = [np.array([0, n - 1], dtype=np.intp)]
    for values in (y, x) if path else (y,):
        rows += [_extreme(values, whole, stretch, np.minimum, np.inf)]
        rows += [_extreme(values, whole, stretch, np.maximum, -np.inf)]
    if holes:
        rows += [_first_of_each(np.flatnonzero(~whole), stretch)]
    return np.unique(np.concatenate(rows))


def _along(x: FloatArray, usable: BoolArray, log_x: bool) -> FloatArray:
    """Place of each point along the axis, 0 to 1, ascending.

    Stretches are cut by the mean of this and of the point's number. By number alone, the sparse
    decades at the left of a logarithmic axis would be one stretch; by place alone, a burst of
    samples between two long gaps would be, and a zoom into it would find nothing.
    """
    # Halved, as the span of two finite numbers need not be finite
    place = np.where(usable, x, 1.0)
    place = np.log(place) if log_x else 0.5 * place
    first, last = place[usable][[0, -1]]
    if last == first:
        return np.linspace(0.0, 1.0, x.size)
    along = np.where(usable, (place - first) / (last - first), 0.0)
    return np.asarray(np.maximum.accumulate(np.clip(along, 0.0, 1.0)))


def _extreme(
    values: FloatArray, whole: BoolArray, stretch: IndexArray, pick: np.ufunc, never: float
) -> IndexArray:
    """Return the first point of each stretch that holds its extreme."""
    starts = np.flatnonzero(np.diff(stretch, prepend=-1))
    extremes = pick.reduceat(np.where(whole, values, never), starts)
    lengths = np.diff(starts, append=stretch.size)
    return _first_of_each(np.flatnonzero(whole & (values == np.repeat(extremes, lengths))), stretch)


def _first_of_each(candidates: IndexArray, stretch: IndexArray) -> IndexArray:
    first = np.flatnonzero(np.diff(stretch[candidates], prepend=-1))
    return candidates[first]
