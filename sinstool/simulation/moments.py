"""True motion of a point of the body at any instant, between the samples of a trajectory.

Position is the quintic in Earth axes with the positions, velocities and accelerations of the two
samples around; velocity is its derivative. Attitude is the cubic rotation vector with the attitudes
and angular rates of both. For a motion of angular frequency w sampled every T, the
quintic leaves (wT)^6/46080 of its amplitude and the cubic (wT)^4/384: at 200 Hz, of a vibration at
43 Hz, 1e-4 and 9e-3, and of one at 1 Hz 2e-14 and 3e-9.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core import earth, rotation
from sinstool.core.arrays import ArrayLike, FloatArray, IntArray
from sinstool.simulation.truth import Trajectory


@dataclass(frozen=True)
class Moments:
    """Motion at some instants.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (m,)
    latitude, longitude : ndarray, shape (m,)
        rad; longitude within (-pi, pi].
    height : ndarray, shape (m,)
        m.
    velocity_n : ndarray, shape (m, 3)
        NED, m/s.
    q_nb : ndarray, shape (m, 4)
    omega_ib_b : ndarray, shape (m, 3)
        rad/s.
    """

    time_ns: IntArray
    latitude: FloatArray
    longitude: FloatArray
    height: FloatArray
    velocity_n: FloatArray
    q_nb: FloatArray
    omega_ib_b: FloatArray


def moments(
    trajectory: Trajectory, time_ns: ArrayLike, lever_arm_b: ArrayLike = (0.0, 0.0, 0.0)
) -> Moments:
    """Motion of a point of the vehicle at any instants.

    Parameters
    ----------
    time_ns : array_like of int64, shape (m,)
        Within those of the trajectory, in any order.
    lever_arm_b : array_like, shape (3,), optional
        From the IMU to the point, FRD, m.

    Raises
    ------
    ValueError
        If an instant lies outside the trajectory or a shape is wrong.
    """
    times = np.asarray(time_ns, dtype=np.int64)
    lever = np.asarray(lever_arm_b, dtype=np.float64)
    if times.ndim != 1 or lever.shape != (3,):
        raise ValueError("Expected `time_ns` of shape (m,) and `lever_arm_b` of shape (3,).")
    samples_ns = trajectory.time_ns
    if len(times) and (times.min() < samples_ns[0] or times.max() > samples_ns[-1]):
        raise ValueError("Found an instant outside the trajectory in `time_ns`.")
    k = np.clip(np.searchsorted(samples_ns, times, side="right") - 1, 0, len(samples_ns) - 2)
    step: FloatArray = (samples_ns[k + 1] - samples_ns[k]).astype(np.float64) * 1e-9
    x: FloatArray = (times - samples_ns[k]) * 1e-9 / step
    r0, v0, a0 = _earth_motion(trajectory, k)
    r1, v1, a1 = _earth_motion(trajectory, k + 1)
    moved, velocity = _quintic(x, step, v0, a0, r1 - r0, v1, a1)
    q_eb, omega_ib_b = _attitude(trajectory, k, step, x)
    omega_eb_b = omega_ib_b - rotation.rotate(rotation.conjugate(q_eb), _EARTH_RATE_E)
    position = r0 + moved + rotation.rotate(q_eb, lever)
    velocity = velocity + rotation.rotate(q_eb, np.cross(omega_eb_b, lever))
    latitude, longitude, height = from_ecef(position)
    q_ne = rotation.conjugate(_q_en(latitude, longitude))
    return Moments(
        times,
        latitude,
        longitude,
        height,
        rotation.rotate(q_ne, velocity),
        rotation.multiply(q_ne, q_eb),
        omega_ib_b,
    )


_EARTH_RATE_E = np.array([0.0, 0.0, earth.EARTH_RATE])


def from_ecef(position: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Latitude, longitude (rad) and height (m) of positions in Earth axes, shape (..., 3).

    Bowring's method, Groves eqs (C.15) to (C.18); repeated, which leaves rounding alone at
    any height above -6000 km.
    """
    r = np.asarray(position, dtype=np.float64)
    e2 = earth.ECCENTRICITY_SQUARED
    out = np.hypot(r[..., 0], r[..., 1])
    reduced = np.arctan2(r[..., 2] * earth.SEMI_MAJOR_AXIS, out * earth.SEMI_MINOR_AXIS)
    latitude = reduced
    for _ in range(3):
        latitude = np.arctan2(
            r[..., 2] + e2 / (1.0 - e2) * earth.SEMI_MINOR_AXIS * np.sin(reduced) ** 3,
            out - e2 * earth.SEMI_MAJOR_AXIS * np.cos(reduced) ** 3,
        )
        reduced = np.arctan2((1.0 - earth.FLATTENING) * np.sin(latitude), np.cos(latitude))
    sin_lat, cos_lat = np.sin(latitude), np.cos(latitude)
    _, transverse = earth.radii_of_curvature(latitude)
    # Equally well conditioned at the equator and at a pole.
    height = out * cos_lat + r[..., 2] * sin_lat - earth.SEMI_MAJOR_AXIS**2 / transverse
    return np.asarray(latitude), np.arctan2(r[..., 1], r[..., 0]), np.asarray(height)


