"""What a filter assumes of a receiver: from what it says of itself, or from what is usual."""

from __future__ import annotations

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.integration.noise import GnssModel
from sinstool.streams import GnssEpochs

# Of the whole error of a fix, what is white and what lasts: of the usual model, 2 of 5.4 m and
# 0.05 of 0.11 m/s.
POSITION_WHITE, POSITION_SLOW = 0.371, 0.928
VELOCITY_WHITE, VELOCITY_SLOW = 0.447, 0.894
USUAL_POSITION = (5.4, 5.4, 8.5)
USUAL_VELOCITY = (0.11, 0.11, 0.17)
# A receiver that claims less than this speaks of its own resolution.
LEAST_POSITION, LEAST_VELOCITY = 0.005, 0.005


def gnss_model(gnss: GnssEpochs, config: ProcessConfig) -> tuple[GnssModel, str]:
    """Noise of a receiver's fixes, and where it is from.

    Parameters
    ----------
    gnss : GnssEpochs
    config : ProcessConfig

    Returns
    -------
    GnssModel
        Position errors last 200 s, velocity errors 60 s.
    str
        In words.
    """
    told = config.filter
    factor = told.gnss_noise_scale
    position, from_fixes = _usual(gnss.sigma_position_n, USUAL_POSITION, LEAST_POSITION, factor)
    if not from_fixes and told.gnss_sigma is not None:
        position = np.array([1.0, 1.0, 1.6]) * told.gnss_sigma * factor
    velocity, from_velocities = _usual(
        gnss.sigma_velocity_n, USUAL_VELOCITY, LEAST_VELOCITY, factor
    )
    if not from_velocities:
        ratio = config.gnss.gnss_sigma_v / 0.1 if config.gnss.gnss_sigma_v != 0.1 else 1.0
        velocity = velocity * ratio
    how = (
        f"position {'as the receiver says' if from_fixes else 'assumed'}, about"
        f" {position[0]:.3g} m; velocity"
        f" {'as the receiver says' if from_velocities else 'assumed'}, about {velocity[0]:.3g} m/s"
    )
    return (
        GnssModel(
            position_white=_triple(POSITION_WHITE * position),
            position_markov=_triple(POSITION_SLOW * position),
            velocity_white=_triple(VELOCITY_WHITE * velocity),
            velocity_markov=_triple(VELOCITY_SLOW * velocity),
        ),
        how,
    )


def _usual(
    sigma: np.ndarray, assumed: tuple[float, float, float], least: float, factor: float
) -> tuple[np.ndarray, bool]:
    """Median of what the fixes say by axis, or what is usual."""
    known = np.isfinite(sigma).any(axis=0)
    if not known[:2].all():
        return factor * np.array(assumed), False
    median = np.array([np.nanmedian(sigma[:, k]) if known[k] else np.nan for k in range(3)])
    median[2] = median[2] if known[2] else 1.6 * median[0]
    return factor * np.maximum(median, least), True


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
