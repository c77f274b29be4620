"""Sensor errors have the sizes that their grade states."""

from __future__ import annotations

import numpy as np
import pytest

from sinstool.core.rotation import from_euler
from sinstool.methods.sensor_errors import SIMULATED_GRADES, SensorGrade
from sinstool.simulation.sensors import markov, with_errors
from sinstool.simulation.truth import sample_times, static


def test_a_perfect_sensor_changes_nothing() -> None:
    truth = static(sample_times(100.0, 10.0), from_euler([0.1, -0.2, 1.0]), 0.7)
    sensor = with_errors(truth, SIMULATED_GRADES["perfect"], 3)
    np.testing.assert_array_equal(sensor.gyro_rate, truth.gyro_rate)
    np.testing.assert_allclose(sensor.gyro_increment, truth.gyro_increment, rtol=1e-15)


@pytest.mark.parametrize("tau", [0.5, 20.0])
def test_markov_is_stationary_and_forgets(tau: float) -> None:
    x = markov(400, 0.1, tau, np.random.default_rng(1), 20000)
    assert np.var(x[0]) == pytest.approx(1.0, abs=0.05)
    assert np.var(x[-1]) == pytest.approx(1.0, abs=0.05)
    correlation = np.mean(x[100] * x[110])
    assert correlation == pytest.approx(np.exp(-1.0 / tau), abs=0.05)


def test_scale_and_misalignment_act_on_the_truth() -> None:
    truth = static(sample_times(10.0, 1.0), from_euler([0.3, 0.2, -1.0]), 0.9)
    grade = SensorGrade(
        angle_random_walk=0,
        gyro_bias=0,
        velocity_random_walk=0,
        accel_bias=0,
        accel_scale=1e-3,
        accel_misalignment=2e-3,
        gyro_scale=5e-3,
    )
    drawn = np.array(
        [
            (with_errors(truth, grade, s).specific_force - truth.specific_force)[0]
            for s in range(800)
        ]
    )
    f = truth.specific_force[0]
    expected = np.sqrt((1e-3 * f) ** 2 + (2e-3) ** 2 * (f @ f - f * f))
    np.testing.assert_allclose(drawn.std(axis=0), expected, rtol=0.1)
    gyro = with_errors(truth, grade, 5)
    ratio = gyro.gyro_increment[0] / truth.gyro_increment[0] - 1.0
    np.testing.assert_allclose(gyro.gyro_rate[3] / truth.gyro_rate[3] - 1.0, ratio, rtol=1e-9)
    assert np.ptp(ratio) > 1e-4


def test_same_seed_same_errors() -> None:
    truth = static(sample_times(50.0, 4.0), from_euler([0.0, 0.1, 2.0]), -0.4)
    grade = SensorGrade(
        angle_random_walk=1e-4,
        gyro_bias=1e-5,
        velocity_random_walk=1e-3,
        accel_bias=1e-3,
        gyro_instability=1e-5,
        accel_instability=1e-3,
    )
    a, b, c = (with_errors(truth, grade, seed).gyro_rate for seed in (7, 7, 8))
    np.testing.assert_array_equal(a, b)
    assert np.abs(a - c).max() > 0
