"""Simulated motions as logs: the sensor's topics, and the truth beside them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import sinstool
from sinstool.messages.definitions import schema_text, type_hash
from sinstool.messages.encode import Encoder
from sinstool.readers.frames import q_for_log, turn_body
from sinstool.simulation.truth import ImuTruth
from sinstool.writers.chunks import Messages
from sinstool.writers.mcap import McapWriter
from sinstool.writers.solution import QOS
from sinstool.writers.whole import WholeFile

IMU_TOPIC = "/imu/data_raw"
FIX_TOPIC = "/gnss/fix"
FIX_RATE_HZ = 1.0
BATCH = 16384
_DEGREE = np.pi / 180.0


@dataclass(frozen=True)
class SimulatedLog:
    """What goes into the log.

    Attributes
    ----------
    sensor, truth : ImuTruth
        With and without sensor errors.
    gyro_kind : {'rate', 'mean-rate', 'increment'}
        Which of the sensor's samples the Imu topic carries.
    body_axes : {'flu', 'frd'}
    position : tuple of float or None
        Latitude, longitude (rad) and height (m) of a body that stays there: written as fixes.
    """

    sensor: ImuTruth
    truth: ImuTruth
    gyro_kind: str
    body_axes: str
    position: tuple[float, float, float] | None = None


def write_simulated(path: Path, log: SimulatedLog, settings: dict[str, str]) -> dict[str, int]:
    """Write a simulated motion as an MCAP log.

    Parameters
    ----------
    path : Path
    log : SimulatedLog
    settings : dict
        How it was made; kept in a Metadata record ``sinstool``.

    Returns
    -------
    dict
        Messages by topic.
    """
    with WholeFile(path) as whole:
        writer = McapWriter(whole.stream, "ros2", f"sinstool/{sinstool.__version__}")
        try:
            counts = _Topics(writer, log).write()
            writer.add_metadata("sinstool", {"version": sinstool.__version__, **settings})
            writer.finish()
        finally:
            writer.abort()
    return counts


class _Topics:
    """The topics of one log and how each is filled."""

    def __init__(self, writer: McapWriter, log: SimulatedLog) -> None:
        self.writer = writer
        self.log = log
        self.world = "enu" if log.body_axes == "flu" else "ned"
        self.reference = "map" if self.world == "enu" else "map_ned"
        self.body = "imu_link" if log.body_axes == "flu" else "imu_link_ned"

    def write(self) -> dict[str, int]:
        log = self.log
        header = {"header.frame_id": self.body}
        odometry = {"header.frame_id": self.reference, "child_frame_id": self.body}
        imu = self._topic(IMU_TOPIC, "sensor_msgs/msg/Imu", header)
        truth = self._topic("/truth/imu", "sensor_msgs/msg/Imu", header)
        pose = self._topic("/truth/odometry", "nav_msgs/msg/Odometry", odometry)
        counts = {IMU_TOPIC: 0, "/truth/imu": 0, "/truth/odometry": 0}
        fix = None
        if log.position is not None:
            fix = self._topic(FIX_TOPIC, "sensor_msgs/msg/NavSatFix", {"header.frame_id": "gnss"})
            counts[FIX_TOPIC] = 0
        n = len(log.truth.time_ns)
        next_fix = int(log.truth.time_ns[0])
        for begin in range(0, n, BATCH):
            rows = slice(begin, min(begin + BATCH, n))
            times = log.truth.time_ns[rows]
            parts = [
                self._messages(imu, self._sensor(rows), times, begin),
                self._messages(truth, self._truth(rows), times, begin),
                self._messages(pose, self._pose(rows), times, begin),
            ]
            for name in (IMU_TOPIC, "/truth/imu", "/truth/odometry"):
                counts[name] += len(times)
            if fix is not None:
                step = round(1e9 / FIX_RATE_HZ)
                at = np.arange(next_fix, int(times[-1]) + 1, step, dtype=np.int64)
                if len(at):
                    parts.append(self._messages(fix, self._fix(), at, counts[FIX_TOPIC]))
                    next_fix = int(at[-1]) + step
                    counts[FIX_TOPIC] += len(at)
            self.writer.write(parts)
        return counts

    def _topic(self, topic: str, type_name: str, strings: dict[str, str]) -> tuple[int, Encoder]:
        text = schema_text(type_name, "cdr").encode()
        schema = self.writer.add_schema(type_name, "ros2msg", text)
        metadata = {"offered_qos_profiles": QOS, "topic_type_hash": type_hash(type_name)}
        number = self.writer.add_channel(topic, "cdr", schema, metadata)
        return number, Encoder(type_name, "cdr", strings)

    @staticmethod
    def _messages(
        topic: tuple[int, Encoder], columns: dict[str, np.ndarray], times: np.ndarray, first: int
    ) -> Messages:
        number, encoder = topic
        stamp = {
            "header.stamp.sec": times // 1_000_000_000,
            "header.stamp.nanosec": times % 1_000_000_000,
        }
        payload = encoder.encode({**stamp, **columns}, len(times))
        sequence = np.arange(first, first + len(times), dtype=np.int64)
        return Messages.from_rows(number, payload, times, sequence)

    def _sensor(self, rows: slice) -> dict[str, np.ndarray]:
        sensor, axes = self.log.sensor, self.log.body_axes
        gyro, accel = {
            "rate": (sensor.gyro_rate, sensor.specific_force),
            "mean-rate": (sensor.gyro_mean_rate, sensor.mean_specific_force),
            "increment": (
                sensor.gyro_increment,
                sensor.mean_specific_force * sensor.interval[:, None],
            ),
        }[self.log.gyro_kind]
        return {
            "orientation.w": np.array(1.0),
            # REP-145: the sensor gives no orientation
            "orientation_covariance": _first(-1.0),
            "angular_velocity.x": turn_body(gyro[rows], axes),
            "linear_acceleration.x": turn_body(accel[rows], axes),
        }

    def _truth(self, rows: slice) -> dict[str, np.ndarray]:
        truth, axes = self.log.truth, self.log.body_axes
        return {
            "orientation.x": self._xyzw(rows),
            "angular_velocity.x": turn_body(truth.gyro_rate[rows], axes),
            "linear_acceleration.x": turn_body(truth.specific_force[rows], axes),
        }

    def _pose(self, rows: slice) -> dict[str, np.ndarray]:
        truth, axes = self.log.truth, self.log.body_axes
        return {
            "pose.pose.orientation.x": self._xyzw(rows),
            "twist.twist.angular.x": turn_body(truth.gyro_rate[rows], axes),
        }

    def _xyzw(self, rows: slice) -> np.ndarray:
        q = q_for_log(self.log.truth.q_nb[rows], self.log.body_axes, self.world)
        return q[:, [1, 2, 3, 0]]

    def _fix(self) -> dict[str, np.ndarray]:
        assert self.log.position is not None
        latitude, longitude, height = self.log.position
        return {
            "latitude": np.array(latitude / _DEGREE),
            "longitude": np.array(longitude / _DEGREE),
            "altitude": np.array(height),
        }


def _first(value: float) -> np.ndarray:
    """A 3x3 covariance whose first element says something and the rest nothing."""
    covariance = np.zeros((1, 9))
    covariance[0, 0] = value
    return covariance
