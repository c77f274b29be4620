"""Gyro-tuned coefficients: pseudo-coning against the table of coning.md 5.3, and the options."""

import numpy as np
import pytest

from sinstool.core import rotation
from sinstool.core.errors import ConfigurationError
from sinstool.methods.coning.gyro_response import (
    butterworth,
    chebyshev,
    gyro_response,
    measured,
    none,
)
from sinstool.methods.coning.gyro_tuned import design
from sinstool.methods.coning.increments import RateIntegrator
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.response import coning_gains
from sinstool.methods.strapdown.attitude import AttitudePropagator

RATE = 400.0
STEP = 1.0 / RATE
SECONDS = 10.0
GYRO = chebyshev(6, 0.2, 200.0)
NOISE = (60, 100, 120, 150, 180, 199, 260)


def tuned(lags, stopband, **options):
    return algorithm(
        "gyro-tuned", passband=60.0, stopband=stopband, gyro_response="cheb:6,0.2,200",
        interval=STEP, lags=lags, **options,
    )  # fmt: skip


def end_error(chosen, noise_frequency, kind="increment", noise=0.01, motion_gain=None):
    """Signed z error in degrees after 10 s of 0.1 deg coning at 30 Hz, seen through the gyro.

    The noise is planar: nothing turns about z at its frequency, so all drift from it is wrong.
    """
    history = 40
    angle, pseudo = np.deg2rad(0.1), np.deg2rad(noise)
    count = round(SECONDS * RATE)
    k = np.arange(-history, count + 40)
    rate = np.zeros((len(k), 3))
    lines = (
        (30.0, np.sin(angle), GYRO(30.0) if motion_gain is None else motion_gain),
        (noise_frequency, np.sin(pseudo), GYRO(noise_frequency)),
    )
    for frequency, size, passed in lines:
        turn = 2 * np.pi * frequency * STEP
        at = turn * k if kind == "rate" else turn * (k - 0.5)
        mean = 1.0 if kind == "rate" else np.sinc(turn / 2 / np.pi)
        gain = 2 * np.pi * frequency * size * mean * passed
        rate[:, 0] += gain * np.cos(at)
        rate[:, 1] -= gain * np.sin(at)
    rate[:, 2] += 4 * np.pi * 30.0 * np.sin(0.5 * angle) ** 2
    dt = np.full(len(k), STEP)
    x = rate * STEP
    chosen = chosen.for_kind("rate" if kind == "rate" else "increment")
    if kind == "rate":
        x[1:] = RateIntegrator().increments(rate, dt, 1, len(rate) - 1)
    phi = chosen.rotation_vectors(x, dt, history + 1, count // chosen.samples)

    def truth(t):
        p = 2 * np.pi * 30.0 * t
        return rotation.exp(angle * np.array([np.sin(p), np.cos(p), 0.0]))

    duration = np.full(len(phi), chosen.samples * STEP)
    q = AttitudePropagator(truth(0.0)).push(phi, duration)[-1]
    wrong = rotation.log(rotation.multiply(rotation.conjugate(truth(SECONDS)), q))
    return np.rad2deg(wrong[2])


TABLE = {
    "optimal-4": (algorithm("optimal-4"), "-.0086 -.0105 -.0113 -.0108 -.0081 -.0052 -.0051"),
    "previous-1": (algorithm("previous-1"), "-.0082 -.0096 -.0098 -.0088 -.0068 -.0049 -.0049"),
    "tuned, 12 lags": (
        tuned(12, 110.0), "-.0033 -.0014 +.00006 +.00002 +.00003 -.00001 -.000001",
    ),
    "tuned, 16 lags": (
        tuned(16, 100.0), "-.0033 -.0001 -.00003 +.000003 -.000002 -.00001 -.000005",
    ),
    # without a stopband what is above the passband is no one's choice: its size only
    "tuned, 8 lags": (tuned(8, None), "-.0033 -.0054"),
}  # fmt: skip


@pytest.mark.parametrize("label", TABLE)
def test_pseudo_coning_of_the_table(label):
    chosen, row = TABLE[label]
    for frequency, text in zip(NOISE, row.split(), strict=False):
        # to the digits given, or 1.5e-5 deg: less depends on grids and weights
        digits = len(text.partition(".")[2])
        assert end_error(chosen, frequency) == pytest.approx(
            float(text), abs=max(1e-4 if digits == 4 else 0.0, 1.5e-5)
        ), frequency


@pytest.mark.parametrize(
    ("frequency", "long", "every"), [(130, -0.0215, -0.0063), (230, 0.0076, 0.0001)]
)
def test_long_updates_fold_two_frequencies(frequency, long, every):
    # 100 and 200 Hz from the motion's 30: multiples of the update rate; gyro flat for the motion
    def error(name, at):
        return end_error(algorithm(name), at, motion_gain=1.0)

    assert error("optimal-4", frequency) == pytest.approx(long, abs=1e-4)
    assert error("previous-3", frequency) == pytest.approx(every, abs=1e-4)
    # with an update for every sample it is like its neighbours
    assert error("previous-3", frequency - 10) == pytest.approx(every, abs=3e-4)
    assert abs(error("optimal-4", frequency) - error("optimal-4", frequency - 10)) > 5e-3


def test_pseudo_coning_vanishes_where_nothing_moves():
    chosen = tuned(12, 110.0)
    for frequency in (120, 137, 150, 180, 199):
        assert abs(end_error(chosen, frequency)) <= 1e-4
        assert abs(end_error(chosen, frequency, kind="rate")) <= 1e-4
        assert abs(end_error(algorithm("optimal-4"), frequency)) > 5e-3
    # the true coning is right: without any noise in the band nothing is left
    assert abs(end_error(chosen, 60, noise=0.0)) < 1e-5
    # the others answer for what the gyro's ripple adds, 3 % of 0.16 deg
    assert end_error(algorithm("optimal-4"), 60, noise=0.0) == pytest.approx(-0.0051, abs=1e-4)


@pytest.mark.parametrize("kind", ["increment", "rate"])
def test_answer_is_the_one_that_was_asked_for(kind):
    chosen = tuned(12, 110.0).for_kind(kind)
    passband, stopband = np.linspace(0.5, 60.0, 60), np.linspace(110.0, 199.0, 60)
    answer = GYRO(passband) ** 2 * coning_gains(chosen, passband, STEP, kind)
    assert np.abs(answer - 1).max() <= 2e-4
    assert answer[0] == pytest.approx(1.0, abs=1e-5)
    answer = GYRO(stopband) ** 2 * coning_gains(chosen, stopband, STEP, kind)
    assert np.abs(answer).max() < 0.03
    # optimal-4 for a gyro that is not flat: 3 % too much
    flat = GYRO(30.0) ** 2 * coning_gains(algorithm("optimal-4"), 30.0, STEP)[0] - 1
    assert flat == pytest.approx(3.1e-2, rel=0.02)


def test_without_bands_they_follow_the_sampling_rate():
    relative = algorithm("gyro-tuned")
    assert (relative.passband, relative.stopband) == (0.15, 0.275)
    assert "sampling rate" in relative.summary
    absolute = algorithm("gyro-tuned", interval=STEP)
    assert absolute.passband == pytest.approx(60.0)
    assert absolute.stopband == pytest.approx(110.0)
    np.testing.assert_allclose(absolute.weights, relative.weights, rtol=1e-6)
    absolute = algorithm("gyro-tuned", passband=60.0, stopband=110.0, interval=STEP)
    np.testing.assert_allclose(absolute.weights, relative.weights, rtol=1e-6)
    halved = algorithm("gyro-tuned", stopband=110.0, interval=STEP)
    assert halved.passband == pytest.approx(60.0)
    np.testing.assert_array_equal(design(12, 0.15, 0.275), relative.weights)


@pytest.mark.parametrize("kind", ["rate", "mean-rate", "increment"])
def test_an_algorithm_for_rates_says_what_it_makes_of_means(kind):
    texts = algorithm("singular-perturbation").caveats(kind)
    assert len(texts) == (kind != "rate")
    assert all("half an interval late" in text for text in texts)
    assert algorithm("previous-3").caveats(kind) == ()
    tuned = algorithm("gyro-tuned", interval=0.005, passband=30.0, stopband=60.0)
    assert tuned.caveats(kind) == (tuned.caveat,)


def test_caveat_names_the_bands():
    chosen = tuned(12, 110.0)
    assert "60 Hz" in chosen.caveat
    assert "real coning above 110 Hz" in chosen.caveat
    assert algorithm("previous-3").caveat == ""
    # without a stopband nothing makes it ignore what is above the passband
    open_above = algorithm("gyro-tuned", interval=STEP, passband=60.0)
    assert "not controlled" in open_above.caveat and "ignored" not in open_above.caveat


def test_real_coning_above_the_stopband_is_ignored():
    # the caveat is true
    gain = coning_gains(tuned(12, 110.0), np.array([150.0]), STEP)[0]
    assert abs(gain) < 0.02
    assert coning_gains(algorithm("optimal-4"), np.array([150.0]), STEP)[0] > 0.3


def test_kinds_have_coefficients_of_their_own():
    chosen = tuned(12, 110.0)
    assert chosen.for_kind("mean-rate") is chosen
    rates = chosen.for_kind("rate")
    assert rates.for_kind("rate") is rates
    assert rates.response is chosen.response
    assert (rates.passband, rates.stopband, rates.lags) == (60.0, 110.0, 12)
    assert np.abs(rates.weights - chosen.weights).max() > 1e-4


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"passband": 60.0}, "interval"),
        ({"gyro_response": "cheb:6,0.2,200"}, "interval"),
        ({"interval": 0.0}, "interval"),
        ({"interval": float("nan")}, "interval"),
        ({"interval": STEP, "passband": 110.0, "stopband": 60.0}, "passband"),
        ({"interval": STEP, "passband": 250.0}, "passband"),
        ({"interval": STEP, "passband": -1.0}, "passband"),
        ({"interval": STEP, "stopband": 200.0}, "stopband"),
        ({"lags": 1}, "lags"),
        ({"lags": 33}, "lags"),
        ({"gyro_response": "cheb:6", "interval": STEP}, "response"),
        ({"gyro_response": "no such file", "interval": STEP}, "response"),
    ],
)
def test_impossible_options_are_refused(options, message):
    with pytest.raises(ConfigurationError, match=message) as error:
        algorithm("gyro-tuned", **options)
    assert error.value.hint


