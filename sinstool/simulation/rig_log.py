"""The log of a turntable with a rate-biased system, from its scenario."""

from __future__ import annotations

from typing import Any

import numpy as np

from sinstool.core.units import ARCSEC, DEGREE, DEGREE_PER_HOUR, MICRO_G
from sinstool.simulation.hse_rig import HseRigErrors, HseRigLog, HseRigSetup, hse_rig
from sinstool.simulation.log import (
    IMU_TOPIC,
    Axes,
    Columns,
    SimulatedTopic,
    joint_topic,
    raw_imu_columns,
)
from sinstool.simulation.scenarios import HseRig

JOINT = "table"


def rig_log(s: HseRig) -> HseRigLog:
    """Simulate a turntable.

    Raises
    ------
    ValueError
        No such log can be made.
    """
    rates = [rate * DEGREE for rate in s.rates]
    random = np.random.default_rng([s.seed, 1])
    heading = s.heading * DEGREE
    theta, gamma = lean(heading, s.tilt_north, s.tilt_east)
    setup = HseRigSetup(
        latitude=s.latitude * DEGREE,
        heading=heading,
        theta=theta,
        gamma=gamma,
        epsilon=tuple(v * ARCSEC for v in s.epsilon),
        kappa=tuple(v * 1e-6 for v in s.kappa),
        xi=tuple(v * ARCSEC for v in s.xi),
        imu_rate=s.rate,
        encoder_rate=s.encoder_rate,
    )
    ramps = float(np.abs(np.diff(rates)).sum()) / (5.0 * DEGREE)
    length = s.plateau * len(rates) + ramps
    errors = HseRigErrors(
        angle_random_walk=s.arw * DEGREE / 60.0,
        gyro_bias=tuple(s.gyro_bias * DEGREE_PER_HOUR * random.standard_normal(3)),
        gyro_drift=s.gyro_drift * DEGREE_PER_HOUR,
        gyro_quantum=s.gyro_quantum * ARCSEC,
        velocity_random_walk=s.vrw * MICRO_G,
        accel_bias=tuple(s.accel_bias * MICRO_G * random.standard_normal(3)),
        encoder_lsb=s.encoder_lsb * ARCSEC,
        encoder_delay=s.encoder_delay * 1e-6,
        encoder_sign=int(s.encoder_sign),
        ripple=s.ripple,
        base_drift_n=tuple(v * ARCSEC / length for v in s.base_drift),
    )
    return hse_rig([(rate, s.plateau) for rate in rates], setup, errors, seed=s.seed)


def lambda2_arcsec(log: HseRigLog) -> float:
    """The true lambda2 that a calibration should find, arcsec."""
    return log.truth.lambda2 / ARCSEC


def lean(heading: float, north: float, east: float) -> tuple[float, float]:
    """Pitch and roll of the base whose (down) axis leans by these components.

    The third column of C_b0^n is (C13, C23, C33) = (north, east, ...): rotate it by minus the
    heading, and read sin(theta) cos(gamma) and -sin(gamma) from it.

    Parameters
    ----------
    heading : float
        rad.
    north, east : float
        Components of the axis.

    Returns
    -------
    theta, gamma : float
        rad.
    """
    along = north * np.cos(heading) + east * np.sin(heading)
    across = -north * np.sin(heading) + east * np.cos(heading)
    gamma = -np.arcsin(across)
    return float(np.arcsin(along / np.cos(gamma))), float(gamma)


def rig_topics(log: HseRigLog, truth: bool) -> list[SimulatedTopic]:
    """Raw triad and encoder, and optionally the true attitude of the body."""
    axes = Axes("frd")

    def imu(rows: slice) -> Columns:
        return raw_imu_columns(log.gyro[rows], log.accel[rows])

    def attitude(rows: slice) -> Columns:
        return {"orientation.x": axes.xyzw(log.truth.q_nb[rows])}

    name = "sensor_msgs/msg/Imu"
    topics = [
        SimulatedTopic(IMU_TOPIC, name, log.time_ns, imu, {"header.frame_id": "gyro_triad"}),
        joint_topic(log.encoder_time_ns, log.encoder_position, JOINT),
    ]
    if truth:
        frame = {"header.frame_id": axes.body}
        topics.append(SimulatedTopic("/truth/imu", name, log.time_ns, attitude, frame))
    return topics


def rig_table(log: HseRigLog, scenario: HseRig) -> dict[str, Any]:
    """The rig as its user believes it to be: the table ``[rig]`` of a configuration file."""
    return {
        "K_g": log.believed_K_g.tolist(),
        "C_s_to_b": log.believed_C_s_to_b.tolist(),
        "gyro_frame": "g",
        "accel_frame": "s",
        "latitude_deg": scenario.latitude,
        "imu_stamp": "end",
        "encoder": {"joint": JOINT, "sign": int(scenario.encoder_sign)},
    }
