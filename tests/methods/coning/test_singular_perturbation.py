import mpmath
import numpy as np
import pytest
from scipy.integrate import quad

from sinstool.core.errors import ConfigurationError
from sinstool.methods.coning import singular_perturbation as kernels
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.singular_perturbation import VARIANTS

T = 0.0025
W1 = np.array([0.9, -0.4, 0.25])
W2 = np.array([0.7, -0.1, -0.35])


def perturbation(**options):
    return algorithm("singular-perturbation", **options)


def one_update(chosen, w1=W1, w2=W2, t=T):
    return chosen.rotation_vectors(np.stack([w1, w2]), np.array([np.nan, t]), 1, 1)[0]


def exact_kernels(x):
    e = mpmath.exp(-x)
    g1 = -1 / (2 * x) - e / (2 * x) - 2 * e / x**2 + 2 * (1 - e) / x**3
    langevin = mpmath.coth(x / 2) - 2 / x
    return {
        "g0": (1 - e) / x,
        "g1": g1,
        "g2": 2 * (1 - e) / x**2 - (1 + e) / x,
        "langevin": langevin,
        "h1": (g1 + mpmath.mpf(1) / 6) / (1 - e),
        "h2": -langevin / x,
    }


def test_kernels_keep_their_digits_for_every_ratio():
    ratios = np.concatenate([np.logspace(-12, 8, 801), np.linspace(0.98, 1.02, 41)])
    with mpmath.workdps(80):
        for x in ratios:
            for name, exact in exact_kernels(mpmath.mpf(float(x))).items():
                ours = mpmath.mpf(float(getattr(kernels, name)(x)))
                assert abs(ours / exact - 1) < 1e-13, (name, x)


def test_kernels_at_no_ratio_at_all():
    limits = {"g0": 1.0, "g1": -1 / 6, "g2": 0.0, "langevin": 0.0, "h1": 0.0, "h2": -1 / 6}
    for name, value in limits.items():
        assert getattr(kernels, name)(0.0) == pytest.approx(value, abs=1e-17)


def integrated(model, t):
    """Integrals of omega and of alpha x omega / 2 of a rate model, by quadrature."""
    alpha = [lambda s, i=i: quad(lambda u: model(u)[i], 0, s, epsabs=0)[0] for i in range(3)]

    def integrand(s, i):
        return np.cross([a(s) for a in alpha], model(s))[i] / 2

    correction = [quad(integrand, 0, t, args=(i,), epsabs=0, epsrel=1e-10)[0] for i in range(3)]
    return np.array([a(t) for a in alpha]) + correction


@pytest.mark.parametrize("epsilon", [2e-4, 1.5e-3, 0.03])
@pytest.mark.parametrize("variant", ["exact", "bvp"])
def test_integral_of_the_rate_model(variant, epsilon):
    beta = np.array([120.0, -75.0, 200.0])
    boundary = W1 - beta * T - W2
    if variant == "exact":  # eq. 10

        def model(t):
            return boundary * np.exp(-t / epsilon) - beta * t + beta * T + W2
    else:  # eq. 3 with both of its boundary values
        size = boundary / -np.expm1(-T / epsilon)

        def model(t):
            return size * np.exp(-t / epsilon) - beta * t + W1 - size

        np.testing.assert_allclose(model(0.0), W1)
        np.testing.assert_allclose(model(T), W2)
    chosen = perturbation(variant=variant, epsilon=epsilon, beta=beta)
    np.testing.assert_allclose(one_update(chosen), integrated(model, T), rtol=1e-9)


def test_as_printed_is_equation_11():
    epsilon, beta = 7e-4, np.array([50.0, 90.0, -30.0])
    a, b, c = W1 - beta * T - W2, beta, beta * T + W2
    expected = (
        epsilon * a - b * T**2 / 2 + c * T
        + np.cross(a, b) / 2 * (epsilon * T**2 / 2 + 2 * epsilon**3)
        + np.cross(c, a) / 2 * (2 * epsilon**3 - epsilon * T)
        + np.cross(b, c) * T**3 / 12
    )  # fmt: skip
    chosen = perturbation(variant="printed", epsilon=epsilon, beta=beta)
    np.testing.assert_allclose(one_update(chosen), expected, rtol=1e-14)


