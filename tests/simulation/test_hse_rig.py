from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad_vec

from sinstool.core import rotation
from sinstool.core.earth import earth_rate_n, gravity_n
from sinstool.simulation.hse_rig import HseRigErrors, HseRigSetup, hse_rig
from sinstool.simulation.turntable import TableProfile

ARCSEC = np.pi / 648000.0
SETUP = HseRigSetup(
    latitude=-0.6,
    heading=2.1,
    theta=0.02,
    gamma=-0.03,
    axis=(-0.6, -0.48, -0.64),
    K_g=((1.01, 0.0, 0.0), (0.02, 0.99, 0.0), (-0.01, 0.03, 1.02)),
    imu_rate=20.0,
    encoder_rate=10.0,
)
WALK = [(0.3, 4.0), (-0.5, 5.0)]


def test_profile_is_continuous_and_its_own_integral():
    profile = TableProfile([(0.3, 4.0), (-0.5, 5.0), (-0.5, 1.0)], 0.2)
    assert profile.duration == pytest.approx(14.0)
    t = np.linspace(-1.0, 15.0, 32001)
    angle, rate, acceleration = profile.angle(t)
    h = t[1] - t[0]
    np.testing.assert_allclose(np.gradient(angle, h)[1:-1], rate[1:-1], atol=0.2 * h)
    inside = np.abs(np.diff(acceleration)) == 0
    np.testing.assert_allclose((np.diff(rate) / h)[inside], acceleration[:-1][inside], atol=1e-9)
    assert angle[t == 0.0] == 0.0
    assert rate[-1] == -0.5
    assert set(np.unique(acceleration)) == {-0.2, 0.0}


def test_samples_are_means_of_eq_5_over_their_intervals():
    # through a ramp and a ripple, from truth by adaptive quadrature
    errors = HseRigErrors(ripple=0.05, ripple_order=3, lever_arm=(0.1, -0.2, 0.3))
    log = hse_rig(WALK, SETUP, errors, acceleration=0.2, start_angle=1.1)
    profile = TableProfile(WALK, 0.2)
    C_nb0 = rotation.to_dcm(rotation.from_euler([SETUP.gamma, SETUP.theta, SETUP.heading]))
    np.testing.assert_allclose(log.truth.C_nb0, C_nb0, atol=1e-15)
    z = np.array(SETUP.axis)
    y = np.cross(z, [1, 0, 0]) / np.linalg.norm(np.cross(z, [1, 0, 0]))
    C_b_to_s = np.stack([np.cross(y, z), y, z]).T
    arm = np.array(errors.lever_arm)

    def motion(t):
        angle, rate, acceleration = (float(v) for v in profile.angle(t))
        angle += 1.1
        phase, gain = 3 * angle, 1 + 0.05 * np.cos(3 * angle)
        acceleration = acceleration * gain - 0.05 * 3 * np.sin(phase) * rate**2
        return angle + 0.05 / 3 * np.sin(phase), rate * gain, acceleration

    def samples(t):
        angle, rate, acceleration = motion(t)
        C_nb = C_nb0 @ rotation.to_dcm(rotation.exp([0, 0, angle]))
        omega, turning = np.array([0, 0, rate]), np.array([0, 0, acceleration])
        gyro = np.linalg.solve(SETUP.K_g, C_b_to_s @ (C_nb.T @ earth_rate_n(-0.6) + omega))
        lever = np.cross(turning, arm) + np.cross(omega, np.cross(omega, arm))
        return np.concatenate([gyro, C_b_to_s @ (C_nb.T @ -gravity_n(-0.6) + lever)])

    for k in (0, 40, 97, 130, 259):  # plateaus and ramp, none across a corner
        mean = quad_vec(samples, k * 0.05, (k + 1) * 0.05, epsabs=1e-13)[0] / 0.05
        np.testing.assert_allclose(log.gyro[k], mean[:3], rtol=0, atol=1e-13)
        np.testing.assert_allclose(log.accel[k], mean[3:], rtol=0, atol=1e-11)
        angle, rate, _ = motion((k + 1) * 0.05)
        assert log.truth.alpha[k] == pytest.approx(angle, abs=1e-13)
        assert log.truth.rate[k] == pytest.approx(rate, abs=1e-13)
        C_nb = C_nb0 @ rotation.to_dcm(rotation.exp([0, 0, angle]))
        np.testing.assert_allclose(rotation.to_dcm(log.truth.q_nb[k]), C_nb, atol=1e-14)


