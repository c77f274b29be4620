"""Heights of pressures on days that are made up, by a setting, the start or GNSS."""

import numpy as np
import pytest
from scipy.optimize import brentq, least_squares
from scipy.stats import norm

from sinstool.methods.height.reference import (
    _huber_fit,
    fit_scale,
    reference_from_gnss,
    reference_from_setting,
    reference_from_start,
)
from sinstool.methods.height.standard_atmosphere import (
    geopotential,
    pressure_altitude,
    pressure_at,
)


def ns(seconds):
    return np.round(np.asarray(seconds) * 1e9).astype(np.int64)


def test_setting_gives_height_above_the_ellipsoid():
    reference = reference_from_setting(102000.0, undulation=-28.0)
    p = float(pressure_at(geopotential(500.0) + pressure_altitude(102000.0)))
    assert reference.height(p) == pytest.approx(472.0, abs=0.02)
    with pytest.raises(ValueError, match="hPa"):
        reference_from_setting(1013.25)


def test_start_gives_the_height_configured():
    p = np.array([np.nan, 95010.0, 95000.0, 0.0, 94990.0])
    reference = reference_from_start(p, 612.0)
    assert reference.height(95000.0) == pytest.approx(612.0)
    assert np.isnan(reference.height([0.0, np.nan])).all()
    with pytest.raises(ValueError, match="at least one"):
        reference_from_start([np.nan, 3.0], 0.0)


class Day:
    """A climb on a day that is not standard, seen by a barometer and by GNSS."""

    def __init__(self, scale=1.05, top=900.0, seed=3):
        rng = np.random.default_rng(seed)
        self.t = np.arange(0.0, 600.0, 0.05)
        rise = np.clip((self.t - 60.0) / 300.0, 0.0, 1.0)
        self.h = 240.0 + (top - 240.0) * rise
        standard = (self.h - 33.0) / scale  # 33 m of offset
        self.p = pressure_at(geopotential(standard)) + 2.0 * rng.standard_normal(len(self.t))
        self.t_gnss = np.arange(0.3, 600.0, 1.0)
        self.gnss = np.interp(self.t_gnss, self.t, self.h) + 2.0 * rng.standard_normal(600)

    def reference(self):
        return reference_from_gnss(ns(self.t), self.p, ns(self.t_gnss), self.gnss)


def test_gnss_scale_is_fitted_where_the_log_climbs():
    day = Day()
    day.gnss[::9] += 400.0  # multipath
    day.gnss[5::50] = np.nan
    day.p[::70] = np.nan
    day.p[3::70] = 0.0
    reference = day.reference()
    assert reference.fit.applied
    assert reference.scale == pytest.approx(1.05, abs=0.002)
    good = np.isfinite(day.p) & (day.p > 0)
    assert abs(reference.height(day.p) - day.h)[good].max() < 3.0


@pytest.mark.parametrize("lag", [0.5, 3.0])
def test_a_barometer_that_lags_in_the_only_climb_has_the_scale_of_the_day(lag):
    day = Day(scale=1.05, top=3240.0)
    late = np.interp(day.t - lag, day.t, day.p)
    fit = reference_from_gnss(ns(day.t), late, ns(day.t_gnss[:300]), day.gnss[:300]).fit
    assert fit.applied and fit.scale == pytest.approx(1.05, abs=1.5e-3)


def test_gnss_offset_alone_where_it_does_not():
    day = Day(top=320.0)
    reference = day.reference()
    assert not reference.fit.applied
    assert reference.scale == 1.0
    early = day.t < 30.0
    assert np.median(reference.height(day.p)[early] - day.h[early]) == pytest.approx(0.0, abs=1.5)
    assert reference.samples == 31


def test_gnss_scale_that_no_day_has_is_not_applied():
    reference = Day(scale=1.25, top=2000.0).reference()
    assert reference.fit.scale == pytest.approx(1.25, abs=0.005)
    assert not reference.fit.applied
    assert reference.scale == 1.0


def test_gnss_without_overlap():
    assert reference_from_gnss(ns([0.0, 1.0]), [1e5, 1e5], ns([5.0]), [100.0]) is None


def test_fit_is_least_squares_without_outliers():
    rng = np.random.default_rng(5)
    h = rng.uniform(0.0, 800.0, 400)
    g = 12.0 + 0.97 * h + 0.01 * rng.standard_normal(400)
    fit = fit_scale(h, g)
    assert (fit.scale, fit.offset) == pytest.approx(tuple(np.polyfit(h, g, 1)), rel=1e-4)


@pytest.mark.parametrize("scale", [1.0, 0.95])
@pytest.mark.parametrize("noise", [0.3, 2.0])
def test_outliers_pull_a_fit_by_no_more_than_hubers_loss_lets_them(noise, scale):
    """One in ten far above: each counts as 1.345 sigmas, and moves the others' mean by so much."""
    rng = np.random.default_rng(6)
    h = rng.uniform(0.0, 800.0, 4000)
    g = 12.0 + scale * h + noise * rng.standard_normal(4000)
    g[::10] += 60.0
    fit = fit_scale(h, g)
    # What nine of ten, clipped about it, have on average is what the tenth has the other way
    sigma = 1.4826 * noise * norm.ppf(0.5 + 0.25 / 0.9)  # by the median size, outliers included

    def pull(off):
        x = np.linspace(-8.0, 8.0, 4001) * noise
        clipped = np.clip(x - off, -1.345 * sigma, 1.345 * sigma) * norm.pdf(x, scale=noise)
        return 0.9 * np.trapezoid(clipped, x) + 0.1 * 1.345 * sigma

    off = brentq(pull, 0.0, 5.0 * noise)
    assert fit.scale == pytest.approx(scale, abs=5e-4)
    assert fit.offset + fit.scale * 400.0 - 400.0 * scale - 12.0 == pytest.approx(off, rel=0.25)


def test_sigma_of_a_height():
    reference = reference_from_setting(101325.0)
    assert reference.sigma(101325.0, 9.0) == pytest.approx(3 * 0.0832, rel=1e-3)


@pytest.mark.parametrize("outliers", [0, 5, 150])
@pytest.mark.parametrize("climb", [0.0, 30.0, 3000.0])
def test_the_line_is_that_of_scipys_least_squares(climb, outliers):
    random = np.random.default_rng(outliers)
    x = climb * np.linspace(-0.5, 0.5, 400) / 100.0
    y = 3.0 + 98.0 * x + random.standard_normal(400)
    y[random.permutation(400)[:outliers]] += 40.0
    expected = least_squares(
        lambda u: y - u[0] - u[1] * x, [0.0, 100.0], loss="huber", f_scale=2.0, xtol=1e-15,
        ftol=1e-15, gtol=1e-12,
    ).x  # fmt: skip
    found = _huber_fit(np.column_stack([np.ones_like(x), x]), y, np.array([0.0, 100.0]), 2.0)
    np.testing.assert_allclose(found, expected, atol=1e-5)
