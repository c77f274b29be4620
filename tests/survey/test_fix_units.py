"""Fixes whose numbers are rounded are as much less certain, and no others."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.core.earth import displaced
from sinstool.core.streams import Gnss
from sinstool.survey.fix_units import with_rounding

SECONDS = np.arange(400) / 5.0


def fixes(seed, sigma=0.02, speed=1.0, noise=None):
    """Fixes of a slow robot at 37.4 N, 122.3 W, with the covariances of RTK."""
    random = np.random.default_rng(seed)
    off = (sigma if noise is None else noise) * random.standard_normal((3, len(SECONDS)))
    north = 20.0 * np.sin(speed * SECONDS / 20.0) + off[0]
    east = 20.0 * np.cos(speed * SECONDS / 20.0) + off[1]
    latitude, longitude = displaced(np.radians(37.4), np.radians(-122.3), 0.0, north, east)
    times = np.round(1.7e18 + SECONDS * 1e9).astype(np.int64)
    n = len(times)
    covariance = np.tile(sigma**2 * np.eye(3), (n, 1, 1))
    return Gnss(times, times, latitude, longitude, 100.0 + off[2], covariance, np.full(n, 2),
                np.zeros(n, int))  # fmt: skip


def rounded(values, step):
    return np.round(values / step) * step


@pytest.mark.parametrize("seed", range(5))
def test_single_precision_is_noise(seed):
    plain = fixes(seed)
    degrees = [np.degrees(x).astype(np.float32) for x in (plain.latitude, plain.longitude)]
    coarse = replace(plain, latitude=np.radians(degrees[0].astype(float)),
                     longitude=np.radians(degrees[1].astype(float)))  # fmt: skip
    told, (finding,) = with_rounding(coarse, "/fix")
    assert finding.kind == "rounded-fixes" and "0.42 by 0.68 by 0 m" in finding.text
    more = told.covariance_n[0] - plain.covariance_n[0]
    np.testing.assert_allclose(
        more, np.diag([0.4234, 0.676, 0.0]) ** 2 / 12.0, rtol=0.01, atol=1e-9
    )
    # and is about what the rounding makes
    off = (coarse.latitude - plain.latitude) * 6.36e6
    assert np.sqrt(more[0, 0]) == pytest.approx(np.std(off), rel=0.1)


@pytest.mark.parametrize("seed", range(5))
def test_a_step_that_is_small_beside_the_noise_is_not_worth_a_word(seed):
    plain = fixes(seed)
    step = np.radians(1e-7)  # of u-blox receivers
    coarse = replace(
        plain, latitude=rounded(plain.latitude, step), height=rounded(plain.height, 0.001)
    )
    told, findings = with_rounding(coarse, "/fix")
    assert not findings
    more = np.diag(told.covariance_n[0] - plain.covariance_n[0])
    np.testing.assert_allclose(
        more, np.array([0.0111, 0.0, 0.001]) ** 2 / 12.0, rtol=0.02, atol=1e-12
    )


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("noise", [None, 0.0])
def test_numbers_that_are_not_rounded_stay_as_they_are(seed, noise):
    plain = fixes(seed, noise=noise)
    told, findings = with_rounding(plain, "/fix")
    assert not findings
    np.testing.assert_array_equal(told.covariance_n, plain.covariance_n)


def test_an_even_way_is_not_rounded():
    # but for a stop and an outage
    number = np.arange(400.0) + np.where(np.arange(400) > 100, 10.0, 0.0)
    latitude = 0.8 + 1e-7 * np.minimum(number, 200.0)
    plain = replace(fixes(0), latitude=latitude, longitude=np.full(400, 0.2))
    assert not with_rounding(plain, "/fix")[1]


def test_what_is_unknown_stays_unknown():
    plain = replace(fixes(0), covariance_type=np.zeros(400, int))
    coarse = replace(plain, height=rounded(plain.height, 0.05))
    assert with_rounding(coarse, "/fix") == (coarse, [])
