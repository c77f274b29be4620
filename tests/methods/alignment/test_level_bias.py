"""The gyro bias of a vehicle that goes where it points, by its course."""

import numpy as np
import pytest

from sinstool.core.streams import Imu
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE, STANDARD_GRAVITY
from sinstool.methods.alignment.inflight_types import GnssFixes
from sinstool.methods.alignment.level_bias import level_bias

BIAS = np.array([0.4, -0.3, 0.8]) * DEGREE
RATE, FIXES = 50.0, 5.0


def log(speed, heading, random):
    """Samples and fixes of 120 s, speed and heading (rad) being functions of time; FRD."""
    time = np.arange(1, 120 * RATE + 1) / RATE
    turns = np.gradient(heading(time), time)
    gyro = BIAS + np.column_stack([0.0 * time, 0.0 * time, turns])
    gyro += 2e-3 * random.standard_normal(gyro.shape)
    accel = np.tile([0.0, 0.0, -STANDARD_GRAVITY], (len(time), 1))
    imu = Imu.of(np.round(time * SECOND).astype(np.int64), gyro, accel)
    at = np.arange(1, 120 * FIXES + 1) / FIXES
    course = np.column_stack([np.cos(heading(at)), np.sin(heading(at)), 0.0 * at])
    velocity = speed(at)[:, None] * course + 0.05 * random.standard_normal((len(at), 3))
    nowhere = np.full(len(at), np.nan)
    fixes = GnssFixes(np.round(at * SECOND).astype(np.int64), nowhere, nowhere, nowhere, velocity)
    return imu, fixes


@pytest.mark.parametrize("seed", range(5))
def test_fixes_that_seem_fast_for_a_moment_show_no_course(seed):
    """Velocities from noisy fixes: 1 s of 2.6 m/s backwards, 75 s before the vehicle sets off."""
    random = np.random.default_rng(seed)
    swing, period = random.uniform(0.1, 0.3), random.uniform(4.0, 8.0)

    def heading(t):
        return swing * np.sin(t / period)

    imu, fixes = log(lambda t: np.where(t > 75.0, 4.0, 0.1), heading, random)
    fixes.velocity_n[:5, :2] = [-2.0, random.uniform(-1.7, 1.7)]
    level = level_bias(imu, fixes, 0)
    assert level is not None
    assert abs((level.bias - BIAS) @ level.up) < 3.0 * level.sigma
    assert np.allclose((level.bias - BIAS)[:2], 0.0, atol=0.05 * DEGREE)


def test_a_vehicle_that_is_never_fast_for_long_shows_none():
    """Of 12 s it stands for ten."""
    random = np.random.default_rng(1)
    imu, fixes = log(lambda t: np.where(t % 12.0 < 2.0, 5.0, 0.0), lambda t: 0.0 * t, random)
    assert level_bias(imu, fixes, 0) is None


def in_turns(random, leans):
    """120 s of turns to either side at 40 m/s, coordinated as an aircraft's, or flat as a car's."""
    time = np.arange(1, 120 * RATE + 1) / RATE
    bank = random.uniform(0.2, 0.6) * np.sin(time / random.uniform(3.0, 6.0) + random.uniform(0, 6))
    turns = STANDARD_GRAVITY * np.tan(bank) / 40.0
    heading = np.cumsum(turns) / RATE
    imu, fixes = log(lambda t: 40.0 + 0.0 * t, lambda t: np.interp(t, time, heading), random)
    nothing = np.zeros_like(time)
    if leans:
        rates = [np.gradient(bank, time), turns * np.sin(bank), turns * np.cos(bank)]
        force = [nothing, nothing, -STANDARD_GRAVITY / np.cos(bank)]
    else:
        rates = [nothing, nothing, turns]
        force = [nothing, 40.0 * turns, nothing - STANDARD_GRAVITY]
    noise = 2e-3 * random.standard_normal((len(time), 3))
    return Imu.of(imu.time_ns, BIAS + np.column_stack(rates) + noise, np.column_stack(force)), fixes


@pytest.mark.parametrize("seed", range(6))
def test_what_an_aircraft_turns_across_the_vertical_is_no_bias(seed):
    """Its nose rises in turns to either side: by a degree each second, and that was certain."""
    imu, fixes = in_turns(np.random.default_rng(seed), leans=True)
    level = level_bias(imu, fixes, 0)
    off = level.bias - BIAS
    across = float(np.linalg.norm(off - (off @ level.up) * level.up))
    assert across > 0.05 * DEGREE
    assert across < 2.0 * level.sigma_any
    assert level.leaning > 0.4 * across


@pytest.mark.parametrize("seed", range(6))
def test_a_car_does_not_lean(seed):
    imu, fixes = in_turns(np.random.default_rng(seed), leans=False)
    level = level_bias(imu, fixes, 0)
    assert level.leaning < 0.05 * DEGREE
    assert np.abs(level.bias - BIAS).max() < 0.1 * DEGREE


@pytest.mark.parametrize("seed", range(5))
def test_a_gap_of_the_imu_leaves_a_bias_with_its_sigma(seed):
    random = np.random.default_rng(seed)
    imu, fixes = in_turns(random, False)
    begin = random.uniform(20.0, 60.0)
    seconds = imu.time_ns / SECOND
    kept = (seconds < begin) | (seconds > begin + random.uniform(2.5, 6.0))
    level = level_bias(imu.rows(kept), fixes, 0)
    assert level is not None and np.isfinite(level.sigma_any)
    assert np.linalg.norm(level.bias - BIAS) < 3.0 * level.sigma_any


def test_an_imu_that_is_not_there_while_the_vehicle_moves_shows_none():
    imu, fixes = log(
        lambda t: np.where((t > 40.0) & (t < 80.0), 5.0, 0.0),
        lambda t: 0.0 * t,
        np.random.default_rng(1),
    )
    seconds = imu.time_ns / SECOND
    assert level_bias(imu, fixes, 0) is not None
    assert level_bias(imu.rows((seconds < 39.0) | (seconds > 81.0)), fixes, 0) is None
    assert level_bias(imu.rows((seconds < 39.0) | (seconds > 70.0)), fixes, 0) is None
