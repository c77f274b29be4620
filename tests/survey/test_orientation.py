"""Orientations of a log are compared with its own gravity and gyro, at rest and in motion."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.config import InputOptions, ProcessConfig
from sinstool.config.load import build
from sinstool.core.errors import AlignmentError
from sinstool.core.rotation import exp, from_dcm, from_euler
from sinstool.io.readers import open_log
from sinstool.io.readers.topics import choose_imu
from sinstool.methods.alignment.still import WINDOW_NS
from sinstool.pipelines.process.run import plan_of
from sinstool.survey.orientation import orientation_fault
from sinstool.survey.source import survey_samples
from tests.helpers.imulogs import T0, even_times, handheld, imu_log, in_log_axes
from tests.helpers.quick import mostly_slow
from tests.helpers.unseen_drives import RATE, drive, flight, multicopter, walk
from tests.helpers.unseen_vehicles import VEHICLES
from tests.survey.test_course import windows

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


@pytest.mark.parametrize(
    ("order", "heading"), [([3, 0, 1, 2], 180.0), ([0, 3, 1, 2], 180.0), ([1, 2, 3, 0], 0.0)]
)
@pytest.mark.parametrize("seed", mostly_slow([1, 2, 3], 1))
def test_numbers_in_another_order_show_once_the_vehicle_has_turned(tmp_path, seed, order, heading):
    """On one heading they are those of a level body that goes somewhere else."""
    random, rate = np.random.default_rng(seed), 50.0
    t = np.arange(0.0, 150.0, 1.0 / rate)
    turn = np.where((t > 60.0) & (t < 75.0), np.radians(6.0), 0.0)
    yaw = np.radians(heading) + np.cumsum(turn) / rate + 0.02 * np.sin(t)
    attitude = Rotation.from_euler("z", yaw[:, None])
    noise = random.standard_normal((2, len(t), 3)) * [[[2e-3]], [[0.3]]]
    gyro = np.stack([0.0 * t, 0.0 * t, turn + 0.02 * np.cos(t)], axis=1) + noise[0]
    accel = np.array([0.0, 0.0, 9.81]) + noise[1]
    times = even_times(len(t), rate)
    right = imu_log(tmp_path / "r.mcap", times, gyro, accel, q_xyzw=attitude.as_quat(),
                    covariance=0.0)  # fmt: skip
    assert surveyed(right).orientation_fault is None
    q = attitude.as_quat()[:, order]
    wrong = imu_log(tmp_path / "w.mcap", times, gyro, accel, q_xyzw=q, covariance=0.0)
    result = surveyed(wrong)
    assert result.orientation_fault is not None and not result.oriented
    assert "order" in result.orientation_fault.text


@pytest.mark.parametrize("vehicle", [flight, walk, multicopter, *VEHICLES.values()])
@pytest.mark.slow
def test_right_orientations_agree_whatever_the_vehicle_does(vehicle):
    """A glider that circles looked tilted, and what shakes seemed to turn differently."""
    for seed in range(5):
        truth = vehicle(seed, 320.0)
        seen = windows(truth)
        begins = np.searchsorted(truth.seconds, (seen.start_ns - T0) * 1e-9 - 1e-6)
        numbers = ((seen.start_ns - seen.start_ns[0]) // WINDOW_NS).tolist()
        q_nb = dict(zip(numbers, from_dcm(truth.c_nb[begins]), strict=True))
        assert orientation_fault(q_nb, int(seen.start_ns[0]), seen) is None, seed


def test_a_banked_turn_is_no_tilt():
    """Of 24 deg, in which the specific force is all but of gravity's size, and half a circle."""
    assert fault_of(roll=0.0, banked=24.0) is None


def fault_of(*, roll=0.0, sense=1.0, rate=0.4, count=20, every=1, banked=0.0):
    """Fault of the orientations of a level body that yaws to and fro, rad/s, window by window.

    They are rolled by so many deg, and turn by `sense` times as much; of `every` windows one has
    an orientation. A body that is banked, deg, feels its own down.
    """
    rates = rate * np.sin(0.6 * np.arange(count))
    yaw = sense * np.cumsum(np.append(0.0, 0.5 * rates[:-1]))
    angles = np.stack([np.full(count, np.radians(roll + banked)), np.zeros(count), yaw], axis=1)
    zero = np.zeros(count)
    gyro = np.stack([zero, zero, rates], axis=1)
    accel = np.tile([0.0, 0.0, -9.8 / np.cos(np.radians(banked))], (count, 1))
    seen = SimpleNamespace(
        start_ns=T0 + WINDOW_NS * np.arange(count),
        gyro=gyro,
        accel=accel,
        force=accel[None],
        turn=exp(0.5 * gyro)[None],
    )
    return orientation_fault(dict(list(enumerate(from_euler(angles)))[::every]), T0, seen)


def test_the_tilt_of_wrong_orientations_is_reported():
    assert fault_of(roll=40.0).tilt_deg == pytest.approx(40.0, abs=4.0)
    assert fault_of(roll=15.0) is None  # an error of attitude, not of axes


def test_turns_of_another_sense_or_size_are_a_fault():
    assert fault_of() is None and fault_of(sense=0.5) is None
    for sense in (-1.0, 0.0, 6.0):
        assert "turns differently from the gyro" in fault_of(sense=sense).text


@pytest.mark.parametrize(
    "few",
    [{"rate": 0.05}, {"rate": 20.0}, {"count": 6}, {"every": 2}],
    ids=["small turns", "turns that may be ambiguous", "few windows", "windows apart"],
)
def test_turns_that_show_too_little_are_no_fault(few):
    assert fault_of(sense=-1.0, count=7) is not None
    assert fault_of(sense=-1.0, **few) is None
