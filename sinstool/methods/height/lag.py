"""How far a barometer's heights lag behind the motion, by the accelerometer.

Within some seconds the second integral of the accelerometer is the height but for a level, a drift
and an acceleration. Less these three, which are estimated in each of many windows, both are
compared at one lag after the other: that of late stamps, and that of a slow sensor, which follows
quick climbs less. (Compared as rates, the noise of a usual barometer hides a lag of a second.)

References
----------
.. [1] B. Efron, "The Jackknife, the Bootstrap and Other Resampling Plans", SIAM, 1982.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.first_order import carry_over
from sinstool.core.order_statistics import median, quantile
from sinstool.core.timeline import SECOND

GRID_NS = SECOND // 10
"""Both are taken at times so far apart, ns."""

# Windows, and the span over which a climb rate is a difference, in steps of the grid.
_WINDOW, _RATE = 200, 30
# Lags that are tried, in steps of the grid.
_LAGS = np.arange(-10, 101)
# Heights that are no further apart than this, s, are interpolated.
_NEAR_S = 2.5
# A change within a step is a jump if it is so many times the usual one, and larger than this, m.
_JUMP_TIMES, _JUMP_M = 10.0, 5.0
# At the lag heights follow the accelerometer's by a factor this near to 1.
_FOLLOWS = 0.3
# Fewest windows, least lag, s, and how many of its sigmas it is at least.
_LEAST_WINDOWS, LEAST_S, _SIGMAS = 4, 0.3, 4.0
# All windows but the one that shows the lag best make it likelier than none by this in -2 log
# likelihood, and by so many times what speaks against it, which is chance.
_LEAST_GAIN, _GAIN_SIGMAS = 50.0, 3.0


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
    if len(time_ns) < 2 or count < _LEAST_WINDOWS * _WINDOW:
        return None
    seconds, shown = _means(time_ns, height)
    at = (first_ns - time_ns[0]) / SECOND + np.arange(count) * (GRID_NS / SECOND)
    after = np.clip(np.searchsorted(seconds, at), 1, len(seconds) - 1)
    there = (seconds[after] - seconds[after - 1] <= _NEAR_S) & (at > 0.0) & (at < seconds[-1])
    barometer = np.interp(at, seconds, shown)
    change = np.abs(np.diff(barometer, prepend=barometer[0]))
    jumps = change > max(_JUMP_TIMES * float(median(change)), _JUMP_M)
    begins = _whole(known & there & ~jumps)
    if len(begins) < _LEAST_WINDOWS:
        return None
    rows = begins[:, None] + np.arange(_WINDOW)
    felt = np.cumsum(climb) * (GRID_NS / SECOND)
    theirs = _bent(barometer[rows])
    costs = [_costs(theirs, (felt[rows - lag] for lag in _LAGS.tolist()))]
    costs.append(_costs(theirs, (slowed[rows] for slowed in _slowed(felt))))
    cost = min(costs, key=lambda one: float(one.sum(axis=0).min()))
    total, best = cost.sum(axis=0), int(np.argmin(cost.sum(axis=0)))
    lag = float(_least(total[None])[0])
    without = _least(total - cost)
    spread = float(np.sqrt((len(begins) - 1) * np.mean(np.square(without - without.mean()))))
    if lag < max(LEAST_S, _SIGMAS * spread) or best >= len(_LAGS) - 2:
        return None
    likelier = cost[:, _LAGS.tolist().index(0)] - cost[:, best]
    against = float(np.sqrt(np.sum(np.square(np.minimum(likelier, 0.0)))))
    if likelier.sum() - likelier.max() < max(_LEAST_GAIN, _GAIN_SIGMAS * against):
        return None
    ours = _bent(felt[rows - int(_LAGS[best])])
    if abs(np.sum(theirs * ours) / np.sum(np.square(ours)) - 1.0) > _FOLLOWS:
        return None
    rate = (barometer[_RATE:] - barometer[:-_RATE]) / (_RATE * GRID_NS / SECOND)
    middle = rows[:, _RATE // 2 : -_RATE // 2] - _RATE // 2
    return Lag(lag, lag * float(quantile(np.abs(rate[middle].ravel()), 0.99)))


def _means(time_ns: IntArray, height: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Means of times, s since the first, and of heights over steps of the grid that have any."""
    seconds = (time_ns - time_ns[0]) / SECOND
    _, first, number = np.unique(time_ns // GRID_NS, return_index=True, return_counts=True)
    return np.add.reduceat(seconds, first) / number, np.add.reduceat(height, first) / number


def _whole(good: BoolArray) -> IntArray:
    """First rows of windows that are good, as are the rows before them for all lags."""
    before, after = int(_LAGS[-1]), -int(_LAGS[0])
    total = np.concatenate([[0], np.cumsum(good)])
    begins = np.arange(before, len(good) - _WINDOW - after, _WINDOW)
    within = total[begins + _WINDOW + after] - total[begins - before]
    return np.asarray(begins[within == before + _WINDOW + after])


def _slowed(height: FloatArray) -> Iterator[FloatArray]:
    """The height as sensors of first order show it, one lag after the other; none is early."""
    for lag in _LAGS.tolist():
        keep = float(np.exp(-1.0 / lag)) if lag > 0 else 0.0
        slowed = (1.0 - keep) * (height - height[0])
        carry_over(np.full(len(slowed), keep), slowed[:, None])
        yield slowed


def _costs(theirs: FloatArray, ours: Iterable[FloatArray]) -> FloatArray:
    """-2 log likelihood of each window, whose noise is unknown, at each lag; shape (n, lags)."""
    squares = [np.square(theirs - _bent(one)).sum(axis=1) for one in ours]
    tiny = float(np.finfo(np.float64).tiny)
    return np.asarray(_WINDOW * np.log(np.maximum(np.stack(squares, axis=1), tiny)))


def _bent(windows: FloatArray) -> FloatArray:
    """Rows less their level, drift and acceleration."""
    time = np.linspace(-1.0, 1.0, windows.shape[1])
    basis, _ = np.linalg.qr(np.stack([np.ones_like(time), time, time**2], axis=1))
    return np.asarray(windows - (windows @ basis) @ basis.T)


def _least(squares: FloatArray) -> FloatArray:
    """Lag, s, at which each row is least, by a parabola through the three values there."""
    k = np.clip(np.argmin(squares, axis=1), 1, len(_LAGS) - 2)
    low, middle, high = (squares[np.arange(len(k)), k + step] for step in (-1, 0, 1))
    bend = low - 2.0 * middle + high
    shift = 0.5 * (low - high) / np.where(bend > 0.0, bend, np.inf)
    return np.asarray((_LAGS[k] + np.clip(shift, -1.0, 1.0)) * (GRID_NS / SECOND))
