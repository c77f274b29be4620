"""Tuning of singular perturbation to a log's own coning, and the paper's bounds."""

import numpy as np
import pytest

from sinstool.core.rotation import conjugate, log, multiply
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.response import coning_spectrum, predicted_drift
from sinstool.methods.coning.sp_tuning import best_q, bounds, coning_answer, most_coning, tune
from sinstool.methods.coning.stage import ConingStage
from sinstool.methods.strapdown.attitude import AttitudePropagator
from sinstool.simulation.motions import broadband, sample
from sinstool.simulation.truth import sample_times
from tests.helpers.coning_response import coning_gain, coning_samples

STEP = 0.0025
PER_HOUR = np.rad2deg(1.0) * 3600.0


def turn(frequency):
    return 2 * np.pi * frequency * STEP


def with_noise(gyro, sigma=1e-5, seed=0):
    return gyro + np.random.default_rng(seed).normal(0, sigma, gyro.shape)


def test_one_line_is_nulled():
    q = best_q(turn(30.0))
    assert q == pytest.approx(0.08682, abs=5e-6)
    assert 6 * q + 1.5 == pytest.approx(2.021, abs=5e-4)
    assert coning_answer(turn(30.0), q) == pytest.approx(1.0, abs=1e-15)
    # what is left at other frequencies
    assert 1 - coning_answer(turn(20.0), q) == pytest.approx(-2e-4, rel=0.05)
    assert 1 - coning_answer(turn(50.0), q) == pytest.approx(3.7e-3, rel=0.01)


def test_regimes_of_fifth_section():
    # at 30 Hz: the best of two rates, one earlier increment, rates taken for increments, 6 points
    assert 1 - coning_answer(turn(30.0), 1 / 12) == pytest.approx(7.5e-4, rel=0.01)
    assert 1 - coning_gain(algorithm("previous-1"), 30.0, STEP) == pytest.approx(1.6e-3, rel=0.01)
    six = 1 - coning_gain(algorithm("optimal-4"), 30.0, STEP, "rate")
    assert six == pytest.approx(7.1e-5, rel=0.01)


@pytest.mark.parametrize("kind", ["rate", "mean-rate"])
def test_answer_is_that_of_the_algorithm(kind):
    for frequency in (3.0, 30.0, 120.0, 230.0):
        for q in (1 / 12, 0.2):
            chosen = algorithm(
                "singular-perturbation", variant="truncated", epsilon=0.5 * STEP,
                beta_gain=6 * q + 1.5,
            )  # fmt: skip
            gain = coning_gain(chosen, frequency, STEP, kind)
            assert coning_answer(turn(frequency), q, kind) == pytest.approx(gain, rel=2e-6)


@pytest.mark.parametrize("kind", ["rate", "mean-rate"])
def test_slow_coning_is_the_limit(kind):
    limit = 1 / 12 if kind == "rate" else 1 / 6
    assert best_q(0.0, kind) == pytest.approx(limit)
    assert best_q(2e-3, kind) == pytest.approx(limit, rel=1e-5)
    assert best_q(1.0, kind) > limit


@pytest.mark.parametrize("frequency", [8.0, 30.0, 100.0])
@pytest.mark.parametrize("kind", ["rate", "mean-rate"])
def test_a_line_in_noise_is_tuned_to(frequency, kind):
    gyro = with_noise(coning_samples(np.deg2rad(0.1), frequency, STEP, 20000, kind))
    result = tune(gyro, STEP, kind, passband=120.0)
    assert result.status == "tuned"
    assert result.q == pytest.approx(best_q(turn(frequency), kind), rel=1e-4)
    assert result.epsilon == 0.5 * STEP
    assert result.beta_gain == pytest.approx(6 * result.q + 1.5)
    assert result.options().keys() == {"variant", "epsilon", "beta_gain"}
    np.testing.assert_allclose(
        result.drift_tuned,
        predicted_drift(
            coning_spectrum(gyro, STEP, kind),
            algorithm("singular-perturbation", **result.options()),
        ),
        rtol=0,
        atol=1e-4 * np.abs(result.drift_best).max() + 1e-12,
    )


@pytest.mark.parametrize("kind", ["rate", "mean-rate", "increment"])
def test_no_motion_of_a_spectrum_cones_more_than_one_in_circles(kind):
    """All of that of a circle is coning; of an ellipse, twice the product of its axes' share."""
    gyro = coning_samples(0.004, 20.0, STEP, 20000, kind)
    for flat in (1.0, 0.3):
        spectrum = coning_spectrum(gyro * [flat, 1.0, 1.0], STEP, kind)
        most = most_coning(gyro * [flat, 1.0, 1.0], spectrum).sum()
        coning = np.linalg.norm(spectrum.density, axis=1).sum()
        assert coning / most == pytest.approx(2.0 * flat / (1.0 + flat**2), rel=0.02)


def test_tuning_pays_on_a_broad_band():
    motion = sample(broadband(2e-4, seed=1), sample_times(400.0, 64.0))
    result = tune(motion.gyro_rate, STEP, passband=160.0)
    assert result.status == "tuned"

    def drift(**options):
        stage = ConingStage(algorithm("singular-perturbation", **options), "rate")
        answers = stage.push(motion.gyro_rate, motion.time_ns)
        q = AttitudePropagator(motion.q_nb[0]).push(answers.rotation_vector, answers.interval)
        return log(multiply(q[-1], conjugate(motion.q_nb[-1])))[2] / 64.0

    best, tuned = drift(preset="best"), drift(**result.options())
    assert best == pytest.approx(result.drift_best[2], rel=0.03)
    assert abs(tuned) < 0.05 * abs(best)
    assert best * PER_HOUR > 0.1


