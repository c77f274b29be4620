from dataclasses import replace

import numpy as np
import pytest

from sinstool.core.errors import ConfigurationError
from sinstool.methods.hse.calibration import (
    correct_heading,
    correction,
    from_fit,
    require_applicable,
)
from sinstool.methods.hse.fit import fit
from sinstool.methods.hse.fit_result import FitOptions
from sinstool.methods.hse.status import judge
from tests.methods.hse.made_runs import ARCSEC, EPSILON, RATES, W, brute_run, brute_runs

HEADING = FitOptions(method="heading")


def calibrated(sigma=0.5 * ARCSEC, options=HEADING, **more):
    result = fit([replace(r, sigma_heading=sigma) for r in brute_runs(**more)], options)
    return from_fit(result, judge(result), "t", "v", "0" * 64)


@pytest.mark.parametrize(
    ("latitude", "rate", "psi"),
    [(0.9, 40.0, 0.3), (-0.6, -60.0, 2.2), (0.49, 20.0, 4.0), (0.0, 40.0, 5.5)],
)
def test_correction_holds_at_other_places(latitude, rate, psi):
    """Calibrated at one latitude and azimuth, applied elsewhere: what is left is constant."""
    theta, gamma = 7e-4, -4e-4
    run = brute_run(np.radians(rate), psi, theta, gamma, latitude=latitude)
    result = correct_heading(
        calibrated(), run.heading, run.sigma_heading, run.rate, run.C23, latitude
    )
    # -d (1 + C13 tan L) remains; it is the same at every azimuth and rate, eq. (13)'s rest
    d = -(EPSILON[0] - EPSILON[1] + EPSILON[2]) / (2.0 * np.sqrt(3.0))
    assert -d / ARCSEC == pytest.approx(0.751, abs=1e-3)
    left = (result.heading - psi) / ARCSEC
    assert left == pytest.approx(0.7515, abs=3e-3)
    assert abs(run.heading - psi - -d) / ARCSEC > 0.3 or abs(run.C23) < 1e-4


def test_figures_of_the_paper():
    """lambda2 4.2" and a lean of 8e-4 at 40 deg/s: 12.152"."""
    cal = replace(calibrated(), lambda2_rad=4.2 * ARCSEC, sigma_lambda2_rad=2.1 * ARCSEC)
    dpsi, sigma = correction(cal, np.radians(40.0), 8e-4, 0.49)
    assert dpsi / ARCSEC == pytest.approx(12.1520, abs=6e-4)
    assert sigma == pytest.approx(0.5 * dpsi)
    dpsi, _ = correction(replace(cal, lambda2_rad=3e-5), np.radians(40), np.sqrt(2) * 1e-3, 0.49)
    assert dpsi / ARCSEC == pytest.approx(31.65, abs=0.01)


def test_sigma_is_that_of_simulations():
    cal = replace(calibrated(), lambda2_rad=4.2 * ARCSEC, sigma_lambda2_rad=1.0 * ARCSEC)
    rng = np.random.default_rng(1)
    n = 20000
    slope = (RATES[1] - W * np.sin(-0.6)) / (3 * W * np.cos(-0.6))
    lambda2 = 4.2 * ARCSEC + ARCSEC * rng.standard_normal(n)
    lean = 8e-4 + 1e-4 * rng.standard_normal(n)
    heading = 1.0 + 10 * ARCSEC * rng.standard_normal(n) - slope * lambda2 * lean
    result = correct_heading(cal, 1.0, 10 * ARCSEC, RATES[1], 8e-4, -0.6, sigma_C23=1e-4)
    assert result.sigma == pytest.approx(heading.std(), rel=0.02)
    assert result.sigma_dpsi == pytest.approx((slope * lambda2 * lean).std(), rel=0.03)
    assert result.heading == pytest.approx(1.0 - result.dpsi)


def test_columns_go_through_at_once():
    cal = calibrated()
    rates = np.array([0.4, -0.4, 0.7])
    result = correct_heading(cal, [0.0, 1.0, 6.28], 1e-5, rates, [8e-4, 1e-4, -8e-4], 0.49)
    for i, rate in enumerate(rates):
        one = correct_heading(cal, [0.0, 1.0, 6.28][i], 1e-5, rate, [8e-4, 1e-4, -8e-4][i], 0.49)
        assert result.heading[i] == one.heading and result.sigma[i] == one.sigma
    assert np.all((result.heading >= 0.0) & (result.heading < 2.0 * np.pi))


def test_what_was_not_calibrated_is_flagged():
    result = correct_heading(
        calibrated(),
        1.0,
        1e-5,
        np.radians([20.0, 40.0, 60.0, 61.0, 70.0, 10.0, -40.0]),
        [8e-4, -8e-4, 8.1e-4, 9e-4, -9e-4, 0.0, 8e-4],
        0.49,
    )
    np.testing.assert_array_equal(result.outside_rate, [0, 0, 0, 0, 1, 1, 1])
    np.testing.assert_array_equal(result.outside_C23, [0, 0, 0, 1, 1, 0, 0])


def test_doubtful_calibrations_need_force():
    good, doubtful = calibrated(), calibrated(sigma=19 * ARCSEC)
    assert require_applicable(good) is None
    assert doubtful.status == "not_significant"
    with pytest.raises(ConfigurationError, match=r"not_significant: .*--force"):
        require_applicable(doubtful)
    assert "not_significant" in require_applicable(doubtful, force=True)
    level = calibrated(lean=2e-5)
    assert level.lambda2_rad is None
    for force in (False, True):
        with pytest.raises(ConfigurationError, match="no coefficient: its status is unobservable"):
            require_applicable(level, force)
    with pytest.raises(ConfigurationError, match="no coefficient"):
        correction(level, 0.5, 1e-3, 0.5)


def test_poles_and_unknown_sigma():
    with pytest.raises(ConfigurationError, match=r"latitude 86.0 deg"):
        correction(calibrated(), 0.5, 1e-3, np.radians([10.0, -86.0]))
    _, sigma = correction(replace(calibrated(), sigma_lambda2_rad=None), 0.5, 1e-3, 0.5)
    assert np.isnan(sigma)
