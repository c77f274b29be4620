import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sinstool.core import rotation
from sinstool.methods.alignment.accumulation import (
    accumulate,
)
from sinstool.methods.alignment.pairs import velocity_gains
from sinstool.methods.alignment.reference import dcm_ni, velocity_reference
from sinstool.simulation.gnss import Receiver
from tests.methods.alignment.launches import PERFECT, exact, true_attitude

BETWEEN = Receiver(errors=PERFECT, offset_s=0.0173)


def rows_of(imu, gnss, scale=1.0, bias=(0.0, 0.0), gains=(0.0, 0.0)):
    step = np.diff(imu.time_ns, prepend=2 * imu.time_ns[0] - imu.time_ns[1])[:, None] * 1e-9
    return accumulate(
        imu.time_ns,
        imu.delta_theta * (1.0 + np.asarray(gains[0])) + np.asarray(bias[0]) * step,
        imu.delta_velocity * (1.0 + np.asarray(gains[1])) + np.asarray(bias[1]) * step,
        gnss.time_ns,
        int(imu.time_ns[0]),
    )


@pytest.mark.parametrize("receiver", [Receiver(errors=PERFECT), BETWEEN], ids=["on", "between"])
def test_integrals_against_the_flight(receiver):
    # Boost with rolls, coning and vibration included. One constant rotation takes all of the
    # inertial side into the GNSS side; the flight comes from quadrature of given functions.
    flight, imu, gnss = exact(receiver, duration_s=60.0)
    rows = rows_of(imu, gnss)
    assert len(rows) == len(gnss.time_ns)
    beta = velocity_reference(
        rows.time_s, gnss.latitude, gnss.longitude, gnss.height, gnss.velocity_n
    )
    c_nb = rotation.to_dcm(true_attitude(flight, gnss.time_ns))
    c_ni = dcm_ni(gnss.latitude, gnss.longitude, rows.time_s)
    constant = np.swapaxes(c_ni, 1, 2) @ c_nb @ np.swapaxes(rotation.to_dcm(rows.q), 1, 2)
    assert np.abs(constant - constant[0]).max() < 1e-5
    alpha = (rows.alpha - rows.alpha[0]) @ constant[-1].T
    assert np.linalg.norm(alpha[-1]) > 800.0
    assert np.abs(alpha - beta).max() < (2e-3 if receiver is not BETWEEN else 1.5e-2)


def test_sensitivities_are_derivatives():
    _, imu, gnss = exact(BETWEEN, duration_s=60.0)
    rows = rows_of(imu, gnss)
    gains = velocity_gains(rows)
    for axis in range(3):
        unit = np.eye(3)[axis]
        cases = (
            ({"bias": (0.0 * unit, 1e-4 * unit)}, 1e-4, 0, 1.0, None),
            ({"gains": (0.0 * unit, 1e-5 * unit)}, 1e-5, 1, 1.0, None),
            ({"bias": (1e-7 * unit, 0.0 * unit)}, 1e-7, 2, -1.0, rows.gyro_bias_attitude),
            ({"gains": (1e-7 * unit, 0.0 * unit)}, 1e-7, 3, -1.0, rows.gyro_scale_attitude),
        )
        for change, size, which, sign, attitude in cases:
            other = rows_of(imu, gnss, **change)
            slope = (other.alpha - rows.alpha) / size
            largest = np.abs(gains[:, which]).max()
            assert np.abs(slope - sign * gains[:, which, :, axis]).max() < 2e-3 * largest
            turned = rotation.log(rotation.multiply(other.q, rotation.conjugate(rows.q))) / size
            if attitude is None:
                np.testing.assert_array_equal(other.q, rows.q)
            else:
                assert np.abs(turned - attitude[:, :, axis]).max() < 2e-3 * np.abs(attitude).max()


