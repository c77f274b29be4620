import mpmath
import numpy as np
import pytest
from scipy.integrate import quad_vec

from sinstool.core import rotation
from sinstool.simulation.coning import classical_coning
from sinstool.simulation.truth import check_times, sample_times

Q_NC = rotation.from_euler([0.5, -0.8, 2.2])
GRAVITY_N = np.array([-1e-3, 0.0, 9.81])
CASES = [(np.deg2rad(0.1), 30.0), (np.deg2rad(10.0), 1.0), (1.2, 4.5), (0.3, -7.0), (0.02, 230.0)]


def attitude(t, half_angle, frequency):
    """The definition, away from any grid."""
    p = 2 * np.pi * frequency * t
    s = np.sin(half_angle / 2)
    q_cb = [np.cos(half_angle / 2), s * np.cos(p), s * np.sin(p), 0.0]
    return rotation.multiply(Q_NC, q_cb)


def motion(half_angle, frequency, count=40):
    rng = np.random.default_rng(9)
    time_ns = 1_700_000_000_000_000_000 + np.cumsum(rng.integers(1_000_000, 4_000_000, size=count))
    truth = classical_coning(time_ns, half_angle, frequency, q_nc=Q_NC, gravity_n=GRAVITY_N)
    return truth, (time_ns - time_ns[0]) * 1e-9


@pytest.mark.parametrize(("half_angle", "frequency"), CASES)
def test_attitude_is_the_definition(half_angle, frequency):
    truth, t = motion(half_angle, frequency)
    expected = np.array([attitude(v, half_angle, frequency) for v in t])
    np.testing.assert_allclose(truth.q_nb, expected, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(truth.q_nb, axis=-1), 1.0, atol=1e-15)
    # the cone is of that half angle about the z axis of its frame
    axis = rotation.rotate(truth.q_nb, [0.0, 0.0, 1.0])
    along = axis @ rotation.rotate(Q_NC, [0.0, 0.0, 1.0])
    np.testing.assert_allclose(along, np.cos(half_angle), atol=1e-15)


@pytest.mark.parametrize(("half_angle", "frequency"), CASES)
def test_rate_is_the_derivative_of_the_attitude(half_angle, frequency):
    truth, t = motion(half_angle, frequency, count=8)
    with mpmath.workdps(40):
        a, f = mpmath.mpf(float(half_angle)), mpmath.mpf(float(frequency))
        turn = 2 * mpmath.pi * f
        for k, at in enumerate(t):

            def cone(s):
                return [
                    mpmath.cos(a / 2),
                    mpmath.sin(a / 2) * mpmath.cos(turn * s),
                    mpmath.sin(a / 2) * mpmath.sin(turn * s),
                    mpmath.mpf(0),
                ]

            at = mpmath.mpf(float(at))
            q = np.array([float(v) for v in cone(at)])
            d = np.array([float(mpmath.diff(lambda s, i=i: cone(s)[i], at)) for i in range(4)])
            rate = 2 * rotation.multiply(rotation.conjugate(q), d)
            scale = abs(2 * np.pi * frequency * half_angle)
            np.testing.assert_allclose(truth.gyro_rate[k], rate[1:], atol=1e-11 * scale)


@pytest.mark.parametrize(("half_angle", "frequency"), CASES)
def test_increments_are_the_integral_of_the_rate(half_angle, frequency):
    truth, t = motion(half_angle, frequency, count=12)

    def rate(s):
        p = 2 * np.pi * frequency * s
        x_y = 2 * np.pi * frequency * np.sin(half_angle)
        z = 2 * np.pi * frequency * (1 - np.cos(half_angle))
        return np.array([-x_y * np.sin(p), x_y * np.cos(p), -z])

    starts = np.concatenate([[t[0] - (t[1] - t[0])], t[:-1]])
    for k, (start, end) in enumerate(zip(starts, t, strict=True)):
        integral = quad_vec(rate, start, end, epsrel=1e-13)[0]
        scale = abs(2 * np.pi * frequency * half_angle) * (end - start)
        np.testing.assert_allclose(truth.gyro_increment[k], integral, atol=1e-10 * scale)
        assert truth.interval[k] == pytest.approx(end - start, rel=1e-9)
    np.testing.assert_allclose(
        truth.gyro_mean_rate * truth.interval[:, None], truth.gyro_increment, rtol=1e-15
    )


@pytest.mark.parametrize(("half_angle", "frequency"), CASES)
def test_specific_force_is_gravity_seen_from_the_body(half_angle, frequency):
    truth, t = motion(half_angle, frequency, count=12)
    expected = rotation.rotate(rotation.conjugate(truth.q_nb), -GRAVITY_N)
    np.testing.assert_allclose(truth.specific_force, expected, atol=1e-13)

    def force(s):
        q = attitude(s, half_angle, frequency)
        return rotation.rotate(rotation.conjugate(q), -GRAVITY_N)

    starts = np.concatenate([[t[0] - (t[1] - t[0])], t[:-1]])
    for k, (start, end) in enumerate(zip(starts, t, strict=True)):
        mean = quad_vec(force, start, end, epsrel=1e-12)[0] / (end - start)
        np.testing.assert_allclose(truth.mean_specific_force[k], mean, atol=1e-9)


def test_hours_later_the_phase_is_still_right():
    frequency = 30.0
    late = np.array([0, 5_000_000, 7_200_000_000_000, 7_200_005_000_000])  # two hours on
    truth = classical_coning(late, 0.01, frequency)
    np.testing.assert_array_equal(truth.q_nb[2:], truth.q_nb[:2])
    np.testing.assert_array_equal(truth.gyro_increment[3], truth.gyro_increment[1])


def test_level_and_still_is_gravity_alone():
    truth = classical_coning(sample_times(100.0, 1.0), 0.0, 5.0)
    np.testing.assert_array_equal(truth.gyro_increment, 0.0)
    np.testing.assert_allclose(truth.specific_force, np.tile([0, 0, -9.80665], (101, 1)))


def test_sample_times():
    times = sample_times(400.0, 10.0, start_ns=17)
    assert len(times) == 4001
    assert times[0] == 17
    assert times[-1] == 10_000_000_017
    third = sample_times(3.0, 1.0)
    np.testing.assert_array_equal(third, [0, 333_333_333, 666_666_667, 1_000_000_000])
    assert len(sample_times(10.0, 0.25)) == 3
    hour = sample_times(30.0, 3600.0)
    assert hour[-1] == 3_600_000_000_000  # rounding does not add up
    for bad in ((0.0, 1.0), (-1.0, 1.0), (10.0, 0.05)):
        with pytest.raises(ValueError, match=r"Hz|rate_hz"):
            sample_times(*bad)


def test_bad_arguments_are_refused():
    times = sample_times(100.0, 0.1)
    for bad in (times[:1], times * 1.0, times.reshape(1, -1)):
        with pytest.raises(ValueError, match="integers"):
            check_times(bad)
    with pytest.raises(ValueError, match="increase"):
        check_times(times[::-1])
    with pytest.raises(ValueError, match="shapes"):
        classical_coning(times, 0.1, 1.0, q_nc=np.ones((2, 4)))
    with pytest.raises(ValueError, match="shapes"):
        classical_coning(times, 0.1, 1.0, gravity_n=9.8)
