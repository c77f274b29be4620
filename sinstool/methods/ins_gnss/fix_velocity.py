"""Velocity from fixes alone, good enough to start from and for nothing else.

A filter takes positions as they are: differences of them would tell it the same thing twice. But an
attitude in motion is found from changes of velocity, and a receiver may give none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.core.earth import horizontal_metres
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND

# A parabola is laid through the fixes within so many seconds to either side: as few as make the
# velocity good to this, m/s, for what a parabola does not follow grows with their square.
SHORTEST_S, LONGEST_S = 1.0, 4.0
WANTED = 0.15
LEAST = 5
LEAST_SIGMA = 0.02


def with_velocities(gnss: GnssEpochs, sigma_m: float) -> GnssEpochs:
    """Epochs with velocities made from their positions.

    Parameters
    ----------
    gnss : GnssEpochs
        By time.
    sigma_m : float
        Noise of a position from one fix to the next, m.

    Returns
    -------
    GnssEpochs
        Those with enough fixes around them; velocities have the sigmas that follow from
        `sigma_m`.
    """
    rows = gnss.rows(gnss.has_position & np.isfinite(gnss.height))
    n = len(rows)
    if n < LEAST:
        return rows.rows(slice(0, 0))
    t = (rows.time_ns - rows.time_ns[0]) / SECOND
    height = float(np.median(rows.height))
    longitude = np.unwrap(rows.longitude)
    north, east = horizontal_metres(
        rows.latitude - rows.latitude[0], longitude - longitude[0], rows.latitude[0], height
    )
    position = np.stack([north, east, -(rows.height - rows.height[0])], axis=1)
    half = _half(t, sigma_m)
    moments, right, count = np.zeros((n, 5)), np.zeros((n, 3, 3)), np.zeros(n)
    reach = int(np.max(np.searchsorted(t, t + half, "right") - np.arange(n)))
    here = np.arange(n)
    for step in range(-reach, reach + 1):
        other = np.clip(here + step, 0, n - 1)
        away = t[other] - t
        inside = (here + step == other) & (np.abs(away) <= half)
        count += inside
        powers = np.where(inside[:, None], away[:, None] ** np.arange(5), 0.0)
        moments += powers
        right += powers[:, :3, None] * (position[other] - position)[:, None, :]
    normal = moments[:, np.arange(3)[:, None] + np.arange(3)[None, :]]
    spread = moments[:, 2] > 0.25 * half**2 * LEAST / 3.0
    good = (count >= LEAST) & spread & (np.linalg.cond(normal + 1e-12 * np.eye(3)) < 1e8)
    normal[~good] = np.eye(3)
    inverse = np.linalg.inv(normal)
    velocity = (inverse @ right)[:, 1]
    sigma = np.maximum(sigma_m * np.sqrt(inverse[:, 1, 1]), LEAST_SIGMA)
    made = replace(rows, velocity_n=velocity, sigma_velocity_n=np.repeat(sigma[:, None], 3, axis=1))
    return made.rows(good)


def _half(seconds: np.ndarray, sigma_m: float) -> float:
    """Half of the window, s: of N fixes over T, velocity is good to sigma sqrt(12/N)/T."""
    usual = float(np.median(np.diff(seconds)))
    half = 0.5 * np.cbrt(12.0 * sigma_m**2 * usual / WANTED**2)
    return float(max(np.clip(half, SHORTEST_S, LONGEST_S), 0.5 * LEAST * usual))
