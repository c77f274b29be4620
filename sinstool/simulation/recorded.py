"""Columns of sensors as topics of a log."""

from __future__ import annotations

import numpy as np

from sinstool.core.streams import Baro, GnssEpochs, Imu
from sinstool.io.readers.frames import enu_to_ned
from sinstool.simulation.log import (
    BARO_TOPIC,
    FIX_TOPIC,
    IMU_TOPIC,
    VELOCITY_TOPIC,
    Axes,
    Columns,
    SimulatedTopic,
    diagonal,
    fix_columns,
    raw_imu_columns,
)

_EAST_NORTH_UP = [1, 0, 2]


def recorded_topics(
    imu: Imu, gnss: GnssEpochs | None = None, barometer: Baro | None = None
) -> list[SimulatedTopic]:
    """Topics in the axes and units of ROS, for :func:`~sinstool.simulation.log.write_simulated`.

    Parameters
    ----------
    imu : Imu
        In FRD.
    gnss : GnssEpochs, optional
        Epochs with a position become NavSatFix, those with a velocity TwistWithCovarianceStamped.
    """
    axes = Axes("flu")

    def imu_columns(rows: slice) -> Columns:
        return raw_imu_columns(axes.turn(imu.gyro[rows]), axes.turn(imu.accel[rows]))

    frame = {"header.frame_id": axes.body}
    kind = "sensor_msgs/msg/Imu"
    topics = [SimulatedTopic(IMU_TOPIC, kind, imu.time_ns, imu_columns, frame)]
    if gnss is not None:
        topics += _gnss_topics(gnss)
    if barometer is not None:
        pressure, variance = barometer.pressure, barometer.variance
        topics.append(
            SimulatedTopic(
                BARO_TOPIC,
                "sensor_msgs/msg/FluidPressure",
                barometer.time_ns,
                lambda rows: {"fluid_pressure": pressure[rows], "variance": variance[rows]},
                {"header.frame_id": "baro"},
            )
        )
    return topics


def _gnss_topics(gnss: GnssEpochs) -> list[SimulatedTopic]:
    fixes, moving = gnss.rows(gnss.has_position), gnss.rows(gnss.has_velocity)

    def fix(rows: slice) -> Columns:
        variance, measured = _variance(fixes.sigma_position_n[rows])
        return {
            **fix_columns(fixes.latitude[rows], fixes.longitude[rows], fixes.height[rows]),
            "position_covariance": diagonal(variance, 3),
            "position_covariance_type": np.where(measured, 2, 0),
        }

    def twist(rows: slice) -> Columns:
        variance, _ = _variance(moving.sigma_velocity_n[rows])
        return {
            "twist.twist.linear.x": enu_to_ned(moving.velocity_n[rows]),
            "twist.covariance": diagonal(variance, 6),
        }

    frame = {"header.frame_id": "gnss"}
    topics = []
    if len(fixes):
        kind = "sensor_msgs/msg/NavSatFix"
        topics.append(SimulatedTopic(FIX_TOPIC, kind, fixes.time_ns, fix, frame))
    if len(moving):
        kind = "geometry_msgs/msg/TwistWithCovarianceStamped"
        topics.append(SimulatedTopic(VELOCITY_TOPIC, kind, moving.time_ns, twist, frame))
    return topics


def _variance(sigma_n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Variances along east, north, up, zeros where unknown; and which rows have any."""
    sigma = np.nan_to_num(sigma_n[:, _EAST_NORTH_UP], nan=0.0)
    return sigma**2, (sigma > 0.0).any(axis=1)
