"""Clocks of receivers that run faster or slower than the IMU's."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sinstool.core.streams import GnssEpochs
from sinstool.methods.ins_gnss.clock_rate import STEADY, USUAL_RATE, ClockRate, clock_rate
from sinstool.methods.ins_gnss.offset_scores import OffsetScores

SECOND = 10**9
T0 = 1_700_000_000 * SECOND


def scores(rate, latency=0.05, count=1800, seed=1, speed=15.0, sigma=0.05):
    """Of epochs whose fixes are late by so much along the track, beside the middle's latency."""
    random = np.random.default_rng(seed)
    seconds = np.arange(count, dtype=float)
    b = latency + rate * (seconds - seconds.mean())
    # What a second of latency moves a fix by, and metres of arm, relative to its noise
    h = np.stack([speed * random.standard_normal(count), *np.ones((3, count))], axis=1) / sigma
    h[:, 1:] *= random.choice([-1.0, 1.0], (count, 3))
    innovation = h[:, 0] * b + random.standard_normal(count)
    return OffsetScores(
        (seconds * SECOND).astype(np.int64),
        h[:, :, None] * h[:, None, :],
        h * innovation[:, None],
        innovation**2,
        np.ones(count),
        np.zeros((count, 3, 4, 4)),
        np.zeros((count, 2)),
        np.ones(count, bool),
        np.zeros(count, bool),
    )


@pytest.mark.parametrize("rate", [4e-5, -1.5e-4])
def test_rates_are_found_to_their_sigmas(rate):
    found = [clock_rate(scores(rate, seed=seed)) for seed in range(20)]
    errors = np.array([(one.rate - rate) / one.sigma for one in found])
    assert all(one.significant for one in found)
    assert 0.6 < np.sqrt(np.mean(errors**2)) < 1.4


def test_clocks_that_run_together_show_no_rate():
    assert not any(clock_rate(scores(0.0, seed=seed)).significant for seed in range(20))


def test_without_information_the_rate_is_that_of_usual_crystals():
    found = clock_rate(scores(1e-3, count=40, sigma=1e6))
    assert abs(found.rate) < 1e-3 * USUAL_RATE
    assert found.sigma == pytest.approx(USUAL_RATE, rel=1e-3)


def test_a_rate_has_its_time_and_span():
    some = scores(4e-5)
    found = clock_rate(replace(some, time_ns=some.time_ns + T0))
    assert found.middle_ns == T0 + 1799 * SECOND // 2
    assert found.span_s == 1799.0
    off = found.sigma * (np.linspace(0.0, found.span_s, 10_000) - 0.5 * found.span_s)
    assert found.spread_s == pytest.approx(np.sqrt(np.mean(off**2)), rel=1e-3)


def test_a_rate_that_hardly_changes_the_latency_is_none():
    assert not ClockRate(2e-5, 1e-7, 0, 400.0).significant
    assert ClockRate(2e-5, 1e-7, 0, 1000.0).significant
    assert not STEADY.significant


@settings(max_examples=40, deadline=None)
@given(
    rate=st.floats(-1e-3, 1e-3),
    left=st.floats(-1e-5, 1e-5),
    seconds=st.lists(st.integers(0, 7200), min_size=2, max_size=30, unique=True).map(sorted),
)
def test_stamps_are_corrected(rate, left, seconds):
    time_ns = np.array(seconds, np.int64) * SECOND
    n = len(time_ns)
    fixes = GnssEpochs(time_ns, time_ns, *np.zeros((3, n)), *np.zeros((3, n, 3)))
    first = ClockRate(rate, 1e-6, 3600 * SECOND, 7200.0)
    both = first.plus(ClockRate(left, 1e-6, 3600 * SECOND, 7200.0))
    once, then = first.corrected(fixes), both.corrected(fixes)
    late = (time_ns - once.time_ns) * 1e-9
    assert late == pytest.approx([first.latency_at(int(t)) for t in time_ns], abs=2e-9)
    assert np.all(np.diff(once.time_ns) > 0)
    assert then.time_ns - time_ns == pytest.approx(
        -(rate + left) * (time_ns - 3600 * SECOND), abs=2.0
    )
    assert first.plus(STEADY) == first
