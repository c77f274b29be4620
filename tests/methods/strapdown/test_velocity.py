import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sinstool.core import rotation
from sinstool.methods.strapdown.velocity import jacobian, remove_bias
from sinstool.simulation.truth import sample_times
from tests.methods.strapdown import flying


class Motion:
    """Angular rate and specific force as sums of sinusoids: all of coning and sculling."""

    def __init__(self, seed, highest, rate, force=8.0):
        random = np.random.default_rng(seed)
        self.frequency = 2.0 * np.pi * random.uniform(0.2 * highest, highest, (6, 3))
        self.phase = random.uniform(0.0, 2.0 * np.pi, (6, 3))
        self.size = random.uniform(0.5, 1.5, (6, 3)) * np.repeat([rate, force], 3)[:, None] / 3.0
        self.mean = np.array([0.2 * rate, -0.1 * rate, 0.3 * rate, 1.0, -2.0, -9.0])

    def value(self, t):
        t = np.asarray(t)[..., None, None]
        return self.mean + (self.size * np.sin(self.frequency * t + self.phase)).sum(-1)

    def integral(self, t):
        t = np.asarray(t)[..., None, None]
        part = -self.size / self.frequency * np.cos(self.frequency * t + self.phase)
        return self.mean * t[..., 0] + part.sum(-1)

    def samples(self, time, kind):
        """Of gyro and accelerometer."""
        t = time * 1e-9
        if kind == "rate":
            both = self.value(t)
        else:
            step = t[1] - t[0]
            both = self.integral(t) - self.integral(t - step)
            both = both / step if kind == "mean-rate" else both
        return both[:, :3], both[:, 3:]

    def truth(self, ends):
        """Rotation vector and velocity increment from each end to the next, integrated."""
        out = np.empty((len(ends) - 1, 6))
        for k in range(len(ends) - 1):

            def equation(t, y):
                both = self.value(t)
                q_rate = 0.5 * rotation.multiply(y[:4], [0.0, *both[:3]])
                return np.concatenate([q_rate, rotation.rotate(y[:4], both[3:])])

            y = solve_ivp(
                equation,
                (ends[k], ends[k + 1]),
                [1.0, 0, 0, 0, 0, 0, 0],
                method="DOP853",
                rtol=1e-13,
                atol=1e-15,
            ).y[:, -1]
            out[k, :3], out[k, 3:] = rotation.log(y[:4]), y[4:]
        return out


def answers(motion, name, kind, rate_hz, count):
    """Ours and the truth over `count` updates in the middle of a segment."""
    time = sample_times(rate_hz, 80.0 / rate_hz)
    run = flying.stage(name, kind, 1.0 / rate_hz)
    updates = flying.joined([run.push(*motion.samples(time, kind), time), run.finish()])
    first = len(updates.sample) // 2
    ends = time[updates.sample[first - 1 : first + count]] * 1e-9
    ours = np.hstack([updates.rotation_vector, updates.velocity_increment])
    return ours[first : first + count], motion.truth(ends)


@pytest.mark.parametrize(
    ("name", "kind", "attitude", "velocity"),
    [
        ("uncompensated", "increment", 4e-6, 4e-5),
        ("previous-1", "increment", 3e-7, 4e-6),
        ("previous-1", "mean-rate", 3e-7, 4e-6),
        ("previous-3", "increment", 2e-7, 2e-6),
        ("savage-two-speed", "increment", 2e-6, 2e-5),
        ("optimal-3", "increment", 1e-5, 1e-4),
        ("quatfiter-4", "increment", 1e-8, 1e-7),
        ("lookahead-12", "mean-rate", 1e-14, 3e-13),
        ("lookahead-12", "rate", 2e-13, 3e-12),
        ("singular-perturbation", "rate", 1e-4, 5e-4),
    ],
)
def test_every_algorithm_has_its_sculling(name, kind, attitude, velocity):
    motion = Motion(4, 5.0, 1.5)
    ours, truth = answers(motion, name, kind, 100.0, 6)
    error = np.abs(ours - truth)
    assert error[:, :3].max() < attitude
    assert error[:, 3:].max() < velocity


@pytest.mark.parametrize(
    ("name", "order"), [("uncompensated", 3), ("previous-1", 5), ("optimal-2", 5)]
)
def test_order_of_sculling_error(name, order):
    # Of a small rotation and of its rectification only, so that no third order hides the law:
    # in phase, angle about x and force along y have a mean product.
    errors = []
    for rate_hz in (100.0, 200.0):
        motion = Motion(0, 1.0, 0.0, 0.0)
        motion.frequency[:] = 2.0 * np.pi * 5.0
        motion.phase[:] = 0.0
        motion.mean[:] = 0.0
        motion.size[0, 0] = 1e-3  # rate, a quarter of a turn before its angle
        motion.size[4, 0] = 1.0
        motion.phase[4, 0] = -0.5 * np.pi
        time = sample_times(rate_hz, 4.0)
        run = flying.stage(name, "increment", 1.0 / rate_hz)
        updates = flying.joined([run.push(*motion.samples(time, "increment"), time), run.finish()])
        ends = time[updates.sample] * 1e-9
        angle = rotation.exp(
            np.outer(motion.integral(ends)[:, 0] - motion.integral(0.0)[0], [1.0, 0.0, 0.0])
        )
        before = np.concatenate([[[1.0, 0.0, 0.0, 0.0]], angle[:-1]])
        total = rotation.rotate(before, updates.velocity_increment)[:, 2].sum()
        # 1 s is five periods: mean of sin(angle) force over 4 s, by quadrature
        t = np.linspace(0.0, 4.0, 40_001)[:-1]
        turned = motion.integral(t)[:, 0] - motion.integral(0.0)[0]
        expected = 4.0 * np.mean(np.sin(turned) * motion.value(t)[:, 4])
        errors.append(abs(total - expected))
    assert errors[0] / errors[1] == pytest.approx(2.0 ** (order - 1), rel=0.1)


