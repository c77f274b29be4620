"""Stretches in which a receiver's positions scatter by far more than it states.

Beside a wall, or as it loses its ambiguities, a receiver of the carrier phase may report fixes that
scatter by half a metre and state a centimetre all the while. A filter that takes the scatter for
white noise averages it, and soon believes its position to centimetres. But signals by a detour do
both: they scatter, and they are all too long, so that the fixes of the stretch are off together, by
an unknown amount that is rarely less than their scatter [1]_.

References
----------
.. [1] P. D. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
   Systems", 2nd ed., 2013, section 9.3.4: multipath interference and its effect on positions.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.running_median import running_median
from sinstool.methods.ins_gnss.fix_jumps import AROUND, NORMAL, successive

# Fixes scatter if from one to the next they change by so many times what their stated sigmas allow,
# and by so many times what is usual in the log; at least by so much, m.
TIMES, LEAST_M = 10.0, 0.1
# Fewer epochs than these are outliers.
LEAST_EPOCHS = 10


@dataclass(frozen=True)
class ScatteredStretch:
    """Successive fixes that scatter.

    Attributes
    ----------
    first, last : int
        Numbers of the first and last epoch.
    scatter_m : float
        Standard deviation of a component, m.
    off_m : float
        By how much they may be off together, m: their scatter, or their distance from the fixes
        beside them if that is larger.
    """

    first: int
    last: int
    scatter_m: float
    off_m: float


def scattered_stretches(
    time_ns: IntArray, innovation: FloatArray, left: FloatArray, sigma: FloatArray
) -> list[ScatteredStretch]:
    """Stretches of fixes that scatter by far more than the receiver states, in order.

    Parameters
    ----------
    time_ns, innovation, left, sigma
        As those of :func:`~sinstool.methods.ins_gnss.fix_jumps.false_stretches`.
    """
    if len(time_ns) <= AROUND:
        return []
    step = innovation[1:] - left[:-1] * innovation[:-1]
    near = successive(time_ns, step)
    size = np.where(near, np.linalg.norm(step - running_median(step, AROUND), axis=1), 0.0)
    change = running_median(size, AROUND) / NORMAL
    stated = np.sqrt(np.mean(np.square(sigma[1:]) + np.square(sigma[:-1]), axis=1))
    usual = float(np.median(size[near])) / NORMAL if near.any() else 0.0
    far = near & (change > np.maximum(TIMES * np.maximum(stated, usual), LEAST_M))
    edges = np.flatnonzero(np.diff(far, prepend=False, append=False)).reshape(-1, 2)
    # How far each is from the first of its chain
    chain = np.concatenate([[0], np.cumsum(~near)])
    place = np.concatenate([np.zeros((1, 3)), np.cumsum(np.where(near[:, None], step, 0.0), 0)])
    found = []
    for begin, end in _joined(edges):
        first, last = _ends(size, near, NORMAL * usual, begin, end)
        if last - first + 1 < LEAST_EPOCHS:
            continue
        scatter = float(np.median(change[begin:end])) / sqrt(2.0)
        off = _off(place, chain, first, last)
        found.append(ScatteredStretch(first, last, scatter, max(scatter, off)))
    return found


def _joined(edges: IntArray) -> list[tuple[int, int]]:
    """The same, those that have fewer than `AROUND` changes between them as one."""
    joined: list[tuple[int, int]] = []
    for begin, end in edges.tolist():
        if joined and begin - joined[-1][1] < AROUND:
            begin = joined.pop()[0]
        joined.append((begin, end))
    return joined


def _ends(size: FloatArray, near: BoolArray, usual: float, begin: int, end: int) -> tuple[int, int]:
    """First and last epoch of the scatter around the changes from `begin` up to `end`.

    Where half of a window scatters the stretch is known to end within half a window. Changes there
    belong to it if they are nearer to its own, by their ratio, than to the usual ones.
    """
    least = sqrt(usual * float(np.median(size[begin:end])))
    low, high = max(begin - AROUND // 2, 0), min(end + AROUND // 2, len(size))
    large = low + np.flatnonzero((size[low:high] > least) & near[low:high])
    # Beside it may be epochs that cannot be compared: it ends at those known not to scatter
    quiet = low + np.flatnonzero((size[low:high] <= least) & near[low:high])
    before, after = quiet[quiet < large[0]], quiet[quiet > large[-1]]
    first = int(before[-1]) + 2 if len(before) else low
    return first, int(after[0]) - 1 if len(after) else high


def _off(place: FloatArray, chain: IntArray, first: int, last: int) -> float:
    """Distance, m, of the fixes of a stretch from those beside it, the larger of both ends."""
    off, rows = 0.0, np.arange(len(place))
    within = (rows >= first) & (rows <= last)
    for edge in (first, last):
        around = (np.abs(rows - edge) < AROUND) & (chain == chain[edge])
        inside, beside = around & within, around & ~within
        if inside.any() and beside.any():
            apart = np.median(place[inside], axis=0) - np.median(place[beside], axis=0)
            off = max(off, float(np.linalg.norm(apart)))
    return off
