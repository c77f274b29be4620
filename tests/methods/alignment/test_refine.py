from dataclasses import replace

import numpy as np
import pytest

from sinstool.core import rotation
from sinstool.methods.alignment import refine as module
from sinstool.methods.alignment.inflight import align_in_flight
from sinstool.methods.alignment.inflight_types import TACTICAL, AlignmentSettings
from sinstool.methods.alignment.refine import Refiner, theta_at, theta_covariance
from sinstool.methods.alignment.solution import solve
from sinstool.methods.sensor_errors import SensorGrade
from sinstool.simulation.gnss import GnssFaults, Receiver
from tests.methods.alignment.launches import NOISY, noisy, psi, true_attitude
from tests.methods.alignment.segments import segment_of

CONSTANT = replace(TACTICAL, bias_time_s=np.inf)
STILL = replace(TACTICAL, angle_random_walk=0.0, velocity_random_walk=0.0, bias_time_s=np.inf)


def started(seed=1, receiver=None, end_s=np.inf):
    flight, imu, gnss = noisy(seed, receiver)
    segment = segment_of(imu, gnss, 40.0, end_s)
    return flight, segment, solve(segment, AlignmentSettings()).dcm


def run(segment, dcm, grade, **options):
    use = options.pop("use", np.ones(len(segment), dtype=bool))
    return Refiner(segment.rows, segment.beta(), segment.sigma, use, grade, **options)(dcm)


