"""Covariances in the axes of a body."""

import numpy as np
import pytest

from sinstool.core.congruence import of_turned, turned_back
from sinstool.core.rotation import exp, normalise, to_dcm


def some(count=7):
    rng = np.random.default_rng(5)
    a = rng.standard_normal((count, 3, 3))
    return normalise(rng.standard_normal((count, 4))), a @ np.swapaxes(a, 1, 2)


@pytest.mark.parametrize("sign", [(1.0, 1.0, 1.0), (1.0, -1.0, -1.0)])
def test_as_by_products_of_matrices(sign):
    q, m = some()
    turn = to_dcm(q) * np.array(sign)
    found = turned_back(q, m, np.array(sign))
    np.testing.assert_allclose(found, np.swapaxes(turn, 1, 2) @ m @ turn, rtol=1e-12, atol=1e-14)
    np.testing.assert_array_equal(found, np.swapaxes(found, 1, 2))


def test_of_columns_that_are_not_in_one_piece():
    q, m = some(10)
    sign = np.ones(3)
    found = turned_back(q[::2], m[::2], sign)
    np.testing.assert_array_equal(found, turned_back(q[::2].copy(), m[::2].copy(), sign))


def test_of_nothing():
    assert turned_back(np.empty((0, 4)), np.empty((0, 3, 3)), np.ones(3)).shape == (0, 3, 3)


def test_uncertain_axes_make_a_vector_uncertain():
    """As many draws of the axes scatter its components."""
    rng = np.random.default_rng(6)
    _, turn = some(4)
    v, turn = 20.0 * rng.standard_normal((4, 3)), 1e-6 * turn
    found = of_turned(v, turn)
    np.testing.assert_array_equal(found, np.swapaxes(found, 1, 2))
    for one, covariance, size in zip(v, turn, found, strict=True):
        angles = rng.multivariate_normal(np.zeros(3), covariance, 40_000)
        seen = np.cov((to_dcm(exp(angles)) @ one).T)
        np.testing.assert_allclose(size, seen, atol=0.03 * np.trace(seen))
