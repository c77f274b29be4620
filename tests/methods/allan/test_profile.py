"""Edges of intervals of a known deviance."""

import numpy as np
import pytest

from sinstool.methods.allan.profile import edge


@pytest.mark.parametrize("best, sigma", [(5.0, 0.8), (5.0, 3.0), (0.4, 2.0), (0.0, 1.0)])
@pytest.mark.parametrize("guess", [0.1, 1.0, 5.0])
@pytest.mark.parametrize("bend", [0.0, 0.3])
def test_edges_are_where_the_root_of_the_rise_is_the_target(best, sigma, guess, bend):
    """Of a coefficient that cannot be negative: down to 0 where even that is likely enough."""

    def root(value):
        z = abs(value - best) / sigma
        return z * (1.0 + bend * z)

    for side in (-1.0, 1.0):
        found = edge(lambda v, p: (root(v) ** 2, p), np.zeros(3), best, guess * sigma, side, 1.96)
        if side < 0.0 and root(0.0) < 1.96:
            assert found == 0.0
        else:
            assert np.sign(found - best) == side
            assert root(found) == pytest.approx(1.96, abs=0.01)
