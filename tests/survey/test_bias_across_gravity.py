"""A rate about a level axis that tilts nothing is a bias, however short the rest."""

from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.core.units import DEGREE, DEGREE_PER_ROOT_HOUR
from sinstool.methods.alignment.still import WindowStage, still_spans
from sinstool.survey.grade import bias_across_gravity, largest_bias, sensor_grade

RATE = 100.0
WALK = 0.06 * DEGREE_PER_ROOT_HOUR  # as of a tactical gyro


def log(gyro=(0.0, 0.0, 0.0), force=(0.0, 0.0, -9.81), turned=False, seconds=6.0, seed=1):
    """What of a source counts here, rates in deg/s; turned: they are true, and tilt the force."""
    random = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    rate, force = np.asarray(gyro) * DEGREE, np.asarray(force)
    accel = force - np.outer(t if turned else 0.0 * t, np.cross(rate, force))
    gyro = rate + WALK * np.sqrt(RATE) * random.standard_normal((len(t), 3))
    accel = accel + 5e-3 * random.standard_normal((len(t), 3))
    stage = WindowStage()
    stage.push(np.round(t * 1e9).astype(np.int64), gyro, accel)
    windows = stage.finish()
    survey = SimpleNamespace(
        windows=windows, spans=still_spans(windows), duration_s=seconds, gyro_resolution=0.0
    )
    return SimpleNamespace(survey=survey, aiding=SimpleNamespace(gnss=None))


@pytest.mark.parametrize("seconds", [3.0, 6.0, 9.0])
@pytest.mark.parametrize("seed", range(3))
def test_quiet_gyros_with_a_large_bias_are_mems(seconds, seed):
    """Then the rest counts as one, instead of as a turn that no such gyro's bias can be."""
    source = log(gyro=(0.3, -0.2, 0.1), seconds=seconds, seed=seed)
    across = np.hypot(0.3, 0.2) * DEGREE
    assert 0.7 * across < bias_across_gravity(source) < across
    judged = sensor_grade(source, ProcessConfig())
    assert judged.grade == "mems" and "its bias there" in judged.why
    assert largest_bias(source, ProcessConfig()) == np.inf


@pytest.mark.parametrize(
    "motion",
    [
        {"gyro": (0.0, 0.0, 0.35)},
        # a level turn at 250 m/s: rate and force lean apart, and neither changes
        {"gyro": (0.0, 0.068, 0.442), "force": (0.0, 0.0, -9.93)},
        {"gyro": (0.3, -0.2, 0.1), "turned": True, "seconds": 4.0},
        {"gyro": (0.01, 0.0, 0.0)},
    ],
)
def test_what_may_be_a_turn_is_no_bias(motion):
    source = log(**motion)
    assert source.survey.spans
    assert bias_across_gravity(source) < 2e-4
    assert sensor_grade(source, ProcessConfig()).grade == "industrial"
    assert largest_bias(source, ProcessConfig()) == 5e-3
