import numpy as np
import pytest

from sinstool.methods.alignment.gate import (
    MIN_FOR_CLIPPING,
    dynamics,
    find_start,
    find_stop,
    lift_off,
    looks_clipped,
    run_lengths,
    saturated,
    why_no_start,
)
from sinstool.methods.alignment.inflight_types import GateLimits, ImuIncrements
from tests.methods.alignment.launches import DEGREE, exact, increments, noisy, trajectory

RATE = 100.0
STEP = 1.0 / RATE


def flight(force, rate=None, start_ns=7):
    """Samples of given specific force, m/s^2, and rate, rad/s, at 100 Hz."""
    force = np.asarray(force, dtype=float)
    rate = np.zeros_like(force) if rate is None else np.asarray(rate, dtype=float)
    time = start_ns + np.arange(len(force)) * 10_000_000
    return ImuIncrements(time, rate * STEP, force * STEP)


def calm(count):
    return np.tile([0.5, -0.3, -9.7], (count, 1))


def test_norms_and_changes():
    rng = np.random.default_rng(2)
    force, rate = rng.normal(size=(2, 50, 3))
    motion = dynamics(flight(force, rate))
    np.testing.assert_allclose(motion.force, np.linalg.norm(force, axis=1))
    np.testing.assert_allclose(motion.rate, np.linalg.norm(rate, axis=1))
    change = np.linalg.norm(np.diff(force, axis=0), axis=1) * RATE
    np.testing.assert_allclose(motion.force_step, [0.0, *change], atol=1e-9)
    change = np.linalg.norm(np.diff(rate, axis=0), axis=1) * RATE
    np.testing.assert_allclose(motion.rate_step, [0.0, *change], atol=1e-9)


def test_smoothing():
    rng = np.random.default_rng(3)
    force = rng.normal(size=(40, 3))
    motion = dynamics(flight(force), smooth=4)
    for k in (0, 2, 3, 20):
        mean = force[max(k - 3, 0) : k + 1].mean(axis=0)
        assert motion.force[k] == pytest.approx(np.linalg.norm(mean))


@pytest.mark.parametrize("smooth", [1, 4])
def test_a_long_record_is_the_same_block_by_block(smooth, monkeypatch):
    rng = np.random.default_rng(4)
    imu = flight(*rng.normal(size=(2, 50, 3)))
    whole = dynamics(imu, smooth)
    monkeypatch.setattr("sinstool.methods.alignment.gate.BLOCK_ROWS", 7)
    for name, values in vars(dynamics(imu, smooth)).items():
        np.testing.assert_allclose(values, getattr(whole, name), rtol=1e-12, atol=1e-12)


def test_run_lengths():
    flags = np.array([1, 1, 0, 1, 1, 1, 0, 0, 1], dtype=bool)
    np.testing.assert_array_equal(run_lengths(flags), [1, 2, 0, 1, 2, 3, 0, 0, 1])
    assert len(run_lengths(np.zeros(0, dtype=bool))) == 0


def test_lift_off_is_where_force_stays():
    force = calm(300)
    force[40] = [0.0, 0.0, -60.0]  # a knock
    force[100:112, 2] = -25.0
    assert lift_off(dynamics(flight(force))) == 100
    assert lift_off(dynamics(flight(calm(300)))) is None
    force[107, 2] = -9.0  # never long enough
    assert lift_off(dynamics(flight(force))) is None


@pytest.mark.parametrize("which", range(4))
def test_each_limit_blocks_the_start(which):
    limits = GateLimits(t_set1=1.0, n_set1=5)
    force, rate = calm(600), np.zeros((600, 3))
    if which == 0:
        force[:300, 2] = -12.1
    elif which == 1:
        force[:300:2, 2] -= 1.05
    elif which == 2:
        rate[:300, 1] = 5.1 * DEGREE
    else:
        rate[:300:2, 1] = 1.05 * DEGREE
    imu = flight(force, rate)
    start = find_start(dynamics(imu), limits, int(imu.time_ns[0]))
    assert 300 + 4 <= start <= 300 + 6
    blocked = np.flatnonzero(~dynamics(imu).within(limits).all(axis=1))
    np.testing.assert_array_equal(blocked, [which] if which in (1, 3) else [which, which + 1])


