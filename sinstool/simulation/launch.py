"""The flight of a launched vehicle: boost, calm glide with gentle weaving, rolls and turns.

The flight of Qu, Li, Zhu and Wang's in-flight alignment experiment is known only by its
dynamics: up to 196 m/s^2, 980 m/s^3, 220 deg/s and 1000 deg/s^2 within 30 s of lift-off, a roll
above 40 deg/s for 8 s near 80 s, rolls of 60 deg/s at 110 to 130 s, calm in between. This one has
them. Its course in the calm part is not published: amplitudes and phases of the weave were fitted
so that errors of alignment grow and shrink with time as an earlier simulation of that experiment
has them, so agreement with those figures says less about the alignment than about the fit.

Speed, flight-path angle, course and the Euler angles are given functions of time, so
velocity, acceleration, attitude and angular rate are exact everywhere. Position is their integral
over the ellipsoid, and gravity is a sum of spherical harmonics, independent of the closed formula
that :mod:`sinstool.earth` uses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool import earth, rotation
from sinstool.simulation.trajectory import Trajectory
from sinstool.simulation.truth import FloatArray, ImuTruth, sample_times

_DEGREE = np.pi / 180.0

# Coning of the boost turns by 2 deg each step of a quadrature at 5 ms; four nodes leave 1e-14.
_MAX_STEP_S = 0.005

# When the weave that makes heading visible in the calm glide begins to come in.
_CALM_S = 36.0
_CONING_HZ = 17.0
_CONING_HALF_ANGLE = 0.02 * _DEGREE
_VIBRATION_HZ = 43.0
_VIBRATION = 5.0  # m/s^2

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
    roll : tuple of terms
    """

    speed: tuple[Term, ...]
    climb: tuple[Term, ...]
    course: tuple[Term, ...]
    pitch: tuple[Term, ...]
    yaw: tuple[Term, ...]
    roll: tuple[Term, ...]


def launch_profile(dynamics: float = 1.0, straight: bool = False) -> Profile:
    """The default flight.

    Parameters
    ----------
    dynamics : float, optional
        Factor on the weaving and the turns after the boost; boost and rolls stay.
    straight : bool, optional
        After the boost fly straight and level at constant speed, without any roll.

    Returns
    -------
    Profile
    """
    boost = (Step(0.05, 0.2, 1.0), Step(24.0, 4.0, -1.0))
    coning = 2.0 * np.pi * _CONING_HZ
    vibration = 2.0 * np.pi * _VIBRATION_HZ
    speed: tuple[Term, ...] = (
        Ramp(0.0, 0.35, 186.0),
        Ramp(2.5, 0.35, -168.0),
        Wave(_VIBRATION / vibration, vibration, 0.0, boost),
    )
    climb: tuple[Term, ...] = (Step(-1e4, 1.0, 48.0 * _DEGREE), Step(2.0, 34.0, -40.0 * _DEGREE))
    pitch: tuple[Term, ...] = (
        Wave(_CONING_HALF_ANGLE, coning, np.pi / 2.0, boost),
        Step(5.0, 20.0, 3.0 * _DEGREE),
    )
    yaw: tuple[Term, ...] = (Wave(1.3 * _CONING_HALF_ANGLE, coning, 0.0, boost),)
    roll: tuple[Term, ...] = (
        Ramp(3.0, 0.4, 220.0 * _DEGREE),
        Ramp(11.0, 0.4, -220.0 * _DEGREE),
    )
    if straight:
        return Profile(
            (*speed, Ramp(28.0, 1.0, -18.0)),
            (*climb, Step(30.0, 8.0, -8.0 * _DEGREE)),
            (),
            pitch,
            yaw,
            roll,
        )
    return _with_glide(Profile(speed, climb, (), pitch, yaw, roll), dynamics)


