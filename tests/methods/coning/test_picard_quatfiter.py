"""Picard, QuatFIter and the iteration of Rodrigues vectors: three ways to one number."""

from itertools import pairwise

import mpmath
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sinstool.core import rotation
from sinstool.core.errors import ConfigurationError
from sinstool.methods.coning.picard import Picard
from sinstool.methods.coning.polynomial import (
    chebyshev,
    reduction,
    through_increments,
    through_rates,
)
from sinstool.methods.coning.quatfiter import QuatFIter
from sinstool.methods.coning.registry import algorithm
from tests.methods.coning.rodfiter import rodrigues_iteration

SIZES = (2, 3, 4, 6, 8)


def floats(matrix):
    return np.array([[float(c) for c in row] for row in matrix])


def alone(chosen, rows):
    return chosen.rotation_vectors(rows, np.full(len(rows), np.nan), 0, 1)[0]


@pytest.mark.parametrize(("rows", "first", "count"), [(1, 0, 1), (4, 0, 4), (5, 2, 3), (11, 5, 1)])
def test_polynomial_has_the_increments(rows, first, count):
    fit = floats(through_increments(rows, first, count))
    increments = np.random.default_rng(1).normal(size=rows)
    primitive = np.polynomial.Polynomial(fit @ increments).integ()
    edges = (2.0 * (np.arange(rows + 1) - first) - count) / count
    np.testing.assert_allclose(np.diff(primitive(edges)), increments, atol=1e-9)
    # -1 and 1 are the ends of the update
    assert edges[first] == -1.0
    assert edges[first + count] == 1.0


@pytest.mark.parametrize(("points", "interval"), [(2, 0), (5, 3), (12, 5)])
def test_polynomial_has_the_rates(points, interval):
    fit = floats(through_rates(points, interval))
    rates = np.random.default_rng(2).normal(size=points)
    nodes = 2.0 * (np.arange(points) - interval) - 1.0
    # the whole interval is 2 in tau
    np.testing.assert_allclose(np.polynomial.Polynomial(fit @ rates)(nodes), 0.5 * rates, atol=1e-9)


def test_reduced_polynomial_has_the_same_parts():
    coefficients = np.random.default_rng(3).normal(size=11)
    reduced = floats(reduction(10, 8)) @ coefficients
    edges = np.linspace(-1.0, 1.0, 9)
    parts = [np.diff(np.polynomial.Polynomial(c).integ()(edges)) for c in (coefficients, reduced)]
    np.testing.assert_allclose(parts[1], parts[0], atol=1e-13)
    assert len(reduced) == 8


def test_chebyshev_of_powers():
    for power in range(8):
        column = floats(chebyshev(8))[:, power]
        at = np.linspace(-1, 1, 11)
        np.testing.assert_allclose(
            np.polynomial.chebyshev.chebval(at, column), at**power, atol=1e-15
        )


def test_impossible_windows_are_refused():
    for bad in ((3, 0, 0), (3, 2, 2), (3, -1, 1)):
        with pytest.raises(ValueError, match="No update"):
            through_increments(*bad)
    with pytest.raises(ValueError, match="No update"):
        through_rates(4, 3)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("scale", [1e-5, 1e-2, 0.05])
def test_three_ways_agree_on_random_increments(size, scale):
    rng = np.random.default_rng(size)
    largest = 0.0
    for _ in range(20):
        rows = rng.normal(0.0, scale, size=(size, 3))
        phi = alone(Picard(size), rows)
        assert np.abs(alone(QuatFIter(size), rows) - phi).max() < 1e-14
        assert np.abs(rodrigues_iteration(rows) - phi).max() < 1e-14
        largest = max(largest, np.linalg.norm(phi - rows.sum(axis=0)))
    assert largest > 0.02 * scale**2  # and it is not the sum of the increments


def iterated_integrals(rows, digits=60):
    """Peano-Baker series of the update in exact polynomials and `digits` digits."""
    size = len(rows)
    with mpmath.workdps(digits):
        fit = through_increments(size, 0, size)
        weights = [[mpmath.mpf(w.numerator) / w.denominator for w in row] for row in fit]
        half = [
            [mpmath.fsum(w * mpmath.mpf(float(rows[j, i])) for j, w in enumerate(row)) / 2
             for i in range(3)]
            for row in weights
        ]  # fmt: skip
        term = [[mpmath.mpf(1), mpmath.mpf(0), mpmath.mpf(0), mpmath.mpf(0)]]
        total = list(term[0])
        for _ in range(60):
            rate = [[mpmath.mpf(0)] * 4 for _ in range(len(term) + size - 1)]
            for j, (w, x, y, z) in enumerate(term):
                for i, (a, b, c) in enumerate(half):
                    out = rate[i + j]
                    out[0] -= x * a + y * b + z * c
                    out[1] += w * a + y * c - z * b
                    out[2] += w * b + z * a - x * c
                    out[3] += w * c + x * b - y * a
            term = [[mpmath.mpf(0)] * 4] + [
                [v / (k + 1) for v in row] for k, row in enumerate(rate)
            ]
            term[0] = [-mpmath.fsum((-1) ** k * row[i] for k, row in enumerate(term))
                       for i in range(4)]  # fmt: skip
            end = [mpmath.fsum(row[i] for row in term) for i in range(4)]
            total = [a + b for a, b in zip(total, end, strict=True)]
            if max(abs(v) for v in end) < mpmath.mpf(10) ** (-digits + 20):
                break
        else:
            raise AssertionError("not converged")
        norm = mpmath.sqrt(mpmath.fsum(v * v for v in total[1:]))
        factor = 2 * mpmath.atan2(norm, total[0]) / norm
        # a solution is of length 1 by itself
        assert abs(mpmath.fsum(v * v for v in total) - 1) < mpmath.mpf(10) ** (-digits + 25)
        return np.array([float(factor * v) for v in total[1:]])


