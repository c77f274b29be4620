from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sinstool.report.decimate import FEWEST, thin

anything = st.floats(allow_nan=True, allow_infinity=True, width=64)
finite = st.floats(allow_nan=False, allow_infinity=False, width=64)
sizes = st.integers(1, 400)
limits = st.integers(FEWEST, 100)


@st.composite
def curves(draw, xs=finite, ascending=True):
    n = draw(sizes)
    x = draw(arrays(np.float64, n, elements=xs))
    y = draw(arrays(np.float64, n, elements=anything))
    return (np.sort(x) if ascending else x), y


def check(x, y, limit, log_x):
    rows = thin(x, y, limit, log_x)
    assert rows.size <= max(limit, 1)
    assert np.all(np.diff(rows) > 0)
    assert rows[0] == 0 and rows[-1] == x.size - 1
    if x.size <= limit:
        assert rows.size == x.size
    whole = np.isfinite(x) & np.isfinite(y) & ((x > 0.0) | (not log_x))
    if whole.any():
        left = y[rows][whole[rows]]
        assert left.min() == y[whole].min() and left.max() == y[whole].max()
    if not whole.all():
        assert not whole[rows].all(), "the holes are all closed"
    return rows, whole


@given(curves(), limits, st.booleans())
def test_extremes_ends_and_bound(curve, limit, log_x):
    check(*curve, limit, log_x)


@given(curves(xs=anything, ascending=False), limits, st.booleans())
def test_whatever_the_places_are(curve, limit, log_x):
    x, y = curve
    rows, whole = check(x, y, limit, log_x)
    places = x[np.isfinite(x) & ((x > 0.0) | (not log_x))]
    if np.any(places[1:] < places[:-1]) and whole.any():
        left = x[rows][whole[rows]]
        assert left.min() == x[whole].min() and left.max() == x[whole].max()


@given(st.integers(1, 50_000), st.integers(0, 49_999), limits)
def test_one_sample_wide_peaks_stay(n, at, limit):
    at %= n
    y = np.zeros(n)
    y[at] = 1.0
    assert at in thin(np.arange(n) * 0.0025, y, limit)


def test_every_stretch_keeps_its_extremes():
    # 1000 stretches of 10 samples of an even axis, cut where the rule cuts them
    rng = np.random.default_rng(0)
    y = rng.normal(size=100_000)
    x = np.arange(y.size) / 400.0
    rows = thin(x, y, 2002)
    for stretch in np.array_split(np.arange(y.size), 500):
        of_it = rows[(rows >= stretch[0]) & (rows <= stretch[-1])]
        # a stretch twice as long as those that were cut holds at least one whole
        assert of_it.size >= 2
        assert np.ptp(y[of_it]) > 0.5 * np.ptp(y[stretch])


def test_long_hole_stays_open_on_both_sides():
    n = 10_000
    x, y = np.arange(n) / 10.0, np.ones(n)
    y[4000:5000] = np.nan
    rows = thin(x, y, 300)
    last_before = rows[rows < 4000].max()
    first_after = rows[rows >= 5000].min()
    assert np.isnan(y[rows[(rows > last_before) & (rows < first_after)]]).all()
    assert last_before > 3900 and first_after < 5100


def test_sparse_decades_of_a_logarithmic_axis_keep_their_points():
    x = np.linspace(1e-3, 1000.0, 1_000_000)
    rows = thin(x, np.ones(x.size) + np.arange(x.size), 2000, log_x=True)
    first = (x > 0.002) & (x < 1.0)
    # 998 points lie in three of the six decades; by number they would be one stretch
    assert np.count_nonzero(first[rows]) > 100
    plain = thin(x, np.ones(x.size) + np.arange(x.size), 2000)
    assert np.count_nonzero(first[plain]) < 10


def test_burst_between_gaps_keeps_its_points():
    burst = 5000.0 + np.linspace(0.0, 1.0, 10_000)
    x = np.concatenate([np.linspace(0.0, 100.0, 500), burst, np.linspace(9900.0, 1e4, 500)])
    rows = thin(x, np.sin(np.arange(x.size)), 1000)
    assert np.count_nonzero((x[rows] >= 5000.0) & (x[rows] <= 5001.0)) > 300


def test_refusals():
    x = np.arange(10.0)
    with pytest.raises(ValueError, match="at least 8"):
        thin(x, x, 7)
    with pytest.raises(ValueError, match="x is"):
        thin(x, x[1:], 8)
