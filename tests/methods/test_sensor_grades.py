"""Grades of sensors: what a filter assumes covers what sensors of its grade have."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from sinstool.core.units import DEGREE
from sinstool.methods.sensor_errors import (
    IMU_GRADES,
    SIMULATED_GRADES,
    SensorGrade,
    uncalibrated,
    without,
)


@pytest.mark.parametrize("grade", ["consumer", "mems", "tactical", "navigation"])
def test_a_filter_assumes_no_less_than_simulated_sensors_have(grade):
    assumed, simulated = IMU_GRADES[grade], SIMULATED_GRADES[grade]
    # The gyros' of a consumer are taken off first
    left_out = {"bias_time_s"} | ({"gyro_bias"} if grade == "consumer" else set())
    for field in fields(SensorGrade):
        if field.name not in left_out:
            there = getattr(simulated, field.name)
            assert getattr(assumed, field.name) >= 0.999 * there, field.name
            # scale_wander alone is not simulated
            assert there > 0.0 or field.name == "scale_wander"


@pytest.mark.parametrize(("sigma_deg_s", "expected"), [(0.2, 0.05), (1.0, 0.9)])
def test_a_bias_shows_whether_a_low_cost_imu_is_calibrated(sigma_deg_s, expected):
    """By Bayes' rule, over biases as they are of calibrated ones and of bare chips."""
    biases = sigma_deg_s * DEGREE * np.random.default_rng(1).standard_normal((4000, 3))
    likelier = np.mean([uncalibrated(bias) > 0.5 for bias in biases])
    assert likelier < expected if expected < 0.5 else likelier > expected


def test_parts_of_a_grade_are_left_out():
    whole = SIMULATED_GRADES["mems"]
    left = without(whole, "scale", "drift")
    assert left.gyro_scale == left.accel_scale == 0.0
    assert left.gyro_instability == left.accel_instability == 0.0
    assert left.gyro_misalignment == whole.gyro_misalignment > 0.0
    assert left.gyro_bias == whole.gyro_bias and without(whole) == whole
