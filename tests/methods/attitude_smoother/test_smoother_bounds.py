"""Sigmas of a smoothed attitude have a limit."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sinstool.methods.attitude_smoother.smoother import UNKNOWN_ANGLE, bound_sigmas


@settings(max_examples=50, deadline=None)
@given(size=st.floats(1e-6, 1e6), seed=st.integers(0, 99))
def test_no_sigma_is_beyond_that_of_any_angle(size, seed):
    factor = size * np.random.default_rng(seed).standard_normal((5, 3, 3))
    before = factor @ factor.transpose(0, 2, 1)
    after = before.copy()
    bound_sigmas(after)
    sigma = np.sqrt(np.einsum("nii->ni", after))
    np.testing.assert_allclose(
        sigma, np.minimum(np.sqrt(np.einsum("nii->ni", before)), UNKNOWN_ANGLE), rtol=1e-9
    )
    assert (np.linalg.eigvalsh(after) > -1e-9 * sigma.max() ** 2).all()


def test_what_is_no_variance_is_any_angle():
    covariance = np.stack([np.diag([1e-4, 1e-4, 1e-2]), np.diag([1e30, -1e14, 3.0])])
    covariance = np.concatenate([covariance, np.full((1, 3, 3), np.nan)])
    bound_sigmas(covariance)
    np.testing.assert_array_equal(covariance[0], np.diag([1e-4, 1e-4, 1e-2]))
    np.testing.assert_allclose(
        covariance[1:], np.broadcast_to(UNKNOWN_ANGLE**2 * np.eye(3), (2, 3, 3))
    )
