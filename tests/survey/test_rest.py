"""Rest is what the IMU says, unless fixes around it move."""

import dataclasses

import numpy as np
import pytest

from sinstool.core.units import DEGREE
from sinstool.methods.alignment.still import StillSpan, WindowStage
from sinstool.survey.rest import (
    calmer,
    longest_rest,
    moving_at,
    rest_end,
    settled,
    shaken_rest,
)
from tests.helpers.gnss import straight

SECOND = 10**9
RADIUS = 6.37e6


@pytest.mark.parametrize("speed, moves", [(60.0, True), (10.0, True), (0.0, False)])
def test_a_span_without_fixes_is_judged_by_those_around_it(speed, moves):
    """A steady turn in an outage was taken for a rest, its rate of 2 deg/s for the gyro's bias."""
    gnss = straight(np.arange(0, 300) * SECOND, speed)
    silent = gnss.rows((gnss.time_ns < 100 * SECOND) | (gnss.time_ns > 200 * SECOND))
    for fixes in (gnss, silent, gnss.rows(gnss.time_ns < 100 * SECOND)):
        shown = moving_at(fixes, 120 * SECOND, 150 * SECOND)
        assert (shown is not None) == moves
        assert shown is None or shown == pytest.approx(speed, rel=0.05)


def test_a_rest_within_an_outage_between_two_drives():
    """In and out of a garage: where the fixes come back is where they went."""
    away = np.concatenate([np.arange(-600.0, 0.0, 10.0), np.arange(0.0, 600.0, 10.0)])
    time_ns = np.concatenate([np.arange(0, 60), np.arange(400, 460)]) * SECOND
    assert moving_at(straight(time_ns, away=away), 100 * SECOND, 350 * SECOND) is None


def test_a_rest_minutes_after_the_last_fix_is_not_refuted():
    """A run that needs GNSS only where the log begins has read no more of it."""
    driving = straight(np.arange(0, 130) * SECOND, 10.0)
    assert moving_at(driving, 140 * SECOND, 240 * SECOND) is not None
    assert moving_at(driving, 390 * SECOND, 490 * SECOND) is None
    late = driving.rows(driving.time_ns > 120 * SECOND)
    assert moving_at(late, 0, 30 * SECOND) is None


