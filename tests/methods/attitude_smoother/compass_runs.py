"""Turning bodies with a magnetometer, simulated: what the smoother gets, and the truth."""

from dataclasses import dataclass

import numpy as np

from sinstool.core.rotation import conjugate as back
from sinstool.core.rotation import from_euler, log, multiply, rotate, tilt_and_heading, to_euler
from sinstool.core.streams import Imu, Magnetometer, Solution
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.attitude_smoother.correction import Correction
from sinstool.methods.attitude_smoother.epochs import Epochs, EpochStage
from sinstool.methods.attitude_smoother.field import EpochField, FieldStage
from sinstool.methods.attitude_smoother.magnetometer import Compass, find_north
from sinstool.methods.attitude_smoother.model import HAND, SensorModel
from sinstool.methods.attitude_smoother.rest import with_rest
from sinstool.methods.attitude_smoother.smoother import smooth
from sinstool.methods.strapdown.attitude import AttitudePropagator

RATE = 50
SIZE = 48e-6  # T
SENSORS = SensorModel(rate_error=0.0, bias=0.005)
GRAVITY = np.array([0.0, 0.0, -9.81])
MAX_GAP_NS = 60_000_000


def earth(dip_deg, azimuth_deg=0.0):
    """The Earth's field in NED, T."""
    dip, azimuth = np.radians(dip_deg), np.radians(azimuth_deg)
    level = np.cos(dip)
    return SIZE * np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(dip)])


def turning(seconds, rng, tilts=True, size=1.0):
    """Attitudes of a body that turns to and fro, about the vertical alone or about all axes."""
    times = np.arange(int(seconds * RATE) + 1) / RATE
    angles = np.zeros((len(times), 3))
    for axis in range(3) if tilts else (2,):
        for period in (7.0, 11.0, 23.0):
            phase = rng.uniform(0.0, 2.0 * np.pi)
            angles[:, axis] += np.sin(2.0 * np.pi * times / period + phase) * rng.uniform(0.4, 1.0)
    angles *= size
    angles[:, 2] += rng.uniform(-np.pi, np.pi)
    return times, from_euler(angles)


@dataclass(frozen=True)
class Made:
    """A run: its input, and its attitudes at the limits of the epochs."""

    epochs: Epochs
    measured: EpochField
    before: Correction
    time_ns: np.ndarray
    integrated: np.ndarray
    true: np.ndarray

    def compass(self, azimuth_deg=0.0) -> Compass:
        return find_north(self.epochs, self.measured, self.before.q[:-1], azimuth_deg * DEGREE)

    def smoothed(self, compass):
        """The correction with the headings of a compass."""
        return smooth(self.epochs, HAND, SENSORS, north=compass.north)

    def heading_errors(self, correction):
        """At the begin of the epochs, rad, and what is said of them."""
        at = np.searchsorted(self.time_ns, correction.time_ns[:-1])
        given = multiply(correction.q[:-1], self.integrated[at])
        _, error = tilt_and_heading(multiply(self.true[at], back(given)))
        return error, np.sqrt(correction.covariance_n[:-1, 2, 2])


def run(
    seed,
    seconds=120.0,
    field=None,
    iron=(0.0, 0.0, 0.0),
    disturbance=None,
    bias=0.0,
    mag_rate=RATE,
    turn=None,
    body_of_field=None,
    blocks=7,
    force_bias=0.0,
    **motion,
):
    """A body that turns where it stands.

    Parameters
    ----------
    field : ndarray, shape (3,), optional
        Of the Earth, NED, T.
    iron : tuple
        In body axes, T.
    disturbance : callable, optional
        Of times (s) and generator: added to the field in NED, T, shape (n, 3).
    bias : float
        Of the gyro on all axes, rad/s.
    turn : tuple, optional
        Times and attitudes, instead of those that are drawn.
    body_of_field : callable, optional
        What the magnetometer's axes make of the field in the IMU's.
    force_bias : float
        Of the accelerometer on all axes, m/s^2.
    blocks : int
        In which the solutions come.
    """
    rng = np.random.default_rng(seed)
    times, q = turning(seconds, rng, **motion) if turn is None else turn
    time_ns = np.rint(times * SECOND).astype(np.int64)
    field = earth(60.0) if field is None else field
    vectors = log(multiply(back(q[:-1]), q[1:]))
    walk = SENSORS.angle_random_walk / np.sqrt(RATE)
    vectors = vectors + walk * rng.standard_normal(vectors.shape) + bias / RATE
    # the integration knows the tilt at the start, and no heading
    roll, pitch, _ = to_euler(q[0])
    first = from_euler(np.array([roll, pitch, 0.0]))
    made = AttitudePropagator(first).push(vectors, np.full(len(vectors), 1.0 / RATE))
    integrated = np.concatenate([first[None], made])
    force = rotate(back(q), np.broadcast_to(GRAVITY, (len(q), 3)))
    force = force + force_bias + 0.03 * rng.standard_normal(force.shape)
    gyro = np.concatenate([vectors[:1], vectors]) * RATE
    imu = Imu(time_ns, time_ns, gyro, force)
    solution = Solution(time_ns, time_ns, integrated, imu.gyro, imu.accel)
    world = np.broadcast_to(field, (len(q), 3))
    if disturbance is not None:
        world = world + disturbance(times, rng)
    body = rotate(back(q), world) + np.array(iron) + 2e-7 * rng.standard_normal((len(q), 3))
    if body_of_field is not None:
        body = body_of_field(body)
    rows = slice(None, None, RATE // mag_rate)
    magnetic = Magnetometer(time_ns[rows], time_ns[rows], body[rows])
    stage, fields = EpochStage(MAX_GAP_NS, np.full(3, np.inf)), FieldStage(magnetic, MAX_GAP_NS)
    for part in np.array_split(np.arange(len(times)), blocks):
        stage.push(solution.rows(part))
        fields.push(solution.rows(part))
    epochs = with_rest(stage.finish())
    before = smooth(epochs, HAND, SENSORS)
    return Made(epochs, fields.means(epochs), before, time_ns, integrated, q)


def wandering(size_deg, field, memory=3.0):
    """A field across the Earth's that turns headings by so much, with a memory of seconds."""
    across = np.array([-field[1], field[0], 0.0])

    def draw(times, rng):
        keep = np.exp(-1.0 / (memory * RATE))
        noise = rng.standard_normal(len(times))
        state, out = noise[0], np.empty(len(times))
        for k, one in enumerate(noise):
            out[k] = state
            state = keep * state + np.sqrt(1.0 - keep**2) * one
        return np.radians(size_deg) * out[:, None] * across

    return draw
