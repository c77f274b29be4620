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
# Fixes that scatter by more than this, m, from one to the next do not show which are false; fewer
# false ones in a row than these are outliers.
PRECISE_M, LEAST_EPOCHS = 0.25, 3
# Two stretches agree within this, m, and within this many sigmas of the jumps between them.
APART_M, APART = 0.2, 4.0
# Fixes are false if they are off by more than this many of the receiver's sigmas.
REFUTED = 4.0
# Stretches that agree are right if they hold this share of the epochs; else none is known to be
# right.
MAJORITY = 0.55
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
        Navigation less fix, m, of a filter that hardly follows the fixes, and to which all are
        equally uncertain.
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
    jump, scale = _jumps(np.linalg.norm(step, axis=1) * certainty(left), near)
    if not jump.any() or np.median(scale) > PRECISE_M:
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


def certainty(left: FloatArray) -> FloatArray:
    """How well a navigation knows its changes from one epoch to the next, beside the usual.

    Where it does not know its attitude, as after a restart, it changes by metres from fix to fix
    by its own errors.

    Parameters
    ----------
    left : ndarray, shape (n, 3)
        As that of :func:`false_stretches`. By sigmas of the navigation before an epoch and after
        it, over that of the fixes, it is 1 / (1 + before^2) and 1 - after^2.

    Returns
    -------
    ndarray, shape (n - 1,)
        Usual sigma of a change over its own, 1 at most.
    """
    grown = (1.0 / left[1:] - 1.0) - (1.0 - left[:-1])
    sigma = np.sqrt(np.maximum(grown, 0.0).sum(axis=1))
    usual = np.full_like(sigma, np.median(sigma))
    return np.divide(usual, sigma, out=np.ones_like(sigma), where=sigma > usual)


def _jumps(size: FloatArray, near: BoolArray) -> tuple[BoolArray, FloatArray]:
    """Which changes are jumps, by their sizes, m, and the scatter of the others about each, m."""
    size = np.where(near, size, 0.0)
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
