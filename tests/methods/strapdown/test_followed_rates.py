"""Rates as a receiver follows them: without vibration, and whatever blocks they come in."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.core.streams import concatenate, take_rows
from sinstool.methods.strapdown.followed_rates import followed_rates, with_followed
from sinstool.methods.strapdown.velocity import Increments


def updates(rate, angle, seconds=2.0):
    """Updates of a body whose angle about each axis is a function of time, s."""
    edges = np.arange(round(rate * seconds) + 1) / rate
    turned = np.diff(angle(edges))[:, None] * np.ones(3)
    count = len(turned)
    time_ns = 10**9 + np.round(edges[1:] * 1e9).astype(np.int64)
    interval = np.full(count, 1.0 / rate)
    return Increments(np.arange(1, count + 1), time_ns, interval, turned, np.zeros((count, 3)))


def followed(made):
    return followed_rates(made.time_ns, made.interval, made.rotation_vector)


@pytest.mark.parametrize("rate", [100.0, 200.0, 400.0])
def test_a_turn_is_left_and_vibration_is_not(rate):
    inner = slice(round(0.1 * rate), round(-0.1 * rate))
    for hertz, least, most in ((1.0, 0.995, 1.005), (5.0, 0.97, 1.01), (27.0, -0.08, 0.08)):
        made = updates(rate, lambda t, w=2.0 * np.pi * hertz: np.sin(w * t) / w)
        ends = (made.time_ns - 10**9) * 1e-9
        true = np.cos(2.0 * np.pi * hertz * ends)[inner]
        left = followed(made)[inner, 0]
        assert least < left @ true / (true @ true) < most
        assert np.abs(left).max() < max(most, 0.1)


def test_a_rate_that_changes_steadily_is_that_of_the_instant():
    made = updates(100.0, lambda t: 0.3 * t + 0.5 * 0.8 * t**2)
    ends = (made.time_ns - 10**9) * 1e-9
    np.testing.assert_allclose(followed(made)[10:-10, 1], (0.3 + 0.8 * ends)[10:-10], rtol=1e-9)


def test_of_slow_samples_it_is_the_mean_of_both_beside():
    made = updates(10.0, lambda t: np.cumsum(np.cos(3.0 * t)))
    rate = made.rotation_vector / made.interval[:, None]
    np.testing.assert_allclose(followed(made)[:-1], 0.5 * (rate[1:] + rate[:-1]), rtol=1e-12)
    np.testing.assert_allclose(followed(made)[-1], rate[-1], rtol=1e-12)


def test_weights_are_those_of_updates_of_any_length():
    """Updates that are alike have theirs from a table."""
    made = updates(200.0, lambda t: np.sin(20.0 * t))
    uneven = replace(made, interval=made.interval * np.where(np.arange(len(made.time_ns)), 1, 1.01))
    inner = slice(20, -20)
    np.testing.assert_allclose(followed(made)[inner], followed(uneven)[inner], rtol=1e-9)


def test_nothing_is_taken_from_beyond_a_gap():
    whole = updates(200.0, lambda t: np.where(t > 1.0, 3.0, 0.5) * (t - 1.0))
    there = np.flatnonzero(np.abs(np.arange(len(whole.time_ns)) - 199.5) > 3)
    rates = followed(take_rows(whole, there))
    np.testing.assert_allclose(rates[: np.count_nonzero(there < 199), 0], 0.5, rtol=1e-9)
    np.testing.assert_allclose(rates[np.count_nonzero(there < 199) :, 0], 3.0, rtol=1e-9)


@pytest.mark.parametrize("size", [1, 3, 64])
def test_blocks_change_no_bit(size):
    random = np.random.default_rng(size)
    made = updates(400.0, lambda t: np.cumsum(random.standard_normal(len(t))), 1.0)
    made = take_rows(made, np.delete(np.arange(400), np.arange(100, 140)))
    pieces = [take_rows(made, slice(k, k + size)) for k in range(0, 360, size)]
    got = list(with_followed((piece, k) for k, piece in enumerate(pieces)))
    assert [k for _, k in got] == list(range(len(pieces)))
    np.testing.assert_array_equal(concatenate([p for p, _ in got]).followed_rate, followed(made))
