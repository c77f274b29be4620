"""Noise terms found again in what is simulated of them, and none that is not there."""

from __future__ import annotations

import numpy as np
import pytest

from sinstool.methods.allan.deviation import VarianceStage, averaging_lags, stride_for
from sinstool.methods.allan.fit import NoiseData
from sinstool.methods.allan.model import (
    TERMS,
    allan_terms,
    block_length,
    block_model,
    covariance_of_variances,
    sine_transform,
)
from sinstool.methods.allan.profile import chance_above
from tests.helpers.allan import fit_segments, simulate_terms

NAMES = (*TERMS, "ramp")
UNIT = {
    "quantisation": (1.0, 0.0, 0.0, 0.0, 0.0),
    "white": (0.0, 1.0, 0.0, 0.0, 0.0),
    "flicker": (0.0, 0.0, 1.0, 0.0, 0.0),
    "random_walk": (0.0, 0.0, 0.0, 1.0, 0.0),
}


def data_of(segments: list[np.ndarray]) -> NoiseData:
    longest = max(map(len, segments))
    lengths = [len(s) for s in segments]
    block, stride = block_length(lengths), stride_for(longest)
    columns = segments[0].shape[1]
    lags = averaging_lags(longest)
    stage = VarianceStage(lags, stride, columns, max(block, stride), hadamard=False)
    for segment in segments:
        stage.begin()
        stage.push(segment - segment.mean(axis=0))
    found = stage.finish()
    return NoiseData(found, stage.lengths, stage.phases, block)


