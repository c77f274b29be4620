"""A latency that a log shows only roughly adds to the error of position."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from sinstool.core.rotation import to_dcm
from sinstool.core.streams import Solution, concatenate
from sinstool.methods.ins_gnss.offsets_error import OffsetsError
from sinstool.pipelines.process.ins_gnss.settings_used import late_or_early
from tests.helpers.filter_logs import run
from tests.helpers.unseen_drives import (
    GRADES,
    LEVER,
    RATE,
    T0,
    band_noise,
    flight,
    motion_of,
    multicopter,
    record,
    smoothed,
    write,
)
from tests.helpers.unseen_errors import slower

LATE = np.diag([1e-4, 0.0, 0.0, 0.0])  # by 10 ms


def horizontal(truth, solution):
    """Square of the error and of its sigma, m^2, once the filter has settled."""
    rows = solution.rows((solution.time_ns - T0) * 1e-9 > 40.0)
    seconds = (rows.time_ns - T0) * 1e-9
    error = truth.errors_of(seconds, *rows.position.T, rows.velocity_n, np.eye(3)[None])[:, :2]
    variance = np.einsum("nii->ni", rows.covariance_position_n)[:, :2]
    return np.sum(error**2, axis=1), np.sum(variance, axis=1)


@pytest.mark.slow
def test_a_flight_is_as_far_off_as_its_sigmas_say(tmp_path):
    """At 60 m/s a latency known to 4 ms is worth 0.24 m, whatever the fixes claim."""
    truth = flight(3, 150.0)
    ratios = []
    for draw in range(11, 14):
        data = record(truth, GRADES["industrial"], draw, gnss_rate=5.0, latency=0.05)
        log = write(tmp_path / "log.mcap", data)
        groups = {"input": {"gyro_kind": "mean-rate"}, "gnss": {"lever_arm": tuple(LEVER.tolist())}}
        result, solution = run(log, **groups)
        square, variance = horizontal(truth, solution)
        ratios.append(np.mean(square / variance))
        shown = result["filter"]["gnss_latency"]["sigma_s"]
        assert np.sqrt(np.mean(variance)) == pytest.approx(60.0 * shown, rel=0.3)
    assert 0.2 < np.sqrt(np.mean(ratios)) < 2.0
    groups["gnss"]["gnss_latency"] = 0.05
    result, solution = run(log, **groups)
    assert not any(f["kind"] == "latency-uncertain" for f in result["findings"])
    square, variance = horizontal(truth, solution)
    assert np.mean(square / variance) < 2.0 and np.mean(variance) < 0.06**2  # given, it is certain


def winding(seed, duration=120.0):
    """A kart that weaves at 15 m/s on a rough track: quick changes of velocity in all axes."""
    random = np.random.default_rng([seed, 11])
    t = np.arange(0.0, duration, 1.0 / RATE)
    moving = smoothed(np.where(t > 10.0, 1.0, 0.0), 6.0)
    slow, fast = band_noise(random, t, 0.1, 0.6), band_noise(random, t, 0.5, 4.0)
    course = moving * (slow[:, 0] + 0.5 * np.sin(0.2 * t))
    ahead, up = 15.0 * moving * np.stack([np.cos(course), np.sin(course)]), 0.15 * moving
    velocity = np.stack([*ahead, up * fast[:, 2]], axis=1)
    roll, pitch = np.radians(0.5) * moving * fast[:, :2].T
    return motion_of(t, velocity, np.stack([roll, pitch, course], axis=1))


@pytest.mark.slow
def test_velocity_may_be_of_half_a_sample_ago(tmp_path):
    """Means over 20 ms, read as rates: at 10 m/s^2 velocity is 0.1 m/s off between fixes."""
    ratios = []
    for seed in range(3):
        data = record(winding(seed), GRADES["industrial"], seed, gnss_rate=5.0, latency=0.05)
        log = write(tmp_path / "log.mcap", slower(data, 4))
        _, solution = run(log, gnss={"lever_arm": tuple(LEVER.tolist())}, filter={"smooth": True})
        rows = solution.rows((solution.time_ns - T0) * 1e-9 > 20.0)
        error = data.truth.errors_of(
            (rows.time_ns - T0) * 1e-9, *rows.position.T, rows.velocity_n, to_dcm(rows.q_nb)
        )
        variance = np.einsum("nii->ni", rows.covariance_velocity_n)
        ratios.append(np.sqrt(np.mean(error[:, 3:6] ** 2 / variance)))
    assert max(ratios) < 2.0 and min(ratios) > 0.5


@pytest.mark.slow
def test_samples_may_be_of_half_a_sample_ago(tmp_path):
    """Means over 20 ms, read as rates: at 60 deg/s they are 0.6 deg off, as nothing shows."""
    outside, known = [], []
    for seed in range(3):
        truth = multicopter(seed, 120.0)
        data = record(truth, GRADES["industrial"], seed, gnss_rate=5.0, sigma_v=0.05, latency=0.05)
        log = write(tmp_path / "log.mcap", slower(data, 4))
        gnss = {"lever_arm": tuple(LEVER.tolist())}
        for given, ratios in (({}, outside), ({"gyro_kind": "mean-rate"}, known)):
            _, solution = run(log, input=dict(given), gnss=dict(gnss), filter={"smooth": True})
            rows = solution.rows((solution.time_ns - T0) * 1e-9 > 20.0)
            error = truth.errors_of(
                (rows.time_ns - T0) * 1e-9, *rows.position.T, rows.velocity_n, to_dcm(rows.q_nb)
            )[:, 6:8]
            variance = np.einsum("nii->ni", rows.covariance_attitude_n)[:, :2]
            ratios.append(np.sqrt(np.mean(error**2 / variance)))
    # At 50 Hz a rotor's fast motion looks like axes that are off by 1 %
    assert max(outside) < 2.0 and max(known) < 2.5
    assert np.mean(outside) > 0.5


def test_a_latency_worth_much_more_than_the_fixes_noise_is_reported():
    assert late_or_early(0.24, 0.004, 0.05) == []
    (finding,) = late_or_early(0.6, 0.01, 0.05)
    assert "to 10 ms only" in finding.text and "0.6 m" in finding.text
    assert finding.answer == "give --gnss-latency"


def turning(rate=0.2, speed=10.0, interval=0.05):
    """A circle, at 20 Hz by default, with covariances of zero."""
    seconds = np.arange(400) * interval
    n = len(seconds)
    zero = np.zeros((n, 3))
    course = rate * seconds
    velocity = speed * np.stack([np.cos(course), np.sin(course), 0.0 * course], axis=1)
    stamps = np.round(seconds * 1e9).astype(np.int64)
    none = np.zeros((n, 3, 3))
    q = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    return Solution(stamps, stamps, q, zero, zero, zero, velocity, None, none, none, none)


def test_along_the_track_and_across_it():
    """Position is off by the velocity, and velocity by its change."""
    solution, error = turning(), OffsetsError(LATE)
    answer = error.added(solution)
    assert error.largest_m == pytest.approx(0.01 * 10.0)
    v = solution.velocity_n
    square = 1e-4 * v[:, :, None] * v[:, None, :]
    assert np.allclose(answer.covariance_position_n, square)
    late = np.einsum("nii->n", answer.covariance_velocity_n)[20:]
    assert np.sqrt(late) == pytest.approx(0.01 * 0.2 * 10.0, rel=0.01)
    assert np.all(answer.covariance_attitude_n == 0.0)
    assert OffsetsError(np.zeros((4, 4))).added(solution) is solution


def test_samples_of_another_time():
    """As likely as not 5 ms off, at 0.2 rad/s; position too, if fixes are timed against them."""
    rate, standing = np.tile([0.0, 0.0, 0.2], (400, 1)), np.tile([0.0, 0.0, -9.80665], (400, 1))
    solution = replace(turning(), omega_ib_b=rate, specific_force_b=standing)
    answer = OffsetsError(np.zeros((4, 4)), sample_s=0.005).added(solution)
    assert np.allclose(answer.covariance_attitude_n[:, 2, 2], 0.5 * (0.2 * 0.005) ** 2)
    assert np.all(answer.covariance_velocity_n == 0.0)
    assert np.all(answer.covariance_attitude_n[:, :2, :2] == 0.0)
    assert np.all(answer.covariance_position_n == 0.0)
    pushed = replace(solution, specific_force_b=standing + np.array([3.0, 0.0, 0.0]))
    answer = OffsetsError(np.zeros((4, 4)), sample_s=0.005).added(pushed)
    assert np.allclose(answer.covariance_velocity_n[:, 0, 0], 0.5 * (3.0 * 0.005) ** 2)
    error = OffsetsError(np.zeros((4, 4)), sample_s=0.005, shared=True)
    answer = error.added(solution)
    trace = np.einsum("nii->n", answer.covariance_position_n)
    assert np.allclose(trace, 0.5 * (10.0 * 0.005) ** 2)
    assert error.largest_m == 0.0  # no latency of the receiver


def test_samples_of_another_time_of_a_turned_body():
    """Rate and force are in axes of the body, covariances in NED."""
    random = np.random.default_rng(5)
    q = random.normal(size=(400, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    rate, force = random.normal(size=(2, 400, 3)) * [[[1.0]], [[10.0]]]
    solution = replace(turning(), q_nb=q, omega_ib_b=rate, specific_force_b=force)
    answer = OffsetsError(np.zeros((4, 4)), sample_s=0.005).added(solution)
    turn = np.einsum("nij,nj->ni", to_dcm(q), rate)
    push = np.einsum("nij,nj->ni", to_dcm(q), force) + np.array([0.0, 0.0, 9.80665])
    for covariance, v in (
        (answer.covariance_attitude_n, turn),
        (answer.covariance_velocity_n, push),
    ):
        squares = v[:, :, None] * v[:, None, :]
        for k in range(1, len(v)):
            squares[k] = 0.5 * (squares[k - 1] + squares[k])
        assert np.allclose(covariance, 0.5 * 0.005**2 * squares)


def test_what_shakes_may_stand_still_at_a_sample():
    """A body that pitches to and fro by 0.3 deg at 6.2 Hz, sampled at 25 Hz."""
    seconds, hertz = np.arange(400) * 0.04, 2.0 * np.pi * 6.2

    def angle(t):
        return np.radians(0.3) * np.sin(hertz * t)

    rate = np.zeros((400, 3))
    rate[:, 1] = (angle(seconds + 1e-4) - angle(seconds - 1e-4)) / 2e-4
    solution = replace(turning(), q_nb=np.tile([1.0, 0, 0, 0], (400, 1)), omega_ib_b=rate)
    solution = replace(solution, specific_force_b=np.tile([0.0, 0.0, -9.80665], (400, 1)))
    error = OffsetsError(np.zeros((4, 4)), sample_s=0.02)
    parts = [error.added(solution.rows(slice(k, k + 37))) for k in range(0, 400, 37)]
    sigma = np.concatenate([np.sqrt(part.covariance_attitude_n[:, 1, 1]) for part in parts])
    off = angle(seconds - 0.02) - angle(seconds)
    # Half of the samples are so much off, in the mean
    assert 0.8 < np.sqrt(np.mean(0.5 * off[5:] ** 2) / np.mean(sigma[5:] ** 2)) < 1.1
    assert np.abs(off / sigma)[5:].max() < 2.0
    whole = OffsetsError(np.zeros((4, 4)), sample_s=0.02).added(solution)
    np.testing.assert_array_equal(np.sqrt(whole.covariance_attitude_n[:, 1, 1]), sigma)


@pytest.mark.parametrize("interval", [0.07, 0.3, 0.9])
def test_the_velocity_a_second_ago_lies_between_samples(interval):
    answer = OffsetsError(LATE).added(turning(interval=interval))
    late = np.einsum("nii->n", answer.covariance_velocity_n)[20:]
    assert np.sqrt(late) == pytest.approx(0.01 * 0.2 * 10.0, rel=0.02)


def test_blocks_do_not_matter():
    solution = turning()
    whole = OffsetsError(LATE).added(solution)
    error, ends = OffsetsError(LATE), [0, 1, 2, 90, 91, 300, 400]
    pieces = [solution.rows(slice(*pair)) for pair in pairwise(ends)]
    joined = concatenate([error.added(piece) for piece in pieces])
    assert np.allclose(joined.covariance_velocity_n, whole.covariance_velocity_n, atol=1e-15)
    again = error.added(replace(pieces[0], velocity_n=None))
    assert np.all(again.covariance_position_n == 0.0)


def test_an_arm_swings_with_the_body():
    """Half a metre to the right, in a turn of 0.2 rad/s: 0.5 m, and 0.1 m/s."""
    solution = turning()
    course = 0.2 * np.arange(400) * 0.05
    zero = np.zeros(400)
    q = np.stack([np.cos(course / 2), zero, zero, np.sin(course / 2)], axis=1)
    moment = np.diag([0.0, 0.0, 0.25, 0.0])
    turned = np.zeros((3, 4, 4))
    turned[2, 2, 2] = 0.04**2  # rad for each metre
    answer = OffsetsError(moment, turned).added(replace(solution, q_nb=q))
    right = np.stack([-np.sin(course), np.cos(course), zero], axis=1)
    square = 0.25 * right[:, :, None] * right[:, None, :]
    assert np.allclose(answer.covariance_position_n, square)
    late = np.einsum("nii->n", answer.covariance_velocity_n)[20:]
    assert np.sqrt(late) == pytest.approx(0.1, rel=0.01)
    assert np.sqrt(answer.covariance_attitude_n[:, 2, 2]) == pytest.approx(0.02)
    assert np.all(answer.covariance_attitude_n[:, :2, :2] == 0.0)


def test_latency_and_arm_that_cancel():
    """Ahead by 2 m for the latency, behind by 2 m for the arm: certain where they cancel."""
    off = np.array([0.2, 2.0, 0.0, 0.0])
    answer = OffsetsError(np.outer(off, off)).added(turning(rate=0.0))
    assert np.allclose(answer.covariance_position_n, 0.0)
