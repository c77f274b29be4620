"""How noisy an Imu is, by its drift where fixes are left out."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.io.readers import open_log
from sinstool.methods.sensor_errors import IMU_GRADES
from sinstool.pipelines.plan import make_plan
from sinstool.pipelines.process.ins_gnss.imu_drift import Drift, NoiseFactors, _likeliest
from sinstool.pipelines.process.ins_gnss.start import timed_start
from sinstool.survey.source import prepare
from tests.helpers.filter_logs import simulated
from tests.helpers.unseen_drives import GRADES, LEVER, drive, record, write


@pytest.mark.parametrize("truth", [(2.5, 0.4, 2.0), (0.2, 0.3, 5.0), (1, 1, 1), (3.0, 3.0, 0.7)])
def test_the_likeliest_factors_are_those_of_the_errors(truth):
    """Early errors are an accelerometer's, late ones mostly a gyro's, others a scale factor's."""
    shares = np.array([[0.01, 1, 0], [0.5, 1, 0], [1, 0.2, 0], [0, 1, 0.05], [0, 0.2, 1]])

    def sigma(*factors):
        return np.sqrt(1e-4 + shares @ np.square(factors))

    ratios = []
    for seed in range(20):
        error = sigma(*truth) * np.random.default_rng(seed).standard_normal((120, 5))

        def cost(*factors, error=error):
            return np.sum((error / sigma(*factors)) ** 2 + 2.0 * np.log(sigma(*factors)))

        ratios.append(np.log(np.array(_likeliest(cost)) / truth))
    assert np.abs(np.mean(ratios, axis=0)).max() < 0.2
    assert np.std(ratios, axis=0).max() < 0.35


def test_without_anything_seen_the_grade_counts():
    assert _likeliest(lambda g, a, s: 0.0) == pytest.approx((1.0, 1.0, 1.0))


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


def drift_of(path, change=lambda settings: settings, **groups):
    groups.setdefault("navigation", {})["mode"] = "ins-gnss"
    config = ProcessConfig(**groups)
    with open_log(path) as opened:
        source = prepare(opened, config, None)
        plan = make_plan(source, config)
        start = timed_start(source, config, plan.algorithm, plan.filter_start)
        start = replace(start, settings=change(start.settings))
        return start, Drift(source, config, plan.algorithm, start)


@pytest.fixture(scope="module")
def industrial(tmp_path_factory):
    data = record(drive(3, 400.0, 60.0), GRADES["industrial"], 3, gnss_rate=5.0, sigma_v=0.03)
    return write(tmp_path_factory.mktemp("drift") / "log.mcap", data)


GROUPS = {"gnss": {"lever_arm": tuple(LEVER.tolist())}, "input": {"gyro_kind": "mean-rate"}}


def test_factors_make_up_for_a_grade_that_is_too_cautious(industrial):
    noise = []
    for factor in (3.0, 6.0):
        change = NoiseFactors(factor, factor)
        start, drift = drift_of(industrial, lambda s, f=change: f.of(s, True), **GROUPS)
        used = drift.used(drift.factors()).imu
        assert used.angle_random_walk < 0.7 * start.settings.imu.angle_random_walk
        noise.append([used.angle_random_walk, used.velocity_random_walk])
    assert np.allclose(noise[0], noise[1], rtol=0.3)
    # No better than at rest
    rest = GRADES["industrial"]
    assert np.all(np.array(noise) > 0.95 * np.array([rest.angle_random_walk, 0.0]))
    assert np.all(np.array(noise) > 0.95 * np.array([0.0, rest.velocity_random_walk]))


def test_scale_factors_that_wander_are_found(industrial):
    """Within an hour by all of 1000 ppm: 7.5 times what an industrial grade is taken to do."""
    grade = IMU_GRADES["industrial"]
    _, drift = drift_of(industrial, lambda s: replace(s, imu=grade), **GROUPS)
    factors = drift.factors()
    assert 3.0 < factors.scale <= 8.0
    assert drift.used(factors).imu.scale_wander == pytest.approx(factors.scale * grade.scale_wander)


def test_a_vehicle_that_stands_makes_no_imu_better(tmp_path):
    path = simulated(
        tmp_path / "stand.mcap", "drive", "--duration", "400", "--still", "330", "--grade", "mems",
        "--seed", "8", "--idle", "0.3,0.01",
    )  # fmt: skip
    _, drift = drift_of(path)
    factors = drift.factors()
    assert min(factors.gyro, factors.accel) >= 1.0
