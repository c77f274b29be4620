"""Slow motion without vibration looks like rest for seconds; real rests remain rests."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from tests.helpers.imulogs import FLU_FRD, G, even_times, imu_log
from tests.pipelines.process.test_smoothing import run

RATE = 100.0
# Size of a bank or of a rate of turn, deg and deg/s; over how many seconds it changes; m/s
KINDS = {
    "aircraft": (25.0, 0.0, 15.0, 70.0),
    "slow aircraft": (12.0, 0.0, 40.0, 50.0),
    "ship": (0.1, 0.8, 30.0, 6.0),
    "balloon": (0.5, 2.0, 20.0, 5.0),
    "car": (0.0, 2.0, 20.0, 22.0),
}


def slow(path, kind, seed, seconds=180.0, noise=(5e-4, 0.015), gate=1.0, shake=0.0):
    """A log of slow motion, gyro bias in FRD, and true headings; of a vehicle that moves by `gate`.

    Vibration does not turn the vehicle: it is a difference of white noise.
    """
    bank, turn, slow_s, speed = KINDS[kind]
    random = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE) + 1) / RATE

    def wander(over_s):
        knots = np.arange(-2.0 * over_s, seconds + 3.0 * over_s, over_s)
        return np.clip(CubicSpline(knots, random.normal(size=len(knots)))(t), -1.8, 1.8) * gate

    roll, pitch = np.radians(bank) * wander(slow_s), 0.02 * wander(10.0)
    turning = G * np.tan(roll) / speed if not turn else np.radians(turn) * wander(slow_s)
    yaw = np.cumsum(turning) / RATE
    attitude = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]))
    velocity = (speed * gate * np.ones_like(t))[:, None] * np.column_stack(
        [np.cos(yaw), np.sin(yaw), np.zeros_like(t)]
    )
    force = np.diff(velocity, axis=0) * RATE - [0.0, 0.0, G]
    accel = attitude[1:].inv().apply(force)
    gyro = (attitude[:-1].inv() * attitude[1:]).as_rotvec() * RATE
    bias = np.radians(100.0 / 3600.0) * random.normal(size=3)
    moves = np.broadcast_to(gate, t.shape)[1:, None]
    vibration = np.diff(random.normal(size=(len(t), 3)), axis=0)
    gyro += bias + noise[0] * random.normal(size=gyro.shape) + shake * 0.02 * moves * vibration
    accel += noise[1] * random.normal(size=gyro.shape) + shake * moves * random.normal(
        size=gyro.shape
    )
    log = imu_log(path, even_times(len(gyro), RATE), FLU_FRD.apply(gyro), FLU_FRD.apply(accel))
    return log, bias, yaw


def judged(tmp_path, *arguments, **options):
    """Error of the gyro's bias in sigmas, and what `process` said."""
    log, bias, _ = slow(tmp_path / "in.mcap", *arguments, **options)
    said = run(log, tmp_path / "out.mcap", input={"gyro_kind": "mean-rate"})
    smoothing = said["smoothing"]
    off = np.abs(np.array(smoothing["gyro_bias_rad_s"]) - bias)
    return float(np.max(off / smoothing["gyro_bias_sigma_rad_s"])), said


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("kind", KINDS)
def test_slow_motion_shows_no_bias(tmp_path, kind, seed):
    sigmas, said = judged(tmp_path, kind, seed)
    assert sigmas < 4.0, (sigmas, said["alignment"]["gyro_bias_source"])
