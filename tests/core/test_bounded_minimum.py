"""Brent's minimum within bounds."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from sinstool.core.bounded_minimum import bounded_minimum


@pytest.mark.parametrize(
    "function",
    [
        lambda x: (x - 0.3) ** 2,
        lambda x: abs(x - 0.7) + 0.1 * x,
        lambda x: np.cosh(5.0 * (x + 0.2)) - x,
        lambda x: -x,
        lambda x: 1.0,
        lambda x: np.exp(-30.0 * x) + x**4,
    ],
)
def test_the_place_is_that_of_scipy(function):
    places = []

    def noted(x):
        places.append(x)
        return function(x)

    expected = minimize_scalar(
        function, bounds=(-0.5, 1.0), method="bounded", options={"xatol": 1e-5}
    )
    assert bounded_minimum(noted, -0.5, 1.0, 1e-5) == (expected.x, expected.fun)
    assert len(places) == expected.nfev
    assert min(places) >= -0.5 and max(places) <= 1.0
