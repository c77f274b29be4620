from fractions import Fraction as F

import numpy as np
import pytest

from sinstool.methods.coning.increments import (
    POINTS,
    RateIntegrator,
    convert,
    integration_stencils,
)


def test_published_centred_stencils():
    assert integration_stencils(2) == ((F(1, 2), F(1, 2)),)
    assert integration_stencils(4)[1] == tuple(F(n, 24) for n in (-1, 13, 13, -1))
    assert integration_stencils(6)[2] == tuple(F(n, 1440) for n in (11, -93, 802, 802, -93, 11))
    half = (-191, 1879, -9531, 68323)
    assert integration_stencils(8)[3] == tuple(F(n, 120960) for n in (*half, *half[::-1]))


def test_published_one_sided_stencils():
    # Adams-Moulton of order 4 and 6, read from either end
    assert integration_stencils(4)[0] == tuple(F(n, 24) for n in (9, 19, -5, 1))
    assert integration_stencils(6)[-1] == tuple(
        F(n, 1440) for n in (27, -173, 482, -798, 1427, 475)
    )


@pytest.mark.parametrize("points", [2, 3, 4, 5, 6, 7, 8])
def test_stencils_integrate_polynomials_exactly(points):
    for position, row in enumerate(integration_stencils(points), start=1):
        for power in range(points):
            integral = F(position ** (power + 1) - (position - 1) ** (power + 1), power + 1)
            assert sum(w * F(node) ** power for node, w in enumerate(row)) == integral


@pytest.mark.parametrize("points", POINTS)
@pytest.mark.parametrize("count", [2, 3, 4, 5, 7, 8, 15])
def test_polynomial_rates_are_integrated_exactly_up_to_the_ends(points, count):
    rng = np.random.default_rng(points)
    h = 0.01
    degree = min(points, count) - 1
    polynomials = [np.polynomial.Polynomial(rng.normal(size=degree + 1)) for _ in range(3)]
    k = np.arange(count)
    rate = np.stack([p(k) for p in polynomials], axis=-1)
    angle = np.stack([h * p.integ()(k) for p in polynomials], axis=-1)
    answers = RateIntegrator(points).increments(rate, np.full(count, h), 1, count - 1)
    scale = np.abs(angle).max()
    np.testing.assert_allclose(answers, np.diff(angle, axis=0), rtol=0, atol=1e-13 * scale)


@pytest.mark.parametrize("points", POINTS)
def test_order_of_the_error(points):
    def worst(h):
        t = h * np.arange(round(2.0 / h) + 1)
        rate = np.stack([np.cos(3 * t), np.sin(5 * t), np.cos(4 * t + 1)], axis=-1)
        angle = np.stack([np.sin(3 * t) / 3, -np.cos(5 * t) / 5, np.sin(4 * t + 1) / 4], axis=-1)
        answers = RateIntegrator(points).increments(rate, np.full(len(t), h), 1, len(t) - 1)
        return np.abs(answers - np.diff(angle, axis=0)).max()  # the ends are the worst

    slope = np.log2(worst(0.02) / worst(0.01))
    assert slope == pytest.approx(points + 1, abs=0.5)


@pytest.mark.parametrize("points", POINTS)
def test_an_interval_depends_on_nothing_but_its_window(points):
    rng = np.random.default_rng(3)
    rate, dt = rng.normal(size=(40, 3)), rng.uniform(0.004, 0.006, size=40)
    integrator = RateIntegrator(points)
    together = integrator.increments(rate, dt, 1, 39)
    for row in range(1, 40):
        start, stop = max(row - integrator.before, 0), min(row + 1 + integrator.after, 40)
        alone = integrator.increments(rate[start:stop], dt[start:stop], row - start, 1)
        np.testing.assert_array_equal(alone[0], together[row - 1])


def test_an_interval_scales_with_its_own_duration():
    rng = np.random.default_rng(4)
    rate, dt = rng.normal(size=(12, 3)), np.full(12, 0.01)
    regular = RateIntegrator().increments(rate, dt, 1, 11)
    dt[5] = 0.02
    longer = RateIntegrator().increments(rate, dt, 1, 11)
    np.testing.assert_array_equal(longer[4], 2 * regular[4])
    np.testing.assert_array_equal(np.delete(longer, 4, axis=0), np.delete(regular, 4, axis=0))


def test_conversions_between_the_kinds():
    rng = np.random.default_rng(6)
    increment, dt = rng.normal(size=(5, 3)), rng.uniform(0.5, 2.0, size=5)
    mean_rate = increment / dt[:, None]
    assert convert(increment, dt, "increment", "increments") is increment
    np.testing.assert_allclose(convert(mean_rate, dt, "mean-rate", "increments"), increment)
    np.testing.assert_array_equal(convert(increment, dt, "increment", "rates"), mean_rate)
    assert convert(mean_rate, dt, "mean-rate", "rates") is mean_rate
    assert convert(mean_rate, dt, "rate", "rates") is mean_rate
    with pytest.raises(ValueError, match="integrate"):
        convert(mean_rate, dt, "rate", "increments")


def test_bad_arguments_are_refused():
    with pytest.raises(ValueError, match="points"):
        RateIntegrator(5)
    with pytest.raises(ValueError, match="No interval"):
        integration_stencils(1)
    rate, dt = np.zeros((4, 3)), np.ones(4)
    for first, count in ((0, 1), (1, 4), (4, 1), (1, -1)):
        with pytest.raises(ValueError, match="do not fit"):
            RateIntegrator().increments(rate, dt, first, count)
    with pytest.raises(ValueError, match="shapes"):
        RateIntegrator().increments(rate, dt[1:], 1, 1)
    assert RateIntegrator().increments(rate, dt, 1, 0).shape == (0, 3)
