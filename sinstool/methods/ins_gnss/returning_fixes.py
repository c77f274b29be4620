"""The first fixes after an outage, compared with those that follow.

When fixes come back after an outage, the navigation is so uncertain that the filter's gate passes
the first of them wherever it is. If that one is bad, the filter is far off with a small sigma, and
rejects the good fixes that follow. These show where the first should have been, since a vehicle
cannot leap.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.order_statistics import median
from sinstool.core.streams import GnssEpochs
from sinstool.methods.ins_gnss.fix_velocity import (
    LEAST_FIXES,
    MOST_TURN,
    OUTLYING,
    stated_sigma,
    track_of,
)

# Fixes come back after an outage if they stay away this long, s; fixes show the way of a vehicle if
# they follow one another within this time, s.
OUTAGE_S, FOLLOW_S = 5.0, 2.5
# Number of first fixes that are tested, and of those that follow.
FIRST, FOLLOWING = 2, 3


def leaps(gnss: GnssEpochs) -> FloatArray:
    """Distance of the first positions after outages from the line through those that follow.

    Parameters
    ----------
    gnss : GnssEpochs
        By time; the log's first fix comes after an outage, too.

    Returns
    -------
    ndarray, shape (n,)
        m; 0 for all fixes but bad ones.
    """
    off = np.zeros(len(gnss))
    rows = np.flatnonzero(gnss.has_position)
    if len(rows) < LEAST_FIXES:
        return off
    seconds, place = track_of(gnss.rows(rows))
    noise = max(_scatter(seconds, place), stated_sigma(gnss.rows(rows)))
    for first in np.flatnonzero(np.diff(seconds, prepend=-np.inf) > OUTAGE_S):
        last = first + FIRST + FOLLOWING
        t, p = seconds[first:last], place[first:last]
        if len(t) < FIRST + FOLLOWING or not np.all(np.diff(t) < FOLLOW_S):
            continue
        good = FIRST  # the first of those that agree
        far, limit = _leap(t, p, good, good + 1, good + 2)
        if far > OUTLYING * noise + limit:
            continue  # those do not agree themselves
        for k in reversed(range(FIRST)):
            far, limit = _leap(t, p, k, good, good + 1)
            if far > OUTLYING * noise + limit:
                off[rows[first + k]] = far
            else:
                good = k
    return off


def _scatter(seconds: FloatArray, place: FloatArray) -> float:
    """Usual distance of a fix from the line through the next two, m."""
    before, after = np.diff(seconds)[:-1], np.diff(seconds)[1:]
    ratio = (before / after)[:, None]
    off = np.linalg.norm(place[:-2] - place[1:-1] + ratio * (place[2:] - place[1:-1]), axis=1)
    return float(median(off))


def _leap(t: FloatArray, p: FloatArray, k: int, near: int, next_: int) -> tuple[float, float]:
    """How far a fix is from the line through two that follow, and what a turn makes of that, m."""
    before, between = float(t[near] - t[k]), float(t[next_] - t[near])
    line = p[near] - (p[next_] - p[near]) * before / between
    return float(np.linalg.norm(p[k] - line)), 0.5 * MOST_TURN * before * (before + between)
