from dataclasses import replace

import numpy as np
import pytest

from sinstool.core import earth, rotation
from sinstool.simulation.gnss import (
    MODELS,
    GnssErrors,
    GnssFaults,
    Jump,
    Receiver,
    gnss_samples,
    true_moments,
)
from sinstool.simulation.launch import launch
from sinstool.simulation.moments import moments
from sinstool.simulation.truth import Trajectory, sample_times, static

DEGREE = np.pi / 180.0
PERFECT = Receiver(errors=MODELS["perfect"])


@pytest.fixture(scope="module")
def flight():
    return launch(200.0, 130.0)


def at_rest(duration_s, latitude=-0.6, longitude=2.0, q_nb=(0.5, 0.5, -0.5, 0.5)):
    imu = static(sample_times(1.0, duration_s), q_nb, latitude, 50.0)
    one = np.ones(len(imu.time_ns))
    return Trajectory(imu, latitude * one, longitude * one, 50.0 * one, np.zeros((len(one), 3)))


def metres(got, truth):
    """North, east, down from the truth to the fixes."""
    meridian, transverse = earth.radii_of_curvature(truth.latitude)
    east = np.mod(got.longitude - truth.longitude + np.pi, 2.0 * np.pi) - np.pi
    return np.stack(
        [
            (got.latitude - truth.latitude) * (meridian + truth.height),
            east * (transverse + truth.height) * np.cos(truth.latitude),
            truth.height - got.height,
        ],
        -1,
    )


def correlation(x, lag):
    return np.mean(x[lag:] * x[:-lag]) / np.mean(x * x)


# -- receiver ------------------------------------------------------------------------------


def test_a_perfect_receiver_tells_the_truth(flight):
    got = gnss_samples(flight, PERFECT, 0)
    assert len(got) == 1301
    rows = slice(None, None, 20)
    np.testing.assert_array_equal(got.time_ns, flight.time_ns[rows])
    np.testing.assert_allclose(got.latitude, flight.latitude[rows], atol=1e-14)
    np.testing.assert_allclose(got.longitude, flight.longitude[rows], atol=1e-14)
    np.testing.assert_allclose(got.height, flight.height[rows], atol=1e-8)
    np.testing.assert_allclose(got.velocity_n, flight.velocity_n[rows], atol=1e-6)
    assert not got.sigma_position.any() and not got.outlier.any()


def test_latency_and_offset_shift_what_is_measured(flight):
    late = replace(PERFECT, latency_s=0.237, offset_s=1.0031, rate_hz=4.0)
    got = gnss_samples(flight, late, 0)
    assert got.time_ns[0] == 1_003_100_000 and got.time_ns[1] == 1_253_100_000
    then = moments(flight, got.time_ns - 237_000_000)
    np.testing.assert_array_equal(got.truth.time_ns, then.time_ns)
    np.testing.assert_allclose(got.velocity_n, then.velocity_n, atol=1e-9)
    # stamps whose fix would be valid before the first instant are left out
    early = gnss_samples(flight, replace(late, offset_s=0.0), 0)
    assert early.time_ns[0] == 250_000_000


def test_a_lever_arm_moves_the_antenna_and_gives_it_speed(flight):
    lever = np.array([3.0, 1.5, -0.5])
    at_imu = gnss_samples(flight, PERFECT, 0)
    at_antenna = gnss_samples(flight, replace(PERFECT, lever_arm_b=tuple(lever)), 0)
    rows = slice(None, None, 20)
    arm_n = rotation.rotate(flight.imu.q_nb[rows], lever)
    np.testing.assert_allclose(metres(at_antenna, at_imu), arm_n, atol=1e-5)
    q_bn = rotation.conjugate(flight.imu.q_nb[rows])
    rate = flight.imu.gyro_rate[rows] - rotation.rotate(
        q_bn, earth.earth_rate_n(flight.latitude[rows])
    )
    swing = rotation.rotate(flight.imu.q_nb[rows], np.cross(rate, lever))
    # transport rate times the lever arm is left out here
    np.testing.assert_allclose(at_antenna.velocity_n - at_imu.velocity_n, swing, atol=1e-3)
    assert np.linalg.norm(swing, axis=1).max() > 5.0


