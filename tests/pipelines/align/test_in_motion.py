"""What goes into an alignment in motion: errors assumed, spans tried, velocities made whole."""

import numpy as np
import pytest

from sinstool.config import ProcessConfig, build
from sinstool.core.timeline import SECOND
from sinstool.methods.ins_gnss.noise import IMU_GRADES
from sinstool.pipelines.align.in_motion import (
    AFTER_REST,
    _spans,
    _whole_velocity,
    sensor_errors,
)

HOUR = 3600.0


def errors(grade="mems", known=False, walk=0.0, **told):
    return sensor_errors(build(ProcessConfig, {"in_flight": told}), grade, known, walk)


def test_a_rest_says_what_the_bias_is():
    noise = IMU_GRADES["mems"]
    unknown = np.hypot(noise.gyro_bias, noise.gyro_instability)
    assert errors().gyro_bias == pytest.approx(unknown)
    assert errors(known=True).gyro_bias == pytest.approx(min(unknown, AFTER_REST))
    # a better gyro is not made worse by it
    navigation = errors("navigation", known=True).gyro_bias
    assert navigation == errors("navigation").gyro_bias < AFTER_REST


def test_a_random_walk_that_was_seen_is_believed_where_it_is_more():
    usual = IMU_GRADES["tactical"].angle_random_walk
    assert errors("tactical", walk=3.0 * usual).angle_random_walk == 3.0 * usual
    assert errors("tactical", walk=0.3 * usual).angle_random_walk == usual


def test_what_is_told_wins():
    told = {"sigma_bg": 2.0, "sigma_ba": 0.03, "sigma_sf": 5e-4, "arw": 0.2, "vrw": 80.0}
    found = errors(known=True, walk=1.0, **told)
    assert np.rad2deg(found.gyro_bias) * HOUR == pytest.approx(2.0)
    assert found.accel_bias == 0.03
    assert found.gyro_scale == found.accel_scale == 5e-4
    assert np.rad2deg(found.angle_random_walk) * 60.0 == pytest.approx(0.2)
    assert found.velocity_random_walk == pytest.approx(80e-6 * 9.80665)


def test_spans_grow_to_the_end_of_the_log():
    first = 7 * SECOND
    assert _spans(30.0, "off", None, first, 10**12) == [first + 30 * SECOND]
    assert _spans(None, "paper", None, first, 10**12) == [None]
    long = _spans(None, "off", 100 * SECOND, first, 5000 * SECOND)
    assert long == [300 * SECOND, 700 * SECOND]
    assert _spans(None, "off", 100 * SECOND, first, 500 * SECOND) == [300 * SECOND, None]
    assert _spans(None, "off", None, first, 60 * SECOND) == [None]


def test_vertical_velocity_comes_from_height_where_there_is_none():
    seconds = np.arange(0.0, 60.0, 0.5)
    height = 300.0 + 4.0 * seconds
    whole = np.tile([20.0, -3.0, -4.0], (len(seconds), 1))
    flat = whole.copy()
    flat[:, 2] = np.nan
    filled, warnings = _whole_velocity(flat, seconds, seconds, height)
    np.testing.assert_allclose(filled[4:-4], whole[4:-4], atol=1e-9)
    assert "taken from height" in warnings[0]
    # few without are better left out than guessed
    few = whole.copy()
    few[10:20, 2] = np.nan
    kept, warnings = _whole_velocity(few, seconds, seconds, height)
    np.testing.assert_array_equal(kept, few)
    assert not warnings
    # no height either
    level, warnings = _whole_velocity(flat, seconds, np.empty(0), np.empty(0))
    assert not level[:, 2].any() and "taken as level" in warnings[0]
