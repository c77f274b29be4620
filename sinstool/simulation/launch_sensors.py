"""Inertial sensors of the launched vehicle: their grades, ranges and mounting."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from sinstool.core import rotation
from sinstool.core.units import DEGREE, STANDARD_GRAVITY
from sinstool.methods.sensor_errors import SensorGrade
from sinstool.simulation.truth import ImuTruth

# Gyro bias deg/h, accelerometer bias in the unit that is in doubt, scale, deg/sqrt(h), ug/sqrt(Hz)
_GRADES = {
    "0.01": (0.01, 1e-5, 1e-5, 0.002, 5.0),
    "1": (1.0, 1e-3, 1e-4, 0.05, 50.0),
    "10": (10.0, 5e-3, 3e-4, 0.3, 150.0),
}


def launch_grade(gyro_bias_deg_h: str, accelerometer_unit: Literal["m/s^2", "g"]) -> SensorGrade:
    """One of the three grades of Qu, Li, Zhu and Wang's Monte Carlo runs.

    They print the accelerometer biases 0.00001, 0.001 and 0.005 with the unit m/s^2, and draw
    conclusions for 0.01 and 0.05 m/s^2; their flight unit has 0.001 g. So g may be meant.

    Parameters
    ----------
    gyro_bias_deg_h : {'0.01', '1', '10'}
    accelerometer_unit : {'m/s^2', 'g'}
        How to read the printed accelerometer biases.

    Returns
    -------
    SensorGrade
        Repeatability and in-run stability both have the printed size, the latter with a
        correlation time of 100 s; misalignment is half the scale error. Noise is not printed: it
        is what such sensors have.

    Raises
    ------
    ValueError
        If there is no such grade or unit.
    """
    if gyro_bias_deg_h not in _GRADES or accelerometer_unit not in ("m/s^2", "g"):
        raise ValueError(f"Found no grade {gyro_bias_deg_h!r} in {accelerometer_unit!r}.")
    gyro, accel, scale, walk, noise = _GRADES[gyro_bias_deg_h]
    gyro *= DEGREE / 3600.0
    accel *= STANDARD_GRAVITY if accelerometer_unit == "g" else 1.0
    return SensorGrade(
        angle_random_walk=walk * DEGREE / 60.0,
        gyro_bias=gyro,
        velocity_random_walk=noise * 1e-6 * STANDARD_GRAVITY,
        accel_bias=accel,
        gyro_instability=gyro,
        accel_instability=accel,
        bias_time_s=100.0,
        gyro_scale=scale,
        accel_scale=scale,
        gyro_misalignment=0.5 * scale,
        accel_misalignment=0.5 * scale,
    )


def saturated(samples: ImuTruth, gyro_range: float, accel_range: float) -> ImuTruth:
    """Samples of sensors that clip.

    Parameters
    ----------
    samples : ImuTruth
        As the sensors would give them without a limit.
    gyro_range, accel_range : float
        Largest reading of each axis, rad/s and m/s^2.

    Returns
    -------
    ImuTruth
        Each mean and each value at an instant is limited, increments accordingly.

    Raises
    ------
    ValueError
        If a range is not positive.
    """
    if not (gyro_range > 0.0 and accel_range > 0.0):
        raise ValueError("Expected positive ranges.")
    mean_rate = np.clip(samples.gyro_mean_rate, -gyro_range, gyro_range)
    return replace(
        samples,
        gyro_rate=np.clip(samples.gyro_rate, -gyro_range, gyro_range),
        gyro_mean_rate=mean_rate,
        gyro_increment=mean_rate * samples.interval[:, None],
        specific_force=np.clip(samples.specific_force, -accel_range, accel_range),
        mean_specific_force=np.clip(samples.mean_specific_force, -accel_range, accel_range),
    )


def mounted(samples: ImuTruth, q_bs: ArrayLike) -> ImuTruth:
    """Samples in the axes of an Imu that is mounted some way round.

    Parameters
    ----------
    samples : ImuTruth
        In the axes of the vehicle.
    q_bs : array_like, shape (4,)
        Attitude of the Imu's axes in the vehicle's.

    Returns
    -------
    ImuTruth
        In the Imu's axes; the attitude is that of the Imu.

    Raises
    ------
    ValueError
        If the shape is wrong or the quaternion zero.
    """
    turn = rotation.normalise(q_bs)
    if turn.shape != (4,):
        raise ValueError(f"Expected `q_bs` to have shape (4,), got {turn.shape}.")
    back = rotation.conjugate(turn)
    return replace(
        samples,
        gyro_rate=rotation.rotate(back, samples.gyro_rate),
        gyro_mean_rate=rotation.rotate(back, samples.gyro_mean_rate),
        gyro_increment=rotation.rotate(back, samples.gyro_increment),
        specific_force=rotation.rotate(back, samples.specific_force),
        mean_specific_force=rotation.rotate(back, samples.mean_specific_force),
        q_nb=rotation.multiply(samples.q_nb, turn),
    )
