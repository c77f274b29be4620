"""Stretches of a receiver's positions with one and the same error, found by its jumps.

A receiver that fixes a wrong integer ambiguity is off by a metre or so until it notices, and states
a centimetre all the while [1]_. A filter that rejects such fixes drifts until they are within its
own sigmas, and then accepts them. The jumps at their ends betray them: compared with an IMU, a fix
does not move by a metre from one epoch to the next. Between two jumps all fixes have the same
error, and stretches that agree with one another count as right.

References
----------
.. [1] P. J. G. Teunissen, S. Verhagen, "The GNSS ambiguity ratio-test revisited: a better way of
   using it", Survey Review 41(312), 2009, 138-151.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.running_median import running_median

# Epochs around each that show how much the navigation drifts and the fixes scatter.
AROUND = 15
# A jump is a change by this many sigmas, and by this many m; a receiver that uses the carrier phase
# does not jump by more than the second. Next to a jump fixes change by at most this share of it:
# outliers, and turns with an unknown lever arm, change them more.
SIGMAS, LEAST_M, MOST_M, BESIDE = 8.0, 0.3, 10.0, 0.4
# Epochs are successive within this many usual intervals, and within so many s. A lost message is no
# outage: within the last one, s, no navigation drifts by as much as a jump.
MOST_INTERVALS, MOST_S, LOST_S = 2.5, 2.0, 0.5
# Fixes that scatter by more than this, m, from one to the next, or jump more than once in `AROUND`
# epochs, do not show which are false; fewer false ones in a row than these are outliers.
PRECISE_M, LEAST_EPOCHS = 0.25, 3
# Two stretches agree within this, m, and within this many sigmas of the jumps between them.
APART_M, APART = 0.2, 4.0
# Fixes are false if they are off by more than this many of the receiver's sigmas.
REFUTED = 4.0
# Stretches that agree are right if they hold this share of the epochs; else none is known to be
# right.
MAJORITY = 0.55
# A navigation that lost its attitude knows it again where no fix jumps, and most of them change by
# less than this many times what is usual.
SETTLED = 2.0
NORMAL = 1.538  # median of the length of three unit normals


@dataclass(frozen=True)
class FalseStretch:
    """Successive fixes with one and the same error.

    Attributes
    ----------
    first, last : int
        Numbers of the first and last epoch.
    off_m : float
        Distance from the fixes that count as right, m; if none do, the largest distance of
        stretches.
    sure : bool
        Whether it is known which are right.
    """

    first: int
    last: int
    off_m: float
    sure: bool


def false_stretches(
    time_ns: IntArray, innovation: FloatArray, left: FloatArray, sigma: FloatArray
) -> list[FalseStretch]:
    """Stretches of fixes that are off by more than the receiver states, in order.

    Parameters
    ----------
    time_ns : ndarray of int64, shape (n,)
        Of epochs with a position, in order, without those that the receiver states to be worse.
    innovation : ndarray, shape (n, 3)
        Navigation less fix, m, of a filter that hardly follows the fixes.
    left : ndarray, shape (n, 3)
        Share of each innovation that remains after the correction of the filter.
    sigma : ndarray, shape (n, 3)
        Stated by the receiver, m.
    """
    if len(time_ns) <= AROUND:
        return []
    step = innovation[1:] - left[:-1] * innovation[:-1]
    step = step - running_median(step, AROUND)
    near = successive(time_ns, step)
    jump, scale = _jumps(step, near)
    rare = np.count_nonzero(jump) * AROUND < len(jump)
    if not jump.any() or not rare or np.median(scale) > PRECISE_M:
        return []
    chain = np.concatenate([[0], np.cumsum(~near)])
    stretch = np.concatenate([[0], np.cumsum(~near | jump)])
    first = np.flatnonzero(np.diff(stretch, prepend=-1))
    last = np.concatenate([first[1:] - 1, [len(time_ns) - 1]])
    found: list[FalseStretch] = []
    for one in np.unique(chain[1:][jump]):
        own = np.flatnonzero(chain[first] == one)
        jumps = step[first[own[1:]] - 1]
        noise = float(scale[first[own[1:]] - 1].max())
        offset = np.concatenate([np.zeros((1, 3)), np.cumsum(jumps, axis=0)])
        found += _disagreeing(first[own], last[own], offset, noise, sigma)
    return found


def successive(time_ns: IntArray, step: FloatArray) -> BoolArray:
    """Which changes `step`, m, shape (n - 1, 3), are those from one epoch to the next, and small.

    Behind an outage a navigation has drifted; a single outlier of more than `MOST_M` says nothing.
    """
    seconds = np.diff(time_ns) * 1e-9
    near = seconds <= min(max(MOST_INTERVALS * float(np.median(seconds)), LOST_S), MOST_S)
    return np.asarray(near & (np.linalg.norm(step, axis=1) <= MOST_M))


def unsettled(
    time_ns: IntArray, innovation: FloatArray, left: FloatArray, lost_ns: IntArray
) -> BoolArray:
    """Which epochs show the errors of a navigation that lost its attitude, not those of fixes.

    Parameters
    ----------
    time_ns, innovation, left
        As those of :func:`false_stretches`.
    lost_ns : ndarray of int64
        When it lost its attitude: the ends of gaps of the IMU.

    Returns
    -------
    ndarray of bool, shape (n,)
        Epochs from such a time on, until fixes change as little as usual from one to the next.
    """
    lost = np.zeros(len(time_ns), np.bool_)
    wide = 2 * AROUND + 1
    if len(time_ns) <= wide:
        return lost
    step = innovation[1:] - left[:-1] * innovation[:-1]
    step = step - running_median(step, AROUND)
    near = successive(time_ns, step)
    size = np.where(near, np.linalg.norm(step, axis=1), np.inf)
    usual = float(np.median(size))
    jumps = np.convolve(size > SIGMAS * usual / NORMAL, np.ones(wide), "same") > 0.0
    calm = (running_median(size, wide) <= SETTLED * usual) & ~jumps
    for first in np.searchsorted(time_ns, lost_ns).tolist():
        # Of windows that begin after it
        settled = np.flatnonzero(calm[first + AROUND :])
        lost[first : first + int(settled[0]) if len(settled) else len(lost)] = True
    return lost


def _jumps(step: FloatArray, near: BoolArray) -> tuple[BoolArray, FloatArray]:
    """Which changes are jumps, and the scatter of the others about each, m."""
    size = np.where(near, np.linalg.norm(step, axis=1), 0.0)
    usual = float(np.median(size[near])) if near.any() else 0.0
    scale = np.maximum(running_median(size, AROUND), usual) / NORMAL
    around = np.pad(size, 1)
    beside = np.maximum(around[:-2], around[2:])
    limit = np.maximum(SIGMAS * scale, LEAST_M)
    return near & (size > limit) & (beside < BESIDE * size), scale


def _disagreeing(
    first: IntArray, last: IntArray, offset: FloatArray, noise: float, sigma: FloatArray
) -> list[FalseStretch]:
    """Stretches that are off; all of them if no offset has a majority."""
    place = np.arange(len(first))
    many = (last - first + 1).astype(np.float64)
    apart = np.linalg.norm(offset[:, None] - offset[None, :], axis=2)
    jumps = np.abs(place[:, None] - place[None, :])
    agree = apart <= APART_M + APART * noise * np.sqrt(jumps)
    weight = agree @ many
    right = int(np.argmax(weight))
    sure = bool(weight[right] >= MAJORITY * many.sum())
    found = []
    for k in place:
        far = ~agree[right, k]
        off = apart[right, k] if sure else apart[k].max()
        stated = np.median(sigma[first[k] : last[k] + 1], axis=0)
        refuted = off > REFUTED * float(np.linalg.norm(stated)) and many[k] >= LEAST_EPOCHS
        if (far or not sure) and refuted:
            found.append(FalseStretch(int(first[k]), int(last[k]), float(off), sure))
    return found
