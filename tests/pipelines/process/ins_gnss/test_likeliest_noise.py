"""The likeliest noise of an IMU, by errors and sigmas of few runs."""

import numpy as np
import pytest
from scipy.stats import norm

from sinstool.pipelines.process.ins_gnss import likeliest_noise
from sinstool.pipelines.process.ins_gnss.likeliest_noise import (
    LEAST_POWERS,
    MOST_POWERS,
    cost,
    likeliest,
)

SHARES = np.array([[0.01, 1, 0], [0.5, 1, 0], [1, 0.2, 0], [0, 1, 0.05], [0, 0.2, 1]])


def sigma(*factors):
    """Early errors are an accelerometer's, late ones mostly a gyro's, others a scale factor's."""
    return np.sqrt(1e-4 + SHARES @ np.square(factors))


@pytest.mark.parametrize("truth", [(2.5, 0.4, 2.0), (0.2, 0.3, 5.0), (1, 1, 1), (3.0, 3.0, 0.7)])
def test_the_likeliest_factors_are_those_of_the_errors(truth):
    ratios = []
    for seed in range(20):
        error = sigma(*truth) * np.random.default_rng(seed).standard_normal((120, 5))
        made = likeliest(lambda *f, e=error: (e, np.broadcast_to(sigma(*f), e.shape)), 1.0)
        ratios.append(np.log(np.array(made) / truth))
    assert np.abs(np.mean(ratios, axis=0)).max() < 0.2
    assert np.std(ratios, axis=0).max() < 0.35


@pytest.mark.parametrize("seed", range(12))
def test_no_factors_beside_the_likeliest_are_likelier(seed, monkeypatch):
    """Errors follow the factors, too, and variances do not quite add up, as those of a filter."""
    random = np.random.default_rng(seed)
    truth = 2.0 ** random.uniform(-3.0, 2.0, 3)
    noise = random.standard_normal((40, 5))

    def errors(*factors):
        spread = sigma(*factors) ** 1.1
        return noise * sigma(*truth) * (1.0 + 0.1 * spread / (0.1 + spread)), spread + 0 * noise

    def total(powers):
        prior = np.sum((np.log(2.0) * np.array(powers) + 1.0) ** 2)
        return cost(*errors(*(2.0 ** np.array(powers)))) + prior

    middles = []
    monkeypatch.setattr(
        likeliest_noise, "_mean", lambda _, middle: middles.append(middle) or np.ones(3)
    )
    likeliest(errors, 1.0)
    beside = middles[0] + np.concatenate([np.eye(3), -np.eye(3)])
    inside = np.all((beside > LEAST_POWERS) & (beside < MOST_POWERS), axis=1)
    assert total(middles[0]) <= min(total(powers) for powers in beside[inside])


def test_few_runs_are_made():
    runs = []

    def errors(*factors):
        runs.append(factors)
        return sigma(1.5, 0.3, 1.0), sigma(*factors)

    likeliest(errors, 1.0)
    assert len(runs) == len(set(runs)) <= 18


@pytest.mark.parametrize("truth", [(0.1, 0.2, 0.5), (0.12, 0.4, 1.0), (3.0, 0.2, 0.5)])
def test_a_guess_near_the_likeliest_spares_runs_and_changes_nothing(truth):
    runs = []

    def errors(*factors):
        runs.append(factors)
        return sigma(*truth) * unit, sigma(*factors) + 0.0 * unit

    unit = np.random.default_rng(4).standard_normal((60, 5))
    without = likeliest(errors, 1.0)
    many = len(runs)
    assert likeliest(errors, 1.0, 1.2 * np.array(truth[:2])) == without
    assert len(runs) - many < many


@pytest.mark.parametrize("guess", [(1e-9, 1e9), (8.0, 0.01)])
def test_a_guess_far_off_changes_nothing(guess):
    error = sigma(0.5, 2.0, 1.0) * np.random.default_rng(2).standard_normal((120, 5))

    def errors(*factors):
        return error, np.broadcast_to(sigma(*factors), error.shape)

    assert likeliest(errors, 1.0, np.array(guess)) == likeliest(errors, 1.0)


def test_without_anything_seen_the_grade_counts():
    nothing = np.empty((0, 3))
    assert likeliest(lambda g, a, s: (nothing, nothing), 1.0) == pytest.approx((1.0, 1.0, 1.0))


def test_where_a_drift_bends_less_than_a_line_the_prior_bounds_the_factors():
    """Accelerometers and their scale factors can stand in for each other in a narrow valley."""

    def errors(gyro, accel, scale):
        both, either = np.log2(accel * scale), np.log2(accel / scale)
        error = np.array([2.0 * both, np.sqrt(40.0 - 0.22 * either**2), np.log2(gyro)])
        return error, np.ones(3)

    _, accel, scale = likeliest(errors, 1.0)
    assert max(accel, scale) < 2.0


def test_the_cost_is_twice_the_negative_log_likelihood():
    random = np.random.default_rng(0)
    spread = random.uniform(0.5, 20.0, (40, 3, 3))
    error = 1.3 * spread * random.standard_normal(spread.shape)
    error[3, 0, 0] = np.nan
    likelihood = norm.logpdf(error, scale=spread)
    known = np.count_nonzero(np.isfinite(likelihood))
    expected = -2.0 * np.nansum(likelihood) - known * np.log(2.0 * np.pi)
    assert cost(error, spread) == pytest.approx(expected)
