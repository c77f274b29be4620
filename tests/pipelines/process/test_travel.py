"""How far, how fast and how well, of solutions made by hand."""

import tracemalloc
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.core.earth import radii_of_curvature
from sinstool.core.streams import Solution
from sinstool.pipelines.process.travel import MOST_SIGMAS, Odometer, find_outages

T0 = 1_700_000_000_000_000_000
LATITUDE = 0.8


def eastward(seconds, speed=10.0, rate=10, sigma=None):
    """Along a parallel over the end of the turn; the noise of its places averages out."""
    n = seconds * rate + 1
    times = T0 + np.arange(n) * (10**9 // rate)
    circle = (float(radii_of_curvature(LATITUDE)[1]) + 100.0) * np.cos(LATITUDE)
    longitude = np.pi - 1e-7 + speed / circle * np.arange(n) / rate
    place = np.stack([np.full(n, LATITUDE), (longitude + np.pi) % (2 * np.pi) - np.pi,
                      np.full(n, 100.0)], axis=1)  # fmt: skip
    velocity = np.tile([3.0, speed, 40.0], (n, 1))
    q_nb, zero = np.tile([1.0, 0, 0, 0], (n, 1)), np.zeros((n, 3))
    known = {}
    if sigma is not None:
        known = {
            "covariance_attitude_n": np.array([np.diag(np.radians(s[:3]) ** 2) for s in sigma(n)]),
            "covariance_position_n": np.array([np.diag(s[3:] ** 2) for s in sigma(n)]),
        }
    return Solution(times, times, q_nb, zero, zero, place, velocity, **known)


def odometer(solution, blocks):
    made = Odometer()
    for rows in np.array_split(np.arange(len(solution)), blocks):
        made.push(solution.rows(slice(rows[0], rows[-1] + 1)))
    return made.travel()


@pytest.mark.parametrize("blocks", [1, 7, 40])
def test_distance_and_speed_do_not_depend_on_blocks(blocks):
    travel = odometer(eastward(30), blocks)
    assert travel.duration_s == 30.0
    assert travel.distance_m == pytest.approx(300.0, rel=1e-6)
    assert travel.mean_speed_m_s == pytest.approx(10.0, rel=1e-6)
    assert travel.largest_speed_m_s == pytest.approx(np.hypot(3.0, 10.0))
    assert travel.accuracy is None


def test_noise_at_rest_adds_up_once_a_second_only():
    rest = eastward(100, speed=0.0, rate=100)
    rng = np.random.default_rng(2)
    rest.position[:, :2] += rng.normal(0.0, 1e-9, (len(rest), 2))  # 6 mm
    every = np.hypot(*np.diff(rest.position[:, :2] * 6.4e6, axis=0).T).sum()
    assert odometer(rest, 3).distance_m < 0.02 * every


def test_accuracy_is_the_median_and_the_largest():
    def sigma(n):
        first = np.array([[5.0, 9.0, 20.0, 7.0, 8.0, 12.0]])
        return np.concatenate([first, np.tile([0.2, 0.1, 1.0, 0.5, 0.6, 2.0], (n - 1, 1))])

    known = odometer(eastward(20, sigma=sigma), 3).accuracy
    for spread, expected in (
        (known.tilt_deg, (0.2, 9.0)),
        (known.heading_deg, (1.0, 20.0)),
        (known.horizontal_m, (0.6, 8.0)),
        (known.height_m, (2.0, 12.0)),
    ):
        assert (spread.median, spread.largest) == pytest.approx(expected)


def test_memory_is_bounded():
    def sigma(n):
        return np.tile([0.2, 0.1, 1.0, 0.5, 0.6, 2.0], (n, 1))

    made = Odometer()
    made.push(eastward(3 * MOST_SIGMAS, rate=1, sigma=sigma))
    assert MOST_SIGMAS // 2 <= len(made._sigmas) <= MOST_SIGMAS
    assert made.travel().accuracy.heading_deg.median == pytest.approx(1.0)


def test_a_clock_that_leaps_takes_no_memory():
    """A computer without a clock starts in 1970: it asked for 12 GiB, for the seconds between."""
    made, before, after = Odometer(), eastward(3), eastward(3)
    made.push(before)
    tracemalloc.start()
    made.push(replace(after, time_ns=after.time_ns + 3_000_000 * 10**9))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 1e6
    assert made.travel().duration_s == 3_000_003.0


def test_nothing_and_attitude_alone():
    empty = Odometer().travel()
    assert (empty.duration_s, empty.distance_m, empty.accuracy) == (0.0, None, None)
    there = eastward(5)
    alone = Solution(there.time_ns, there.time_ns, there.q_nb, there.omega_ib_b,
                     there.specific_force_b)  # fmt: skip
    travel = odometer(alone, 2)
    assert (travel.duration_s, travel.mean_speed_m_s) == (5.0, None)


def epochs(seconds, used=None):
    times = T0 + (np.asarray(seconds) * 1e9).astype(np.int64)
    taken = np.ones(len(times), bool) if used is None else np.asarray(used, bool)
    return SimpleNamespace(time_ns=times, used=taken)


def test_outages_are_long_gaps_between_fixes_that_were_used():
    one = epochs([0, 1, 2, 3, 8, 9])
    two = epochs([10, 11, 12, 13, 14, 15], used=[1, 0, 0, 0, 0, 1])
    found = find_outages([one, two])
    assert (found.count, found.total_s, found.longest_s) == (2, 10.0, 5.0)
    # 1.5 s at ten a second is no outage, nor is 2.9 s at one a second
    assert find_outages([epochs([0, 0.1, 0.2, 0.3, 1.8])]).count == 0
    assert find_outages([epochs([0, 1, 2, 3, 5.9])]).count == 0
    assert find_outages([]).count == find_outages([epochs([0.0])]).count == 0
