"""Simulated fixes as a filter takes them."""

import numpy as np

from sinstool.core.streams import GnssEpochs


def epochs(samples, own_sigma=False):
    """Fixes of the simulation, with what the receiver says of its noise or without."""
    nothing = np.full_like(samples.velocity_n, np.nan)
    return GnssEpochs(
        samples.time_ns,
        samples.time_ns,
        samples.latitude,
        samples.longitude,
        samples.height,
        samples.velocity_n,
        samples.sigma_position if own_sigma else nothing,
        samples.sigma_velocity if own_sigma else nothing,
    )


def straight(time_ns, speed=0.0, away=None):
    """Positions alone, northward at so many m/s, or so far away (m)."""
    north = speed * (time_ns - time_ns[0]) * 1e-9 if away is None else away
    nothing = np.full((len(time_ns), 3), np.nan)
    latitude, fixed = 0.8 + north / 6.37e6, np.zeros(len(time_ns))
    return GnssEpochs(time_ns, time_ns, latitude, fixed, fixed, nothing, nothing + 1.0, nothing)
