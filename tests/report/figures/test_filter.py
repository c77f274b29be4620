"""Figures of a filter's run, from diagnostics made by hand: their numbers and units."""

import numpy as np
import pytest

from sinstool.methods.ins_gnss.results import FilterEvent, GnssDiagnostics
from sinstool.pipelines.process.summary import FilterCourse
from sinstool.report.figures.filter import MARKS, MOST, filter_figures

T0 = 1_700_000_000_000_000_000
SECOND = 10**9


def diagnosed(n=4, **columns):
    """Fixes of every second: innovations 0, sigmas 1, all used."""
    base = {
        "time_ns": T0 + SECOND * np.arange(n),
        "innovation": np.zeros((n, 6)),
        "innovation_sigma": np.ones((n, 6)),
        "measurement_sigma": np.ones((n, 6)),
        "noise_ratio": np.ones((n, 6)),
        "nis": np.full(n, 6.0),
        "rows": np.full(n, 6),
        "used": np.ones(n, bool),
        "gated": np.zeros(n, bool),
        "restarted": np.zeros(n, bool),
        "withheld": np.zeros(n, bool),
    }
    return GnssDiagnostics(**{**base, **columns})


def figures(gnss, events=(), biases=None):
    nothing = np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3))
    course = FilterCourse(T0 - 2 * SECOND, gnss, *(biases or nothing), list(events))
    return {one.key: one for one in filter_figures(course)}


def drawn(figure):
    return {one.name: one for one in figure.series}


def test_innovations_are_within_three_sigma_of_the_worst_axis():
    innovation = np.arange(24.0).reshape(4, 6)
    innovation[2, :3] = np.nan  # a fix without a position
    sigma = np.tile([1.0, 2.0, 0.5, 0.1, 0.2, 0.4], (4, 1))
    sigma[2, :3] = np.nan
    sigma[3, 0] = 7.0
    by_name = figures(diagnosed(innovation=innovation, innovation_sigma=sigma))
    position, velocity = by_name["innovation-position"], by_name["innovation-velocity"]
    assert (position.ylabel, velocity.ylabel) == ("innovation, m", "innovation, m/s")
    np.testing.assert_array_equal(position.x, [2.0, 3.0, 5.0])
    np.testing.assert_array_equal(velocity.x, [2.0, 3.0, 4.0, 5.0])
    np.testing.assert_array_equal(drawn(position)["north"].y, [0.0, 6.0, 18.0])
    np.testing.assert_array_equal(drawn(position)["down"].y, [2.0, 8.0, 20.0])
    np.testing.assert_array_equal(drawn(velocity)["east"].y, [4.0, 10.0, 16.0, 22.0])
    bound = drawn(position)["3 sigma of the worst axis"]
    np.testing.assert_array_equal(bound.y, [6.0, 6.0, 21.0, np.nan, -6.0, -6.0, -21.0])
    np.testing.assert_array_equal(bound.x, [2.0, 3.0, 5.0, 5.0, 2.0, 3.0, 5.0])
    bound = drawn(velocity)["3 sigma of the worst axis"]
    np.testing.assert_allclose(bound.y[:4], 1.2)


def test_size_of_innovations_is_by_what_became_of_the_fix():
    gnss = diagnosed(
        5,
        nis=np.array([6.0, 24.0, 27.0, np.nan, 0.0]),
        rows=np.array([6, 6, 3, 6, 0]),
        used=np.array([True, False, False, True, True]),
        gated=np.array([False, True, False, False, False]),
        withheld=np.array([False, False, True, False, False]),
    )
    figure = figures(gnss)["nis"]
    shown = {name: (one.x.tolist(), one.y.tolist()) for name, one in drawn(figure).items()}
    assert shown == {
        "used": ([2.0, 6.0], [1.0, 0.0]),
        "rejected": ([3.0], [2.0]),
        "withheld": ([4.0], [3.0]),
    }
    assert figure.levels == (("expected", 1.0),)


def test_biases_are_in_degrees_per_hour_and_metres_per_second_squared():
    gyro = np.radians([[1.0, 2.0, -3.0], [4.0, 5.0, 6.0]]) / 3600.0
    accel = np.array([[0.01, 0.02, -0.03], [0.04, 0.05, 0.06]])
    by_name = figures(diagnosed(), biases=(T0 + SECOND * np.array([8, 18]), gyro, accel))
    assert by_name["gyro-bias"].ylabel == "bias, deg/h"
    assert by_name["accel-bias"].ylabel == "bias, m/s²"
    np.testing.assert_array_equal(by_name["gyro-bias"].x, [10.0, 20.0])
    np.testing.assert_allclose(drawn(by_name["gyro-bias"])["down"].y, [-3.0, 6.0])
    np.testing.assert_allclose(drawn(by_name["gyro-bias"])["forward"].y, [1.0, 4.0])
    np.testing.assert_array_equal(drawn(by_name["accel-bias"])["right"].y, [0.02, 0.05])


def test_events_are_marked_but_for_single_rejected_fixes():
    events = [FilterEvent("gated", T0, 30.0), FilterEvent("imu-gap", T0 + SECOND // 2, 0.5)]
    events += [FilterEvent("restart", T0 + k * SECOND, 99.0) for k in range(1, MARKS + 5)]
    by_name = figures(diagnosed(), events)
    marks = by_name["nis"].marks
    assert marks[:2] == (("imu-gap", 2.5), ("restart", 3.0)) and len(marks) == MARKS
    assert by_name["innovation-position"].marks == marks


@pytest.mark.parametrize("n", [MOST, MOST + 1, 2 * MOST + 1])
def test_of_many_fixes_every_so_many_are_drawn(n):
    every = -(-n // MOST)
    by_name = figures(diagnosed(n, innovation=np.tile(np.arange(n, dtype=float)[:, None], 6)))
    figure = by_name["innovation-velocity"]
    np.testing.assert_array_equal(drawn(figure)["east"].y, np.arange(n)[::every])
    np.testing.assert_array_equal(figure.x, 2.0 + np.arange(n)[::every])
    assert len(figure.x) <= MOST
