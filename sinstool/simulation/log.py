"""Simulated motions as logs: the sensors' topics and the truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sinstool.core import earth, version
from sinstool.core.choices import log_choice
from sinstool.core.rotation import conjugate, rotate
from sinstool.core.whole_file import WholeFile
from sinstool.io.messages.definitions import schema_text, type_hash
from sinstool.io.messages.encode import Encoder
from sinstool.io.readers.batch import RawBatch
from sinstool.io.readers.frames import enu_to_ned, q_for_log, turn_body
from sinstool.io.writers.mcap import McapWriter
from sinstool.io.writers.solution import QOS
from sinstool.simulation.car import AxleMotion
from sinstool.simulation.gnss import GnssSamples
from sinstool.simulation.sensors import ImuErrors
from sinstool.simulation.truth import ImuTruth, Trajectory

IMU_TOPIC = "/imu/data_raw"
FIX_TOPIC = "/gnss/fix"
VELOCITY_TOPIC = "/gnss/velocity"
BARO_TOPIC = "/baro"
JOINT_TOPIC = "/joint_states"
REST_FIX_HZ = 1.0
BATCH = 16384

Columns = dict[str, np.ndarray]


@dataclass(frozen=True)
class SimulatedTopic:
    """One topic of a simulated log.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (n,)
        Stamps and log times.
    columns : callable
        Fields of a slice of rows, without the stamp.
    strings : dict
        Texts of string fields.
    lengths : dict
        Lengths of sequences.
    """

    topic: str
    type_name: str
    time_ns: np.ndarray
    columns: Callable[[slice], Columns]
    strings: dict[str, str] = field(default_factory=dict)
    lengths: dict[str, int] = field(default_factory=dict)


def write_simulated(
    path: Path, topics: Sequence[SimulatedTopic], settings: dict[str, str]
) -> dict[str, int]:
    """Write topics as an MCAP log, in the order of time.

    Parameters
    ----------
    settings : dict
        How the log was made; kept in a Metadata record ``sinstool``.

    Returns
    -------
    dict
        Messages by topic.
    """
    options = dict(settings)
    name = options.pop("scenario", "a log")
    log_choice("scenario", ", ".join([name, *(f"{k} {v}" for k, v in options.items())]))
    with WholeFile(path) as whole:
        writer = McapWriter(whole.stream, "ros2", f"sinstool/{version.VERSION}")
        try:
            open_topics = [_Open(writer, topic) for topic in topics]
            longest = max(topics, key=lambda t: len(t.time_ns))
            ends = [*longest.time_ns[BATCH - 1 :: BATCH].tolist(), None]
            for end in ends:
                parts = [part for topic in open_topics if (part := topic.until(end)) is not None]
                if parts:
                    writer.write(parts)
            writer.add_metadata("sinstool", {"version": version.VERSION, **settings})
            writer.finish()
        finally:
            writer.abort()
    return {topic.topic: len(topic.time_ns) for topic in topics}


class _Open:
    """A topic that is being written."""

    def __init__(self, writer: McapWriter, topic: SimulatedTopic) -> None:
        name = topic.type_name
        schema = writer.add_schema(name, "ros2msg", schema_text(name, "cdr").encode())
        metadata = {"offered_qos_profiles": QOS, "topic_type_hash": type_hash(name)}
        self.number = writer.add_channel(topic.topic, "cdr", schema, metadata)
        self.encoder = Encoder(name, "cdr", topic.strings, topic.lengths)
        self.topic = topic
        self.done = 0

    def until(self, end_ns: int | None) -> RawBatch | None:
        """Further messages up to a time; all that remain for None."""
        times = self.topic.time_ns
        stop = len(times) if end_ns is None else int(np.searchsorted(times, end_ns, "right"))
        if stop <= self.done:
            return None
        rows = slice(self.done, stop)
        self.done = stop
        at = times[rows]
        stamp = {
            "header.stamp.sec": at // 1_000_000_000,
            "header.stamp.nanosec": at % 1_000_000_000,
        }
        payload = self.encoder.encode({**stamp, **self.topic.columns(rows)}, len(at))
        sequence = np.arange(rows.start, rows.stop, dtype=np.int64)
        return RawBatch.from_rows(self.number, payload, at, sequence)


@dataclass(frozen=True)
class Axes:
    """Axes of a simulated log: FLU in ENU, or FRD in NED.

    Attributes
    ----------
    body_axes : {'flu', 'frd'}
    """

    body_axes: str

    @property
    def world(self) -> str:
        """``enu`` or ``ned``."""
        return "enu" if self.body_axes == "flu" else "ned"

    @property
    def reference(self) -> str:
        """Frame id of the world."""
        return "map" if self.world == "enu" else "map_ned"

    @property
    def body(self) -> str:
        """Frame id of the sensor."""
        return "imu_link" if self.body_axes == "flu" else "imu_link_ned"

    def turn(self, vectors: np.ndarray) -> np.ndarray:
        """FRD vectors in the log's body axes."""
        return turn_body(vectors, self.body_axes)

    def turn_world(self, vectors_n: np.ndarray) -> np.ndarray:
        """NED vectors in the log's world axes."""
        return enu_to_ned(vectors_n) if self.world == "enu" else vectors_n

    def xyzw(self, q_nb: np.ndarray) -> np.ndarray:
        """Orientation, scalar last."""
        return q_for_log(q_nb, self.body_axes, self.world)[:, [1, 2, 3, 0]]


