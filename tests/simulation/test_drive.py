import numpy as np
import pytest

from sinstool.core import earth, rotation
from sinstool.simulation.drive import road_drive


@pytest.fixture(scope="module")
def drive():
    return road_drive(900.0, 100.0, latitude=-0.65, longitude=-1.2, height=200.0, seed=4)


def test_still_at_first(drive):
    still = slice(0, 6000)
    imu = drive.imu
    np.testing.assert_array_equal(drive.velocity_n[still], 0.0)
    np.testing.assert_allclose(drive.latitude[still], -0.65, atol=1e-15)
    np.testing.assert_array_equal(drive.height[still], 200.0)
    q_bn = rotation.conjugate(imu.q_nb[still])
    rate, force = earth.earth_rate_n(-0.65), -earth.gravity_n(-0.65, 200.0)
    for gyro in (imu.gyro_rate, imu.gyro_mean_rate):
        np.testing.assert_allclose(gyro[still], rotation.rotate(q_bn, rate), atol=1e-17)
    for accel in (imu.specific_force, imu.mean_specific_force):
        np.testing.assert_allclose(accel[still], rotation.rotate(q_bn, force), atol=1e-13)
    assert np.linalg.norm(drive.velocity_n[6500]) > 1.0


def test_stops_turns_and_hills(drive):
    speed = np.linalg.norm(drive.velocity_n, axis=1)
    assert 11.0 < speed.max() < 17.5
    stopped = speed == 0.0
    begins = np.flatnonzero(np.diff(stopped.astype(int)) == 1)
    assert len(begins) >= 4
    for begin in begins[:-1]:
        length = np.argmin(stopped[begin + 1 :])
        assert 450 <= length <= 2100
    _, pitch, heading = rotation.to_euler(drive.imu.q_nb).T
    assert np.ptp(np.unwrap(heading)) > np.pi
    assert np.rad2deg(np.ptp(pitch)) > 4.0
    assert np.ptp(drive.height) > 20.0
    # along its own axis, but for what the suspension does
    course = np.arctan2(drive.velocity_n[:, 1], drive.velocity_n[:, 0])
    slip = np.remainder(course - heading + np.pi, 2.0 * np.pi) - np.pi
    assert np.abs(slip[speed > 1.0]).max() < 0.005


def test_suspension_moves_at_two_to_four_hertz(drive):
    pitch_rate = drive.imu.gyro_rate[:, 1]
    fast = np.linalg.norm(drive.velocity_n, axis=1) > 10.0
    spectrum = np.abs(np.fft.rfft(pitch_rate * fast)) ** 2
    frequency = np.fft.rfftfreq(len(pitch_rate), 0.01)
    band = spectrum[(frequency > 1.8) & (frequency < 4.2)].sum()
    assert band > 0.8 * spectrum[frequency > 1.0].sum()
    heave = np.std(drive.imu.specific_force[fast, 2])
    assert 0.2 < heave < 2.0


def test_lateral_force_is_that_of_turns(drive):
    rate = drive.imu.gyro_rate[:, 2]
    speed = np.linalg.norm(drive.velocity_n, axis=1)
    roll = rotation.to_euler(drive.imu.q_nb)[:, 0]
    turning = np.abs(rate) > 0.15
    lateral = drive.imu.specific_force[turning, 1]
    expected = (speed * rate)[turning] - 9.8 * np.sin(roll[turning])
    assert np.abs(lateral - expected).max() < 0.25
    assert np.abs(expected).max() > 1.0


def test_seeds_differ_and_repeat():
    first = road_drive(100.0, 20.0, seed=1)
    again = road_drive(100.0, 20.0, seed=1)
    other = road_drive(100.0, 20.0, seed=2)
    np.testing.assert_array_equal(first.imu.gyro_rate, again.imu.gyro_rate)
    assert np.abs(first.velocity_n - other.velocity_n).max() > 1.0