def test_constant_rate_and_force_are_exact():
    # 400 deg/s at 50 Hz: 8 degrees in an interval, where the first-order rotation
    # compensation is wrong by 0.3 %
    rate, force = np.deg2rad([250.0, -290.0, 116.0]), np.array([3.0, -1.0, -9.0])
    time = sample_times(50.0, 0.4)
    run = flying.stage("previous-1", "mean-rate", 0.02)
    rows = (len(time), 1)
    updates = flying.joined(
        [run.push(np.tile(rate, rows), np.tile(force, rows), time), run.finish()]
    )
    t, weight = np.polynomial.legendre.leggauss(12)
    turned = rotation.rotate(rotation.exp(np.outer(0.01 * (t + 1.0), rate)), force)
    expected = 0.01 * weight @ turned
    np.testing.assert_allclose(updates.velocity_increment, np.tile(expected, (20, 1)), atol=1e-12)


@pytest.mark.parametrize("turn", [1e-9, 1e-3, 0.0999, 0.1001, 0.6, 0.9999, 1.0001, 3.0])
def test_rotation_compensation_at_any_angle(turn):
    axis, force = np.array([0.6, -0.48, 0.64]), np.array([0.1, 0.3, -0.2])
    t, weight = np.polynomial.legendre.leggauss(30)
    turned = rotation.rotate(rotation.exp(np.outer(0.5 * (t + 1.0) * turn, axis)), force)
    expected = 0.5 * weight @ turned
    ours = jacobian(*(turn * axis), *force)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-15)


def compensate(gyro_before, accel_before, gyro, accel):
    """Rotation vector and velocity increment of a sample and the one before it."""
    run = flying.stage("previous-1", "increment", 0.01)
    time = sample_times(100.0, 0.01)
    parts = [run.push(np.stack([gyro_before, gyro]), np.stack([accel_before, accel]), time)]
    one = flying.joined([*parts, run.finish()])
    return np.concatenate([one.rotation_vector[0], one.velocity_increment[0]])


def test_previous_1_has_the_forms_of_the_textbooks():
    motion = Motion(7, 3.0, 2.0)
    time = sample_times(100.0, 1.0)
    gyro, accel = motion.samples(time, "increment")
    run = flying.stage("previous-1", "increment", 0.01)
    updates = flying.joined([run.push(gyro, accel, time), run.finish()])
    for k in range(1, len(time)):
        # but for the second order of the rotation compensation
        a, b, v, u = gyro[k - 1], gyro[k], accel[k - 1], accel[k]
        book = u + 0.5 * np.cross(b, u) + (np.cross(a, u) + np.cross(v, b)) / 12.0
        assert (
            np.abs(updates.velocity_increment[k - 1] - book).max()
            < 0.3 * np.sum(b * b) * np.abs(u).max()
        )


def test_bias_is_removed_after_compensation():
    motion = Motion(9, 2.0, 1.0)
    time = sample_times(100.0, 1.0)
    gyro, accel = motion.samples(time, "increment")
    gyro_bias, accel_bias = np.array([3e-4, -2e-4, 1e-4]), np.array([0.02, -0.05, 0.03])
    g, a = 0.01 * gyro_bias, 0.01 * accel_bias
    for k in range(1, len(time)):
        first = compensate(gyro[k - 1] - g, accel[k - 1] - a, gyro[k] - g, accel[k] - a)
        raw = compensate(gyro[k - 1], accel[k - 1], gyro[k], accel[k])
        after = np.array(remove_bias(*raw, *g, *a))
        np.testing.assert_allclose(after[:3], first[:3], rtol=0, atol=3e-9)
        np.testing.assert_allclose(after[3:], first[3:], rtol=0, atol=1e-6)
        simple = np.array(raw) - [*g, *a]
        assert np.abs(simple - first)[3:].max() > 2.0 * np.abs(after - first)[3:].max()


@pytest.mark.parametrize("axis", range(3))
def test_every_term_of_the_removal_is_that_of_corrected_increments(axis):
    # u = a + p x a / 2 of corrected increments; of a bias only its first order is wanted
    p, a = np.array([2e-3, -3e-3, 1e-3]), np.array([0.08, 0.05, -0.1])
    u = a + 0.5 * np.cross(p, a)
    for g, b in ((1e-6 * np.eye(3)[axis], np.zeros(3)), (np.zeros(3), 1e-6 * np.eye(3)[axis])):
        change = np.array(remove_bias(*p, *u, *g, *b)) - [*p, *u]
        wanted = (a - b) + 0.5 * np.cross(p - g, a - b) - u
        crossed = 0.5 * (np.cross(g, a) + np.cross(p, b))
        np.testing.assert_allclose(change[:3], -g, rtol=1e-9)
        np.testing.assert_allclose(change[3:], wanted, rtol=0, atol=0.02 * np.abs(crossed).max())


def test_samples_that_do_not_fit_are_refused():
    run = flying.stage("previous-1", "increment", 0.01)
    with pytest.raises(ValueError, match="accel"):
        run.push(np.zeros((3, 3)), np.zeros((2, 3)), sample_times(100.0, 0.02))
