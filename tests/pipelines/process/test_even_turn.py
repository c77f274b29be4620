"""A robot that creeps over a smooth floor in an even turn is as quiet as one that rests."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.helpers.imulogs import G, even_times, imu_log, read_attitude
from tests.pipelines.process.test_smoothing import run

RATE = 100.0
DEG_H = np.radians(1.0 / 3600.0)


def creeping(path, seed, *phases, bias=5.0, noise=5e-4, speed=0.4, wobble=0.0, sways=0.0):
    """Phases of seconds and deg/s; returns times from the first, s, and headings, rad, of the log.

    FLU axes, gyro biases of one sigma in deg/h, in any direction.
    """
    random = np.random.default_rng(seed)
    rate = np.concatenate([np.full(round(s * RATE), np.radians(w)) for s, w in phases])
    rate = np.convolve(np.pad(rate, 50, "edge"), np.full(100, 0.01), "same")[50:-50]
    heading = np.concatenate([[0.0], np.cumsum(rate)[:-1] / RATE])
    tilt = Rotation.from_euler("xy", random.normal(0.0, 0.03, 2))
    level = np.zeros((len(rate), 3))
    level[:, 2] = rate
    force = np.zeros((len(rate), 3))
    force[:, 1], force[:, 2] = speed * rate, G
    gyro = tilt.inv().apply(level) + bias * DEG_H * random.normal(size=3)
    gyro += noise * random.normal(size=gyro.shape)
    shake = np.diff(random.normal(size=(len(gyro) + 81, 3)), axis=0)
    gyro += (
        wobble * np.array([np.convolve(one, np.hanning(83)[1:-1], "valid") for one in shake.T]).T
    )
    accel = tilt.inv().apply(force) + 0.02 * random.normal(size=3)
    accel += 0.01 * random.normal(size=accel.shape)
    # a roll, in lulls every twenty seconds
    t = np.arange(len(rate)) / RATE
    roll = sways * np.abs(np.sin(np.pi * t / 20.0)) ** 3 * np.sin(2.0 * np.pi * t / 7.0)
    gyro += tilt.inv().apply(np.outer(np.gradient(roll, t), [1.0, 0.0, 0.0]))
    accel += tilt.inv().apply(np.outer(roll, [0.0, G, 0.0]))
    return imu_log(path, even_times(len(rate), RATE), gyro, accel), heading


def drift(tmp_path, seed, *phases, **sensors):
    """Change of the heading's error from begin to end, its sigma, rad, and kinds of findings."""
    path, heading = creeping(tmp_path / "in.mcap", seed, *phases, **sensors)
    summary = run(path, tmp_path / "out.mcap", input={"gyro_kind": "mean-rate"})
    q = Rotation.from_quat(read_attitude(tmp_path / "out.mcap")[1])
    yaw = np.unwrap(q.as_euler("ZYX")[[0, -1], 0])
    off = (yaw[1] - yaw[0] - heading[-1] + np.pi) % (2.0 * np.pi) - np.pi
    sigma = np.radians(summary["smoothing"]["heading_sigma_end_deg"])
    return off, sigma, [one["kind"] for one in summary["findings"]]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    "phases",
    [
        ((120.0, 0.3),),
        ((60.0, 0.3), (60.0, -0.3)),
        ((30.0, 0.3), (40.0, 0.1), (30.0, -0.2), (40.0, 0.5)),
    ],
)
def test_an_even_turn_is_in_the_sigma_of_heading(tmp_path, seed, phases):
    """36 deg off at a stated 0.24 deg: the turn was taken for the bias, without a word."""
    off, sigma, kinds = drift(tmp_path, seed, *phases)
    assert abs(off) < 3.0 * sigma
    assert "steady-rate" in kinds


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("phases", [((20.0, 0.0), (100.0, 0.3)), ((100.0, 0.3), (20.0, 0.0))])
def test_a_rest_beside_it_shows_that_it_turns(tmp_path, seed, phases):
    off, sigma, _ = drift(tmp_path, seed, *phases)
    assert abs(off) < np.radians(1.0) and abs(off) < 3.0 * sigma


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("bias", "turn"), [(300.0, -0.45), (300.0, 1.0), (1500.0, 0.6)])
def test_a_train_in_an_even_bend_that_is_longer_than_the_straight(tmp_path, seed, bias, turn):
    """Off by 58 deg at a stated 2.5 deg: the rate of the bend was taken for the bias."""
    phases = ((22.0, 0.0), (60.0, turn), (15.0, 0.0))
    off, sigma, _ = drift(tmp_path, seed, *phases, bias=bias, speed=20.0, wobble=1e-2)
    assert abs(off) < 3.0 * sigma


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("bias", "sways"), [(300.0, 0.01), (300.0, 0.06), (1500.0, 0.03)])
def test_a_ship_that_drifts_round_in_a_calm_sea(tmp_path, seed, bias, sways):
    """All lulls of its sway show the rate of the turn: it was off by 30 deg at a stated 1 to 4."""
    off, sigma, _ = drift(
        tmp_path, seed, (120.0, 0.25), bias=bias, speed=1.0, wobble=3e-3, sways=sways
    )
    assert abs(off) < 3.0 * sigma


@pytest.mark.slow
@pytest.mark.parametrize("bias", [5.0, 600.0])
def test_biases_in_any_direction_are_biases(tmp_path, bias):
    """Of resting logs no more than a few in a hundred look like an even turn."""
    found = [drift(tmp_path / str(k), k, (40.0, 0.0), bias=bias) for k in made(tmp_path, 6)]
    assert all(abs(off) < 4.0 * sigma for off, sigma, _ in found)
    assert sum("steady-rate" in kinds for _, _, kinds in found) <= 1
    assert np.median([sigma for _, sigma, _ in found]) < np.radians(0.3)


def made(folder, count):
    """Numbers, each with a folder of its own."""
    for k in range(count):
        (folder / str(k)).mkdir()
        yield k
