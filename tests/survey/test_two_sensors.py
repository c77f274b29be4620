"""Two IMUs on one topic: their samples alternate, and no attitude of them is right."""

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.core.finding import Severity
from sinstool.core.streams import Imu
from sinstool.io.readers import open_log
from sinstool.pipelines.process.run import process
from sinstool.survey import two_sensors
from sinstool.survey.source import prepare
from tests.helpers.imulogs import even_times, handheld, imu_messages, write_log

RATE, COUNT = 50.0, 1000
# The second one is turned by 30 degrees about the forward axis
TURN = np.array([[1.0, 0.0, 0.0], [0.0, np.sqrt(0.75), -0.5], [0.0, 0.5, np.sqrt(0.75)]])


def one_sensor(rate=RATE, count=COUNT):
    gyro, accel = handheld(count, rate, slowness_s=1.0, size=1.0, rest_s=4.0)[:2]
    return even_times(count, rate), gyro, accel


def found(path, messages):
    """What is found of the topic in `prepare`, by kind."""
    log = write_log(path, sorted(messages, key=lambda m: m.log_ns))
    with open_log(log) as opened:
        return log, {f.kind: f for f in prepare(opened, ProcessConfig()).findings}


def published_twice(turn, later_ms=7.0):
    times, gyro, accel = one_sensor()
    other = times + round(later_ms * 1e6)
    return imu_messages(times, gyro, accel) + imu_messages(other, gyro @ turn.T, accel @ turn.T)


@pytest.mark.parametrize("later_ms", [4.0, 10.0])
def test_two_mounted_in_different_ways_are_told(tmp_path, later_ms):
    log, kinds = found(tmp_path / "a.mcap", published_twice(TURN, later_ms))
    two = kinds["two-sensors"]
    assert two.severity == Severity.LOST
    assert "/imu alternate" in two.text and "--imu-topic" in two.answer
    assert two.numbers["apart_m_s2"] == pytest.approx(4.4, abs=0.7)
    result = process(log, tmp_path / "out.mcap", build(ProcessConfig, {}))
    assert "two-sensors" in {f.kind for f in result.findings}


@pytest.mark.parametrize("lost", [0.01, 0.04])
def test_two_with_lost_samples_are_told(tmp_path, lost):
    messages = published_twice(TURN)
    kept = np.random.default_rng(5).random(len(messages)) > lost
    _, kinds = found(
        tmp_path / "a.mcap", [m for m, keep in zip(messages, kept, strict=True) if keep]
    )
    assert "two-sensors" in kinds


def test_two_along_the_same_axes_are_as_good_as_one(tmp_path):
    _, kinds = found(tmp_path / "a.mcap", published_twice(np.eye(3)))
    assert "two-sensors" not in kinds


@pytest.mark.parametrize(
    ("hertz", "along"),
    [
        (0.5 * RATE - 1.0, (4.0, 0.0, 0.0)),  # as an engine's, near half of the sampling rate
        (0.5 * RATE, (0.0, 0.0, 4.0)),
        (0.3 * RATE, (4.0, 4.0, 0.0)),
    ],
)
def test_vibration_is_of_one_sensor(tmp_path, hertz, along):
    times, gyro, accel = one_sensor()
    phase = 2.0 * np.pi * hertz * np.arange(len(times)) / RATE
    shaken = accel + np.cos(phase)[:, None] * np.array(along)
    _, kinds = found(tmp_path / "a.mcap", imu_messages(times, gyro, shaken))
    assert "two-sensors" not in kinds


@pytest.mark.parametrize("off_hz", [0.1, -0.05, 0.02])
@pytest.mark.parametrize("circling", [False, True])
def test_vibration_that_beats_within_a_minute_is_of_one_sensor(off_hz, circling):
    """What shakes across gravity at half of the sampling rate was taken for a second sensor."""
    seconds = np.arange(60.0 * RATE) / RATE
    phase = 2.0 * np.pi * (0.5 * RATE + off_hz) * seconds
    level = np.array([0.3, -0.2, 9.8]) + 0.02 * np.random.default_rng(2).normal(size=(3000, 3))
    shaken = level + 5.0 * np.cos(phase)[:, None] * [1.0, 0.0, 0.0]
    shaken += 5.0 * circling * np.sin(phase)[:, None] * [0.0, 1.0, 0.0]
    assert two_sensors.apart(blocks_of(shaken), RATE) == 0.0


@pytest.mark.parametrize("swing", [0.0, 0.5])
def test_two_that_swing_together_are_told(swing):
    t = np.arange(60.0 * RATE) / RATE
    roll = swing * np.sin(0.4 * t)
    one = 9.8 * np.stack([0.1 * np.cos(0.3 * t), np.sin(roll), np.cos(roll)], axis=1)
    both = np.where(np.arange(len(t))[:, None] % 2, one, one @ TURN.T)
    apart = two_sensors.apart(blocks_of(both), RATE)
    assert apart == pytest.approx(5.0, abs=0.5)


def blocks_of(accel):
    times = even_times(len(accel), RATE)
    yield Imu(times, times, np.zeros_like(accel), accel)


def test_white_noise_is_of_one_sensor(tmp_path):
    times, gyro, accel = one_sensor()
    noisy = accel + 3.0 * np.random.default_rng(1).standard_normal(accel.shape)
    _, kinds = found(tmp_path / "a.mcap", imu_messages(times, gyro, noisy))
    assert "two-sensors" not in kinds


@pytest.mark.parametrize("rate", [100.0, 150.0])
def test_stamps_too_coarse_for_the_rate_lose_no_samples(tmp_path, rate):
    """Half of the samples of two hundredths of a second, or fewer, have the stamp of another."""
    times, gyro, accel = one_sensor(rate)
    coarse = times // 20_000_000 * 20_000_000
    log = write_log(tmp_path / "a.mcap", imu_messages(coarse, gyro, accel, log_ns=times))
    with open_log(log) as opened:
        survey = prepare(opened, ProcessConfig()).survey
    assert (survey.count, survey.time_source) == (COUNT, "log")


def test_two_with_the_same_stamps_are_told(tmp_path):
    """Neither is taken for the repetition of the other."""
    times, gyro, accel = one_sensor()
    both = imu_messages(times, gyro, accel) + imu_messages(times, gyro @ TURN.T, accel @ TURN.T)
    _, kinds = found(tmp_path / "a.mcap", both)
    assert "two-sensors" in kinds and "duplicate-stamps" not in kinds
