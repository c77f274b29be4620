"""Stretches of a receiver's positions that are all off by the same, by what its fixes jump.

A receiver that takes a wrong integer ambiguity for the right one is off by a metre or so until it
notices, and says that it is good to a centimetre all the while [1]_. A filter that turns such fixes
down drifts until they are within its own sigmas, and believes them then. What betrays them are
their edges: beside an Imu, a fix does not move by a metre from one epoch to the next. Between two
jumps all fixes are off by the same, and those of the stretches that agree with one another are
taken to be right.

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

# Epochs about each that show how much the navigation drifts and the fixes scatter there.
AROUND = 15
# A change of so many sigmas, and m, is a jump, and no receiver that counts waves jumps by more than
# the second; beside one the fixes change by this much of it at most, as neither outliers nor turns
# about an arm that nobody gave do.
SIGMAS, LEAST_M, MOST_M, BESIDE = 8.0, 0.3, 10.0, 0.4
# Epochs follow each other within so many of their usual intervals, and s. A message that is lost is
# no outage: within the last, s, no navigation drifts by as much as a jump.
MOST_INTERVALS, MOST_S, LOST_S = 1.5, 2.0, 0.5
# Fixes that scatter by more than this, m, from one to the next do not show which are false; and
# fewer in a row than these are outliers.
PRECISE_M, LEAST_EPOCHS = 0.25, 3
# Two stretches agree within this, m, and so many sigmas of the jumps between them.
APART_M, APART = 0.2, 4.0
# A receiver is refuted where its fixes are off by more than so many of its sigmas.
REFUTED = 4.0
# Stretches that agree must have so much of the epochs, or none is known to be right.
MAJORITY = 0.55
_NORMAL = 1.538  # median of the length of three unit normals


@dataclass(frozen=True)
class FalseStretch:
    """Fixes that are off by the same.

    Attributes
    ----------
    first, last : int
        Of its epochs.
    off_m : float
        How far they are from those taken to be right; where none is, how far stretches are apart.
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
    """Stretches of fixes that are off by more than the receiver says, in order.

    Parameters
    ----------
    time_ns : ndarray of int64, shape (n,)
        Of epochs with a position, in order; those that the receiver says are worse left out.
    innovation : ndarray, shape (n, 3)
        Navigation less fix, m, of a filter that hardly follows the fixes.
    left : ndarray, shape (n, 3)
        Share of each innovation that the filter leaves when it corrects by the fix.
    sigma : ndarray, shape (n, 3)
        What the receiver says, m.
    """
    if len(time_ns) <= AROUND:
        return []
    seconds = np.diff(time_ns) * 1e-9
    step = innovation[1:] - left[:-1] * innovation[:-1]
    step = step - running_median(step, AROUND)
    near = seconds <= min(max(MOST_INTERVALS * float(np.median(seconds)), LOST_S), MOST_S)
    near &= np.linalg.norm(step, axis=1) <= MOST_M
    jump, scale = _jumps(step, near)
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


def _jumps(step: FloatArray, near: BoolArray) -> tuple[BoolArray, FloatArray]:
    """Which changes are jumps, and the scatter of the others about each, m."""
    size = np.where(near, np.linalg.norm(step, axis=1), 0.0)
    usual = float(np.median(size[near])) if near.any() else 0.0
    scale = np.maximum(running_median(size, AROUND), usual) / _NORMAL
    around = np.pad(size, 1)
    beside = np.maximum(around[:-2], around[2:])
    limit = np.maximum(SIGMAS * scale, LEAST_M)
    return near & (size > limit) & (beside < BESIDE * size), scale


def _disagreeing(
    first: IntArray, last: IntArray, offset: FloatArray, noise: float, sigma: FloatArray
) -> list[FalseStretch]:
    """Of stretches that follow each other, those that are off; all, where no offset prevails."""
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
