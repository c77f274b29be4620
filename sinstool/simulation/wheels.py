"""Wheel speeds of a simulated car: scale, latency, slip, and their topics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.simulation.car import Car, axle_motion
from sinstool.simulation.log import Columns, SimulatedTopic
from sinstool.simulation.truth import Trajectory

WHEEL_TOPIC = "/wheels"
JOINTS = ("rear_left_wheel_joint", "rear_right_wheel_joint")
_HALF_TRACK = 0.76  # m
_STANDING = 1e-6  # m/s; slower is a rest with the error of interpolation
_GRIP = 1.2  # m/s^2, beyond which wheels slip


@dataclass(frozen=True)
class WheelSensor:
    """Errors of the wheels' speeds.

    Attributes
    ----------
    rate_hz : float
        Readings per second.
    scale : float
        Relative error: readings are ``1 + scale`` times the speed.
    latency_s : float
        From the time at which a reading is valid to its stamp.
    slip : float
        Slip as a fraction of the speed for each m/s^2 of acceleration or braking beyond 1.2 m/s^2.
    slipping : {'both', 'left'}
        Which wheels slip.
    noise : float
        White noise of a turning wheel, m/s.
    """

    rate_hz: float = 20.0
    scale: float = 0.0
    latency_s: float = 0.0
    slip: float = 0.0
    slipping: Literal["both", "left"] = "both"
    noise: float = 0.0


@dataclass(frozen=True)
class WheelReadings:
    """Readings, and the truth they were made from.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (n,)
        Stamps.
    speed : ndarray, shape (n, 2)
        Circumferential speeds of the left and the right rear wheel, m/s.
    truth : ndarray, shape (n,)
        Forward speed of the axle when the readings are valid, m/s.
    """

    time_ns: IntArray
    speed: FloatArray
    truth: FloatArray


def wheel_readings(
    trajectory: Trajectory, car: Car, sensor: WheelSensor, seed: int
) -> WheelReadings:
    """Speeds of the rear wheels of a car along a trajectory.

    Parameters
    ----------
    seed : int
        Of the noise.

    Raises
    ------
    ValueError
        If the rate is not positive or the trajectory too short.
    """
    first, last = int(trajectory.time_ns[0]), int(trajectory.time_ns[-1])
    count = int((last - first) * 1e-9 * sensor.rate_hz + 1e-6) + 1
    if count < 2:
        raise ValueError("Expected two readings of the wheels within the drive.")
    valid = first + np.round(np.arange(count) * 1e9 / sensor.rate_hz).astype(np.int64)
    axle = axle_motion(trajectory, car, np.minimum(valid, last))
    seconds = (valid - first) * 1e-9
    forward, yaw_rate = axle.velocity_v[:, 0], axle.rate_v[:, 2]
    turning = np.abs(forward) > _STANDING
    if car.ferry is not None:  # on a ship wheels do not turn
        turning &= (seconds < car.ferry[0]) | (seconds > sum(car.ferry))
    forward, yaw_rate = turning * forward, turning * yaw_rate
    gain = np.gradient(forward, seconds)
    slip = sensor.slip * np.sign(gain) * np.maximum(np.abs(gain) - _GRIP, 0.0)
    slips = np.outer(slip, [1.0, float(sensor.slipping == "both")])
    speed = forward[:, None] + np.outer(yaw_rate, [_HALF_TRACK, -_HALF_TRACK])
    speed *= (1.0 + sensor.scale) * (1.0 + slips)
    noise = np.random.default_rng(seed).standard_normal(speed.shape)
    speed += sensor.noise * noise * turning[:, None]
    return WheelReadings(valid + round(sensor.latency_s * 1e9), speed, forward)


def wheel_topic(
    readings: WheelReadings, kind: Literal["odometry", "twist", "joint"], radius: float
) -> SimulatedTopic:
    """Readings as nav_msgs/Odometry, geometry_msgs/TwistStamped or sensor_msgs/JointState.

    Parameters
    ----------
    radius : float
        Of the wheels of a JointState, m.
    """
    if kind == "joint":
        return SimulatedTopic(
            WHEEL_TOPIC,
            "sensor_msgs/msg/JointState",
            readings.time_ns,
            lambda rows: {"velocity": readings.speed[rows] / radius},
            {"name[0]": JOINTS[0], "name[1]": JOINTS[1]},
            {"name": 2, "velocity": 2},
        )
    forward = readings.speed.mean(axis=1)
    # FLU: a turn to the left is positive, and the right wheel is then the faster one
    turn = (readings.speed[:, 1] - readings.speed[:, 0]) / (2.0 * _HALF_TRACK)
    path = "twist.twist" if kind == "odometry" else "twist"

    def columns(rows: slice) -> Columns:
        return {f"{path}.linear.x": forward[rows], f"{path}.angular.z": turn[rows]}

    if kind == "twist":
        frames = {"header.frame_id": "base_link"}
        return SimulatedTopic(
            WHEEL_TOPIC, "geometry_msgs/msg/TwistStamped", readings.time_ns, columns, frames
        )
    seconds = (readings.time_ns - readings.time_ns[0]) * 1e-9
    step = np.diff(seconds, prepend=0.0)
    heading = np.cumsum(turn * step)
    place = np.cumsum(
        np.stack([np.cos(heading), np.sin(heading)], axis=1) * (forward * step)[:, None], axis=0
    )

    def odometry(rows: slice) -> Columns:
        return {
            "pose.pose.position.x": place[rows],
            "pose.pose.orientation.z": np.sin(0.5 * heading[rows]),
            "pose.pose.orientation.w": np.cos(0.5 * heading[rows]),
            **columns(rows),
        }

    return SimulatedTopic(
        WHEEL_TOPIC,
        "nav_msgs/msg/Odometry",
        readings.time_ns,
        odometry,
        {"header.frame_id": "odom", "child_frame_id": "base_link"},
    )