@pytest.mark.parametrize(("size", "scale"), [(2, 0.05), (4, 0.03), (8, 2e-3)])
def test_sixty_digits_confirm(size, scale):
    rows = np.random.default_rng(10 + size).normal(0.0, scale, size=(size, 3))
    exact = iterated_integrals(rows)
    for phi in (alone(Picard(size), rows), alone(QuatFIter(size), rows), rodrigues_iteration(rows)):
        np.testing.assert_allclose(phi, exact, rtol=0, atol=2e-16)


@pytest.mark.parametrize("size", [4, 8])
def test_large_rotations_with_noise(size):
    # polynomials with large coefficients that cancel: in parts, and against an ODE solver
    rows = np.random.default_rng(4).normal(0.0, 0.2 if size == 4 else 0.03, size=(size, 3))
    rows[:, 2] += 2.0 / size
    coefficients = floats(through_increments(size, 0, size)) @ rows
    assert np.abs(coefficients).sum() > 8.0

    def derivative(tau, q):
        rate = tau ** np.arange(size) @ coefficients
        return 0.5 * rotation.multiply(q, [0.0, *rate])

    end = solve_ivp(derivative, (-1, 1), [1.0, 0, 0, 0], method="DOP853", rtol=1e-12, atol=1e-13).y[
        :, -1
    ]
    phi = alone(Picard(size), rows)
    np.testing.assert_allclose(phi, rotation.log(end), atol=1e-10)
    np.testing.assert_allclose(alone(QuatFIter(size), rows), phi, atol=1e-13)


@pytest.mark.parametrize("family", [Picard, QuatFIter])
def test_more_than_half_a_turn_about_one_axis(family):
    rows = np.tile([0.0, 0.0, 1.2], (4, 1))
    np.testing.assert_allclose(alone(family(4), rows), [0, 0, 4.8], rtol=1e-14)


@pytest.mark.parametrize("before", [1, 3])
def test_fixed_iterations_take_earlier_samples_as_the_limit_does(before):
    x = 0.02 * np.random.default_rng(7).standard_normal((40, 3))
    dt = np.full(40, 0.01)
    limit = Picard(2, before).rotation_vectors(x, dt, 0, 20)
    found = Picard(2, before, iterations=12).rotation_vectors(x, dt, 0, 20)
    np.testing.assert_allclose(found, limit, atol=1e-13)
    alone_ = Picard(2, 0).rotation_vectors(x, dt, 0, 20)
    assert np.abs(alone_ - limit)[before:].max() > 1e-6


@pytest.mark.slow
def test_fixed_iterations_converge_to_the_limit():
    rows = np.random.default_rng(5).normal(0.02, 0.02, size=(4, 3))
    exact = alone(Picard(4), rows)
    errors = [
        np.abs(alone(Picard(4, iterations=k), rows) - exact).max() for k in (2, 3, 4, 5, 6, 12)
    ]
    assert all(late < 0.2 * early for early, late in pairwise(errors))
    assert errors[0] > 1e-6
    assert errors[-1] < 1e-16
    # one integral is the sum of the increments, as a quaternion that is normalised
    total = rows.sum(axis=0)
    expected = rotation.log([1.0, *(0.5 * total)])
    np.testing.assert_allclose(alone(Picard(4, iterations=1), rows), expected, rtol=1e-14)


@pytest.mark.parametrize("family", [Picard, QuatFIter])
def test_shorter_update_passes_through_earlier_increments(family):
    # a polynomial rate of degree 3: any window of four increments gives the same answer
    rng = np.random.default_rng(6)
    polynomials = [np.polynomial.Polynomial(rng.normal(0, 0.02, size=4)) for _ in range(3)]
    angle = np.stack([p.integ()(0.3 * np.arange(12)) for p in polynomials], axis=-1)
    rows, dt = np.diff(angle, axis=0), np.full(11, 0.3)
    fine = np.stack([p.integ()(0.3 * np.arange(48) / 4) for p in polynomials], axis=-1)
    exact = [alone(Picard(4), one) for one in np.diff(fine, axis=0)[:44].reshape(11, 4, 3)]
    answers = family(4).shorter(1).rotation_vectors(rows, dt, 3, 8)
    np.testing.assert_allclose(answers, exact[3:], rtol=0, atol=1e-15)
    # with less history, a lower degree
    early = family(4).shorter(1).rotation_vectors(rows, dt, 0, 1)
    np.testing.assert_allclose(early[0], rows[0], rtol=1e-14)


def test_diverging_rodrigues_vectors_are_not_an_answer():
    with pytest.raises(ValueError, match="converge"):
        rodrigues_iteration(np.tile([1.0, 0.0, 0.0], (4, 1)))
    with pytest.raises(ValueError, match="shape"):
        rodrigues_iteration(np.zeros(3))
    np.testing.assert_array_equal(rodrigues_iteration(np.zeros((4, 3))), 0.0)


def test_not_a_number_comes_to_an_end():
    rows = np.full((4, 3), np.nan)
    assert np.all(np.isnan(alone(Picard(4), rows)))
    assert np.all(np.isnan(alone(QuatFIter(4), rows)))
    assert np.all(np.isnan(alone(Picard(4), np.full((4, 3), np.inf))))


def test_impossible_sizes_are_refused():
    for name in ("picard-1", "quatfiter-11", "picard-0"):
        with pytest.raises(ConfigurationError, match="samples per update"):
            algorithm(name)
    with pytest.raises(ConfigurationError, match="iterations"):
        Picard(4, iterations=0)