@pytest.mark.parametrize("options", [{"beta_gain": 0.4}, {"beta": (40.0, -80.0, 10.0)}])
def test_variants_are_one_where_the_layer_is_thin(options):
    answers = [
        one_update(perturbation(variant=v, epsilon=T / 60, **options))
        for v in ("truncated", "exact", "bvp")
    ]
    np.testing.assert_allclose(answers[0], answers[1], rtol=1e-14)
    np.testing.assert_allclose(answers[2], answers[1], rtol=1e-14)
    # but neither as printed nor where the layer is thick
    printed = one_update(perturbation(variant="printed", epsilon=T / 60, **options))
    assert np.abs(printed - answers[1]).max() > 1e-10
    thick = [
        one_update(perturbation(variant=v, epsilon=T, **options))
        for v in ("truncated", "exact", "bvp")
    ]
    assert np.abs(thick[0] - thick[1]).max() > 1e-7
    assert np.abs(thick[2] - thick[1]).max() > 1e-7


LINEAR = T * (W1 + W2) / 2 + T**2 / 12 * np.cross(W1, W2)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("epsilon", [0.0, 1e-6, 2e-4, T, 0.032, 5.0])
def test_n_of_one_is_the_linear_rate(variant, epsilon):
    chosen = perturbation(variant=variant, epsilon=epsilon, beta_gain=1.0)
    np.testing.assert_allclose(one_update(chosen), LINEAR, rtol=1e-14)
    chosen = perturbation(variant=variant, epsilon=epsilon, beta=(W1 - W2) / T)
    np.testing.assert_allclose(one_update(chosen), LINEAR, rtol=1e-14)
    # which is two thirds of two half-interval increments' product
    first = T / 2 * (W1 + (W1 + W2) / 2) / 2
    second = T / 2 * ((W1 + W2) / 2 + W2) / 2
    two = first + second + 2 / 3 * np.cross(first, second)
    np.testing.assert_allclose(two, LINEAR, rtol=1e-14)


@pytest.mark.parametrize("beta", [(30.0, -20.0, 55.0), (0.0, 0.0, 0.0)])
def test_two_point_solution_of_a_wide_layer_is_linear_for_any_beta(beta):
    chosen = perturbation(variant="bvp", epsilon=1e9 * T, beta=beta)
    np.testing.assert_allclose(one_update(chosen), LINEAR, rtol=1e-8)


@pytest.mark.parametrize("variant", VARIANTS)
def test_no_layer_at_all_is_the_second_rate(variant):
    np.testing.assert_allclose(
        one_update(perturbation(variant=variant, epsilon=0.0, beta_gain=0.0)), T * W2, rtol=1e-15
    )


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("epsilon", [2e-4, 1.1e-3, 0.032])
@pytest.mark.parametrize("n", [-0.5, 0.001, 0.6, 2.0])
def test_collapse_to_two_numbers(variant, epsilon, n):
    gain = perturbation(variant=variant, epsilon=epsilon, beta_gain=n)
    vector = perturbation(variant=variant, epsilon=epsilon, beta=n / T * (W1 - W2))
    np.testing.assert_allclose(one_update(gain), one_update(vector), rtol=1e-12)

    p, kappa = gain.two_rate_form(T)
    two = p * W1 + (T - p) * W2 + kappa * np.cross(W1, W2)
    np.testing.assert_allclose(one_update(gain), two, rtol=1e-14)

    # the table of the collapsed form, from the definitions of its terms
    s, m, x = epsilon / T, 1 - n, T / epsilon
    e = np.exp(-x)
    g2 = 2 * (1 - e) / x**2 - (1 + e) / x
    langevin = 1 / np.tanh(x / 2) - 2 / x
    r, k2 = {
        "truncated": (s * m + n / 2, m * (s - 2 * s**2) + n / 6),
        "printed": (s * m + n / 2, m * (s - 2 * epsilon**3 / T**2) + n / 6),
        "exact": (s * m * (1 - e) + n / 2, -m * g2 + n / 6),
        "bvp": ((1 - m * langevin) / 2, m * langevin / x + n / 6),
    }[variant]
    assert p / T == pytest.approx(r, rel=1e-10)
    assert 2 * kappa / T**2 == pytest.approx(k2, rel=1e-9)


def coning_quality(chosen, t=T):
    p, kappa = chosen.two_rate_form(t)
    return 2 * kappa / t**2 - p / t * (1 - p / t)


@pytest.mark.parametrize("t", [T, 0.01, 1.0])
def test_best_preset_is_the_optimum_at_any_rate(t):
    assert coning_quality(perturbation(), t) == pytest.approx(1 / 12, rel=1e-14)
    assert perturbation().two_rate_form(t)[0] == pytest.approx(t / 2, rel=1e-15)
    answer = one_update(perturbation(preset="best"), t=t)
    expected = t / 2 * (W1 + W2) + t**2 / 6 * np.cross(W1, W2)
    np.testing.assert_allclose(answer, expected, rtol=1e-14)
    other = perturbation(variant="truncated", epsilon=t / 6, beta_gain=2.0)
    assert coning_quality(other, t) == pytest.approx(1 / 12, rel=1e-13)


