import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from sinstool.methods.hse.statistics import drifts, fit_sinusoid, scatter, trend_t
from tests.methods.hse.published_table1 import (
    AFTER,
    AZIMUTH_DEG,
    BEFORE,
    POSITION,
    PRINTED_PEAK_TO_PEAK_BEFORE,
)

AZIMUTH = np.radians(AZIMUTH_DEG)


def test_the_published_columns_are_whole():
    """Support for the grouping: each column sums to zero but for its last digit."""
    assert abs(BEFORE.sum()) < 0.05 and abs(AFTER.sum()) < 0.05
    by_position = (BEFORE - AFTER).reshape(4, 3)
    assert all(len(set(np.sign(row))) == 1 for row in by_position)


def test_scatter_of_table_1():
    before, after = scatter(BEFORE, POSITION), scatter(AFTER, POSITION)
    assert before.peak_to_peak == pytest.approx(PRINTED_PEAK_TO_PEAK_BEFORE, abs=1e-9)
    assert after.peak_to_peak == pytest.approx(28.50, abs=1e-9)
    np.testing.assert_allclose(before.means, [-9.9733, 10.5933, 6.3933, -7.0067], atol=5e-5)
    np.testing.assert_allclose(after.means, [-6.2200, 2.0467, 2.1467, 2.0133], atol=5e-5)
    assert (before.std, before.rms) == pytest.approx((12.175, 11.657), abs=5e-4)
    assert (after.std, after.rms) == pytest.approx((7.680, 7.353), abs=5e-4)
    assert before.peak_to_peak_of_means == pytest.approx(20.567, abs=5e-4)
    assert after.peak_to_peak_of_means == pytest.approx(8.367, abs=5e-4)
    assert (before.within_std, before.within_dof) == (pytest.approx(9.524, abs=5e-4), 8)
    assert (after.within_std, after.within_dof) == (pytest.approx(7.859, abs=5e-4), 8)
    warm = POSITION > 0  # the first position was cold
    assert scatter(BEFORE[warm], POSITION[warm]).peak_to_peak == pytest.approx(30.60)
    assert scatter(AFTER[warm], POSITION[warm]).peak_to_peak == pytest.approx(19.20)


def test_sinusoid_of_table_1():
    before, after = fit_sinusoid(AZIMUTH, BEFORE), fit_sinusoid(AZIMUTH, AFTER)
    coefficients = (before.offset, before.cosine, before.sine)
    assert coefficients == pytest.approx((0.0844, -8.2643, 8.4857), abs=5e-5)
    coefficients = (after.offset, after.cosine, after.sine)
    assert coefficients == pytest.approx((0.0142, -4.1639, -0.1323), abs=5e-5)
    assert (before.amplitude, before.sigma_amplitude) == pytest.approx((11.845, 3.71), abs=5e-3)
    assert (after.amplitude, after.sigma_amplitude) == pytest.approx((4.166, 3.18), abs=5e-3)
    assert np.degrees(before.phase) == pytest.approx(134.24, abs=5e-3)
    assert np.degrees(after.phase) == pytest.approx(-178.18, abs=5e-3)
    assert (before.residual_std, before.dof) == (pytest.approx(9.211, abs=5e-4), 9)
    assert after.residual_std == pytest.approx(7.779, abs=6e-4)
    assert (before.F, before.p) == (pytest.approx(5.110, abs=5e-4), pytest.approx(0.033, abs=5e-4))
    assert (after.F, after.p) == (pytest.approx(0.860, abs=5e-4), pytest.approx(0.455, abs=5e-4))
    compensation = fit_sinusoid(AZIMUTH, BEFORE - AFTER)
    assert compensation.amplitude == pytest.approx(9.544, abs=5e-4)
    assert compensation.sigma_amplitude == pytest.approx(0.90, abs=5e-3)


@given(
    st.floats(-50, 50),
    st.floats(1.0, 50),
    st.floats(-3.1, 3.1),
    st.integers(4, 20),
    st.floats(0, 6),
)
def test_a_sinusoid_is_found(offset, amplitude, phase, n, turn):
    azimuth = turn + np.arange(n) * 2.0 * np.pi / n
    values = offset + amplitude * np.cos(azimuth - phase)
    result = fit_sinusoid(azimuth, values)
    assert result.offset == pytest.approx(offset, abs=1e-9)
    assert result.amplitude == pytest.approx(amplitude, abs=1e-9)
    assert np.cos(result.phase - phase) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(
        result(azimuth), offset + amplitude * np.cos(azimuth - phase), atol=1e-8
    )


