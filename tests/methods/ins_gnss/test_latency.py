"""Latencies that simulated receivers have, of either sign, found again."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sinstool.core.rotation import exp, multiply
from sinstool.core.streams import GnssEpochs, concatenate
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.stage import ConingStage
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.fix_velocity import (
    split_position_velocity,
    velocity_lag,
    velocity_noise_bound,
)
from sinstool.methods.ins_gnss.latency import correlate, inertial_velocity
from sinstool.methods.ins_gnss.settings import DivergenceControl, GnssModel, Settings
from sinstool.methods.sensor_errors import SIMULATED_GRADES, SensorGrade
from sinstool.methods.strapdown.velocity import IncrementStage
from sinstool.simulation.drive import road_drive
from sinstool.simulation.flight import manoeuvring_flight
from sinstool.simulation.gnss import GnssErrors, Receiver, gnss_samples
from sinstool.simulation.sensors import with_errors
from tests.helpers.filter_start import start
from tests.helpers.gnss import epochs
from tests.helpers.unseen_drives import GRADES, cruise, record, walk
from tests.helpers.unseen_vehicles import tractor, train

RATE = 50.0
GRADE = SIMULATED_GRADES["mems"]
ERRORS = GnssErrors((1.0, 1.0, 1.5), (2.0, 2.0, 3.0), 100.0, (0.05, 0.05, 0.08))
# No gate: fixes at a wrong time are not bad ones
SETTINGS = Settings(
    control=DivergenceControl(gate_probability=1.0),
    filter="markov-21",
    imu=SensorGrade(
        angle_random_walk=GRADE.angle_random_walk,
        velocity_random_walk=GRADE.velocity_random_walk,
        gyro_bias=GRADE.gyro_bias,
        accel_bias=GRADE.accel_bias,
    ),
    gnss=GnssModel((1.0, 1.0, 1.5), (2.0, 2.0, 3.0), 100.0, (0.05, 0.05, 0.08), (5e-3,) * 3, 100.0),
)


def increments(imu):
    stage = IncrementStage(
        lambda: ConingStage(
            algorithm("previous-1"), "mean-rate", nominal_interval=float(imu.interval[1])
        )
    )
    parts = [stage.push(imu.gyro_mean_rate, imu.mean_specific_force, imu.time_ns), stage.finish()]
    return concatenate(parts)


class Scene:
    """A MEMS on the move and a receiver, whose clock is ahead of the IMU's or behind."""

    def __init__(self, kind, latency, seed=1, rate=5.0):
        if kind == "flight":
            path = manoeuvring_flight(240.0, RATE, latitude=0.6, longitude=-1.0, seed=seed)
        elif kind == "drive":
            path = road_drive(240.0, RATE, heading=1.0, still_s=10.0, seed=seed)
        else:
            path = road_drive(120.0, RATE, heading=1.0, still_s=200.0)
        self.path, imu = path, with_errors(path.imu, GRADE, seed)
        self.increments = increments(imu)
        receiver = Receiver(rate, 0.61, max(latency, 0.0), errors=ERRORS)
        samples = gnss_samples(path, receiver, seed)
        early = round(min(latency, 0.0) * 1e9)
        stamps = samples.time_ns + early
        self.gnss = replace(epochs(samples), time_ns=stamps, log_time_ns=stamps)
        psi = np.deg2rad([0.3, -0.3, 2.0])
        self.start = start(
            float(path.latitude[0]),
            float(path.longitude[0]),
            float(path.height[0]),
            path.velocity_n[0],
            multiply(exp(psi), path.imu.q_nb[0]),
            3.0,
            0.1,
            np.deg2rad([0.5, 0.5, 2.0]),
        )

    def filtered(self, latency=0.0):
        run = InsGnssFilter(
            self.start, replace(SETTINGS, gnss_latency=latency), with_baro=False, output=True
        )
        return run.push(self.increments, self.gnss)

    def correlated(self, **more):
        updates = self.filtered().updates
        before = np.concatenate([self.start.nav[None, 6:10], updates.q_nb[:-1]])
        velocity = inertial_velocity(
            before,
            self.increments.velocity_increment,
            self.increments.interval,
            updates.latitude,
            updates.height,
            updates.velocity_n,
        )
        return correlate(updates.time_ns, velocity, self.gnss.time_ns, self.gnss.velocity_n, **more)


@cache
def scene(kind, latency, seed=1):
    return Scene(kind, latency, seed)


@pytest.mark.parametrize("kind", ["flight", "drive"])
@pytest.mark.parametrize("latency", [0.05, 0.1, 0.2, 0.0, -0.125])
def test_found_from_the_velocities(kind, latency):
    result = scene(kind, latency).correlated()
    assert result.status == "found"
    assert result.latency_s == pytest.approx(latency, abs=0.01)
    assert result.sigma_s < 0.01
    assert "ms" in str(result)