def test_twice_integrated():
    _, imu, gnss = exact(BETWEEN, duration_s=60.0)
    rows = rows_of(imu, gnss)
    step = np.diff(rows.time_s)[:, None]
    # Simpson on alpha, its values half way from rows asked for there.
    middle = (gnss.time_ns[:-1] + gnss.time_ns[1:]) // 2
    half = accumulate(imu.time_ns, imu.delta_theta, imu.delta_velocity, middle, int(imu.time_ns[0]))
    simpson = step / 6.0 * (rows.alpha[:-1] + 4.0 * half.alpha + rows.alpha[1:])
    assert np.abs(np.diff(rows.xi, axis=0) - simpson).max() < 2e-3
    assert np.linalg.norm(rows.xi[-1]) > 1e4


def test_force_and_rate_between_samples():
    flight, imu, gnss = exact(BETWEEN, duration_s=60.0)
    rows = rows_of(imu, gnss)
    calm = rows.time_s > 37.0
    t = flight.time_ns * 1e-9
    for axis in range(3):
        force = np.interp(rows.time_s, t, flight.imu.specific_force[:, axis])
        rate = np.interp(rows.time_s, t, flight.imu.gyro_rate[:, axis])
        turning = rotation.to_dcm(rows.q).swapaxes(1, 2) @ rows.swing
        turning = turning[:, axis - 1, axis - 2]
        assert np.abs(rows.force_b[calm, axis] - force[calm]).max() < 1e-3
        assert np.abs(turning[calm] - rate[calm]).max() < 1e-4


def test_coning_and_sculling():
    # A cone of 1 deg at 15 Hz, sampled at 200 Hz, under a force that is constant in inertial
    # axes. All is known in closed form; what is left is of the order of the algorithm's own
    # error, a hundredth of what coning and sculling come to.
    half, turn = np.deg2rad(1.0), 2.0 * np.pi * 15.0
    force = np.array([12.0, -4.0, -30.0])

    def attitude(t):
        s = np.sin(0.5 * half)
        zero = np.zeros_like(t)
        cosine = np.full_like(t, np.cos(0.5 * half))
        return np.stack([cosine, zero, s * np.cos(turn * t), s * np.sin(turn * t)], axis=-1)

    def angle(t):  # integral of the body's rate
        a, b = turn * (1.0 - np.cos(half)), np.sin(half)
        return np.stack([-a * t, b * np.cos(turn * t), b * np.sin(turn * t)], axis=-1)

    time = np.arange(1001) * 5_000_000
    t = time * 1e-9
    theta = np.diff(angle(t), axis=0, prepend=angle(t[:1] - 0.005))
    nodes, weights = np.polynomial.legendre.leggauss(6)
    at = t[:, None] - 0.0025 + 0.0025 * nodes
    felt = rotation.rotate(rotation.conjugate(attitude(at)), force)
    velocity = 0.0025 * np.einsum("kjc,j->kc", felt, weights)
    times = np.sort(np.random.default_rng(5).integers(0, time[-1], size=300))
    rows = accumulate(time, theta, velocity, times, 0)
    start = attitude(t[:1])[0]
    result = rotation.multiply(start, rows.q)
    true = attitude(times * 1e-9)
    error = rotation.log(rotation.multiply(rotation.conjugate(true), result))
    cone = turn * (1.0 - np.cos(half)) * t[-1]
    assert np.abs(error).max() < 0.03 * cone / 5.0  # 7e-2 rad in all without the coning term
    alpha = rotation.rotate(start, rows.alpha)
    assert np.abs(alpha - force * (times * 1e-9)[:, None]).max() < 0.02