def skew(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def test_one_pass_is_least_squares(monkeypatch):
    # Without noise of the sensors all states are constants: one linear problem, solved at once.
    monkeypatch.setattr(module, "PASSES", 1)
    _, segment, dcm = started()
    ours = run(segment, dcm, STILL, lever_sigma=1.0, latency_sigma=0.05)
    rows = segment.rows
    first = rows.rows(slice(0, 1))
    count = len(rows)
    h = np.zeros((count, 3, 22))
    c = rotation.to_dcm(rows.q)
    for k in range(count):
        alpha = rows.alpha[k] - first.alpha[0]
        a0, k0 = first.gyro_bias_attitude[0], first.gyro_scale_attitude[0]
        h[k, :, 0:3] = skew(alpha)
        h[k, :, 3:6] = np.eye(3)
        h[k, :, 6:9] = -(rows.gyro_bias_attitude[k] - a0)
        gain = rows.gyro_bias_velocity[k] - first.gyro_bias_velocity[0]
        h[k, :, 9:12] = gain - skew(alpha) @ a0
        h[k, :, 12:15] = -(rows.accel_scale_velocity[k] - first.accel_scale_velocity[0])
        gain = rows.gyro_scale_velocity[k] - first.gyro_scale_velocity[0]
        h[k, :, 15:18] = gain - skew(alpha) @ k0
        h[k, :, 18:21] = rows.swing[k]
        h[k, :, 21] = -c[k] @ rows.force_b[k]
    z = segment.beta() @ dcm - (rows.alpha - first.alpha)
    s = STILL
    prior = np.repeat(
        [module.START_SIGMA, 1.0, s.accel_bias, s.gyro_bias, s.accel_scale, s.gyro_scale, 1.0], 3
    )
    prior = np.append(prior, 0.05)
    h, z = h.reshape(-1, 22) * prior, z.reshape(-1)  # scaled, for the inverse
    covariance = np.linalg.inv(h.T @ h / 0.01 + np.eye(22))
    x = prior * (covariance @ (h.T @ z) / 0.01)
    covariance = prior[:, None] * covariance * prior
    # The filter's theta and s are those of the last fix.
    at_end = np.eye(22)
    last = rows.rows(slice(-1, None))
    at_end[:3, 9:12] = (last.gyro_bias_attitude - first.gyro_bias_attitude)[0]
    at_end[:3, 15:18] = (last.gyro_scale_attitude - first.gyro_scale_attitude)[0]
    at_end[3:6] += h.reshape(count, 3, 22)[-1] / prior
    at_end[3:6, 3:6] = np.eye(3)
    at_end[3:6, 18:] = 0.0
    assert ours.inflated == 0
    sigma = np.sqrt(np.diag(at_end @ covariance @ at_end.T))
    np.testing.assert_allclose(np.sqrt(np.diag(ours.covariance)), sigma, rtol=1e-5)
    assert np.abs((ours.state - at_end @ x) / sigma).max() < 1e-4


def nees(cases):
    return np.mean([e @ np.linalg.solve(p, e) / 3.0 for e, p in cases])


@pytest.mark.slow
def test_covariance_is_honest_and_small():
    # Constant biases and scale factors, 24 flights: normalised errors have mean 1, here with
    # three of them per flight, 1 +- 0.17. At the end and, run backward, at the start.
    cases = {(at, refined): [] for at in ("end", "start") for refined in (False, True)}
    for seed in range(24):
        flight, imu, gnss = noisy(seed, rate_hz=100.0)
        for (at, refined), into in cases.items():
            settings = AlignmentSettings(
                at=at, refine=refined, kappa=1.0, grade=CONSTANT, series=False
            )
            answer = align_in_flight(imu, gnss, settings)
            error = psi(answer.q_nb, true_attitude(flight, answer.t_ns)[0])
            into.append((error, answer.cov))
    rms = {}
    for key, pairs in cases.items():
        nees = np.mean([e @ np.linalg.solve(p, e) / 3.0 for e, p in pairs])
        assert 0.6 < nees < 1.8, key
        rms[key] = np.rad2deg(np.sqrt(np.mean([e @ e for e, _ in pairs])))
    for at in ("end", "start"):
        assert rms[at, False] < 0.13
        assert rms[at, True] < 0.7 * rms[at, False]


def test_latency_is_found():
    flight, imu, gnss = noisy(5, Receiver(errors=NOISY, latency_s=0.1))
    answer = align_in_flight(imu, gnss, AlignmentSettings(refine=True, refine_latency_sigma=0.2))
    result = answer.errors
    assert abs(result.latency_s - 0.1) < 3.0 * result.sigma["latency_s"] < 0.08
    # The attitude at the time at which the fixes were taken to be valid.
    error = psi(answer.q_nb, true_attitude(flight, answer.t_ns)[0])
    assert np.rad2deg(np.linalg.norm(error)) < 0.12


def test_lever_arm_is_found():
    lever = (3.0, 1.5, 0.5)
    flight, imu, gnss = noisy(5, Receiver(errors=NOISY, lever_arm_b=lever))
    answer = align_in_flight(imu, gnss, AlignmentSettings(refine=True, refine_lever_sigma=3.0))
    result = answer.errors
    assert np.all(np.abs(result.lever_arm_b - lever) < 3.5 * result.sigma["lever_arm_b"])
    assert np.all(result.sigma["lever_arm_b"][1:] < 0.05)  # what the roll shows
    error = psi(answer.q_nb, true_attitude(flight, answer.t_ns)[0])
    assert np.rad2deg(np.linalg.norm(error)) < 0.12


def test_misfits_are_inflated_not_fatal():
    # Without the screen, every tenth fix 20 m/s off, and a filter that thinks it knows all.
    receiver = Receiver(
        errors=NOISY, faults=GnssFaults(outlier_fraction=0.1, outlier_velocity=20.0)
    )
    flight, imu, gnss = noisy(6, receiver)
    segment = segment_of(imu, gnss, 40.0)
    dcm = solve(segment_of(*noisy(6)[1:], 40.0), AlignmentSettings()).dcm
    result = run(segment, dcm, CONSTANT)
    assert 40 < result.inflated < 140
    c = result.dcm @ rotation.to_dcm(rotation.exp(-result.state[:3]))
    q = rotation.from_dcm(segment.dcm_ni()[-1] @ c @ rotation.to_dcm(segment.rows.q[-1]))
    time_ns = round(segment.rows.time_s[-1] * 1e9)
    error = psi(q, true_attitude(flight, time_ns)[0])
    assert np.rad2deg(np.linalg.norm(error)) < 0.15


def test_second_pass_forgets_the_start():
    # Start 3 deg off: with the linearisation renewed the answer hardly knows.
    _, segment, dcm = started()
    grade = CONSTANT
    good = run(segment, dcm, grade)
    off = run(segment, dcm @ rotation.to_dcm(rotation.exp([0.03, -0.02, 0.04])), grade)

    def attitude(r):
        return r.dcm @ rotation.to_dcm(rotation.exp(-r.state[:3]))

    turn = rotation.log(rotation.from_dcm(attitude(off) @ attitude(good).T))
    assert np.rad2deg(np.linalg.norm(turn)) < 0.005


def test_unused_fixes_do_not_count():
    _, segment, dcm = started()
    use = np.ones(len(segment), dtype=bool)
    use[200:500] = False
    spoiled = segment.velocity_n.copy()
    spoiled[200:500] += 50.0
    other = type(segment)(**{**vars(segment), "velocity_n": spoiled})
    skipped = run(segment, dcm, CONSTANT, use=use)
    # The integral of beta uses all velocities, a little.
    beta = segment.beta() + (other.beta() - segment.beta()) * ~use[:, None]
    anyway = Refiner(segment.rows, beta, segment.sigma, use, CONSTANT)(dcm)
    np.testing.assert_array_equal(anyway.state, skipped.state)
    assert np.abs(skipped.state - run(segment, dcm, CONSTANT).state).max() > 0.0


def test_theta_between_rows():
    _, segment, dcm = started(end_s=60.0)
    result = run(segment, dcm, STILL)
    rows = segment.rows
    there = theta_at(result.state, rows.rows(slice(-1, None)), rows)
    np.testing.assert_array_equal(there[-1], result.state[:3])
    gain = rows.gyro_bias_attitude[0] - rows.gyro_bias_attitude[-1]
    scale = rows.gyro_scale_attitude[0] - rows.gyro_scale_attitude[-1]
    expected = result.state[:3] + gain @ result.state[9:12] + scale @ result.state[15:18]
    np.testing.assert_allclose(there[0], expected, rtol=1e-12)


def test_noise_of_the_model():
    # Nothing measured: biases stay as uncertain as they were, angle and velocity wander.
    _, segment, dcm = started()
    use = np.zeros(len(segment), dtype=bool)
    span = segment.rows.time_s[-1] - segment.rows.time_s[0]
    wandering = run(segment, dcm, replace(TACTICAL, bias_time_s=30.0), use=use)
    p = np.diag(wandering.covariance)
    np.testing.assert_allclose(p[6:9], TACTICAL.accel_bias**2)
    np.testing.assert_allclose(p[9:12], TACTICAL.gyro_bias**2)
    noise = SensorGrade(0.0, 0.0, 0.0, 0.0, angle_random_walk=1e-3, velocity_random_walk=1e-2)
    p = np.diag(run(segment, dcm, noise, use=use, start_sigma=0.01).covariance)
    np.testing.assert_allclose(p[:3], 0.01**2 + 1e-6 * span)
    still = SensorGrade(0.0, 0.0, 0.0, 0.0, angle_random_walk=0.0, velocity_random_walk=0.0)
    quiet = np.diag(run(segment, dcm, still, use=use, start_sigma=0.01).covariance)
    noise = SensorGrade(0.0, 0.0, 0.0, 0.0, angle_random_walk=0.0, velocity_random_walk=1e-2)
    p = np.diag(run(segment, dcm, noise, use=use, start_sigma=0.01).covariance)
    np.testing.assert_allclose(p[3:6] - quiet[3:6], 1e-4 * span, rtol=1e-6)


def test_answer_at_the_start_comes_from_the_backward_run():
    _, imu, gnss = noisy(4)
    grade = replace(TACTICAL, bias_time_s=20.0)
    answer = align_in_flight(imu, gnss, AlignmentSettings(refine=True, at="start", grade=grade))
    segment = segment_of(imu, gnss, (answer.t_q_ns - imu.time_ns[0]) * 1e-9)
    dcm = solve(segment, AlignmentSettings(grade=grade)).dcm
    back = run(segment, dcm, grade, latency_sigma=0.05, backward=True)
    ahead = run(segment, dcm, grade, latency_sigma=0.05)
    assert (back.row, ahead.row) == (0, len(segment) - 1)
    ours = np.linalg.eigvalsh(answer.cov) / max(1.0, back.chi2)  # that widens it
    np.testing.assert_allclose(ours, np.linalg.eigvalsh(back.covariance[:3, :3]), rtol=0.01)
    # Carried back from the end it is known less, as the biases were others then.
    first, last = segment.rows.rows(slice(0, 1)), segment.rows.rows(slice(-1, None))
    carried = theta_covariance(ahead.covariance, last, first, grade)
    assert np.trace(carried) > 1.05 * np.trace(answer.cov)
