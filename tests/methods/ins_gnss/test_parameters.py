"""Settings as numbers of the compiled filter: noise, correlation and variance fit together."""

from dataclasses import replace

import numpy as np
import pytest

from sinstool.methods.height.network import HeightNetwork
from sinstool.methods.ins_gnss.parameters import (
    decay_rates,
    initial_covariance,
    loop_parameters,
    noise_densities,
)
from sinstool.methods.ins_gnss.settings import BaroModel, DivergenceControl, GnssModel, Settings
from sinstool.methods.ins_gnss.states import (
    ACCEL_AXES,
    ACCEL_BIAS,
    ACCEL_SCALE,
    ATTITUDE,
    BARO,
    FILTERS,
    GNSS_POSITION,
    GNSS_VELOCITY,
    GYRO_AXES,
    GYRO_BIAS,
    GYRO_SCALE,
    POSITION,
    VELOCITY,
)
from sinstool.methods.sensor_errors import SensorGrade
from tests.helpers.filter_start import start

IMU = SensorGrade(
    gyro_bias=3e-5, accel_bias=2e-3, angle_random_walk=7e-6, velocity_random_walk=9e-4,
    gyro_scale=4e-4, accel_scale=6e-4, gyro_instability=1e-5, accel_instability=5e-4,
    bias_time_s=700.0, scale_wander=0.25,
)  # fmt: skip
GNSS = GnssModel((1.0, 2.0, 3.0), (4.0, 5.0, 6.0), 210.0, (0.1, 0.2, 0.3), (0.4, 0.5, 0.6), 50.0)
SETTINGS = Settings(
    filter="network-29a", imu=IMU, gnss=GNSS, baro=BaroModel(7.0, 400.0, 0.7),
    network=HeightNetwork(5.0, 0.5), grade="tactical", correction_sigma=0.03,
    control=DivergenceControl(virtual_noise=False),
)  # fmt: skip
START = start(0.8, 0.1, 100.0, (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0), (8.0, 9.0, 10.0), 0.5, 0.02)
BLOCKS = {
    POSITION: 3, VELOCITY: 3, ATTITUDE: 3, BARO: 1, GYRO_BIAS: 3, ACCEL_BIAS: 3, ACCEL_SCALE: 3,
    GYRO_SCALE: 3, GNSS_POSITION: 3, GNSS_VELOCITY: 3,
}  # fmt: skip


@pytest.mark.parametrize("name", FILTERS)
def test_processes_with_a_correlation_time_keep_the_variance_that_they_begin_with(name):
    kind, settings = FILTERS[name], replace(SETTINGS, filter=name)
    rate, noise = decay_rates(kind, settings), noise_densities(kind, START, settings)
    variance = np.diag(initial_covariance(kind, START, settings))
    assert len(rate) == len(noise) == len(variance) == kind.size
    lasting = {BARO: 400.0, GNSS_POSITION: 210.0, GNSS_VELOCITY: 50.0}
    for block, size in BLOCKS.items():
        first = kind.first(block)
        if first < 0:
            continue
        rows = slice(first, first + size)
        time = lasting.get(block, np.inf)
        np.testing.assert_allclose(rate[rows], 1.0 / time)
        if block in lasting:
            # d/dt P = -2 P / T + q = 0
            np.testing.assert_allclose(noise[rows], 2.0 * variance[rows] / time)


