"""White noise by what changes from one sample to the next, of logs by another program."""

from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.methods.alignment.still import WindowStage, still_spans
from sinstool.survey.noise_in_motion import walks_in_motion

RATE = 200.0
WALK, VELOCITY_WALK = 2e-5, 1.5e-3


def source(gyro, accel):
    """What of a source counts here."""
    time_ns = np.round(np.arange(len(gyro)) * 1e9 / RATE).astype(np.int64)
    stage = WindowStage()
    stage.push(time_ns, gyro, accel)
    windows = stage.finish()
    duration = len(gyro) / RATE
    return SimpleNamespace(
        survey=SimpleNamespace(windows=windows, spans=still_spans(windows), duration_s=duration)
    )


def samples(seed, rest_s=20.0, moving_s=100.0, low_pass=1):
    """Rest, then rates and forces that wind and bounce, both with the noise of sensors."""
    random = np.random.default_rng(seed)
    count, rest = round((rest_s + moving_s) * RATE), round(rest_s * RATE)
    t = np.maximum(np.arange(count) - rest, 0)[:, None] / RATE
    phase = random.uniform(0.0, 6.0, 3)
    goes = np.minimum(t, 1.0)
    gyro = goes * 0.5 * (np.sin(1.3 * t + phase) + 0.1 * np.sin(2.0 * np.pi * 6.0 * t + phase))
    accel = goes * 2.0 * np.sin(2.0 * np.pi * 8.0 * t + phase) + np.array([0.0, 0.0, -9.8])
    out = []
    for motion, walk in ((gyro, WALK), (accel, VELOCITY_WALK)):
        noise = walk * np.sqrt(RATE) * random.standard_normal((count + low_pass - 1, 3))
        sums = np.cumsum(np.vstack([np.zeros((1, 3)), noise]), axis=0)
        out.append(motion + (sums[low_pass:] - sums[:-low_pass]) / low_pass)
    return (*out, rest)


@pytest.mark.parametrize("seed", range(5))
def test_motion_does_not_hide_the_noise_of_sensors(seed):
    gyro, accel, _ = samples(seed)
    walks = walks_in_motion(source(gyro, accel))
    assert np.divide(walks, (WALK, VELOCITY_WALK)) == pytest.approx(1.0, abs=0.15)


def test_what_shakes_at_rest_is_not_there_in_motion():
    gyro, accel, rest = samples(1)
    random = np.random.default_rng(9)
    gyro[:rest] += 4e-3 * random.standard_normal((rest, 3))
    accel[:rest] += 0.1 * random.standard_normal((rest, 3))
    shaken = source(gyro, accel)
    assert max(s.duration_s for s in shaken.survey.spans) > 10.0
    assert np.divide(walks_in_motion(shaken), (WALK, VELOCITY_WALK)) == pytest.approx(1.0, abs=0.15)


def test_what_shakes_in_motion_is_noise_there():
    gyro, accel, rest = samples(2)
    gyro[rest:] += (
        4.0 * WALK * np.sqrt(RATE) * np.random.default_rng(3).standard_normal(gyro[rest:].shape)
    )
    walk, _ = walks_in_motion(source(gyro, accel))
    assert walk == pytest.approx(np.sqrt(17.0) * WALK, rel=0.1)


@pytest.mark.parametrize("seed", range(3))
def test_a_sensor_that_filters_its_output_is_not_taken_for_a_quiet_one(seed):
    """Means of eight samples: their neighbours differ by a tenth of what the noise would make."""
    gyro, accel, _ = samples(seed, low_pass=8)
    walks = np.divide(walks_in_motion(source(gyro, accel)), (WALK, VELOCITY_WALK))
    assert np.all((walks > 0.8) & (walks < 5.0)), walks


def test_a_log_without_rest_or_motion_shows_none():
    gyro, accel, rest = samples(4)
    assert walks_in_motion(source(gyro[:rest], accel[:rest])) is None
    assert walks_in_motion(source(gyro[rest + 400 :], accel[rest + 400 :])) is None
    # nor sensors that do not change at all
    assert walks_in_motion(source(np.round(gyro), accel)) is None
