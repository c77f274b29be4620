from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sinstool.core.earth import earth_rate_n
from sinstool.core.errors import AlignmentError
from sinstool.methods.alignment.initial import (
    from_angles,
    from_log,
    from_motion,
    from_still,
    off_level,
    still_bias,
)
from sinstool.methods.alignment.still import WindowStage, still_spans
from tests.helpers.imulogs import G, even_times, handheld, resting

EARTH_RATE = 7.292115e-5


def windows(gyro, accel):
    stage = WindowStage()
    stage.push(even_times(len(gyro)), gyro, accel)
    return stage.finish()


def turned(rows, rotation):
    return rotation.inv().apply(rows)


angles = st.floats(-179.0, 179.0)


@given(angles, st.floats(-89.0, 89.0), angles, st.floats(-90.0, 90.0))
def test_the_earths_rate_is_no_bias(roll, pitch, heading, latitude):
    attitude = Rotation.from_euler("ZYX", [heading, pitch, roll], degrees=True)
    q_nb = attitude.as_quat(scalar_first=True)
    bias = np.array([0.01, -0.02, 0.005])
    lat = np.radians(latitude)
    omega_n = EARTH_RATE * np.array([np.cos(lat), 0.0, -np.sin(lat)])
    gyro = np.tile(bias + attitude.inv().apply(omega_n), (400, 1))
    accel = np.tile(attitude.inv().apply([0.0, 0.0, -G]), (400, 1))
    (span,) = still_spans(windows(gyro, accel))
    np.testing.assert_allclose(still_bias(span, q_nb, earth_rate_n(lat)), bias, atol=1e-10)
    # without a latitude it cannot be told from the bias
    np.testing.assert_allclose(still_bias(span, q_nb, None), gyro[0], atol=1e-12)


@given(angles, st.floats(-89.0, 89.0))
def test_levelled_from_rest(roll, pitch):
    attitude = Rotation.from_euler("ZYX", [0.0, pitch, roll], degrees=True)
    gyro, accel = resting(800, accel_noise=0.0)
    accel = attitude.inv().apply(-accel)  # up in NED
    (span,) = still_spans(windows(gyro, accel))
    got = from_still(span, 12)
    result = Rotation.from_quat(got.q_nb, scalar_first=True)
    assert (result.inv() * attitude).magnitude() < 1e-8
    assert (got.method, got.time_ns, got.status, got.north_referenced) == ("level", 12, "ok", False)
    assert got.bias_source == "none" and not got.gyro_bias.any()


def test_sigma_of_tilt_is_that_of_the_bias_or_what_the_rest_shows():
    gyro, accel = resting(800, accel_noise=0.02)
    (span,) = still_spans(windows(gyro, -accel))
    noise = span.accel_std / np.sqrt(800) / G
    excess = abs(np.linalg.norm(span.accel) - G) / G
    roll, pitch, heading = from_still(span, 0).sigma_rad
    assert roll == pitch == pytest.approx(max(noise, excess))
    assert heading is None
    assert from_still(span, 0, 0.1).sigma_rad[1] == pytest.approx(0.1 / 9.80665)
    # an accelerometer that reads 9.5 m/s^2 at rest may be tilted by its bias of 0.3
    (off,) = still_spans(windows(gyro, -accel * 9.5 / G))
    assert from_still(off, 0, 0.1).sigma_rad[0] == pytest.approx(0.3 / G, rel=0.03)


@pytest.mark.parametrize("factor", [G, 1.0 / G, 200.0])
def test_a_tilt_whose_sigma_means_nothing_is_not_ok(factor):
    gyro, accel = resting(800)
    (span,) = still_spans(windows(gyro, -accel))
    span = replace(span, accel=factor * span.accel)
    got = from_still(span, 0)
    assert got.status == "degraded" and "--accel-unit" in got.warnings[0]
    assert np.deg2rad(5.0) < got.sigma_rad[0] < 2.0
    with pytest.raises(AlignmentError, match="no gravity"):
        from_still(replace(span, accel=0.0 * span.accel), 0)


def test_a_moving_start_gives_a_rough_tilt_and_says_so():
    gyro, accel, attitude = handheld(1000, seed=4, size=0.3)
    # FLU in ENU to FRD in NED, level at the start
    got = from_motion(windows(gyro * [1, -1, -1], accel * [1, -1, -1]), 5)
    down = Rotation.from_quat(got.q_nb, scalar_first=True).inv().apply([0.0, 0.0, 1.0])
    mean = attitude[:200].inv().apply([0.0, 0.0, 1.0]).mean(axis=0)
    expected = -(mean / np.linalg.norm(mean)) * [1, -1, -1]
    assert np.degrees(np.arccos(np.clip(down @ expected, -1, 1))) < 1.0
    assert (got.method, got.status) == ("level-moving", "degraded")
    assert "6 deg for each m/s^2" in got.warnings[0]


def test_a_moving_start_without_gravity_is_refused():
    gyro, accel, _ = handheld(1000, seed=4)
    with pytest.raises(AlignmentError, match=r"no gravity.*--align fixed"):
        from_motion(windows(gyro, accel * 0.01), 0)


def test_given_attitudes_are_taken_as_they_are():
    angles = np.radians([10.0, -20.0, 130.0])
    got = from_angles(tuple(angles), 7)
    expected = Rotation.from_euler("ZYX", angles[::-1])
    assert (Rotation.from_quat(got.q_nb, scalar_first=True).inv() * expected).magnitude() < 1e-15
    assert (got.method, got.time_ns, got.north_referenced) == ("fixed", 7, True)
    from_topic = from_log(got.q_nb, 8)
    np.testing.assert_array_equal(from_topic.q_nb, got.q_nb)
    assert (from_topic.method, from_topic.time_ns) == ("log", 8)


@given(
    angles,
    st.floats(-89.0, 89.0),
    angles,
    st.floats(-0.01, 0.01),
    st.floats(-0.01, 0.01),
    st.floats(-0.5, 0.5),
)
def test_sigmas_by_which_an_attitude_denies_a_rest(roll, pitch, heading, north, east, down):
    """Those of its tilt; heading has no part in it."""
    true = Rotation.from_euler("ZYX", [heading, pitch, roll], degrees=True)
    specific_force = true.inv().apply([0.0, 0.0, -G])
    wrong = Rotation.from_rotvec([0.0, 0.0, down]) * Rotation.from_rotvec([north, east, 0.0]) * true
    covariance = np.diag([3e-3, 3e-3, 0.2]) ** 2
    off = off_level(wrong.as_quat(scalar_first=True), covariance, specific_force, 4e-3 * G)
    assert off == pytest.approx(np.hypot(north, east) / 5e-3, rel=1e-3, abs=1e-6)
