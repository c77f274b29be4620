import numpy as np
import pytest
from scipy.integrate import quad_vec

from sinstool.core import rotation
from sinstool.simulation.coning import classical_coning
from sinstool.simulation.motions import (
    Sinusoids,
    broadband,
    quadrature_nodes,
    random_manoeuvre,
    sample,
    two_frequency,
)
from sinstool.simulation.truth import sample_times
from tests.helpers.thinned import thin

Q_NM = rotation.from_euler([0.5, -0.8, 2.2])
GRAVITY_N = np.array([-1e-3, 0.0, 9.81])
OPTIONS = {"q_nm": Q_NM, "gravity_n": GRAVITY_N}


def irregular(count=40, seed=9, longest=4_000_000):
    steps = np.random.default_rng(seed).integers(1_000_000, longest, size=count)
    return 1_700_000_000_000_000_000 + np.cumsum(steps)


def motion(angle=0.6, seed=3):
    """A rotation vector that passes through large and small angles, fast."""
    rng = np.random.default_rng(seed)
    shape = (5, 3)
    return Sinusoids(
        rng.uniform(0.5, 60.0, 5), angle * rng.normal(size=shape), angle * rng.normal(size=shape)
    )


def rotation_vector(chosen, t):
    phase = 2 * np.pi * chosen.frequency * t
    return np.sin(phase) @ chosen.sine + np.cos(phase) @ chosen.cosine


def body_rate(chosen, t, step=1e-4):
    """Rate from attitudes close by, Richardson's extrapolation of central differences."""

    def central(h):
        q = [rotation.exp(rotation_vector(chosen, t + s * h)) for s in (-1, 1)]
        return rotation.log(rotation.multiply(rotation.conjugate(q[0]), q[1])) / (2 * h)

    coarse, middle, fine = (central(step / 2**k) for k in range(3))
    better = [(4 * b - a) / 3 for a, b in ((coarse, middle), (middle, fine))]
    return (16 * better[1] - better[0]) / 15


@pytest.mark.parametrize("angle", [1e-5, 0.02, 0.6])
def test_attitude_is_the_definition_and_rate_its_derivative(angle):
    chosen = motion(angle)
    times = irregular()
    truth = sample(chosen, times, **OPTIONS)
    for k, t in enumerate((times - times[0]) * 1e-9):
        q = rotation.multiply(Q_NM, rotation.exp(rotation_vector(chosen, t)))
        np.testing.assert_allclose(truth.q_nb[k], q, atol=1e-12)
        scale = np.abs(truth.gyro_rate).max()
        np.testing.assert_allclose(truth.gyro_rate[k], body_rate(chosen, t), atol=1e-7 * scale)
        force = rotation.rotate(rotation.conjugate(q), -GRAVITY_N)
        np.testing.assert_allclose(truth.specific_force[k], force, atol=1e-11)


@pytest.mark.parametrize("longest", [4_000_000, 2_000_000])
def test_increments_are_the_integral_of_the_rate(longest):
    chosen = motion()
    times = irregular(10, longest=longest)
    truth = sample(chosen, times, **OPTIONS)

    def values(ns_before_end, end):
        # the rate at any instant, by asking for samples there
        at = np.array([times[0], end - round(ns_before_end)])
        result = sample(chosen, at if at[1] > at[0] else at[::-1], **OPTIONS, nodes=4)
        row = 1 if at[1] > at[0] else 0
        return np.concatenate([result.gyro_rate[row], result.specific_force[row]])

    for k in (3, 9):
        start, end = int(times[k - 1]), int(times[k])
        # 20 Gauss-Legendre nodes on each of two halves, apart from the 1 ns of their rounding
        total = np.zeros(6)
        at, weights = np.polynomial.legendre.leggauss(20)
        for half in (0.25, 0.75):
            for place, weight in zip(at, weights, strict=True):
                back = (end - start) * (half + 0.25 * place)
                total += 0.25 * weight * values(back, end)
        seconds = (end - start) * 1e-9
        scale = np.abs(truth.gyro_rate).max()
        np.testing.assert_allclose(truth.gyro_mean_rate[k], total[:3], atol=3e-7 * scale)
        np.testing.assert_allclose(truth.mean_specific_force[k], total[3:], atol=1e-5)
        np.testing.assert_allclose(truth.gyro_increment[k], truth.gyro_mean_rate[k] * seconds)
        assert truth.interval[k] == seconds


