"""Sensors of height that hang, and sensors that only seem to."""

import numpy as np
import pytest

from sinstool.methods.height.hangs import hung_rows

RATE = 20.0


def climbs(seed, noise=3.0, step=0.0, seconds=160.0, rest=10.0, level=()):
    """Pressures of climbs and descents after a rest, rounded to a step, Pa, and their times, s."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1.0 / RATE)
    speed = random.uniform(0.5, 4.0, 40) * random.choice([-1.0, 1.0], 40)
    speed = speed[(t / 8.0).astype(int)] * (t >= rest)
    for begin, end in level:
        speed[(t >= begin) & (t < end)] = 0.0
    pressure = 1e5 - 12.0 * np.cumsum(speed) / RATE + noise * random.standard_normal(len(t))
    return t, np.round(pressure / step) * step if step else pressure


def ns(t):
    return np.round(t * 1e9).astype(np.int64)


def hang(t, pressure, begin, end):
    """The same with a sensor that hangs, and which rows repeat."""
    inside = (t >= begin) & (t < end)
    pressure[inside] = pressure[inside][0]
    repeats = inside.copy()
    repeats[np.argmax(inside)] = False
    return repeats


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("step", [0.0, 1.0, 10.0])
def test_a_sensor_that_hangs_and_leaps(seed, step):
    t, pressure = climbs(seed, step=step, level=[(60.0, 70.0)])
    pressure -= 24.0 * np.clip(t - 60.0, 0.0, 8.0)
    pressure = np.round(pressure / step) * step if step else pressure
    repeats = hang(t, pressure, 60.0, 68.0)
    rows = hung_rows(ns(t), pressure)
    # Rounded values may be alike before and after
    assert rows[repeats].all()
    assert np.count_nonzero(rows) <= np.count_nonzero(repeats) + 10 * (step > 0.0)


@pytest.mark.parametrize("seed", range(8))
def test_a_sensor_that_hangs_to_the_end_is_told_by_its_noise_at_rest(seed):
    t, pressure = climbs(seed, step=1.0)
    repeats = hang(t, pressure, 100.0, 200.0)
    assert not hung_rows(ns(t), pressure).any()
    rests = [(0, 10 * 10**9)]
    np.testing.assert_array_equal(hung_rows(ns(t), pressure, rests), repeats)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize(("noise", "step"), [(0.0, 1.0), (0.2, 1.0), (1.0, 10.0), (0.0, 100.0)])
def test_a_coarse_sensor_stays_at_its_value_while_level(seed, noise, step):
    """At rest, and in the midst of climbs, for so long, however rarely."""
    t, pressure = climbs(seed, noise, step, level=[(70.0, 100.0)])
    assert not hung_rows(ns(t), pressure, [(0, 10 * 10**9)]).any()


@pytest.mark.parametrize("seed", range(5))
def test_noise_of_motion_may_cease(seed):
    """The wind that shakes a coarse sensor is gone while the vehicle waits with its engine on."""
    t, pressure = climbs(seed, noise=0.0, level=[(70.0, 100.0)])
    moves = (t > 10.0) & ((t < 70.0) | (t > 100.0))
    pressure += 20.0 * moves * np.random.default_rng(seed).standard_normal(len(t))
    pressure = np.round(pressure / 10.0) * 10.0
    assert not hung_rows(ns(t), pressure, [(0, 10 * 10**9)]).any()


@pytest.mark.parametrize("seed", range(5))
def test_propellers_on_the_ground_are_no_leap(seed):
    """Their pressure comes at once, after a rest of which a coarse sensor shows nothing."""
    t, pressure = climbs(seed, noise=0.0, step=1.0, level=[(70.0, 100.0)])
    pressure[t >= 99.0] += 60.0
    assert not hung_rows(ns(t), pressure, [(0, 10 * 10**9), (70 * 10**9, 99 * 10**9)]).any()


def test_a_driver_that_sends_each_value_again():
    t, pressure = climbs(1)
    pressure = np.repeat(pressure[::10], 10)[: len(t)]
    assert not hung_rows(ns(t), pressure, [(0, 10 * 10**9)]).any()


@pytest.mark.parametrize("values", [[], [1e5], np.full(5000, 1e5), np.full(300, np.nan)])
def test_what_shows_no_change(values):
    t = np.arange(len(values)) / RATE
    assert not hung_rows(ns(t), values, [(0, 10**9)]).any()
