"""How far a barometer's heights lag behind the motion, by the accelerometer.

Both show how fast the vehicle climbs: the barometer by its differences, late; the accelerometer by
its integral, at once, but for a drift that changes slowly. So both lose what is slower than some
seconds, and are compared at one offset after the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.order_statistics import median, quantile
from sinstool.core.timeline import SECOND

GRID_NS = SECOND // 10
"""Both are taken at times so far apart, ns."""

# Mean over so long, in steps of the grid, which the noise of a barometer needs, and twice the one
# that is taken off.
_SHORT, _LONG = 11, 201
# Lags that are tried, in steps of the grid.
_LAGS = np.arange(-10, 101)
# Heights that are no further apart than this, s, are interpolated.
_NEAR_S = 2.5
# A change within a step is a jump if it is so many times the usual one, and larger than this, m.
_JUMP_TIMES, _JUMP_M = 10.0, 5.0
# Both must agree at the lag to this share of the variance, which is so much less than without one;
# and so must parts of the log, to so many s or this share of the lag.
_AGREES, _LESS, _PARTS, _ALIKE_S, _ALIKE_SHARE = 0.5, 0.5, 3, 0.5, 0.25
# Least time in which both are known, s, and least lag, s.
_LEAST_TIME_S, LEAST_S = 40.0, 0.3


@dataclass(frozen=True)
class Lag:
    """By how much heights are late, and by how far that puts them off.

    Attributes
    ----------
    seconds : float
        s.
    metres : float
        That much at the fastest climb or descent but for one hundredth of the time, m.
    """

    seconds: float
    metres: float


def height_lag(
    first_ns: int, climb: FloatArray, known: BoolArray, time_ns: IntArray, height: FloatArray
) -> Lag | None:
    """The lag of heights behind a climb rate, where it shows clearly.

    Parameters
    ----------
    first_ns : int
        Time of the first climb rate, ns; one follows every `GRID_NS`.
    climb : ndarray, shape (n,)
        Integral of the upward acceleration, m/s; its level and drift do not matter.
    known : ndarray of bool, shape (n,)
        Where samples show it.
    time_ns : ndarray of int, shape (m,)
        Of the heights, increasing.
    height : ndarray, shape (m,)
        m.
    """
    count = len(climb)
    if len(time_ns) < 2 or count * GRID_NS < _LEAST_TIME_S * SECOND:
        return None
    at = (first_ns - time_ns[0]) / SECOND + np.arange(-1, count) * (GRID_NS / SECOND)
    seconds = (time_ns - time_ns[0]) / SECOND
    after = np.clip(np.searchsorted(seconds, at), 1, len(seconds) - 1)
    there = (seconds[after] - seconds[after - 1] <= _NEAR_S) & (at > 0.0) & (at < seconds[-1])
    change = np.diff(np.interp(at, seconds, height))
    usual = float(median(np.abs(change)))
    jumps = np.abs(change) > max(_JUMP_TIMES * usual, _JUMP_M)
    good = known & there[1:] & there[:-1] & ~jumps
    good = ~_near(~good, _SHORT + _LONG + len(_LAGS))
    rate = _mean(change * (SECOND / GRID_NS), _SHORT)
    shown, felt = _without_drift(rate), _without_drift(_mean(climb, _SHORT))
    rows = np.flatnonzero(good)
    if len(rows) * GRID_NS < _LEAST_TIME_S * SECOND:
        return None
    lag, least, none = _best(shown, felt, rows)
    size = float(np.mean(felt[rows] ** 2))
    if lag < LEAST_S or least > min(_AGREES * size, _LESS * none):
        return None
    for part in np.array_split(rows, _PARTS):
        moves = float(np.mean(felt[part] ** 2)) > 0.1 * size
        if moves and abs(_best(shown, felt, part)[0] - lag) > max(_ALIKE_S, _ALIKE_SHARE * lag):
            return None
    return Lag(lag, lag * float(quantile(np.abs(rate[rows]), 0.99)))


def _best(shown: FloatArray, felt: FloatArray, rows: IntArray) -> tuple[float, float, float]:
    """Lag at which both are most alike, s, and the mean squared difference there and without."""
    off = np.array([np.mean((shown[rows] - felt[rows - lag]) ** 2) for lag in _LAGS])
    k = int(np.argmin(off))
    shift = 0.0
    if 0 < k < len(off) - 1:
        bend = off[k - 1] - 2.0 * off[k] + off[k + 1]
        shift = 0.5 * float(off[k - 1] - off[k + 1]) / bend if bend > 0.0 else 0.0
    none = float(off[np.flatnonzero(_LAGS == 0)[0]])
    # A change of height is that of the step before its time
    return (float(_LAGS[k]) + shift - 0.5) * GRID_NS / SECOND, float(off[k]), none


def _mean(values: FloatArray, count: int) -> FloatArray:
    """Running mean over an odd number of rows, 0 beyond the ends."""
    return np.convolve(values, np.full(count, 1.0 / count), mode="same")


def _without_drift(values: FloatArray) -> FloatArray:
    """Less the running mean, of which a straight line is left nothing."""
    return values - _mean(values, _LONG)


def _near(rows: BoolArray, count: int) -> BoolArray:
    """Rows that are within so many of one of these, or of the ends."""
    padded = np.pad(rows, count, constant_values=True)
    total = np.concatenate([[0], np.cumsum(padded)])
    return np.asarray(total[2 * count + 1 :] - total[: -2 * count - 1] > 0)
