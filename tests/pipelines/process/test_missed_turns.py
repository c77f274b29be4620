"""Turns that gyros miss, which gravity shows at the next rest."""

import numpy as np
import pytest

from tests.pipelines.process.test_smoothing import BIAS, RATE, hand, smoothed


def hung(seed, at_s, seconds, rate=(0.15, -0.14, 0.21)):
    """A hand with a rest at either end, whose gyros give one rate for a while."""
    log = hand(seconds=60.0, seed=seed, rest=(8.0, 10.0), bias=0.2 * BIAS)
    hangs = slice(int(at_s * RATE), int((at_s + seconds) * RATE))
    noise = 2e-3 * np.random.default_rng(seed).standard_normal(log.gyro[hangs].shape)
    log.gyro[hangs] = np.array(rate) + noise
    return log


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("at_s", [12.0, 40.0])
def test_a_rest_after_gyros_that_hang_shows_the_vertical(tmp_path, seed, at_s):
    """Unlike an acceleration, it does not add to gravity, so it is no travel of a vehicle."""
    summary, off, covariance = smoothed(tmp_path, hung(seed, at_s, 1.5))
    off, sigma = np.degrees(off), np.degrees(np.sqrt(np.einsum("nii->ni", covariance)))[:, :2]
    assert np.abs(off[-500:]).max() < 1.0
    assert np.sqrt(np.mean((off / sigma) ** 2)) < 1.2
    missed = {one["kind"]: one for one in summary["findings"]}["missed-turn"]
    assert missed["severity"] == "lost"
    assert missed["numbers"]["times"] == 1
    # gravity does not show what was missed of heading
    angle = missed["numbers"]["angle_deg"]
    assert min(angle, 100.0) < np.degrees(np.sqrt(covariance[-1, 2, 2])) < 104.0


def test_a_hand_whose_gyros_measure_all_has_missed_no_turn(tmp_path):
    log = hand(seconds=60.0, seed=4, rest=(8.0, 10.0), bias=0.2 * BIAS)
    summary, _, _ = smoothed(tmp_path, log)
    assert "missed-turn" not in {one["kind"] for one in summary["findings"]}
