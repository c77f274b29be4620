"""True motion between the instants of a trajectory, against one that is sampled more finely."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sinstool.core import rotation
from sinstool.core.earth import ecef
from sinstool.simulation.launch import launch
from sinstool.simulation.moments import from_ecef, moments

DEGREE = np.pi / 180.0


@pytest.fixture(scope="module")
def flight():
    return launch(200.0, 130.0)


@given(st.floats(-np.pi / 2, np.pi / 2), st.floats(-np.pi, np.pi), st.floats(-1e4, 1e6))
def test_earth_axes_there_and_back(latitude, longitude, height):
    lat, lon, h = from_ecef(ecef(latitude, longitude, height))
    # Some ten roundings of the Earth's radius, of 0.5 nm each
    assert lat == pytest.approx(latitude, abs=1e-14) and h == pytest.approx(height, abs=1e-8)
    across = (lon - longitude) * np.cos(latitude)
    assert min(abs(across), abs(abs(across) - 2.0 * np.pi * np.cos(latitude))) < 1e-14


def test_points_in_earth_axes():
    got = ecef([0.0, np.pi / 2], [np.pi / 2, 0.3], [100.0, -5.0])
    expected = [[0.0, 6378237.0, 0.0], [0.0, 0.0, 6356752.314245 - 5.0]]
    np.testing.assert_allclose(got, expected, atol=1e-6)


@pytest.mark.parametrize(
    "where", [{}, {"latitude": 78 * DEGREE, "longitude": 179.9 * DEGREE, "azimuth": 1.4}]
)
def test_a_finer_simulation_lies_between_the_samples(where):
    coarse, fine = launch(200.0, 60.0, **where), launch(1000.0, 60.0, **where)
    rows = slice(3, None, 7)  # in every fifth of a sample interval
    got = moments(coarse, fine.time_ns[rows])
    r = ecef(fine.latitude, fine.longitude, fine.height)[rows]
    off = np.linalg.norm(ecef(got.latitude, got.longitude, got.height) - r, axis=1)
    speed = np.linalg.norm(got.velocity_n - fine.velocity_n[rows], axis=1)
    turn = rotation.multiply(rotation.conjugate(got.q_nb), fine.imu.q_nb[rows])
    turn = np.linalg.norm(rotation.log(turn), axis=1)
    rate = np.linalg.norm(got.omega_ib_b - fine.imu.gyro_rate[rows], axis=1)
    calm = got.time_ns > 40e9
    assert off.max() < 3e-8 and speed.max() < 1e-5 and turn.max() < 2e-7 and rate.max() < 1e-4
    assert speed[calm].max() < 2e-6 and turn[calm].max() < 1e-9 and rate[calm].max() < 1e-6


def test_instants_outside_are_refused(flight):
    for time_ns in (-1, int(flight.time_ns[-1]) + 1):
        with pytest.raises(ValueError, match="outside"):
            moments(flight, [5, time_ns])
    with pytest.raises(ValueError, match="shape"):
        moments(flight, [5], [0.0, 1.0])
