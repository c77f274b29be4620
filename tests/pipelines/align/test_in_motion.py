"""Sensor errors that an alignment in motion assumes: of options, rest and grade."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.core.rotation import wrapped
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.io.readers import open_log
from sinstool.methods.alignment import in_motion
from sinstool.methods.sensor_errors import IMU_GRADES
from sinstool.pipelines.align.in_motion import (
    AFTER_REST,
    align_moving,
    imu_noise,
    increments,
    sensor_errors,
)
from sinstool.pipelines.align.log import align_log
from sinstool.survey.source import prepare
from tests.helpers.imulogs import T0
from tests.helpers.launch_logs import TACTICAL, launched
from tests.helpers.unseen_drives import (
    GRADES,
    LEVER,
    RATE,
    band_noise,
    drive,
    flight,
    motion_of,
    record,
    smoothed,
    straight_flight,
    write,
)
from tests.helpers.unseen_drives import (
    sensor_errors as unseen_errors,
)
from tests.helpers.unseen_errors import slower

HOUR = 3600.0
MODULE = "sinstool.pipelines.align.in_motion"


def errors(grade="mems", at_rest=False, walk=0.0, velocity=0.0, misalignment=None, **options):
    config = {"in_flight": options, "filter": {"sigma_misalignment": misalignment}}
    return sensor_errors(build(ProcessConfig, config), grade, at_rest, (walk, velocity))


def test_a_rest_says_what_the_bias_is():
    noise = IMU_GRADES["mems"]
    unknown = np.hypot(noise.gyro_bias, noise.gyro_instability)
    assert errors().gyro_bias == pytest.approx(unknown)
    assert errors(at_rest=True).gyro_bias == pytest.approx(min(unknown, AFTER_REST))
    # a better gyro is not made worse by it
    navigation = errors("navigation", at_rest=True).gyro_bias
    assert navigation == errors("navigation").gyro_bias < AFTER_REST


def test_a_random_walk_seen_at_rest_counts_where_it_is_more():
    usual = IMU_GRADES["tactical"].angle_random_walk
    assert errors("tactical", walk=3.0 * usual).angle_random_walk == 3.0 * usual
    assert errors("tactical", walk=0.3 * usual).angle_random_walk == usual
    usual = IMU_GRADES["tactical"].velocity_random_walk
    assert errors("tactical", velocity=3.0 * usual).velocity_random_walk == 3.0 * usual
    assert errors("tactical", velocity=0.3 * usual).velocity_random_walk == usual


def test_options_win():
    options = {"sigma_bg": 2.0, "sigma_ba": 0.03, "sigma_sf": 5e-4, "arw": 0.2, "vrw": 80.0}
    result = errors(at_rest=True, walk=1.0, velocity=1.0, misalignment=0.0, **options)
    assert np.rad2deg(result.gyro_bias) * HOUR == pytest.approx(2.0)
    assert result.accel_bias == 0.03
    assert result.gyro_scale == result.accel_scale == 5e-4
    assert np.rad2deg(result.angle_random_walk) * 60.0 == pytest.approx(0.2)
    assert result.velocity_random_walk == pytest.approx(80e-6 * 9.80665)


def test_a_stated_misalignment_is_that_of_both_sensors():
    config = build(ProcessConfig, {"filter": {"sigma_misalignment": 0.3}})
    noise, grade = imu_noise(config, "tactical"), IMU_GRADES["tactical"]
    assert noise.gyro_misalignment == noise.accel_misalignment == pytest.approx(3e-4)
    assert replace(noise, gyro_misalignment=2e-4, accel_misalignment=2e-4) == grade
    exact = imu_noise(build(ProcessConfig, {"filter": {"sigma_misalignment": 0}}), "mems")
    assert exact.gyro_misalignment == exact.accel_misalignment == 0.0


def test_a_bias_that_an_option_makes_small_does_not_wander_more_than_a_tenth_of_it():
    grade = IMU_GRADES["mems"]

    def noise(**options):
        return imu_noise(build(ProcessConfig, {"in_flight": options}), "mems")

    small = 2.0 * grade.accel_instability
    assert noise(sigma_ba=small).accel_bias == small
    assert noise(sigma_ba=small).accel_instability == pytest.approx(0.1 * small)
    assert noise(sigma_ba=100.0 * small).accel_instability == grade.accel_instability
    assert noise(sigma_ba=small).gyro_instability == grade.gyro_instability
    small = 2.0 * grade.gyro_instability
    turned = noise(sigma_bg=small / DEGREE * HOUR)
    assert turned.gyro_instability == pytest.approx(0.1 * small)
    assert turned.accel_instability == grade.accel_instability


def test_a_bias_time_lets_all_of_a_bias_wander():
    def noise(**options):
        return imu_noise(build(ProcessConfig, {"in_flight": options}), "industrial")

    grade, slow = IMU_GRADES["industrial"], noise(bias_time=3600.0)
    assert slow.bias_time_s == 3600.0
    assert slow.gyro_instability == slow.gyro_bias == grade.gyro_bias
    assert slow.accel_instability == slow.accel_bias == grade.accel_bias
    assert slow.scale_wander == 1.0 > grade.scale_wander
    both = noise(bias_time=3600.0, sigma_bg=25.0, sigma_ba=2e-3)
    assert both.gyro_instability == both.gyro_bias == pytest.approx(25.0 * DEGREE / HOUR)
    assert both.accel_instability == both.accel_bias == 2e-3


@pytest.mark.parametrize("kind", ["rate", "mean-rate", "increment"])
def test_increments_of_a_part_are_those_of_the_whole(kind):
    config = build(ProcessConfig, {"input": {"gyro_kind": kind}})
    bias = np.array([0.01, -0.02, 0.03])
    with open_log(launched(*TACTICAL, "--pad", "30", "--gyro-kind", kind)) as log:
        source = prepare(log, config)
        first, end = source.survey.first_ns, source.survey.first_ns + 50 * 10**9
        whole = increments(source, config, bias, end)
        assert whole.time_ns[0] == first and end - 10**8 < whole.time_ns[-1] <= end
        begin = first + 20 * 10**9
        part = increments(source, config, bias, end, begin)
        rows = whole.rows(whole.time_ns >= begin)
        for name, values in vars(part).items():
            np.testing.assert_array_equal(values, getattr(rows, name))
        assert len(increments(source, config, bias, end, most=700)) == 700


def test_a_lift_off_late_in_a_long_log_is_aligned_all_the_same(monkeypatch):
    config = build(ProcessConfig, {"input": {"gyro_kind": "increment"}})
    with open_log(launched(*TACTICAL, "--pad", "30")) as log:
        source = prepare(log, config)
        whole = align_moving(source, config, "tactical", "svd", "end").result
        # 20 of the 30 s of rest are more than may be held beside the flight
        rate = 1e9 / source.survey.interval_ns
        monkeypatch.setattr(f"{MODULE}.MOST_SAMPLES", source.survey.count - round(15.0 * rate))
        again = align_moving(source, config, "tactical", "svd", "end").result
    assert whole.status == again.status == "ok"
    assert again.t_ns == whole.t_ns
    np.testing.assert_allclose(again.q_nb, whole.q_nb, atol=1e-6)


def cornering(seed, most=1.6, speed=17.0):
    """A kart on a winding track: up to 2.9 g sideways, for longer than half a second."""
    random = np.random.default_rng([seed, 31])
    t = np.arange(0.0, 150.0, 1.0 / RATE)
    moving = smoothed(np.where(t > 15.0, 1.0, 0.0), 8.0)
    rate = smoothed(most * moving * (np.sin(0.5 * t + 6.0 * random.random()) > 0.2), 0.8)
    rate -= smoothed(most * moving * (np.sin(0.37 * t + 6.0 * random.random()) > 0.8), 0.8)
    course = np.cumsum(rate) / RATE
    ahead = speed * moving * (1.0 + 0.1 * np.sin(0.3 * t))
    velocity = np.stack([ahead * np.cos(course), ahead * np.sin(course), 0.0 * t], axis=1)
    roll, pitch = np.radians(2.0) * moving * band_noise(random, t, 0.5, 4.0)[:, :2].T
    return motion_of(t, velocity, np.stack([roll, pitch, course], axis=1))


@pytest.mark.slow
@pytest.mark.parametrize("sigma_v", [0.05, None])
@pytest.mark.parametrize("seed", range(3))
def test_a_corner_of_more_than_two_g_is_no_launch(tmp_path, seed, sigma_v):
    data = record(
        cornering(seed), GRADES["industrial"], seed, gnss_rate=5.0, sigma=0.05, sigma_v=sigma_v
    )
    result, ratio = aligned(tmp_path, data, gyro_kind="mean-rate")
    assert result.gate == "off" and result.status in ("ok", "degraded")
    assert ratio < 4.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_samples_may_be_of_half_a_sample_ago(tmp_path, seed):
    """Means over 20 ms, read as rates, at 60 to 130 deg/s: as nothing in the log shows."""
    truth = cornering(seed, most=1.0)
    data = slower(
        record(truth, GRADES["industrial"], seed, gnss_rate=5.0, sigma=0.03, sigma_v=0.05), 4
    )
    result, ratio = aligned(tmp_path, data)
    told, rest = aligned(tmp_path, data, gyro_kind="mean-rate")
    assert ratio < 4.0 and rest < 4.0
    assert max(told.sigma_deg) < 0.1 < max(result.sigma_deg)


def aligned(tmp_path, data, groups=None, **options):
    """Result of `align`, and how far it is off over its sigmas."""
    log = write(tmp_path / "log.mcap", data)
    groups = groups or {"gnss": {"lever_arm": tuple(LEVER.tolist())}}
    groups = {"input": {"gyro_unit": "rad/s"} | options, **groups}
    result = align_log(log, build(ProcessConfig, groups)).result
    k = np.argmin(np.abs(data.truth.seconds - (result.time_ns - T0) * 1e-9))
    found = Rotation.from_euler(
        "ZYX", [result.heading_deg, result.pitch_deg, result.roll_deg], degrees=True
    )
    off = (found * Rotation.from_matrix(data.truth.c_nb[k]).inv()).as_rotvec(degrees=True)
    covariance = result.cov_deg2
    return result, np.sqrt(off @ np.linalg.solve(covariance, off) / 3.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_quiet_gyros_in_steady_motion_do_not_show_north(tmp_path, seed):
    """Headings 44 deg off, to 1.7 deg: gyros of industrial grade, taken for tactical ones."""
    t = np.arange(0.0, 300.0, 1.0 / RATE)
    level = np.zeros_like(t)
    velocity = np.stack([level + 15.0, level + 7.5, level], axis=1)
    truth = motion_of(t, velocity, np.stack([level, level, level + np.arctan2(7.5, 15.0)], axis=1))
    data = record(truth, GRADES["industrial"], seed, sigma=0.5, sigma_v=0.05)
    log = write(tmp_path / "log.mcap", data)
    options = {"input": {"gyro_kind": "mean-rate"}, "gnss": {"lever_arm": tuple(LEVER.tolist())}}
    result = align_log(log, build(ProcessConfig, options)).result
    assert "no rest shows its bias to be small" in result.plan.choices["imu_grade"].reason
    if result.heading_deg is not None and result.sigma_deg[2] is not None:
        off = np.rad2deg(wrapped(np.deg2rad(result.heading_deg) - np.arctan2(7.5, 15.0)))
        assert abs(off) < 4.0 * result.sigma_deg[2]


@pytest.mark.parametrize(("seed", "seconds"), [(5, 180), (7, 120)])
@pytest.mark.slow
def test_alignment_begins_later_where_the_first_motion_shows_nothing(tmp_path, seed, seconds):
    """An aircraft that flies straight for minutes: cheap gyros do not last until its first turn."""
    truth = straight_flight(seed)
    consumer = unseen_errors(0.4, 150.0, 0.15, 1500.0, 3000.0, 0.5)
    data = record(truth, consumer, seed, gnss_rate=5.0, sigma=0.3, sigma_v=0.1)
    log = write(tmp_path / "log.mcap", data)
    groups = {"input": {"gyro_kind": "mean-rate"}, "gnss": {"lever_arm": tuple(LEVER.tolist())}}
    config = build(ProcessConfig, groups)
    told = build(ProcessConfig, groups | {"in_flight": {"align_start": 1.0}})
    with open_log(log) as opened:
        source = prepare(opened, config)
        made = align_moving(source, config, "mems", "svd", "end")
        # who says when to begin is believed, and headings all around are tried from there
        as_told = align_moving(source, told, "mems", "svd", "end")
    assert any(f"first {seconds} s of motion do not show" in x for x in made.result.warnings)
    assert as_told.result.t_q_ns < T0 + 2 * SECOND < made.result.t_q_ns
    for answer in (made, as_told):
        assert answer.good
        row = int(np.argmin(np.abs(truth.seconds - (answer.result.t_ns - T0) * 1e-9)))
        given = Rotation.from_quat(answer.result.q_nb, scalar_first=True)
        off = (given * Rotation.from_matrix(truth.c_nb[row]).inv()).as_rotvec()
        sigma = np.sqrt(np.diag(answer.result.cov))
        assert (np.abs(off) < 3.5 * sigma).all()
        assert (np.rad2deg(sigma) < [0.7, 0.7, 2.0]).all()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 5])
def test_an_antenna_whose_place_is_not_given_is_estimated(tmp_path, seed):
    """An excavator swings its antenna about: 2 deg off in tilt at 9 sigmas, with one at the IMU."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, 240.0, 1.0 / RATE)

    def sway(size, *periods):
        return sum(
            size * random.uniform(0.5, 1.0) * np.sin(2.0 * np.pi * (t / p + random.random()))
            for p in periods
        )

    heading = random.uniform(-3.0, 3.0) + sway(0.8, 11.0, 23.0)
    angles = np.stack([sway(0.01, 3.1, 7.0), sway(0.01, 2.7, 5.0), heading], axis=1)
    velocity = np.stack([sway(0.5, 9.0, 17.0), sway(0.5, 11.0, 19.0), 0.0 * t], axis=1)
    consumer = unseen_errors(0.4, 150.0, 0.15, 1500.0, 3000.0, 0.5)
    arm = np.array([-1.3, -0.75, -1.7])
    truth = motion_of(t, velocity, angles)
    data = record(truth, consumer, seed, gnss_rate=5.0, sigma=0.02, sigma_v=0.02, lever=arm)
    groups = {"align": {"align": "svd"}}
    result, ratio = aligned(tmp_path, data, groups, gyro_kind="mean-rate")
    assert ratio < 2.0
    assert result.sigma_deg[2] < 5.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_gyro_bias_that_earlier_fixes_showed_is_not_searched_for_again(
    tmp_path, monkeypatch, seed
):
    """With other latencies the fixes of a bare chip were aligned with 26 times instead of twice."""
    chip = unseen_errors(0.4, 150.0, 0.15, 1500.0, 3000.0, 0.5)
    truth = flight(seed, 240.0, turbulent=True)
    data = record(truth, chip, seed, gnss_rate=5.0, sigma_v=0.1)
    data = replace(data, gyro=data.gyro + np.radians([1.5, -2.5, 3.3]) / RATE)
    log = write(tmp_path / "log.mcap", data)
    groups = {"input": {"gyro_kind": "mean-rate"}, "gnss": {"lever_arm": tuple(LEVER.tolist())}}
    config = build(ProcessConfig, groups)
    later = build(ProcessConfig, groups | {"gnss": {**groups["gnss"], "gnss_latency": 0.02}})
    tried = []
    align_in_flight = in_motion.align_in_flight

    def aligning(imu, fixes, settings):
        tried.append(settings)
        return align_in_flight(imu, fixes, settings)

    monkeypatch.setattr(in_motion, "align_in_flight", aligning)
    with open_log(log) as opened:
        source = prepare(opened, config)
        moving = align_moving(source, config, "mems", "svd", "start")
        assert moving.bias_by_motion
        tried.clear()
        likely = moving.refined_bias
        found = align_moving(source, later, "mems", "svd", "start", likely_bias=likely)
        assert len(tried) <= 3
        tried.clear()
        wrong = likely + np.radians([0.0, 0.0, 2.0])
        other = align_moving(source, later, "mems", "svd", "start", likely_bias=wrong)
        assert len(tried) > 3
    for answer in (found, other):
        assert answer.good and answer.bias_by_motion
        row = int(np.argmin(np.abs(truth.seconds - (answer.result.t_ns - T0) * 1e-9)))
        given = Rotation.from_quat(answer.result.q_nb, scalar_first=True)
        off = (given * Rotation.from_matrix(truth.c_nb[row]).inv()).as_rotvec()
        assert (np.abs(off) < 3.5 * np.sqrt(np.diag(answer.result.cov))).all()


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.slow
def test_spans_that_are_too_short_for_positions_alone_are_skipped(tmp_path, seed):
    """Spans of 15 s, in which a large bias is searched for, refused the whole alignment."""
    chip = unseen_errors(0.4, 150.0, 0.15, 1500.0, 3000.0, 0.5)
    data = record(flight(seed, 240.0, turbulent=True), chip, seed, gnss_rate=5.0)
    data = replace(data, gyro=data.gyro + np.radians([1.5, -2.5, 3.3]) / RATE)
    log = write(tmp_path / "log.mcap", data)
    config = build(ProcessConfig, {"input": {"gyro_kind": "mean-rate"}})
    with open_log(log) as opened:
        answer = align_moving(prepare(opened, config), config, "mems", "svd", "start")
    assert answer.result.status in ("ok", "degraded", "level-only", "unobservable")


def test_noise_of_accelerometers_at_rest_is_in_the_sigma(tmp_path):
    """Of a stated grade; with accelerometers forty times as noisy attitudes were 4 sigma off."""
    noisy = unseen_errors(0.05, 1.0, 1.27, 15.0, 300.0, 4.0)
    log = write(tmp_path / "log.mcap", record(drive(3, 180.0, 60.0), noisy, 3, sigma_v=0.03))
    sigma = []
    for vrw in (None, 2160.0, 50.0):  # as shown, as it is, as the grade has it
        options = {"in_flight": {"vrw": vrw}, "navigation": {"imu_grade": "tactical"}}
        config = build(ProcessConfig, {**options, "input": {"gyro_kind": "mean-rate"}})
        with open_log(log) as opened:
            made = align_moving(prepare(opened, config), config, "tactical", "svd", "end")
        sigma.append(np.sqrt(np.diag(made.result.cov)))
    shown, true, assumed = sigma
    assert (shown > 1.2 * assumed).all()
    np.testing.assert_allclose(shown, true, rtol=0.25)
