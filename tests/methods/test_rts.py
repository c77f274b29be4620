"""The smoother's gain and covariance, against the same in matrices."""

import numpy as np
import pytest

from sinstool.methods.rts import smoother_covariance, smoother_gain


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


@pytest.mark.parametrize("n, unknown", [(1, ()), (4, ()), (9, (2,)), (15, (0, 7, 14))])
@pytest.mark.parametrize("seed", range(3))
def test_gain_and_smoothed_covariance(n, unknown, seed):
    transition, p_plus, p_minus, after, scale = a_step(n, seed, unknown)
    p_minus, after = np.ascontiguousarray(p_minus), np.ascontiguousarray(after)
    transposed, low, diff = np.empty((n, n)), np.full((n, n), 7.0), np.full((n, n), 9.0)
    smoother_gain(transition, p_plus, p_minus, transposed, low, np.empty(n))
    unit = p_minus / np.outer(scale, scale)
    inverse = np.linalg.pinv(unit) / np.outer(scale, scale)
    gain = p_plus @ transition.T @ inverse
    size = np.outer(scale, 1.0 / scale)
    np.testing.assert_allclose(transposed.T / size, gain / size, atol=1e-7)
    expected = p_plus + gain @ (after - p_minus) @ gain.T
    for into in ("room of its own", "p_plus", "after"):
        before, later, out = p_plus.copy(), after.copy(), np.full((n, n), np.nan)
        out = {"p_plus": before, "after": later}.get(into, out)
        smoother_covariance(before, p_minus, later, transposed, diff, low, out)
        size = np.outer(scale, scale)
        np.testing.assert_allclose(out / size, expected / size, atol=1e-7)
        np.testing.assert_array_equal(out, out.T)