def _q_en(latitude: FloatArray, longitude: FloatArray) -> FloatArray:
    """Attitude of NED in Earth axes: about z by longitude, then about y by -(90 deg + latitude)."""
    zero = np.zeros_like(latitude)
    about_z = rotation.exp(np.stack([zero, zero, longitude], -1))
    about_y = rotation.exp(np.stack([zero, -0.5 * np.pi - latitude, zero], -1))
    return rotation.multiply(about_z, about_y)


def _earth_motion(trajectory: Trajectory, k: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, velocity and acceleration against the Earth, in Earth axes, at rows ``k``."""
    lat, lon, h = trajectory.latitude[k], trajectory.longitude[k], trajectory.height[k]
    q_en = _q_en(lat, lon)
    velocity = rotation.rotate(q_en, trajectory.velocity_n[k])
    q_nb, f_b = trajectory.imu.q_nb[k], trajectory.imu.specific_force[k]
    pull = rotation.rotate(q_nb, f_b) + earth.gravity_n(lat, h)
    coriolis = np.cross(2.0 * _EARTH_RATE_E, velocity)
    return earth.ecef(lat, lon, h), velocity, rotation.rotate(q_en, pull) - coriolis


def _quintic(
    x: FloatArray,
    step: FloatArray,
    v0: FloatArray,
    a0: FloatArray,
    moved: FloatArray,
    v1: FloatArray,
    a1: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Displacement and velocity at fraction x of the step, from both ends' derivatives."""
    x, step = x[:, None], step[:, None]
    c1, c2 = step * v0, 0.5 * step**2 * a0
    # What is left for the powers 3 to 5 in position, velocity and acceleration at the end.
    p = moved - c1 - c2
    d = step * v1 - c1 - 2.0 * c2
    s = step**2 * a1 - 2.0 * c2
    c3 = 10.0 * p - 4.0 * d + 0.5 * s
    c4 = -15.0 * p + 7.0 * d - s
    c5 = 6.0 * p - 3.0 * d + 0.5 * s
    position = x * (c1 + x * (c2 + x * (c3 + x * (c4 + x * c5))))
    rate = c1 + x * (2.0 * c2 + x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5)))
    return position, rate / step


def _attitude(
    trajectory: Trajectory, k: IntArray, step: FloatArray, x: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Attitude in Earth axes and rate against inertial space at fraction x of the step."""
    turn = earth.EARTH_RATE * step
    z = np.zeros_like(turn)

    def inertial(row: IntArray, angle: FloatArray) -> FloatArray:
        """Against the Earth's axes as they were at the start of the step."""
        q_en = _q_en(trajectory.latitude[row], trajectory.longitude[row])
        q_eb = rotation.multiply(q_en, trajectory.imu.q_nb[row])
        return rotation.multiply(rotation.exp(np.stack([z, z, angle], -1)), q_eb)

    start = inertial(k, z)
    end = inertial(k + 1, turn)
    phi = rotation.log(rotation.multiply(rotation.conjugate(start), end))
    w0, w1 = trajectory.imu.gyro_rate[k], trajectory.imu.gyro_rate[k + 1]
    # Rotation vector rate of an angular rate (Bortz), to the second order in the angle.
    cross = np.cross(phi, w1)
    s0 = step[:, None] * w0
    s1 = step[:, None] * (w1 + 0.5 * cross + np.cross(phi, cross) / 12.0)
    x = x[:, None]
    c2 = 3.0 * phi - 2.0 * s0 - s1
    c3 = -2.0 * phi + s0 + s1
    at = x * (s0 + x * (c2 + x * c3))
    rate = (s0 + x * (2.0 * c2 + x * 3.0 * c3)) / step[:, None]
    cross = np.cross(at, rate)
    omega = rate - 0.5 * cross + np.cross(at, cross) / 6.0
    back = rotation.exp(np.stack([z, z, -turn * x[:, 0]], -1))
    q_eb = rotation.multiply(back, rotation.multiply(start, rotation.exp(at)))
    return q_eb, omega
