"""Drift in classical coning against a table computed elsewhere, twice: closed and simulated.

The table was made by other code, at 400 Hz with a half angle of 1 degree. An entry is met
within 1 % or 1e-6 deg/h, or half a unit of the last digit it is given with.
"""

from decimal import Decimal

import mpmath
import numpy as np
import pytest

from sinstool.core import rotation
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.response import coning_drifts, coning_gains
from sinstool.methods.coning.stage import ConingStage
from sinstool.methods.strapdown.attitude import AttitudePropagator
from sinstool.simulation.coning import classical_coning
from sinstool.simulation.truth import sample_times
from tests.helpers.coning_response import (
    coning_drift,
    coning_gain,
    coning_rate,
    coning_samples,
    drift_from_phi,
)

PER_HOUR = np.rad2deg(1.0) * 3600.0
FREQUENCIES = (5, 10, 20, 30, 50, 75, 100)
INTERVAL = 0.0025


def perturbation(**options):
    return algorithm("singular-perturbation", **options)


PAPER = {"epsilon": 2e-4, "beta_gain": 0.001}

# label: (algorithm, what the samples are, what the algorithm is told they are, interval,
# drift in deg/h at each frequency)
TABLE = {
    "none": (
        algorithm("uncompensated"), "mean-rate", "mean-rate", INTERVAL,
        "1.014 8.107 64.6 216.7 984 3194 7172",
    ),
    "none at 100 Hz": (
        algorithm("uncompensated"), "increment", "increment", 4 * INTERVAL,
        "16.15 127.3 960 2934 9869 1.79e4 1.97e4",
    ),
    "optimal-2": (
        algorithm("optimal-2"), "mean-rate", "mean-rate", INTERVAL,
        "1.251e-3 3.99e-2 1.267 9.48 116 806 2985",
    ),
    "previous-1": (
        algorithm("previous-1"), "increment", "increment", INTERVAL,
        "1.251e-3 3.99e-2 1.267 9.48 116 806 2985",
    ),
    "savage-two-speed": (
        algorithm("savage-two-speed"), "increment", "increment", INTERVAL,
        "1.251e-3 3.99e-2 1.267 9.48 116 806 2985",
    ),
    "optimal-3": (
        algorithm("optimal-3"), "increment", "increment", INTERVAL,
        "1.54e-6 2.10e-4 2.69e-2 .450 14.9 217 1314",
    ),
    "optimal-4": (
        algorithm("optimal-4"), "mean-rate", "mean-rate", INTERVAL,
        "9.7e-7 4.7e-5 3.7e-3 6.1e-2 2.67 63.8 812",
    ),
    "previous-3": (
        algorithm("previous-3"), "increment", "increment", INTERVAL,
        "-1.4e-8 6.5e-7 5.6e-4 2.14e-2 1.92 59.6 590",
    ),
    "optimal-5": (
        algorithm("optimal-5"), "increment", "increment", INTERVAL,
        "4.5e-6 1.9e-4 1.2e-2 .128 1.92 20.7 271",
    ),
    "optimal-6": (
        algorithm("optimal-6"), "increment", "increment", INTERVAL,
        "1.3e-5 5.4e-4 3.0e-2 .293 2.45 5.2 128",
    ),
    "quatfiter-3": (
        algorithm("quatfiter-3"), "increment", "increment", INTERVAL,
        "-9.4e-4 -2.96e-2 -.903 -6.33 -61.6 -227 52",
    ),
    "quatfiter-4": (
        algorithm("quatfiter-4"), "increment", "increment", INTERVAL,
        "-4.9e-6 -6.2e-4 -7.7e-2 -1.23 -35.9 -403 -1537",
    ),
    "picard-4": (
        algorithm("picard-4"), "mean-rate", "mean-rate", INTERVAL,
        "-4.9e-6 -6.2e-4 -7.7e-2 -1.23 -35.9 -403 -1537",
    ),
    "picard-8": (
        algorithm("picard-8"), "increment", "increment", INTERVAL,
        "0 -2e-7 -3.4e-4 -2.15e-2 -1.5 102 1547",
    ),
    "rates, none": (
        algorithm("uncompensated"), "rate", "mean-rate", INTERVAL,
        ".507 4.06 32.5 110 513 1753 4236",
    ),
    "rates taken for means, optimal-4": (
        algorithm("optimal-4"), "rate", "mean-rate", INTERVAL,
        "-.507 -4.06 -32.6 -111 -521 -1766 -3932",
    ),
    "perturbation as printed": (
        perturbation(variant="printed", **PAPER), "rate", "rate", INTERVAL,
        ".470 3.76 30.2 102 479 1654 4046",
    ),
    "perturbation, paper": (
        perturbation(preset="paper"), "rate", "rate", INTERVAL,
        ".548 4.38 35.1 118 549 1860 4442",
    ),
    "perturbation, exact": (
        perturbation(variant="exact", **PAPER), "rate", "rate", INTERVAL,
        ".548 4.38 35.1 118 549 1860 4442",
    ),
    "perturbation, two-point": (
        perturbation(variant="bvp", **PAPER), "rate", "rate", INTERVAL,
        ".548 4.38 35.1 118 549 1860 4442",
    ),
    "perturbation, linear": (
        perturbation(variant="exact", epsilon=2e-4, beta_gain=1.0), "rate", "rate", INTERVAL,
        "1.014 8.10 64.5 216 969 3096 6819",
    ),
    "perturbation as printed, wide layer": (
        perturbation(variant="printed", epsilon=0.032, beta_gain=0.001), "rate", "rate", INTERVAL,
        "-930 -7417 -5.9e4",
    ),
    "perturbation, best": (
        perturbation(preset="best"), "rate", "rate", INTERVAL,
        "5.7e-4 1.83e-2 .585 4.42 55.9 410 1652",
    ),
    "perturbation, T/6": (
        perturbation(variant="truncated", epsilon=INTERVAL / 6, beta_gain=2.0),
        "rate", "rate", INTERVAL,
        "5.7e-4 1.83e-2 .585 4.42 55.9 410 1652",
    ),
}  # fmt: skip