def test_nothing_is_lost_between_samples_at_high_rate():
    # few and slow samples: the quadrature must hold for a third of a turn in one of them
    log = hse_rig([(200 * np.pi / 180, 20.0)], replace(SETUP, imu_rate=2.0))
    angle = 0.3 + 200 * np.pi / 180 * np.arange(41) / 2.0
    u = log.truth.C_nb0.T @ earth_rate_n(-0.6)
    cos, sin = np.diff(np.sin(angle)) / np.diff(angle), -np.diff(np.cos(angle)) / np.diff(angle)
    in_b = log.gyro @ np.array(SETUP.K_g).T @ log.truth.C_s_to_b.T
    np.testing.assert_allclose(in_b[:, 0], cos * u[0] + sin * u[1], rtol=0, atol=2e-15)
    np.testing.assert_allclose(in_b[:, 1], cos * u[1] - sin * u[0], rtol=0, atol=2e-15)


def test_stamps():
    log = hse_rig(WALK, SETUP, acceleration=0.2)
    assert log.time_ns.dtype == np.int64
    np.testing.assert_array_equal(np.diff(log.time_ns), 50_000_000)
    assert log.time_ns[0] == SETUP.epoch_ns + 50_000_000
    assert log.encoder_time_ns[0] == SETUP.epoch_ns
    for stamp, first in (("mid", 25_000_000), ("start", 0)):
        other = hse_rig(WALK, replace(SETUP, imu_stamp=stamp), acceleration=0.2)
        assert other.time_ns[0] - SETUP.epoch_ns == first
        np.testing.assert_array_equal(other.gyro, log.gyro)
    fast = hse_rig(WALK, SETUP, HseRigErrors(clock=1e-3), acceleration=0.2)
    np.testing.assert_allclose(np.diff(fast.time_ns), 50_050_000, atol=1)
    assert fast.truth.lambda2 == pytest.approx(-3e-3)


def test_encoder():
    clean = hse_rig(WALK, SETUP, HseRigErrors(encoder_wrap="none"), acceleration=0.2)
    true = TableProfile(WALK, 0.2).angle(np.arange(131) / 10.0)[0] + 0.3
    np.testing.assert_allclose(clean.encoder_position, true, atol=1e-13)
    errors = HseRigErrors(
        encoder_sign=-1, encoder_offset=0.2, encoder_lsb=1e-3, encoder_degrees=True,
        encoder_harmonics=((2, 5e-3, 0.4),),
    )  # fmt: skip
    log = hse_rig(WALK, SETUP, errors, acceleration=0.2)
    reading = -(true - 0.2)
    reading = reading + 5e-3 * np.sin(2 * reading + 0.4)
    reading = np.mod(1e-3 * np.round(reading / 1e-3), 2 * np.pi)
    np.testing.assert_allclose(log.encoder_position, np.degrees(reading), atol=1e-9)
    half = hse_rig(WALK, SETUP, HseRigErrors(encoder_wrap="half-turn"), acceleration=0.2)
    assert -np.pi <= half.encoder_position.min() < half.encoder_position.max() < np.pi
    stale = hse_rig(
        [(0.3, 9.0)], SETUP, HseRigErrors(encoder_delay=0.1, encoder_wrap="none"), start_angle=0.3
    )
    np.testing.assert_allclose(stale.encoder_position[5], 0.3 + 0.3 * 0.4, atol=1e-13)


def test_noise_has_the_size_that_is_asked_for():
    arw, vrw, drift = 1e-5, 2e-3, 3e-6
    setup = replace(SETUP, imu_rate=100.0)
    clean = hse_rig([(0.5, 600.0)], setup)
    noisy = hse_rig(
        [(0.5, 600.0)],
        setup,
        HseRigErrors(
            angle_random_walk=arw, velocity_random_walk=vrw, encoder_jitter=1e-3, imu_jitter=1e-4,
            gyro_bias=(1e-5, -2e-5, 3e-5), accel_bias=(0.1, 0.2, -0.3),
        ),
        seed=4,
    )  # fmt: skip
    gyro, accel = noisy.gyro - clean.gyro, noisy.accel - clean.accel
    np.testing.assert_allclose(gyro.std(axis=0), arw * 10.0, rtol=0.02)
    np.testing.assert_allclose(accel.std(axis=0), vrw * 10.0, rtol=0.02)
    np.testing.assert_allclose(gyro.mean(axis=0), [1e-5, -2e-5, 3e-5], atol=5 * arw / np.sqrt(600))
    np.testing.assert_allclose(accel.mean(axis=0), [0.1, 0.2, -0.3], atol=5 * vrw / np.sqrt(600))
    assert np.std((noisy.time_ns - clean.time_ns) * 1e-9) == pytest.approx(1e-4, rel=0.02)
    assert np.std((noisy.encoder_time_ns - clean.encoder_time_ns) * 1e-9) > 5e-4
    assert (np.diff(noisy.encoder_time_ns) >= 0).all()
    wandering = hse_rig(
        [(0.5, 3000.0)],
        replace(setup, imu_rate=10.0),
        HseRigErrors(gyro_drift=drift, gyro_drift_time_s=10.0),
    )
    steady = hse_rig([(0.5, 3000.0)], replace(setup, imu_rate=10.0))
    process = wandering.gyro - steady.gyro
    np.testing.assert_allclose(process.std(axis=0), drift, rtol=0.25)
    later = (process[100:] * process[:-100]).mean(axis=0) / (process**2).mean(axis=0)
    np.testing.assert_allclose(later, np.exp(-1.0), atol=0.2)
    again = hse_rig([(0.5, 60.0)], setup, HseRigErrors(angle_random_walk=arw), seed=9)
    same = hse_rig([(0.5, 60.0)], setup, HseRigErrors(angle_random_walk=arw), seed=9)
    np.testing.assert_array_equal(again.gyro, same.gyro)


