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