@pytest.mark.parametrize("name", ["launch", "coloured"])
def test_noise_has_the_size_and_colour_of_its_model(name):
    rest = at_rest(40_000)
    model = MODELS[name]
    got = gnss_samples(rest, Receiver(rate_hz=1.0, errors=model), 5)
    position, velocity = metres(got, got.truth), got.velocity_n
    for noise, white, markov, tau in (
        (position, model.position_white, model.position_markov, model.position_time),
        (velocity, model.velocity_white, model.velocity_markov, model.velocity_time),
    ):
        size = np.hypot(white, markov)
        # 40 000 s hold 100 correlation times and more: a standard deviation is good to 7 %
        np.testing.assert_allclose(noise.std(axis=0), size, rtol=0.2)
        for axis in range(3):
            part = (markov[axis] / size[axis]) ** 2
            for lag in (1, 30):
                expected = part * np.exp(-lag / tau)
                assert correlation(noise[:, axis], lag) == pytest.approx(expected, abs=0.08)
            # what is white shows in differences, whatever wanders
            step = np.diff(noise[:, axis])
            jumps = 2.0 * white[axis] ** 2 + 2.0 * markov[axis] ** 2 * (1.0 - np.exp(-1.0 / tau))
            assert step.std() == pytest.approx(np.sqrt(jumps), rel=0.03)
    cross = np.corrcoef(np.concatenate([position, velocity], axis=1).T) - np.eye(6)
    assert np.abs(cross).max() < 0.3
    np.testing.assert_allclose(
        got.sigma_position[0], np.hypot(model.position_white, model.position_markov)
    )
    np.testing.assert_allclose(
        got.sigma_velocity[-1], np.hypot(model.velocity_white, model.velocity_markov)
    )


def test_faults_leave_the_other_fixes_as_they_were(flight):
    usual = Receiver(errors=MODELS["coloured"])
    faults = GnssFaults(
        outages=((10.0, 12.0), (100.0, 105.5)),
        jumps=(Jump(20.0, 25.0, (100.0, -50.0, 10.0)),),
        outlier_fraction=0.02,
        outlier_position=500.0,
        outlier_velocity=20.0,
        flat=((40.0, 45.0),),
        without_velocity=((50.0, 51.0),),
    )
    clean = gnss_samples(flight, usual, 9)
    bad = gnss_samples(flight, replace(usual, faults=faults), 9)
    t = clean.time_ns * 1e-9
    out = ((t >= 10) & (t < 12)) | ((t >= 100) & (t < 105.5))
    assert len(bad) == len(clean) - out.sum() == 1301 - 75
    np.testing.assert_array_equal(bad.time_ns, clean.time_ns[~out])
    off, fast = metres(bad, bad.truth), bad.velocity_n
    expected = metres(clean, clean.truth)[~out]
    t = t[~out]
    ok = ~bad.outlier
    jump = (t >= 20) & (t < 25)
    flat, dumb = (t >= 40) & (t < 45), (t >= 50) & (t < 51)
    np.testing.assert_allclose((off - expected)[ok & ~jump & ~flat], 0.0, atol=1e-8)
    np.testing.assert_allclose(
        (off - expected)[ok & jump],
        np.tile([100.0, -50.0, 10.0], ((ok & jump).sum(), 1)),
        atol=1e-8,
    )
    assert np.isnan(bad.height[flat]).all() and np.isnan(fast[flat, 2]).all()
    assert np.isfinite(fast[flat & ~dumb, :2]).all() and np.isfinite(bad.latitude).all()
    assert np.isnan(fast[dumb]).all() and np.isfinite(bad.height[dumb]).all()
    hit = bad.outlier & ~jump & ~flat & ~dumb
    assert 10 <= bad.outlier.sum() <= 45  # 25 expected
    np.testing.assert_allclose(np.linalg.norm((off - expected)[hit], axis=1), 500.0, atol=1e-6)
    more = np.linalg.norm((fast - clean.velocity_n[~out])[hit], axis=1)
    np.testing.assert_allclose(more, 20.0, atol=1e-9)


def test_seeds_and_shared_truth(flight):
    receiver = Receiver(lever_arm_b=(1.0, 0.0, -2.0))
    shared = true_moments(flight, receiver)
    one, same, other = (gnss_samples(flight, receiver, s, shared) for s in (1, 1, 2))
    alone = gnss_samples(flight, receiver, 1)
    np.testing.assert_array_equal(one.velocity_n, same.velocity_n)
    np.testing.assert_array_equal(one.latitude, alone.latitude)
    assert np.abs(one.velocity_n - other.velocity_n).max() > 0.1


def test_fixes_across_the_date_line():
    track = launch(50.0, 60.0, latitude=-16.0 * DEGREE, longitude=179.9 * DEGREE, azimuth=1.5)
    noisy = Receiver(errors=GnssErrors(position_white=(3000.0, 3000.0, 1.0)))
    got = gnss_samples(track, noisy, 3)
    assert np.abs(got.longitude).max() <= np.pi
    assert got.longitude.min() < -3.0 and got.longitude.max() > 3.0
    assert np.abs(metres(got, got.truth)).max() < 15_000.0


@pytest.mark.parametrize(
    "wrong", [{"rate_hz": 0.0}, {"latency_s": -0.1}, {"offset_s": -1.0}, {"offset_s": 500.0}]
)
def test_receivers_that_cannot_be(flight, wrong):
    with pytest.raises(ValueError):
        gnss_samples(flight, replace(PERFECT, **wrong), 0)
