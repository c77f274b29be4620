"""How noisy an IMU is, by its drift where fixes are left out."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.core.streams import GnssEpochs
from sinstool.io.readers import open_log
from sinstool.methods.ins_gnss.settings import Settings
from sinstool.methods.sensor_errors import IMU_GRADES
from sinstool.pipelines.planning import make_plan
from sinstool.pipelines.process.ins_gnss.imu_drift import (
    LEAST_DRIVEN,
    LOOKS,
    Drift,
    WindowErrors,
    shown_increments,
)
from sinstool.pipelines.process.ins_gnss.noise_factors import NoiseFactors
from sinstool.pipelines.process.ins_gnss.start import timed_start
from sinstool.survey.source import prepare
from tests.helpers.filter_logs import simulated
from tests.helpers.unseen_drives import GRADES, LEVER, drive, record, write


@pytest.mark.parametrize(
    "factors, text",
    [
        ((0.5, 0.5), "0.5 times"),
        ((2.0, 1.0), "gyros 2, accelerometers 1 times"),
        ((1.0, 1.0, 5.0), "scale factors 5 times"),
        ((2.0, 2.0, 5.0), "scale factors 5, gyros and accelerometers 2 times"),
        ((2.0, 1.0, 5.0), "scale factors 5, gyros 2, accelerometers 1 times"),
    ],
)
def test_factors_in_words(factors, text):
    assert str(NoiseFactors(*factors)) == text


def test_white_noise_stays_within_what_a_log_shows():
    settings = Settings(imu=IMU_GRADES["industrial"])
    imu = settings.imu
    for factor, gyro, accel in ((0.3, 0.8, 0.5), (3.0, 1.2, 2.0), (1.1, 1.1, 1.1)):
        changed = NoiseFactors(factor, factor, 1.0, ((0.8, 1.2), (0.5, 2.0))).of(settings, True).imu
        assert changed.angle_random_walk == pytest.approx(gyro * imu.angle_random_walk)
        assert changed.velocity_random_walk == pytest.approx(accel * imu.velocity_random_walk)
        assert changed.gyro_instability == pytest.approx(factor * imu.gyro_instability)
        assert changed.accel_instability == pytest.approx(factor * imu.accel_instability)


def drift_of(path, change=lambda settings: settings, **groups):
    groups.setdefault("navigation", {})["mode"] = "ins-gnss"
    config = ProcessConfig(**groups)
    with open_log(path) as opened:
        source = prepare(opened, config, None)
        plan = make_plan(source, config)
        start = timed_start(source, config, plan.algorithm, plan.filter_start)
        start = replace(start, settings=change(start.settings))
        return start, Drift(source, config, plan.algorithm, start)


@pytest.mark.parametrize("latency", [0.0, 0.033])
def test_updates_in_which_fixes_lie_are_not_joined(tmp_path, latency):
    """Long updates hide how an antenna swings when a fix is valid."""
    path = simulated(
        tmp_path / "log.mcap", "drive", "--duration", "60", "--still", "20", "--seed", "3"
    )
    config = ProcessConfig(navigation={"mode": "ins-gnss"}, gnss={"gnss_latency": latency})
    with open_log(path) as opened:
        source = prepare(opened, config, None)
        plan = make_plan(source, config)
        shown = shown_increments(source, config, plan.algorithm, plan.filter_start)
    valid_ns = plan.filter_start.valid_ns
    valid_ns = valid_ns[(valid_ns > shown.time_ns[0]) & (valid_ns < shown.time_ns[-1])]
    at = np.searchsorted(shown.time_ns, valid_ns)
    alone = shown.interval[at] < 1.5e-9 * source.survey.interval_ns
    assert len(at) > 100 and np.all(alone | (shown.time_ns[at] == valid_ns))
    assert np.median(shown.interval) > 3e-9 * source.survey.interval_ns


@pytest.fixture(scope="module")
def industrial(tmp_path_factory):
    data = record(drive(3, 400.0, 60.0), GRADES["industrial"], 3, gnss_rate=5.0, sigma_v=0.03)
    return write(tmp_path_factory.mktemp("drift") / "log.mcap", data)


GROUPS = {"gnss": {"lever_arm": tuple(LEVER.tolist())}, "input": {"gyro_kind": "mean-rate"}}


@pytest.mark.slow
def test_factors_make_up_for_a_grade_that_is_too_cautious(industrial):
    noise = []
    for factor in (3.0, 6.0):
        change = NoiseFactors(factor, factor)
        start, drift = drift_of(industrial, lambda s, f=change: f.of(s, True), **GROUPS)
        used = drift.used(drift.factors()).imu
        assert used.angle_random_walk < 0.7 * start.settings.imu.angle_random_walk
        noise.append([used.angle_random_walk, used.velocity_random_walk])
    # Scale factors stand in for accelerometers, as far as the prior of either has it
    assert np.all(np.abs(np.log(np.divide(*noise))) < np.log([1.3, 2.5])), noise
    # No better than at rest
    rest = GRADES["industrial"]
    assert np.all(np.array(noise) > 0.95 * np.array([rest.angle_random_walk, 0.0]))
    assert np.all(np.array(noise) > 0.95 * np.array([0.0, rest.velocity_random_walk]))


@pytest.mark.slow
def test_sensors_are_as_noisy_as_at_rest_and_in_motion(industrial):
    """An industrial grade has them twice as noisy. Nothing shakes the vehicle."""
    start, drift = drift_of(industrial, **GROUPS)
    truth = GRADES["industrial"]
    assert start.grade.grade == "industrial"
    for imu in (start.settings.imu, drift.used(drift.factors()).imu):
        assert imu.angle_random_walk == pytest.approx(truth.angle_random_walk, rel=0.15)
    noise = drift.factors()
    for factor in (1e-2, 1e2):
        forced = replace(noise, gyro=factor, accel=factor)
        imu = drift.used(forced).imu
        assert imu.angle_random_walk == pytest.approx(truth.angle_random_walk, rel=0.15)
        assert imu.velocity_random_walk == pytest.approx(truth.velocity_random_walk, rel=0.15)


@pytest.mark.slow
def test_scale_factors_that_wander_are_found(industrial):
    """Within an hour by all of 1000 ppm: 7.5 times what an industrial grade is taken to do."""
    grade = IMU_GRADES["industrial"]
    _, drift = drift_of(industrial, lambda s: replace(s, imu=grade), **GROUPS)
    factors = drift.factors()
    assert 3.0 < factors.scale <= 8.0
    assert drift.used(factors).imu.scale_wander == pytest.approx(factors.scale * grade.scale_wander)


@pytest.mark.slow
def test_a_vehicle_that_stands_makes_no_imu_better(tmp_path):
    path = simulated(
        tmp_path / "stand.mcap", "drive", "--duration", "400", "--still", "330", "--grade", "mems",
        "--seed", "8", "--idle", "0.3,0.01",
    )  # fmt: skip
    _, drift = drift_of(path)
    factors = drift.factors()
    assert min(factors.gyro, factors.accel) >= 1.0
    # it moves for 70 s, of which fixes are left out in three windows at most
    assert 0 < np.count_nonzero(drift._as_graded.moved) <= 3


def windows(ratio, count=40, moved=None, restarts=0, seed=0):
    """Windows of errors that are so many times their sigmas."""
    random = np.random.default_rng(seed)
    sigma = random.uniform(0.5, 20.0, (count, len(LOOKS), 3))
    error = ratio * sigma * random.standard_normal(sigma.shape)
    moved = np.ones(count, bool) if moved is None else moved
    return WindowErrors(error, sigma, moved, restarts)


@pytest.mark.slow
def test_runs_for_the_looks_alone_agree_with_those_that_compare_all(industrial):
    """Fixes that are compared only change nothing but where substeps end."""
    start, drift = drift_of(industrial, **GROUPS)
    error, sigma = drift.window_errors(start.settings)
    moved = drift._as_graded.moved
    assert np.isfinite(error).all() and len(error) == np.count_nonzero(moved)
    assert sigma == pytest.approx(drift._as_graded.sigma[moved], rel=0.02)
    assert np.abs((error - drift._as_graded.error[moved]) / sigma).max() < 0.05


@pytest.mark.parametrize("restarts", [0, 2])
def test_errors_of_three_sigmas_are_seen_as_such(restarts):
    found = [windows(3.0, 60, restarts=restarts, seed=seed).ratio for seed in range(40)]
    assert np.mean(found) == pytest.approx(3.0, rel=0.05)


def test_what_chance_makes_of_one_is_one():
    found = [windows(1.0, 60, seed=seed).ratio for seed in range(300)]
    # more than 1 in one of a hundred
    assert 0 < np.count_nonzero(np.array(found) > 1.0) < 12
    assert windows(9.0, 3).ratio == 1.0 and windows(9.0, 4).ratio > 1.0


@pytest.mark.parametrize(
    ("driven", "shaken"), [(LEAST_DRIVEN - 1, True), (LEAST_DRIVEN, True), (LEAST_DRIVEN, False)]
)
def test_windows_with_a_stop_that_shakes_do_not_count_where_enough_have_none(driven, shaken):
    """What shakes a car at a traffic light is none of the IMU's noise."""
    seconds = np.arange(0.0, 20.0 * (driven + 2) + 1.0)
    speed = np.where((seconds > 6.0) & (seconds < 12.0), 0.0, 10.0)  # a stop in the first window
    speed[-21:] = 0.0  # and one that lasts for all of the last
    north = np.concatenate([[0.0], np.cumsum(speed[1:])])
    time_ns = np.round(seconds * 1e9).astype(np.int64)
    place = np.stack([0.8 + north / 6.37e6, 0.0 * north, 0.0 * north], axis=1)
    sigma = np.full((len(north), 3), 0.05)
    gnss = GnssEpochs(time_ns, time_ns, *place.T, np.full_like(sigma, np.nan), sigma, sigma)
    drift = Drift.__new__(Drift)
    drift._start = SimpleNamespace(used=gnss, late_ns=0)
    drift._shaken = shaken
    begin = np.arange(0, 20 * (driven + 2), 20)
    moved = drift.moved_between(SimpleNamespace(time_ns=time_ns), begin, begin + 20)
    assert moved[1:-1].all() and not moved[-1]
    assert moved[0] == (driven < LEAST_DRIVEN or not shaken)
