"""Logs of an IMU that lies still, with noise that is known."""

import numpy as np
from scipy.spatial.transform import Rotation

from sinstool.core.streams import Imu
from sinstool.simulation.log import write_simulated
from sinstool.simulation.recorded import recorded_topics
from tests.helpers.allan import simulate_terms

T0 = 1_700_000_000_000_000_000
RATE = 100.0
# Quantisation, white, flicker, random walk and ramp of a sample, in rad/s and m/s^2
GYRO = (0.0, 2e-3, 0.0, 0.0, 0.0)
ACCEL = (0.0, 2e-2, 0.0, 0.0, 0.0)


def noise(count, seed=1, gyro=GYRO, accel=ACCEL):
    """Samples of six axes at rest, gyro and accelerometer."""
    rng = np.random.default_rng(seed)
    columns = [simulate_terms(count, *terms, rng) for terms in (gyro,) * 3 + (accel,) * 3]
    rates, forces = np.column_stack(columns[:3]), np.column_stack(columns[3:])
    rates += np.array([1e-3, -2e-3, 5e-4])
    forces += np.array([0.1, -0.2, -9.8])
    return rates, forces


def moved(rates, forces, begin, end):
    """The same, turned and pushed between two samples; gravity turns as the rates say."""
    phase = np.linspace(0.0, 20.0 * np.pi, end - begin)[:, None]
    turning = 0.5 * np.sin(phase * np.array([1.0, 1.3, 0.7]))
    turned = Rotation.identity()
    for k, step in enumerate(Rotation.from_rotvec(turning / RATE), begin):
        turned = turned * step
        forces[k] = turned.inv().apply(forces[k])
    rates[begin:end] += turning
    forces[begin:end] += 2.0 * np.sin(phase * np.array([0.9, 1.1, 1.7]))
    return rates, forces


def write(path, rates, forces, time_ns=None):
    """A log of them."""
    if time_ns is None:
        time_ns = T0 + np.round(np.arange(len(rates)) * 1e9 / RATE).astype(np.int64)
    imu = Imu(time_ns, time_ns, rates, forces)
    write_simulated(path, recorded_topics(imu, None, None), {"scenario": "rest"})
    return path
