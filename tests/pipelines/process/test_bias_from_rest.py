"""Attitude alone: a rest anywhere in the log shows the gyro's bias."""

import numpy as np
import pytest

from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.pipelines.process.run import process
from tests.helpers.filter_logs import Capture
from tests.helpers.imulogs import angles_between, even_times, handheld, imu_log, in_log_axes

RATE = 100.0
BIAS = np.radians([1.5, -2.5, 3.3])  # 4.4 deg/s


def in_the_hand(path, seed, moving_s, still_s, moving_first):
    """A log that moves and then is still, or the other way round but for a moment; truth."""
    moving, still = round(moving_s * RATE), round(still_s * RATE)
    gyro, accel, attitude = handheld(moving, rate=RATE, seed=seed, size=0.5)
    random = np.random.default_rng(seed)
    noise = random.standard_normal((2, still, 3)) * [[[2e-3]], [[0.02]]]
    at = -1 if moving_first else 0
    rest = noise[0], attitude[at].inv().apply([0.0, 0.0, 9.80665]) + noise[1]
    parts = [(gyro, accel), rest] if moving_first else [rest, (gyro, accel)]
    gyro, accel = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    if not moving_first:  # begun with a jolt, so that the rest is not the beginning
        gyro[:40] += random.standard_normal((40, 3)) * 0.5 * (-1.0) ** np.arange(40)[:, None]
        accel[:40] += random.standard_normal((40, 3))
    count = moving + still
    imu_log(path, even_times(count, RATE), gyro + BIAS, accel)
    held = [attitude[at]] * still
    truth = [*attitude, *held] if moving_first else [*held, *attitude]
    return type(attitude).concatenate(truth)


@pytest.mark.parametrize("moving_first", [True, False])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_rest_that_is_not_the_beginning_is_used_and_said(tmp_path, seed, moving_first):
    log = tmp_path / "log.mcap"
    truth = in_the_hand(log, seed, 2.5 if moving_first else 30.0, 60.0, moving_first)
    options = {"output": {"only_results": True}, "navigation": {"attitude": "inertial"}}
    config = build(ProcessConfig, options)
    capture = Capture()
    result = process(log, tmp_path / "out.mcap", config, None, capture)
    assert result.alignment.gyro_bias_source == "rest"
    assert any("longest rest" in finding.text for finding in result.findings)
    np.testing.assert_allclose(
        result.alignment.gyro_bias_rad_s, BIAS * [1.0, -1.0, -1.0], atol=np.radians(0.05)
    )
    solution = capture.solution
    turned = in_log_axes(solution.q_nb)
    # heading and the first tilt are not known: what is turned since the first second counts
    first = round(1.0 * RATE)
    off = (turned[first] * truth[first].inv()) * truth
    assert np.degrees(angles_between(off.as_quat(), turned)[first:].max()) < 3.0
