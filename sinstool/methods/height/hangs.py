"""A height sensor that hangs: it repeats one value for much longer than it usually does.

A coarse sensor without noise also repeats a value, while it rests or stays level. When it goes on,
it does so by the step to the next value, while one that hung leaps. A sensor that hangs until the
end of the log, or goes on at the height where it hung, is told by its noise alone, and only
where that noise was seen at rest: what wind and motion add to it may cease. A value that lasts
until the IMU no longer rests is right, though propellers may then make it leap.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sinstool.core.arrays import ArrayLike, BoolArray, FloatArray, IntArray
from sinstool.core.order_statistics import quantile
from sinstool.core.timeline import SECOND

# Fewest values that show how long the sensor usually keeps one: the longest but for this share.
LEAST_VALUES, USUAL_SHARE = 50, 0.99
# It hangs if it keeps one so many times as long, in samples, and for such a time at least, s.
UNUSUAL, LEAST_S = 10, 1.0
# It leaps by so many times a large change from one value to the next: that of the nine tenths.
LEAP, LARGE_SHARE = 5.0, 0.9
# Noise changes its sign between neighbours in two of three cases. Blocks of so many samples show
# noise if so many do, and it is there at all times if it is in such a share of so many blocks.
BLOCK, LEAST_TURNS, LEAST_BLOCKS, ALWAYS = 20, 4, 5, 0.95


def hung_rows(
    time_ns: ArrayLike, values: ArrayLike, rests: Iterable[tuple[int, int]] = ()
) -> BoolArray:
    """Samples that repeat what the sensor measured before it hung.

    Parameters
    ----------
    time_ns : array_like of int, shape (n,)
        Stamps, increasing.
    values : array_like, shape (n,)
        Pressures or heights; NaN is no value.
    rests : iterable of (int, int), optional
        First and last stamp, ns, of each time in which the IMU shows rest.

    Returns
    -------
    ndarray of bool, shape (n,)
        All samples of such a time but the first, which is one.
    """
    stamps, value = np.asarray(time_ns, np.int64), np.asarray(values, np.float64)
    hung = np.zeros(len(stamps), np.bool_)
    known = np.flatnonzero(np.isfinite(value))
    stamps, value = stamps[known], value[known]
    first = np.flatnonzero(np.append(True, value[1:] != value[:-1])) if len(value) else known
    if len(first) < LEAST_VALUES:
        return hung
    count = np.diff(np.append(first, len(value)))
    last = first + count - 1
    usual = float(quantile(count.astype(np.float64), USUAL_SHARE))
    lasted = (stamps[last] - stamps[first]) / SECOND
    still = np.zeros(len(first), np.bool_)
    rests, margin = list(rests), round(LEAST_S * SECOND)
    for start, end in rests:
        still |= (stamps[first] >= start - margin) & (np.abs(stamps[last] - end) <= margin)
    long = np.flatnonzero((count >= UNUSUAL * usual) & (lasted >= LEAST_S) & ~still)
    if not len(long):
        return hung
    change = np.abs(np.diff(value[first]))
    leaps = np.append(change > LEAP * quantile(change, LARGE_SHARE), False)
    if not leaps[long].all() and _always_noisy(stamps, value, rests, first[long], last[long]):
        leaps[long] = True
    for run in long[leaps[long]]:
        hung[known[first[run] + 1 : last[run] + 1]] = True
    return hung


def _always_noisy(
    stamps: IntArray,
    value: FloatArray,
    rests: Iterable[tuple[int, int]],
    first: IntArray,
    last: IntArray,
) -> bool:
    """Whether noise changes the value all the time, at rest too, but for some rows."""
    steps = np.diff(value)
    turns = np.append(False, steps[1:] * steps[:-1] < 0.0)
    beside = np.ones(len(turns), np.bool_)
    for a, b in zip(first, last, strict=True):
        beside[max(a - 1, 0) : b + 1] = False
    begins = np.arange(0, len(turns) - BLOCK + 1, BLOCK)
    if not len(begins):
        return False
    noisy = np.add.reduceat(turns[: begins[-1] + BLOCK], begins) >= LEAST_TURNS
    whole = np.add.reduceat(beside[: begins[-1] + BLOCK], begins) == BLOCK
    rest = np.zeros(len(begins), np.bool_)
    for start, end in rests:
        rest |= (stamps[begins] >= start) & (stamps[begins + BLOCK] <= end)
    return all(
        np.count_nonzero(rows) >= LEAST_BLOCKS and float(np.mean(noisy[rows])) >= ALWAYS
        for rows in (whole, whole & rest)
    )
