"""Congruent matrices are those that NumPy computes, and symmetric."""

import numpy as np
import pytest

from sinstool.core.congruence import congruent


@pytest.mark.parametrize(("rows", "columns", "one"), [(3, 3, False), (3, 4, True), (2, 5, False)])
def test_products_of_matrices(rows, columns, one):
    rng = np.random.default_rng(8)
    a = rng.normal(size=(50, rows, columns))
    m = rng.normal(size=(columns, columns) if one else (50, columns, columns))
    m = m + np.swapaxes(m, -1, -2)
    found = congruent(a, m)
    np.testing.assert_allclose(found, a @ m @ np.swapaxes(a, 1, 2), rtol=0, atol=1e-13)
    np.testing.assert_array_equal(found, np.swapaxes(found, 1, 2))


def test_matrices_that_lie_otherwise_in_memory():
    rng = np.random.default_rng(9)
    a, m = rng.normal(size=(7, 4, 4)), np.eye(4) * np.arange(1.0, 8.0)[:, None, None]
    turned = np.swapaxes(a, 1, 2)
    np.testing.assert_array_equal(congruent(turned, m), congruent(turned.copy(), m))


def test_none_and_too_few():
    assert congruent(np.empty((0, 3, 3)), np.eye(3)).shape == (0, 3, 3)
    with pytest.raises(ValueError, match="one matrix or 4"):
        congruent(np.ones((4, 3, 3)), np.ones((2, 3, 3)))