def test_variances_are_squares_of_the_sigmas_given():
    kind = FILTERS["network-29a"]
    p = initial_covariance(kind, START, SETTINGS)
    wander = np.hypot(IMU.gyro_bias, IMU.gyro_instability)
    expected = {
        POSITION: (8.0, 9.0, 10.0), VELOCITY: 0.5, ATTITUDE: 0.02, BARO: 7.0, GYRO_BIAS: wander,
        ACCEL_BIAS: np.hypot(IMU.accel_bias, IMU.accel_instability), ACCEL_SCALE: 6e-4,
        GYRO_SCALE: 4e-4, GNSS_POSITION: (4.0, 5.0, 6.0), GNSS_VELOCITY: (0.4, 0.5, 0.6),
    }  # fmt: skip
    for block, sigma in expected.items():
        rows = slice(kind.first(block), kind.first(block) + BLOCKS[block])
        np.testing.assert_allclose(np.sqrt(np.diag(p)[rows]), sigma)
    assert np.count_nonzero(p) == kind.size
    imu = replace(IMU, gyro_misalignment=3e-4, accel_misalignment=5e-4)
    kind = kind.with_axes
    sigma = np.sqrt(np.diag(initial_covariance(kind, START, replace(SETTINGS, imu=imu))))
    axes = sigma[kind.first(GYRO_AXES) : kind.first(GNSS_POSITION)]
    np.testing.assert_allclose(axes, [3e-4] * 6 + [5e-4] * 6)
    kind = FILTERS["network-29a"]
    known = replace(START, gyro_bias_sigma=1e-6, accel_bias_sigma=1e-5)
    p = initial_covariance(kind, known, SETTINGS)
    sigma = np.sqrt(np.diag(p)[kind.first(GYRO_BIAS)])
    assert sigma == pytest.approx(np.hypot(1e-6, IMU.gyro_instability))


def test_noise_drives_a_bias_to_its_instability_and_back():
    """What wanders by the instability within the bias time: a variance of 2 t / T of it."""
    kind = FILTERS["network-29a"]
    q = noise_densities(kind, START, SETTINGS)
    walk = {
        VELOCITY: 9e-4**2, ATTITUDE: 7e-6**2, GYRO_BIAS: 2.0 * 1e-5**2 / 700.0,
        ACCEL_BIAS: 2.0 * 5e-4**2 / 700.0, POSITION: 0.0,
        # as the accelerometers' biases, of which a quarter wanders
        ACCEL_SCALE: 2.0 * (0.25 * 6e-4) ** 2 / 700.0,
        GYRO_SCALE: 2.0 * (0.25 * 4e-4) ** 2 / 700.0,
    }  # fmt: skip
    for block, density in walk.items():
        rows = slice(kind.first(block), kind.first(block) + BLOCKS[block])
        np.testing.assert_allclose(q[rows], density)


@pytest.mark.parametrize("name", FILTERS)
def test_measurements_have_the_variances_of_their_noise(name):
    kind, settings = FILTERS[name], replace(SETTINGS, filter=name)
    fields = loop_parameters(kind, settings)
    white = np.square([1.0, 2.0, 3.0, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(fields["gnss_white"], white)
    np.testing.assert_allclose(fields["gnss_all"] - white, np.square([4, 5, 6, 0.4, 0.5, 0.6]))
    assert fields["baro_white"] == pytest.approx(0.49)
    assert fields["correction_variance"] == pytest.approx(0.0009)
    assert fields["k4"] == (SETTINGS.network.k4 if kind.network else 0.0)
    # one in a thousand right fixes, or as many as are asked for, is beyond a gate: by tables
    gated = replace(settings, control=replace(settings.control, gate_probability=0.999))
    np.testing.assert_allclose(
        loop_parameters(kind, gated)["gates"],
        [np.inf, 10.828, 13.816, 16.266, 18.467, 20.515, 22.458], atol=1e-3,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("name", "misalignment", "walk", "has"),
    [
        ("network-29a", 2e-4, 1e-6, True),
        # 0.2 deg in a right angle, and in a minute 0.4 deg of noise
        ("network-29a", 2e-3, 9e-4, False),
        ("network-29a", 0.0, 0.0, False),
        ("plain-15", 2e-4, 1e-6, False),
        ("network-26", 2e-4, 1e-6, False),
    ],
)
def test_axes_have_states_where_turns_show_them_through_the_noise(name, misalignment, walk, has):
    imu = replace(IMU, gyro_misalignment=misalignment, angle_random_walk=walk)
    settings = replace(SETTINGS, filter=name, network=None, imu=imu)
    for kind in (settings.kind, settings.kind.without_baro, settings.kind.on_wheels):
        assert (kind.first(GYRO_AXES) > 0) == (kind.first(ACCEL_AXES) > 0) == has
        # Else a turn makes attitude uncertain
        across = loop_parameters(kind, settings)["across_variance"]
        assert (across > 0.0) == (misalignment > 0.0 and not has)
