"""The first fixes after an outage, held against those that follow."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sinstool.core.earth import displaced
from sinstool.core.streams import GnssEpochs
from sinstool.methods.ins_gnss.returning_fixes import lasting, leaps, unsettled
from tests.helpers.filter_logs import run
from tests.helpers.quick import mostly_slow
from tests.helpers.unseen_drives import LEVER, PHONE, T0, drive, moved, record, without_fixes, write
from tests.pipelines.process.ins_gnss.test_false_fixes import worst

SIGMA = 0.5


def fixes(rate, turn_s, noise, seed, outage=(20.0, 40.0), lasts=80.0):
    """Fixes on a circle at 15 m/s, with an outage; rows of the first two after it."""
    random = np.random.default_rng(seed)
    seconds = np.arange(0.0, lasts, 1.0 / rate)
    seconds = seconds[(seconds < outage[0]) | (seconds >= outage[1])]
    angle = 2.0 * np.pi * seconds / turn_s
    radius = 15.0 * turn_s / (2.0 * np.pi)
    off = radius * np.stack([np.sin(angle), 1.0 - np.cos(angle), 0.0 * angle], axis=1)
    off += noise * random.standard_normal(off.shape)
    n = len(seconds)
    latitude, longitude = displaced(0.8, 0.1, 0.0, off[:, 0], off[:, 1])
    time_ns = np.round(seconds * 1e9).astype(np.int64)
    gnss = GnssEpochs(
        time_ns,
        time_ns,
        latitude,
        longitude,
        -off[:, 2],
        np.full((n, 3), np.nan),
        np.full((n, 3), noise),
        np.full((n, 3), np.nan),
    )
    first = int(np.searchsorted(seconds, outage[1]))
    return gnss, (first, first + 1)


def shifted(gnss, row, metres):
    latitude, longitude = gnss.latitude.copy(), gnss.longitude.copy()
    latitude[row], longitude[row] = displaced(latitude[row], longitude[row], 0.0, *metres)
    return replace(gnss, latitude=latitude, longitude=longitude)


@given(st.sampled_from([1.0, 2.0, 5.0, 10.0]), st.floats(8.0, 200.0), st.integers(0, 2**32))
def test_a_vehicle_that_turns_does_not_leap(rate, turn_s, seed):
    gnss, _ = fixes(rate, turn_s, SIGMA, seed)
    assert not leaps(gnss).any()


@pytest.mark.parametrize("bad", [(0,), (1,), (0, 1)])
@pytest.mark.parametrize("rate", [1.0, 5.0])
@pytest.mark.parametrize("seed", range(5))
def test_bad_fixes_that_come_first_are_as_far_off_as_they_are(rate, bad, seed):
    gnss, first = fixes(rate, 60.0, SIGMA, seed)
    random = np.random.default_rng([seed, 1])
    for k in bad:
        way = random.standard_normal(2)
        gnss = shifted(gnss, first[k], 150.0 * way / np.linalg.norm(way))
    off = leaps(gnss)
    assert np.flatnonzero(off).tolist() == [first[k] for k in bad]
    assert np.allclose(off[off > 0.0], 150.0, atol=15.0)


def test_the_first_fix_of_a_log_comes_after_an_outage():
    gnss, _ = fixes(5.0, 60.0, SIGMA, 1)
    assert np.flatnonzero(leaps(shifted(gnss, 0, (0.0, 80.0)))).tolist() == [0]


@pytest.mark.parametrize("noise", [0.02, 0.2, 3.0])
@pytest.mark.parametrize("seed", range(6))
def test_a_leap_is_far_beyond_the_noise_of_the_log(noise, seed):
    """A fix is usually 3.8 of its sigmas off the line through the next two; the limit is at 15."""
    gnss, (first, _) = fixes(10.0, 1e4, noise, seed)
    assert not leaps(shifted(gnss, first, (30.0 * noise, 0.0))).any()
    far = 90.0 * noise + 0.2
    assert np.flatnonzero(leaps(shifted(gnss, first, (far, 0.0)))).tolist() == [first]


@pytest.mark.parametrize("left", [0, 1, 3])
def test_too_few_fixes_after_an_outage_show_no_leap(left):
    gnss, (first, _) = fixes(5.0, 60.0, SIGMA, 1)
    assert not leaps(shifted(gnss, first, (200.0, 0.0)).rows(slice(0, first + 1 + left))).any()


def test_where_the_next_ones_do_not_agree_nothing_is_said():
    gnss, (first, _) = fixes(5.0, 60.0, SIGMA, 1)
    for k in range(5):
        gnss = shifted(gnss, first + k, (100.0 * (-1.0) ** k, 50.0 * k))
    assert not leaps(gnss).any()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 4])
def test_a_bad_fix_after_an_outage_does_not_throw_the_filter_off(tmp_path, seed):
    """A phone's chip is 100 m uncertain after a minute without fixes: it took one that was 154 m
    off, and turned down all that followed (7 deg at 17 sigmas, status 0)."""
    truth = drive(seed, 200.0, rest=20.0)
    data = record(truth, PHONE, seed, gnss_rate=5.0, sigma=SIGMA)
    data = without_fixes(data, [(90.0, 150.0)])
    log = data.fixes
    row = int(np.searchsorted(log.seconds, 150.0))
    off = np.zeros((len(log.seconds), 3))
    off[row] = 80.0, -60.0, 50.0
    latitude, longitude, height = moved(log.latitude, log.longitude, log.height, off)
    spoilt = replace(log, latitude=latitude, longitude=longitude, height=height)
    path = write(tmp_path / "log.mcap", replace(data, fixes=spoilt))
    arm = {"lever_arm": tuple(LEVER.tolist())}
    chosen, solution = run(path, gnss=arm, input={"gyro_kind": "mean-rate"})
    assert chosen["filter"]["restarts"] == 0
    after = solution.rows((solution.time_ns - T0) * 1e-9 > 151.0)
    most, _ = worst(data, after)
    assert most < 4.5
    told = [f["text"] for f in chosen["findings"] if "after an outage" in f["text"]]
    assert len(told) == 1 and re.search(r"11\d m", told[0])


def coming_in(seed, rate, metres, fade_s, *, stated=1.4, vertical=True):
    """Fixes with an error that wanders; after an outage they come in from so many metres off.

    Returns the fixes, and how far each of them is off by what fades.
    """
    random = np.random.default_rng(seed)
    gnss, (first, _) = fixes(rate, 60.0, 0.4, seed, outage=(120.0, 180.0), lasts=400.0)
    seconds = gnss.time_ns * 1e-9
    angle = 2.0 * np.pi * seconds / 60.0
    velocity = 15.0 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    velocity += 0.08 * random.standard_normal(velocity.shape)
    if not vertical:
        velocity[:, 2] = np.nan
    step = np.diff(seconds, prepend=-1e9)
    error = np.zeros((len(seconds), 3))
    for k, since in enumerate(step):
        keep = np.exp(-since / 120.0)
        error[k] = keep * error[k - 1] + 1.2 * np.sqrt(1.0 - keep**2) * random.standard_normal(3)
    fades = metres * np.exp(-(seconds - seconds[first]) / fade_s) * (seconds >= seconds[first])
    way = random.uniform(0.0, 2.0 * np.pi)
    error[:, :2] += fades[:, None] * [np.cos(way), np.sin(way)]
    latitude, longitude = displaced(gnss.latitude, gnss.longitude, 0.0, error[:, 0], error[:, 1])
    gnss = replace(
        gnss,
        latitude=latitude,
        longitude=longitude,
        height=gnss.height - error[:, 2],
        velocity_n=velocity,
        sigma_position_n=np.full((len(seconds), 3), stated),
    )
    return gnss, fades


@pytest.mark.parametrize("vertical", [True, False])
@pytest.mark.parametrize("rate", [1.0, 5.0])
@pytest.mark.parametrize("seed", range(5))
def test_a_receiver_that_comes_in_is_as_far_off_as_it_is(seed, rate, vertical):
    """A car out of a garage: the first fixes were 60 m off, the filter 7 sigmas, status 0."""
    gnss, fades = coming_in(seed, rate, 50.0, 8.0, vertical=vertical)
    off, seconds = unsettled(gnss), gnss.time_ns * 1e-9
    assert np.all(off[fades > 12.0] > 0.0)
    assert not off[(seconds < 180.0) | (seconds > 245.0)].any()
    told = off > 0.0
    assert np.abs(off[told] - fades[told]).max() < 6.0


def test_an_error_that_wanders_and_one_that_is_stated_are_not_told():
    assert sum(unsettled(coming_in(seed, 1.0, 0.0, 8.0)[0]).any() for seed in range(60)) == 0
    for seed in range(5):
        gnss, fades = coming_in(seed, 1.0, 50.0, 8.0)
        honest = replace(gnss, sigma_position_n=np.hypot(1.4, fades)[:, None] * np.ones(3))
        assert not unsettled(honest).any()


@pytest.mark.parametrize("seed", range(5))
def test_a_bad_fix_among_good_ones_is_not_of_a_receiver_that_comes_in(seed):
    """163 good fixes counted as one that was 39 m off, and a wrong latency was not noticed."""
    gnss, _ = coming_in(seed, 5.0, 0.0, 8.0)
    assert not unsettled(gnss).any()
    (first,) = np.flatnonzero(np.diff(gnss.time_ns, prepend=0) > 50_000_000_000)[-1:]
    latitude = gnss.latitude.copy()
    latitude[[70, first + 80]] += 39.0 / 6.37e6
    assert not unsettled(replace(gnss, latitude=latitude)).any()


@pytest.mark.parametrize("latitude", [-81.0, -74.0, 60.0, 72.0])
@pytest.mark.parametrize("seed", mostly_slow(range(3), 0))
def test_a_jet_that_turns_at_high_latitudes_is_where_it_is(seed, latitude):
    """North turns by degrees in a minute: 299 good fixes were said to be 129 m off."""
    random, step = np.random.default_rng(seed), 0.1
    t = np.arange(0.0, 900.0, step)
    course = random.uniform(0.0, 6.0) + np.cumsum(np.where(t % 150.0 < 60.0, 0.05, 0.0) * step)
    velocity = 250.0 * np.stack([np.cos(course), np.sin(course), 0.0 * t], axis=1)
    place = np.array([np.radians(latitude), 0.2])
    places = np.empty((len(t), 2))
    between = 0.5 * (velocity + np.roll(velocity, -1, axis=0))
    for k, v in enumerate(between):
        places[k] = place
        there = displaced(*place, 9000.0, *(0.5 * step * v[:2]))
        way = np.subtract(displaced(*there, 9000.0, *(step * v[:2])), there)
        place = place + way
    rows = np.flatnonzero((np.arange(len(t)) % 2 == 0) & ((t < 400.0) | (t >= 700.0)))
    n = len(rows)
    noise = 0.4 * random.standard_normal((n, 3))
    latitudes, longitudes = displaced(*places[rows].T, 9000.0, *noise[:, :2].T)
    time_ns = np.round(t[rows] * 1e9).astype(np.int64)
    velocities = velocity[rows] + 0.05 * random.standard_normal((n, 3))
    gnss = GnssEpochs(
        time_ns, time_ns, latitudes, longitudes, 9000.0 - noise[:, 2], velocities,
        np.full((n, 3), 0.4), np.full((n, 3), 0.05),
    )  # fmt: skip
    assert not unsettled(gnss).any() and not leaps(gnss).any()


def test_without_velocities_nothing_is_said():
    gnss, _ = coming_in(1, 5.0, 50.0, 8.0)
    assert not unsettled(replace(gnss, velocity_n=np.full_like(gnss.velocity_n, np.nan))).any()


def test_fixes_that_are_off_together_count_as_one():
    sigma = lasting(np.array([0.0, 10.0, 10.0, 10.0, 10.0, 0.0, 5.0]))
    assert np.sum(1.0 / sigma[1:5] ** 2) == pytest.approx(1.0 / 10.0**2)
    assert sigma[[0, 5, 6]] == pytest.approx([0.0, 0.0, 5.0])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3])
def test_a_receiver_that_comes_in_does_not_throw_the_filter_off(tmp_path, seed):
    truth = drive(seed, 330.0, rest=20.0)
    data = record(truth, PHONE, seed, gnss_rate=2.0, sigma=SIGMA, sigma_v=0.06)
    data = without_fixes(data, [(170.0, 240.0)])
    log = data.fixes
    fades = np.where(log.seconds >= 240.0, np.exp(-(log.seconds - 240.0) / 9.0), 0.0)
    place = moved(log.latitude, log.longitude, log.height, fades[:, None] * [45.0, -35.0, 20.0])
    latitude, longitude, height = place
    spoilt = replace(log, latitude=latitude, longitude=longitude, height=height)
    path = write(tmp_path / "log.mcap", replace(data, fixes=spoilt))
    arm = {"lever_arm": tuple(LEVER.tolist())}
    chosen, solution = run(path, gnss=arm, input={"gyro_kind": "mean-rate"})
    assert chosen["filter"]["restarts"] == 0
    most, _ = worst(data, solution)
    assert most < 4.5
    assert sum("receiver's velocities show" in f["text"] for f in chosen["findings"]) == 1
