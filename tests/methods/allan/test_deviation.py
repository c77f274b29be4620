"""Allan and Hadamard variances: beside allantools, over gaps, and independent of blocks."""

from __future__ import annotations

import numpy as np
import pytest

from sinstool.methods.allan import deviation
from sinstool.methods.allan.deviation import VarianceStage, averaging_lags, stride_for
from tests.helpers.allan import variances


@pytest.fixture(scope="module")
def walk() -> np.ndarray:
    rng = np.random.default_rng(3)
    steps = rng.standard_normal((9000, 2))
    return steps + np.cumsum(1e-2 * rng.standard_normal((9000, 2)), axis=0) + 9.8


def test_as_allantools(walk: np.ndarray) -> None:
    allantools = pytest.importorskip("allantools")
    ours = variances([walk])
    taus = ours.lags / 50.0
    for column in range(2):
        options = {"rate": 50.0, "data_type": "freq", "taus": taus}
        _, theirs, _, terms = allantools.oadev(walk[:, column], **options)
        np.testing.assert_allclose(np.sqrt(ours.allan[:, column]), theirs, rtol=1e-9)
        np.testing.assert_array_equal(ours.terms, terms)
        octaves = ours.hadamard_terms > 0
        assert np.count_nonzero(octaves) >= 11
        _, theirs, _, terms = allantools.ohdev(walk[:, column], **options)
        mine = np.sqrt(ours.hadamard[octaves, column])
        np.testing.assert_allclose(mine, theirs[octaves], rtol=1e-9)
        np.testing.assert_array_equal(ours.hadamard_terms[octaves], terms[octaves])


@pytest.mark.parametrize("size", [1, 7, 1000])
def test_blocks_do_not_matter(walk: np.ndarray, size: int) -> None:
    rows = walk[:1500] - walk[:1500].mean(axis=0)
    whole = variances([walk[:1500]])
    stage = VarianceStage(whole.lags, 1, 2, 1)
    stage.begin()
    for first in range(0, len(rows), size):
        stage.push(rows[first : first + size])
    found = stage.finish()
    np.testing.assert_allclose(found.allan, whole.allan, rtol=1e-9)
    np.testing.assert_allclose(found.hadamard, whole.hadamard, rtol=1e-9)
    assert stage.lengths == [1500]


def test_gaps_are_not_bridged(walk: np.ndarray) -> None:
    parts = [walk[:3000], walk[3000:7000] + 5.0, walk[7000:] - 3.0]
    pooled = variances(parts)
    single = [variances([part]) for part in parts]
    for k, lag in enumerate(pooled.lags):
        sums = [
            (v.terms[at] * v.allan[at], v.terms[at])
            for v in single
            for at in np.flatnonzero(v.lags == lag)
        ]
        if len(sums) == len(parts):
            expected = sum(s for s, _ in sums) / sum(n for _, n in sums)
            np.testing.assert_allclose(pooled.allan[k], expected, rtol=1e-9)
            assert pooled.terms[k] == sum(n for _, n in sums)


@pytest.mark.parametrize("size", [13, 4096])
def test_long_segments_keep_fewer_phases(
    walk: np.ndarray, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = variances([walk])
    monkeypatch.setattr(deviation, "MOST_PHASES", 3000)
    assert stride_for(len(walk)) == 4
    lags = averaging_lags(len(walk))
    stage = VarianceStage(lags, 4, 2, 64)
    rows = walk - walk.mean(axis=0)
    stage.begin()
    for first in range(0, len(rows), size):
        stage.push(rows[first : first + size])
    coarse = stage.finish()
    fine = lags < deviation.COARSE * 4
    np.testing.assert_array_equal(lags[~fine] % 4, 0)
    at = np.searchsorted(whole.lags, lags[fine])
    np.testing.assert_allclose(coarse.allan[fine], whole.allan[at], rtol=1e-9)
    np.testing.assert_allclose(coarse.hadamard[fine], whole.hadamard[at], rtol=1e-9)
    both, mine, theirs = np.intersect1d(lags[~fine], whole.lags, return_indices=True)
    assert len(both) > 3
    np.testing.assert_allclose(coarse.allan[~fine][mine], whole.allan[theirs], rtol=0.02)
    # Phases a block apart, from the first sample on
    phase = np.vstack([np.zeros(2), np.cumsum(rows, axis=0)])[::64]
    np.testing.assert_allclose(stage.phases[0], phase, atol=1e-9)


def test_too_short_for_anything() -> None:
    assert len(averaging_lags(3)) == 0
    assert averaging_lags(4).tolist() == [1]
