"""A simulated flight or drive: where the vehicle was, and what exact sensors felt there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sinstool.simulation.truth import ImuTruth

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Trajectory:
    """Motion over the Earth at the instants of the Imu samples.

    Attributes
    ----------
    imu : ImuTruth
        Exact samples and attitude. ``gyro_increment`` and ``mean_specific_force * interval``
        are the exact integrals of angular rate and specific force over (t[k-1], t[k]].
    latitude, longitude : ndarray, shape (n,)
        WGS-84, rad. Longitude is within (-pi, pi].
    height : ndarray, shape (n,)
        Ellipsoidal, m.
    velocity_n : ndarray, shape (n, 3)
        Against the Earth, in NED, m/s.
    """

    imu: ImuTruth
    latitude: FloatArray
    longitude: FloatArray
    height: FloatArray
    velocity_n: FloatArray

    @property
    def time_ns(self) -> IntArray:
        """Instants, shape (n,)."""
        return self.imu.time_ns