def imu_topic(sensor: ImuTruth, gyro_kind: str, axes: Axes) -> SimulatedTopic:
    """The sensor's Imu messages.

    Parameters
    ----------
    sensor : ImuTruth
        Measured samples.
    gyro_kind : {'rate', 'mean-rate', 'increment'}
    """
    gyro, accel = {
        "rate": (sensor.gyro_rate, sensor.specific_force),
        "mean-rate": (sensor.gyro_mean_rate, sensor.mean_specific_force),
        "increment": (sensor.gyro_increment, sensor.mean_specific_force * sensor.interval[:, None]),
    }[gyro_kind]

    def columns(rows: slice) -> Columns:
        return raw_imu_columns(axes.turn(gyro[rows]), axes.turn(accel[rows]))

    return SimulatedTopic(
        IMU_TOPIC, "sensor_msgs/msg/Imu", sensor.time_ns, columns, {"header.frame_id": axes.body}
    )


def raw_imu_columns(gyro: np.ndarray, accel: np.ndarray) -> Columns:
    """Fields of Imu messages of a sensor that gives no orientation (REP-145)."""
    unknown = np.zeros((1, 9))
    unknown[0, 0] = -1.0
    return {
        "orientation.w": np.array(1.0),
        "orientation_covariance": unknown,
        "angular_velocity.x": gyro,
        "linear_acceleration.x": accel,
    }


def truth_topics(
    truth: ImuTruth, axes: Axes, trajectory: Trajectory | None = None
) -> list[SimulatedTopic]:
    """``/truth/imu`` and ``/truth/odometry``.

    Parameters
    ----------
    trajectory : Trajectory, optional
        Motion of the vehicle; by default it stays at the origin. Positions are in the tangent plane
        at the first one.
    """

    def imu(rows: slice) -> Columns:
        return {
            "orientation.x": axes.xyzw(truth.q_nb[rows]),
            "angular_velocity.x": axes.turn(truth.gyro_rate[rows]),
            "linear_acceleration.x": axes.turn(truth.specific_force[rows]),
        }

    def odometry(rows: slice) -> Columns:
        columns = {
            "pose.pose.orientation.x": axes.xyzw(truth.q_nb[rows]),
            "twist.twist.angular.x": axes.turn(truth.gyro_rate[rows]),
        }
        if trajectory is not None:
            position = _positions(trajectory, rows)
            origin = _positions(trajectory, slice(0, 1))[0]
            local = earth.local_position_n(origin, position)
            columns["pose.pose.position.x"] = axes.turn_world(local)
            velocity = rotate(conjugate(truth.q_nb[rows]), trajectory.velocity_n[rows])
            columns["twist.twist.linear.x"] = axes.turn(velocity)
        return columns

    frame = {"header.frame_id": axes.body}
    frames = {"header.frame_id": axes.reference, "child_frame_id": axes.body}
    topics = [
        SimulatedTopic("/truth/imu", "sensor_msgs/msg/Imu", truth.time_ns, imu, frame),
        SimulatedTopic("/truth/odometry", "nav_msgs/msg/Odometry", truth.time_ns, odometry, frames),
    ]
    if trajectory is not None:
        # Positions on the Earth, which the local positions of the odometry do not give
        topics.append(
            SimulatedTopic(
                "/truth/fix",
                "sensor_msgs/msg/NavSatFix",
                truth.time_ns,
                lambda rows: fix_columns(*_positions(trajectory, rows).T),
                {"header.frame_id": "imu_link"},
            )
        )
    return topics


def bias_topic(errors: ImuErrors, axes: Axes) -> SimulatedTopic:
    """``/truth/bias``: biases of the sensors once a second, in Imu messages."""
    step = np.searchsorted(
        errors.time_ns, np.arange(errors.time_ns[0], errors.time_ns[-1] + 1, 1_000_000_000)
    )
    gyro, accel = axes.turn(errors.gyro_bias[step]), axes.turn(errors.accel_bias[step])

    def columns(rows: slice) -> Columns:
        return raw_imu_columns(gyro[rows], accel[rows])

    frame = {"header.frame_id": axes.body}
    kind = "sensor_msgs/msg/Imu"
    return SimulatedTopic("/truth/bias", kind, errors.time_ns[step], columns, frame)


