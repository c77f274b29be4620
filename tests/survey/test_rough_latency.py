"""A first value of the latency of fixes, by velocity changes, beside the truth of simulated drives
and flights (`pyins.sim`)."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sinstool.core.streams import GnssEpochs
from sinstool.methods.alignment.still import WindowStage
from sinstool.survey.rough_latency import rough_latency
from tests.helpers.unseen_drives import RATE, T0, cruise, drive, flight

NEAR_S = 0.2


def windows_of(truth, turned=None, bias=0.0):
    """Windows of an ideal IMU, mounted as a rotation says, with a bias of its gyros, rad/s."""
    stage = WindowStage()
    gyro, accel = RATE * truth.gyro + bias, RATE * truth.accel
    if turned is not None:
        gyro, accel = turned.apply(gyro), turned.apply(accel)
    stage.push(T0 + np.round(truth.seconds * 1e9).astype(np.int64), gyro, accel)
    return stage.finish()


def fixes_of(truth, late_s, interval_s, noise=0.0, velocity=True, seed=0):
    """Fixes that are stamped late."""
    k = np.arange(0, len(truth.seconds), round(interval_s * RATE))
    random = np.random.default_rng(seed)
    unknown = np.full((len(k), 3), np.nan)
    velocity_n = truth.velocity_n[k] + noise * random.standard_normal((len(k), 3))
    time_ns = T0 + np.round((truth.seconds[k] + late_s) * 1e9).astype(np.int64)
    return GnssEpochs(
        time_ns,
        time_ns,
        truth.latitude[k],
        truth.longitude[k],
        truth.height[k],
        velocity_n if velocity else unknown,
        unknown,
        unknown,
    )


@pytest.fixture(scope="module")
def motions():
    return {"road": drive(5, 200.0, 20.0), "rough air": flight(4, 200.0, turbulent=True)}


@pytest.mark.parametrize("late_s", [-2.3, 0.0, 0.6, 1.1, 2.9])
@pytest.mark.parametrize("interval_s", [0.2, 1.0])
@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize("kind", ["road", "rough air"])
def test_latency_is_found(motions, kind, velocity, interval_s, late_s):
    truth = motions[kind]
    windows = windows_of(truth, bias=0.002)
    gnss = fixes_of(truth, late_s, interval_s, 0.1, velocity)
    assert rough_latency(windows, gnss) == pytest.approx(late_s, abs=NEAR_S)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None)
def test_mounting_does_not_matter(motions, seed):
    truth = motions["road"]
    turned = Rotation.random(random_state=seed % 2**32)
    gnss = fixes_of(truth, 1.4, 1.0, 0.1)
    straight = rough_latency(windows_of(truth), gnss)
    assert rough_latency(windows_of(truth, turned), gnss) == pytest.approx(straight, abs=1e-6)


def test_even_motion_shows_nothing():
    truth = cruise(120.0)
    assert rough_latency(windows_of(truth), fixes_of(truth, 1.0, 1.0, 0.1)) is None


@pytest.mark.parametrize("late_s", [3.5, -4.5])
def test_clocks_further_apart_are_not_told(motions, late_s):
    truth = motions["road"]
    assert rough_latency(windows_of(truth), fixes_of(truth, late_s, 1.0, 0.1)) is None


def test_rest_and_noise_show_nothing(motions):
    truth = motions["road"]
    gnss = fixes_of(truth, 1.0, 1.0)
    still = fixes_of(truth, 1.0, 1.0, 3.0)
    assert rough_latency(windows_of(truth), None) is None
    assert rough_latency(windows_of(truth), gnss.rows(slice(0, 1))) is None
    assert rough_latency(windows_of(truth), still) is None


def test_rates_of_another_sign_do_not_move_the_latency(motions):
    """Loads show it in rough air, though no rotation explains the turns."""
    truth = motions["rough air"]
    stage = WindowStage()
    time_ns = T0 + np.round(truth.seconds * 1e9).astype(np.int64)
    stage.push(time_ns, -RATE * truth.gyro, RATE * truth.accel)
    found = rough_latency(stage.finish(), fixes_of(truth, 1.0, 1.0, 0.1))
    assert found == pytest.approx(1.0, abs=NEAR_S)


def test_outages_of_either_are_left_out(motions):
    truth = motions["road"]
    gnss = fixes_of(truth, 1.4, 1.0, 0.1)
    seconds = (gnss.time_ns - T0) * 1e-9
    gnss = gnss.rows((seconds < 60.0) | (seconds > 75.0))
    stage = WindowStage()
    kept = (truth.seconds < 110.0) | (truth.seconds > 116.3)
    time_ns = T0 + np.round(truth.seconds[kept] * 1e9).astype(np.int64)
    stage.push(time_ns, RATE * truth.gyro[kept], RATE * truth.accel[kept])
    assert rough_latency(stage.finish(), gnss) == pytest.approx(1.4, abs=NEAR_S)
