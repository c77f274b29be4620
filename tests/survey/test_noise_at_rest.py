"""The noise of gyros behind counts, sway and vibration, of rests by another program."""

from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.core.earth import EARTH_RATE
from sinstool.core.units import DEGREE, DEGREE_PER_ROOT_HOUR
from sinstool.methods.alignment.still import WindowStage, still_spans
from sinstool.survey.grade import (
    gyro_walk_shown,
    random_walk,
    random_walks,
    sensor_grade,
    velocity_walk_shown,
)

RATE, SECONDS = 100.0, 300.0
ARC_SECOND = DEGREE / 3600.0
WALK = 0.002 * DEGREE_PER_ROOT_HOUR  # of a laser gyro
EARTH = EARTH_RATE * np.array([0.6, 0.0, -0.8])


def rest(seed, walk=WALK, mean=EARTH, counts=0.0, sway=0.0, white=1e-3, shaken=0.0):
    """What of a source counts here; counts in rad, sway in rad/s at 2 Hz.

    The accelerometers have white noise, and are shaken at 23 Hz, both in m/s^2.
    """
    random = np.random.default_rng(seed)
    t = np.arange(round(SECONDS * RATE)) / RATE
    turn = 2.0 * np.pi * 2.0
    gyro = mean + sway * np.sin(turn * t[:, None] + random.uniform(0.0, 6.0, 3))
    gyro = gyro + walk * np.sqrt(RATE) * random.standard_normal((len(t), 3))
    if counts:
        angle = np.round(np.cumsum(gyro / RATE, axis=0) / counts) * counts
        gyro = RATE * np.diff(angle, axis=0, prepend=np.zeros((1, 3)))
    accel = np.array([0.0, 0.0, -9.8]) + white * random.standard_normal((len(t), 3))
    accel += shaken * np.sin(23.0 * 2.0 * np.pi * t[:, None] + [0.0, 1.0, 2.0])
    stage = WindowStage()
    stage.push(np.round(t * 1e9).astype(np.int64), gyro, accel)
    windows = stage.finish()
    spans = still_spans(windows)
    survey = SimpleNamespace(
        windows=windows,
        spans=spans,
        duration_s=SECONDS,
        gyro_resolution=counts * RATE,
        lead_in=spans[0],
    )
    return SimpleNamespace(survey=survey, aiding=SimpleNamespace(gnss=None))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("of", [{"counts": 2.0 * ARC_SECOND}, {"sway": 0.01 * DEGREE}])
def test_what_stays_within_an_angle_is_no_random_walk(seed, of):
    log = rest(seed, **of)
    assert random_walk(log) > 8.0 * WALK
    assert gyro_walk_shown(log) < 4.0 * WALK
    assert sensor_grade(log, ProcessConfig()).grade == "navigation"


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("walk", [0.002, 0.05, 0.3])
def test_white_noise_is_as_large_as_its_samples_say(seed, walk):
    log = rest(seed, walk * DEGREE_PER_ROOT_HOUR)
    assert gyro_walk_shown(log) == random_walk(log)


def test_gyros_without_the_rate_of_the_earth_are_as_noisy_as_their_samples():
    """As of a driver that takes the mean off at rest, however steady what is left."""
    log = rest(1, mean=np.zeros(3), sway=0.05 * DEGREE)
    assert gyro_walk_shown(log) == random_walk(log)
    assert sensor_grade(log, ProcessConfig()).grade == "mems"


@pytest.mark.parametrize("white", [1e-3, 0.05])
@pytest.mark.parametrize("shaken", [0.0, 0.1])
def test_noise_of_accelerometers_is_not_what_shakes_them(white, shaken):
    log = rest(1, white=white, shaken=shaken)
    assert velocity_walk_shown(log) == pytest.approx(white / np.sqrt(RATE), rel=0.4)
    if shaken:
        assert random_walks(log)[1] > 1.4 * velocity_walk_shown(log)
