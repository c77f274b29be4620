"""Velocities that a receiver smooths: how it does is found, and undone."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from sinstool.core.streams import GnssEpochs
from sinstool.methods.ins_gnss.smoothed_velocity import delay, smoothing, unsmoothed
from tests.helpers.unseen_drives import RATE, band_noise

STEP = 1.0 / RATE


def moving(seed, highest, duration=300.0):
    """Times, s, and velocities that change with up to so many Hz."""
    random = np.random.default_rng(seed)
    seconds = np.arange(0.0, duration, STEP)
    return seconds, 2.0 * band_noise(random, seconds, 0.01, highest)


def lowpassed(velocity, time_s):
    gain = -np.expm1(-STEP / time_s)
    return lfilter([gain], [1.0, gain - 1.0], velocity - velocity[0], axis=0) + velocity[0]


def nanoseconds(seconds):
    return np.round(np.asarray(seconds) * 1e9).astype(np.int64)


def shown(seed, made, rate, latency=0.0, noise=0.05, highest=0.4):
    """What is found of velocities made of true ones, beside a navigation that wanders slowly."""
    seconds, velocity = moving(seed, highest)
    random = np.random.default_rng([seed, 1])
    at = np.arange(2.0, seconds[-1], 1.0 / rate)
    theirs = made(velocity)[np.round((at - latency) / STEP).astype(int)]
    theirs = theirs + noise * random.standard_normal(theirs.shape)
    wander = 0.5 * np.sin(seconds / 40.0 + np.arange(3)[:, None]).T
    return smoothing(nanoseconds(seconds), velocity + wander, nanoseconds(at), theirs)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("latency", [0.0, 0.2])
@pytest.mark.parametrize("rate", [2.0, 5.0, 10.0])
@pytest.mark.parametrize("time_s", [0.3, 0.6, 1.0])
def test_the_time_constant(time_s, rate, latency, seed):
    found = shown(seed, lambda v: lowpassed(v, time_s), rate, latency)
    assert found.time_s == pytest.approx(time_s, rel=0.1)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("latency", [0.0, 0.1, 0.4, 0.8])
@pytest.mark.parametrize("rate", [1.0, 5.0])
def test_late_velocities_are_not_smoothed(rate, latency, seed):
    assert shown(seed, lambda v: v, rate, latency).time_s == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_differences_of_positions_are_not_smoothed(seed):
    def means(velocity):
        total = np.cumsum(velocity, axis=0)
        return (total - np.roll(total, round(RATE), axis=0)) / RATE

    assert shown(seed, means, 1.0).time_s == 0.0


def test_little_motion_shows_nothing():
    found = shown(1, lambda v: 0.01 * lowpassed(v, 0.6), 5.0)
    assert found.time_s == 0.0
    seconds, velocity = moving(1, 0.4, 20.0)
    assert smoothing(nanoseconds(seconds), velocity, nanoseconds(seconds[::20]), velocity[::20]) \
        .time_s == 0.0  # fmt: skip


@pytest.mark.parametrize("seed", range(3))
def test_what_moves_within_an_interval_cannot_be_undone(seed):
    def made(velocity):
        return lowpassed(velocity, 0.6)

    assert shown(seed, made, 5.0, highest=0.3).undoable
    assert not shown(seed, made, 2.0, highest=0.9, noise=0.02).undoable


def epochs(seconds, velocity):
    n = len(seconds)
    one, three = np.zeros(n), np.ones((n, 3))
    time_ns = nanoseconds(seconds)
    return GnssEpochs(time_ns, time_ns, one, one, one, velocity, three, three)


@given(
    st.floats(0.05, 3.0),
    st.floats(0.1, 2.0),
    st.lists(st.floats(0.9, 1.1), min_size=3, max_size=20),
    st.integers(0, 1000),
)
def test_undone_it_is_what_was_smoothed(time_s, interval, uneven, seed):
    """Of any velocities at about even times, by the definition of the low-pass."""
    steps = np.round(interval * np.array(uneven), 9)
    before = np.random.default_rng(seed).normal(size=(len(steps), 3))
    velocity = [np.array([1.0, -2.0, 0.5])]
    for step, mean in zip(steps, before, strict=True):
        keep = np.exp(-step / time_s)
        velocity.append(keep * velocity[-1] + (1.0 - keep) * mean)
    gnss = epochs(np.concatenate([[0.0], np.cumsum(steps)]), np.array(velocity))
    found = unsmoothed(gnss, time_s).velocity_n
    assert np.isnan(found[0]).all()
    np.testing.assert_allclose(found[1:], before, atol=1e-4)


@pytest.mark.parametrize(("time_s", "interval"), [(0.3, 1.0), (1.0, 0.2), (2.0, 0.1)])
def test_the_delay_is_that_of_a_steady_acceleration(time_s, interval):
    """A low-pass of first order is late by its time constant then."""
    seconds = interval * np.arange(30.0)
    velocity = np.outer(seconds - time_s, [3.0, -1.0, 0.2])
    gnss = epochs(seconds, velocity)
    found = unsmoothed(gnss, time_s).velocity_n[1:]
    late = delay(gnss, time_s)
    np.testing.assert_allclose(found, np.outer(seconds[1:] - late, [3.0, -1.0, 0.2]), atol=1e-6)


def test_velocities_that_are_not_smoothed_stay():
    gnss = epochs(np.arange(5.0), np.ones((5, 3)))
    assert unsmoothed(gnss, 0.0) is gnss


def test_after_a_lost_velocity_there_is_none():
    seconds = np.delete(np.arange(20.0), [7, 12, 13])
    velocity = np.column_stack([seconds, seconds, seconds])
    velocity[3] = np.nan
    gnss = epochs(seconds, velocity)
    known = unsmoothed(gnss, 0.5).has_velocity
    missing = {0.0, 3.0, 4.0, 8.0, 14.0}
    assert {t for t, there in zip(seconds, known, strict=True) if not there} == missing