ENTRIES = [
    (label, frequency, text)
    for label, row in TABLE.items()
    for frequency, text in zip(FREQUENCIES, row[4].split(), strict=False)
]

NARROW = {  # half angle 0.1 degree, 30 Hz
    "uncompensated": "2.167",
    "optimal-2": ".0948",
    "optimal-3": "4.44e-3",
    "optimal-4": "2.19e-4",
    "optimal-5": "2.3e-5",
    "optimal-6": "3.0e-5",
    "previous-3": "2.15e-4",
    "quatfiter-4": "-1.23e-2",
}


def assert_entry(value, text):
    printed = Decimal(text)
    digit = 0.5 * 10.0 ** int(printed.as_tuple().exponent)
    expected = float(printed)
    assert value == pytest.approx(expected, abs=max(0.01 * abs(expected), 1e-6, digit))


def closed_drift(algorithm, kind, assumed, interval, frequency, half_angle):
    if kind == assumed:
        return coning_drift(algorithm, half_angle, frequency, interval, kind)
    # point rates passed off as mean rates
    before = algorithm.before
    rate = coning_samples(half_angle, frequency, interval, before + algorithm.samples, kind)
    dt = np.full(len(rate), interval)
    phi = algorithm.rotation_vectors(rate * interval, dt, before, 1)[0]
    return drift_from_phi(phi, algorithm.samples * interval, frequency)


def simulated_drift(algorithm, kind, assumed, interval, frequency, half_angle):
    """Run the log through the stage and the attitude, and look at it 6 s apart.

    After whole turns of the cone the true rotation between the two instants is none, so
    the computed one is the drift. The first updates, short of history, are left out.
    """
    window = 6.0
    rate_hz = round(1.0 / interval)
    motion = classical_coning(
        sample_times(rate_hz, window + 0.6, start_ns=1_700_000_000_123_456_789),
        half_angle,
        frequency,
        q_nc=rotation.from_euler([0.3, -0.7, 2.0]),
    )
    gyro = {
        "rate": motion.gyro_rate,
        "mean-rate": motion.gyro_mean_rate,
        "increment": motion.gyro_increment,
    }[kind]
    stage = ConingStage(algorithm, assumed, nominal_interval=interval)
    answers = stage.push(gyro, motion.time_ns)
    q = AttitudePropagator(motion.q_nb[0]).push(answers.rotation_vector, answers.interval)
    updates = round(window / (algorithm.samples * interval))
    first = len(q) - updates - 2
    assert first >= 8
    turned = rotation.log(rotation.multiply(rotation.conjugate(q[first]), q[first + updates]))
    return -np.copysign(np.linalg.norm(turned), turned[2]) / window


