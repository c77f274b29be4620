"""The recorder of a run: what it shows of solutions made by hand, and in which order."""

from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.core.rotation import from_euler
from sinstool.core.streams import Solution
from sinstool.pipelines.process.errors_against_truth import Truth
from sinstool.report.figure import Figure, Series
from sinstool.report.recorder import FIXES, MARKS, Recorder

T0 = 1_700_000_000_000_000_000
SECOND = 10**9
N = 40


def solutions(**columns):
    """Ten per second, turning by 20 deg each, from 301 deg on; forty of them."""
    times = T0 + SECOND // 10 * np.arange(N)
    angles = np.stack([np.full(N, 3.0), np.full(N, -4.0), 301.0 + 20.0 * np.arange(N)], axis=1)
    rate = np.tile(np.radians([3.0, 4.0, 12.0]), (N, 1))
    force = np.tile([0.0, 0.0, -9.8], (N, 1))
    q_nb = from_euler(np.radians(angles))
    return Solution(times, times, q_nb, rate, force, **columns)


def travelling():
    """Northward at the equator by 1e-6 rad each, rising by 1 m each."""
    step = np.arange(N)
    position = np.stack([1e-6 * step, np.full(N, 0.5), 100.0 + step], axis=1)
    velocity = np.outer(np.ones(N), [64.0, 1.0, -10.0])
    return {"position": position, "velocity_n": velocity}


def recorded(solution, *, blocks=1, height=None, hse=None, truth=None, prepare=None):
    recorder = Recorder(truth)
    if prepare is not None:
        prepare(recorder)
    for rows in np.array_split(np.arange(N), blocks):
        recorder.push(solution.rows(slice(rows[0], rows[-1] + 1)))
    alignment = SimpleNamespace(north_referenced=True)
    result = SimpleNamespace(
        height=height, hse=hse, filter=None, smoothing=None, alignment=alignment
    )
    results, checks = recorder.figures(result)
    return recorder, {one.key: one for one in (*results, *checks)}


def drawn(figure):
    return {one.name: one.y for one in figure.series}


def extra(key="nis"):
    return Figure(key, key, np.zeros(1), (Series("used", np.ones(1)),), "s", "size, m")


@pytest.mark.parametrize("blocks", [1, 7])
def test_attitude_rates_and_forces_are_in_degrees_and_metres(blocks):
    recorder, shown = recorded(solutions(), blocks=blocks)
    assert recorder.errors() is None
    assert list(shown) == ["heading", "tilt", "rate", "force"]
    np.testing.assert_allclose(shown["tilt"].x, 0.1 * np.arange(N), atol=1e-9)
    np.testing.assert_allclose(drawn(shown["tilt"])["roll"], 3.0)
    np.testing.assert_allclose(drawn(shown["tilt"])["pitch"], -4.0)
    heading = drawn(shown["heading"])["heading"]
    whole = heading[np.isfinite(heading)]
    assert len(heading) - len(whole) == 2  # over south, which it passes less often than north
    np.testing.assert_allclose(whole, (121.0 + 20.0 * np.arange(N)) % 360.0 - 180.0, atol=1e-9)
    np.testing.assert_allclose(drawn(shown["rate"])["rate"], 13.0)
    np.testing.assert_allclose(drawn(shown["force"])["force"], 9.8)
    assert shown["rate"].ylabel == "norm, deg/s" and shown["force"].ylabel == "norm, m/s²"


def test_a_run_that_nothing_came_of_has_no_figures():
    recorder = Recorder()
    recorder.push(solutions().rows(slice(0, 0)))
    assert recorder.figures({}) == ((), ())


def test_results_come_first_and_figures_of_a_kind_of_run_are_checks():
    def prepare(recorder):
        recorder.extra += [extra("innovation"), extra("nis")]

    sigma = np.tile(np.diag([4.0, 9.0, 16.0]), (N, 1, 1))
    solution = solutions(**travelling(), covariance_position_n=sigma)
    _, shown = recorded(solution, prepare=prepare)
    assert list(shown) == [
        "track", "heading", "height", "speed", "tilt", "velocity", "sigma-position", "innovation",
        "nis", "rate", "force",
    ]  # fmt: skip
    np.testing.assert_allclose(drawn(shown["speed"])["speed"], np.hypot(64.0, 1.0))
    assert shown["sigma-position"].log_y
    assert [drawn(shown["sigma-position"])[a][0] for a in ("north", "east", "down")] == [2, 3, 4]
    np.testing.assert_array_equal(drawn(shown["velocity"])["down"], -10.0)
    np.testing.assert_array_equal(drawn(shown["height"])["computed"], 100.0 + np.arange(N))
    vertical = np.tile([5.0, 1.0, 0.0], (N, 1))
    _, shown = recorded(solutions(vertical=vertical), prepare=prepare)
    assert list(shown) == ["heading", "height", "tilt", "innovation", "nis", "up", "correction",
                           "rate", "force"]  # fmt: skip
    np.testing.assert_array_equal(drawn(shown["up"])["up"], 1.0)


