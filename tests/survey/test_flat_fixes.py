"""Heights that a receiver holds in 2-D mode are left out; level or rounded ones are not."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.core.earth import displaced
from sinstool.core.streams import Gnss, Velocity
from sinstool.survey.flat_fixes import held_heights, without_held
from tests.helpers.imulogs import T0

RATE = 2.0


def way(height, sigma=0.5, speed=3.0):
    """Fixes at these heights, m, of a vehicle that goes east; `sigma` is that of its receiver."""
    n = len(height)
    random = np.random.default_rng(n)
    times = T0 + np.round(np.arange(n) / RATE * 1e9).astype(np.int64)
    east = speed / RATE * np.arange(n) + sigma * random.standard_normal(n)
    latitude, longitude = displaced(0.8, 0.2, 100.0, np.zeros(n), east)
    covariance = np.tile(sigma**2 * np.eye(3), (n, 1, 1))
    return Gnss(times, times, latitude, longitude, np.asarray(height, float), covariance,
                np.full(n, 2), np.zeros(n, int))  # fmt: skip


def hills(seed, n=600, sigma=0.5):
    random = np.random.default_rng(seed)
    t = np.arange(n) / RATE
    return 200.0 + 15.0 * np.sin(t / 40.0 + seed) + sigma * random.standard_normal(n)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("digits", [0.001, 0.1])
def test_heights_that_are_held_on_the_way_are_found_and_nothing_else(seed, digits):
    height = np.round(hills(seed) / digits) * digits
    begin = 100 + 20 * seed
    end = begin + 40 + int(np.argmax(np.abs(height[begin + 40 :] - height[begin]) > 5.0))
    height[begin:end] = height[begin]
    found = np.flatnonzero(held_heights(way(height)))
    assert np.array_equal(found, np.arange(begin + 1, end))


@pytest.mark.parametrize("digits", [0.1, 1.0])
@pytest.mark.parametrize("seed", range(4))
def test_heights_that_stay_the_same_are_not_held(seed, digits):
    """Rounded ones: of a vehicle that rests for minutes on its way, and of one that stays level."""
    random = np.random.default_rng(seed)
    height = hills(seed, sigma=0.02)
    height[200:400] = height[200] + 0.02 * random.standard_normal(200)
    height[400:] += height[200] - height[400]
    level = 50.0 + 0.02 * random.standard_normal(600)
    for rounded in (height, level):
        assert not held_heights(way(np.round(rounded / digits) * digits, 0.02)).any()


@pytest.mark.parametrize("digits", [1e-3, 1e-12])
@pytest.mark.parametrize("sigma", [0.3, 5.0])
def test_heights_told_to_a_millimetre_need_no_leap(digits, sigma):
    """As of a boat, which comes back to where they were held."""
    random = np.random.default_rng(3)
    height = np.round((40.0 + sigma * random.standard_normal(600)) / digits) * digits
    height[200:300] = height[200]
    height[520:] = height[520]
    found = np.flatnonzero(held_heights(way(height)))
    assert np.array_equal(found, np.r_[201:300, 521:600])


def test_all_of_a_fix_repeated_is_no_height_that_is_held():
    height = hills(1)
    height[100:200] = height[100]
    fixes = way(height)
    latitude, longitude = fixes.latitude.copy(), fixes.longitude.copy()
    latitude[100:200], longitude[100:200] = latitude[100], longitude[100]
    assert not held_heights(replace(fixes, latitude=latitude, longitude=longitude)).any()


def test_vertical_velocities_of_zero_beside_them_are_left_out_too():
    height = hills(2)
    height[100:200] = height[100]
    fixes = way(height)
    v = np.tile([0.0, 3.0, 0.1], (600, 1))
    v[100:200, 2] = 0.0
    v[50, 2] = 0.0  # by chance
    covariance = np.tile(np.eye(3), (600, 1, 1))
    velocity = Velocity(fixes.time_ns, fixes.time_ns, v, covariance)
    kept, velocity, (finding,) = without_held(fixes, velocity, "/fix")
    assert velocity is not None and finding.kind == "held-height"
    assert np.array_equal(np.flatnonzero(np.isnan(kept.height)), np.arange(101, 200))
    assert np.array_equal(np.flatnonzero(np.isnan(velocity.velocity_n[:, 2])), np.arange(101, 200))
    assert "holds its height for 49.5 s" in finding.text
