"""Medians and quantiles beside NumPy's."""

import subprocess
import sys

import numpy as np
import pytest

from sinstool.core.order_statistics import median, quantile


@pytest.mark.parametrize("shape", [(1,), (2,), (7,), (40,), (5, 6), (6, 5, 3)])
@pytest.mark.parametrize("axis", [None, 0, -1])
@pytest.mark.parametrize("share", [0.0, 0.05, 0.25, 0.5, 0.9, 1.0])
def test_they_are_numpys(shape, axis, share):
    for seed in range(5):
        random = np.random.default_rng(seed)
        values = random.choice([random.standard_normal(shape), random.integers(0, 4, shape)])
        assert quantile(values, share, axis) == pytest.approx(
            np.quantile(values, share, axis), rel=1e-14, abs=1e-15
        )
        assert median(values, axis) == pytest.approx(np.median(values, axis), rel=1e-14, abs=1e-15)


def test_infinite_values_and_none():
    assert median([1.0, np.inf, np.inf]) == np.inf
    assert median([np.inf, np.inf]) == np.inf
    assert median([1.0, 2.0, np.inf]) == 2.0
    assert np.isnan(median([1.0, np.nan, 2.0]))
    made = median([[1.0, np.nan, 2.0], [3.0, 1.0, 2.0]], axis=1)
    assert np.isnan(made[0]) and made[1] == 2.0
    assert np.isnan(median([])) and np.isnan(median(np.empty((0, 3)), axis=0)).all()
    assert isinstance(median([1, 2]), np.float64)


def test_no_masked_arrays_are_loaded():
    code = (
        "import sys; from sinstool.core.order_statistics import median; median([1.0, 2.0]);"
        " sys.exit('numpy.ma' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
