"""Scales of gyros that are constantly off, of bodies that spin."""

import numpy as np
import pytest

from sinstool.core.rotation import conjugate as back
from sinstool.core.rotation import exp, log, multiply, rotate
from sinstool.core.streams import Solution
from sinstool.core.timeline import SECOND
from sinstool.methods.attitude_smoother.epochs import EpochStage
from sinstool.methods.attitude_smoother.model import VEHICLE, SensorModel
from sinstool.methods.attitude_smoother.rest import with_rest
from sinstool.methods.attitude_smoother.smoother import smooth
from sinstool.methods.strapdown.attitude import AttitudePropagator

RATE = 200


def tilts(seed, spin, scale, seconds=60.0):
    """Errors of tilt of an IMU in a wheel, rad, and their sigmas."""
    rng = np.random.default_rng(seed)
    times = np.arange(int(seconds * RATE) + 1) / RATE
    speed = spin * (1.0 + 0.2 * np.sin(2.0 * np.pi * times / 40.0 + rng.uniform(0.0, 6.0)))
    speed *= np.clip((times - 10.0) / 5.0, 0.0, 1.0)
    angle, zero = np.cumsum(speed) / RATE, np.zeros_like(times)
    q = exp(np.column_stack([zero, angle, zero]))
    vectors = log(multiply(back(q[:-1]), q[1:])) * (1.0 + scale)
    vectors += SensorModel().angle_random_walk / np.sqrt(RATE) * rng.standard_normal(vectors.shape)
    made = AttitudePropagator(q[0]).push(vectors, np.full(len(vectors), 1.0 / RATE))
    moves = np.where(times > 10.0, 0.5, 0.02)[:, None]
    shaken = np.array([0.0, 0.0, -9.81]) + moves * rng.standard_normal((len(q), 3))
    time_ns = np.rint(times * SECOND).astype(np.int64)
    gyro = np.concatenate([vectors[:1], vectors]) * RATE
    integrated = np.concatenate([q[:1], made])
    stage = EpochStage(60_000_000, np.full(3, np.inf))
    stage.push(Solution(time_ns, time_ns, integrated, gyro, rotate(back(q), shaken)))
    found = smooth(with_rest(stage.finish()), VEHICLE, SensorModel())
    at = np.searchsorted(time_ns, found.time_ns)
    down = np.broadcast_to([0.0, 0.0, 1.0], (len(at), 3))
    ours = rotate(back(multiply(found.q, integrated[at])), down)
    error = np.linalg.norm(ours - rotate(back(q[at]), down), axis=1)
    covariance = found.covariance_n
    return error, np.sqrt(covariance[:, 0, 0] + covariance[:, 1, 1])


@pytest.mark.parametrize("spin", [15.0, 30.0])
def test_what_a_wheel_turns_too_far_is_in_the_sigma_of_its_tilt(spin):
    # 1.4 sigma of what is said of scales
    squares = []
    for seed in range(6):
        error, sigma = tilts(seed, spin, -7e-3)
        squares.append(np.mean((error / sigma) ** 2))
    assert 0.3 < np.mean(squares) < 1.5


def test_what_does_not_spin_keeps_its_sigma():
    _, sigma = tilts(0, 0.05, 0.0)
    assert np.median(sigma) < np.radians(3.0)
