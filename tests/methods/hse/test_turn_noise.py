import numpy as np
import pytest

from sinstool.methods.hse.turn_noise import sigma_of_mean


def turns(random, count, white=1.0, sway=0.0):
    """Rates of turns: white noise, and the change of an angle that stays small."""
    angle = sway * random.standard_normal(count + 1)
    return 5.0 + white * random.standard_normal(count) + np.diff(angle)


def over_sigma(count, white, sway, draws=300):
    random = np.random.default_rng([count, int(10 * sway)])
    values = [turns(random, count, white, sway) for _ in range(draws)]
    return np.array([(v.mean() - 5.0) / sigma_of_mean(v) for v in values])


def test_few_turns_show_nothing():
    assert np.isnan(sigma_of_mean([1.0, 2.0, 3.0]))
    assert sigma_of_mean([2.0, 2.0, 2.0, 2.0]) == 0.0


def test_it_is_the_average_by_likelihood():
    """The same by dense matrices: contrasts of the turns, and every ratio by itself."""
    values = turns(np.random.default_rng(3), 9, 1.0, 1.0)
    n, ratios = len(values), [0.0, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0]
    cancels = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    contrasts = np.diff(np.eye(n), axis=0)
    weights, variances = [], []
    for ratio in ratios:
        covariance = contrasts @ (np.eye(n) + ratio * cancels) @ contrasts.T
        seen = contrasts @ values
        square = seen @ np.linalg.solve(covariance, seen)
        prior = 0.9 if ratio == 0.0 else 0.1 / 8
        weights.append(prior * np.linalg.det(covariance) ** -0.5 * square ** (-(n - 1) / 2))
        mean = np.full(n, 1.0 / n)
        variances.append(square / (n - 1) * mean @ (np.eye(n) + ratio * cancels) @ mean)
    wanted = np.sqrt(np.average(variances, weights=weights))
    assert sigma_of_mean(values) == pytest.approx(wanted, rel=1e-10)
    assert sigma_of_mean(1e-9 * values) == pytest.approx(1e-9 * wanted, rel=1e-10)


@pytest.mark.parametrize("count", [4, 10, 40])
def test_white_noise_keeps_the_scatter_of_the_turns(count):
    random = np.random.default_rng(count)
    values = [turns(random, count) for _ in range(200)]
    ratio = [sigma_of_mean(v) / (v.std(ddof=1) / np.sqrt(count)) for v in values]
    assert 0.93 < np.mean(ratio) <= 1.0


@pytest.mark.parametrize("sway", [0.0, 1.0, 3.0, 30.0])
def test_errors_over_sigma_of_sixty_turns(sway):
    """The scatter over the root of their number gives 0.6, 0.26 and 0.12 with sway."""
    assert 0.7 < np.sqrt(np.mean(over_sigma(60, 1.0, sway) ** 2)) < 1.25


def test_sway_of_twenty_turns_is_seen_in_part():
    scatter = 0.23  # errors over the scatter of the turns
    assert 1.4 * scatter < np.sqrt(np.mean(over_sigma(20, 0.01, 10.0) ** 2)) < 1.2