def test_responses_of_filters():
    # residual of 0.01 deg at 400 Hz, in deg/s, for each order: the table of section 2
    for order, expected in ((5, 0.187), (6, 0.0557), (7, 0.0155), (8, 0.0045), (9, 0.0012)):
        amplitude = 2 * np.pi * 400 * 0.01 * chebyshev(order, 0.2, 200.0)(400.0)
        assert amplitude == pytest.approx(expected, abs=0.6 * 10.0 ** -len(str(expected)[2:]))
    for order, expected in ((8, 0.098), (9, 0.049), (10, 0.0245)):
        amplitude = 2 * np.pi * 400 * 0.01 * butterworth(order, 200.0)(400.0)
        assert amplitude == pytest.approx(expected, rel=0.01)
    for response in (none(), butterworth(3, 80.0), chebyshev(4, 1.0, 80.0), chebyshev(5, 1.0, 80)):
        assert response(0.0) == pytest.approx(1.0, abs=1e-15)
        assert response(-33.0) == response(33.0)
    ripple = chebyshev(6, 0.2, 200.0)(np.linspace(0, 150, 3001))
    assert ripple.min() == pytest.approx(1.0, abs=1e-6)
    assert ripple.max() == pytest.approx(10 ** (0.2 / 20), abs=1e-6)
    # half the power of the passband's maximum
    assert chebyshev(6, 0.2, 200.0)(200.0) ** 2 == pytest.approx(0.5 * 10 ** (0.2 / 10))
    assert chebyshev(7, 0.2, 200.0)(200.0) ** 2 == pytest.approx(0.5)
    assert butterworth(4, 200.0)(200.0) ** 2 == pytest.approx(0.5)