def test_sinusoid_deviations_and_test_are_those_of_simulations():
    rng = np.random.default_rng(1)
    noise = rng.standard_normal((1500, 12))
    p = [fit_sinusoid(AZIMUTH, x).p for x in noise]
    assert stats.kstest(p, "uniform").pvalue > 1e-3
    wave = 8.0 * np.cos(AZIMUTH - 1.0)
    fits = [fit_sinusoid(AZIMUTH, wave + x) for x in noise]
    formal = np.sqrt(np.mean([f.sigma_amplitude**2 for f in fits]))
    assert np.std([f.amplitude for f in fits]) == pytest.approx(formal, rel=0.06)
    assert np.std([f.offset for f in fits]) == pytest.approx(
        np.sqrt(np.mean([f.sigma_offset**2 for f in fits])), rel=0.06
    )


def test_sigma_of_the_amplitude_is_along_its_own_direction():
    """Azimuths that see the cosine far better than the sine."""
    rng = np.random.default_rng(3)
    azimuth = np.array([0.0, 0.3, -0.3, np.pi, np.pi + 0.3, np.pi - 0.3, 0.1, 3.0])
    wave = 40.0 * np.cos(azimuth - 1.4)
    fits = [fit_sinusoid(azimuth, wave + rng.standard_normal(8)) for _ in range(600)]
    formal = np.sqrt(np.mean([f.sigma_amplitude**2 for f in fits]))
    assert np.std([f.amplitude for f in fits]) == pytest.approx(formal, rel=0.1)
    assert formal > 1.0


def test_few_values():
    alone = scatter([3.0], [0])
    assert (alone.mean, alone.peak_to_peak) == (3.0, 0.0)
    assert np.isnan(alone.std) and np.isnan(alone.within_std) and np.isnan(alone.between_std)
    with pytest.raises(ValueError, match="three azimuths"):
        fit_sinusoid([0.0, 0.0, 1.0, 1.0], [1.0, 2.0, 3.0, 4.0])
    exact = fit_sinusoid([0.0, 1.0, 2.0], [1.0, 2.0, 4.0])
    assert exact.dof == 0 and np.isnan(exact.p) and np.isnan(exact.sigma_amplitude)


def test_between_is_of_means():
    result = scatter([1.0, 3.0, 10.0, 12.0], [4, 4, 7, 7])
    np.testing.assert_allclose(result.means, [2.0, 11.0])
    assert result.between_std == pytest.approx(9.0 / np.sqrt(2.0))
    assert result.within_std == pytest.approx(np.sqrt(4.0 / 2.0))


def test_trend_follows_student_and_does_not_mind_north():
    rng = np.random.default_rng(2)
    t = [trend_t(1e-4 * rng.standard_normal(20)) for _ in range(800)]
    assert stats.kstest(t, stats.t(18).cdf).pvalue > 1e-3
    turns = 1e-4 * rng.standard_normal(20) + np.linspace(0.0, 1e-3, 20)
    assert trend_t(turns) > 4.0
    assert trend_t(turns % (2.0 * np.pi)) == pytest.approx(trend_t(turns), rel=1e-6)
    assert trend_t(-turns) == pytest.approx(-trend_t(turns))
    line = stats.linregress(np.arange(20), turns)
    assert trend_t(turns) == pytest.approx(line.slope / line.stderr)
    assert trend_t([1.0, 2.0, 3.0]) == 0.0
    assert trend_t(np.ones(9)) == 0.0


@pytest.mark.parametrize("turns", [4, 6, 30])
def test_few_turns_are_no_trend_by_chance(turns):
    rng = np.random.default_rng(turns)
    alarms = sum(drifts(1.0 + 1e-4 * rng.standard_normal(turns)) for _ in range(3000))
    assert alarms <= 4
    slope = np.linspace(0.0, 1.0, turns)
    assert drifts(slope + 1e-6 * rng.standard_normal(turns))
    assert not drifts(1e-12 * slope)  # rounding
