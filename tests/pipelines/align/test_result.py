"""What `align` reports is the alignment's answer, in the units that it names."""

from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.core.rotation import from_euler
from sinstool.methods.sensor_errors import SensorGrade
from sinstool.pipelines.align.result import (
    AssumedErrors,
    angles,
    at_rest_values,
    covariance,
    in_motion_values,
    plain_values,
    sigmas,
)

SIGMA_DEG = np.array([0.2, 0.3, 1.5])


def answer(status):
    sigma = np.deg2rad(SIGMA_DEG)
    return SimpleNamespace(status=status, sigma_rad=sigma, cov=np.diag(sigma**2))


def test_the_covariance_is_the_square_of_the_sigmas():
    stated = np.sqrt(np.diag(covariance(answer("ok"))))
    np.testing.assert_allclose(stated, SIGMA_DEG)
    np.testing.assert_allclose(sigmas(answer("ok")), SIGMA_DEG)


def test_without_a_heading_there_is_neither_its_sigma_nor_a_covariance():
    assert covariance(answer("level-only")) is None
    assert sigmas(answer("level-only"))[:2] == pytest.approx(tuple(SIGMA_DEG[:2]))
    assert sigmas(answer("level-only"))[2] is None


def test_assumed_errors_are_in_the_units_of_data_sheets():
    # 1 rad is 180/pi deg and 1 rad/sqrt(s) 60 rad/sqrt(h)
    grade = SensorGrade(1e-4, 0.02, 3e-3, 4e-3, 1e-3, 0.05, 77.0)
    assumed = AssumedErrors.of(grade)
    assert assumed.gyro_bias_deg_h == pytest.approx(1e-4 * 180.0 / np.pi * 3600.0)
    assert assumed.angle_random_walk_deg_sqrt_h == pytest.approx(1e-3 * 180.0 / np.pi * 60.0)
    assert (assumed.gyro_scale, assumed.accel_scale) == (3e-3, 4e-3)
    assert assumed.accel_bias_m_s2 == 0.02
    assert assumed.velocity_random_walk_m_s_sqrt_s == 0.05
    assert assumed.bias_time_s == 77.0


BIAS = np.array([1e-5, -2e-5, 3e-5])
BIAS_DEG_H = BIAS * 180.0 / np.pi * 3600.0


def test_a_level_alignment_in_degrees():
    sigma = (*np.deg2rad(SIGMA_DEG[:2]), None)
    values = plain_values(SimpleNamespace(sigma_rad=sigma, gyro_bias=BIAS))
    assert values["sigma_deg"][:2] == pytest.approx(tuple(SIGMA_DEG[:2]))
    assert values["sigma_deg"][2] is None
    assert values["gyro_bias_deg_h"] == pytest.approx(tuple(BIAS_DEG_H))


def test_a_gyrocompass_in_degrees():
    rest = {"sigma_heading": np.deg2rad(1.5), "chi2": 1.2, "gyro_bias": BIAS,
            "accel_bias": 100.0 * BIAS}  # fmt: skip
    values = at_rest_values(SimpleNamespace(**vars(answer("ok")), **rest))
    assert values["sigma_worst_deg"] == pytest.approx(1.5)
    assert values["sigma_deg"] == pytest.approx(tuple(SIGMA_DEG))
    assert values["gyro_bias_deg_h"] == pytest.approx(tuple(BIAS_DEG_H))
    assert values["accel_bias_m_s2"] == pytest.approx(tuple(100.0 * BIAS))


@pytest.mark.parametrize("worst_deg", [1.6, 1e4])
def test_an_alignment_in_motion_in_degrees(worst_deg):
    refined = SimpleNamespace(chi2=1.3, gyro_bias=BIAS, accel_bias=100.0 * BIAS, latency_s=0.12)
    rest = {"vectors": "win", "sigma_worst": np.deg2rad(worst_deg), "rho": 0.4,
            "singular_values": (3.0, 2.0, np.nan), "n_pairs": 9, "n_rejected": 1,
            "residual_rms": 0.1, "chi2": np.inf, "time_to_align_s": 7.0,
            "errors": refined}  # fmt: skip
    made = SimpleNamespace(**vars(answer("ok")), **rest)
    values = in_motion_values(made, SensorGrade(), "on", 2.0 * BIAS)
    # Beyond what is as good as anywhere, 180 deg over the root of 3, there is no worse
    assert values["sigma_worst_deg"] == pytest.approx(min(worst_deg, 180.0 / np.sqrt(3.0)))
    assert values["gyro_bias_deg_h"] == pytest.approx(tuple(BIAS_DEG_H))
    assert values["gyro_bias_removed_deg_h"] == pytest.approx(tuple(2.0 * BIAS_DEG_H))
    assert values["singular_values"] == (3.0, 2.0, None) and values["chi2"] is None


@pytest.mark.parametrize("status", ["ok", "level-only", "unobservable"])
def test_angles_are_those_of_the_quaternion(status):
    q = from_euler(np.deg2rad([3.0, -4.0, -100.0]))
    values = angles(q if status != "unobservable" else np.full(4, np.nan), status)
    north = status == "ok"
    assert values["heading_deg"] == (pytest.approx(260.0) if north else None)
    assert (values["q_nb_wxyz"] is not None) == north
    level = (3.0, -4.0) if status != "unobservable" else (None, None)
    assert (values["roll_deg"], values["pitch_deg"]) == pytest.approx(level)