@pytest.mark.parametrize(
    ("gyro", "passband", "status"),
    [
        (with_noise(coning_samples(0.002, 30.0, STEP, 8000, "rate")), None, "no-passband"),
        (with_noise(np.zeros((8000, 3)), 1e-3), 60.0, "noise-limited"),
        (np.zeros((8000, 3)), 60.0, "noise-limited"),
        # a line that does not cone: x and y in phase
        (
            with_noise(np.outer(np.sin(turn(20.0) * np.arange(8000)), [0.1, 0.1, 0.0]), 1e-3),
            60.0,
            "no-coning",
        ),
        # opposite conings whose answers to Q all but cancel ask for an absurd Q
        (
            with_noise(
                coning_samples(0.01, 5.0, STEP, 8000, "rate")
                + coning_samples(0.0019, -15.0, STEP, 8000, "rate")
            ),
            60.0,
            "no-coning",
        ),
        (np.full((8000, 3), np.nan), 60.0, "noise-limited"),
    ],
)
def test_the_usual_where_there_is_nothing_to_tune_to(gyro, passband, status):
    result = tune(gyro, STEP, passband=passband)
    assert result.status == status
    assert (result.q, result.beta_gain, result.epsilon) == (1 / 12, 2.0, 0.5 * STEP)


@pytest.mark.parametrize("frequency", [8.0, 30.0, 100.0])
def test_bounds_of_one_line(frequency):
    gyro = with_noise(coning_samples(np.deg2rad(0.1), frequency, STEP, 40000, "rate"))
    result = bounds(gyro, STEP)
    assert (result.status, result.noise_limited) == ("ok", 0)
    assert result.windows == 19
    for value in result.epsilon_upper:
        assert value == pytest.approx(1 / (2 * np.pi * frequency), rel=1e-3)
    for value in result.gain_lower:
        assert value == pytest.approx(turn(frequency), rel=1e-3)


def test_bounds_of_noise_say_so():
    noise = with_noise(np.zeros((40000, 3)), 1e-3)
    result = bounds(noise, STEP)
    assert result.status == "noise-limited"
    assert result.noise_limited == result.windows == 19
    # half of the windows with motion: those decide, not the noise
    noise[:24000] += coning_samples(np.deg2rad(1.0), 30.0, STEP, 24000, "rate")
    result = bounds(noise, STEP)
    assert (result.status, result.noise_limited) == ("ok", 7)
    assert result.epsilon_upper[0] == pytest.approx(1 / (2 * np.pi * 30), rel=0.01)
    assert result.epsilon_upper[1] <= result.epsilon_upper[0] <= result.epsilon_upper[2]


@pytest.mark.parametrize(("ratio", "status"), [(2.0, "noise-limited"), (5.0, "ok")])
def test_bounds_need_motion_of_three_times_the_noise(ratio, status):
    noise = with_noise(np.zeros((40000, 3)), 1e-3)
    # a line whose power is that of the noise in the band up to 160 of 200 Hz, times the ratio
    power = ratio * 3.0 * 1e-6 * 160.0 / 200.0
    line = np.outer(np.sin(turn(30.0) * np.arange(40000)), [np.sqrt(2.0 * power), 0.0, 0.0])
    assert bounds(line + noise, STEP).status == status


def test_naive_differences_of_noise_would_mislead():
    # what the bounds would be from differences of white noise: the reason for the spectrum
    noise = np.random.default_rng(1).normal(size=100000)
    d1, d2 = np.diff(noise) / STEP, np.diff(noise, 2) / STEP**2
    assert d1.std() / d2.std() == pytest.approx(STEP / np.sqrt(3), rel=0.01)
    assert STEP * d1.std() / noise.std() == pytest.approx(np.sqrt(2), rel=0.01)


def test_bounds_are_clipped_and_short_logs_are_one_window():
    slow = np.outer(np.sin(turn(0.3) * np.arange(16000)), [1.0, 0.5, 0.0])
    result = bounds(with_noise(slow, 1e-9), STEP)
    assert result.epsilon_upper[0] == pytest.approx(100 * STEP)
    short = bounds(coning_samples(0.01, 30.0, STEP, 400, "increment"), STEP, "increment")
    assert short.windows == 1
    assert short.epsilon_upper[0] == pytest.approx(1 / (2 * np.pi * 30), rel=0.05)
    still = bounds(np.zeros((400, 3)), STEP)
    assert still.status == "noise-limited"
    assert np.isnan(still.epsilon_upper).all()


def test_bad_arguments_are_refused():
    with pytest.raises(ValueError, match="gyro"):
        bounds(np.zeros((4, 3)), STEP)
    with pytest.raises(ValueError, match="frequencies"):
        bounds(np.zeros((400, 3)), STEP, highest=0.3)
    for passband in (0.0, 200.0):
        with pytest.raises(ValueError, match="passband"):
            tune(np.zeros((400, 3)), STEP, passband=passband)
