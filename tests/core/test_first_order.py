"""First-order recursion against scipy's."""

import numpy as np
from scipy.signal import lfilter

from sinstool.core.first_order import carry_over


def test_constant_decay_is_scipys_filter_to_the_bit():
    driven = np.random.default_rng(3).standard_normal((4000, 3))
    expected = lfilter([1.0], [1.0, -0.97], driven, axis=0)
    carry_over(np.full(4000, 0.97), driven)
    assert np.array_equal(driven, expected)


def test_decay_of_each_step_and_one_column():
    random = np.random.default_rng(4)
    decay, driven = random.uniform(0.2, 1.0, 50), random.standard_normal(50)
    expected = driven.copy()
    for k in range(1, 50):
        expected[k] += decay[k] * expected[k - 1]
    carry_over(decay, driven[:, None])
    assert np.array_equal(driven, expected)


def test_nothing_and_one_row_stay():
    for n in (0, 1):
        driven = np.full((n, 3), 2.0)
        carry_over(np.full(n, 0.5), driven)
        assert np.array_equal(driven, np.full((n, 3), 2.0))
