"""Sensor errors that an alignment in motion assumes: of options, rest and grade."""

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.methods.sensor_errors import IMU_GRADES
from sinstool.pipelines.align.in_motion import AFTER_REST, sensor_errors

HOUR = 3600.0


def errors(grade="mems", at_rest=False, walk=0.0, **options):
    return sensor_errors(build(ProcessConfig, {"in_flight": options}), grade, at_rest, walk)


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


def test_options_win():
    options = {"sigma_bg": 2.0, "sigma_ba": 0.03, "sigma_sf": 5e-4, "arw": 0.2, "vrw": 80.0}
    result = errors(at_rest=True, walk=1.0, **options)
    assert np.rad2deg(result.gyro_bias) * HOUR == pytest.approx(2.0)
    assert result.accel_bias == 0.03
    assert result.gyro_scale == result.accel_scale == 5e-4
    assert np.rad2deg(result.angle_random_walk) * 60.0 == pytest.approx(0.2)
    assert result.velocity_random_walk == pytest.approx(80e-6 * 9.80665)
