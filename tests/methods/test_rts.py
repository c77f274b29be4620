"""The smoother's gain and covariance, against the same in matrices."""

import numpy as np
import pytest

from sinstool.methods.rts import ROWS, smoothed_change, smoother_gain


def a_step(n, seed, unknown=()):
    """Transition, covariance after a row and before the next, and the smoothed one of that."""
    random = np.random.default_rng(seed)
    scale = 10.0 ** random.uniform(-4.0, 3.0, n)
    root = scale[:, None] * random.standard_normal((n, n))
    p_plus = root @ root.T
    for k in unknown:  # known exactly, before and after
        p_plus[k], p_plus[:, k] = 0.0, 0.0
    transition = np.eye(n) + 0.1 * scale[:, None] * random.standard_normal((n, n)) / scale
    for k in unknown:
        transition[k] = np.eye(n)[k]
    noise = np.where(np.isin(np.arange(n), unknown), 0.0, (0.3 * scale) ** 2)
    p_minus = transition @ p_plus @ transition.T + np.diag(noise)
    # a later measurement of one combination
    h = random.standard_normal(n) / scale
    gain = p_minus @ h / (h @ p_minus @ h + 0.01)
    return transition, p_plus, p_minus, p_minus - np.outer(gain, h @ p_minus), scale


@pytest.mark.parametrize("n, unknown", [(1, ()), (4, ()), (9, (2,)), (15, (0, 7, 14)), (26, (3,))])
@pytest.mark.parametrize("seed", range(3))
def test_gain_and_smoothed_covariance(n, unknown, seed):
    transition, p_plus, p_minus, after, scale = a_step(n, seed, unknown)
    p_minus, after = np.ascontiguousarray(p_minus), np.ascontiguousarray(after)
    even = n + -n % ROWS
    columns = min(3, even // ROWS) * ROWS
    made_up = np.zeros((even, even))
    made_up[:n, :n] = p_minus
    gains, product, up = (
        np.zeros((even, columns)),
        np.empty((even, columns)),
        np.empty((even, even)),
    )
    gains[:n] = np.pad(transition @ p_plus, ((0, 0), (0, even - n)))[:, :columns]
    smoother_gain(made_up, columns, gains, up, np.empty(even))
    unit = p_minus / np.outer(scale, scale)
    inverse = np.linalg.pinv(unit) / np.outer(scale, scale)
    gain = p_plus @ transition.T @ inverse
    size, rows = np.outer(scale, 1.0 / scale), min(n, columns)
    np.testing.assert_allclose(
        gains[:n, :rows].T / size[:rows], gain[:rows] / size[:rows], atol=1e-7
    )
    np.testing.assert_array_equal(made_up[:n, :n], p_minus)
    change = np.full((columns, columns), np.nan)
    smoothed_change(made_up, after, columns, gains, product, change)
    size, both = np.outer(scale, scale), (after - p_minus) @ gain.T
    expected = np.tril(gain @ both / size)[:rows, :rows]
    np.testing.assert_allclose(
        np.tril(change[:rows, :rows] / size[:rows, :rows]), expected, atol=1e-7
    )
    np.testing.assert_allclose(
        product[:n, :rows] / size[:, :rows], -both[:, :rows] / size[:, :rows], atol=1e-7
    )
