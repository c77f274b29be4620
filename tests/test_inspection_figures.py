"""What the page of a log is drawn from: intervals, steps back, rates of topics."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sinstool.inspection_figures import BINS, FIRST_BIN_NS, Sampling, Traffic
from sinstool.streams import Imu

START = 1_700_000_000_000_000_000


def sampled(steps_ms, blocks=1, delay_ms=0.0):
    """A sampling that saw stamps with these steps, in so many blocks."""
    steps = np.round(np.asarray(steps_ms) * 1e6).astype(np.int64)
    times = START + np.concatenate([[0], np.cumsum(steps)])
    n = len(times)
    log_times = times + np.round(delay_ms * 1e6 * np.ones(n)).astype(np.int64)
    gyro, accel = np.tile([0.1, 0.2, 0.3], (n, 1)), np.tile([1.0, 2.0, -9.8], (n, 1))
    imu = Imu(times, log_times, gyro, accel)
    made = Sampling("/imu", "flu")
    parts = [imu.rows(slice(a[0], a[-1] + 1)) for a in np.array_split(np.arange(n), blocks)]
    assert sum(len(block) for block in made.watch(iter(parts))) == n
    return made


@given(st.lists(st.floats(0.5, 50.0), min_size=5, max_size=60), st.integers(1, 5))
@settings(deadline=None)
def test_intervals_do_not_depend_on_blocks(steps, blocks):
    whole, cut = sampled(steps), sampled(steps, blocks)
    for a, b in zip(whole.curves(START), cut.curves(START), strict=True):
        np.testing.assert_array_equal(a, b)
    shown = whole.curves(START)[1][:, 0]
    np.testing.assert_allclose(shown[np.isfinite(shown)], np.round(np.array(steps), 6), atol=2e-6)


def test_steps_back_are_kept_and_no_interval_is_negative():
    made = sampled([10, 10, -25, 10, 10, 40], blocks=3, delay_ms=3.0)
    assert made.back == [(START + 20_000_000, 25.0)]
    shown = made.curves(START)[1][:, 0]
    assert np.nanmin(shown) == 10.0 and np.nanmax(shown) == 40.0
    assert made.least_delay_ns == 3_000_000


def test_values_are_in_the_log_s_own_axes():
    values = sampled([10] * 4).curves(START)[1]
    # given in FRD, shown in FLU: y and z turn about
    np.testing.assert_allclose(values[0, 2:5], np.degrees([0.1, -0.2, -0.3]))
    np.testing.assert_allclose(values[0, 5:8], [1.0, -2.0, 9.8])
    np.testing.assert_allclose(values[0, 8], np.sqrt(1.0 + 4.0 + 9.8**2))


def test_shares_count_every_interval_once():
    steps = np.concatenate([np.full(900, 10.0), np.full(90, 10.5), np.full(9, 9.5), [5000.0]])
    middles, counts, outside = sampled(np.random.default_rng(1).permutation(steps)).shares()
    assert counts.sum() + outside == 1000 and outside >= 1
    assert counts.max() == 900 and abs(middles[np.argmax(counts)] - 10.0) < 0.1
    assert counts[np.abs(middles - 10.5) < 0.06].sum() == 90


def test_nothing_is_kept_of_a_reading_that_begins_again():
    made = sampled([10, -5, 10])
    again = Imu(*(np.arange(4) * 20_000_000 + START,) * 2, np.zeros((4, 3)), np.ones((4, 3)))
    list(made.watch(iter([again])))
    assert made.back == [] and np.nanmax(made.curves(START)[1][:, 0]) == 20.0


@pytest.mark.parametrize("seconds", [30.0, 4000.0])
def test_rates_of_topics(seconds):
    traffic = Traffic()
    times = {}
    for topic, hertz in (("/fast", 100.0), ("/slow", 2.0)):
        at = START + np.arange(int(seconds * hertz)) * round(1e9 / hertz)
        # silent for a fifth of the time
        late = (at - START) / 1e9
        times[topic] = at[(late < 0.4 * seconds) | (late >= 0.6 * seconds)]
    order = np.array_split(times["/fast"], 20)
    for k, part in enumerate(np.array_split(times["/slow"], 20)):
        traffic.add("/fast", order[k])
        traffic.add("/slow", part)
    assert traffic.width_ns < max(2 * seconds * 1e9 / BINS, 2 * FIRST_BIN_NS)
    found = {topic: (at, rate) for topic, at, rate in traffic.rates()}
    for topic, hertz in (("/fast", 100.0), ("/slow", 2.0)):
        at, rate = found[topic]
        width = at[1] - at[0]
        inside = (np.abs(at - 0.5 * seconds) > 0.1 * seconds + width) & (at > width)
        inside &= at < seconds - width
        np.testing.assert_allclose(rate[inside], hertz, rtol=0.06)
        silent = np.abs(at - 0.5 * seconds) < 0.1 * seconds - width
        assert np.isnan(rate[silent]).all()


def test_too_few_messages_have_no_rate():
    traffic = Traffic()
    traffic.add("/once", np.array([START]))
    assert list(traffic.rates()) == []