def test_its_sigma_is_its_error():
    errors = []
    for seed in range(2, 10):
        result = Scene("drive", 0.08, seed).correlated()
        errors.append((result.latency_s - 0.08) / result.sigma_s)
    assert 0.3 < np.sqrt(np.mean(np.square(errors))) < 1.8


def test_nothing_is_found_at_rest():
    result = scene("rest", 0.1).correlated()
    assert result.status == "not observable"
    assert not np.isfinite(result.sigma_s)
    assert "not observable" in str(result)


def test_at_the_end_of_the_range():
    result = scene("drive", 0.2).correlated(low_s=-0.1, high_s=0.1)
    assert result.status == "at the limit"
    assert result.latency_s == pytest.approx(0.1, abs=0.01)


def test_outliers_and_missing_velocities():
    trial = scene("flight", 0.1)
    updates = trial.filtered().updates
    before = np.concatenate([trial.start.nav[None, 6:10], updates.q_nb[:-1]])
    velocity = inertial_velocity(
        before,
        trial.increments.velocity_increment,
        trial.increments.interval,
        updates.latitude,
        updates.height,
        updates.velocity_n,
    )
    random = np.random.default_rng(3)
    spoilt = trial.gnss.velocity_n.copy()
    spoilt[random.random(len(spoilt)) < 0.1] = np.nan
    spoilt[::3, 2] = np.nan
    spoilt[100:110] += 30.0 * random.standard_normal((10, 3))
    result = correlate(updates.time_ns, velocity, trial.gnss.time_ns, spoilt)
    assert result.latency_s == pytest.approx(0.1, abs=0.01)
    nothing = np.full_like(spoilt, np.nan)
    nothing = correlate(updates.time_ns, velocity, trial.gnss.time_ns, nothing)
    assert nothing.status == "not observable"


def smooth_motion(t):
    """Velocity and way of something that speeds up and slows down."""
    w, size, phase = np.array([[0.5, 0.9, 1.3], [4.0, 3.0, 2.0], [0.0, 1.0, 2.0]])
    angle = np.outer(t, w) + phase
    speed = np.sin(angle) * size
    way = (np.cos(phase) - np.cos(angle)) / w * size
    return speed, way


@settings(max_examples=25, deadline=None)
@given(st.floats(-0.5, 0.5), st.integers(0, 2**31))
def test_any_latency_of_exact_velocities(latency, seed):
    random = np.random.default_rng(seed)
    t = np.arange(0.0, 60.0, 0.01)
    fix = np.sort(random.uniform(1.0, 59.0, 200))
    drift = random.standard_normal(3)
    result = correlate(
        (t * 1e9).astype(np.int64),
        smooth_motion(t)[0] + drift * t[:, None],
        (fix * 1e9).astype(np.int64),
        smooth_motion(fix - latency)[0] + 0.01 * random.standard_normal((200, 3)),
    )
    assert result.latency_s == pytest.approx(latency, abs=5e-3)


@pytest.mark.parametrize("lag", [0.12, 0.0, -0.05])
def test_velocities_of_another_instant_than_positions(lag):
    random = np.random.default_rng(4)
    t = np.arange(0.0, 200.0, 0.25)
    _, way = smooth_motion(t)
    speed, _ = smooth_motion(t - lag)
    way = way + 0.03 * random.standard_normal(way.shape)
    n = len(t)
    gnss = GnssEpochs(
        (t * 1e9).astype(np.int64) + 7,
        np.zeros(n, np.int64),
        0.8 + way[:, 0] / 6.3683e6,
        3.1415 + way[:, 1] / (6.3893e6 * np.cos(0.8)),
        np.full(n, 100.0),
        speed + 0.03 * random.standard_normal(speed.shape),
        np.full((n, 3), np.nan),
        np.full((n, 3), np.nan),
    )
    result = velocity_lag(gnss)
    assert result.status == "found"
    assert result.latency_s == pytest.approx(lag, abs=0.01)
    assert velocity_lag(gnss.rows(slice(0, 10))).status == "not observable"
    both = split_position_velocity(gnss, lag)
    if lag == 0.0:
        assert both is gnss
        return
    assert np.all(np.diff(both.time_ns) >= 0)
    assert not np.any(both.has_position & both.has_velocity)
    place, moving = both.rows(both.has_position), both.rows(both.has_velocity)
    np.testing.assert_array_equal(place.time_ns, gnss.time_ns + round(0.5e9 * lag))
    np.testing.assert_array_equal(moving.time_ns, place.time_ns - round(lag * 1e9))
    np.testing.assert_array_equal(moving.velocity_n, gnss.velocity_n)


