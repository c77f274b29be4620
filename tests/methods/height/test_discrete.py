"""Sampled gains: poles, stability, and the limit of short intervals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sinstool.methods.height.network import HeightNetwork, pole_matched_gains
from tests.helpers.height_network import NetworkTheory

W2 = 3.0858e-6
TAUS = (2.4, 10.0, 100.0)
INTERVALS = (0.005, 0.02, 0.1, 0.5, 1.0, 5.0)


def free(interval, w2=0.0):
    """Transition of (h, v, A) between samples."""
    if w2 == 0.0:
        return np.array([[1.0, interval, -(interval**2) / 2], [0.0, 1.0, -interval], [0, 0, 1.0]])
    w = np.sqrt(w2)
    c, s = np.cosh(w * interval), np.sinh(w * interval) / w
    return np.array([[c, s, -(c - 1) / w2], [w2 * s, c, -s], [0.0, 0.0, 1.0]])


def update(interval, tau, k4, w2=0.0):
    l1, l2, l3 = pole_matched_gains(interval, tau, k4, w2)
    return np.eye(3) - np.outer([l1, l2, -l3], [1.0, k4, 0.0])


@given(st.floats(0.005, 5.0), st.floats(0.5, 300.0), st.floats(-0.9, 0.9))
def test_poles(interval, tau, share):
    # scaled to entries of one size: h, v T, A T^2
    scale = np.array([1.0, interval, interval**2])
    step = update(interval, tau, share * tau) @ free(interval)
    r = np.exp(-interval / tau)
    ours = np.poly(scale[:, None] * step / scale)
    assert ours == pytest.approx([1.0, -3 * r, 3 * r * r, -(r**3)], abs=2e-11)


@pytest.mark.parametrize("interval", INTERVALS)
@pytest.mark.parametrize("tau", TAUS)
def test_gravity_hardly_moves_the_poles(interval, tau):
    roots = np.linalg.eigvals(update(interval, tau, 0.0, W2) @ free(interval, W2))
    rates = -np.log(roots) / interval * tau
    assert abs(rates - 1).max() < (0.033 if tau >= 10 else 0.045)


def test_without_its_share_in_l2_gravity_would():
    roots = np.linalg.eigvals(update(1.0, 100.0, 0.0, 0.0) @ free(1.0, W2))
    assert abs(-np.log(roots) * 100 - 1).max() > 0.2


@pytest.mark.parametrize(("tau", "k4"), [(2.4, 0.0), (2.4, 0.5), (30.0, -1.0)])
def test_short_intervals_give_the_continuous_gains(tau, k4):
    k = np.array(HeightNetwork(tau, k4, 0.0).gains)
    off = [abs(np.array(pole_matched_gains(t, tau, k4, 0.0)) / t / k - 1) for t in (1e-2, 1e-3)]
    assert off[0] / off[1] == pytest.approx([10.0] * 3, rel=0.05)  # first order in T
    k = np.array(HeightNetwork(tau, k4, W2).gains)
    assert np.array(pole_matched_gains(1e-4, tau, k4, W2)) / 1e-4 == pytest.approx(k, rel=2e-4)


def test_published_examples():
    # without gravity's share, to the digits given, and with it
    assert pole_matched_gains(0.02, 2.4, 0.5, 0.0) == pytest.approx(
        (0.01990358, 0.00957302, 0.00142880), abs=6e-9
    )
    assert pole_matched_gains(0.02, 2.4, 0.5, W2)[1] == pytest.approx(0.00957308, abs=6e-9)
    assert pole_matched_gains(1.0, 2.4, 0.0, W2) == pytest.approx(
        (0.7134952, 0.2890009, 0.0395679), abs=6e-8
    )


@pytest.mark.parametrize("share", [0.0, 0.3, -0.4])
@pytest.mark.parametrize("tau", [2.4, 10.0, 100.0])
def test_stable_for_random_intervals(tau, share):
    rng = np.random.default_rng(8)
    scale = np.array([1.0, tau, tau * tau])
    worst = 0.0
    for _ in range(12):
        product, passed = np.eye(3), 0.0
        while passed < 25 * tau:
            t = rng.uniform(0.02, 3.0)
            product = update(t, tau, share * tau, W2) @ free(t, W2) @ product
            passed += t
        worst = max(worst, np.linalg.norm(scale[:, None] * product / scale, 2))
    assert worst < 1e-6


@pytest.mark.parametrize(
    ("rate", "deviation"), [(128.0, 0.0013), (50.0, 0.0034), (10.0, 0.0165), (1.0, 0.135)]
)
@pytest.mark.parametrize("k4", [0.0, 0.5])
def test_step_response_beside_the_continuous_one(rate, deviation, k4):
    tau, interval = 2.4, 1.0 / rate
    network = NetworkTheory(tau, k4, W2)
    gains = np.array(pole_matched_gains(interval, tau, k4, W2)) * [1.0, 1.0, -1.0]
    phi = free(interval, W2)
    x, after = np.zeros(3), []
    for _ in range(int(12 * tau * rate)):
        x = phi @ x
        x = x - gains * (x[0] + k4 * x[1] - 1.0)
        after.append(x[0])
    # a sample stands for the interval that it ends
    t = np.arange(1, len(after) + 1) * interval
    off = abs(np.array(after) - network.step_response("baro", t)[:, 0]).max()
    assert deviation / 1.35 < off < deviation
