"""Units of noise that other programs ask for."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from sinstool.pipelines.allan.formats import kf_gins_keys

DEGREE = np.pi / 180.0


def test_a_bias_of_kf_gins_is_the_markov_process_with_the_flat_part_that_was_measured():
    """By the Allan variance of a first-order Markov process, and that of flicker noise."""

    def variance(x):  # of 1 sigma, at so many correlation times
        return 2.0 / x * (1.0 - (3.0 - 4.0 * np.exp(-x) + np.exp(-2.0 * x)) / (2.0 * x))

    peak = minimize_scalar(lambda x: -variance(x), bounds=(0.5, 5.0), method="bounded")
    sigma = np.sqrt(2.0 * np.log(2.0) / np.pi) / np.sqrt(-peak.fun)
    of = {key: scaled for key, _, _, _, scaled in kf_gins_keys(100.0)}
    assert of["gbstd"](DEGREE / 3600.0) == pytest.approx(sigma, rel=1e-3)
    assert of["abstd"](1e-5) == pytest.approx(sigma, rel=1e-3)
    assert of["arw"](DEGREE / 60.0) == pytest.approx(1.0)
    assert of["vrw"](1.0 / 60.0) == pytest.approx(1.0)