def test_inside_an_interval_rate_and_force_are_linear():
    # Rate and force linear in time: increments of parts are exact, and so is coning within.
    a, b = np.array([0.4, -0.2, 0.3]), np.array([1.0, 4.0, -6.0])
    f, g = np.array([3.0, -9.0, 20.0]), np.array([-50.0, 30.0, 80.0])

    def equation(t, x):
        force = rotation.rotate(x[:4], f + g * t)
        return np.concatenate(
            [0.5 * rotation.multiply(x[:4], np.concatenate([[0.0], a + b * t])), force]
        )

    time = np.arange(41) * 10_000_000
    t = time[:, None] * 1e-9
    theta = np.diff(a * t + 0.5 * b * t * t, axis=0, prepend=0.0)
    velocity = np.diff(f * t + 0.5 * g * t * t, axis=0, prepend=0.0)
    # Row 0 is history: over the interval before.
    theta[0], velocity[0] = (0.01 * u - 0.5e-4 * v for u, v in ((a, b), (f, g)))
    times = np.arange(5, 395, 3) * 1_000_000
    rows = accumulate(time, theta, velocity, times, 0)
    start = np.concatenate([[1.0, 0.0, 0.0, 0.0], np.zeros(3)])
    true = solve_ivp(
        equation, (0.0, 0.4), start, method="DOP853", t_eval=times * 1e-9, rtol=1e-13, atol=1e-14
    ).y.T
    error = rotation.log(rotation.multiply(rotation.conjugate(true[:, :4]), rows.q))
    assert np.abs(error).max() < 2e-8
    assert np.abs(rows.alpha - true[:, 4:]).max() < 2e-6


def test_antenna():
    flight, imu, gnss = exact(BETWEEN, duration_s=60.0)
    rows = rows_of(imu, gnss)
    lever = np.array([2.0, -1.0, 0.5])
    moved = rows.at_antenna(lever)
    c = rotation.to_dcm(rows.q)
    np.testing.assert_allclose(moved.xi - rows.xi, c @ lever, atol=1e-9)
    seconds = flight.time_ns * 1e-9
    rate = np.column_stack([np.interp(rows.time_s, seconds, x) for x in flight.imu.gyro_rate.T])
    expected = np.einsum("nij,nj->ni", c, np.cross(rate, lever))
    calm = rows.time_s > 37.0
    assert np.abs(moved.alpha - rows.alpha - expected)[calm].max() < 1e-3
    assert np.abs(moved.alpha - rows.alpha).max() > 2.0  # the roll of the boost
    assert rows.at_antenna((0.0, 0.0, 0.0)) is rows


def test_uneven_intervals():
    # Constant rate and force in the body are exact for any intervals.
    rng = np.random.default_rng(3)
    time = np.cumsum(rng.integers(2_000_000, 40_000_000, size=400))
    step = np.diff(time, prepend=0)[:, None] * 1e-9
    rate, force = np.array([0.9, -1.4, 0.6]), np.array([3.0, -20.0, 8.0])
    times = np.sort(rng.integers(time[0], time[-1], size=50))
    rows = accumulate(time, rate * step, force * step, times, int(time[0]))
    elapsed = (times - time[0])[:, None] * 1e-9
    error = rotation.log(
        rotation.multiply(rotation.conjugate(rotation.exp(rate * elapsed)), rows.q)
    )
    assert np.abs(error).max() < 1e-12
    angle = np.linalg.norm(rate)
    u = rate / angle
    a = angle * elapsed
    along = u * (u @ force)
    expected = (
        elapsed * along
        + np.sin(a) / angle * (force - along)
        + (1.0 - np.cos(a)) / angle * np.cross(u, force)
    )
    assert np.abs(rows.alpha - expected).max() < 1e-5


def test_repeated_times_and_early_epochs_are_passed_over():
    _, imu, gnss = exact(duration_s=60.0)
    twice = np.repeat(np.arange(2000), 2)
    origin = int(imu.time_ns[0])
    times = np.concatenate([[origin - 5, origin], gnss.time_ns[1:90]])
    once = accumulate(
        imu.time_ns[:2000], imu.delta_theta[:2000], imu.delta_velocity[:2000], times, origin
    )
    again = accumulate(
        imu.time_ns[twice], imu.delta_theta[twice], imu.delta_velocity[twice], times, origin
    )
    assert len(once) == 90
    np.testing.assert_array_equal(again.alpha, once.alpha)
    np.testing.assert_array_equal(once.q[0], [1.0, 0.0, 0.0, 0.0])


def test_wrong_input():
    nothing = np.zeros((0, 3))
    with pytest.raises(ValueError, match="increasing"):
        accumulate([], nothing, nothing, [5, 3], 0)
    assert len(accumulate([], nothing, nothing, [5], 0)) == 0
