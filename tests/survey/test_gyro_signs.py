"""A gyro whose axes do not have the accelerometer's signs is told; right ones never are.

EuRoC's drone with the sign of its x or z rates changed ended 45 deg off, at sigmas of 4, status 0.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sinstool.core.finding import Severity
from sinstool.methods.alignment.still import WindowStage
from sinstool.survey.gyro_signs import gyro_sign_findings
from tests.helpers.quick import mostly_slow
from tests.helpers.unseen_drives import (
    RATE,
    T0,
    boat,
    cruise,
    drive,
    flight,
    multicopter,
    walk,
)

GRAVITY = np.array([0.0, 0.0, 9.81])


def found(time_ns, gyro, accel):
    stage = WindowStage()
    stage.push(time_ns, gyro, accel)
    return list(gyro_sign_findings(stage.finish(), "/imu"))


def in_hand(seed, duration=120.0, rate=100.0):
    """A sensor that a hand turns about all axes and shakes; its gyro has a bias."""
    random, n = np.random.default_rng(seed), round(duration * rate)
    t = np.arange(n) / rate
    tones = 2.0 * np.pi * random.uniform(0.02, 0.4, (6, 3))
    phases = random.uniform(0.0, 2.0 * np.pi, (6, 3))
    omega = 0.35 * np.cos(tones[:, None] * t[:, None] + phases[:, None]).sum(axis=0)
    turned = [Rotation.random(random_state=seed)]
    for step in omega / rate:
        turned.append(turned[-1] * Rotation.from_rotvec(step))
    c_nb = Rotation.concatenate(turned[1:])
    shaken = 2.0 * np.sin(2.0 * np.pi * random.uniform(0.3, 1.0, 3) * t[:, None])
    noise = random.standard_normal((2, n, 3))
    gyro = omega + random.uniform(-0.05, 0.05, 3) + 0.005 * noise[0]
    accel = c_nb.inv().apply(GRAVITY + shaken) + 0.05 * noise[1]
    return T0 + np.round(t * 1e9).astype(np.int64), gyro, accel


@pytest.mark.parametrize("seed", mostly_slow(range(3), 0))
@pytest.mark.parametrize("axes", ["x", "y", "z", "yz", "xyz"])
def test_a_wrong_sign_is_named(seed, axes):
    time_ns, gyro, accel = in_hand(seed)
    assert not found(time_ns, gyro, accel)
    signs = np.array([-1.0 if axis in axes else 1.0 for axis in "xyz"])
    finding = found(time_ns, gyro * signs, accel)[0]
    assert finding.severity == Severity.LOST
    said = {"x": "x", "y": "y", "z": "z", "yz": "y and z", "xyz": "x, y and z"}[axes]
    assert f"about {said} is changed" in finding.text


def test_an_accelerometer_with_one_wrong_sign_is_one_of_two_of_the_gyro():
    time_ns, gyro, accel = in_hand(4)
    finding = found(time_ns, gyro, accel * [1.0, 1.0, -1.0])[0]
    assert "about x and y is changed" in finding.text


@pytest.mark.parametrize("make", [drive, flight, boat, walk, multicopter])
@pytest.mark.parametrize("seed", mostly_slow([1, 2], 1))
def test_vehicles_with_right_signs_are_believed(make, seed):
    truth = make(seed, 200.0)
    time_ns = T0 + np.round(truth.seconds * 1e9).astype(np.int64)
    turned = Rotation.random(random_state=seed)
    bias = np.random.default_rng(seed).uniform(-0.05, 0.05, 3)
    gyro = turned.apply(RATE * truth.gyro) * 1.02 + bias
    assert not found(time_ns, gyro, turned.apply(RATE * truth.accel) * 1.01)


def test_even_motion_short_logs_and_gyros_alone_show_nothing():
    truth = cruise(60.0)
    time_ns = T0 + np.round(truth.seconds * 1e9).astype(np.int64)
    assert not found(time_ns, -RATE * truth.gyro, RATE * truth.accel)
    time_ns, gyro, accel = in_hand(1)
    assert not found(time_ns, -gyro, np.zeros_like(accel))
    assert not found(time_ns[:1500], -gyro[:1500], accel[:1500])
    assert not found(time_ns[:0], gyro[:0], accel[:0])