def vehicle_topic(axle: AxleMotion, axes: Axes) -> SimulatedTopic:
    """``/truth/vehicle``: attitude of a car, position and velocity of its rear axle.

    Positions are in the tangent plane at the first one.
    """

    def columns(rows: slice) -> Columns:
        position = np.stack([axle.latitude, axle.longitude, axle.height], axis=1)
        local = earth.local_position_n(position[0], position[rows])
        return {
            "pose.pose.position.x": axes.turn_world(local),
            "pose.pose.orientation.x": axes.xyzw(axle.q_nv[rows]),
            "twist.twist.linear.x": axes.turn(axle.velocity_v[rows]),
            "twist.twist.angular.x": axes.turn(axle.rate_v[rows]),
        }

    child = "base_link" if axes.body_axes == "flu" else "base_link_ned"
    frames = {"header.frame_id": axes.reference, "child_frame_id": child}
    kind = "nav_msgs/msg/Odometry"
    return SimulatedTopic("/truth/vehicle", kind, axle.time_ns, columns, frames)


def _positions(trajectory: Trajectory, rows: slice) -> np.ndarray:
    t = trajectory
    return np.stack([t.latitude[rows], t.longitude[rows], t.height[rows]], axis=1)


def fix_columns(latitude: np.ndarray, longitude: np.ndarray, height: np.ndarray) -> Columns:
    """Fields of NavSatFix messages, from rad and m."""
    degrees = {"latitude": np.degrees(latitude), "longitude": np.degrees(longitude)}
    return {**degrees, "altitude": height}


def resting_fixes(time_ns: np.ndarray, position: tuple[float, float, float]) -> SimulatedTopic:
    """Exact fixes of a body at rest.

    Parameters
    ----------
    time_ns : ndarray of int64
        Instants of the log's samples.
    position : tuple of float
        Latitude, longitude (rad) and height (m).
    """
    step = round(1e9 / REST_FIX_HZ)
    at = np.arange(int(time_ns[0]), int(time_ns[-1]) + 1, step, dtype=np.int64)
    columns = fix_columns(*(np.array(one) for one in position))
    frame = {"header.frame_id": "gnss"}
    return SimulatedTopic(FIX_TOPIC, "sensor_msgs/msg/NavSatFix", at, lambda _: columns, frame)


def gnss_topics(samples: GnssSamples, velocity: bool = True) -> list[SimulatedTopic]:
    """NavSatFix and, optionally, TwistWithCovarianceStamped of a simulated receiver."""
    swap = [1, 0, 2]  # north, east, down to east, north, up

    def fix(rows: slice) -> Columns:
        variance = samples.sigma_position[rows][:, swap] ** 2
        return {
            **fix_columns(samples.latitude[rows], samples.longitude[rows], samples.height[rows]),
            "position_covariance": diagonal(variance, 3),
            "position_covariance_type": np.array(2),
        }

    def twist(rows: slice) -> Columns:
        variance = samples.sigma_velocity[rows][:, swap] ** 2
        return {
            "twist.twist.linear.x": enu_to_ned(samples.velocity_n[rows]),
            "twist.covariance": diagonal(variance, 6),
        }

    frame = {"header.frame_id": "gnss"}
    topics = [SimulatedTopic(FIX_TOPIC, "sensor_msgs/msg/NavSatFix", samples.time_ns, fix, frame)]
    if velocity:
        kind = "geometry_msgs/msg/TwistWithCovarianceStamped"
        topics.append(SimulatedTopic(VELOCITY_TOPIC, kind, samples.time_ns, twist, frame))
    return topics


def diagonal(variance: np.ndarray, size: int) -> np.ndarray:
    """Covariances with these first elements of the diagonal, row by row."""
    matrix = np.zeros((len(variance), size, size))
    for k in range(variance.shape[1]):
        matrix[:, k, k] = variance[:, k]
    return matrix.reshape(len(variance), size * size)


def baro_topic(time_ns: np.ndarray, pressure: np.ndarray, variance: float) -> SimulatedTopic:
    """FluidPressure, Pa, with its variance in Pa^2."""
    return SimulatedTopic(
        BARO_TOPIC,
        "sensor_msgs/msg/FluidPressure",
        time_ns,
        lambda rows: {"fluid_pressure": pressure[rows], "variance": np.array(variance)},
        {"header.frame_id": "baro"},
    )


def joint_topic(time_ns: np.ndarray, position: np.ndarray, joint: str) -> SimulatedTopic:
    """JointState with the position of one joint."""
    return SimulatedTopic(
        JOINT_TOPIC,
        "sensor_msgs/msg/JointState",
        time_ns,
        lambda rows: {"position": position[rows]},
        {"header.frame_id": "", "name[0]": joint},
        {"name": 1, "position": 1},
    )