@pytest.mark.parametrize("regular", [True, False])
def test_twice_the_nodes_change_nothing(regular):
    chosen = motion()
    times = sample_times(200.0, 0.4) if regular else irregular(80)
    usual, doubled = sample(chosen, times), sample(chosen, times, nodes=48)
    scale = np.abs(usual.gyro_mean_rate).max()
    np.testing.assert_allclose(usual.gyro_mean_rate, doubled.gyro_mean_rate, atol=1e-12 * scale)
    np.testing.assert_allclose(
        usual.mean_specific_force, doubled.mean_specific_force, atol=1e-12 * 9.81
    )
    # and it is not that nodes do not matter
    few = sample(chosen, times, nodes=3)
    assert np.abs(few.gyro_mean_rate - doubled.gyro_mean_rate).max() > 1e-6 * scale


def test_node_count_keeps_its_promise():
    for turn in (0.1, 2.0, 9.0, 40.0):
        n = quadrature_nodes(turn)
        at, weights = np.polynomial.legendre.leggauss(n)
        result = weights @ np.cos(0.5 * turn * at + 0.3)
        exact = 2 * np.cos(0.3) * np.sinc(turn / 2 / np.pi)
        assert abs(result - exact) < 5e-14
    assert quadrature_nodes(0.0) == 4
    assert quadrature_nodes(9.0) < quadrature_nodes(40.0) < 60


@pytest.mark.parametrize("frequency", [7.0, -30.0, 530.0])
def test_one_of_two_frequencies_is_classical_coning(frequency):
    times = irregular()
    one = sample(two_frequency((0.2, 0.0), (frequency, 11.0)), times, **OPTIONS)
    # phi = a [sin, cos, 0] is the cone turning the other way, a quarter of a turn on
    turned = rotation.multiply(Q_NM, rotation.exp([0.0, 0.0, np.pi / 2]))
    cone = classical_coning(times, 0.2, -frequency, q_nc=turned, gravity_n=GRAVITY_N)
    back = rotation.exp([0.0, 0.0, -np.pi / 2])
    np.testing.assert_allclose(one.q_nb, rotation.multiply(cone.q_nb, back), atol=1e-11)
    for name in ("gyro_rate", "gyro_mean_rate", "gyro_increment", "specific_force",
                 "mean_specific_force"):  # fmt: skip
        expected = rotation.rotate(rotation.conjugate(back), getattr(cone, name))
        scale = np.abs(expected).max()
        np.testing.assert_allclose(getattr(one, name), expected, atol=1e-10 * scale)


def test_two_frequencies_are_both_there():
    truth = sample(two_frequency((0.002, 0.001), (30.0, 130.0)), sample_times(400.0, 2.0))
    spectrum = np.abs(np.fft.rfft(truth.gyro_rate[:800, 0])) / 400
    for frequency, angle in ((30, 0.002), (130, 0.001)):
        size = 2 * np.pi * frequency * angle
        assert spectrum[2 * frequency] == pytest.approx(size, rel=1e-3)


def test_broadband_has_its_band_and_size():
    times = sample_times(1000.0, 8.0)
    truth = sample(broadband(1e-3, (20.0, 150.0), seed=2), times, **OPTIONS)
    phi = rotation.log(rotation.multiply(rotation.conjugate(Q_NM), truth.q_nb))
    np.testing.assert_allclose(np.std(phi, axis=0), [1e-3, 1e-3, 0.0], atol=2e-5)
    power = np.abs(np.fft.rfft(truth.gyro_rate[:8000] * np.hanning(8000)[:, None], axis=0)) ** 2
    frequency = np.fft.rfftfreq(8000, 1e-3)
    outside = (frequency < 19.0) | (frequency > 151.0)
    assert power[outside, :2].sum() < 1e-5 * power[:, :2].sum()
    # flat in rate: each third of the band has its third
    inside = power[(frequency >= 20) & (frequency < 150), 0]
    shares = [part.sum() for part in np.array_split(inside, 3)] / inside.sum()
    np.testing.assert_allclose(shares, 1 / 3, atol=0.1)
    # the gyro's z axis turns the other way than the cone, on average
    assert truth.gyro_rate[:, 2].mean() > 0
    same = sample(broadband(1e-3, seed=2), times[:50]).gyro_rate
    np.testing.assert_array_equal(sample(broadband(1e-3, seed=2), times[:50]).gyro_rate, same)
    assert np.abs(sample(broadband(1e-3, seed=4), times[:50]).gyro_rate - same).max() > 0.01


