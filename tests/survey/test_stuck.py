"""A receiver that sends its last fix again: left out where it hangs, kept where it rests."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sinstool.config import InputOptions
from sinstool.core.earth import displaced
from sinstool.core.streams import Gnss, Velocity
from sinstool.io.readers import open_log
from sinstool.survey.gnss import read_gnss
from sinstool.survey.stuck import (
    LEAP_STEPS,
    LEAST_ALIKE,
    sent_again,
    stale_velocities,
    stuck_fixes,
    stuck_velocities,
)
from tests.helpers.imulogs import T0
from tests.helpers.unseen_drives import PERFECT, drive, every, frozen, record, write


def track(east, rate=5.0, sigma=0.5):
    """Fixes that are so far east, m."""
    n = len(east)
    times = T0 + np.round(np.arange(n) / rate * 1e9).astype(np.int64)
    latitude, longitude = displaced(0.8, 0.2, 100.0, np.zeros(n), np.asarray(east, float))
    covariance = np.tile(sigma**2 * np.eye(3), (n, 1, 1))
    return Gnss(times, times, latitude, longitude, np.full(n, 100.0), covariance,
                np.full(n, 2), np.zeros(n, int))  # fmt: skip


def noisy(east, seed, sigma=0.5):
    return np.asarray(east) + sigma * np.random.default_rng(seed).standard_normal(len(east))


@settings(max_examples=60, deadline=None)
@given(
    speed=st.floats(1.0, 60.0),
    rate=st.sampled_from([1.0, 5.0, 10.0]),
    begin=st.integers(5, 60),
    count=st.integers(LEAST_ALIKE, 60),
    seed=st.integers(0, 99),
)
def test_what_is_sent_again_on_the_way_is_found_and_nothing_else(speed, rate, begin, count, seed):
    east = noisy(speed / rate * np.arange(140), seed, 0.05)
    east[begin : begin + count] = east[begin]
    stuck = stuck_fixes(track(east, rate, 0.05))
    # Too short a leap for one who moves on so slowly is left to the filter
    if speed / rate * (count - LEAP_STEPS) > 1.0:
        assert np.array_equal(np.flatnonzero(stuck), np.arange(begin + 1, begin + count))
    else:
        assert set(np.flatnonzero(stuck)) <= set(range(begin + 1, begin + count))


def test_a_receiver_that_holds_its_position_at_rest_is_not_stuck():
    way = np.concatenate([np.zeros(200), 0.5 * 1.0 * (0.2 * np.arange(100)) ** 2])
    assert not stuck_fixes(track(way)).any()
    # It lets go of what it holds by a few sigmas
    way[200:] += 2.0
    assert not stuck_fixes(track(way)).any()


@pytest.mark.parametrize("seed", range(5))
def test_one_that_hangs_for_long_while_its_vehicle_goes_to_and_fro_leaps_far(seed):
    """A digger that ends 8 m from where its receiver hung for 42 s: 0.2 m/s in the mean."""
    way = noisy(
        np.concatenate([0.5 * np.arange(100), np.full(42, 50.0), 58.0 + np.zeros(60)]), seed, 0.05
    )
    way[100:142] = way[100]
    assert np.array_equal(np.flatnonzero(stuck_fixes(track(way, 1.0, 0.05))), np.arange(101, 142))
    # For a receiver of a metre this may be rest
    way = noisy(
        np.concatenate([0.5 * np.arange(100), np.full(42, 50.0), 58.0 + np.zeros(60)]), seed
    )
    way[100:142] = way[100]
    assert not stuck_fixes(track(way, 1.0, 1.0)).any()


def test_one_that_hangs_while_its_height_goes_on_is_stuck():
    way = noisy(
        np.concatenate([2.0 * np.arange(100), np.full(80, 200.0), 280.0 + np.arange(60)]), 1
    )
    way[100:180] = way[100]
    fixes = track(way)
    height = fixes.height + np.where(np.arange(len(way)) < 140, 0.0, 3.0)
    stuck = stuck_fixes(replace(fixes, height=height))
    assert np.array_equal(np.flatnonzero(stuck), np.arange(101, 180))


def test_alike_up_to_the_end_is_rest():
    way = np.concatenate([noisy(10.0 * np.arange(50), 1), np.full(50, 500.0)])
    assert not stuck_fixes(track(way)).any()


def test_a_slow_receiver_sent_on_quickly_leaves_one_of_each():
    way = np.repeat(noisy(20.0 * np.arange(30), 2, 0.1), 10)
    fixes = track(way, rate=10.0, sigma=0.1)
    kept = ~stuck_fixes(fixes)
    assert np.count_nonzero(kept[:-10]) == 29 and kept[:-10][::10].all()


@pytest.mark.parametrize("rates", [(10.0, 1.0), (10.0, 4.0), (10.0, 8.0), (50.0, 5.0), (2.0, 1.0)])
@pytest.mark.parametrize("seed", range(5))
def test_one_is_left_of_each_fix_that_a_faster_driver_sends_again(rates, seed):
    """At rest as well: there no leap shows that the fixes between are none."""
    sent, measured = rates
    jitter = np.random.default_rng(seed).uniform(0.0, 0.3 / sent, 1000)
    number = np.floor((np.arange(1000) / sent + jitter) * measured).astype(int)
    t = np.arange(number[-1] + 1) / measured
    way = noisy(10.0 * np.maximum(t - t[-1] / 2, 0.0), seed)
    again, times = sent_again(track(way[number], sent))
    new = np.append(True, np.diff(number) > 0)
    assert not again[new].any() and np.count_nonzero(~again) <= 1.05 * np.count_nonzero(new)
    assert times == pytest.approx(sent / measured, rel=0.05)


@pytest.mark.parametrize("seed", range(5))
def test_fixes_that_are_alike_by_chance_are_not_sent_again(seed):
    assert not sent_again(track(noisy(np.zeros(500), seed)))[0].any()
    # held at rest, in a drive with some stops
    way = noisy(5.0 * np.arange(600), seed)
    for begin in range(0, 600, 100):
        way[begin : begin + 50] = way[begin]
    assert not sent_again(track(way))[0].any()
    # rounded to so many metres, at rest and on the way
    way = np.append(noisy(np.zeros(200), seed, 0.05), noisy(10.0 * np.arange(200), seed, 0.05))
    assert not sent_again(track(0.2 * np.round(way / 0.2)))[0].any()


def test_heights_that_are_missing_are_alike():
    way = noisy(10.0 * np.arange(60), 3)
    way[20:30] = way[20]
    fixes = replace(track(way), height=np.full(60, np.nan))
    assert np.count_nonzero(stuck_fixes(fixes)) == 9


def test_velocities_go_with_the_fixes_they_hang_with():
    way = noisy(10.0 * np.arange(60), 4)
    way[20:30] = way[20]
    fixes = track(way)
    speed = np.stack([np.zeros(60), noisy(np.full(60, 10.0), 5), np.zeros(60)], axis=1)
    speed[20:25, :2] = speed[20, :2]
    speed[22:, 2] = 0.5  # its vertical part may be another receiver's
    velocity = Velocity(fixes.time_ns, fixes.log_time_ns, speed, np.zeros((60, 3, 3)))
    gone = stuck_velocities(fixes, stuck_fixes(fixes), velocity)
    assert np.array_equal(np.flatnonzero(gone), np.arange(21, 25))


@pytest.mark.parametrize("hung", [True, False])
def test_it_is_said_how_long_a_receiver_hangs(tmp_path, hung):
    truth = drive(41, 120.0, rest=20.0)
    data = record(truth, PERFECT, 41, gnss_rate=5.0, sigma=0.05)
    data = frozen(data, 60.0, 15.0) if hung else data
    with open_log(write(tmp_path / "log.mcap", data)) as log:
        aiding = read_gnss(log, InputOptions(), False)
    findings = [f for f in aiding.findings if f.kind == "stuck-fixes"]
    assert len(findings) == hung
    if hung:
        assert 10.0 < findings[0].numbers["seconds"] < 15.1
        assert "hangs for" in findings[0].text
        gap = np.diff(aiding.gnss.time_ns) * 1e-9
        assert gap.max() == pytest.approx(findings[0].numbers["seconds"] + 0.2, abs=0.05)


def test_a_velocity_is_not_denied_by_fixes_that_hang(tmp_path):
    """Left out before: while the fixes stand still ten ways of a hundred metres are off by all."""
    truth = drive(41, 150.0, rest=20.0)
    data = record(truth, PERFECT, 41, gnss_rate=5.0, sigma=0.05, sigma_v=0.05)
    data = frozen(data, 40.0, 70.0)
    with open_log(write(tmp_path / "log.mcap", data)) as log:
        aiding = read_gnss(log, InputOptions(), False)
    assert "stuck-fixes" in {finding.kind for finding in aiding.findings}
    assert aiding.velocity_topic and aiding.gnss.has_velocity.any()
    assert "velocity-left-out" not in {finding.kind for finding in aiding.findings}


def test_fixes_that_stand_to_the_end_while_the_velocity_goes_on(tmp_path):
    """A ZeroDivisionError before, where most ways by fixes are zero."""
    data = record(drive(41, 150.0, rest=20.0), PERFECT, 41, gnss_rate=5.0, sigma_v=0.05)
    data = frozen(data, 40.0, 200.0)
    with open_log(write(tmp_path / "log.mcap", data)) as log:
        aiding = read_gnss(log, InputOptions(), False)
    assert "velocity-left-out" in {finding.kind for finding in aiding.findings}


def test_velocities_that_are_sent_again_go_with_their_fixes(tmp_path):
    truth = drive(41, 120.0, rest=20.0)
    data = record(truth, PERFECT, 41, gnss_rate=10.0, sigma=1.0, sigma_v=0.05)
    data = every(data, 10)
    with open_log(write(tmp_path / "log.mcap", data)) as log:
        aiding = read_gnss(log, InputOptions(), False)
    assert len(aiding.gnss) == pytest.approx(120, abs=3)
    assert aiding.gnss.has_position.all() and aiding.gnss.has_velocity.all()
    (finding,) = (f for f in aiding.findings if f.kind == "sent-again")
    assert "sends each 10 times" in finding.text and finding.severity.name == "NOTE"


def velocities(fixes, east, seed, noise=0.05):
    """Those of fixes that are so far east, with noise."""
    n = len(east)
    rate = np.gradient(east, fixes.time_ns * 1e-9)
    v = np.stack([np.zeros(n), rate, np.zeros(n)], axis=1)
    v += noise * np.random.default_rng(seed).standard_normal((n, 3))
    return Velocity(fixes.time_ns, fixes.log_time_ns, v, np.zeros((n, 3, 3)))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("zero", [False, True])
def test_a_velocity_that_stays_while_the_fixes_move_on_is_stale(seed, zero):
    speed = 10.0 + 5.0 * np.sin(0.1 * np.arange(300))
    east = np.cumsum(speed)
    fixes = track(noisy(east, seed), rate=1.0)
    velocity = velocities(fixes, east, seed)
    v = velocity.velocity_n
    v[100:160] = 0.0 if zero else v[100] * [1.0, 1.5, 1.0]
    v[250:] = 0.0  # to the end
    found = np.flatnonzero(stale_velocities(fixes, velocity))
    assert found.tolist() == [*range(101 - zero, 160), *range(250, 300)]


@pytest.mark.parametrize("seed", range(5))
def test_a_velocity_that_stays_as_the_fixes_say_is_right(seed):
    """Zero at rest beside a fix that is bad; and rounded to 0.1 m/s on a steady way."""
    east = np.concatenate([np.zeros(150), 8.0 * np.arange(150)])
    places = noisy(east, seed)
    places[[50, 51]] += 200.0
    fixes = track(places, rate=1.0)
    velocity = velocities(fixes, east, seed, noise=0.02)
    velocity.velocity_n[:148] = 0.0
    velocity.velocity_n[:] = np.round(velocity.velocity_n, 1)
    assert not stale_velocities(fixes, velocity).any()


@pytest.mark.parametrize("seed", range(3))
def test_a_slow_robot_whose_receiver_has_no_velocity_is_not_held_to_stand(seed):
    """Of a hundred metres, by which a velocity is denied otherwise, there is none here."""
    random = np.random.default_rng(seed)
    east = np.concatenate([np.zeros(20), np.cumsum(0.7 + 0.3 * random.random(60))])
    fixes = track(east + 0.5 * random.standard_normal(80), rate=1.0)
    velocity = velocities(fixes, east, seed)
    velocity.velocity_n[:] = 0.0
    assert stale_velocities(fixes, velocity).all()
