"""An IMU that is shaken while its vehicle stands, as by an idling engine.

Samples that do not resolve the vibration show it as noise, far more than that of the sensors. A
filter without this noise is too sure of attitude and velocity after each stop, and its velocity
then contradicts a rest. Here rests are found by the fixes alone, before any filter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import BoolArray
from sinstool.core.streams import GnssEpochs
from sinstool.methods.ins_gnss.constraints import Constraints
from sinstool.methods.land_vehicle.rest import find_rests, noise_at_rest
from sinstool.methods.land_vehicle.track import Means, Track
from sinstool.methods.sensor_errors import SensorGrade


@dataclass(frozen=True)
class Shaking:
    """Noise of an IMU while its vehicle stands.

    Attributes
    ----------
    start_ns : int
        Where the first step begins.
    stands : ndarray of bool, shape (g,)
        Steps in which it is as quiet as at rest.
    noise : tuple of float
        Power densities of force, (m/s^2)^2 s, and of rate, (rad/s)^2 s; 0 where unknown.
    """

    start_ns: int
    stands: BoolArray
    noise: tuple[float, float]

    def constraints(self, imu: SensorGrade) -> Constraints | None:
        """Constraints with this noise only, for a filter; None if it is no more than the IMU's.

        Parameters
        ----------
        imu : SensorGrade
            Noise of the sensors that the filter assumes.
        """
        more = beyond(self.noise, imu)
        if not any(more):
            return None
        never, unknown = np.zeros_like(self.stands), np.full(len(self.stands), np.nan)
        return Constraints(self.start_ns, never, never, never, unknown, None, self.stands, more)


def beyond(noise: tuple[float, float], imu: SensorGrade) -> tuple[float, float]:
    """Power densities of force and rate beyond those of the sensors."""
    own = imu.velocity_random_walk**2, imu.angle_random_walk**2
    return max(noise[0] - own[0], 0.0), max(noise[1] - own[1], 0.0)


def find_shaking(means: Means, gnss: GnssEpochs, latency_ns: int) -> Shaking:
    """Noise while a vehicle stands by its fixes.

    Parameters
    ----------
    gnss : GnssEpochs
        Those that may be looked at, valid `latency_ns` before their stamps.
    """
    known = gnss.has_velocity & np.isfinite(gnss.velocity_n).all(axis=1)
    rows = gnss.rows(known & np.isfinite(gnss.sigma_velocity_n).all(axis=1))
    covariance = np.zeros((len(rows.time_ns), 6, 6))
    axes = np.arange(3)
    covariance[:, axes, axes] = rows.sigma_velocity_n**2
    level = np.broadcast_to(np.eye(3), (len(rows.time_ns), 3, 3))
    track = Track(rows.time_ns - latency_ns, rows.velocity_n, level, covariance)
    rests = find_rests(means, track)
    return Shaking(means.start_ns, rests.stands, noise_at_rest(means, rests.at))
