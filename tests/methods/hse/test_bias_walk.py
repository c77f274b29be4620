"""The axial coefficient of gyros whose bias changes by less than any single run shows."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.methods.hse.axial import earth_rate_along_axis, fit_axial
from tests.methods.hse.made_runs import ARCSEC, EPSILON, brute_runs

TRUE = -EPSILON.sum()


def drifting(runs, random, drift):
    """By gyros of 5e-4 deg/sqrt(h) whose bias drifts, deg/h in an hour: means and slopes."""
    out = []
    for run in runs:
        walk, total = 5e-4 / 60.0 * np.pi / 180.0, run.duration_s
        slope = drift * ARCSEC / 3600.0
        bias = slope * (run.t_start_s + 0.5 * total) + walk / np.sqrt(total) * random.normal()
        slope_sigma = walk * np.sqrt(12.0) / total**1.5
        shown = {"axial_drift": slope + slope_sigma * random.normal()}
        shown["axial_drift_sigma"] = slope_sigma
        rate = run.rate + earth_rate_along_axis(run)
        sigma = np.hypot(walk / np.sqrt(total), 0.003 * ARCSEC) / abs(rate)
        c = run.c_axial + bias / rate
        out.append(replace(run, c_axial=c, sigma_c_axial=sigma, quality=shown))
    return out


@pytest.mark.parametrize(
    ("degrees", "drift", "ratio", "error"),
    [
        ([20, 30, 40, 50, 60], 0.0, 1.0, 0.01),
        ([20, 30, 40, 50, 60], 0.02, 2.2, 0.06),
        ([20, 30, 40, 50, 60], 0.1, 1.6, 0.07),
        ([20, 60, 40, 60, 20, 40], 0.1, 1.6, 0.02),
        ([60, 40, 20, -20, -40, -60], 0.1, 1.6, 0.03),
    ],
)
def test_a_drift_that_no_run_shows_for_sure_is_in_the_axial_sigma(degrees, drift, ratio, error):
    """Was off by 3 sigmas while too small to be seen, and half of all of it then in the sigma."""
    ideal = brute_runs(np.radians(np.array(degrees, dtype=float)))
    found = [
        fit_axial(drifting(ideal, np.random.default_rng(seed), sign * drift), True)
        for seed in range(30)
        for sign in (-1.0, 1.0)
    ]
    off = np.array([one.lambda2 - TRUE for one in found])
    sigma = np.array([one.sigma_lambda2 for one in found])
    assert np.sqrt(np.mean((off / sigma) ** 2)) < ratio
    assert np.sqrt(np.mean(off**2)) < error * ARCSEC
    assert np.median(sigma) < 2.5 * error * ARCSEC


def test_logs_of_one_rate_each_are_tied_by_their_stamps():
    """A bias that walks is another one after an hour, and nearly the same after a minute."""
    runs = drifting(brute_runs(np.radians([20.0, 40.0, 60.0])), np.random.default_rng(1), 0.05)
    sigma = {}
    for apart in (60.0, 86400.0):
        logs = [
            replace(
                run, source=run.id, t_start_s=0.0, log_start_ns=round(1e9 * k * (600.0 + apart))
            )
            for k, run in enumerate(runs)
        ]
        sigma[apart] = fit_axial(logs, True).sigma_c
    assert sigma[60.0] < sigma[86400.0]
