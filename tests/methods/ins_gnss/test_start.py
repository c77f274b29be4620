"""Starts of simulated drives and flights against where the vehicle was."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from sinstool.core.errors import AlignmentError
from sinstool.core.rotation import conjugate, from_euler, log, multiply, rotate
from sinstool.methods.alignment.inflight import ImuIncrements
from sinstool.methods.ins_gnss.noise import IMU_GRADES, GnssModel
from sinstool.methods.ins_gnss.settings import for_grade
from sinstool.methods.ins_gnss.start import carried_back, find_start, start_at
from sinstool.simulation.drive import road_drive
from sinstool.simulation.flight import manoeuvring_flight
from sinstool.simulation.gnss import GnssErrors, Receiver, gnss_samples
from sinstool.simulation.interpolation import moments
from sinstool.simulation.sensors import GRADES, with_errors
from tests.helpers.gnss import epochs

LEVER = (0.8, -0.4, -1.1)
SHARP = GnssErrors((0.5, 0.5, 0.8), (0.0,) * 3, 100.0, (0.05, 0.05, 0.08))
MODEL = GnssModel((0.5, 0.5, 0.8), (0.0,) * 3, 100.0, (0.05, 0.05, 0.08), (0.0,) * 3, 100.0)


def increments(imu, mount=(1.0, 0.0, 0.0, 0.0)):
    """As a sensor feels it whose axes are turned by `mount` against the vehicle's."""
    theta = rotate(mount, imu.gyro_increment)
    velocity = rotate(mount, imu.mean_specific_force * imu.interval[:, None])
    return ImuIncrements(imu.time_ns, theta, velocity)


@functools.cache
def drive(duration=110.0, still=30.0, seed=2):
    return road_drive(duration, 100.0, heading=2.3, still_s=still, seed=seed)


def psi(q_found, q_true):
    return log(multiply(q_true, conjugate(q_found)))


@pytest.mark.parametrize("latency", [0.0, 0.13])
def test_position_and_velocity_of_the_imu_between_two_fixes(latency):
    flight = manoeuvring_flight(60.0, 100.0, latitude=-0.6, longitude=2.8, heading=1.0, seed=3)
    receiver = Receiver(10.0, 0.033, latency, LEVER, GnssErrors())
    gnss = epochs(gnss_samples(flight, receiver, 1))
    settings = for_grade("mems", lever_arm_b=LEVER, gnss_latency=latency)
    for row in (2000, 2507, 4003):
        truth = moments(flight, flight.time_ns[row : row + 1])
        earth_rate = 7.3e-5
        start = start_at(
            int(flight.time_ns[row]),
            truth.q_nb[0],
            np.diag([1e-4, 2e-4, 9e-4]),
            gnss,
            settings,
            omega_eb_b=truth.omega_ib_b[0],
        )
        # What is left is the bend of the way within 0.1 s, and the Earth's turn of the lever arm
        bend = 10.0 * 0.1**2 / 8.0
        assert abs(start.nav[0] - truth.latitude[0]) * 6.37e6 < bend + 0.08
        assert abs(start.nav[1] - truth.longitude[0]) * 5.3e6 < bend + 0.08
        assert abs(start.nav[2] - truth.height[0]) < bend + 0.08
        limit = 2e-2 + 2.0 * earth_rate
        np.testing.assert_allclose(start.nav[3:6], truth.velocity_n[0], atol=limit)
        np.testing.assert_allclose(start.nav[6:], truth.q_nb[0], atol=1e-12)
        # Noise of the model, white and slow, and more where the lever arm may have turned
        sigma = np.sqrt(np.diag(start.covariance_position_n))
        model = np.hypot(settings.gnss.position_white, settings.gnss.position_markov)
        assert np.all(sigma >= model)
        np.testing.assert_allclose(sigma, model, rtol=0.01)
        turned = start.covariance_position_n - np.diag(model**2)
        assert np.trace(turned) > 1e-4 * np.dot(LEVER, LEVER)


def test_a_lever_arm_left_out_is_seen():
    flight = manoeuvring_flight(30.0, 100.0, seed=3)
    gnss = epochs(
        gnss_samples(flight, Receiver(10.0, 0.0, 0.0, LEVER, GnssErrors()), 1), own_sigma=True
    )
    truth = moments(flight, flight.time_ns[2000:2001])
    at = (int(truth.time_ns[0]), truth.q_nb[0], 1e-6 * np.eye(3), gnss)
    near = start_at(*at, for_grade("mems", lever_arm_b=LEVER))
    far = start_at(*at, for_grade("mems"))
    assert abs(near.nav[2] - truth.height[0]) < 0.02
    assert abs(far.nav[2] - truth.height[0]) > 0.3


