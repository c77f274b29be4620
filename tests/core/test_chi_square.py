"""Points of the chi-square distribution."""

import numpy as np
import pytest
from scipy.special import chdtri

from sinstool.core.chi_square import upper_point


@pytest.mark.parametrize("freedom", [1, 2, 3, 6, 17, 80, 400, 5000])
def test_points_are_those_of_scipy(freedom):
    for probability in (1e-9, 1e-6, 1e-4, 0.01, 0.025, 0.3, 0.5, 0.7, 0.975, 0.999):
        expected = float(chdtri(freedom, probability))
        assert upper_point(freedom, probability) == pytest.approx(expected, rel=2e-12)


def test_what_is_never_and_always_exceeded():
    assert upper_point(3, 0.0) == np.inf
    assert upper_point(3, 1.0) == 0.0