def test_manoeuvre_has_its_rate():
    truth = sample(random_manoeuvre(5.0, (1.0, 8.0), seed=5), sample_times(200.0, 60.0))
    rms = np.sqrt(np.mean(np.sum(truth.gyro_rate**2, axis=1)))
    assert rms == pytest.approx(5.0, rel=0.1)
    np.testing.assert_array_less(0.5, truth.gyro_rate.std(axis=0))
    assert np.abs(truth.gyro_rate).max() < 25.0


def test_aliasing_is_that_of_point_rates_only():
    # 400 Hz seen at 400 Hz: a constant for point rates, nothing for increments
    truth = sample(two_frequency((1e-4, 0.0), (400.0, 1.0)), sample_times(400.0, 1.0))
    np.testing.assert_allclose(truth.gyro_rate[:, 0], 2 * np.pi * 400 * 1e-4, rtol=1e-6)
    assert np.abs(truth.gyro_mean_rate[:, :2]).max() < 1e-12


def test_thinned_is_sampled_slower():
    chosen = motion()
    fast = sample(chosen, sample_times(800.0, 0.5), **OPTIONS)
    slow = thin(fast, 4)
    assert len(slow.time_ns) == 100
    np.testing.assert_array_equal(slow.time_ns, fast.time_ns[3:400:4])
    np.testing.assert_allclose(slow.interval, 0.005, rtol=1e-12)
    np.testing.assert_array_equal(slow.q_nb, fast.q_nb[3:400:4])
    # as if it had been sampled at those instants: phases are those at the first
    late = 0.00375
    moved = chosen.delayed(-late)
    direct = sample(moved, slow.time_ns, **OPTIONS)
    np.testing.assert_allclose(direct.q_nb, slow.q_nb, atol=1e-11)
    for name in ("gyro_rate", "gyro_mean_rate", "gyro_increment", "mean_specific_force"):
        scale = np.abs(getattr(direct, name)).max()
        np.testing.assert_allclose(
            getattr(slow, name), getattr(direct, name), atol=1e-10 * scale, err_msg=name
        )
    with pytest.raises(ValueError, match="fewer than two"):
        thin(fast, 300)
    with pytest.raises(ValueError, match="fewer than two"):
        thin(fast, 0)


def test_hours_later_the_phase_is_still_right():
    chosen = Sinusoids(np.array([30.0]), np.full((1, 3), 0.01), np.zeros((1, 3)))
    late = np.array([0, 5_000_000, 7_200_000_000_000, 7_200_005_000_000])
    truth = sample(chosen, late, nodes=8)
    np.testing.assert_array_equal(truth.q_nb[2:], truth.q_nb[:2])
    # a row of its own duration: quadratures over 5 ms among those over two hours
    short = sample(chosen, late[:2], nodes=8)
    np.testing.assert_allclose(truth.gyro_rate[3], short.gyro_rate[1], rtol=1e-14)


def test_mean_rates_against_adaptive_quadrature():
    chosen = motion(0.02)
    times = sample_times(100.0, 0.05)
    truth = sample(chosen, times)
    t = times * 1e-9
    integral = quad_vec(lambda s: body_rate(chosen, s), t[2], t[3], epsrel=1e-9)[0]
    scale = np.abs(truth.gyro_rate).max()
    np.testing.assert_allclose(truth.gyro_increment[3], integral, atol=1e-8 * scale * 0.01)


def test_bad_arguments_are_refused():
    times = sample_times(100.0, 0.1)
    for bad in ((0.0, 10.0), (10.0, 10.0), (-1.0, 5.0)):
        with pytest.raises(ValueError, match="band"):
            sample(broadband(1e-3, bad), times)
        with pytest.raises(ValueError, match="band"):
            sample(random_manoeuvre(1.0, bad), times)
    with pytest.raises(ValueError, match="shapes"):
        sample(two_frequency((0.1, 0.1), (1.0, 2.0)), times, q_nm=np.ones((2, 4)))
    with pytest.raises(ValueError, match="increase"):
        sample(two_frequency((0.1, 0.1), (1.0, 2.0)), times[::-1])
    with pytest.raises(ValueError, match="turns"):
        sample(two_frequency((0.1, 0.1), (1.0, 400.0)), sample_times(1.0, 3.0))
