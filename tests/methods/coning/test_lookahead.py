"""Look-ahead against the drift that was computed elsewhere, ends of the log included."""

import numpy as np
import pytest

from sinstool.core import rotation
from sinstool.core.errors import ConfigurationError
from sinstool.methods.coning.increments import RateIntegrator, integration_stencils
from sinstool.methods.coning.lookahead import Lookahead
from sinstool.methods.coning.picard import Picard
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.stage import ConingStage
from sinstool.methods.strapdown.attitude import AttitudePropagator
from sinstool.simulation.coning import classical_coning
from sinstool.simulation.truth import sample_times

PER_HOUR = np.rad2deg(1.0) * 3600.0
SECONDS = 60.0
# half angle, frequency, rate
CASES = [(0.1, 20.0, 200.0), (1.0, 10.0, 100.0), (10.0, 1.0, 100.0)]
# coning.md's own table of all three, deg/h, for mean rates
TABLE = {
    "previous-1": (0.196, 9.8, 0.0101),
    "optimal-4": (0.00138, 0.123, 7.4e-4),
    "optimal-6": (6.8e-5, 0.288, 9.8e-3),
    "picard-8": (1.6e-3, 0.078, 2.8e-8),
    "lookahead-8": (1.19e-3, 5.96e-2, 1.6e-6),
    "lookahead-12": (1e-5, 5e-4, 2e-5),
}
BETTER = {"picard-8", "lookahead-8", "lookahead-12"}  # in the last case: a longer series


def error(name, case, kind, noise=None):
    """Length of the attitude error at the end of the log, over its duration, in deg/h."""
    half_angle, frequency, rate = CASES[case]
    motion = classical_coning(sample_times(rate, SECONDS), np.deg2rad(half_angle), frequency)
    gyro = motion.gyro_rate if kind == "rate" else motion.gyro_mean_rate
    if noise is not None:
        gyro = gyro + noise
    stage = ConingStage(algorithm(name), kind, nominal_interval=1.0 / rate)
    parts = [stage.push(gyro, motion.time_ns), stage.finish()]
    phi = np.concatenate([p.rotation_vector for p in parts])
    interval = np.concatenate([p.interval for p in parts])
    q = AttitudePropagator(motion.q_nb[0]).push(phi, interval)[-1]
    wrong = rotation.log(rotation.multiply(rotation.conjugate(motion.q_nb[-1]), q))
    return np.linalg.norm(wrong) / SECONDS * PER_HOUR


@pytest.mark.parametrize("case", range(3))
@pytest.mark.parametrize("name", TABLE)
def test_drift_over_a_minute_ends_included(name, case):
    actual, expected = error(name, case, "mean-rate"), TABLE[name][case]
    if name == "lookahead-12" or (name in BETTER and case == 2):
        assert actual <= expected
    else:
        assert actual == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize(("case", "limit"), list(enumerate((7e-5, 7e-4, 1.6e-7))))
def test_point_rates_are_as_good_as_a_spline_of_them(case, limit):
    # the usual six points leave more than 100 times as much
    assert error("lookahead-12", case, "rate") <= limit
    if case < 2:
        assert error("optimal-4", case, "rate") > 100 * limit


@pytest.mark.parametrize("kind", ["mean-rate", "rate"])
def test_noise_is_that_of_one_earlier_sample(kind):
    # 0.3 deg/sqrt(h) on the slow case, where neither algorithm drifts by itself
    rate = CASES[2][2]
    sigma = np.deg2rad(0.3) / 60.0 * np.sqrt(rate)
    squares = {"lookahead-12": 0.0, "previous-1": 0.0}
    for seed in range(12):
        noise = sigma * np.random.default_rng(seed).normal(size=(int(SECONDS * rate) + 1, 3))
        for name in squares:
            squares[name] += error(name, 2, kind, noise) ** 2
    # the walk itself: three axes of 0.3 deg/sqrt(h) over a minute
    assert np.sqrt(squares["previous-1"] / 12) == pytest.approx(0.3 * np.sqrt(3 * 60), rel=0.2)
    assert squares["lookahead-12"] == pytest.approx(squares["previous-1"], rel=0.01)