@pytest.mark.parametrize(("label", "frequency", "text"), ENTRIES)
def test_drift_of_the_table(label, frequency, text):
    run = (*TABLE[label][:4], frequency, np.deg2rad(1.0))
    closed = closed_drift(*run) * PER_HOUR
    simulated = simulated_drift(*run) * PER_HOUR
    assert_entry(closed, text)
    assert_entry(simulated, text)
    # The two know nothing of each other, and agree much better than with any table.
    assert simulated == pytest.approx(closed, rel=1e-6, abs=1e-7)


@pytest.mark.parametrize("name", NARROW)
def test_drift_of_a_narrow_cone(name):
    drift = coning_drift(algorithm(name), np.deg2rad(0.1), 30.0, INTERVAL) * PER_HOUR
    text = NARROW[name]
    half_digit = 0.5 * 10.0 ** int(Decimal(text).as_tuple().exponent)
    assert drift == pytest.approx(float(text), abs=half_digit)


@pytest.mark.parametrize(
    ("half_angle", "frequency", "rate_hz", "expected"),
    [
        (0.1, 20.0, 200, {"uncompensated": 2.547, "previous-1": 0.196, "optimal-4": 0.00138}),
        (1.0, 10.0, 100, {"uncompensated": 127.3, "previous-1": 9.78, "optimal-6": 0.288}),
        (10.0, 1.0, 100, {"previous-1": 0.0101, "optimal-2": 0.0099, "optimal-5": 3.5e-3}),
    ],
)
def test_drift_that_other_programs_have(half_angle, frequency, rate_hz, expected):
    for name, value in expected.items():
        run = (algorithm(name), "mean-rate", "mean-rate", 1.0 / rate_hz, frequency)
        simulated = simulated_drift(*run, np.deg2rad(half_angle)) * PER_HOUR
        assert simulated == pytest.approx(value, rel=0.012)
        closed = closed_drift(*run, np.deg2rad(half_angle)) * PER_HOUR
        assert simulated == pytest.approx(closed, rel=1e-6, abs=1e-7)


@pytest.mark.parametrize(("points", "expected"), [(4, 8.9e-2), (6, 4.2e-3), (8, 4.1e-4)])
def test_drift_after_interpolated_rates(points, expected):
    drift = coning_drift(
        algorithm("optimal-4"), np.deg2rad(0.1), 30.0, INTERVAL, "rate", points=points
    )
    assert drift * PER_HOUR == pytest.approx(expected, rel=0.015)


@pytest.mark.parametrize("kind", ["rate", "mean-rate", "increment"])
@pytest.mark.parametrize(
    "name", ["previous-3", "optimal-4", "savage-two-speed", "lookahead-8", "gyro-tuned"]
)
def test_many_frequencies_at_once_are_each_alone(name, kind):
    chosen = algorithm(name)
    frequencies = np.array([0.5, 30.0, 99.0, 130.0, 231.0])
    together = coning_drifts(chosen, 0.02, frequencies, INTERVAL, kind)
    gains = coning_gains(chosen, frequencies, INTERVAL, kind)
    for i, frequency in enumerate(frequencies):
        assert together[i] == coning_drift(chosen, 0.02, frequency, INTERVAL, kind)
        assert gains[i] == coning_gain(chosen, frequency, INTERVAL, kind)
    assert len(set(gains)) == 5
    assert coning_gains(chosen, [0.0], INTERVAL, kind)[0] == 1.0


def test_coning_rate_is_the_mean_of_the_z_gyro_and_a_solid_angle():
    expected = (987, 1974, 3948, 5922, 9869, 1.48e4, 1.97e4)
    for frequency, value in zip(FREQUENCIES, expected, strict=True):
        rate = coning_rate(np.deg2rad(1.0), frequency)
        assert rate * PER_HOUR == pytest.approx(value, rel=2e-3)
        samples = coning_samples(np.deg2rad(1.0), frequency, 1e-3, 5, "mean-rate")
        np.testing.assert_allclose(samples[:, 2], -rate, rtol=1e-14)
    assert coning_rate(0.8, 3.0) == pytest.approx(3.0 * 2 * np.pi * (1 - np.cos(0.8)), rel=1e-14)


@pytest.mark.parametrize("kind", ["rate", "mean-rate", "increment"])
@pytest.mark.parametrize("frequency", [7.0, 130.0, 530.0])
def test_samples_are_those_of_the_simulation(kind, frequency):
    motion = classical_coning(sample_times(400.0, 0.5), 0.2, frequency)
    simulated = {
        "rate": motion.gyro_rate,
        "mean-rate": motion.gyro_mean_rate,
        "increment": motion.gyro_increment,
    }[kind]
    ours = coning_samples(0.2, frequency, 0.0025, len(simulated), kind)
    np.testing.assert_allclose(ours, simulated, rtol=0, atol=3e-12 * np.abs(simulated).max())


