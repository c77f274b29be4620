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


# Of 24 seeds of each kind, some that were off by 4 to 48 sigmas of the gyro's bias
@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        ("aircraft", 3),
        ("slow aircraft", 3),
        ("slow aircraft", 13),
        ("ship", 4),
        ("balloon", 15),
        ("balloon", 17),
        ("car", 11),
        ("car", 17),
    ],
)
def test_slow_motion_shows_no_bias(tmp_path, kind, seed):
    """Turns were taken for rests of two seconds, and heading was off by a hundred degrees."""
    sigmas, said = judged(tmp_path, kind, seed)
    assert sigmas < 4.0, (sigmas, said["alignment"]["gyro_bias_source"])


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_what_slow_motion_shows_of_a_bias_is_as_sure_as_it_says(tmp_path, kind):
    found = []
    for seed in range(100, 124):
        (tmp_path / str(seed)).mkdir()
        found.append(judged(tmp_path / str(seed), kind, seed)[0])
    assert np.mean(np.array(found) > 4.0) < 0.05
    assert np.sqrt(np.mean(np.minimum(found, 10.0) ** 2)) < 1.5


def stops(seed, seconds=180.0, rest_s=3.0, brakes_s=8.0):
    """1 where a vehicle moves, 0 in stops, which it comes to and leaves within some seconds."""
    random = np.random.default_rng([seed, 1])
    t = np.arange(round(seconds * RATE) + 1) / RATE
    gate = np.ones_like(t)
    at = float(random.uniform(5.0, 20.0))
    while at < seconds - 10.0:
        off = np.maximum(at - t, t - at - rest_s) / brakes_s
        gate = np.minimum(gate, 0.5 - 0.5 * np.cos(np.pi * np.clip(off, 0.0, 1.0)))
        at += float(random.uniform(25.0, 40.0))
    return gate


@pytest.mark.parametrize("seed", [0, 1, 4, 5])
def test_stops_of_three_seconds_show_the_bias(tmp_path, seed):
    """A vehicle that shakes where it moves comes to them gradually, and moves off so."""
    sigmas, said = judged(tmp_path, "car", seed, gate=stops(seed), shake=0.3)
    assert sigmas < 4.0
    assert said["alignment"]["gyro_bias_source"] == "rest"
    assert said["smoothing"]["heading_sigma_end_deg"] < 2.0
