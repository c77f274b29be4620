"""A simulated car: its sliding, the place of the IMU, and the motion of its rear axle.

Vehicle axes ``v`` are FRD at the middle of the rear axle, which slides only as given
here: its velocity to the right is ``-kappa V^2 r + s``, of forward speed V, yaw rate r and a slow
random slip s.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sinstool.core import rotation
from sinstool.core.arrays import ArrayLike, FloatArray, IntArray
from sinstool.simulation.gnss import Triple
from sinstool.simulation.moments import moments
from sinstool.simulation.travel import Levels
from sinstool.simulation.truth import Trajectory

Jet = Callable[[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray], tuple[FloatArray, ...]]
"""Time, speed, its derivative, yaw rate and its derivative into a velocity and its derivative."""

# The slow slip is a sum of this many sinusoids with the spectrum of a first-order Markov process,
# up to a frequency above which a car's body does not follow; it sets in at about this speed, m/s
_TONES, _FASTEST_HZ, _WALKING = 64, 1.0, 2.0
_SHIP = 3.0  # m/s, to the right
_MOORING = 10.0  # s
# Amplitudes of the ship's roll, pitch (rad) and heave (m/s), and their periods, s
_WAVES = ((np.deg2rad(2.0), 9.0), (np.deg2rad(0.8), 7.0), (0.3, 8.0))


@dataclass(frozen=True)
class Car:
    """A car and the IMU in it.

    Attributes
    ----------
    mount : tuple of float
        Roll, pitch and yaw of the IMU's axes in the vehicle's, rad: ``C_vb`` follows from them as
        ``C_nb`` from roll, pitch and heading.
    axle_lever : float
        Distance of the IMU ahead of the rear axle, m. The axle follows the road.
    sideslip : float
        kappa, angle of slip outward for each m/s^2 of centripetal acceleration, rad/(m/s^2).
    slip : float
        Standard deviation of the slow slip, m/s.
    slip_time : float
        Its correlation time, s.
    suspension : float
        Factor on the motion of the body on its springs; with 0 it moves with the axle.
    ferry : tuple of float or None
        Departure of a ferry, s after the start, and the duration of its crossing, s.
    """

    mount: Triple = (0.0, 0.0, 0.0)
    axle_lever: float = 0.0
    sideslip: float = 0.0
    slip: float = 0.0
    slip_time: float = 3.0
    suspension: float = 1.0
    ferry: tuple[float, float] | None = None

    @property
    def slides(self) -> bool:
        """Whether the axle moves sideways."""
        return self.sideslip != 0.0 or self.slip != 0.0


def product(a: tuple[FloatArray, ...], b: tuple[FloatArray, ...]) -> tuple[FloatArray, ...]:
    """Product of two quantities, each with its first and second derivative."""
    return (
        a[0] * b[0],
        a[1] * b[0] + a[0] * b[1],
        a[2] * b[0] + 2.0 * a[1] * b[1] + a[0] * b[2],
    )


def drift(car: Car, random: np.random.Generator) -> Jet:
    """Velocity of the axle to the right, and its derivative.

    Parameters
    ----------
    random : Generator
        Random numbers of the slow slip.
    """
    # Frequencies at random within equal shares of the Lorentzian spectrum up to the highest
    share = (np.arange(_TONES) + random.random(_TONES)) / _TONES
    corner = 1.0 / (2.0 * np.pi * car.slip_time)
    w = 2.0 * np.pi * corner * np.tan(share * np.arctan(_FASTEST_HZ / corner))
    phase = random.uniform(0.0, 2.0 * np.pi, _TONES)
    amplitude = car.slip * np.sqrt(2.0 / _TONES)

    def slip(
        t: FloatArray, v: FloatArray, dv: FloatArray, rate: FloatArray, bend: FloatArray
    ) -> tuple[FloatArray, ...]:
        right = -car.sideslip * v * v * rate
        dright = -car.sideslip * (2.0 * v * dv * rate + v * v * bend)
        moving = v != 0.0
        if car.slip and moving.any():
            v, dv = v[moving], dv[moving]
            turn = np.outer(t[moving], w) + phase
            slow, dslow = amplitude * np.sin(turn).sum(1), amplitude * np.cos(turn) @ w
            below = v * v + _WALKING**2
            sets, dsets = v * v / below, 2.0 * v * dv * _WALKING**2 / below**2
            right[moving] += sets * slow
            dright[moving] += dsets * slow + sets * dslow
        return right, dright

    return slip


def ferry_levels(car: Car) -> Levels | None:
    """Fraction of the ship's motion that the car has, 0 to 1; it fades in and out."""
    if car.ferry is None:
        return None
    leaves, lasts = car.ferry
    return Levels(0.0, [(leaves, _MOORING, 1.0), (leaves + lasts - _MOORING, _MOORING, 0.0)])


