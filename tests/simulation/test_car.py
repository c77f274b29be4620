"""A simulated car: what its axle does, where the IMU is in it, its wheels and a ferry."""

import json

import numpy as np
import pytest

from sinstool.core import earth, rotation
from sinstool.simulation.car import Car, axle_motion
from sinstool.simulation.drive import road_drive
from sinstool.simulation.sensors import idling
from sinstool.simulation.wheels import WheelSensor, wheel_readings
from tests.helpers.imulogs import read_topic, stamp_ns

MOUNT = tuple(np.deg2rad([3.0, -60.0, 170.0]))


def driven(seconds=240.0, rate=100.0, **car):
    car = Car(**car)
    return road_drive(seconds, rate, still_s=10.0, seed=4, car=car), car


def seen_by_axle(seconds=240.0, **car):
    trajectory, car = driven(seconds, **car)
    axle = axle_motion(trajectory, car, trajectory.time_ns)
    speed_rate = np.gradient(axle.velocity_v[:, 0], 0.01)
    return axle, *axle.velocity_v.T, axle.rate_v[:, 2], speed_rate


@pytest.mark.parametrize("mount", [(0.0, 0.0, 0.0), MOUNT])
@pytest.mark.parametrize("lever", [0.0, 1.85, -0.7])
def test_an_axle_that_does_not_slip_goes_forward_only(mount, lever):
    _, forward, right, down, rate, _ = seen_by_axle(mount=mount, axle_lever=lever, suspension=0.0)
    assert forward.max() > 10.0 and np.abs(rate).max() > 0.15
    assert np.abs(right).max() < 1e-4
    assert np.abs(down).max() < 1e-4


def test_the_imu_ahead_of_the_axle_swings_out_in_turns():
    trajectory, car = driven(axle_lever=1.85, suspension=0.0)
    velocity_b = rotation.rotate(rotation.conjugate(trajectory.imu.q_nb), trajectory.velocity_n)
    at_axle = axle_motion(trajectory, car, trajectory.time_ns)
    swing = 1.85 * at_axle.rate_v[:, 2]
    assert np.abs(swing).max() > 0.3
    np.testing.assert_allclose(velocity_b[:, 1], swing, atol=2e-4)


def test_springs_leave_what_street_logs_show():
    _, forward, right, down, _, _ = seen_by_axle(axle_lever=1.85)
    moving = forward > 5.0
    assert 0.005 < np.sqrt(np.mean(down[moving] ** 2)) < 0.1
    assert np.sqrt(np.mean(right[moving] ** 2)) < 0.01


CARS = {
    "lever": {"axle_lever": 1.85},
    "slip": {"slip": 0.1, "sideslip": 0.005, "axle_lever": 1.0},
    "ferry": {"ferry": (120.0, 60.0), "axle_lever": 1.0},
    "mount": {"mount": MOUNT, "axle_lever": 1.0},
}


@pytest.mark.parametrize("kind", CARS)
def test_force_and_rate_are_those_of_the_motion(kind):
    trajectory, _ = driven(240.0, 200.0, **CARS[kind])
    t = trajectory
    moved = np.gradient(t.velocity_n, 0.005, axis=0)
    force_n = rotation.rotate(t.imu.q_nb, t.imu.specific_force)
    pull = earth.gravity_n(t.latitude, t.height) + force_n
    # Coriolis: 1.5e-4 rad/s and 17 m/s; differences: third derivative of heave and slip
    np.testing.assert_allclose(moved[1:-1], pull[1:-1], atol=0.02)
    turn = rotation.log(rotation.multiply(rotation.conjugate(t.imu.q_nb[:-1]), t.imu.q_nb[1:]))
    np.testing.assert_allclose(turn / 0.005, t.imu.gyro_mean_rate[1:], atol=2e-4)


def test_slip_outward_is_by_kappa():
    _, forward, right, down, rate, _ = seen_by_axle(sideslip=0.01, axle_lever=1.5, suspension=0.0)
    expected = -0.01 * forward**2 * rate
    assert np.abs(expected).max() > 0.03
    np.testing.assert_allclose(right, expected, atol=3e-3)
    assert np.abs(down).max() < 2e-3


