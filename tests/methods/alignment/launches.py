"""A simulated launch as alignment sees it, and what its attitude really was."""

from functools import cache

import numpy as np

from sinstool.core import rotation
from sinstool.methods.alignment.inflight_types import GnssFixes, ImuIncrements
from sinstool.methods.sensor_errors import SensorGrade as Errors
from sinstool.simulation.gnss import MODELS, Receiver, gnss_samples, true_moments
from sinstool.simulation.launch import launch
from sinstool.simulation.moments import moments
from sinstool.simulation.sensors import with_errors

PERFECT = MODELS["perfect"]
NOISY = MODELS["launch"]
DEGREE = np.pi / 180.0

# Constant errors of a tactical grade: what the covariance speaks of.
TACTICAL = Errors(
    angle_random_walk=0.05 * DEGREE / 60.0,
    gyro_bias=DEGREE / 3600.0,
    velocity_random_walk=50e-6 * 9.80665,
    accel_bias=1e-3 * 9.80665,
    gyro_scale=1e-4,
    accel_scale=1e-4,
)


@cache
def trajectory(**options):
    return launch(**{"duration_s": 110.0, **options})


@cache
def antenna_truth(receiver, **options):
    return true_moments(trajectory(**options), receiver)


def increments(truth, errors=None, seed=0):
    samples = truth if errors is None else with_errors(truth, errors, seed)
    return ImuIncrements(
        samples.time_ns,
        samples.gyro_increment,
        samples.mean_specific_force * samples.interval[:, None],
    )


def fixes(samples):
    return GnssFixes(
        samples.time_ns, samples.latitude, samples.longitude, samples.height, samples.velocity_n
    )


def exact(receiver=None, **options):
    receiver = Receiver(errors=PERFECT) if receiver is None else receiver
    flight = trajectory(**options)
    samples = gnss_samples(flight, receiver, 1, antenna_truth(receiver, **options))
    return flight, increments(flight.imu), fixes(samples)


def noisy(seed, receiver=None, errors=TACTICAL, **options):
    receiver = Receiver(errors=NOISY) if receiver is None else receiver
    flight = trajectory(**options)
    samples = gnss_samples(flight, receiver, 1000 + seed, antenna_truth(receiver, **options))
    return flight, increments(flight.imu, errors, seed), fixes(samples)


def true_attitude(flight, time_ns):
    return moments(flight, np.atleast_1d(np.int64(time_ns)), (0.0, 0.0, 0.0)).q_nb


def psi(result, true):
    """Rotation vector in NED: the attitude found is (I + [psi x]) the true one."""
    return rotation.log(rotation.multiply(result, rotation.conjugate(true)))


def angle_deg(result, true):
    return np.rad2deg(np.linalg.norm(psi(result, true), axis=-1))
