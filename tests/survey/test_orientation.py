"""Orientations of a log are held against its own gravity and gyro, at rest and in motion."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.config import InputOptions, ProcessConfig
from sinstool.config.load import build
from sinstool.core.errors import AlignmentError
from sinstool.io.readers import open_log
from sinstool.io.readers.topics import choose_imu
from sinstool.pipelines.process.run import plan_of
from sinstool.survey.source import survey_samples
from tests.helpers.imulogs import T0, even_times, handheld, imu_log, in_log_axes
from tests.helpers.unseen_drives import RATE, drive

N, HAND_RATE = 3000, 100.0

ORDERS = {
    "w first": [3, 0, 1, 2],
    "w second": [0, 3, 1, 2],
    "reversed": [3, 2, 1, 0],
    "x and y exchanged": [1, 0, 2, 3],
}


def surveyed(path):
    with open_log(path) as log:
        return survey_samples(log, choose_imu(log, None), InputOptions())[0]


def in_the_hand(path, seed, size, order=(0, 1, 2, 3), heading=0.0, bias=0.0):
    """A log of a hand that moves from the first sample on."""
    gyro, accel, attitude = handheld(N, rate=HAND_RATE, seed=seed, size=size)
    q = (Rotation.from_euler("z", heading, degrees=True) * attitude).as_quat()[:, list(order)]
    times = even_times(N, HAND_RATE)
    return imu_log(path, times, gyro + np.radians(bias), accel, q_xyzw=q, covariance=0.0)


@pytest.mark.parametrize("size", [0.1, 0.5, 2.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_right_orientations_agree_whatever_heading_and_gyro_bias(tmp_path, seed, size):
    log = in_the_hand(tmp_path / "a.mcap", seed, size, heading=137.0, bias=4.4)
    assert surveyed(log).orientation_fault is None


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_numbers_in_another_order_are_found_in_motion(tmp_path, seed, order):
    log = in_the_hand(tmp_path / "a.mcap", seed, 0.5, ORDERS[order], heading=137.0)
    result = surveyed(log)
    assert result.orientation_fault is not None and not result.oriented
    assert "order" in result.orientation_fault.text


@pytest.fixture(scope="module")
def on_the_road():
    """Rates, forces and attitudes (flu in enu) of a car that moves from the first sample on."""
    truth = drive(21, 60.0, rest=0.0)
    rows = slice(round(12.0 * RATE), None)
    flip = RATE * np.array([1.0, -1.0, -1.0])
    attitude = in_log_axes(Rotation.from_matrix(truth.c_nb[rows]).as_quat(scalar_first=True))
    times = T0 + np.round(truth.seconds[rows] * 1e9).astype(np.int64)
    return times, truth.gyro[rows] * flip, truth.accel[rows] * flip, attitude.as_quat()


def test_a_wrong_orientation_of_a_moving_car_is_no_first_attitude(tmp_path, on_the_road):
    times, gyro, accel, q = on_the_road
    noise = np.random.default_rng(3).standard_normal((2, *gyro.shape)) * [[[2e-3]], [[0.02]]]
    columns = times, gyro + noise[0], accel + noise[1]
    right = imu_log(tmp_path / "right.mcap", *columns, q_xyzw=q, covariance=0.0)
    assert plan_of(right, ProcessConfig()).first_attitude.value == "log"
    wrong = imu_log(tmp_path / "wrong.mcap", *columns, q_xyzw=q[:, [3, 0, 1, 2]], covariance=0.0)
    assert plan_of(wrong, ProcessConfig()).first_attitude.value == "level-moving"
    with pytest.raises(AlignmentError, match=r"/imu is tilted by .* another order") as refused:
        plan_of(wrong, build(ProcessConfig, {"align": {"align": "log"}}))
    assert "--align fixed" in str(refused.value)
