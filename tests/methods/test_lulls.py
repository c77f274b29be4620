"""Stretches of a slow motion are told from rests by how their rate begins and ends."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from sinstool.methods.lulls import lulls

STEP = 0.2
NOISE = np.radians(0.01)


def found(rate, stretches, noise=NOISE, shake=None, joined=None, seed=0):
    """What is said of stretches of a rate, rad/s, with noise of its means."""
    random = np.random.default_rng(seed)
    n = len(rate)
    return lulls(
        rate + noise * random.normal(size=rate.shape),
        np.full(n, noise**2),
        np.full((n, 2), 1e-6) if shake is None else shake,
        np.ones(n, np.bool_) if joined is None else joined,
        stretches,
        STEP,
    )


def slow(seed, seconds=120.0, slowness_s=12.0, size=2.0):
    """A rate that wanders, and its stretches of two seconds that stay within 0.12 deg/s."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, STEP)
    knots = np.arange(-30.0, seconds + 40.0, slowness_s)
    rate = np.radians(size) * CubicSpline(knots, random.normal(size=(len(knots), 3)))(t)
    wide = 10
    quiet = [
        (k, k + wide)
        for k in range(20, len(t) - 20, wide)
        if (rate[k : k + wide].std(axis=0) < np.radians(0.12)).all()
    ]
    return rate, quiet


def still(seed, begin, end, n=200, size=20.0, ease=5):
    """A rest amid vigorous motion, which it comes to within `ease` steps."""
    random = np.random.default_rng(seed)
    gate = np.ones(n)
    gate[begin:end] = 0.0
    gate[begin - ease : begin] = np.linspace(1.0, 0.0, ease)
    gate[end : end + ease] = np.linspace(0.0, 1.0, ease)
    knots = np.arange(-3.0, n * STEP + 4.0, 0.7)
    swing = CubicSpline(knots, random.normal(size=(len(knots), 3)))(np.arange(n) * STEP)
    return np.radians(size) * gate[:, None] * swing + np.radians(random.normal(size=3))


@pytest.mark.parametrize("seed", range(5))
def test_quiet_stretches_of_a_slow_motion_are_lulls(seed):
    stretches = [one for k in range(8) for one in [(slow(seed * 8 + k))]]
    said = [lull for rate, quiet in stretches for lull in found(rate, quiet, seed=seed)]
    assert len(said) > 5, "else this test shows nothing"
    assert np.mean(said) > 0.9


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("length", [10, 25, 100])
def test_a_rest_amid_motion_is_none(seed, length):
    assert found(still(seed, 50, 50 + length), [(50, 50 + length)], seed=seed) == [False]


def test_what_shakes_as_it_moves_off_rests():
    """Its rate goes over as gradually as in a turn, but the vehicle shakes where it moves."""
    t = np.arange(0.0, 20.0, STEP) - 10.0
    rate = np.radians(0.1) * np.column_stack([0.0 * t, 0.0 * t, t**2])
    shake = np.full((len(t), 2), 1e-4)
    assert found(rate, [(44, 56)], shake=shake) == [True]
    shake[(t < -1.2) | (t > 1.2)] *= 5.0
    assert found(rate, [(44, 56)], shake=shake) == [False]


def test_the_end_of_a_log_or_a_gap_says_nothing():
    rate = np.zeros((60, 3))
    assert found(rate, [(0, 60), (20, 40)]) == [False, False]
    rate[40:, 2] = np.radians(0.2) * np.arange(1, 21)
    rate[30:40, 2] = np.radians(0.02) * np.arange(10)
    assert found(rate, [(30, 40)]) == [True]
    joined = np.ones(60, np.bool_)
    joined[40] = False
    assert found(rate, [(30, 40)], joined=joined) == [False]


def test_noise_that_hides_how_the_rate_changes_leaves_it_open():
    """As smooth as the rate is, nothing says that it rests."""
    t = np.arange(0.0, 20.0, STEP) - 10.0
    rate = np.radians(2.0) * np.column_stack([0.0 * t, 0.0 * t, np.abs(t) > 1.1])
    rate[np.abs(t) <= 1.1] = 0.0
    assert found(rate, [(45, 56)]) == [False]
    assert found(rate, [(45, 56)], noise=np.radians(0.5)) == [True]
