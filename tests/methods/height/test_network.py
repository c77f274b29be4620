"""The network against algebra done elsewhere: eigenvalues, matrix exponentials, Lyapunov."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm, solve_continuous_lyapunov

from sinstool.core.earth import normal_gravity
from sinstool.core.errors import ConfigurationError
from sinstool.methods.height.network import (
    HeightNetwork,
    gravity_gradient,
    paper,
    recommended,
)
from tests.helpers.height_network import NetworkTheory

W2 = 3.08e-6
G = 9.80665

TABLE = [  # tau, K4: K1, K2, K3 by an independent computer algebra
    (2.4, 0.0, "1.25", "0.520836413", "0.072337963"),
    (2.4, 0.5, "1.00766706", "0.48466588", "0.072337963"),
    (2.4, 0.8, "0.8796289", "0.462963876", "0.072337963"),
    (10.0, 0.0, "0.3", "0.03000308", "0.001"),
    (10.0, 0.5, "0.28524868", "0.02950264", "0.001"),
    (30.0, 0.0, "0.1", "0.00333641", "3.7037e-5"),
    (100.0, 0.0, "0.03", "3.0308e-4", "1e-6"),
]

networks = st.builds(
    lambda tau, share, w2: NetworkTheory(tau, share * tau, w2),
    st.floats(0.5, 300.0),
    st.floats(-0.9, 0.9),
    st.floats(0.0, 3.2e-6),
)


@pytest.mark.parametrize(("tau", "k4", "k1", "k2", "k3"), TABLE)
def test_gains(tau, k4, k1, k2, k3):
    for value, printed in zip(HeightNetwork(tau, k4, W2).gains, (k1, k2, k3), strict=True):
        mantissa, _, power = printed.partition("e")
        digit = 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))
        assert value == pytest.approx(float(printed), rel=0, abs=0.51 * digit)


def test_k4_zero_is_the_conventional_loop():
    k1, k2, k3 = HeightNetwork(100.0, 0.0, W2).gains
    assert (k1, k2, k3) == pytest.approx((3 / 100, 3 / 100**2 + W2, 1 / 100**3), rel=1e-14)


@given(networks)
def test_all_roots_are_one(network):
    a = 1.0 / network.tau
    assert np.poly(network.matrix) == pytest.approx(
        [1.0, 3 * a, 3 * a * a, a**3], rel=1e-9, abs=1e-12 * a**3
    )


def test_printed_matrix_is_unstable_and_the_corrected_one_is_not():
    roots = np.linalg.eigvals(NetworkTheory(paper(W2).tau, paper(W2).k4, W2).printed_matrix)
    unstable = roots[roots.imag > 0]
    assert unstable == pytest.approx([0.009 + 0.180j], abs=5e-4)
    assert np.linalg.eigvals(
        NetworkTheory(paper(W2).tau, paper(W2).k4, W2).matrix
    ).real == pytest.approx([-1 / 2.4] * 3, rel=1e-4)


def test_earth_rate_in_the_gains_spreads_the_roots():
    # what the paper prints in (3): the Earth rate, squared, in place of the Schuler frequency
    literal = HeightNetwork(100.0, 0.0, 7.292115e-5**2)
    k1, k2, k3 = literal.gains
    roots = np.roots([1.0, k1, k2 - W2, k3]) * -100.0
    assert roots.real.min() == pytest.approx(0.83, abs=0.01)
    assert roots.real.max() == pytest.approx(1.35, abs=0.01)


@given(networks, st.floats(0.0, 6.0))
def test_transition(network, share):
    t = share * network.tau
    scale = np.diag([1.0, network.tau, network.tau**2])  # entries of one size
    ours = scale @ network.transition(t) @ np.linalg.inv(scale)
    theirs = scale @ expm(network.matrix * t) @ np.linalg.inv(scale)
    assert ours == pytest.approx(theirs, abs=1e-9)


@pytest.mark.parametrize("source", ["baro", "acceleration"])
@pytest.mark.parametrize(("tau", "k4"), [(2.4, 0.5), (30.0, -1.0), (100.0, 0.0)])
def test_step_responses(source, tau, k4):
    network = NetworkTheory(tau, k4, W2)
    f, b = network.matrix, network.input_vector(source)
    # an input as a state of a larger system
    big = np.zeros((4, 4))
    big[:3, :3], big[:3, 3] = f, b
    for t in (0.3 * tau, 1.7 * tau, 8.0 * tau):
        e = expm(big * t)
        assert network.step_response(source, t) == pytest.approx(e[:3, 3], rel=1e-8, abs=1e-10)


@pytest.mark.parametrize(
    ("k4", "over", "settle", "speed"),
    [(0.0, 20.6, 5.6, 0.333), (0.5, 9.5, 3.0, 0.314), (0.8, 4.6, 2.9, 0.302)],
)
def test_baro_step_of_one_metre(k4, over, settle, speed):
    t = np.linspace(0.0, 30.0, 30001)
    r = NetworkTheory(2.4, k4, W2).step_response("baro", t)
    assert 100 * (r[:, 0].max() - 1) == pytest.approx(over, abs=0.06)
    if k4 == 0.0:
        assert t[r[:, 0].argmax()] / 2.4 == pytest.approx(1.27, abs=0.01)
    outside = np.flatnonzero(abs(r[:, 0] - 1) > 0.02)
    assert t[outside[-1]] / 2.4 == pytest.approx(settle, abs=0.06)
    assert r[:, 1].max() == pytest.approx(speed, abs=6e-4)


@pytest.mark.parametrize(
    ("tau", "k4", "peak"),
    [(2.4, 0.0, 1.559), (2.4, 0.5, 0.774), (2.4, 0.8, 0.462), (10.0, 0.0, 27.1)],
)
def test_acceleration_step(tau, k4, peak):
    t = np.linspace(0.0, 25 * tau, 50001)
    h, _, a = NetworkTheory(tau, k4, W2).step_response("acceleration", t).T
    assert h.max() == pytest.approx(peak, rel=2e-3)
    assert t[h.argmax()] == pytest.approx(2 * tau, rel=1e-2)
    assert (h[-1], a[-1]) == pytest.approx((0.0, 1.0), abs=1e-6)


@pytest.mark.parametrize(("k4", "lag"), [(0.5, 0.0), (0.0, 1.0), (-1.0, 1.0), (0.7, 0.4)])
def test_climb_error(k4, lag):
    network = NetworkTheory(4.0, k4, W2)
    speed = 5.0
    # error = solution less truth: driven by -K4 V and by the lag of the barometer
    big = np.zeros((5, 5))
    b = network.input_vector("baro")
    big[:3, :3], big[:3, 3], big[:3, 4] = network.matrix, b, -k4 * speed * b
    if lag:
        big[3, 3], big[3, 4] = -1 / lag, -speed
    for t in (0.5, 3.0, 9.0, 60.0):
        expected = expm(big * t)[:3, 4]
        assert network.climb_error(t, speed, lag) == pytest.approx(expected, abs=1e-9)
    assert network.climb_error(200.0, speed, lag)[0] == pytest.approx(-(k4 + lag) * speed, abs=1e-6)


NOISES = ("baro_white", "baro_wander", "accel_white", "accel_bias_wander")


def lyapunov(network, name):
    """Stationary sigmas of (h - slow baro, v, A - bias) for unit density, without gravity."""
    f = network.matrix
    drive = {
        "baro_white": network.input_vector("baro"),
        # in terms of h - b: it moves by -b', and the rest is homogeneous
        "baro_wander": np.array([-1.0, 0.0, 0.0]),
        "accel_white": np.array([0.0, 1.0, 0.0]),
        "accel_bias_wander": np.array([0.0, 0.0, -1.0]),
    }[name]
    scale = np.array([1.0, network.tau, network.tau**2])
    f = scale[:, None] * f / scale
    drive = drive * scale
    return np.sqrt(np.diag(solve_continuous_lyapunov(f, -np.outer(drive, drive)))) / scale


@pytest.mark.parametrize("name", NOISES)
@given(st.floats(0.5, 300.0), st.floats(-0.9, 0.9))
def test_sigmas(name, tau, share):
    network = NetworkTheory(tau, share * tau, 0.0)
    s = network.sigmas(**{name: 1.0})
    expected = pytest.approx(lyapunov(network, name), rel=1e-6)
    assert (s.height, s.velocity, s.correction) == expected
    exact = network.sigmas_with_gravity(**{name: 1.0})
    assert (exact.height, exact.velocity, exact.correction) == expected


def test_sigmas_add_as_squares():
    network = NetworkTheory(12.0, 3.0)
    parts = [network.sigmas(**{name: 2.0}).velocity ** 2 for name in NOISES]
    every = network.sigmas(**dict.fromkeys(NOISES, 2.0))
    assert every.velocity**2 == pytest.approx(sum(parts), rel=1e-12)


def test_sigmas_of_the_papers_barometer():
    network = NetworkTheory(2.4, 0.5, W2)
    s = network.sigmas(baro_wander=2 * 100.0 / 500.0)
    assert s.velocity == pytest.approx(0.335, abs=5e-4)
    assert s.correction == pytest.approx(4.253e-2, abs=1e-5)
    assert s.correction / G * 1e6 == pytest.approx(4337, abs=1)


def test_gravity_gradient_is_the_derivative():
    lat, h = np.radians(34.2368), 388.0
    slope = (normal_gravity(lat, h - 0.5) - normal_gravity(lat, h + 0.5)) / 1.0
    assert gravity_gradient(lat, h) == pytest.approx(float(slope), rel=1e-8)
    assert gravity_gradient(lat, h) == pytest.approx(3.0858e-6, abs=5e-11)


def test_presets():
    assert [recommended(g).tau for g in ("mems", "tactical", "navigation")] == [5.0, 30.0, 100.0]
    assert recommended("tactical").k4 == 0.0
    assert (paper().tau, paper().k4) == (2.4, 0.5)


@pytest.mark.parametrize("tau", [0.0, -1.0, np.nan, np.inf])
def test_impossible_tau(tau):
    with pytest.raises(ConfigurationError, match="tau"):
        HeightNetwork(tau)


@pytest.mark.parametrize("k4", [5.0, -5.0, 7.0, np.nan])
def test_impossible_k4(k4):
    with pytest.raises(ConfigurationError, match="K4"):
        HeightNetwork(5.0, k4)
    assert HeightNetwork(5.0, 4.99).gains