@pytest.mark.parametrize("variant", ["truncated", "exact", "bvp"])
def test_n_from_zero_to_one_never_helps(variant):
    for n in np.linspace(0.0, 1.0, 11):
        for s in np.logspace(-4, 4, 33):
            q = coning_quality(perturbation(variant=variant, epsilon=s * T, beta_gain=n))
            # cancellation of terms of size s**2 is all that may look positive
            assert q < 1e-13 * max(1.0, s * s)
    if variant == "truncated":
        n, s = 0.3, 0.21
        q = n**2 * s**2 - n**2 * s + n**2 / 4 + n * s - n / 3 - s**2
        chosen = perturbation(variant="truncated", epsilon=s * T, beta_gain=n)
        assert coning_quality(chosen) == pytest.approx(q, rel=1e-12)


def test_paper_preset_is_as_good_as_nothing():
    paper = perturbation(preset="paper")
    assert (paper.variant, paper.epsilon, paper.beta_gain) == ("truncated", 2e-4, 0.001)
    assert -0.008 < coning_quality(paper) < 0.0
    printed = perturbation(preset="paper", variant="printed")
    assert coning_quality(printed) == pytest.approx(0.0061, abs=1e-4)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("epsilon", [0.0, 2e-4, 0.032])
def test_constant_beta_is_a_rate_bias(variant, epsilon):
    beta = np.array([1.0, -2.0, 0.5])
    chosen = perturbation(variant=variant, epsilon=epsilon, beta=beta)
    x = T / epsilon if epsilon else np.inf
    factor = {
        "printed": T / 2 - epsilon,
        "truncated": T / 2 - epsilon,
        "exact": T / 2 - epsilon * -np.expm1(-x),
        "bvp": T / 2 * (1 / np.tanh(x / 2) - 2 / x),
    }[variant]
    at_rest = one_update(chosen, np.zeros(3), np.zeros(3)) / T
    np.testing.assert_allclose(at_rest, factor * beta, rtol=1e-11)
    if (variant, epsilon) == ("truncated", 2e-4):
        assert at_rest[0] == pytest.approx(1.05e-3, rel=1e-11)


def test_beta_that_follows_the_rates_has_no_bias():
    chosen = perturbation(preset="paper")
    np.testing.assert_array_equal(one_update(chosen, np.zeros(3), np.zeros(3)), 0.0)
    with pytest.raises(ValueError, match="two-rate"):
        perturbation(epsilon=1e-3, beta=(1, 2, 3)).two_rate_form(T)


@pytest.mark.parametrize("options", [{"beta_gain": 0.3}, {"beta": (3.0, 2.0, -1.0)}])
@pytest.mark.parametrize("variant", VARIANTS)
def test_every_update_has_its_own_interval(variant, options):
    chosen = perturbation(variant=variant, epsilon=1e-3, **options)
    rng = np.random.default_rng(8)
    rate = rng.normal(size=(30, 3))
    dt = rng.choice([0.002, 0.0025, 0.004], size=30)
    together = chosen.rotation_vectors(rate, dt, 1, 29)
    for row in range(1, 30):
        alone = one_update(chosen, rate[row - 1], rate[row], dt[row])
        np.testing.assert_array_equal(together[row - 1], alone)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"variant": "exakt"}, "variant 'exakt'.*exact, bvp"),
        ({"preset": "worst"}, "preset 'worst'.*best, paper"),
        ({"preset": "best", "epsilon": 1e-3}, "give one of them"),
        ({"beta_gain": 1.0}, "without epsilon"),
        ({"beta": (1, 2, 3)}, "without epsilon"),
        ({"epsilon": 1e-3}, "exactly one"),
        ({"epsilon": 1e-3, "beta_gain": 1.0, "beta": (1, 2, 3)}, "exactly one"),
        ({"epsilon": 1e-3, "beta": (1, 2)}, "2 components"),
        ({"epsilon": -1e-3, "beta_gain": 1.0}, "epsilon is -0.001"),
        ({"epsilon": float("inf"), "beta_gain": 1.0}, "epsilon is inf"),
        ({"epsilon": 1e-3, "beta_gain": float("nan")}, "not finite"),
        ({"epsilon": 1e-3, "beta": (1, 2, float("inf"))}, "not finite"),
    ],
)
def test_impossible_options_are_refused(options, message):
    with pytest.raises(ConfigurationError, match=message):
        perturbation(**options)


def test_variant_by_default():
    assert perturbation().variant == "truncated"
    assert perturbation(epsilon=1e-3, beta_gain=0.5).variant == "exact"
