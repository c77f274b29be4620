"""Figures of a simulated log, from motions made by hand: their numbers and units."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.core.streams import Solution
from sinstool.report.figures.simulation import baro_figures, fix_figures, motion_figures
from sinstool.report.recorder import Recorder
from sinstool.simulation.truth import ImuTruth, Trajectory

T0 = 1_700_000_000_000_000_000
# WGS-84, by its definition
EQUATOR_M = 6_378_137.0
FLATTENING = 1.0 / 298.257223563
MERIDIAN_M = EQUATOR_M * (1.0 - FLATTENING * (2.0 - FLATTENING))  # its radius at the equator


def still(n, hertz, rate=None):
    """Truth of a body that keeps its attitude; a rate may be told, rad/s."""
    dt = 1.0 / hertz
    rate = np.zeros((n, 3)) if rate is None else rate
    force = np.tile([0.0, 0.0, -9.8], (n, 1))
    return ImuTruth(
        time_ns=T0 + np.round(np.arange(n) * dt * 1e9).astype(np.int64),
        interval=np.full(n, dt),
        gyro_rate=rate,
        gyro_mean_rate=rate,
        gyro_increment=rate * dt,
        specific_force=force,
        mean_specific_force=force,
        q_nb=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
    )


def travelled(latitude_deg, longitude_deg, height, hertz=1.0):
    n = len(latitude_deg)
    return Trajectory(
        still(n, hertz),
        np.radians(latitude_deg),
        np.radians(longitude_deg),
        np.asarray(height, float),
        np.outer(np.arange(n), [1.0, 2.0, -3.0]),
    )


def drawn(figure):
    return {one.name: one.y for one in figure.series}


def by_key(figures):
    return {one.key: one for one in figures}


def test_errors_of_fixes_are_fix_less_truth_and_down_is_down():
    """On the equator at 180 deg, where the radii are known; a fix too low is off downwards."""
    truth = travelled([0.0, 0.0], [180.0, 180.0], [1000.0, 1010.0])
    at = T0 + np.array([250_000_000, 500_000_000, 1_000_000_000])
    height = np.array([1002.5, 1005.0, 1010.0])
    columns = {
        "latitude": np.degrees(np.array([3.0, 0.0, 0.0]) / (MERIDIAN_M + height)),
        # the other side of the line: east of it
        "longitude": -180.0 + np.degrees(np.array([4.0, 0.0, -2.0]) / (EQUATOR_M + height)),
        "altitude": height - np.array([0.0, 5.0, -7.0]),
    }
    (figure,) = fix_figures(at, columns, truth)
    assert (figure.key, figure.ylabel) == ("fix-error", "error, m")
    np.testing.assert_allclose(figure.x, [0.25, 0.5, 1.0])
    assert all(one.style == "points" for one in figure.series)
    shown = drawn(figure)
    np.testing.assert_allclose(shown["north"], [3.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(shown["east"], [4.0, 0.0, -2.0], atol=1e-6)
    np.testing.assert_allclose(shown["down"], [0.0, 5.0, -7.0], atol=1e-9)


def test_error_of_the_barometer_is_that_of_its_geometric_height():
    """Sea level and 11 km of the standard atmosphere: geopotential 11000 m is 11019.1 m."""
    truth = travelled([0.0, 0.0], [0.0, 0.0], [20.0, 11_000.0])
    at = T0 + np.array([0, 1_000_000_000])
    (figure,) = baro_figures(at, np.array([101_325.0, 22_632.06]), truth)
    assert (figure.key, figure.ylabel) == ("baro-error", "error, m")
    np.testing.assert_array_equal(figure.x, [0.0, 1.0])
    np.testing.assert_allclose(drawn(figure)["error"], [-20.0, 19.1], atol=0.05)


def test_errors_of_sensors_are_in_their_own_units_and_added_up():
    truth = still(101, 10.0)
    # one degree per hour about right, two milli-metres per second squared forward
    off = np.tile([0.0, np.radians(1.0) / 3600.0, 0.0], (101, 1))
    sensor = replace(
        truth,
        gyro_mean_rate=truth.gyro_mean_rate + off,
        mean_specific_force=truth.mean_specific_force + np.array([2e-3, 0.0, 0.0]),
    )
    by_name = by_key(motion_figures(truth, sensor, None))
    gyro, added, accel = (by_name[key] for key in ("gyro-error", "gyro-sum", "accel-error"))
    assert (gyro.ylabel, added.ylabel, accel.ylabel) == (
        "error, deg/h", "angle, deg", "error, mm/s²",
    )  # fmt: skip
    np.testing.assert_allclose(drawn(gyro)["right"], 1.0)
    np.testing.assert_array_equal(drawn(gyro)["forward"], 0.0)
    np.testing.assert_allclose(drawn(added)["right"], 0.1 * np.arange(1, 102) / 3600.0)
    np.testing.assert_allclose(drawn(accel)["forward"], 2.0)
    np.testing.assert_array_equal(drawn(accel)["down"], 0.0)
    np.testing.assert_allclose(drawn(by_name["force"])["down"], -9.8)


def test_exact_sensors_have_no_errors_to_draw():
    truth = still(101, 10.0)
    assert set(by_key(motion_figures(truth, truth, None))) == {"tilt", "heading", "rate", "force"}


@pytest.mark.parametrize("turns_hz, closer", [(0.9, False), (1.2, True), (10.0, True)])
def test_a_closer_look_is_drawn_of_fast_motion(turns_hz, closer):
    seconds = np.arange(3000) / 100.0
    rate = np.zeros((3000, 3))
    # about a constant rate, which must not hide the turning
    rate[:, 1] = 5.0 + 2.0 * np.sin(2.0 * np.pi * turns_hz * seconds + 0.1)
    truth = still(3000, 100.0, rate)
    figures = motion_figures(truth, truth, None)
    by_name = by_key(figures)
    assert ("closer" in by_name) == closer
    np.testing.assert_allclose(drawn(by_name["rate"])["right"], np.degrees(rate[:, 1]))
    if closer:
        look = by_name["closer"]
        assert figures[0] is look and look.ylabel == "rate, deg/s"
        # 200 samples about two thirds of the log
        np.testing.assert_allclose(look.x, seconds[1900:2100], atol=1e-9)
        np.testing.assert_allclose(drawn(look)["right"], np.degrees(rate[1900:2100, 1]))


def test_a_short_log_is_close_enough():
    rate = np.tile([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], (100, 1))
    truth = still(200, 100.0, rate)
    assert "closer" not in by_key(motion_figures(truth, truth, None))


def test_height_and_velocity_are_the_true_ones():
    truth = travelled([52.0, 52.001, 52.002], [13.0] * 3, [40.0, 43.0, 46.0])
    by_name = by_key(motion_figures(truth.imu, truth.imu, truth))
    np.testing.assert_array_equal(drawn(by_name["height"])["true"], [40.0, 43.0, 46.0])
    velocity = drawn(by_name["velocity"])
    assert list(velocity) == ["north", "east", "down"]
    np.testing.assert_array_equal(velocity["down"], [0.0, -3.0, -6.0])
    assert (by_name["height"].ylabel, by_name["velocity"].ylabel) == ("height, m", "velocity, m/s")


def test_a_drive_has_the_same_track_when_simulated_and_when_processed():
    """Three kilometres north and three east: whatever unit is chosen, both pages have it."""
    n = 11
    latitude = -43.5 + np.linspace(0.0, 0.027, n)
    longitude = (179.99 + np.linspace(0.0, 0.037, n) + 180.0) % 360.0 - 180.0
    truth = travelled(latitude, longitude, np.linspace(0.0, 300.0, n))
    simulated = by_key(motion_figures(truth.imu, truth.imu, truth))["track"]
    recorder = Recorder()
    position = np.stack([truth.latitude, truth.longitude, truth.height], axis=1)
    imu = truth.imu
    recorder.push(
        Solution(
            imu.time_ns, imu.time_ns, imu.q_nb, imu.gyro_rate, imu.specific_force,
            position=position, velocity_n=truth.velocity_n,
        )
    )  # fmt: skip
    alignment = SimpleNamespace(north_referenced=True)
    result = SimpleNamespace(
        hse=None, height=None, filter=None, smoothing=None, alignment=alignment
    )
    processed = by_key(recorder.figures(result)[0])["track"]
    assert (simulated.xlabel, simulated.ylabel) == (processed.xlabel, processed.ylabel)
    assert simulated.ylabel == "north, m"
    np.testing.assert_array_equal(simulated.x, processed.x)
    np.testing.assert_array_equal(drawn(simulated)["true"], drawn(processed)["computed"])
    np.testing.assert_allclose(simulated.x[-1], 2990.0, rtol=2e-3)
