import numpy as np
import pytest

from sinstool.methods.alignment.accumulation import accumulate
from sinstool.methods.alignment.reference import velocity_reference
from sinstool.methods.alignment.segments import LENGTH_SHARE, _share, plausible_fixes
from sinstool.methods.sensor_errors import IMU_GRADES
from sinstool.simulation.gnss import GnssFaults, Receiver, gnss_samples
from tests.methods.alignment.launches import NOISY, antenna_truth, fixes, noisy, trajectory


def screened(samples, imu):
    gnss = fixes(samples)
    rows = accumulate(imu.time_ns, imu.delta_theta, imu.delta_velocity, gnss.time_ns, 0)
    beta = velocity_reference(
        rows.time_s, gnss.latitude, gnss.longitude, gnss.height, gnss.velocity_n
    )
    return plausible_fixes(rows.alpha, beta, np.full(len(rows), 0.1))


@pytest.mark.parametrize("fraction", [0.02, 0.1])
def test_outliers_are_found_and_others_kept(fraction):
    receiver = Receiver(
        errors=NOISY, faults=GnssFaults(outlier_fraction=fraction, outlier_velocity=20.0)
    )
    truth = antenna_truth(receiver)
    bad = lost = good = 0
    for seed in range(6):
        samples = gnss_samples(trajectory(), receiver, seed, truth)
        mask = screened(samples, noisy(seed)[1])
        bad += samples.outlier.sum()
        good += (~samples.outlier).sum()
        lost += (~mask & ~samples.outlier).sum()
        assert not np.any(mask & samples.outlier)
    assert bad > 50 * fraction * 100
    assert lost < 1e-3 * good


def test_latency_is_no_outlier():
    receiver = Receiver(errors=NOISY, latency_s=0.1)
    samples = gnss_samples(trajectory(), receiver, 2, antenna_truth(receiver))
    mask = screened(samples, noisy(2)[1])
    assert (~mask).mean() < 0.02


def test_noise_per_fix_is_heard():
    rng = np.random.default_rng(4)
    alpha = np.cumsum(rng.normal(size=(200, 3)), axis=0)
    sigma = np.where(np.arange(200) % 7 == 3, 3.0, 0.01)
    beta = alpha + sigma[:, None] * rng.normal(size=(200, 3))
    assert plausible_fixes(alpha, beta, sigma).all()
    assert not plausible_fixes(alpha, beta, np.full(200, 0.01)).all()


def test_accelerometers_may_be_as_poor_as_their_grade():
    """Chips that read gravity 6 % too small left no fix at all, where one was bad."""
    beta = 9.81 * np.arange(60.0)[:, None] * np.array([0.0, 0.0, -1.0])
    sigma, bad = np.full(60, 0.1), np.arange(60) == 30
    spoilt = beta + 20.0 * bad[:, None]
    assert not plausible_fixes(0.94 * beta, beta, sigma).any()
    share = _share(IMU_GRADES["consumer"])
    assert np.array_equal(plausible_fixes(0.94 * beta, spoilt, sigma, share), ~bad)
    assert _share(IMU_GRADES["navigation"]) == LENGTH_SHARE


def test_few_fixes():
    for count in range(3):
        assert plausible_fixes(np.zeros((count, 3)), np.ones((count, 3)), np.ones(count)).all()
