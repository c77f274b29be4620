"""Integrals of monotone piecewise cubics."""

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from sinstool.core.monotone_cubic import integral


@pytest.mark.parametrize("seed", range(6))
def test_integrals_are_those_of_scipy(seed):
    random = np.random.default_rng(seed)
    x = np.cumsum(random.uniform(0.05, 2.0, 3 if seed == 0 else 40))
    y = random.standard_normal((len(x), 2)).round(1)  # with equal neighbours
    at = np.concatenate([x, random.uniform(x[0], x[-1], 300)])
    expected = PchipInterpolator(x, y).antiderivative()(at)
    np.testing.assert_allclose(integral(x, y, at), expected, rtol=1e-12, atol=1e-12)
