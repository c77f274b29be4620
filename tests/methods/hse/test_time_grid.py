import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sinstool.core.streams import Imu
from sinstool.methods.hse.time_grid import filled, time_grids

EPOCH = 1_700_000_000_123_456_789
RATE = 0.7
DT = 0.01


def ns(seconds):
    return EPOCH + np.round(np.asarray(seconds) * 1e9).astype(np.int64)


def turning(seconds):
    """Samples of a rig: what is fixed to the body, and what turns in it."""
    angle = RATE * seconds
    turns = np.stack([np.cos(angle), -np.sin(angle), np.zeros_like(angle)], axis=1)
    gyro = [0.4, -0.4, -0.4] + 6e-5 * turns
    return Imu.of(ns(seconds), gyro, [5.6, 5.6, 5.6] + 0.01 * turns)


def test_late_stamps_do_not_split():
    late = 0.002 * np.arange(7000)
    late[5000] += 1.5e-3  # a step of 1.75 intervals, and the next of a quarter
    assert len(time_grids(ns(late))) == 1


def test_clock_that_does_not_run_evenly_is_told():
    gyro = 0.002 * np.arange(30_000)
    bent = gyro + 1e-3 * (gyro / 60.0) ** 2
    (grid,) = time_grids(ns(bent))
    assert 0.5e-4 < grid.wander_s < 2e-4


@pytest.mark.parametrize("count", [80, 99, 100, 250])
def test_wander_is_seen_in_whole_seconds(count):
    """The largest mean of a second; of less than one there is none."""
    late = 1e-4 * np.random.default_rng(7).standard_normal(count)
    (grid,) = time_grids(ns(0.01 * np.arange(count) + late))
    left = late - np.polyval(np.polyfit(np.arange(count), late, 1), np.arange(count))
    means = [left[k : k + 100].mean() for k in range(0, count - 99, 100)]
    assert grid.wander_s == pytest.approx(np.abs(means).max() if means else 0.0, abs=2e-9)
    assert grid.jitter_s == pytest.approx(np.sqrt(np.mean(left**2)), abs=2e-9)


@given(st.data())
def test_every_short_gap_is_filled(data):
    whole = turning(DT * np.arange(400))
    gaps = data.draw(st.lists(st.tuples(st.integers(25, 370), st.integers(1, 9)), max_size=5))
    keep = np.ones(400, bool)
    for first, length in gaps:
        keep[first : first + length] = False
    runs = np.diff(np.flatnonzero(keep)) - 1
    samples, made = filled(whole.rows(keep))
    # neighbouring gaps may have joined to long ones, which stay
    assert np.count_nonzero(made) == runs[runs <= 10].sum()
    for name in ("time_ns", "gyro", "accel"):
        np.testing.assert_array_equal(
            getattr(samples, name)[~made], getattr(whole.rows(keep), name)
        )
    rows = np.round((samples.time_ns - EPOCH) / (1e9 * DT)).astype(int)
    assert np.abs(samples.time_ns - whole.time_ns[rows]).max() <= 10
    # (w T)^2 / 8 of what turns, over 0.11 s
    assert np.abs(samples.gyro - whole.gyro[rows]).max() < 6e-5 * (RATE * 0.11) ** 2 / 7
    assert np.abs(samples.accel - whole.accel[rows]).max() < 0.01 * (RATE * 0.11) ** 2 / 7
    assert len(time_grids(samples.time_ns)) == 1 + np.count_nonzero(runs > 10)


@pytest.mark.parametrize("seed", range(5))
def test_gaps_are_counted_right_where_stamps_jitter_and_gaps_are_close(seed):
    random = np.random.default_rng(seed)
    keep = np.ones(3000, bool)
    keep[random.integers(50, 2950, 60)] = False
    stamps = DT * np.arange(3000) + 0.1 * DT * random.standard_normal(3000)
    samples, made = filled(turning(np.maximum.accumulate(stamps)[keep]))
    assert len(samples) == 3000
    np.testing.assert_array_equal(made, ~keep)


def test_long_gaps_stay_open():
    keep = np.ones(400, bool)
    keep[100:111] = False
    samples, made = filled(turning(DT * np.arange(400)[keep]))
    assert not made.any() and len(samples) == 389
    assert len(filled(turning(np.empty(0)))[0]) == 0
