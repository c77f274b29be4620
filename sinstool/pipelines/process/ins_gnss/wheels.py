"""Wheel speeds of a land vehicle for a filter: in m/s, at their own times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.timeline import SECOND
from sinstool.methods.ins_gnss.constraints import STEP_NS
from sinstool.methods.land_vehicle.track import Means, Track
from sinstool.methods.wheel_fit import WheelFit
from sinstool.survey.wheels import WheelSpeeds, matched, slipping

# Readings further apart than this say nothing between them. A car's own bus is asked once a second:
# between two such readings a jerk of 1 m/s^3 is worth 0.12 m/s, about as much as their sigma.
LONGEST_S = 1.25
# A speed of wheels as a mean over 1 s is not better than this, nor worse, m/s.
LEAST_SIGMA, MOST_SIGMA = 0.1, 1.0
# How long what is wrong with wheels lasts, s.
LASTS_S = 2.0
# A usual latency of their stamps, 1 sigma about 0, s.
LATENCY_S = 0.2


@dataclass(frozen=True)
class WheelsUsed:
    """Wheels that are compared with a track.

    Attributes
    ----------
    unit : str
        Of the readings.
    speed : ndarray, shape (g,)
        At the steps of the means' begins, m/s; NaN where unknown or slipping.
    sigma : float
        As a mean over 1 s, m/s.
    slipping : float
        Share of the readings in which one wheel slips.
    """

    topic: str
    unit: str
    fit: WheelFit
    speed: FloatArray
    sigma: float
    slipping: float


def use_wheels(
    wheels: WheelSpeeds, means: Means, track: Track, c_vb: FloatArray
) -> WheelsUsed | None:
    """Wheels in a filter's units and times; None where the log has none, or the track denies them.

    Parameters
    ----------
    means, track : Means, Track
        Of a first run without constraints.
    c_vb : ndarray, shape (3, 3)
        From body axes to those of the vehicle.
    """
    if not wheels.topic or len(wheels) < 2:
        return None
    seen = track.outside_outages
    forward = track.velocity_b @ c_vb[0]
    fit = matched(wheels, track.time_ns[seen], forward[seen])
    if fit is None:
        return None
    fit = fit.with_prior(LATENCY_S)
    measured = np.isfinite(means.rate).all(axis=1)
    yaw = means.rate[measured] @ c_vb[2]
    slips = slipping(wheels, means.time_ns[measured], yaw, fit.latency_s)
    good = ~slips
    if np.count_nonzero(good) < 2:
        return None
    time_ns = wheels.time_ns[good] - round(fit.latency_s * SECOND)
    grid_ns = means.start_ns + STEP_NS * np.arange(len(means), dtype=np.int64)
    # From one origin, or nanoseconds since 1970 would be rounded
    origin = int(time_ns[0])
    at = np.asarray(1e-9 * (time_ns - origin), np.float64)
    steps = np.asarray(1e-9 * (grid_ns - origin), np.float64)
    speed = fit.rolled(steps, at, wheels.speed[good])
    after = np.clip(np.searchsorted(time_ns, grid_ns), 1, len(time_ns) - 1)
    inside = (grid_ns >= time_ns[0]) & (grid_ns <= time_ns[-1])
    speed[~inside | (time_ns[after] - time_ns[after - 1] > LONGEST_S * SECOND)] = np.nan
    lasting = fit.residual_sigma * np.sqrt(2.0 * LASTS_S)
    return WheelsUsed(
        wheels.topic,
        wheels.unit,
        fit,
        speed,
        float(np.clip(lasting, LEAST_SIGMA, MOST_SIGMA)),
        float(np.mean(slips)),
    )
