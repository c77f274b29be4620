"""Running medians."""

import numpy as np
import pytest
from scipy.ndimage import median_filter

from sinstool.core.running_median import running_median


@pytest.mark.parametrize("wide", [1, 2, 7, 100])
@pytest.mark.parametrize("count", [100, 9000])
def test_they_are_those_of_scipy(count, wide):
    values = np.random.default_rng(count + wide).standard_normal((count, 3))
    expected = median_filter(values, wide, axes=0, mode="reflect")
    assert np.array_equal(running_median(values, wide), expected)
    alone = median_filter(values[:, 0], wide, mode="reflect")
    assert np.array_equal(running_median(values[:, 0], wide), alone)


def test_fewer_values_than_a_window():
    values = np.array([3.0, 1.0, 2.0])
    assert np.array_equal(running_median(values, 11), median_filter(values, 11, mode="reflect"))
