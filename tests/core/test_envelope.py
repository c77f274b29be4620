"""Curves in bounded memory: no peak is lost, no block edge shows, no gap is drawn over."""

import numpy as np
import pytest

from sinstool.core.envelope import Envelope

T0 = 1_700_000_000_000_000_000


def rows(n, seed=0):
    values = np.random.default_rng(seed).standard_normal((n, 2)).cumsum(axis=0)
    return T0 + np.arange(n, dtype=np.int64) * 10_000_000, values


def envelope_of(time_ns, values, size, groups=16):
    result = Envelope(values.shape[1], groups)
    for k in range(0, len(values), size):
        result.push(time_ns[k : k + size], values[k : k + size])
    return result


@pytest.mark.parametrize("n", [1, 15, 32, 33, 1000, 4097])
def test_block_edges_do_not_matter(n):
    whole = envelope_of(*rows(n), n)
    for size in (1, 7, 300):
        again = envelope_of(*rows(n), size)
        for one, other in zip(whole.groups(), again.groups(), strict=True):
            np.testing.assert_array_equal(one, other)
    assert len(whole.groups()[0]) <= 33


def test_every_group_has_its_extremes():
    time_ns, values = rows(5000)
    values[1234, 0], values[4321, 1] = 1e3, -1e3
    result = envelope_of(time_ns, values, 61)
    times, low, high, first = result.groups()
    size = result.rows_per_group
    assert size > 100
    for k, (begin, end) in enumerate(times):
        inside = (time_ns >= begin) & (time_ns <= end)
        assert inside.sum() == size or k == len(times) - 1
        np.testing.assert_array_equal(low[k], values[inside].min(axis=0))
        np.testing.assert_array_equal(high[k], values[inside].max(axis=0))
        np.testing.assert_array_equal(first[k], values[inside][0])
    seconds, curve = result.curves(T0)
    assert np.all(np.diff(seconds) >= 0.0)
    assert np.nanmax(curve[:, 0]) == 1e3 and np.nanmin(curve[:, 1]) == -1e3


def test_few_rows_are_drawn_as_they_are():
    time_ns, values = rows(20)
    seconds, curve = envelope_of(time_ns, values, 3).curves(T0)
    np.testing.assert_allclose(seconds, (time_ns - T0) * 1e-9)
    np.testing.assert_array_equal(curve, values)


def test_nothing_is_drawn_over_a_gap_nor_where_nothing_is():
    time_ns, values = rows(4000)
    time_ns[2500:] += 30 * 10**9
    values[100:140, 1] = np.nan
    seconds, curve = envelope_of(time_ns, values, 77).curves(T0)
    hole = np.flatnonzero(np.isnan(curve[:, 0]))
    assert len(hole) == 1
    assert seconds[hole[0] + 1] - seconds[hole[0] - 1] > 25.0
    assert np.isfinite(curve[:, 1]).sum() >= np.isfinite(curve[:, 0]).sum() - 4


@pytest.mark.parametrize("slope", [1.0, -1.0])
def test_a_straight_curve_has_no_teeth(slope):
    envelope = Envelope(1, groups=10)
    times = T0 + np.arange(1000, dtype=np.int64)
    envelope.push(times, slope * np.arange(1000.0)[:, None])
    assert envelope.rows_per_group > 1
    _, values = envelope.curves(T0)
    assert np.all(slope * np.diff(values[:, 0]) > 0.0)


@pytest.mark.parametrize("n", [33, 34, 1001, 1003, 4097, 5000])
def test_a_curve_ends_at_the_last_row(n):
    """Of 2301 rows in pairs the last was two points; of others the last one was an extreme."""
    time_ns, values = rows(n)
    envelope = envelope_of(time_ns, values, 50)
    seconds, curve = envelope.curves(T0)
    assert seconds[-1] == pytest.approx((time_ns[-1] - T0) * 1e-9)
    np.testing.assert_array_equal(curve[-1], values[-1])
    if n == 33 and envelope.rows_per_group == 2:
        assert len(curve) == n