@pytest.mark.parametrize("half_angle", [1e-6, 0.02, 0.5, 1.5])
@pytest.mark.parametrize("turn", [0.01, 0.9, 3.0, 4.5, 7.0])
def test_true_rotation_vectors_do_not_drift(half_angle, turn):
    motion = classical_coning(np.array([0, 10_000_000]), half_angle, turn / 2 / np.pi / 0.01)
    phi = rotation.log(rotation.multiply(rotation.conjugate(motion.q_nb[0]), motion.q_nb[1]))
    drift = drift_from_phi(phi, 0.01, turn / 2 / np.pi / 0.01)
    assert abs(drift) < 1e-13 * max(half_angle, 1e-3)
    # and a known rotation against the mean of the z gyro is found back
    e = 1e-9
    r = rotation.exp([0, 0, turn])
    product = rotation.multiply(rotation.exp(phi), r)
    axis = product[1:] / np.linalg.norm(product[1:])
    axis = np.copysign(1.0, axis[2]) * axis
    wrong = rotation.multiply(rotation.exp(-e * axis), product)
    phi = rotation.log(rotation.multiply(wrong, rotation.conjugate(r)))
    result = drift_from_phi(phi, 0.01, turn / 2 / np.pi / 0.01)
    assert result == pytest.approx(e / 0.01, rel=1e-5)


@pytest.mark.parametrize("half_angle", [1e-4, 2e-3, 0.05])
@pytest.mark.parametrize("frequency", [0.3, 11.0, 170.0, 310.0])
def test_difference_of_the_angles_does_not_cancel(half_angle, frequency):
    gyro = coning_samples(half_angle, frequency, INTERVAL, 5, "increment")
    phi = algorithm("previous-3").rotation_vectors(gyro, np.full(5, INTERVAL), 4, 1)[0]
    with mpmath.workdps(60):
        exact_phi = [mpmath.mpf(float(v)) for v in phi]
        angle = mpmath.sqrt(sum(v * v for v in exact_phi))
        half = mpmath.pi * mpmath.mpf(frequency) * mpmath.mpf(INTERVAL)
        cosine = mpmath.cos(angle / 2) * mpmath.cos(half) - (
            exact_phi[2] / angle * mpmath.sin(angle / 2) * mpmath.sin(half)
        )
        exact = -2 * (mpmath.acos(cosine) - half) / mpmath.mpf(INTERVAL)
    error = abs(drift_from_phi(phi, INTERVAL, frequency) - float(exact))
    assert error < 1e-13 * coning_rate(half_angle, frequency)


def rates_gain(turn, q):
    """Small-angle response of any two-rate algorithm; coefficients in one number Q."""
    return turn * (0.5 / np.tan(0.5 * turn) + q * np.sin(turn))


@pytest.mark.parametrize("turn", [0.05, 0.471, 1.3, 2.6, 3.9, 5.2, 7.5])
@pytest.mark.parametrize(
    "options",
    [
        {"variant": "truncated", "epsilon": 4e-4, "beta_gain": 0.3},
        {"variant": "printed", "epsilon": 9e-4, "beta_gain": -0.4},
        {"variant": "exact", "epsilon": 2e-3, "beta_gain": 1.7},
        {"variant": "bvp", "epsilon": 3e-2, "beta_gain": 2.4},
        {"preset": "best"},
    ],
)
def test_gain_of_two_rates_in_closed_form(turn, options):
    chosen = perturbation(**options)
    p, kappa = chosen.two_rate_form(INTERVAL)
    q = 2 * kappa / INTERVAL**2 - p / INTERVAL * (1 - p / INTERVAL)
    gain = coning_gain(chosen, turn / 2 / np.pi / INTERVAL, INTERVAL, "rate")
    assert gain == pytest.approx(rates_gain(turn, q), rel=2e-6, abs=2e-6)


def test_gain_of_mean_rates_in_closed_form():
    for turn in (0.1, 0.9, 2.0, 3.0, 4.4):
        frequency = turn / 2 / np.pi / INTERVAL
        for name, q in (("uncompensated", 0.0), ("previous-1", 1 / 6)):
            expected = np.sin(turn) / turn * (1 + 4 * q * np.sin(turn / 2) ** 2)
            gain = coning_gain(algorithm(name), frequency, INTERVAL)
            assert gain == pytest.approx(expected, rel=1e-5, abs=1e-5), (turn, name)