def test_responses_of_the_command_line(tmp_path):
    at = np.array([0.0, 20.0, 80.0, 130.0, 500.0])
    np.testing.assert_array_equal(gyro_response("none")(at), 1.0)
    assert gyro_response(None).flat
    assert gyro_response(GYRO) is GYRO
    np.testing.assert_array_equal(gyro_response("cheb:6,0.2,200")(at), GYRO(at))
    np.testing.assert_array_equal(gyro_response("butter:3,80")(at), butterworth(3, 80.0)(at))
    table = tmp_path / "gyro.csv"
    table.write_text("# Hz, gain\n0, 2.0\n50 1.8\n100, 1.0\n\n200, 0.2\n")
    read = gyro_response(str(table))
    np.testing.assert_allclose(read([0, 50, 100, 200, 900]), [1.0, 0.9, 0.5, 0.1, 0.1])
    assert np.all(np.diff(read(np.linspace(0, 200, 50))) < 0)
    table.write_text("0, 2.0\n50\n")
    with pytest.raises(ConfigurationError, match="table"):
        gyro_response(str(table))


@pytest.mark.parametrize(
    "bad", [((0,), (1,)), ((0, 1, 1), (1, 1, 1)), ((0, 1), (1, 0)), ((0, 1), (1, np.nan))]
)
def test_impossible_tables_are_refused(bad):
    with pytest.raises(ConfigurationError, match="gyro response"):
        measured(*bad)


@pytest.mark.parametrize(
    "bad", ["cheb:0,0.2,200", "cheb:6,0,200", "cheb:6,0.2,-1", "cheb:6.5,0.2,200", "butter:2",
            "butter:0,80", "cheb:six,0.2,200", "butter:inf,80", "cheb:nan,0.2,200"]
)  # fmt: skip
def test_impossible_responses_are_refused(bad):
    with pytest.raises(ConfigurationError):
        gyro_response(bad)
