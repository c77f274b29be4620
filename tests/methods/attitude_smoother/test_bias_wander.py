"""A bias that wanders by more than its grade says, as chips that warm up have it."""

import numpy as np

from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.attitude_smoother.bias_wander import wandering
from sinstool.methods.attitude_smoother.epochs import (
    ACCEL,
    AT_REST,
    COUNT,
    DURATION,
    DV,
    GAP,
    GYRO,
    JB,
    OWN_RATE,
    REST,
    WIDTH,
    Epochs,
)
from sinstool.methods.attitude_smoother.model import (
    EPOCH_S,
    GRAVITY,
    HAND,
    sensor_model,
)

SENSORS = sensor_model("mems", walk_at_rest=None, bias_known=True, earth_removed=True)


def rested(slope, bent=0.0, later=None):
    """Epochs of one rest whose rate has a slope, rad/s^2, or bends; or of two, 5 min apart."""
    random = np.random.default_rng(1)
    parts = []
    for at_first in (0.0, later):
        if at_first is None:
            continue
        rows = np.zeros((100, WIDTH))
        t = np.arange(100) * EPOCH_S
        rows[:, DURATION], rows[:, COUNT], rows[:, REST] = EPOCH_S, 20.0, AT_REST
        rows[:, JB : JB + 9] = EPOCH_S * np.eye(3).ravel()
        rows[:, DV + 2], rows[:, ACCEL + 2] = -GRAVITY * EPOCH_S, -GRAVITY
        rate = at_first + slope * t + bent * np.sin(6.0 * np.pi * t / t[-1])
        rows[:, GYRO : GYRO + 3] = rate[:, None] + random.normal(0.0, 1e-4, (100, 3))
        rows[:, OWN_RATE] = 1e-8
        gap = np.zeros((1, WIDTH))
        gap[:, DURATION] = gap[:, GAP] = 300.0
        parts += [rows, gap]
    values = np.concatenate(parts[:-1])
    seconds = np.concatenate([[0.0], np.cumsum(values[:, DURATION])])
    return Epochs(np.rint(seconds * SECOND).astype(np.int64), values)


def walk_of(epochs):
    return wandering(epochs, HAND, SENSORS).bias_walk / SENSORS.bias_walk


def test_a_rest_shows_that_gyros_warm_up():
    """By 0.3 deg/s within 5 minutes: heading was up to 28 of its sigmas off."""
    assert walk_of(rested(0.3 * DEGREE / 300.0)) >= 10.0
    assert walk_of(rested(0.0)) == 1.0


def test_a_rate_that_bends_as_much_is_no_slope():
    assert walk_of(rested(0.0, bent=3e-4)) == 1.0


def test_rests_of_the_same_rate_contradict_a_walk_and_of_another_show_one():
    assert walk_of(rested(1e-5, later=0.0)) < walk_of(rested(1e-5))
    assert walk_of(rested(0.0, later=5e-3)) >= 10.0