def test_quantised_gyro_loses_no_angle():
    quantum = 1e-4
    clean = hse_rig(WALK, SETUP, acceleration=0.2)
    log = hse_rig(WALK, SETUP, HseRigErrors(gyro_quantum=quantum), acceleration=0.2)
    counts = log.gyro * 0.05 / quantum
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    lost = np.cumsum(log.gyro - clean.gyro, axis=0) * 0.05
    assert 0.45 * quantum < np.abs(lost).max() < 0.5001 * quantum


def test_believed_calibration_is_eqs_1_and_2():
    setup = replace(
        SETUP, epsilon=(1e-5, 2e-5, -3e-5), kappa=(4e-6, 5e-6, 6e-6), xi=(1e-4, 2e-4, 3e-4)
    )
    log = hse_rig(WALK, setup, HseRigErrors(gyro_scale=2e-6), acceleration=0.2)
    lam = np.array([[4e-6, 0, 0], [1e-5, 5e-6, 0], [2e-5, -3e-5, 6e-6]])
    np.testing.assert_allclose(log.believed_K_g, (np.eye(3) + lam) @ setup.K_g, atol=1e-16)
    turn = np.cross(np.array(setup.xi), log.truth.C_s_to_b.T).T  # columns: xi x column
    np.testing.assert_allclose(log.believed_C_s_to_b, log.truth.C_s_to_b - turn, atol=1e-16)
    # what the user computes of the rates differs from the truth by X
    omega_b = np.array([1e-5, -2e-5, 0.7])
    raw = np.linalg.solve(setup.K_g, log.truth.C_s_to_b.T @ omega_b) * (1 + 2e-6)
    computed = log.believed_C_s_to_b @ log.believed_K_g @ raw
    np.testing.assert_allclose(computed - omega_b, log.truth.X @ omega_b, atol=1e-15)
    e = np.array(setup.axis)
    assert log.truth.lambda2 == pytest.approx(-3 * (e @ lam @ e + 2e-6), rel=2e-2)


def test_base_that_turns():
    rate = np.array([3e-4, -5e-4, 2e-4])
    log = hse_rig([(0.3, 9.0)], SETUP, HseRigErrors(base_drift_n=tuple(rate)))
    back = rotation.to_dcm(
        rotation.multiply(log.truth.q_nb, rotation.exp([0.0, 0.0, -1.0] * log.truth.alpha[:, None]))
    )
    t = (np.arange(180) + 1) * 0.05 - 4.5
    want = rotation.to_dcm(rotation.exp(rate * t[:, None])) @ log.truth.C_nb0
    np.testing.assert_allclose(back, want, atol=1e-13)
    # the gyros see it turn beside the Earth, the accelerometers lean with it
    in_b = log.gyro @ np.array(SETUP.K_g).T @ log.truth.C_s_to_b.T
    k = 89
    C_nb = rotation.to_dcm(rotation.multiply(log.truth.q_nb[k], rotation.exp([0, 0, -0.3 * 0.025])))
    np.testing.assert_allclose(
        in_b[k] - [0, 0, 0.3], C_nb.T @ (earth_rate_n(-0.6) + rate), atol=2e-8
    )
    force = log.accel[k] @ log.truth.C_s_to_b.T
    np.testing.assert_allclose(force, C_nb.T @ -gravity_n(-0.6), atol=2e-4)


def test_impossible_settings_are_refused():
    with pytest.raises(ValueError, match="axis"):
        hse_rig(WALK, replace(SETUP, axis=(1.0, 1.0, 1.0)))
    with pytest.raises(ValueError, match="fewer than two"):
        hse_rig([(0.3, 0.05)], SETUP)