@pytest.mark.slow
def test_slow_slip_has_its_size_and_time():
    _, forward, right, _, _, _ = seen_by_axle(1800.0, slip=0.1, slip_time=4.0, suspension=0.0)
    moving = forward > 8.0
    # weighed by V^2 / (V^2 + 4 m^2/s^2)
    slow = np.where(moving, right * (1.0 + 4.0 / np.maximum(forward, 1.0) ** 2), 0.0)
    both = moving[400:] & moving[:-400]
    assert np.std(slow[moving]) == pytest.approx(0.1, rel=0.2)
    alike = np.mean(slow[400:][both] * slow[:-400][both]) / np.var(slow[moving])
    assert alike == pytest.approx(np.exp(-1.0), abs=0.2)
    standing = forward < 1e-6
    assert standing.sum() > 1000
    assert np.abs(right[standing]).max() < 1e-6


def test_a_mount_turns_the_samples_and_not_the_vehicle():
    plain, _ = driven(100.0)
    turned, car = driven(100.0, mount=MOUNT)
    np.testing.assert_array_equal(turned.velocity_n, plain.velocity_n)
    q_vb = rotation.from_euler(MOUNT)
    for name in ("gyro_rate", "gyro_mean_rate", "gyro_increment", "specific_force"):
        back = rotation.rotate(q_vb, getattr(turned.imu, name))
        np.testing.assert_allclose(back, getattr(plain.imu, name), atol=1e-12)
    axle = axle_motion(turned, car, turned.time_ns)
    apart = rotation.log(rotation.multiply(rotation.conjugate(axle.q_nv), plain.imu.q_nb))
    assert np.abs(apart).max() < 1e-10
    # nose up by 60 degrees: forward of the level vehicle has a part upward in the IMU
    nose_up = rotation.rotate(rotation.from_euler(np.deg2rad([0.0, 60.0, 0.0])), [1.0, 0.0, 0.0])
    np.testing.assert_allclose(nose_up, [0.5, 0.0, -np.sqrt(0.75)], atol=1e-12)


def test_a_ferry_goes_sideways_while_wheels_rest():
    car = {"ferry": (150.0, 120.0), "axle_lever": 1.5}
    _, forward, right, down, _, _ = seen_by_axle(400.0, **car)
    aboard = slice(16000, 26000)
    assert np.all(np.abs(right[aboard] - 3.0) < 0.3)
    assert np.std(down[aboard]) > 0.1
    assert np.abs(forward[aboard]).max() < 0.2
    before, after = slice(0, 15000), slice(27000, 40000)
    for rows in (before, after):
        assert forward[rows].max() > 8.0
        assert np.abs(right[rows]).max() < 0.05
    trajectory, car = driven(400.0, **car)
    wheels = wheel_readings(trajectory, car, WheelSensor(), 0)
    seconds = (wheels.time_ns - wheels.time_ns[0]) * 1e-9
    assert np.all(wheels.speed[(seconds > 145.0) & (seconds < 270.0)] == 0.0)
    assert wheels.speed.max() > 10.0


def test_wheels_read_the_speed_of_the_axle_within_scale_latency_and_slip():
    trajectory, car = driven(axle_lever=1.5, mount=MOUNT)
    sensor = WheelSensor(scale=0.02, latency_s=0.13, slip=0.01, slipping="left")
    wheels = wheel_readings(trajectory, car, sensor, 0)
    valid = wheels.time_ns - 130_000_000
    np.testing.assert_array_equal(np.diff(valid), 50_000_000)
    axle = axle_motion(trajectory, car, valid)
    left, right = wheels.speed.T
    turn = axle.rate_v[:, 2]
    np.testing.assert_allclose(wheels.truth, axle.velocity_v[:, 0], atol=1e-6)
    np.testing.assert_allclose(right, 1.02 * (wheels.truth - 0.76 * turn), atol=2e-4)
    gain = np.gradient(wheels.truth, 0.05)
    over = np.sign(gain) * np.maximum(np.abs(gain) - 1.2, 0.0)
    assert over.max() > 0.5 and over.min() < -0.5
    expected = 1.02 * (wheels.truth + 0.76 * turn) * (1.0 + 0.01 * over)
    np.testing.assert_allclose(left, expected, atol=2e-4)
    assert np.abs(left - right - 2.0 * 1.02 * 0.76 * turn).max() > 0.03


