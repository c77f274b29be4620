"""Grades of sensors: what a filter assumes covers what sensors of its grade have."""

from __future__ import annotations

from dataclasses import fields

import pytest

from sinstool.methods.sensor_errors import IMU_GRADES, SIMULATED_GRADES, SensorGrade, without


@pytest.mark.parametrize("grade", ["mems", "tactical", "navigation"])
def test_a_filter_assumes_no_less_than_simulated_sensors_have(grade):
    assumed, simulated = IMU_GRADES[grade], SIMULATED_GRADES[grade]
    for field in fields(SensorGrade):
        if field.name != "bias_time_s":
            there = getattr(simulated, field.name)
            assert getattr(assumed, field.name) >= 0.999 * there, field.name
            # scale_wander alone is not simulated
            assert there > 0.0 or field.name == "scale_wander"


def test_parts_of_a_grade_are_left_out():
    whole = SIMULATED_GRADES["mems"]
    left = without(whole, "scale", "drift")
    assert left.gyro_scale == left.accel_scale == 0.0
    assert left.gyro_instability == left.accel_instability == 0.0
    assert left.gyro_misalignment == whole.gyro_misalignment > 0.0
    assert left.gyro_bias == whole.gyro_bias and without(whole) == whole
