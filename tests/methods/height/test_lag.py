"""By how much heights lag behind an accelerometer, and when that is not said."""

import numpy as np
import pytest

from sinstool.core.timeline import SECOND
from sinstool.methods.height.lag import GRID_NS, height_lag

T0 = 1_700_000_000 * SECOND


def flown(
    seed,
    late=0.0,
    noise=0.3,
    speed=3.0,
    slow=0.0,
    seconds=200.0,
    drift=0.02,
    rate=20.0,
    change_s=2.0,
):
    """Arguments of `height_lag` for climbs and descents of some seconds each."""
    random = np.random.default_rng(seed)
    fine = np.arange(-20.0, seconds, 0.01)
    steps = random.uniform(-speed, speed, 60)[((fine + 20.0) / 7.0).astype(int)]
    width = round(100 * change_s)
    climb = np.convolve(steps, np.full(width, 1.0 / width), mode="same")
    height = np.cumsum(climb) * 0.01
    if slow:
        kernel = np.exp(-np.arange(0.0, 8.0 * slow, 0.01) / slow)
        height = np.convolve(height, kernel / kernel.sum())[: len(fine)]
    at = np.arange(0.0, seconds - 0.1, GRID_NS / SECOND)
    felt = np.interp(at, fine, climb) + drift * at
    times = np.arange(0.0, seconds - 0.1, 1.0 / rate)
    shown = np.interp(times - late, fine, height) + noise * random.standard_normal(len(times))
    stamps = T0 + np.round(times * SECOND).astype(np.int64)
    return T0, felt, np.ones(len(at), bool), stamps, shown


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("late", [1.0, 3.0, 7.0])
def test_stamps_that_are_late(seed, late):
    lag = height_lag(*flown(seed, late))
    assert lag.seconds == pytest.approx(late, abs=0.1)
    assert 1.0 * late < lag.metres < 4.0 * late


@pytest.mark.parametrize("seed", range(6))
def test_a_slow_sensor(seed):
    """It follows quick climbs less than slow ones, and was taken for one that is late by less."""
    assert height_lag(*flown(seed, slow=2.0)).seconds == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("kind", ["late", "slow"])
def test_gentle_climbs(seed, kind):
    """The noise of their rates hid a lag of a second and a half."""
    lag = height_lag(*flown(seed, noise=0.4, speed=4.0, change_s=8.0, seconds=280.0, **{kind: 1.5}))
    assert lag.seconds == pytest.approx(1.5, abs=0.35)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("spoilt", [{}, {"noise": 3.0}, {"speed": 0.1}, {"drift": 0.3}])
def test_a_sensor_that_is_not_late(seed, spoilt):
    assert height_lag(*flown(seed, **spoilt)) is None


@pytest.mark.parametrize("seed", range(6))
def test_jumps_gaps_and_another_motion(seed):
    first, felt, known, stamps, shown = flown(seed, 2.0)
    jumped = shown + 30.0 * (np.arange(len(shown)) > 2000)
    assert height_lag(first, felt, known, stamps, jumped).seconds == pytest.approx(2.0, abs=0.1)
    keep = (stamps < T0 + 60 * SECOND) | (stamps > T0 + 80 * SECOND)
    lag = height_lag(first, felt, known, stamps[keep], shown[keep])
    assert lag.seconds == pytest.approx(2.0, abs=0.1)
    assert height_lag(first, flown(seed + 100)[1], known, stamps, shown) is None
    assert height_lag(first, felt, ~known, stamps, shown) is None
    assert height_lag(first, felt[:300], known[:300], stamps, shown) is None
    assert height_lag(first, felt, known, stamps[:1], shown[:1]) is None