def test_an_idling_engine_shakes_a_standing_car_and_little_below_five_hertz():
    trajectory, _ = driven()
    speed = np.linalg.norm(trajectory.velocity_n, axis=1)
    standing = speed == 0.0
    shaken = idling(trajectory.imu, standing, 0.6, 0.02, 3)
    for name, size in (("specific_force", 0.6), ("gyro_rate", 0.02)):
        added = getattr(shaken, name) - getattr(trajectory.imu, name)
        assert not added[~standing].any()
        first = added[:1000]
        assert np.sqrt(np.mean(np.sum(first**2, 1))) == pytest.approx(size, rel=0.05)
        slow = first.reshape(100, 10, 3).mean(axis=1)
        assert np.sqrt(np.mean(np.sum(slow**2, 1))) < 0.25 * size


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    from click.testing import CliRunner

    from sinstool.cli.main import cli

    def make(*options):
        log = tmp_path_factory.mktemp("drive") / "log.mcap"
        arguments = ["simulate", "drive", "-o", str(log), "--duration", "60", "--rate", "50"]
        run = CliRunner().invoke(cli, [*arguments, "--still", "5", "--json", *options])
        assert run.exit_code == 0, run.output
        return log, json.loads(run.stdout)

    return make


@pytest.mark.parametrize("kind", ["odometry", "twist", "joint"])
def test_wheels_of_each_kind_are_written(simulated, tmp_path, kind):
    log, written = simulated(
        "--wheels", kind, "--wheel-scale", "3", "--axle-lever", "1.5", "--mount", "0,10,90",
        "--report", str(tmp_path / "page.html"),
    )  # fmt: skip
    assert written["topics"]["/wheels"] == 1201
    assert "speeds of the wheels" in (tmp_path / "page.html").read_text()
    truth = read_topic(log, "/truth/vehicle")
    forward = {stamp_ns(m): m.twist.twist.linear.x for _, m in truth}
    worst = 0.0
    for _, m in read_topic(log, "/wheels"):
        t = stamp_ns(m)
        if kind == "joint":
            assert m.name == ["rear_left_wheel_joint", "rear_right_wheel_joint"]
            speed = 0.31 * np.mean(m.velocity)
        else:
            speed = (m.twist.twist if kind == "odometry" else m.twist).linear.x
        if t in forward:
            worst = max(worst, abs(speed - 1.03 * forward[t]))
    assert max(forward.values()) > 10.0
    assert worst < 1e-3


def test_a_plain_drive_says_nothing_of_a_car(simulated):
    _, written = simulated()
    assert "/truth/vehicle" not in written["topics"]
    assert not {"mount", "wheels", "suspension", "idle"} & set(written["settings"])


def test_regular_outages(simulated):
    log, _ = simulated("--outages", "8,20", "--gnss-rate", "4")
    times = np.array([stamp_ns(m) for _, m in read_topic(log, "/gnss/fix")])
    seconds = (times - times[0]) * 1e-9
    begins = seconds[:-1][np.diff(seconds) > 5.0]
    np.testing.assert_allclose(begins, [19.75, 39.75])
    assert np.sort(np.diff(seconds))[-2:] == pytest.approx([8.25, 8.25])


@pytest.mark.parametrize(
    "options", [("--ferry", "10,5"), ("--idle", "-1,0"), ("--outages", "0,5"), ("--mount", "1,2")]
)
def test_impossible_cars_are_refused(sinstool, tmp_path, options):
    status, _, err = sinstool("simulate", "drive", "-o", tmp_path / "log.mcap", *options)
    assert status == 2
    assert options[0].strip("-") in err