def ferry(out: FloatArray, t: FloatArray, crossing: Levels) -> FloatArray:
    """Add the motion of a ship that sails to the right of the car, in waves.

    Parameters
    ----------
    out : ndarray, shape (n, COLUMNS)
        Motion of the car on the ship; changed in place.
    t : ndarray, shape (n,)
        s.

    Returns
    -------
    ndarray, shape (n,)
        Second derivative of the pitch that was added, rad/s^2.
    """
    share = (crossing.value(t), crossing.slope(t), crossing.curvature(t))
    roll, pitch, heave = (
        product(share, (a * np.sin(w * t), a * w * np.cos(w * t), -a * w * w * np.sin(w * t)))
        for a, w in ((size, 2.0 * np.pi / period) for size, period in _WAVES)
    )
    c, s = np.cos(out[:, 8]), np.sin(out[:, 8])
    out[:, 0] -= _SHIP * share[0] * s
    out[:, 1] += _SHIP * share[0] * c
    out[:, 3] -= _SHIP * share[1] * s
    out[:, 4] += _SHIP * share[1] * c
    for column, jet in ((2, heave), (6, roll), (7, pitch)):
        out[:, column] += jet[0]
        out[:, column + 3] += jet[1]
    return pitch[2]


def move_by_lever(out: FloatArray, pitched: FloatArray, bend: FloatArray, lever: float) -> None:
    """Turn the motion of the axle into that of a point ahead of it.

    Parameters
    ----------
    out : ndarray, shape (n, COLUMNS)
        Changed in place.
    pitched, bend : ndarray, shape (n,)
        Second derivatives of pitch and yaw, rad/s^2.
    lever : float
        m.
    """
    cp, sp = np.cos(out[:, 7]), np.sin(out[:, 7])
    cy, sy = np.cos(out[:, 8]), np.sin(out[:, 8])
    dp, dy = out[:, 10], out[:, 11]
    # Derivatives of the forward axis (cp cy, cp sy, -sp), first along and across its azimuth
    along, across = -sp * dp, cp * dy
    dalong = -cp * (dp * dp + dy * dy) - sp * pitched
    dacross = cp * bend - 2.0 * sp * dp * dy
    out[:, 0] += lever * (along * cy - across * sy)
    out[:, 1] += lever * (along * sy + across * cy)
    out[:, 2] -= lever * cp * dp
    out[:, 3] += lever * (dalong * cy - dacross * sy)
    out[:, 4] += lever * (dalong * sy + dacross * cy)
    out[:, 5] += lever * (sp * dp * dp - cp * pitched)


@dataclass(frozen=True)
class AxleMotion:
    """Motion of the middle of the rear axle.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (n,)
    latitude, longitude, height : ndarray, shape (n,)
        rad, m.
    q_nv : ndarray, shape (n, 4)
        Attitude of the vehicle.
    velocity_v : ndarray, shape (n, 3)
        Relative to the Earth, FRD of the vehicle, m/s.
    rate_v : ndarray, shape (n, 3)
        ``omega_iv_v``, rad/s.
    """

    time_ns: IntArray
    latitude: FloatArray
    longitude: FloatArray
    height: FloatArray
    q_nv: FloatArray
    velocity_v: FloatArray
    rate_v: FloatArray


def axle_motion(trajectory: Trajectory, car: Car, time_ns: ArrayLike) -> AxleMotion:
    """Truth of the vehicle, from that of the IMU in it.

    Parameters
    ----------
    trajectory : Trajectory
        Of the IMU.
    time_ns : array_like of int64, shape (n,)
        Within the trajectory.
    """
    q_vb = rotation.from_euler(car.mount)
    back = rotation.rotate(rotation.conjugate(q_vb), [-car.axle_lever, 0.0, 0.0])
    m = moments(trajectory, time_ns, back)
    q_nv = rotation.multiply(m.q_nb, rotation.conjugate(q_vb))
    velocity = rotation.rotate(rotation.conjugate(q_nv), m.velocity_n)
    rate = rotation.rotate(q_vb, m.omega_ib_b)
    return AxleMotion(m.time_ns, m.latitude, m.longitude, m.height, q_nv, velocity, rate)
