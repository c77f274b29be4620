"""Sigmas of attitude where the log leaves something open: how it moves, and what a sample is."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.core.units import DEGREE
from sinstool.methods.sensor_errors import IMU_GRADES
from tests.helpers import unseen_drives
from tests.helpers.imulogs import G, even_times, imu_log
from tests.helpers.unseen_vehicles import glider, motorcycle
from tests.pipelines.process.test_smoothing import RATE, Hand, hand, run, smoothed, written

FLU = np.diag([1.0, -1.0, -1.0])
ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def over_sigma(off, covariance):
    """Root mean square of errors of tilt over their sigmas."""
    sigma = np.sqrt(np.einsum("nii->ni", covariance))[:, :2]
    return float(np.sqrt(np.mean((off / sigma) ** 2)))


def without_rest(motion, seed, first_s=0.0, warms=0.0):
    """The motion from then on, as low-cost sensors with biases measure it.

    Those of the gyros end within 5 minutes by `warms`, rad/s, as they warm up.
    """
    random = np.random.default_rng(seed)
    each, first = round(unseen_drives.RATE / RATE), round(first_s * unseen_drives.RATE)
    count = (len(motion.seconds) - first) // each
    last = first + count * each
    gyro, accel = (
        values[first:last].reshape(count, each, 3).mean(axis=1) @ FLU * unseen_drives.RATE
        for values in (motion.gyro, motion.accel)
    )
    gyro = gyro + 5e-3 * random.standard_normal(3) + 2e-3 * random.standard_normal(gyro.shape)
    accel = accel + 0.03 * random.standard_normal(3) + 0.03 * random.standard_normal(accel.shape)
    cold = np.exp(-np.arange(count) / RATE / 300.0)
    gyro = gyro + warms * cold[:, None] * random.standard_normal(3)
    attitude = Rotation.from_matrix(ENU @ motion.c_nb[first + each - 1 : last : each] @ FLU)
    return Hand(even_times(count, RATE), gyro, accel, attitude)


@pytest.mark.parametrize("seed", [1, 4, 5, 9])
def test_circling_and_level_travel_with_a_large_bias_are_both_allowed_for(tmp_path, seed):
    """Forty seconds of circling in gusts and a wind, and no rest: 28 deg off, by 4 sigmas."""
    summary, off, covariance = smoothed(tmp_path, without_rest(glider(seed, 40.0), seed))
    assert summary["smoothing"]["motion"] == "vehicle"
    assert 0.5 < over_sigma(off, covariance) < 2.0


@pytest.mark.parametrize("seed", [2, 10])
def test_forty_seconds_show_that_a_motorcycle_goes_where_it_points(tmp_path, seed):
    """It was 1.6 and 5.8 deg off while its velocity was taken to keep its direction."""
    log = without_rest(motorcycle(seed, 100.0), seed, 60.0)
    summary, off, covariance = smoothed(tmp_path, log)
    assert summary["smoothing"]["motion"] == "vehicle"
    assert np.degrees(np.sqrt(np.mean(off**2))) < 1.2
    assert over_sigma(off, covariance) < 1.0


@pytest.mark.slow
def test_gyros_that_warm_up_by_a_third_of_a_degree_per_second(tmp_path):
    """A drive with one rest, at its start, was 3.6 deg off, by 4.6 of its own sigmas."""
    log = without_rest(unseen_drives.drive(5, 180.0, rest=15.0), 5, warms=0.3 * DEGREE)
    _, off, covariance = smoothed(tmp_path, log)
    assert over_sigma(off, covariance) < 2.0


def test_a_motorcycle_that_is_called_a_hand_is_not_to_be_trusted(tmp_path):
    """Six degrees off at a stated one, with status 0."""
    log = without_rest(motorcycle(2, 100.0), 2, 60.0)
    summary, _, _ = smoothed(tmp_path, log, navigation={"motion": "hand"})
    denied = {f["kind"]: f for f in summary["findings"]}["motion-denied"]
    assert denied["severity"] == "lost" and denied["numbers"]["margin_nat"] > 2.0


def shaken(rate=25.0, seconds=60.0, seed=0):
    """A hand that shakes after a rest, its rates and forces those at the stamps."""
    random = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate
    frequency, phase = random.uniform(1.0, 3.0, (2, 3)), random.uniform(0.0, 2.0 * np.pi, (2, 3))

    def attitude(t):
        size = 0.1 * np.clip((t - 10.0) / 5.0, 0.0, 1.0)[:, None]
        waves = np.sin(2.0 * np.pi * frequency * t[:, None, None] + phase)
        return Rotation.from_euler("xyz", size * waves.sum(axis=1))

    step = 1e-4
    gyro = (attitude(t - step).inv() * attitude(t + step)).as_rotvec() / (2.0 * step)
    gyro += 2e-4 * random.standard_normal(gyro.shape)
    accel = attitude(t).inv().apply([0.0, 0.0, G]) + 0.01 * random.standard_normal(gyro.shape)
    return Hand(even_times(len(t), rate), gyro, accel, attitude(t))


@pytest.mark.parametrize("seed", range(3))
def test_whether_a_sample_is_a_mean_or_a_rate_is_in_the_sigma(tmp_path, seed):
    """Half a sample at 25 Hz and 2 rad/s is 2 deg; who knows it is no less certain for it."""
    log = shaken(seed=seed)
    _, off, covariance = smoothed(tmp_path, log)
    assert 0.5 < over_sigma(off, covariance) < 1.6
    known = {"input": {"gyro_kind": "rate"}, "output": {"overwrite": True}}
    _, better, surer = smoothed(tmp_path, log, **known)
    assert np.sqrt(np.mean(better**2)) < 0.6 * np.sqrt(np.mean(off**2))
    moving = slice(len(off) // 3, None)
    before, after = (np.median(np.trace(c[moving], axis1=1, axis2=2)) for c in (covariance, surer))
    assert after < 0.8 * before


@pytest.mark.slow
@pytest.mark.parametrize(("scale", "bias"), [(5e-3, 0.0), (1e-2, 0.03)])
@pytest.mark.parametrize("seed", range(4))
def test_a_heading_that_turns_on_and_on_is_off_in_proportion(tmp_path, seed, scale, bias):
    """A tilted sensor on a carousel, of gyros with constant errors of scale: it turns, and back.

    Those of a bare chip are larger, as its bias is.
    """
    random = np.random.default_rng(seed)
    n = 120 * round(RATE)
    t = np.arange(n) / RATE
    rate = 0.9 * np.clip((t - 10.0) / 5.0, 0.0, 1.0) * np.clip((65.0 - t) / 5.0, -1.0, 1.0)
    rate *= np.clip((115.0 - t) / 5.0, 0.0, 1.0)
    angle = np.cumsum(rate) / RATE
    mount = Rotation.random(random_state=seed)
    turn = np.zeros((n, 3))
    turn[:, 2] = angle
    attitude = Rotation.from_rotvec(turn) * mount
    down = mount.inv().apply([0.0, 0.0, 1.0])
    errors = np.diag(scale * random.standard_normal(3))
    gyro = np.outer(rate, down) @ (np.eye(3) + errors) + 1e-3 * random.standard_normal((n, 3))
    gyro += bias * random.choice([-1.0, 1.0], 3)
    accel = G * down + 0.02 * random.standard_normal((n, 3))
    run(imu_log(tmp_path / "in.mcap", even_times(n, RATE), gyro, accel), tmp_path / "out.mcap")
    times, q, covariance = written(tmp_path / "out.mcap")
    at = np.searchsorted(even_times(n, RATE), times)
    turned = (q * attitude[at].inv()).as_matrix()
    heading = np.unwrap(np.arctan2(turned[:, 1, 0], turned[:, 0, 0]))
    heading -= heading[0]
    sigma = np.sqrt(covariance[:, 2, 2])
    middle, last = np.searchsorted(at, round(65.0 * RATE)), -1
    assert np.degrees(sigma[middle]) > (20.0 if bias else 5.0)  # after 48 rad
    assert np.abs(heading[middle]) < 3.0 * sigma[middle]
    assert np.abs(heading[last]) < 3.0 * sigma[last]
    assert bias or np.degrees(sigma[last]) < 3.0


@pytest.mark.parametrize("seed", range(6))
def test_a_telephone_on_a_table(tmp_path, seed):
    """Its gyros' bias was taken off, its accelerometers' was not: gravity is not as large as it is.

    The tilt was off by 4 sigmas and more.
    """
    random = np.random.default_rng(seed)
    n = 40 * round(RATE)
    offset = np.append(0.2 * random.choice([-1.0, 1.0], 2), random.choice([-0.12, 0.12]))
    mount = Rotation.from_rotvec(0.2 * random.standard_normal(3))
    up = mount.inv().apply([0.0, 0.0, 1.0])
    gyro = 1e-3 * random.standard_normal((n, 3))
    accel = G * up + mount.inv().apply(offset) + 0.02 * random.standard_normal((n, 3))
    log = Hand(even_times(n, RATE), gyro, accel, Rotation.concatenate([mount] * n))
    _, off, covariance = smoothed(tmp_path, log)
    assert np.degrees(np.abs(off)).max() > 1.0
    assert over_sigma(off, covariance) < 2.5


def test_a_calibration_of_some_time_ago(tmp_path):
    """At rest, accelerometers have the bias of their grade, 10 mg: tilts were off by 2.5 sigmas."""
    n, ratios = 20 * round(RATE), []
    for seed in range(10):
        random = np.random.default_rng(seed)
        mount = Rotation.random(rng=random)
        bias = IMU_GRADES["mems"].accel_bias * random.standard_normal(3)
        accel = mount.inv().apply([0.0, 0.0, G]) + bias + 0.02 * random.standard_normal((n, 3))
        gyro = 1e-3 * random.standard_normal((n, 3))
        log = Hand(even_times(n, RATE), gyro, accel, Rotation.concatenate([mount] * n))
        _, off, covariance = smoothed(tmp_path, log, output={"overwrite": True})
        ratios.append(over_sigma(off, covariance))
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.6


@pytest.mark.parametrize("seed", range(3))
def test_an_attitude_from_a_force_that_is_not_gravity_is_not_to_be_trusted(tmp_path, seed):
    """Shaken to their stops, accelerometers read half of gravity: 67 deg off, with status 0."""
    log = hand(seed=seed, rest=(0.0, 0.0))
    log = replace(log, accel=0.45 * log.accel)
    summary, _, _ = smoothed(tmp_path, log)
    assert summary["plan"]["attitude"]["value"] == "inertial"
    found = {f["kind"]: f for f in summary["findings"]}
    assert found["gravity-unused"]["severity"] == "lost"
    assert "may be wrong by any angle" in found["gravity-unused"]["text"]
    # whoever asks for it, or gives the first attitude, knows
    for groups, kind in (
        ({"navigation": {"attitude": "inertial"}}, None),
        ({"align": {"align": "fixed", "initial_attitude": (0.0, 0.0, 0.0)}}, "warning"),
    ):
        summary = run(tmp_path / "in.mcap", tmp_path / f"{kind}.mcap", **groups)
        found = {f["kind"]: f["severity"] for f in summary["findings"]}
        assert found.get("gravity-unused") == kind


def hanging(seed, swing, rest_s=0.0):
    """A load on a rope of 16 m, which swings by so many rad as soon as it has rested.

    Specific force is along the rope always: to accelerometers all of it is rest.
    """
    random = np.random.default_rng(seed)
    n = 240 * round(RATE)
    t = np.arange(n) / RATE
    swings = np.clip((t - rest_s) / 10.0, 0.0, 1.0) if rest_s else np.ones(n)
    angle = swing * swings * np.sin(np.sqrt(G / 16.0) * t + random.uniform(0.0, 6.0))
    gyro = np.gradient(angle, 1.0 / RATE)[:, None] * [1.0, 0.0, 0.0]
    accel = G * np.stack([0.0 * t, 0.0 * t, 1.0 + 0.0 * t], axis=1)
    gyro += 1e-3 * random.standard_normal(3) + 1.5e-3 * random.standard_normal(gyro.shape)
    accel += 0.03 * random.standard_normal(3) + 0.02 * random.standard_normal(accel.shape)
    return Hand(
        even_times(n, RATE), gyro, accel, Rotation.from_rotvec(angle[:, None] * [1.0, 0.0, 0.0])
    )


@pytest.mark.slow
@pytest.mark.parametrize("swing", [0.03, 0.06])
@pytest.mark.parametrize("seed", range(6))
def test_a_load_that_swings_all_the_time_never_rests(tmp_path, seed, swing):
    """Two seconds about its largest rate were taken for rests: 54 deg off, by 20 sigmas."""
    summary, off, covariance = smoothed(tmp_path, hanging(seed, swing))
    assert summary["smoothing"]["rest_s"] == 0.0
    assert np.degrees(off.max()) < 2.0 and over_sigma(off, covariance) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_one_that_hung_still_before_shows_its_bias_there(tmp_path, seed):
    _, off, covariance = smoothed(tmp_path, hanging(seed, 0.03, rest_s=15.0))
    assert np.degrees(off.max()) < 2.0
    assert np.degrees(np.sqrt(covariance[-1, 2, 2])) < 45.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_short_stops_of_a_hand_are_rests(tmp_path, seed):
    """Three seconds each, and nothing longer."""
    random = np.random.default_rng(seed)
    n = 120 * round(RATE)
    t = np.arange(n) / RATE
    goes = np.clip(np.abs(t % 12.0 - 6.0) - 1.5, 0.0, 1.0)[:, None]
    angles = np.cumsum(goes * np.sin(t[:, None] * random.uniform(1.0, 3.0, 3)), axis=0) / RATE
    attitude = Rotation.from_euler("xyz", angles)
    turns = (attitude[:-1].inv() * attitude[1:]).as_rotvec() * RATE
    gyro = np.concatenate([turns[:1], turns]) + 5e-3 * random.standard_normal(3)
    gyro += 1.5e-3 * random.standard_normal(gyro.shape)
    accel = attitude.inv().apply([0.0, 0.0, G]) + 0.02 * random.standard_normal(gyro.shape)
    accel += goes * 0.5 * np.sin(5.0 * t)[:, None]
    summary, _, _ = smoothed(tmp_path, Hand(even_times(n, RATE), gyro, accel, attitude))
    assert summary["smoothing"]["rest_s"] > 15.0
