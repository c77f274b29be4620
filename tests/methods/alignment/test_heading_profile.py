"""Headings held against all others: sigmas of profiles, and the likelier of two minima."""

import numpy as np
import pytest

from sinstool.core.rotation import exp, from_dcm, log, to_dcm
from sinstool.core.units import DEGREE
from sinstool.methods.alignment.heading_profile import (
    AROUND,
    NEAR,
    Profile,
    likeliest,
    profiled,
)
from sinstool.methods.alignment.refine import STATES, Refined

DOWN = np.array([0.0, 0.0, 1.0])
MANY = 300


def angles(sigma):
    near = NEAR * sigma
    return np.unique(np.concatenate([-near, near, AROUND * np.arange(-3, 5)]))


@pytest.mark.parametrize("sigma", [0.5, 1.0, 3.0])
def test_a_parabola_has_the_sigma_of_its_normal_distribution(sigma):
    offset = angles(sigma * DEGREE)
    profile = Profile(offset, 642.0 + (offset / (sigma * DEGREE)) ** 2)
    assert profile.sigma(1.0) == pytest.approx(sigma * DEGREE, rel=0.15)


def test_where_all_headings_do_none_is_known():
    """A uniform angle has a standard deviation of pi over the root of three."""
    offset = angles(2.0 * DEGREE)
    flat = Profile(offset, np.full(len(offset), 217.0))
    assert flat.sigma(1.0) == pytest.approx(np.pi / np.sqrt(3.0), rel=0.1)


def refinement(best, claimed, curvature, misfit=0.5, lasting=1.0):
    """A refinement of which only headings near `best` explain the fixes; it moves none of them."""

    def refine(dcm, held=None):
        heading = log(from_dcm(dcm[None]))[0, 2]
        off = (heading - best + np.pi) % (2.0 * np.pi) - np.pi
        covariance = np.zeros((STATES, STATES))
        covariance[range(3), range(3)] = claimed**2
        chi2 = misfit + (off / curvature) ** 2 / MANY
        return Refined(dcm, np.zeros(STATES), covariance, 0, 0, chi2, lasting)

    return refine


def start(heading):
    return to_dcm(exp(np.array([[0.0, 0.0, heading]])))[0]


def test_a_sigma_that_others_bear_out_stays():
    refine = refinement(0.3, 1.0 * DEGREE, 1.0 * DEGREE)
    found, lacking = profiled(refine, refine(start(0.3)), DOWN, MANY)
    np.testing.assert_allclose(found.dcm, start(0.3), atol=1e-9)
    assert not lacking.any()


def test_a_claim_that_others_do_not_bear_out_is_widened():
    refine = refinement(0.3, 1.0 * DEGREE, 8.0 * DEGREE)
    _, lacking = profiled(refine, refine(start(0.3)), DOWN, MANY)
    assert np.sqrt(lacking[2, 2] + DEGREE**2) == pytest.approx(8.0 * DEGREE, rel=0.3)
    np.testing.assert_array_equal(lacking[:2], 0.0)


def test_a_heading_that_explains_more_is_taken():
    refine = refinement(0.3, 10.0 * DEGREE, 10.0 * DEGREE)
    found, _ = profiled(refine, refine(start(0.3 - 0.5 * np.pi)), DOWN, MANY)
    np.testing.assert_allclose(found.dcm, start(0.3), atol=1e-6)


def test_innovations_larger_than_expected_widen_a_sigma_once():
    """The answer's covariance grows by them anyway: what a profile shows is not added to that."""
    refine = refinement(0.3, 1.0 * DEGREE, 1.0 * DEGREE, misfit=9.0)
    _, lacking = profiled(refine, refine(start(0.3)), DOWN, MANY)
    assert not lacking.any()


@pytest.mark.parametrize("heading", [-2.9, -0.4, 1.7])
def test_of_headings_all_around_the_one_that_explains_most_is_found(heading):
    refine = refinement(heading, 5.0 * DEGREE, 5.0 * DEGREE)
    found = likeliest(refine, start(0.3), DOWN)
    off = log(from_dcm((found.dcm @ start(-heading))[None]))[0]
    np.testing.assert_allclose(off[:2], 0.0, atol=1e-9)
    assert abs(off[2]) <= 0.25 * AROUND + 1e-9


def test_innovations_that_follow_one_another_are_worth_less():
    refine = refinement(0.3, 2.0 * DEGREE, 2.0 * DEGREE, lasting=9.0)
    _, lacking = profiled(refine, refine(start(0.3)), DOWN, MANY, lasting=True)
    assert np.sqrt(lacking[2, 2] + (2.0 * DEGREE) ** 2) == pytest.approx(6.0 * DEGREE, rel=0.2)
    _, lacking = profiled(refine, refine(start(0.3)), DOWN, MANY)
    assert not lacking.any()
