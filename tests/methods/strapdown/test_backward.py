"""Navigation backwards takes a state to where it came from."""

import numpy as np
import pytest

from sinstool.methods.strapdown.navigation import SIZE, initial_state, navigate_backward
from sinstool.simulation.flight import manoeuvring_flight
from tests.methods.strapdown.navigator import Navigator


@pytest.mark.parametrize(
    ("latitude", "longitude"), [(-0.6, 2.0), (0.9, np.pi - 1e-6), (1.56, -0.5)]
)
def test_there_and_back(latitude, longitude):
    flight = manoeuvring_flight(
        120.0, 100.0, latitude=latitude, longitude=longitude, heading=1.2, seed=3
    )
    imu = flight.imu
    phi = np.ascontiguousarray(imu.gyro_increment[1:])
    dv = np.ascontiguousarray(imu.mean_specific_force[1:] * imu.interval[1:, None])
    dt = np.ascontiguousarray(imu.interval[1:])
    start = initial_state(
        latitude, flight.longitude[0], flight.height[0], flight.velocity_n[0], imu.q_nb[0]
    )
    navigator = Navigator(start)
    forward = navigator.push(phi, dv, dt).rows
    state = navigator.state
    backward = np.empty((len(dt), SIZE))
    navigate_backward(state, phi, dv, dt, backward)
    # rows of `backward` are starts of the updates: those of `forward`, one later
    sign = np.sign(np.sum(backward[1:, 6:] * forward[:-1, 6:], axis=1))[:, None]
    np.testing.assert_allclose(backward[1:, 0], forward[:-1, 0], atol=1e-13)
    turn = (backward[1:, 1] - forward[:-1, 1] + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(turn * np.cos(latitude), 0.0, atol=1e-12)
    np.testing.assert_allclose(backward[1:, 2:6], forward[:-1, 2:6], atol=1e-6)
    np.testing.assert_allclose(sign * backward[1:, 6:], forward[:-1, 6:], atol=1e-11)
    np.testing.assert_allclose(state[2:6], start[2:6], atol=1e-6)
    # it went somewhere
    assert abs(forward[-1, 0] - start[0]) + abs(forward[-1, 1] - start[1]) > 1e-5