def simulated(count: int, terms: tuple[float, ...], runs: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.stack([simulate_terms(count, *terms, rng) for _ in range(runs)], axis=1)


@pytest.mark.parametrize("name", TERMS)
def test_expected_allan_variance(name: str) -> None:
    """The mean over runs of each term alone is what the model says, and so is the scatter."""
    rows = simulated(600, UNIT[name], 400, seed=5)
    lags = 2 ** np.arange(6)
    stage = VarianceStage(lags, 1, rows.shape[1], 1, hadamard=False)
    stage.begin()
    stage.push(rows - rows.mean(axis=0))
    found = stage.finish().allan
    k = TERMS.index(name)
    expected = allan_terms(lags)[:, k]
    scatter = found.std(axis=1) / np.sqrt(found.shape[1])
    np.testing.assert_array_less(np.abs(found.mean(axis=1) - expected), 4.5 * scatter)
    covariance = covariance_of_variances(lags, [len(rows)])[:, :, k, k]
    ratio = found.var(axis=1, ddof=1) / np.diag(covariance)
    np.testing.assert_allclose(ratio, 1.0, atol=0.35)
    correlation = covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    np.testing.assert_allclose(np.corrcoef(found), correlation, atol=0.2)


@pytest.mark.parametrize("name", TERMS)
def test_blocks_in_the_sine_basis(name: str) -> None:
    """Coefficients of block means have the variances of the model, and hardly any covariance."""
    rows = simulated(40 * 8, UNIT[name], 2500, seed=6)
    phase = np.vstack([np.zeros(rows.shape[1]), np.cumsum(rows, axis=0)])[::8]
    found = sine_transform(np.diff(phase, 2, axis=0))
    expected = block_model(39, 8).variance[:, TERMS.index(name)]
    np.testing.assert_allclose(found.var(axis=1) / expected, 1.0, atol=0.15)
    # Quantisation alone, which blocks hardly show, leaves its ends in the lowest coefficients
    if name != "quantisation":
        apart = np.corrcoef(found) - np.eye(len(found))
        assert np.abs(apart).max() < 0.12


def test_ramp_in_the_sine_basis() -> None:
    phase = np.cumsum(np.concatenate([[0.0], 1e-3 * np.arange(160.0)]))[::4]
    found = sine_transform(np.diff(phase, 2)[:, None])[:, 0]
    np.testing.assert_allclose(found, 1e-3 * block_model(39, 4).ramp, atol=1e-9)


CASES = [
    (2000, (0.0, 1.0, 0.0, 0.0, 0.0), {"white"}),
    (20000, (0.0, 1.0, 0.0, 2e-2, 0.0), {"white", "random_walk"}),
    (60000, (3.0, 1.0, 0.1, 0.0, 0.0), {"quantisation", "white", "flicker"}),
    (20000, (0.0, 1.0, 0.0, 0.0, 6e-5), {"white", "ramp"}),
]


@pytest.mark.parametrize(("count", "terms", "seen"), CASES)
def test_terms_that_are_there(count: int, terms: tuple[float, ...], seen: set[str]) -> None:
    """Visible terms are found within their intervals, others are bounded and never claimed."""
    runs = 12
    data = data_of([simulated(count, terms, runs, seed=8)])
    held = bounded = 0
    for run in range(runs):
        fit = data.fit(run)
        assert fit is not None
        for name, truth in zip(NAMES, terms, strict=True):
            term = fit.terms[name]
            assert (term.value is not None) == (name in seen), (name, run)
            if term.value is not None:
                assert 0.0 < term.low <= term.value <= term.high
                held += term.low <= truth <= term.high
            bounded += truth <= term.high
        assert fit.misfit == 1.0
    assert held >= 0.75 * runs * len(seen)
    assert bounded >= 0.95 * runs * len(NAMES)


def test_segments_together_are_as_one() -> None:
    rows = simulated(40000, (0.0, 1.0, 0.0, 1e-2, 0.0), 1, seed=9)
    whole = data_of([rows]).fit(0)
    parts = data_of([rows[:9000], rows[9000:22000] + 7.0, rows[22000:]]).fit(0)
    assert whole is not None
    assert parts is not None
    for name in ("white", "random_walk"):
        one, other = whole.terms[name], parts.terms[name]
        assert one.value is not None
        assert other.value == pytest.approx(one.value, rel=0.15)
        assert other.high - other.low > 0.8 * (one.high - one.low)


def test_short_averaging_times_that_do_not_fit_are_left_out() -> None:
    """A low-pass filter in the sensor: nothing of its corner is taken for a term."""
    rows = simulated(60000, (0.0, 1.0, 0.0, 0.0, 0.0), 1, seed=10)
    smooth = np.apply_along_axis(np.convolve, 0, rows, np.ones(6) / 6.0, "same")
    fit = data_of([smooth]).fit(0)
    assert fit is not None
    assert fit.from_lag > 4
    white = fit.terms["white"]
    assert white.value == pytest.approx(1.0, rel=0.08)
    assert fit.terms["quantisation"].value is None


@pytest.mark.parametrize("pole", [0.8, 0.9])
def test_white_noise_behind_a_filter(pole: float) -> None:
    """Long averages show it, less what the filter takes there."""
    rows = simulated(120000, (0.0, 1.0, 0.0, 0.0, 0.0), 6, seed=3)
    smooth = np.zeros_like(rows)
    for k in range(1, len(rows)):
        smooth[k] = pole * smooth[k - 1] + (1.0 - pole) * rows[k]
    fits = [data_of([smooth]).fit(column) for column in range(6)]
    whites = [fit.terms["white"] for fit in fits if fit is not None]
    assert np.mean([white.value for white in whites]) == pytest.approx(1.0, abs=0.02)
    assert sum(white.low < 1.0 < white.high for white in whites) >= 5
    assert all(fit is not None and fit.terms["quantisation"].value is None for fit in fits)


def test_intervals_hold_their_values() -> None:
    """Also where a term that is just not visible moves one that is."""
    data = data_of([simulated(60000, (0.0, 1.0, 0.02, 0.0, 0.0), 12, seed=21)])
    for run in range(12):
        fit = data.fit(run)
        assert fit is not None
        for term in fit.terms.values():
            assert term.value is None or term.low <= term.value <= term.high
        assert fit.terms["white"].value is not None


def test_nothing_to_fit() -> None:
    assert data_of([np.zeros((5000, 1))]).fit(0) is None
    assert data_of([np.random.default_rng(1).standard_normal((6, 1))]).fit(0) is None


def test_functions_beside_scipy() -> None:
    """The chance of chi-squared, and the sine transform."""
    special = pytest.importorskip("scipy.special")
    fft = pytest.importorskip("scipy.fft")
    for freedom in (1, 2, 3, 8, 31, 256):
        for value in (0.0, 0.3, 5.0, 40.0, 300.0):
            expected = float(special.chdtrc(freedom, value))
            assert chance_above(value, freedom) == pytest.approx(expected, rel=1e-9, abs=1e-300)
    rows = np.random.default_rng(3).standard_normal((37, 2))
    expected = fft.dst(rows, type=1, norm="ortho", axis=0)
    np.testing.assert_allclose(sine_transform(rows), expected, atol=1e-12)


@pytest.mark.parametrize(
    "terms",
    [
        # Less than a twentieth of every variance, but no chance
        (0.1, 1.0, 0.0, 0.0, 0.0),
        # Of the random walk long averaging times know far more than short ones of all else
        (0.2, 1.0, 0.0, 1e-5, 0.0),
    ],
    ids=["small quantisation", "small random walk"],
)
def test_white_noise_of_a_million_samples(terms: tuple[float, ...]) -> None:
    generator = np.random.default_rng([6, 4])
    columns = np.column_stack([simulate_terms(1_000_000, *terms, generator) for _ in range(4)])
    for fit in fit_segments([columns]):
        assert fit is not None and fit.from_lag == 1 and fit.misfit == 1.0
        white = fit.terms["white"]
        assert white.value is not None
        assert abs(white.value - 1.0) < 2.0 * (white.high - white.low)
