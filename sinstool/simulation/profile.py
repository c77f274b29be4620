"""A vehicle on a profile: speed, flight-path angle, course and Euler angles over time.

Velocity, acceleration, attitude and angular rate are exact everywhere. Position is their integral
over the ellipsoid, and gravity is a sum of spherical harmonics, independent of the closed formula
that :mod:`sinstool.core.earth` uses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core import earth, rotation
from sinstool.simulation.truth import FloatArray, ImuTruth, Trajectory

# Longest step of the quadrature: four nodes leave 6e-9 of a vibration at 43 Hz, 5e-14 at 10 Hz.
_MAX_STEP_S = 0.005

# Second zonal harmonic of the WGS-84 ellipsoid, NIMA TR8350.2 table 3.1 (-sqrt(5) C20); those
# of order four and six follow from it as the ellipsoid is an equipotential surface.
_J2 = 1.0826298213e-3


@dataclass(frozen=True)
class Step:
    """Quintic step from 0 to ``size`` in ``duration`` s after ``start`` s."""

    start: float
    duration: float
    size: float

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Value and rate."""
        x = np.clip((t - self.start) / self.duration, 0.0, 1.0)
        value = self.size * x**3 * (10.0 - 15.0 * x + 6.0 * x * x)
        return value, self.size / self.duration * 30.0 * x * x * (1.0 - x) ** 2


@dataclass(frozen=True)
class Ramp:
    """Integral of a quintic step: its rate goes from 0 to ``slope``."""

    start: float
    duration: float
    slope: float

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Value and rate."""
        x = np.clip((t - self.start) / self.duration, 0.0, 1.0)
        within = self.duration * x**4 * (2.5 - 3.0 * x + x * x)
        after = np.maximum(t - self.start - self.duration, 0.0)
        return self.slope * (within + after), self.slope * x**3 * (10.0 - 15.0 * x + 6.0 * x * x)


@dataclass(frozen=True)
class Wave:
    """Sine of ``amplitude``, rad/s and phase at 0 s, faded in and out by steps of unit size."""

    amplitude: float
    angular_frequency: float
    phase: float
    fade: tuple[Step, ...]

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Value and rate."""
        envelope, growth = _total(self.fade, t)
        angle = self.angular_frequency * t + self.phase
        wave = self.amplitude * np.sin(angle)
        slope = self.amplitude * self.angular_frequency * np.cos(angle)
        return envelope * wave, envelope * slope + growth * wave


Term = Step | Ramp | Wave