@pytest.mark.parametrize("taps", [4, 8, 12])
def test_sum_of_the_parts_is_the_increment(taps):
    # about one axis nothing but the angle is left
    rng = np.random.default_rng(taps)
    x = rng.normal(0.0, 0.01, size=(40, 1)) * [[0.0, 1.0, 0.0]]
    dt = np.full(40, 0.01)
    answers = Lookahead(taps).rotation_vectors(x, dt, 0, 40)
    np.testing.assert_allclose(answers, x, rtol=0, atol=1e-16)
    # point rates: the centred integral of the interpolating polynomial
    answers = Lookahead(taps).for_kind("rate").rotation_vectors(x, dt, 1, 39)
    stencil = [float(w) for w in integration_stencils(taps)[taps // 2 - 1]]
    for row in range(taps, 40 - taps):
        window = x[row - taps // 2 : row + taps // 2]
        np.testing.assert_allclose(answers[row - 1], 0.01 * (stencil @ window), atol=1e-17)


def test_answer_is_that_of_a_polynomial_rate():
    # increments of a polynomial of degree 6 are met exactly by eight taps, ends included
    rng = np.random.default_rng(8)
    polynomials = [np.polynomial.Polynomial(rng.normal(0, 1, 7) / 10.0**np.arange(1, 8))
                   for _ in range(3)]  # fmt: skip
    k = np.arange(21)
    angle = np.stack([p.integ()(k) for p in polynomials], axis=-1)
    angle *= 0.02 / np.abs(np.diff(angle, axis=0)).max()
    rows, dt = np.diff(angle, axis=0), np.full(20, 1.0)
    scale = angle[1, 0] / polynomials[0].integ()(1)
    fine = scale * np.stack([p.integ()(np.arange(141) / 7) for p in polynomials], axis=-1)
    parts = np.diff(fine, axis=0).reshape(20, 7, 3)
    exact = np.array([Picard(7).rotation_vectors(p, dt[:7], 0, 1)[0] for p in parts])
    np.testing.assert_allclose(
        Lookahead(8).rotation_vectors(rows, dt, 0, 20), exact, rtol=0, atol=1e-13
    )


def test_ends_of_point_rates_are_quiet_and_sharp():
    chosen = Lookahead(12).for_kind("rate")
    dt = np.full(40, 1.0)
    # linear in the rates for a single axis: the weights are the answers to unit rates
    weights = np.zeros((39, 40))
    for node in range(40):
        x = np.zeros((40, 3))
        x[node, 0] = 1e-3
        weights[:, node] = chosen.rotation_vectors(x, dt, 1, 39)[:, 0] / 1e-3
    np.testing.assert_allclose(weights[::-1, ::-1], weights, atol=1e-9)  # both ends alike
    sums = weights[:5].sum(axis=0)
    assert np.linalg.norm(sums) < 3.0  # five samples alone: 2.2
    polynomial = [[float(w) for w in row] for row in integration_stencils(12)[:5]]
    assert np.linalg.norm(np.sum(polynomial, axis=0)) > 9.0  # of the one-sided polynomial
    for turn in (0.05, 0.3, 0.6, 0.85):
        wave = np.exp(1j * turn * np.arange(40))
        exact = (np.exp(1j * turn * np.arange(1, 40)) - np.exp(1j * turn * np.arange(39))) / (
            1j * turn
        )
        assert np.abs(weights @ wave - exact)[:5].max() < (1e-8 if turn < 0.1 else 5e-5)
    # degree 5, everywhere
    for power in range(6):
        values = (np.arange(40) / 40.0) ** power
        exact = np.diff((np.arange(40) / 40.0) ** (power + 1)) * 40.0 / (power + 1)
        np.testing.assert_allclose(weights @ values, exact, atol=1e-10)


@pytest.mark.parametrize("count", [2, 3, 5, 9, 11, 12, 13, 15, 16, 17])
@pytest.mark.parametrize("kind", ["mean-rate", "rate"])
def test_short_segments_use_what_there_is(kind, count):
    motion = classical_coning(sample_times(400.0, (count - 1) / 400.0), 0.02, 20.0)
    gyro = motion.gyro_rate if kind == "rate" else motion.gyro_mean_rate

    def worst(name):
        stage = ConingStage(algorithm(name), kind, nominal_interval=0.0025)
        phi = np.concatenate([p.rotation_vector for p in (stage.push(gyro, motion.time_ns),
                                                           stage.finish())])  # fmt: skip
        true = rotation.log(rotation.multiply(rotation.conjugate(motion.q_nb[:-1]),
                                              motion.q_nb[1:]))  # fmt: skip
        return np.abs(phi - true).max()

    # increments are exact already; rates are integrated by as many points as there are
    usual = worst("previous-3")
    assert worst("lookahead-12") < (2.0 if count < 4 else 0.7 if count < 9 else 0.05) * usual


def test_irregular_intervals_scale_the_rates():
    rng = np.random.default_rng(12)
    rate = rng.normal(size=(40, 3)) * [[0.0, 0.0, 1.0]]
    dt = np.full(40, 0.01)
    chosen = Lookahead(6).for_kind("rate")
    regular = chosen.rotation_vectors(rate, dt, 1, 39)
    dt[20] = 0.013
    longer = chosen.rotation_vectors(rate, dt, 1, 39)
    np.testing.assert_allclose(longer[19], 1.3 * regular[19], rtol=1e-14)
    np.testing.assert_array_equal(np.delete(longer, 19, 0), np.delete(regular, 19, 0))
    np.testing.assert_allclose(
        regular[9:29, 2], RateIntegrator(6).increments(rate, np.full(40, 0.01), 10, 20)[:, 2],
        rtol=0, atol=1e-17,
    )  # fmt: skip


@pytest.mark.parametrize("name", ["lookahead-7", "lookahead-2", "lookahead-18", "lookahead-0"])
def test_impossible_taps_are_refused(name):
    with pytest.raises(ConfigurationError, match="lookahead") as error:
        algorithm(name)
    assert "12" in error.value.hint


def test_forms_know_each_other():
    chosen = algorithm("lookahead-12")
    assert chosen.takes == "increments"
    assert chosen.for_kind("mean-rate") is chosen
    rates = chosen.for_kind("rate")
    assert (rates.takes, rates.name) == ("rates", chosen.name)
    assert rates.for_kind("rate") is rates
    assert rates.for_kind("increment").takes == "increments"
