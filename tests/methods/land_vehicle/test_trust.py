"""Whether a vehicle slides, by tracks made for it."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.core import rotation
from sinstool.methods.land_vehicle import trust as trusting
from sinstool.methods.land_vehicle.track import Means, Track
from sinstool.methods.land_vehicle.trust import find_trust

MOUNT = rotation.to_dcm(rotation.from_euler(np.radians([3.0, 60.0, 170.0])))  # C_vb
G = 9.81


def slow(random, n, sigma, time, step=0.1):
    """A Gauss-Markov process."""
    decay = np.exp(-step / time)
    out = np.zeros(n)
    noise = sigma * np.sqrt(1.0 - decay**2) * random.standard_normal(n)
    for k in range(1, n):
        out[k] = decay * out[k - 1] + noise[k]
    return out


def a_track(
    seed=0,
    slip=0.05,
    axle=1.7,
    own=0.03,
    minutes=8.0,
    heading_walk=False,
    mount=MOUNT,
    turns=1.0,
    felt=1.0,
    corners=False,
):
    """A vehicle with turns: its axle moves forward but for a slow slip.

    What turns take is felt sideways by this share, beside a road whose camber changes. With
    `corners` it goes straight at 16 m/s, and turns at 4 m/s only.
    """
    random = np.random.default_rng(seed)
    n = round(600 * minutes)
    t = 0.1 * np.arange(n)
    speed = 10.0 + 5.0 * np.sin(0.05 * t)
    rate = turns * 0.25 * np.sin(0.11 * t) * (np.sin(0.013 * t) > 0.0)
    if corners:
        at_one = np.clip(2.0 * np.sin(2.0 * np.pi * t / 60.0) - 0.5, 0.0, 1.0)
        speed = 16.0 - 12.0 * at_one
        rate = turns * 0.25 * (at_one == 1.0) * np.where(t % 120.0 < 60.0, 1.0, -1.0)
    heading = np.cumsum(rate) * 0.1
    v_v = np.stack([speed, rate * axle + slow(random, n, slip, 3.0), slow(random, n, 0.03, 3.0)], 1)
    q_nv = rotation.from_euler(np.stack([0 * t, 0 * t, heading], axis=1))
    if heading_walk:  # goes anywhere in its own body
        turn = slow(random, n, 1.2, 5.0)
        v_v = speed[:, None] * np.stack([np.cos(turn), np.sin(turn), 0 * t], axis=1)
    v_n = rotation.rotate(q_nv, v_v) + own * random.standard_normal((n, 3))
    omega = np.stack([0 * t, 0 * t, rate], axis=1)
    felt = felt * speed * rate + slow(random, n, 0.2, 4.0)
    force = np.stack([np.gradient(speed, 0.1), felt, np.full(n, -G)], axis=1)
    means = Means(0, omega @ mount, force @ mount)
    covariance = np.zeros((n, 6, 6)) + np.diag([own**2] * 3 + [1e-8] * 3)
    rows = slice(None, None, 2)
    track = Track(
        means.time_ns[rows], v_n[rows], (rotation.to_dcm(q_nv) @ mount)[rows], covariance[rows]
    )
    return means, track


@pytest.mark.parametrize("seed", range(3))
def test_a_car_is_found_with_its_mount_and_its_axle(seed):
    trust = find_trust(*a_track(seed))
    assert trust.holds, trust.reason
    off = rotation.log(rotation.from_dcm(trust.vehicle.c_vb @ MOUNT.T))
    assert np.degrees(np.linalg.norm(off)) < 2.0
    assert trust.vehicle.axle == pytest.approx(1.7, abs=0.2)
    # 0.05 m/s over 3 s: sqrt(2 tau) sigma
    assert 0.08 < trust.vehicle.lateral < 0.25
    assert trust.rolls.mean() > 0.9


@pytest.mark.parametrize("seed", range(3))
def test_a_car_that_turns_slowly_is_found(seed):
    """A lever of 132 m, or that it turns too little to tell, was the answer."""
    trust = find_trust(*a_track(seed, corners=True))
    assert trust.holds, trust.reason
    assert trust.vehicle.axle == pytest.approx(1.7, abs=0.4)


@pytest.mark.parametrize("seed", range(3))
def test_a_lever_that_no_turn_shows_is_none(seed):
    trust = find_trust(*a_track(seed, turns=1e-3))
    assert not trust.holds and "turns too little" in trust.reason
    assert abs(trust.vehicle.axle) < 3.0


def test_slip_makes_the_constraint_weaker():
    sigmas = [find_trust(*a_track(1, slip=slip)).vehicle.lateral for slip in (0.02, 0.1, 0.2)]
    assert sigmas[0] < sigmas[1] < sigmas[2]
    assert sigmas[2] == pytest.approx(0.2 * np.sqrt(6.0), rel=0.5)


def test_a_walk_is_no_vehicle():
    trust = find_trust(*a_track(0, heading_walk=True))
    assert not trust.holds


def test_a_boat_that_drifts_is_no_vehicle():
    trust = find_trust(*a_track(0, slip=0.8))
    assert not trust.holds and "sideways" in trust.reason


def test_a_ferry_is_left_out_or_denies_the_whole():
    means, track = a_track(0, minutes=12.0)
    velocity = track.velocity_n.copy()
    aboard = slice(1000, 1080)
    c_nv = track.dcm_nb[aboard] @ MOUNT.T
    velocity[aboard] += 3.0 * c_nv[:, :, 1]
    trust = find_trust(means, Track(track.time_ns, velocity, track.dcm_nb, track.covariance))
    on = slice(2000, 2160)
    assert not trust.holds or not trust.rolls[on].any()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "turns, felt, said",
    [
        (0.1, 1.0, ""),  # 0.12 m/s^2, less than what the camber of the road does
        (0.1, 0.0, "leans"),
        (1.0, 0.0, "leans"),
        (0.01, 1.0, "too little"),
    ],
)
def test_gentle_turns_show_what_it_is(turns, felt, said, seed):
    trust = find_trust(*a_track(seed, turns=turns, felt=felt, minutes=12.0))
    assert trust.holds == (said == "")
    assert said in trust.reason


def test_too_little_motion_says_so():
    means, track = a_track(0, minutes=0.3)
    trust = find_trust(means, track)
    assert not trust.holds and trust.vehicle is None and "too little" in trust.reason


@pytest.mark.parametrize("roll, holds", [(3.0, True), (10.0, False), (180.0, False)])
def test_a_mount_stated_with_another_roll_is_denied_by_gravity(roll, holds):
    means, track = a_track(4)
    stated = rotation.to_dcm(rotation.from_euler(np.radians([roll, 0.0, 0.0]))) @ MOUNT
    trust = find_trust(means, track, stated)
    assert trust.holds == holds
    assert ("gravity" in trust.reason) == (not holds)


@pytest.mark.parametrize(
    "weaves, said", [(0.0, "too little"), (0.1, "")], ids=["a circle", "a weaving one"]
)
def test_a_steady_circle_does_not_show_what_leans(weaves, said):
    """What it takes is all mean, what is left the error of velocity, and that is never felt."""
    random = np.random.default_rng(3)
    n = 3000
    t = 0.1 * np.arange(n)
    rate = 0.3 + weaves * np.sin(0.4 * t)
    velocity = np.stack([10.0 + 0.05 * random.standard_normal(n), 0.0 * t, 0.0 * t], axis=1)
    turn = np.stack([0.0 * t, 0.0 * t, rate], axis=1)
    rows = SimpleNamespace(
        time=t, velocity=velocity, rate=turn, right=10.0 * rate + 0.02 * random.standard_normal(n)
    )
    assert said in trusting._leans(rows, np.ones(n, bool))
    assert bool(said) == bool(trusting._leans(rows, np.ones(n, bool)))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("turned", [20.0, 60.0, 90.0, 120.0])
def test_a_mount_that_is_turned_is_said_to_be_by_its_angle(seed, turned):
    """Thousands of degrees were said for 90."""
    wrong = rotation.to_dcm(rotation.from_euler(np.radians([0.0, 0.0, turned]))) @ MOUNT
    trust = find_trust(*a_track(seed), c_vb=wrong)
    said = re.fullmatch(r"it moves (\d+) deg off the forward axis of the mount", trust.reason)
    assert not trust.holds and said
    assert float(said[1]) == pytest.approx(turned, abs=2.0)
