"""What `align` reports is the alignment's answer, in the units that it names."""

from types import SimpleNamespace

import numpy as np
import pytest

from sinstool.methods.sensor_errors import SensorGrade
from sinstool.pipelines.align.result import AssumedErrors, covariance, sigmas

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
