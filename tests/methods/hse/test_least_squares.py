import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from sinstool.methods.hse.least_squares import lack_of_fit, least_squares, outlier_limit


def problem(rng, n=9, p=3):
    design = np.column_stack([np.ones(n), rng.normal(0.0, 1e-6, n), rng.normal(0.0, 1e3, n)])[:, :p]
    return design, rng.normal(0.0, 1.0, n), rng.uniform(0.3, 3.0, n)


@given(st.integers(0, 1000), st.booleans())
def test_solves_the_normal_equations(seed, weighted):
    rng = np.random.default_rng(seed)
    design, observed, sigma = problem(rng)
    scale = np.array([1.0, 1e-6, 1e3])
    actual = least_squares(design, observed, sigma if weighted else None)
    w = 1.0 / sigma**2 if weighted else np.ones(len(sigma))
    normal = (design / scale).T @ (w[:, None] * (design / scale))
    expected = np.linalg.solve(normal, (design / scale).T @ (w * observed))
    np.testing.assert_allclose(actual.estimate * scale, expected, rtol=1e-8, atol=1e-10)
    residual = observed - design @ actual.estimate
    chi2 = np.sum(w * residual**2)
    factor = max(1.0, chi2 / 6) if weighted else chi2 / 6
    np.testing.assert_allclose(
        actual.covariance * np.outer(scale, scale), factor * np.linalg.inv(normal), rtol=1e-7
    )
    assert actual.dof == 6
    assert actual.chi2 == pytest.approx(chi2)
    assert actual.leverage.sum() == pytest.approx(3.0)


@given(st.integers(0, 1000), st.booleans())
def test_studentised_residual_is_of_the_fit_without_the_observation(seed, weighted):
    rng = np.random.default_rng(seed)
    design, observed, sigma = problem(rng)
    weights = sigma if weighted else np.ones_like(sigma)
    result = least_squares(design, observed, sigma if weighted else None)
    for i in range(len(observed)):
        others = np.arange(len(observed)) != i
        without = least_squares(
            design[others] / weights[others, None], (observed / weights)[others]
        )
        row = design[i] / weights[i]
        error = observed[i] / weights[i] - row @ without.estimate
        deviation = np.sqrt(without.s**2 + row @ without.covariance @ row)
        assert result.studentised[i] == pytest.approx(error / deviation, rel=1e-6, abs=1e-9)


def test_studentised_residuals_follow_student():
    rng = np.random.default_rng(2)
    design = problem(rng)[0]
    t = [least_squares(design, rng.normal(size=9)).studentised[0] for _ in range(1500)]
    assert stats.kstest(t, stats.t(5).cdf).pvalue > 1e-3
    assert outlier_limit(9, 6, 0.01) == pytest.approx(stats.t.ppf(1 - 0.01 / 18, 5))
    assert outlier_limit(4, 1, 0.01) == np.inf


def test_an_observation_that_alone_holds_a_parameter_has_no_studentised_residual():
    design = np.column_stack([np.ones(6), [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    result = least_squares(design, np.array([1.0, 2.0, 1.5, 0.5, 1.2, 9.0]))
    assert result.leverage[5] == pytest.approx(1.0)
    assert np.isnan(result.studentised[5]) and np.isfinite(result.studentised[:5]).all()


def test_quantiles():
    rng = np.random.default_rng(3)
    design, observed, sigma = problem(rng, p=2)
    assert least_squares(design, observed).quantile == pytest.approx(stats.t.ppf(0.975, 7))
    believed = least_squares(design, observed * sigma, sigma)
    assert not believed.student
    assert believed.quantile == pytest.approx(1.959964, rel=1e-6)
    disbelieved = least_squares(design, 10.0 * observed * sigma, sigma)
    assert disbelieved.student
    assert disbelieved.quantile == pytest.approx(stats.t.ppf(0.975, 7))


def test_without_redundancy():
    design = np.array([[1.0, 0.0], [1.0, 2.0]])
    known = least_squares(design, np.array([1.0, 5.0]), np.array([0.3, 0.4]))
    np.testing.assert_allclose(known.estimate, [1.0, 2.0])
    np.testing.assert_allclose(np.sqrt(np.diag(known.covariance)), [0.3, 0.25])
    unknown = least_squares(design, np.array([1.0, 5.0]))
    assert np.isnan(unknown.covariance).all() and np.isnan(unknown.s)


@pytest.mark.parametrize(
    "design",
    [np.ones((1, 2)), np.ones((5, 2)), np.column_stack([np.ones(5), np.zeros(5)])],
)
def test_what_cannot_be_solved_is_refused(design):
    with pytest.raises(np.linalg.LinAlgError):
        least_squares(design, np.arange(float(len(design))))


def test_condition_does_not_depend_on_units():
    rng = np.random.default_rng(4)
    design, observed, sigma = problem(rng)
    one = least_squares(design, observed, sigma)
    other = least_squares(design * [1e5, 1e-5, 3.0], observed, sigma)
    assert other.condition == pytest.approx(one.condition)
    assert one.condition < 10.0


def test_lack_of_fit_by_hand():
    """Two repeats at three places, a straight line: sums of squares by hand."""
    x = np.array([0.0, 0.0, 1.0, 1.0, 2.0, 2.0])
    y = np.array([-1.0, 1.0, 2.0, 4.0, -1.0, 1.0])
    design = np.column_stack([np.ones(6), x])
    # means 0, 3, 0: line 1, off by -1, 2, -1; twice each: 12 with 1; repeats: 6 with 3
    ratio, p = lack_of_fit(design, y, np.array([0, 0, 1, 1, 2, 2]))
    assert ratio == pytest.approx(6.0)
    assert p == pytest.approx(stats.f.sf(6.0, 1, 3))
    assert lack_of_fit(design, y, np.array([0, 0, 0, 1, 1, 1])) is None
    assert lack_of_fit(design, y, np.arange(6)) is None


def test_lack_of_fit_with_weights_and_drift_follows_f():
    rng = np.random.default_rng(5)
    cells = np.repeat(np.arange(4), 3)
    x = np.array([-2.0, -1.0, 1.0, 2.5])[cells]
    time = rng.normal(size=12)
    sigma = rng.uniform(0.2, 4.0, 12)
    design = np.column_stack([np.ones(12), x, time])
    p = []
    for _ in range(800):
        y = design @ [3.0, -1.0, 5.0] + sigma * rng.standard_normal(12)
        p.append(lack_of_fit(design, y, cells, sigma, time[:, None])[1])
    assert stats.kstest(p, "uniform").pvalue > 1e-3
