"""Motion constraints of an INS/GNSS filter: rests, and wheels on land."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray
from sinstool.core.units import DEGREE
from sinstool.methods.ins_gnss import layout, states

STEP_NS = 100_000_000
# Sigmas of velocity, m/s, and rate, rad/s, at rest, as means over STEP: an engine idles, somebody
# gets in.
REST_VELOCITY, REST_RATE = 0.02, 0.05 * DEGREE
# Time between constraints, s: errors of tyres last for seconds, so more constraints add no
# information.
INTERVAL = 0.5
# Initial sigmas of a vehicle: mount, rad; axle, m; sideslip and squat, rad/(m/s^2); scale of the
# wheels.
MOUNT_SIGMA, AXLE_SIGMA = 3.0 * DEGREE, 2.0
SIDESLIP_SIGMA, SQUAT_SIGMA = 0.004, 0.005
WHEEL_SCALE_SIGMA = 0.05


@dataclass(frozen=True)
class LandVehicle:
    """A vehicle whose unsteered axle goes neither sideways nor up.

    Attributes
    ----------
    c_vb : ndarray, shape (3, 3)
        From body axes to those of the vehicle: forward, right, down.
    axle : float
        How far the IMU is ahead of the axle, m.
    lateral, vertical : float
        Sigma of the axle's velocity in these directions as its mean over 1 s, m/s.
    wheel : float, optional
        The same of the wheels' speed.
    wheel_scale : float, optional
        By which the wheels read low, as a fraction.
    mount_sigma : float, optional
        Of pitch and yaw of `c_vb`, rad.
    """

    c_vb: FloatArray
    axle: float
    lateral: float
    vertical: float
    wheel: float = 0.1
    wheel_scale: float = 0.0
    mount_sigma: float = MOUNT_SIGMA

    def variances(self) -> FloatArray:
        """Variances of its states at the start, in the order of the filter; shape (6,)."""
        sigma = np.array(
            [
                self.mount_sigma,
                self.mount_sigma,
                AXLE_SIGMA,
                SIDESLIP_SIGMA,
                SQUAT_SIGMA,
                WHEEL_SCALE_SIGMA,
            ]
        )
        return sigma**2

    def start_values(self) -> FloatArray:
        """Initial values for a filter: see :mod:`~sinstool.methods.ins_gnss.layout`."""
        return np.concatenate([self.c_vb.ravel(), [self.axle, 0.0, 0.0, self.wheel_scale]])


@dataclass(frozen=True)
class Constraints:
    """Times at rest and times without sliding of a vehicle, on a grid.

    Attributes
    ----------
    start_ns : int
        Time of the first point; the others follow every `STEP_NS`.
    rests, rolls : ndarray of bool, shape (g,)
        At each point.
    surely : ndarray of bool, shape (g,)
        Of the rests, those that fixes show too: the filter's own speed does not deny them.
    wheel_speed : ndarray, shape (g,)
        m/s; NaN where unknown.
    vehicle : LandVehicle or None
        None where only rests are known.
    stands : ndarray of bool, shape (g,), optional
        Times at which the IMU is shaken: rests, and their ends, at which they are not used.
    shaken : tuple of float, optional
        Noise while it stands beyond that of the sensors, as power densities: of specific force,
        (m/s^2)^2 s, and of the rate, (rad/s)^2 s.
    """

    start_ns: int
    rests: BoolArray
    surely: BoolArray
    rolls: BoolArray
    wheel_speed: FloatArray
    vehicle: LandVehicle | None
    stands: BoolArray | None = None
    shaken: tuple[float, float] = (0.0, 0.0)

    def grid(self) -> FloatArray:
        """Columns by the names ``G_...`` of :mod:`~sinstool.methods.ins_gnss.layout`."""
        rests = self.rests.astype(np.float64) + (self.rests & self.surely)
        stands = self.rests if self.stands is None else self.stands
        return np.column_stack([rests, self.rolls, self.wheel_speed, stands])

    def parameters(self) -> FloatArray:
        """Numbers by the names ``V_...`` of :mod:`~sinstool.methods.ins_gnss.layout`."""
        p = np.zeros(layout.V_PARAMETERS)
        p[layout.V_STEP] = step = STEP_NS * 1e-9
        p[layout.V_INTERVAL] = INTERVAL
        p[layout.V_REST_VELOCITY] = REST_VELOCITY**2 * step
        p[layout.V_REST_RATE] = max(REST_RATE**2 * step, self.shaken[1])
        p[layout.V_SHAKEN_FORCE], p[layout.V_SHAKEN_RATE] = self.shaken
        if self.vehicle is not None:
            p[layout.V_LATERAL] = self.vehicle.lateral**2
            p[layout.V_VERTICAL] = self.vehicle.vertical**2
            p[layout.V_WHEEL] = self.vehicle.wheel**2
        return p


@dataclass(frozen=True)
class VehicleEstimate:
    """A filter's last estimates of a land vehicle.

    Attributes
    ----------
    c_vb : ndarray, shape (3, 3)
        From body axes to those of the vehicle.
    mount_sigma : ndarray, shape (2,)
        Of its pitch and yaw, rad.
    axle, sideslip, squat, wheel_scale : tuple of float
        Estimate and sigma: m, rad/(m/s^2), rad/(m/s^2), share.
    """

    c_vb: FloatArray
    mount_sigma: FloatArray
    axle: tuple[float, float]
    sideslip: tuple[float, float]
    squat: tuple[float, float]
    wheel_scale: tuple[float, float]


def vehicle_estimate(memory: FloatArray, covariance: FloatArray, first: int) -> VehicleEstimate:
    """Estimates of the vehicle from a filter's memory and covariance, from state `first` on."""
    sigma = np.sqrt(np.diagonal(covariance)[first : first + 6])

    def pair(state: int) -> tuple[float, float]:
        return float(memory[9 + state - states.AXLE]), float(sigma[state])

    return VehicleEstimate(
        memory[:9].reshape(3, 3).copy(),
        sigma[:2].copy(),
        pair(states.AXLE),
        pair(states.SIDESLIP),
        pair(states.SQUAT),
        pair(states.WHEEL_SCALE),
    )