@pytest.mark.parametrize("rate", [5, 20])
def test_wild_velocities_do_not_move_a_vehicle_at_rest(rate):
    """One in twelve is off by tens of m/s; the others say 5 cm/s."""
    random = np.random.default_rng(rate)
    gnss = straight(np.arange(0, 6 * rate) * (SECOND // rate), 0.0)
    wild = np.where(random.random((len(gnss), 1)) < 0.08, 40.0, 0.05)
    noise = wild * random.standard_normal((len(gnss), 3))
    resting = dataclasses.replace(gnss, velocity_n=noise)
    assert moving_at(resting, 0, 6 * SECOND) is None
    driving = dataclasses.replace(gnss, velocity_n=noise + np.array([3.0, 4.0, 0.0]))
    assert moving_at(driving, 0, 6 * SECOND) == pytest.approx(5.0, abs=0.2)


def circling(radius, speed, *, with_velocity):
    """A vehicle in a steady circle, a fix a second for five minutes."""
    t = np.arange(0.0, 300.0)
    turn = speed / radius * t
    gnss = straight((t * SECOND).astype(np.int64), 0.0)
    north, east = radius * np.sin(turn), -radius * np.cos(turn)
    velocity = speed * np.stack([np.cos(turn), np.sin(turn), np.zeros_like(t)], axis=1)
    return dataclasses.replace(
        gnss,
        latitude=gnss.latitude + north / RADIUS,
        longitude=gnss.longitude + east / RADIUS / np.cos(gnss.latitude),
        velocity_n=velocity if with_velocity else np.full((len(t), 3), np.nan),
    )


@pytest.mark.parametrize("with_velocity", [True, False])
def test_a_steady_circle_is_no_rest_and_keeps_its_fixes(with_velocity):
    """To an IMU it is a rest, and in the mean its velocity is none: no fix was left of the log."""
    gnss = circling(60.0, 10.0, with_velocity=with_velocity)
    assert moving_at(gnss, 0, 300 * SECOND) == pytest.approx(10.0, rel=0.2)
    kept, findings = settled(gnss, 0, 300 * SECOND)
    assert len(kept) == len(gnss) and not findings


@pytest.mark.parametrize("rate", [1.0, 10.0])
def test_the_farthest_of_many_fixes_is_no_sign_of_a_receiver_that_has_not_settled(rate):
    """Of 2000 fixes with white noise one in two sets has one beyond four sigmas."""
    told = 0
    time_ns = (np.arange(200.0 * rate) * 1e9 / rate).astype(np.int64)
    for seed in range(100):
        random = np.random.default_rng(seed)
        gnss = straight(time_ns, away=5.0 * random.standard_normal(len(time_ns)))
        east = 5.0 * random.standard_normal(len(time_ns)) / (6.37e6 * np.cos(0.8))
        gnss = dataclasses.replace(
            gnss, longitude=east, sigma_position_n=np.full((len(time_ns), 3), 5.0)
        )
        told += bool(settled(gnss, 0, int(time_ns[-1]))[1])
    assert told <= 5


@pytest.mark.parametrize(
    ("speed", "sigma"), [(0.7, 0.05), (1.4, 0.05), (3.0, 0.05), (1.4, 2.0), (3.0, 2.0)]
)
def test_what_a_receiver_says_until_it_has_settled_is_left_out(speed, sigma):
    """Its last metres are slow, and its first fixes may be older than the first sample."""
    time_ns = np.arange(0, 200 * SECOND, SECOND // 5)
    coming = np.maximum(30.0 - time_ns / SECOND, 0.0) * speed
    for seed in range(10):
        noise = sigma * np.random.default_rng(seed).standard_normal(len(time_ns))
        gnss = straight(time_ns, away=coming + noise)
        gnss = dataclasses.replace(gnss, sigma_position_n=np.full((len(time_ns), 3), sigma))
        kept, findings = settled(gnss, 8 * SECOND, int(time_ns[-1]))
        assert len(findings) == 1
        off = speed * np.maximum(30.0 - kept.time_ns / SECOND, 0.0)
        assert off.max() < max(3.0 * sigma, 0.2), (seed, kept.time_ns[0] / SECOND)
        assert kept.time_ns[0] < 60 * SECOND


def shaken(seed, parked=60.0, rock=0.0, rate=100.0):
    """An IMU that an engine shakes, parked and then driven off: its windows and its fixes.

    Parameters
    ----------
    rock : float
        The vehicle rolls by so much, rad, as a boat does.
    """
    random = np.random.default_rng(seed)
    t = np.arange(0.0, parked + 20.0, 1.0 / rate)
    ahead = np.where(t > parked, 1.5, 0.0)
    roll = rock * np.sin(t)
    gyro = np.stack([rock * np.cos(t) + 0.02, 0.0 * t - 0.01, 0.0 * t + 0.005], axis=1)
    accel = np.stack([ahead, -9.81 * np.sin(roll), -9.81 * np.cos(roll)], axis=1)
    gyro += 0.04 * random.standard_normal(gyro.shape)
    accel += 2.0 * random.standard_normal(accel.shape)
    stage = WindowStage()
    stage.push(np.round(t * SECOND).astype(np.int64), gyro, accel)
    seconds = np.arange(0.2, t[-1], 0.5)
    moving = np.maximum(seconds - parked, 0.0)
    gnss = straight(np.round(seconds * SECOND).astype(np.int64), away=0.75 * moving**2)
    return stage.finish(), gnss, 1.5 * moving


def with_speed(gnss, speed, sigma):
    velocity = np.stack([speed, 0.0 * speed, 0.0 * speed], axis=1)
    random = np.random.default_rng(7)
    return dataclasses.replace(
        gnss,
        velocity_n=velocity + sigma * random.standard_normal(velocity.shape),
        sigma_velocity_n=np.full_like(velocity, sigma),
    )


@pytest.mark.parametrize("with_velocity", [True, False])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_engine_shakes_a_parked_vehicle(seed, with_velocity):
    """Two minutes of rest were aligned from the motion behind, 24 deg off at the beginning."""
    windows, gnss, speed = shaken(seed)
    gnss = with_speed(gnss, speed, 0.1) if with_velocity else gnss
    rest = shaken_rest(windows, gnss, 0)
    assert rest is not None and rest.start_ns == 0 and 40.0 < rest.duration_s <= 60.0
    assert rest.gyro == pytest.approx([0.02, -0.01, 0.005], abs=0.003)
    assert rest.accel == pytest.approx([0.0, 0.0, -9.81], abs=0.15)


def test_what_is_shaken_and_no_rest():
    windows, gnss, speed = shaken(1)
    # A ferry, which shakes as much and goes on
    away = 0.8 * gnss.time_ns / SECOND
    assert shaken_rest(windows, straight(gnss.time_ns, away=away), 0) is None
    assert shaken_rest(windows, with_speed(gnss, speed + 0.8, 0.05), 0) is None
    # A receiver that says where it is only later
    assert shaken_rest(windows, gnss.rows(gnss.time_ns > 20 * SECOND), 0) is None
    assert shaken_rest(windows, gnss.rows(slice(0, 3)), 0) is None
    # A boat at its mooring rolls, and a multicopter that hovers moves as fast
    t = np.arange(0.0, 80.0, 0.01)
    random = np.random.default_rng(5)
    slow = np.cumsum(random.standard_normal((len(t), 6)), axis=0)
    slow = slow[5:] - slow[:-5]  # up to some Hz
    stage = WindowStage()
    still = np.array([0.0, 0.0, -9.81])
    stage.push(
        np.round(t[5:] * SECOND).astype(np.int64), 0.1 * slow[:, :3], still + 0.3 * slow[:, 3:]
    )
    assert shaken_rest(stage.finish(), gnss, 0) is None
    windows, gnss, _ = shaken(1, rock=0.06)
    assert shaken_rest(windows, gnss, 0) is None


def quiet(begin_s, seconds, rate_deg_s):
    rate = np.array([0.0, 0.0, rate_deg_s * DEGREE])
    start, end = round(begin_s * 1e9), round((begin_s + seconds) * 1e9)
    force = np.array([0.0, 0.0, -9.8])
    return StillSpan(start, end, 100 * round(seconds), rate, force, 2e-3, 2e-2)


@pytest.mark.parametrize(
    "spans, chosen",
    [
        ([(0.0, 20.0, 0.3), (30.0, 5.0, 0.1)], 0),  # a bias that drifts
        ([(0.0, 20.0, 15.0), (30.0, 2.5, 0.1)], 1),  # a turn, and a stop
        ([(0.0, 20.0, 15.0), (30.0, 1.5, 0.1)], 0),  # too short to say so
        ([(0.0, 9.0, 8.0), (20.0, 4.0, -15.0), (30.0, 3.0, 0.3), (40.0, 5.0, -0.4)], 3),
        ([(0.0, 20.0, 5.0), (30.0, 10.0, 4.2)], 0),  # a chip that is not calibrated
    ],
)
def test_of_two_rates_the_smaller_is_the_bias(spans, chosen):
    made = [quiet(*span) for span in spans]
    assert longest_rest(made, None) is made[chosen]
    assert not calmer(made, made[chosen])


def two_rests(seed, speed, moving_s, *, bias=0.0):
    """The windows of an IMU that rests, is accelerated to a speed and stopped again, and rests."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, 80.0, 0.01)
    ramp_s = 0.25 * moving_s
    goes = (
        (t > 30.0) & (t <= 30.0 + ramp_s),
        (t > 30.0 + moving_s - ramp_s) & (t <= 30.0 + moving_s),
    )
    along = speed / ramp_s * (goes[0].astype(float) - goes[1]) + bias * (t > 30.0)
    gyro = 0.001 * random.standard_normal((len(t), 3)) + [0.01, 0.0, -0.01]
    accel = 0.02 * random.standard_normal((len(t), 3)) + [0.2, 0.1, -9.81]
    accel += along[:, None] * [0.8, 0.6, 0.0]
    stage = WindowStage()
    stage.push(np.round(t * SECOND).astype(np.int64), gyro, accel)
    rate, force = np.array([0.01, 0.0, -0.01]), np.array([0.2, 0.1, -9.81])
    first = StillSpan(0, 30 * SECOND, 3000, rate, force, 2e-3, 2e-2)
    later = StillSpan(55 * SECOND, 80 * SECOND, 2500, rate, force, 2e-3, 2e-2)
    return stage.finish(), first, later


@pytest.mark.parametrize("seed", range(5))
def test_a_vehicle_that_goes_straight_on_from_rest_to_rest_is_not_knocked(seed):
    """Fixes from before it were left out as those of a receiver that had not settled: 80 m off."""
    for speed, moving_s in ((3.0, 8.0), (10.0, 20.0), (0.5, 15.0), (-6.0, 12.0)):
        windows, first, later = two_rests(seed, speed, moving_s)
        assert rest_end(first, (first, later), windows) == first.end_ns
    for speed, moving_s in ((0.4, 1.0), (0.0, 4.0), (-0.2, 3.0)):  # knocks, with a drift of bias
        windows, first, later = two_rests(seed, speed, moving_s, bias=0.01)
        assert rest_end(first, (first, later), windows) == later.end_ns