def test_what_makes_no_sense_is_refused():
    with pytest.raises(ValueError, match="below"):
        correlate([0], np.zeros((1, 3)), [0], np.zeros((1, 3)), 0.1, 0.1)
    with pytest.raises(ValueError, match="shape"):
        correlate([0, 1], np.zeros((1, 3)), [0], np.zeros((1, 3)))


def test_its_sigma_follows_from_the_noise_of_the_velocities():
    """Of a velocity that swings as a sine, in white noise: the Cramer-Rao bound in closed form.

    Of n velocities with noise s on each axis, and accelerations of mean square a^2 on each of two
    axes, the delay is known to s / (a sqrt(2 n)).
    """
    swing, rate, noise, n = 4.0, 0.9, 0.3, 600
    errors, sigmas = [], []
    t = np.arange(30_001) * 0.01
    velocity = np.stack([swing * np.sin(rate * t), swing * np.cos(rate * t), 0.0 * t], axis=1)
    times = np.round(t * 1e9).astype(np.int64)
    fixes = 5.0 + 0.4 * np.arange(n)
    for seed in range(40):
        random = np.random.default_rng(seed)
        true = np.stack([swing * np.sin(rate * fixes), swing * np.cos(rate * fixes)], axis=1)
        measured = np.zeros((n, 3))
        measured[:, :2] = true + noise * random.standard_normal((n, 2))
        measured[:, 2] = noise * random.standard_normal(n)
        stamps = np.round((fixes + 0.05) * 1e9).astype(np.int64)
        found = correlate(times, velocity, stamps, measured)
        assert found.status == "found"
        errors.append(found.latency_s - 0.05)
        sigmas.append(found.sigma_s)
    bound = noise / (swing * rate / np.sqrt(2.0) * np.sqrt(2.0 * n))
    assert np.std(errors) == pytest.approx(bound, rel=0.35)
    # Stated as the root of 2 of it, for what of the noise is not white
    assert 1.25 * bound < np.median(sigmas) < 1.8 * bound


@pytest.mark.parametrize(
    "fixes, downs, status",
    [(6, 4, "not observable"), (6, 5, "found"), (7, 2, "not observable"), (7, 1, "not observable")],
)
def test_more_than_ten_degrees_of_freedom_are_needed(fixes, downs, status):
    # Of so many fixes in a window: a line takes two from each axis, or all that there are.
    t = np.arange(0.0, 40.0, 0.01)
    fix = np.array([8.3, 9.7, 10.9, 12.2, 13.6, 15.1, 15.9])[:fixes]
    noise = 1e-4 * np.random.default_rng(2).normal(size=(fixes, 3))
    measured = smooth_motion(fix - 0.1)[0] + noise
    measured[downs:, 2] = np.nan
    found = correlate((t * 1e9).astype(np.int64), smooth_motion(t)[0],
                      (fix * 1e9).astype(np.int64), measured)  # fmt: skip
    assert found.status == status


def received(truth, seed, rate, sigma, sigma_v):
    """Fixes with such noise of positions, m, and velocities, m/s."""
    noise = {"sigma": sigma, "sigma_v": sigma_v}
    f = record(truth, GRADES["tactical"], seed, gnss_rate=rate, **noise).fixes
    stamps = np.rint(f.seconds * 1e9).astype(np.int64)
    none = np.full((len(stamps), 3), np.nan)
    return GnssEpochs(stamps, stamps, f.latitude, f.longitude, f.height, f.velocity_n, none, none)


@pytest.mark.parametrize(
    ("moving", "seed", "rate", "noise"),
    [
        (walk, 3, 1.0, (0.064, 0.081)),
        (tractor, 5, 2.0, (0.06, 0.085)),
        (train, 1, 5.0, (0.12, 0.26)),
    ],
)
def test_steps_and_swings_between_fixes_show_no_lag_of_an_interval(moving, seed, rate, noise):
    """One interval later they look alike: lags of -1 to 0.5 s at 15 to 24 sigmas."""
    fixes = received(moving(seed, 400.0), seed, rate, *noise)
    assert not velocity_lag(fixes).differs_from(0.0, 0.02, 3.0)


@pytest.mark.parametrize("rate", [1.0, 5.0])
@pytest.mark.parametrize("sigma_v", [0.1, 0.3])
@pytest.mark.slow
def test_positions_bound_the_noise_of_velocities(rate, sigma_v):
    for seed in (1, 2):
        bound = velocity_noise_bound(received(cruise(400.0), seed, rate, 0.02, sigma_v))
        assert sigma_v < bound < 3.0 * sigma_v + 0.1  # by a few centimetres of positions
        # What positions say no better than the velocities may be is no bound to them
        assert velocity_noise_bound(received(cruise(400.0), seed, rate, 5.0, sigma_v)) > sigma_v
    assert np.isnan(velocity_noise_bound(received(cruise(60.0), 1, rate, 0.1, sigma_v)))