def test_track_is_in_metres_from_the_first_place_with_the_fixes_about_it():
    latitude, longitude = 1e-6 * np.arange(2.0 * FIXES + 2), np.full(2 * FIXES + 2, 0.5)
    latitude[1] = np.nan

    def prepare(recorder):
        recorder.refer_track(latitude, longitude)

    _, shown = recorded(solutions(**travelling()), prepare=prepare)
    meridian = 6_378_137.0 * (1.0 - 0.00669437999014)
    north = drawn(shown["track"])["computed"]
    np.testing.assert_allclose(north, 1e-6 * meridian * np.arange(N), atol=1e-6)
    assert shown["track"].ylabel == "north, m"
    fixes = drawn(shown["track"])["GNSS fixes"]
    assert len(fixes) <= FIXES
    by_name = {one.name: one for one in shown["track"].series}
    np.testing.assert_allclose(by_name["computed"].shade, np.hypot(64.0, 1.0))
    assert shown["track"].shade_label == "speed, m/s"
    assert next(iter(by_name)) == "GNSS fixes" and by_name["GNSS fixes"].style == "halo"
    # of those that have a position every third
    expected = meridian * np.delete(latitude, 1)[::3]
    np.testing.assert_allclose(fixes, expected, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("blocks", [1, 6])
def test_height_is_compared_at_the_instants_of_its_reference(blocks):
    """It rises by 10 m/s; references of any order, two of them outside of the run."""
    at = np.array([2.05, -1.0, 0.55, 3.9, 0.0, 5.0])
    off = np.array([1.0, 9.0, 2.0, 3.0, 4.0, 9.0])

    def prepare(recorder):
        stamps = T0 + np.round(at * SECOND).astype(np.int64)
        recorder.refer_height("/baro", stamps, 100.0 + 10.0 * at - off)

    _, shown = recorded(solutions(**travelling()), blocks=blocks, prepare=prepare)
    figure = shown["difference"]
    assert figure.ylabel == "difference, m"
    np.testing.assert_allclose(figure.x, [0.0, 0.55, 2.05, 3.9], atol=1e-9)
    np.testing.assert_allclose(drawn(figure)["computed less reference"], [4, 2, 1, 3], atol=1e-6)
    np.testing.assert_allclose(drawn(shown["height"])["/baro"], [96, 103.5, 119.5, 136], atol=1e-6)


def test_errors_against_the_truth_are_drawn_and_reported():
    """The true heading is less by ten arc seconds, the true velocity down more by 2 m/s."""
    solution = solutions(**travelling())
    turned = np.stack([np.zeros(N), np.zeros(N), np.full(N, 10.0 / 3600.0)], axis=1)
    angles = np.stack([np.full(N, 3.0), np.full(N, -4.0), 301.0 + 20.0 * np.arange(N)], axis=1)
    truth = Truth(
        attitude=(solution.time_ns, from_euler(np.radians(angles - turned))),
        velocity=(solution.time_ns, solution.velocity_n + np.array([0.0, 0.0, 2.0])),
        names=("truth.csv",),
    )
    recorder, shown = recorded(solution, blocks=3, truth=truth)
    assert list(shown)[5:8] == ["velocity", "error-attitude", "error-velocity"]
    assert shown["error-attitude"].ylabel == "error, arcsec"
    np.testing.assert_allclose(drawn(shown["error-attitude"])["down"], 10.0, atol=1e-6)
    np.testing.assert_allclose(drawn(shown["error-attitude"])["north"], 0.0, atol=1e-6)
    np.testing.assert_allclose(drawn(shown["error-velocity"])["down"], -2.0)
    errors = recorder.errors()
    np.testing.assert_allclose(errors.attitude_deg.rms[2], 10.0 / 3600.0)
    assert errors.velocity_m_s.instants == N


def test_sigmas_of_attitude_are_in_degrees_and_their_bounds_in_the_errors_unit():
    sigma = np.tile(np.diag(np.radians([1.0, 2.0, 3.0]) ** 2 / 3600.0**2), (N, 1, 1))
    solution = solutions(covariance_attitude_n=sigma)
    truth = Truth(attitude=(solution.time_ns, solution.q_nb), names=("truth.csv",))
    _, shown = recorded(solution, truth=truth)
    figure = shown["error-attitude"]
    assert figure.ylabel == "error, arcsec"
    for axis, bound in (("north", 3.0), ("east", 6.0), ("down", 9.0)):
        np.testing.assert_allclose(drawn(figure)[f"3 sigma, {axis}"][:N], bound)


def test_events_of_the_height_are_marked_but_for_its_beginning():
    events = [SimpleNamespace(kind="engaged", time_ns=T0)]
    for k in range(1, MARKS + 3):
        events.append(SimpleNamespace(kind="coast", time_ns=T0 + k * SECOND // 4))
    height = SimpleNamespace(events=events)
    _, shown = recorded(solutions(**travelling()), height=height)
    marks = shown["height"].marks
    assert marks[:2] == (("coast", 0.25), ("coast", 0.5)) and len(marks) == MARKS


def test_stretches_come_first():
    segment = SimpleNamespace(rate_deg_s=60.0, heading_raw_deg=10.001, heading_deg=10.0,
                              sigma_heading_arcsec=2.0)  # fmt: skip
    _, shown = recorded(solutions(), hse=SimpleNamespace(segments=[segment]))
    assert next(iter(shown)) == "stretches"
    np.testing.assert_allclose(drawn(shown["stretches"])["as aligned"], 3.6)
    np.testing.assert_array_equal(shown["stretches"].series[1].error, [2.0])