def _with_glide(boost: Profile, dynamics: float) -> Profile:
    """The boost, then glide, weave, rolls and turns.

    The weave is strong for half a minute and gentle after. Its two frequencies and phases make
    the horizontal force turn mostly one way, so that heading shows from the first seconds, and
    more slowly as time goes on.
    """
    fade = (Step(_CALM_S, 4.0, 1.0), Step(66.0, 15.0, -0.8), Step(150.0, 20.0, -0.2))
    ahead, aside = 0.12, 0.0555  # rad/s
    return Profile(
        speed=(
            *boost.speed,
            Ramp(28.0, 1.0, -20.0),
            Ramp(140.0, 10.0, -4.7),
            Ramp(203.0, 10.0, 8.4),
            Wave(17.8 * dynamics, ahead, 1.4 - ahead * 40.0, fade),
        ),
        climb=(
            *boost.climb,
            Step(44.0, 90.0, -4.8 * _DEGREE),
            Step(145.0, 40.0, -3.2 * _DEGREE),
            Step(195.0, 50.0, -5.0 * _DEGREE),
        ),
        course=(
            Wave(-2.55 * _DEGREE * dynamics, aside, 1.87 - aside * 40.0, fade),
            Step(150.0, 50.0, -9.0 * _DEGREE * dynamics),
            Step(205.0, 50.0, 12.0 * _DEGREE * dynamics),
        ),
        pitch=(
            *boost.pitch,
            Wave(2.0 * _DEGREE * dynamics, 0.17, 0.0, fade),
        ),
        yaw=boost.yaw,
        roll=(
            *boost.roll,
            Wave(5.0 * _DEGREE * dynamics, 0.11, 0.0, fade),
            Ramp(76.0, 1.0, 46.0 * _DEGREE),
            Ramp(85.0, 1.0, -46.0 * _DEGREE),
            Ramp(110.5, 0.8, 62.0 * _DEGREE),
            Ramp(114.4, 1.6, -124.0 * _DEGREE),
            Ramp(121.4, 0.8, 62.0 * _DEGREE),
        ),
    )


def launch(
    rate_hz: float = 200.0,
    duration_s: float = 260.0,
    *,
    latitude: float = 0.72,
    longitude: float = 1.75,
    height: float = 1000.0,
    azimuth: float = 1.1,
    dynamics: float = 1.0,
    straight: bool = False,
    pad_s: float = 0.0,
    start_ns: int = 0,
) -> Trajectory:
    """Simulate the flight.

    Parameters
    ----------
    rate_hz : float, optional
        Imu samples per second.
    duration_s : float, optional
        From lift-off; the profile ends at 260 s.
    latitude, longitude, height : float, optional
        Of the site, rad and m, anywhere but at a pole.
    azimuth : float, optional
        Of the launch from north, rad.
    dynamics, straight : optional
        See :func:`launch_profile`.
    pad_s : float, optional
        Seconds at rest before lift-off.
    start_ns : int, optional
        First instant.

    Returns
    -------
    Trajectory
        Increments are integrals by Gauss-Legendre quadrature with four nodes in each 5 ms.

    Raises
    ------
    ValueError
        If the rate or the duration are not positive.
    """
    return fly(
        launch_profile(dynamics, straight),
        sample_times(rate_hz, pad_s + duration_s, start_ns),
        start_ns + round(pad_s * 1e9),
        (latitude, longitude, height),
        azimuth,
    )


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
    profile : Profile
    time_ns : ndarray of int64, shape (n,)
        Instants of the samples, of equal spacing up to rounding.
    lift_off_ns : int
        Time 0 of the profile.
    site : tuple of float
        Latitude, longitude (rad) and height (m) at the first instant.
    azimuth : float
        Course at which the profile's course is 0, rad.

    Returns
    -------
    Trajectory
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
    longitude = np.pi - np.mod(np.pi - ends[1], 2.0 * np.pi)
    return Trajectory(imu, ends[0], longitude, ends[2], now.velocity)


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
        m/s^2. Within 1e-6 of :func:`sinstool.earth.gravity_n` up to 20 km, which gets there
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
