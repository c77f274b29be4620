import numpy as np
import pytest

from sinstool.core import earth, rotation
from sinstool.simulation.truth import sample_times, static

LATITUDE, HEIGHT = np.deg2rad(28.2), 1234.0
Q_NB = rotation.from_euler([0.2, -0.4, 1.9])


def test_gyro_and_accelerometer_at_rest():
    truth = static(sample_times(200.0, 1.0), 2.5 * Q_NB, LATITUDE, HEIGHT)
    c_nb = rotation.to_dcm(Q_NB)
    rate = c_nb.T @ [earth.EARTH_RATE * np.cos(LATITUDE), 0, -earth.EARTH_RATE * np.sin(LATITUDE)]
    np.testing.assert_allclose(truth.gyro_rate, np.tile(rate, (201, 1)), rtol=1e-13)
    np.testing.assert_array_equal(truth.gyro_mean_rate, truth.gyro_rate)
    np.testing.assert_allclose(truth.gyro_increment, np.tile(rate * 0.005, (201, 1)), rtol=1e-12)
    force = c_nb.T @ -earth.gravity_n(LATITUDE, HEIGHT)
    np.testing.assert_allclose(truth.specific_force, np.tile(force, (201, 1)), rtol=1e-13)
    np.testing.assert_array_equal(truth.mean_specific_force, truth.specific_force)
    np.testing.assert_allclose(truth.q_nb, np.tile(Q_NB, (201, 1)), atol=1e-15)


def test_level_and_north_is_what_an_accelerometer_reads():
    truth = static(sample_times(10.0, 1.0), [1, 0, 0, 0], -LATITUDE)
    assert truth.specific_force[3, 2] < -9.7  # reaction, up: negative down
    assert truth.gyro_rate[3, 0] > 0  # north
    assert truth.gyro_rate[3, 2] > 0  # down, in the south


def test_bad_arguments_are_refused():
    with pytest.raises(ValueError, match="q_nb"):
        static(sample_times(10.0, 1.0), np.ones((2, 4)), LATITUDE)
    with pytest.raises(ValueError, match="zero"):
        static(sample_times(10.0, 1.0), np.zeros(4), LATITUDE)
    with pytest.raises(ValueError, match="increase"):
        static(np.array([1, 1]), Q_NB, LATITUDE)
