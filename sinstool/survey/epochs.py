"""Epochs of a receiver: fixes and velocities that were measured together."""

from __future__ import annotations

import numpy as np

from sinstool.core.streams import Gnss, GnssEpochs, Velocity

# Position and velocity of one epoch may be stamped apart by the time between their messages.
SAME_EPOCH_NS = 20_000_000
# A standard deviation above this says "unknown", however much larger it is.
UNKNOWN_SIGMA = 1e6


def join(fixes: Gnss | None, velocity: Velocity | None) -> GnssEpochs | None:
    """Fixes and velocities by epoch: those stamped together share a row.

    Parameters
    ----------
    velocity : Velocity or None
        Both by time, without repeated stamps.

    Returns
    -------
    GnssEpochs or None
        By time. A row takes the stamp of the fix.
    """
    first = fixes if fixes is not None else velocity
    if first is None:
        return None
    times, logged, rows = first.time_ns, first.log_time_ns, np.arange(len(first))
    if fixes is not None and velocity is not None:
        partner, together = partners(fixes.time_ns, velocity.time_ns)
        single = np.ones(len(velocity), np.bool_)
        single[partner[together]] = False
        alone = np.flatnonzero(single)
        times = np.concatenate([times, velocity.time_ns[alone]])
        logged = np.concatenate([logged, velocity.log_time_ns[alone]])
        rows = np.concatenate([rows[together], len(fixes) + np.arange(len(alone))])
        velocity = velocity.rows(np.concatenate([partner[together], alone]))
    latitude, longitude, height = (np.full(len(times), np.nan) for _ in range(3))
    v, sigma_p, sigma_v = (np.full((len(times), 3), np.nan) for _ in range(3))
    if fixes is not None:
        n = len(fixes)
        latitude[:n], longitude[:n], height[:n] = fixes.latitude, fixes.longitude, fixes.height
        sigma_p[:n] = _sigma(fixes.covariance_n, (fixes.covariance_type > 0)[:, None])
    if velocity is not None:
        v[rows] = velocity.velocity_n
        sigma_v[rows] = _sigma(velocity.covariance_n, True)
    epochs = GnssEpochs(times, logged, latitude, longitude, height, v, sigma_p, sigma_v)
    if np.all(times[1:] >= times[:-1]):
        return epochs
    return epochs.rows(np.argsort(times, kind="stable"))


def partners(fixes_ns: np.ndarray, velocity_ns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The velocity nearest to each fix, shape (n,), and whether the two are of one epoch."""
    right = np.searchsorted(velocity_ns, fixes_ns)
    left = np.clip(right - 1, 0, len(velocity_ns) - 1)
    right = np.clip(right, 0, len(velocity_ns) - 1)
    to_left = np.abs(velocity_ns[left] - fixes_ns)
    to_right = np.abs(velocity_ns[right] - fixes_ns)
    partner = np.where(to_left <= to_right, left, right)
    away = np.minimum(to_left, to_right)
    # A velocity belongs to one fix only, the nearest to it.
    order = np.lexsort((away, partner))
    nearest = np.zeros(len(fixes_ns), np.bool_)
    nearest[order[np.diff(partner[order], prepend=-1) > 0]] = True
    return partner, nearest & (away <= SAME_EPOCH_NS)


def _sigma(covariance: np.ndarray, stated: np.ndarray | bool) -> np.ndarray:
    """Roots of the diagonal; NaN where it says nothing."""
    variance = np.einsum("nii->ni", covariance)
    good = stated & np.isfinite(variance) & (variance > 0.0)
    return np.minimum(np.sqrt(np.where(good, variance, np.nan)), UNKNOWN_SIGMA)
