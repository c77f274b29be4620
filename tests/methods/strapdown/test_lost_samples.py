"""What lost samples do to increments, and how well that is known."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from sinstool.core.streams import concatenate, take_rows
from sinstool.methods.strapdown.joined_updates import joined_updates
from sinstool.methods.strapdown.lost_samples import LostSamples
from sinstool.methods.strapdown.velocity import Increments

HERTZ = 50.0


def rough(seed, count=20000):
    """Mean rates and forces of a rough road, with resonances of 2 to 12 Hz, shape (n, 6)."""
    random = np.random.default_rng(seed)
    seconds = np.arange(count) / HERTZ
    out = np.zeros((count, 6))
    for column in range(6):
        for hertz in random.uniform(2.0, 12.0, 4):
            phase = 2.0 * np.pi * hertz * seconds + np.cumsum(random.normal(0.0, 0.2, count))
            out[:, column] += random.uniform(0.02, 0.2) * np.sin(phase + random.uniform(0.0, 6.0))
    return out


def updates(rates, kept):
    """Increments over means that were kept; lost ones are as those beside them."""
    rows = np.flatnonzero(kept)
    lost = np.diff(rows)[:, None] - 1
    interval = np.diff(rows) / HERTZ
    beside = 0.5 * (rates[rows[1:]] + rates[rows[:-1]])
    means = (rates[rows[1:]] + lost * beside) / HERTZ
    time_ns = np.round(1e9 * rows[1:] / HERTZ).astype(np.int64)
    return Increments(np.arange(len(rows) - 1), time_ns, interval, means[:, :3], means[:, 3:])


def lossy(seed, share, run=1):
    """Increments with lost samples, and what was lost of each, shape (n, 6)."""
    rates = rough(seed)
    random = np.random.default_rng([seed, 1])
    kept = np.ones(len(rates), bool)
    for k in np.flatnonzero(random.random(len(rates)) < share / run):
        kept[k : k + run] = False
    kept[[0, -1]] = True
    made = updates(rates, kept)
    whole = updates(rates, np.ones(len(rates), bool))
    sums = np.zeros((len(rates), 6))
    sums[1:] = np.cumsum(np.hstack([whole.rotation_vector, whole.velocity_increment]), axis=0)
    true = np.diff(sums[np.flatnonzero(kept)], axis=0)
    return made, true - np.hstack([made.rotation_vector, made.velocity_increment])


def stage():
    return LostSamples(1.0 / HERTZ, 1.0 / HERTZ)


@pytest.mark.parametrize("run", [1, 2])
@pytest.mark.parametrize("seed", range(3))
def test_variances_are_those_of_what_was_lost(seed, run):
    made, off = lossy(seed, 0.03, run)
    lost = stage().marked(made).lost
    here = (lost > 0.0).all(axis=1)
    assert here.sum() > 200
    ratio = np.sqrt(np.mean(off[here] ** 2, axis=0) / np.mean(lost[here], axis=0))
    assert (ratio > 0.5).all()
    assert (ratio < 1.25).all()


def test_where_nothing_is_lost_there_is_none():
    made, _ = lossy(1, 0.03)
    lost = stage().marked(made).lost
    assert not lost[made.interval < 1.2 / HERTZ].any()
    assert not stage().marked(updates(rough(1), np.ones(20000, bool))).lost.any()


def test_a_motion_that_goes_on_loses_nothing():
    """A steady turn, and one that becomes faster, are interpolated across exactly."""
    rates = np.outer(np.arange(3000) / HERTZ, [0.1, 0.0, -0.2, 1.0, 0.5, 0.0]) + 0.3
    kept = np.arange(3000) % 97 != 50
    lost = stage().marked(updates(rates, kept)).lost
    assert lost.max() < 1e-20


def test_it_is_the_same_in_whatever_blocks():
    made, _ = lossy(2, 0.03)
    whole = stage().marked(made)
    one = stage()
    edges = [0, 1, 7, 500, 501, 9000, len(made.time_ns)]
    parts = [one.marked(take_rows(made, slice(a, b))) for a, b in pairwise(edges)]
    np.testing.assert_array_equal(concatenate(parts).lost, whole.lost)


def test_nothing_is_known_at_once_after_a_beginning():
    rates = rough(3)[:6]
    kept = np.array([True, True, False, True, True, True])
    assert not stage().marked(updates(rates, kept)).lost.any()
    one = stage()
    one.marked(updates(rough(3), np.ones(20000, bool)))
    one.begin()
    known = one.marked(updates(rates, kept)).lost
    assert known[1].min() > 0.0  # as unsteady as before the gap


def test_a_second_without_samples_is_no_extrapolation():
    rates = rough(5)
    kept = np.ones(len(rates), bool)
    for k in range(500, len(rates) - 200, 500):
        kept[k : k + 50] = False
    lost = stage().marked(updates(rates, kept)).lost
    assert 0.01 < np.sqrt(lost[lost > 0.0]).max() < 1.0  # rad and m/s: rates are 0.3 rad/s


def test_joined_updates_have_the_sums():
    made = stage().marked(lossy(4, 0.05)[0])
    joined = joined_updates(made, 0.1)
    assert len(joined.interval) < len(made.interval) / 2
    np.testing.assert_allclose(joined.lost.sum(axis=0), made.lost.sum(axis=0), rtol=1e-12)
    assert joined_updates(replace(made, lost=None), 0.1).lost is None