def _total(terms: tuple[Term, ...], t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sum of terms and its rate."""
    value, rate = np.zeros_like(t), np.zeros_like(t)
    for term in terms:
        part, slope = term.at(t)
        value += part
        rate += slope
    return value, rate


@dataclass(frozen=True)
class Profile:
    """A flight as functions of the time since lift-off; angles in rad, speed in m/s.

    Attributes
    ----------
    speed, climb, course : tuple of terms
        Of the velocity against the Earth: size, angle above the horizon, angle from the azimuth.
    pitch, yaw : tuple of terms
        Of the body beyond those of the velocity (angles of attack and sideslip, coning).
    """

    speed: tuple[Term, ...]
    climb: tuple[Term, ...]
    course: tuple[Term, ...]
    pitch: tuple[Term, ...]
    yaw: tuple[Term, ...]
    roll: tuple[Term, ...]


def fly(
    profile: Profile,
    time_ns: np.ndarray,
    lift_off_ns: int,
    site: tuple[float, float, float],
    azimuth: float,
) -> Trajectory:
    """Trajectory of a profile.

    Parameters
    ----------
    time_ns : ndarray of int64, shape (n,)
        Instants of the samples, of equal spacing up to rounding.
    lift_off_ns : int
        Time 0 of the profile.
    site : tuple of float
        Latitude, longitude (rad) and height (m) at the first instant.
    azimuth : float
        Course at which the profile's course is 0, rad.
    """
    t = (time_ns - lift_off_ns) * 1e-9
    interval = np.concatenate([[t[1] - t[0]], np.diff(t)])
    pieces = int(np.ceil(interval.max() / _MAX_STEP_S - 1e-6))
    nodes, weights, partial = _gauss_rule()
    step = np.repeat(interval / pieces, pieces)
    begin = np.repeat(t - interval, pieces) + np.tile(np.arange(pieces), len(t)) * step
    at = begin[:, None] + step[:, None] * nodes
    motion = _Motion(profile, at.ravel(), azimuth)
    latitude, height, ends = _path(motion, step, weights, partial, site, pieces)
    rate, force = motion.felt(latitude.ravel(), height.ravel())

    def integral(of: FloatArray) -> FloatArray:
        over = np.einsum("kj,j,kjc->kc", np.broadcast_to(step[:, None], at.shape), weights, of)
        return over.reshape(len(t), pieces, 3).sum(axis=1)

    increment = integral(rate.reshape(*at.shape, 3))
    velocity_increment = integral(force.reshape(*at.shape, 3))
    now = _Motion(profile, t, azimuth)
    instant_rate, instant_force = now.felt(ends[0], ends[2])
    imu = ImuTruth(
        time_ns=time_ns,
        interval=interval,
        gyro_rate=instant_rate,
        gyro_mean_rate=increment / interval[:, None],
        gyro_increment=increment,
        specific_force=instant_force,
        mean_specific_force=velocity_increment / interval[:, None],
        q_nb=rotation.normalise(rotation.from_euler(now.euler)),
    )
    return Trajectory(imu, ends[0], rotation.wrapped(ends[1]), ends[2], now.velocity)


class _Motion:
    """Velocity, acceleration, attitude and its rate at instants of a profile."""

    def __init__(self, profile: Profile, t: FloatArray, azimuth: float) -> None:
        speed, speeding = _total(profile.speed, t)
        climb, climbing = _total(profile.climb, t)
        course, turning = _total(profile.course, t)
        course += azimuth
        ahead = np.stack(
            [np.cos(climb) * np.cos(course), np.cos(climb) * np.sin(course), -np.sin(climb)], -1
        )
        above = np.stack(
            [-np.sin(climb) * np.cos(course), -np.sin(climb) * np.sin(course), -np.cos(climb)], -1
        )
        right = np.stack([-np.sin(course), np.cos(course), np.zeros_like(course)], -1)
        self.velocity = speed[:, None] * ahead
        self.acceleration = (
            speeding[:, None] * ahead
            + (speed * climbing)[:, None] * above
            + (speed * turning * np.cos(climb))[:, None] * right
        )
        roll, roll_rate = _total(profile.roll, t)
        pitch, pitch_rate = _total(profile.pitch, t)
        yaw, yaw_rate = _total(profile.yaw, t)
        pitch, pitch_rate = pitch + climb, pitch_rate + climbing
        yaw, yaw_rate = yaw + course, yaw_rate + turning
        self.euler = np.stack([roll, pitch, yaw], -1)
        # Rate of b against n from Euler rates, Groves eq. (2.58) of the kinematics.
        self.rate_nb = np.stack(
            [
                roll_rate - yaw_rate * np.sin(pitch),
                pitch_rate * np.cos(roll) + yaw_rate * np.cos(pitch) * np.sin(roll),
                -pitch_rate * np.sin(roll) + yaw_rate * np.cos(pitch) * np.cos(roll),
            ],
            -1,
        )

    def felt(self, latitude: FloatArray, height: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Angular rate and specific force in the body at these latitudes and heights."""
        q_bn = rotation.conjugate(rotation.from_euler(self.euler))
        earth_rate = earth.earth_rate_n(latitude)
        transport = earth.transport_rate_n(latitude, height, self.velocity)
        force = (
            self.acceleration
            + np.cross(2.0 * earth_rate + transport, self.velocity)
            - harmonic_gravity_n(latitude, height)
        )
        rate = self.rate_nb + rotation.rotate(q_bn, earth_rate + transport)
        return rate, rotation.rotate(q_bn, force)


def _gauss_rule() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Nodes and weights on [0, 1], and weights of the integrals from 0 to each node."""
    x, w = np.polynomial.legendre.leggauss(4)
    nodes, weights = 0.5 * (x + 1.0), 0.5 * w
    powers = np.arange(4)
    to_node = nodes[:, None] ** (powers + 1) / (powers + 1)
    return nodes, weights, to_node @ np.linalg.inv(nodes[:, None] ** powers)


def _path(
    motion: _Motion,
    step: FloatArray,
    weights: FloatArray,
    partial: FloatArray,
    site: tuple[float, float, float],
    pieces: int,
) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray, FloatArray]]:
    """Latitude and height at the nodes; latitude, longitude and height at the samples."""
    shape = (len(step), len(weights))
    v = motion.velocity.reshape(*shape, 3)

    def integrate(rate: FloatArray, start: float) -> tuple[FloatArray, FloatArray]:
        """Values at the nodes and at the ends of the steps; ``start`` holds at the first sample."""
        end = np.cumsum(step * (rate @ weights))
        end += start - end[pieces - 1]
        begin = np.concatenate([[end[0] - step[0] * (rate[0] @ weights)], end[:-1]])
        return begin[:, None] + step[:, None] * (rate @ partial.T), end

    height, height_end = integrate(-v[..., 2], site[2])
    latitude, latitude_end = np.full(shape, site[0]), np.full(len(step), site[0])
    # The radius depends on latitude so weakly that each round leaves a part in 1e4 of the error.
    for _ in range(6):
        meridian, _ = earth.radii_of_curvature(latitude)
        latitude, latitude_end = integrate(v[..., 0] / (meridian + height), site[0])
    _, transverse = earth.radii_of_curvature(latitude)
    _, longitude_end = integrate(v[..., 1] / ((transverse + height) * np.cos(latitude)), site[1])
    last = slice(pieces - 1, None, pieces)
    return latitude, height, (latitude_end[last], longitude_end[last], height_end[last])


def harmonic_gravity_n(latitude: FloatArray, height: FloatArray) -> FloatArray:
    """Gravity in NED from zonal harmonics up to order six, centrifugal acceleration included.

    Parameters
    ----------
    latitude, height : ndarray, shape (n,)
        Geodetic, rad and m.

    Returns
    -------
    ndarray, shape (n, 3)
        m/s^2. Within 1e-6 of :func:`sinstool.core.earth.gravity_n` up to 20 km, which gets there
        another way.

    References
    ----------
    Heiskanen and Moritz, Physical Geodesy, eqs (2-39) and (2-92) for the harmonics of an
    equipotential ellipsoid.
    """
    e2 = earth.ECCENTRICITY_SQUARED
    _, transverse = earth.radii_of_curvature(latitude)
    out = (transverse + height) * np.cos(latitude)
    up = (transverse * (1.0 - e2) + height) * np.sin(latitude)
    r = np.hypot(out, up)
    s, c = up / r, out / r
    legendre = (
        ((3.0 * s**2 - 1.0) / 2.0, 3.0 * s),
        ((35.0 * s**4 - 30.0 * s**2 + 3.0) / 8.0, (35.0 * s**3 - 15.0 * s) / 2.0),
        (
            (231.0 * s**6 - 315.0 * s**4 + 105.0 * s**2 - 5.0) / 16.0,
            (693.0 * s**5 - 630.0 * s**3 + 105.0 * s) / 8.0,
        ),
    )
    radial, along = np.ones_like(r), np.zeros_like(r)
    for n, (p, slope) in enumerate(legendre, start=1):
        j = (-1.0) ** (n + 1) * 3.0 * e2**n / ((2 * n + 1) * (2 * n + 3))
        j *= 1.0 - n + 5.0 * n * _J2 / e2
        scaled = j * (earth.SEMI_MAJOR_AXIS / r) ** (2 * n)
        radial -= (2 * n + 1) * scaled * p
        along += scaled * slope * c
    size = -earth.GRAVITATIONAL_CONSTANT / r**2
    radial, along = size * radial, size * along
    outward = radial * c - along * s + earth.EARTH_RATE**2 * out
    upward = radial * s + along * c
    sin_lat, cos_lat = np.sin(latitude), np.cos(latitude)
    north = -sin_lat * outward + cos_lat * upward
    down = -cos_lat * outward - sin_lat * upward
    return np.stack([north, np.zeros_like(north), down], axis=-1)