def test_time_of_start_and_stop():
    imu = flight(calm(3000))
    motion = dynamics(imu)
    limits = GateLimits(t_set1=4.0, n_set1=3, t_set2=10.0, n_set2=7)
    start = find_start(motion, limits, int(imu.time_ns[100]))
    assert start == 100 + 400 + 2  # the third sample from 4.0 s on
    # n counts samples for which time passes too.
    assert find_stop(motion, limits, start) == start + 1000 + 6
    rough = calm(3000)
    rough[start + 1004, 2] = -13.0
    motion = dynamics(flight(rough))
    assert find_stop(motion, limits, start) == start + 1006 + 6
    assert find_stop(motion, GateLimits(t_set2=30.0), start) is None
    assert find_start(motion, GateLimits(t_set1=31.0), int(imu.time_ns[0])) is None


def test_why_no_start_names_the_limit():
    force = calm(600)
    force[:, 2] = -13.0
    imu = flight(force)
    why = why_no_start(dynamics(imu), GateLimits(t_set1=1.0), int(imu.time_ns[0]))
    assert "|f| for 5.0 s" in why and "omega" not in why
    assert "waits 40 s" in why_no_start(dynamics(imu), GateLimits(), int(imu.time_ns[0]))
    late = why_no_start(dynamics(imu), GateLimits(), int(imu.time_ns[-1]) + 1)
    assert "it ends before lift-off" in late
    # as many samples as the gate waits for, and one
    end_s = (imu.time_ns[-1] - imu.time_ns[0]) * 1e-9
    one = why_no_start(dynamics(imu), GateLimits(t_set1=end_s), int(imu.time_ns[0]))
    assert one == "of 0.0 s, over the limit: |f| for 0.0 s"


def test_the_flight():
    # The gate opens 40 s after lift-off, and noise does not close it.
    _, imu, _ = noisy(1)
    motion = dynamics(imu)
    off = lift_off(motion)
    assert 0.0 < motion.time_ns[off] * 1e-9 < 0.3
    start = find_start(motion, GateLimits(), int(motion.time_ns[off]))
    assert (motion.time_ns[start] - motion.time_ns[off]) * 1e-9 == pytest.approx(40.0, abs=0.006)
    _, exact_imu, _ = exact()
    clean = dynamics(exact_imu).within(GateLimits()).all(axis=0)
    np.testing.assert_array_equal(motion.within(GateLimits()).all(axis=0)[8000:], clean[8000:])


def test_saturation():
    truth = trajectory().imu
    imu = increments(truth)
    limit = 200.0 * DEGREE
    theta = np.clip(imu.delta_theta, -limit * 0.005, limit * 0.005)
    clipped = ImuIncrements(imu.time_ns, theta, imu.delta_velocity)
    true = (np.abs(truth.gyro_mean_rate) > limit).any(axis=1)
    result = saturated(clipped, limit, None)
    assert np.all(result[true])
    assert result.sum() == true.sum() + 1  # and the one after
    assert saturated(clipped, 210.0 * DEGREE, 1e4).sum() == 0
    assert looks_clipped(clipped) == "gyro x"
    assert looks_clipped(imu) is None
    assert looks_clipped(noisy(1)[1]) is None


@pytest.mark.parametrize("seed", range(4))
def test_counts_of_a_laser_gyro_at_rest_are_not_clipped(seed):
    truth, count = trajectory().imu, 5e-6
    imu = increments(truth)
    random = np.random.default_rng(seed)
    turned = np.cumsum(
        count * (random.uniform(0.1, 0.4, 3) + 0.3 * random.standard_normal(imu.delta_theta.shape)),
        axis=0,
    )
    # Differences of an angle in rad, which rounds them
    theta = np.diff(0.7 + count * np.floor(turned / count), axis=0, prepend=0.7)
    theta = np.minimum(np.maximum(theta, 0.0), theta[np.abs(theta - count) < 1e-12].max())
    assert looks_clipped(ImuIncrements(imu.time_ns, theta, imu.delta_velocity)) is None


def test_a_record_of_two_samples_may_be_saturated():
    # 2 g within 10 ms; the first sample's interval is taken for as long as the next
    force = np.array([[0.0, 0.0, -19.0], [0.0, 0.0, -20.0]])
    assert saturated(flight(force), None, 20.0).tolist() == [False, True]
    assert saturated(flight(force), None, 18.0).tolist() == [True, True]
    assert saturated(flight(force), None, 21.0).tolist() == [False, False]
    assert saturated(flight(force[:1]), None, 21.0).tolist() == [True]


@pytest.mark.parametrize("missing", [0, 1])
def test_few_samples_show_no_clipping(missing):
    force = np.tile([0.0, 0.0, -1.0], (MIN_FOR_CLIPPING + 1 - missing, 1))
    force[20:26, 2] = -30.0
    assert looks_clipped(flight(force)) == ("accelerometer z" if not missing else None)
