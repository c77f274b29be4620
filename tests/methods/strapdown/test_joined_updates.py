"""Updates joined to longer ones."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sinstool.core import rotation
from sinstool.core.streams import concatenate, take_rows
from sinstool.methods.strapdown.joined_updates import joined_blocks, joined_updates
from sinstool.methods.strapdown.navigation import initial_state
from sinstool.methods.strapdown.velocity import Increments
from tests.methods.strapdown.navigator import Navigator


def updates(count, hertz, gaps=(), seed=0):
    """Updates of a body that turns and shakes by 5 m/s^2, some of them a second late."""
    random = np.random.default_rng(seed)
    interval = np.full(count, 1.0 / hertz)
    late = np.zeros(count)
    late[list(gaps)] = 1.0
    time_ns = np.round(1e9 * np.cumsum(interval + late)).astype(np.int64)
    return Increments(
        np.arange(count),
        time_ns,
        interval,
        random.normal(0.0, 2.0 / hertz, (count, 3)),
        random.normal((0.0, 0.0, -9.8 / hertz), 5.0 / hertz, (count, 3)),
    )


def navigated(made):
    state = initial_state(0.8, 0.1, 300.0, [3.0, -2.0, 0.5], rotation.from_euler([0.1, -0.2, 2.0]))
    run = Navigator(state)
    return run.push(made.rotation_vector, made.velocity_increment, made.interval).rows[-1]


@pytest.mark.parametrize("hertz, joined", [(128.0, 2), (200.0, 3), (400.0, 7)])
def test_the_same_navigation_with_fewer_updates(hertz, joined):
    every = updates(round(10.5 * hertz), hertz)
    fewer = joined_updates(every, 0.02)
    assert len(fewer.interval) == -(-len(every.interval) // joined)
    assert fewer.interval.max() < 0.02
    assert fewer.interval.sum() == pytest.approx(every.interval.sum(), rel=1e-14)
    np.testing.assert_array_equal(fewer.time_ns, every.time_ns[fewer.sample])
    assert fewer.sample[-1] == every.sample[-1]
    one, other = navigated(every), navigated(fewer)
    # rad, m, m/s, and a quaternion
    assert np.abs(one - other)[:2].max() < 0.02 / 6.4e6
    assert np.abs(one - other)[2] < 0.02
    assert np.abs(one - other)[3:6].max() < 1e-4
    assert np.abs(one - other)[6:].max() < 1e-8


def test_nothing_is_joined_across_a_gap():
    every = updates(20, 200.0, gaps=(4, 5, 13))
    fewer = joined_updates(every, 0.02)
    np.testing.assert_array_equal(fewer.sample, [2, 3, 4, 7, 10, 12, 15, 18, 19])
    begins = fewer.time_ns - np.round(1e9 * fewer.interval).astype(np.int64)
    gaps = begins[1:] - fewer.time_ns[:-1]
    assert np.flatnonzero(gaps > 1_000_000).tolist() == [1, 2, 5]


@given(st.integers(0, 2**32 - 1), st.sampled_from([50.0, 128.0, 200.0, 1000.0]))
def test_an_update_in_which_a_fix_lies_stays_as_it_is(seed, hertz):
    random = np.random.default_rng(seed)
    every = updates(300, hertz, seed=seed % 1000)
    seen_ns = np.sort(random.integers(every.time_ns[0], every.time_ns[-1], 6))
    ends = random.choice(every.time_ns, 3)
    fewer = joined_updates(every, 0.1, np.sort(np.concatenate([seen_ns, ends])))
    assert np.isin(ends, fewer.time_ns).all()
    assert fewer.interval.max() < 0.1 and len(fewer.time_ns) < len(every.time_ns)
    assert fewer.interval.sum() == pytest.approx(every.interval.sum(), rel=1e-12)
    near = np.abs(np.subtract.outer(seen_ns, every.time_ns)).min(axis=1)
    alone = np.searchsorted(every.time_ns, seen_ns[near > 0.02e9 / hertz])
    row = np.searchsorted(fewer.time_ns, every.time_ns[alone])
    np.testing.assert_array_equal(fewer.time_ns[row], every.time_ns[alone])
    np.testing.assert_allclose(fewer.rotation_vector[row], every.rotation_vector[alone], atol=1e-12)


def test_updates_of_which_no_two_fit_stay_as_they_are():
    for interval in (0.01, 0.0100002, 0.0099998, 0.05):
        every = updates(10, 1.0 / interval)
        assert joined_updates(every, 0.02) is every


@given(st.integers(0, 1000), st.lists(st.integers(1, 199), max_size=6))
def test_it_does_not_matter_where_blocks_end(seed, cuts):
    """Updates were joined within a block, so that the last of each was a shorter one."""
    random = np.random.default_rng(seed)
    every = updates(200, 100.0, gaps=random.integers(1, 200, 3), seed=seed)
    begin_ns = every.time_ns - 10_000_000
    row = random.integers(0, 200, 8)
    seen_ns = np.sort(begin_ns[row] + random.integers(1, 10, 8) * 1_000_000)
    edges = [0, *sorted(set(cuts)), 200]
    blocks = [take_rows(every, slice(a, b)) for a, b in pairwise(edges)]
    made = concatenate(list(joined_blocks(blocks, 0.05, seen_ns)))
    whole = joined_updates(every, 0.05, seen_ns)
    np.testing.assert_array_equal(made.time_ns, whole.time_ns)
    for name in ("sample", "interval", "rotation_vector", "velocity_increment"):
        # But for rounding: several at a time are computed otherwise than one
        np.testing.assert_allclose(getattr(made, name), getattr(whole, name), atol=1e-15)
