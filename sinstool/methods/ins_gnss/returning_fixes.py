"""The first fixes after an outage, compared with those that follow.

When fixes come back after an outage, the navigation is so uncertain that the filter's gate passes
the first of them wherever it is. If that one is bad, the filter is far off with a small sigma, and
rejects the good fixes that follow. These show where the first should have been, since a vehicle
cannot leap.

A receiver may also take many seconds to find the right place, on its way from where it thought it
was, while its velocities are right from the first one on: they follow from Doppler shifts, which
need no history. Then positions less the integral of the velocities show how far off it still is.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray
from sinstool.core.monotone_cubic import integral
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
# A receiver has settled at the earliest and at the latest so long after its first fix, s: the mean
# of the last MEAN_S before, where fixes follow one another as long, shows where it should have
# been. Fixes are off by more than an error that wanders if they differ from it by more than so many
# times as much as fixes LAG_S apart usually do.
SETTLED_S, MEAN_S, LAG_S = (30.0, 70.0), 10.0, 30.0
UNSETTLED = 5.0


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


def unsettled(gnss: GnssEpochs) -> FloatArray:
    """Distance of positions after outages from where velocities lead back from later ones.

    Parameters
    ----------
    gnss : GnssEpochs
        By time; the log's first fix comes after an outage, too.

    Returns
    -------
    ndarray, shape (n,)
        m; 0 for all fixes but those of a receiver that is still to find its place.
    """
    off = np.zeros(len(gnss))
    rows = np.flatnonzero(gnss.has_position & gnss.has_velocity)
    if len(rows) < LEAST_FIXES:
        return off
    fixes = gnss.rows(rows)
    seconds, place = track_of(fixes)
    # Not all receivers give a vertical velocity
    axes = 3 if np.isfinite(fixes.velocity_n[:, 2]).all() else 2
    velocity = (fixes.velocity_n * [1.0, 1.0, -1.0])[:, :axes]
    left = place[:, :axes] - integral(seconds, velocity, seconds)
    stated = np.nan_to_num(fixes.sigma_position_n[:, :2].max(axis=1))
    begins = np.flatnonzero(np.diff(seconds, prepend=-np.inf) > OUTAGE_S)
    piece = np.cumsum(np.diff(seconds, prepend=seconds[0]) > FOLLOW_S)
    settled = _settled(seconds, begins)
    wander = _wander(seconds, left, piece, settled)
    if not np.isfinite(wander):
        return off
    noise = np.maximum(max(wander, stated_sigma(fixes)), stated)
    for first in begins:
        after = seconds - seconds[first]
        here = (piece == piece[first]) & (after >= 0.0) & (after < SETTLED_S[1])
        last_s = after[here][-1]
        ref = here & (after >= last_s - MEAN_S)
        if last_s - MEAN_S < SETTLED_S[0] or np.count_nonzero(ref) < FOLLOWING:
            continue
        early = np.flatnonzero(here & ~ref)
        far = np.linalg.norm(left[early] - left[ref].mean(axis=0), axis=1)
        off_here = far > UNSETTLED * noise[early]
        # A bad fix among good ones is no receiver that is still to find its place
        most = np.cumsum(off_here) >= 0.5 * np.arange(1, len(early) + 1)
        wrong = np.flatnonzero(off_here & most)
        if not len(wrong):
            continue
        # It comes slowly near: until it is as near as fixes usually are, and as long again, in
        # which an error that fades becomes as much smaller once more
        last = int(wrong[-1])
        near = np.flatnonzero(far[last:] <= noise[early[last:]])
        count = last + int(near[0]) if len(near) else len(early)
        until = 2.0 * after[early[min(count, len(early) - 1)]] - after[early[last]]
        fading = early[: np.searchsorted(after[early], until, side="right")]
        off[rows[fading]] = np.maximum(far[: len(fading)], noise[fading])
    return off


def lasting(off: FloatArray) -> FloatArray:
    """Sigmas of fixes with errors that last, m, by their distances: as white noise of each, m.

    All fixes of a stretch are off in the same direction, and count as one.
    """
    there = off > 0.0
    stretch = np.cumsum(np.diff(there, prepend=False) & there)
    count = np.bincount(stretch[there], minlength=1) if there.any() else np.ones(1)
    return np.where(there, off * np.sqrt(count[np.where(there, stretch, 0)]), 0.0)


def _settled(seconds: FloatArray, begins: np.ndarray) -> BoolArray:
    """Which fixes are not among the first after an outage."""
    latest = begins[np.searchsorted(begins, np.arange(len(seconds)), side="right") - 1]
    return np.asarray(seconds - seconds[latest] > SETTLED_S[1])


def _wander(seconds: FloatArray, left: FloatArray, piece: np.ndarray, settled: BoolArray) -> float:
    """Usual change of the error of positions within `LAG_S`, m; NaN where no fixes show it."""
    later = np.searchsorted(seconds, seconds + LAG_S)
    at = np.flatnonzero(settled & (later < len(seconds)))
    at = at[piece[at] == piece[later[at]]]
    if len(at) < LEAST_FIXES:
        return np.nan
    return float(median(np.linalg.norm(left[later[at]] - left[at], axis=1)))


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
