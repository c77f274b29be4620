"""Navigations carried back from erroneous starts with erroneous sensors err as they claim to."""

import numpy as np
import pytest

from sinstool.core.rotation import conjugate, exp, from_euler, log, multiply
from sinstool.methods.ins_gnss.carried_back import carried_back
from sinstool.methods.sensor_errors import IMU_GRADES
from sinstool.methods.strapdown.navigation import SIZE, navigate_backward
from sinstool.methods.strapdown.velocity import Increments
from tests.helpers.filter_start import start

DT, SECONDS, RUNS = 0.1, 60.0, 300
RADIUS = 6.371e6
ACROSS = 1.0 - np.eye(3)


def back(nav, turned, gained):
    rows = np.empty((len(turned) + 1, SIZE))
    rows[-1] = nav
    navigate_backward(nav.copy(), turned, gained, np.full(len(turned), DT), rows[:-1])
    return rows


def weaving(n):
    """Increments of a vehicle that turns left and right, speeds up and brakes."""
    t = DT * np.arange(n)
    rate = np.stack([0.02 * np.sin(t), 0.03 * np.cos(0.7 * t), 0.2 + 0.2 * np.sin(0.2 * t)], axis=1)
    force = np.stack([2.0 * np.sin(0.3 * t), 4.0 * np.sin(0.2 * t), np.full(n, -9.8)], axis=1)
    return rate * DT, force * DT


@pytest.mark.parametrize("grade", ["mems", "industrial", "tactical"])
def test_errors_are_as_large_as_said(grade):
    """Truth: the nonlinear navigation itself, from many starts with many sensors."""
    imu, n = IMU_GRADES[grade], round(SECONDS / DT)
    turned, gained = weaving(n)
    sigma = {"p": [2.0, 1.0, 3.0], "v": [0.1, 0.2, 0.05], "a": [2e-3, 3e-3, 8e-3]}
    begin = start(
        0.8, 0.2, 100.0, [10.0, 5.0, 0.0], from_euler([0.05, -0.02, 1.0]), *sigma.values(),
        gyro_bias=np.zeros(3), accel_bias=np.zeros(3),
        gyro_bias_sigma=0.2 * imu.gyro_bias, accel_bias_sigma=0.2 * imu.accel_bias,
    )  # fmt: skip
    truth = back(begin.nav, turned, gained)
    updates = Increments(np.arange(1, n + 1), np.arange(1, n + 1), np.full(n, DT), turned, gained)
    seconds, covariance = carried_back(begin, imu, updates, truth[:, 6:10])
    assert seconds[-1] == pytest.approx(SECONDS)
    random = np.random.default_rng(5)
    errors = np.empty((RUNS, len(seconds), 9))
    at = n - np.round(seconds / DT).astype(int)
    for k in range(RUNS):

        def drawn(size, wander, steps=random):
            walk = np.sqrt(2.0 * DT / imu.bias_time_s) * wander * steps.standard_normal((n, 3))
            return size * steps.standard_normal(3) + np.cumsum(walk[::-1], axis=0)[::-1]

        share = imu.scale_wander
        rate = drawn(0.2 * imu.gyro_bias, imu.gyro_instability) * DT
        rate += drawn(imu.gyro_scale, share * imu.gyro_scale) * turned
        rate += turned @ (imu.gyro_misalignment * random.standard_normal((3, 3)) * ACROSS)
        rate += imu.angle_random_walk * np.sqrt(DT) * random.standard_normal((n, 3))
        force = drawn(0.2 * imu.accel_bias, imu.accel_instability) * DT
        force += drawn(imu.accel_scale, share * imu.accel_scale) * gained
        force += imu.velocity_random_walk * np.sqrt(DT) * random.standard_normal((n, 3))
        nav = begin.nav.copy()
        north, east, down = np.multiply(sigma["p"], random.standard_normal(3))
        nav[:3] += north / RADIUS, east / RADIUS / np.cos(0.8), -down
        nav[3:6] += np.multiply(sigma["v"], random.standard_normal(3))
        nav[6:10] = multiply(exp(np.multiply(sigma["a"], random.standard_normal(3))), nav[6:10])
        rows = back(nav, turned + rate, gained + force)[at]
        off = rows - truth[at]
        errors[k, :, :3] = off[:, :3] * [RADIUS, RADIUS * np.cos(0.8), -1.0]
        errors[k, :, 3:6] = off[:, 3:6]
        errors[k, :, 6:] = log(multiply(rows[:, 6:10], conjugate(truth[at, 6:10])))
    spread = np.mean(errors**2, axis=0)
    said = np.diagonal(covariance, axis1=1, axis2=2)
    ratio = np.sqrt(spread / said)
    # What angles between the axes do as a vehicle turns is no random walk, and only bounded so
    least = 0.85 if imu.gyro_misalignment < 1e-3 else 0.5
    assert np.all(ratio < 1.15) and np.all(ratio > least)


def test_turns_that_no_gyro_has_seen():
    imu, n = IMU_GRADES["tactical"], 50
    begin = start(0.8, 0.2, 0.0, [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], 1.0, 0.1, 0.01)
    still = np.zeros((n, 3))
    updates = Increments(np.arange(n), np.arange(n), np.full(n, DT), still, still)
    q_nb, unseen = np.tile(begin.nav[6:10], (n + 1, 1)), np.zeros((n, 3))
    unseen[25] = [0.01, 0.02, 0.03]
    seconds, plain = carried_back(begin, imu, updates, q_nb)
    _, more = carried_back(begin, imu, updates, q_nb, unseen)
    grown = np.diagonal(more - plain, axis1=1, axis2=2)[:, 6:]
    before = seconds > DT * 25
    assert grown[before] == pytest.approx(np.tile([0.01, 0.02, 0.03], (before.sum(), 1)))
    assert not grown[~before].any()


def test_nothing_before_it():
    begin = start(0.8, 0.2, 0.0, [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], 1.0, 0.1, 0.01)
    nothing = np.empty((0, 3))
    updates = Increments(*(np.empty(0, np.int64),) * 2, np.empty(0), nothing, nothing)
    seconds, covariance = carried_back(begin, IMU_GRADES["mems"], updates, begin.nav[None, 6:10])
    assert seconds[0] == 0.0 and covariance.shape == (2, 9, 9)
    assert np.diag(covariance[0]) == pytest.approx(np.repeat([1.0, 0.01, 1e-4], 3))