def test_far_from_any_fix_there_is_no_start():
    flight = drive()
    gnss = epochs(gnss_samples(flight, Receiver(2.0, 20.0, errors=SHARP), 1), own_sigma=True)
    with pytest.raises(AlignmentError, match="within 2 s"):
        start_at(int(1e10), [1.0, 0.0, 0.0, 0.0], np.eye(3), gnss, for_grade("mems"))


@pytest.mark.parametrize(
    ("mount", "seed"),
    [((0.0, 0.0, 0.0), 1), ((170.0, 60.0, -20.0), 2), ((-90.0, 5.0, 135.0), 3)],
)
def test_a_road_start_however_the_sensor_is_mounted(mount, seed):
    truth = drive(seed=seed)
    q_mount = from_euler(np.deg2rad(mount))
    # Half a degree per second of bias, as of a consumer's gyro
    sensors = with_errors(truth.imu, replace(GRADES["mems"], gyro_bias=5e-3), seed)
    imu = increments(sensors, q_mount)
    gnss = epochs(gnss_samples(truth, Receiver(4.0, 2.1, 0.0, errors=SHARP), seed), own_sigma=True)
    settings = for_grade("mems", gnss=MODEL)
    found = find_start(imu, gnss, settings)
    # It begins with GNSS, though heading is known only from the motion half a minute later
    assert abs(found.time_ns - gnss.time_ns[0]) <= 10_000_000
    row = int(np.searchsorted(truth.time_ns, found.time_ns))
    q_true = multiply(truth.imu.q_nb[row], conjugate(q_mount))
    error = psi(found.start.nav[6:], q_true)
    covariance = found.start.covariance_attitude_n
    assert np.rad2deg(np.sqrt(covariance[2, 2])) < 4.0
    assert error @ np.linalg.solve(covariance, error) < 14.2  # 99.7 % of three
    bias = rotate(q_mount, (sensors.gyro_increment - truth.imu.gyro_increment).mean(axis=0) * 100.0)
    assert np.abs(found.start.gyro_bias - bias).max() < 3.0 * found.start.gyro_bias_sigma
    assert found.start.gyro_bias_sigma < np.deg2rad(0.02)
    assert "rest" in found.how


def test_carried_back_through_turns():
    flight = manoeuvring_flight(100.0, 100.0, latitude=-0.6, heading=1.0, seed=3)
    imu = flight.imu
    part = slice(1001, 9001)
    found = carried_back(
        imu.q_nb[9000], imu.gyro_increment[part], imu.interval[part], float(flight.latitude[0])
    )
    # The transport rate is left out: 60 m/s over the Earth's radius for 80 s
    assert np.abs(psi(found, imu.q_nb[1000])).max() < 80.0 * 70.0 / 6.37e6
    assert np.abs(psi(imu.q_nb[9000], imu.q_nb[1000])).max() > 0.1
    np.testing.assert_array_equal(
        carried_back(imu.q_nb[5], np.empty((0, 3)), np.empty(0), 0.3), imu.q_nb[5]
    )


def test_without_rest_in_a_flight():
    flight = manoeuvring_flight(120.0, 100.0, latitude=0.5, heading=-2.0, seed=4)
    imu = increments(with_errors(flight.imu, GRADES["mems"], 5))
    gnss = epochs(
        gnss_samples(flight, Receiver(5.0, errors=SHARP, lever_arm_b=LEVER), 6), own_sigma=True
    )
    settings = for_grade("mems", gnss=MODEL, lever_arm_b=LEVER)
    found = find_start(imu, gnss, settings)
    row = int(np.searchsorted(flight.time_ns, found.time_ns))
    error = psi(found.start.nav[6:], flight.imu.q_nb[row])
    covariance = found.start.covariance_attitude_n
    assert error @ np.linalg.solve(covariance, error) < 14.2
    assert np.rad2deg(np.sqrt(covariance[2, 2])) < 5.0
    assert row * 0.01 < 100.0
    assert 0.0 < found.start.gyro_bias_sigma <= IMU_GRADES["mems"].gyro_bias


def test_where_nothing_tells_the_heading_it_says_so():
    standing = road_drive(60.0, 100.0, still_s=100.0)
    gnss = epochs(gnss_samples(standing, Receiver(4.0, errors=SHARP), 1), own_sigma=True)
    imu = increments(with_errors(standing.imu, GRADES["mems"], 1))
    with pytest.raises(AlignmentError, match="heading"):
        find_start(imu, gnss, for_grade("mems", gnss=MODEL))
    silent = replace(gnss, velocity_n=np.full_like(gnss.velocity_n, np.nan))
    with pytest.raises(AlignmentError, match="position and velocity"):
        find_start(imu, silent, for_grade("mems", gnss=MODEL))
