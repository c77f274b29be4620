"""Alias exposure against noise and lines that are really thinned."""

import numpy as np
import pytest
from scipy import signal

from sinstool.pipelines.compare_coning.alias import exposure, lines, rate_spectrum

RATE = 400.0
STEP = 1.0 / RATE
SIGMA = 3e-3


@pytest.fixture(scope="module")
def noise():
    """White but for a slope, so that what folds onto what can be told."""
    rng = np.random.default_rng(11)
    white = SIGMA * rng.standard_normal((round(1600 * RATE), 3))
    return signal.lfilter([1.0, -0.6], [1.0], white, axis=0)


@pytest.fixture(scope="module")
def spectrum(noise):
    return rate_spectrum([noise], STEP)


def thinned(gyro, m, how):
    if how == "points":
        return gyro[::m]
    whole = gyro[: len(gyro) // m * m]
    return whole.reshape(-1, m, gyro.shape[1]).mean(axis=1)


def test_spectrum_holds_the_power(noise, spectrum):
    power = spectrum.density.sum() * spectrum.frequency[1]
    assert power == pytest.approx(3 * SIGMA**2 * 1.36, rel=0.01)


@pytest.mark.parametrize("how", ["sums", "points"])
@pytest.mark.parametrize("m", [2, 3, 4, 5, 8])
def test_folded_density_is_that_of_the_thinned_log(noise, spectrum, m, how):
    actual = exposure(spectrum, RATE, m, how, 10.0)
    assert actual.rate_hz == RATE / m
    f, density = signal.welch(thinned(noise, m, how), RATE / m, nperseg=1024, axis=0)
    measured = density.sum(axis=1)
    expected = np.interp(f, actual.frequency, ndimage_mean(actual.folded))
    inside = (f > 1.0) & (f < 0.48 * RATE / m)
    ratio = measured[inside] / expected[inside]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.02)
    assert np.all(np.abs(ratio - 1.0) < 0.3)
    # rest is no special place, wherever it was folded from
    near = actual.folded[1:30].mean()
    if how == "points":
        assert actual.folded[0] == pytest.approx(near, rel=0.25)
    # the shape too, not the level alone
    halves = np.array_split(ratio, 2)
    assert halves[0].mean() == pytest.approx(halves[1].mean(), rel=0.03)


def ndimage_mean(values, width=21):
    return np.convolve(np.pad(values, width // 2, "edge"), np.ones(width) / width, "valid")


@pytest.mark.parametrize("m", [2, 3, 4, 8])
def test_angle_of_folded_noise_is_that_of_windows(noise, m):
    window = 10.0
    n = round(window * RATE)
    picked = noise.reshape(-1, n, 3)
    # less what slow motion is: the angle that is truly turned
    wrong = picked[:, ::m].sum(axis=1) * m * STEP - picked.sum(axis=1) * STEP
    measured = np.sqrt((wrong**2).sum(axis=1).mean())
    # windows that m does not divide are off by a sample: nothing beside the rest
    spectrum = rate_spectrum([noise], STEP, window)
    folded = np.deg2rad(exposure(spectrum, RATE, m, "points", window).dc_alias_deg)
    assert folded == pytest.approx(measured, rel=0.12)


def test_sums_fold_next_to_nothing_onto_rest(noise, spectrum):
    sums = exposure(spectrum, RATE, 4, "sums", 10.0).dc_alias_deg
    points = exposure(spectrum, RATE, 4, "points", 10.0).dc_alias_deg
    assert sums < 0.01 * points


@pytest.mark.parametrize("window", [10.0, 40.0])
def test_line_at_the_lower_rate_becomes_a_constant_rate(window):
    amplitude = 2e-3
    t = np.arange(round(200 * RATE)) * STEP
    rng = np.random.default_rng(2)
    gyro = 1e-6 * rng.standard_normal((len(t), 3))
    gyro[:, 0] += amplitude * np.sin(2 * np.pi * 100.0 * t + 0.25 * np.pi)
    spectrum = rate_spectrum([gyro], STEP, window)
    result = exposure(spectrum, RATE, 4, "points", window)
    # sin 45 deg of the amplitude at every sample that is kept, and its rms over all phases
    assert np.allclose(gyro[::4, 0], amplitude * np.sqrt(0.5), atol=1e-5)
    angle = np.rad2deg(window * amplitude * np.sqrt(0.5))
    assert result.dc_alias_deg == pytest.approx(angle, rel=0.25)
    assert result.lines_hz == pytest.approx([100.0])


def test_only_lines_near_multiples_of_the_lower_rate_are_named():
    t = np.arange(round(100 * RATE)) * STEP
    gyro = 1e-4 * np.random.default_rng(3).standard_normal((len(t), 3))
    for k, f in enumerate((101.5, 110.0, 199.0, 33.0)):
        gyro[:, k % 3] += 1e-3 * np.sin(2 * np.pi * f * t)
    spectrum = rate_spectrum([gyro], STEP)
    assert lines(spectrum) == pytest.approx([33.0, 101.5, 110.0, 199.0])
    assert exposure(spectrum, RATE, 4, "points", 10.0).lines_hz == pytest.approx([101.5, 199.0])
    # 133 Hz and 2.7 Hz about it: none of them
    assert exposure(spectrum, RATE, 3, "points", 10.0).lines_hz == ()


def test_what_a_sum_takes_out_or_rounding_makes_is_no_line():
    t = np.arange(round(100 * RATE)) * STEP
    gyro = np.zeros((len(t), 3))
    gyro[:, 0] = 1e-3 * np.sin(2 * np.pi * 100.0 * t) + 1e-15 * np.sin(2 * np.pi * 50.0 * t)
    spectrum = rate_spectrum([gyro], STEP)
    assert exposure(spectrum, RATE, 4, "points", 10.0).lines_hz == pytest.approx([100.0])
    assert exposure(spectrum, RATE, 4, "sums", 10.0).lines_hz == ()
    assert exposure(spectrum, RATE, 8, "points", 10.0).lines_hz == pytest.approx([100.0])


def test_noise_has_no_lines(spectrum):
    assert len(lines(spectrum)) == 0


def test_segments_weigh_by_their_length_and_short_ones_are_left_out():
    rng = np.random.default_rng(4)
    loud, quiet = 2.0 * rng.standard_normal((8000, 3)), rng.standard_normal((24000, 3))
    both = rate_spectrum([loud, quiet, 100.0 * np.ones((50, 3))], STEP)
    power = both.density.sum() * both.frequency[1]
    assert power == pytest.approx(3 * (4.0 * 0.25 + 1.0 * 0.75), rel=0.05)
    assert rate_spectrum([np.zeros((63, 3))], STEP) is None
    assert rate_spectrum([], STEP) is None
