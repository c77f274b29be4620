"""Coning spectrum and predicted drift against simulated drift (coning.md, section 4, M4)."""

import numpy as np
import pytest

from sinstool.core import rotation
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.response import (
    coning_gains,
    coning_spectrum,
    predicted_drift,
    pseudo_coning,
)
from sinstool.methods.coning.stage import ConingStage
from sinstool.methods.strapdown.attitude import AttitudePropagator
from sinstool.simulation.motions import broadband, sample
from sinstool.simulation.truth import sample_times
from tests.helpers.coning_response import coning_rate, coning_samples
from tests.helpers.thinned import thin

PER_HOUR = np.rad2deg(1.0) * 3600.0
STEP = 0.0025
PER_SAMPLE = ["uncompensated", "previous-1", "previous-2", "previous-3", "lookahead-12",
              "gyro-tuned"]  # fmt: skip


@pytest.fixture(scope="module")
def motion():
    # 20 to 150 Hz for 64 s; one instant less than a multiple of four, so that it thins well
    return sample(broadband(2e-4, seed=1), sample_times(400.0, 64.0075))


def samples(motion, kind):
    return {"rate": motion.gyro_rate, "mean-rate": motion.gyro_mean_rate,
            "increment": motion.gyro_increment}[kind]  # fmt: skip


def simulated(motion, chosen, kind):
    """Drift of the run about the body's axes, which move by 0.01 deg only, in deg/h."""
    interval = float(motion.interval[1])
    stage = ConingStage(chosen, kind, nominal_interval=interval)
    parts = [stage.push(samples(motion, kind), motion.time_ns), stage.finish()]
    phi = np.concatenate([p.rotation_vector for p in parts])
    duration = np.concatenate([p.interval for p in parts])
    q = AttitudePropagator(motion.q_nb[0]).push(phi, duration)[-1]
    wrong = rotation.log(rotation.multiply(q, rotation.conjugate(motion.q_nb[-1])))
    return wrong * PER_HOUR / duration.sum()


@pytest.mark.parametrize("kind", ["rate", "mean-rate", "increment"])
@pytest.mark.parametrize("name", PER_SAMPLE)
def test_predicted_drift_is_that_of_a_simulation(motion, name, kind):
    chosen = algorithm(name)
    spectrum = coning_spectrum(samples(motion, kind), STEP, kind)
    predicted = predicted_drift(spectrum, chosen) * PER_HOUR
    actual = simulated(motion, chosen, kind)
    # 0.5 % in fact, but for the point rates of lookahead
    assert predicted[2] == pytest.approx(actual[2], rel=0.03)
    assert abs(actual[2]) > 0.02
    assert np.abs(predicted[:2]).max() < 1e-5


@pytest.mark.parametrize("kind", ["rate", "mean-rate"])
@pytest.mark.parametrize("name", ["uncompensated", "previous-1"])
def test_prediction_for_a_slower_log_from_the_native_spectrum(motion, name, kind):
    chosen, slower = algorithm(name), thin(motion, 4)
    spectrum = coning_spectrum(samples(motion, kind), STEP, kind)
    predicted = predicted_drift(spectrum, chosen, interval=4 * STEP)[2] * PER_HOUR
    actual = simulated(slower, chosen, kind)[2]
    assert predicted == pytest.approx(actual, rel=0.03)
    # from the slow log alone it cannot be told: what folded has lost its frequency
    blind = coning_spectrum(samples(slower, kind), 4 * STEP, kind)
    assert abs(predicted_drift(blind, chosen)[2] * PER_HOUR) < 0.75 * actual


def test_long_updates_fold_what_the_spectrum_does_not_know(motion):
    # 130 Hz and 30 Hz are 100 Hz apart, the update rate: optimal-4 is off, its relative not
    spectrum = coning_spectrum(motion.gyro_increment, STEP, "increment")
    apart = {}
    for name in ("optimal-4", "previous-3"):
        predicted = predicted_drift(spectrum, algorithm(name))[2] * PER_HOUR
        actual = simulated(motion, algorithm(name), "increment")[2]
        apart[name] = abs(actual / predicted - 1.0)
    assert apart["previous-3"] < 0.01
    assert apart["optimal-4"] > 0.03


@pytest.mark.parametrize("kind", ["rate", "mean-rate", "increment"])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_integral_is_the_coning_rate(kind, axis):
    half_angle, frequency = 0.01, 35.0
    gyro = np.roll(coning_samples(half_angle, frequency, STEP, 16000, kind), axis + 1, axis=1)
    spectrum = coning_spectrum(gyro, STEP, kind)
    # the body's coning, against the mean of the gyro that cancels it
    expected = np.zeros(3)
    expected[axis] = coning_rate(half_angle, frequency)
    np.testing.assert_allclose(spectrum.coning_rate(), expected, rtol=1e-3, atol=1e-9)
    assert gyro[:, axis].mean() < 0
    below, above = np.searchsorted(spectrum.frequency, [34.0, 36.0])
    share = spectrum.cumulative()[:, axis] / expected[axis]
    assert abs(share[below]) < 1e-3
    assert share[above] == pytest.approx(1.0, abs=1e-3)
    # the other way round
    reverse = coning_samples(half_angle, -frequency, STEP, 16000, kind)
    assert coning_spectrum(reverse, STEP, kind).coning_rate()[2] < 0


def test_drift_of_one_line_is_its_gain():
    gyro = coning_samples(0.01, 35.0, STEP, 16000, "mean-rate")
    spectrum = coning_spectrum(gyro, STEP, "mean-rate")
    true = coning_rate(0.01, 35.0)
    for name in ("uncompensated", "optimal-4"):
        gain = coning_gains(algorithm(name), 35.0, STEP)[0]
        result = predicted_drift(spectrum, algorithm(name))
        assert result[2] == pytest.approx((gain - 1.0) * true, rel=2e-3)
        # above a passband it is all noise, and what is answered is drift
        noise = predicted_drift(spectrum, algorithm(name), passband=20.0)
        assert noise[2] == pytest.approx(gain * true, rel=2e-3)
        np.testing.assert_allclose(
            pseudo_coning(spectrum, algorithm(name), 30.0), noise, atol=1e-12
        )
        assert abs(pseudo_coning(spectrum, algorithm(name), 40.0)[2]) < 1e-4 * true


def test_one_segment_of_all_and_short_logs():
    gyro = coning_samples(0.01, 35.0, STEP, 4000, "mean-rate")
    whole = coning_spectrum(gyro, STEP, "mean-rate", segment=None, taper="boxcar")
    assert whole.step == pytest.approx(0.1)
    assert whole.coning_rate()[2] == pytest.approx(coning_rate(0.01, 35.0), rel=1e-4)
    short = coning_spectrum(gyro[:401], STEP, "mean-rate")
    assert len(short.frequency) == 201
    assert short.coning_rate()[2] == pytest.approx(coning_rate(0.01, 35.0), rel=0.03)


def test_bad_arguments_are_refused():
    for bad in (np.zeros((7, 3)), np.zeros((100, 2)), np.zeros(100)):
        with pytest.raises(ValueError, match="gyro"):
            coning_spectrum(bad, STEP, "rate")
    with pytest.raises(ValueError, match="interval"):
        coning_spectrum(np.zeros((100, 3)), 0.0, "rate")
