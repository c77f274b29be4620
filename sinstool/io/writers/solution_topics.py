"""Topics of a solution: their types, frames, and the columns of their messages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sinstool.core import earth
from sinstool.core.congruence import of_turned, turned_back
from sinstool.core.rotation import conjugate, multiply, rotate, to_euler
from sinstool.core.streams import Diagnostics, Solution
from sinstool.io.readers.frames import enu_to_ned, enu_to_ned_covariance, q_for_log, turn_body


@dataclass(frozen=True)
class Frames:
    """Names and axes of the output's frames.

    Attributes
    ----------
    world : {'enu', 'ned'}
    reference : str
        ``map`` where heading is referenced to north, ``odom`` where it is not.
    body : str
        Frame id of the sensor.
    body_axes : {'flu', 'frd'}
    origin : tuple of float or None
        Latitude, longitude (rad) and height (m) where the reference frame has its origin.
    """

    world: str
    reference: str
    body: str
    body_axes: str
    origin: tuple[float, float, float] | None = None

    @property
    def reference_id(self) -> str:
        """Frame id of the reference; NED frames say so in their name."""
        return f"{self.reference}_ned" if self.world == "ned" else self.reference


Columns = dict[str, np.ndarray]
# A number as the text of a diagnostic value: always as long as this.
NUMBER = "%14.6e"
NUMBER_LENGTH = 14


class Rows:
    """A batch of solutions in the terms of messages; values shared by topics are computed once."""

    def __init__(self, solution: Solution, frames: Frames) -> None:
        self.solution = solution
        self.frames = frames

    def header(self, prefix: str = "") -> Columns:
        """The stamp, for a header at a path."""
        sec, nanosec = self._stamp
        return {f"{prefix}header.stamp.sec": sec, f"{prefix}header.stamp.nanosec": nanosec}

    @cached_property
    def _stamp(self) -> tuple[np.ndarray, np.ndarray]:
        return stamp(self.solution.time_ns)

    @cached_property
    def xyzw(self) -> np.ndarray:
        """Orientation, scalar last."""
        q = q_for_log(self.solution.q_nb, self.frames.body_axes, self.frames.world)
        return q[:, [1, 2, 3, 0]]

    @cached_property
    def position(self) -> np.ndarray | None:
        """Cartesian position in the world frame, from its origin; None without a position."""
        if self.solution.position is None or self.frames.origin is None:
            return None
        ned = earth.local_position_n(self.frames.origin, self.solution.position)
        return self.to_world(ned)

    def to_world(self, vectors_n: np.ndarray) -> np.ndarray:
        """NED vectors in the axes of the world frame."""
        return enu_to_ned(vectors_n) if self.frames.world == "enu" else vectors_n

    @cached_property
    def turned_position(self) -> np.ndarray:
        """Covariances of positions in the axes of the world frame."""
        return self._turned(self.solution.covariance_position_n)

    @cached_property
    def turned_attitude(self) -> np.ndarray:
        """Covariances of attitudes in the axes of the world frame."""
        return self._turned(self.solution.covariance_attitude_n)

    def _turned(self, covariance_n: np.ndarray | None) -> np.ndarray:
        assert covariance_n is not None
        if self.frames.world != "enu":
            return covariance_n
        return enu_to_ned_covariance(covariance_n)

    def in_body(self, covariance_n: np.ndarray) -> np.ndarray:
        """NED covariances in the log's body axes."""
        sign = turn_body(np.ones(3), self.frames.body_axes)
        return turned_back(self.solution.q_nb, covariance_n, sign)


def stamp(time_ns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Seconds and nanoseconds of times."""
    sec = time_ns // 1_000_000_000
    # numpy divides by a constant quickly, but takes remainders slowly
    return sec, time_ns - sec * 1_000_000_000


def _imu(r: Rows) -> Columns:
    columns = {
        **r.header(),
        "orientation.x": r.xyzw,
        "angular_velocity.x": turn_body(r.solution.omega_ib_b, r.frames.body_axes),
        "linear_acceleration.x": turn_body(r.solution.specific_force_b, r.frames.body_axes),
    }
    if r.solution.covariance_attitude_n is not None:
        columns["orientation_covariance"] = r.turned_attitude.reshape(-1, 9)
    return columns


def _attitude(r: Rows) -> Columns:
    return {**r.header(), "quaternion.x": r.xyzw}


def _vehicle(r: Rows) -> Columns:
    """Attitude of the vehicle, by the mount of the sensor in it."""
    assert r.solution.q_vb is not None
    q_nv = multiply(r.solution.q_nb, conjugate(r.solution.q_vb))
    q = q_for_log(q_nv, r.frames.body_axes, r.frames.world)
    return {**r.header(), "quaternion.x": q[:, [1, 2, 3, 0]]}


def _euler(r: Rows) -> Columns:
    return {**r.header(), "vector.x": to_euler(r.solution.q_nb)}


def _pose(r: Rows) -> Columns:
    columns = {**r.header(), "pose.orientation.x": r.xyzw}
    if r.position is not None:
        columns["pose.position.x"] = r.position
    return columns


def _tf(r: Rows) -> Columns:
    first = "transforms[0]."
    columns = {**r.header(first), f"{first}transform.rotation.x": r.xyzw}
    if r.position is not None:
        columns[f"{first}transform.translation.x"] = r.position
    return columns


def _odometry(r: Rows) -> Columns:
    """Pose in the world frame, twist in the body's (REP-105 and nav_msgs/Odometry).

    A velocity over ground that is known well is known no better in the body's axes than these are.
    """
    s = r.solution
    assert r.position is not None and s.velocity_n is not None
    body_velocity = rotate(conjugate(s.q_nb), s.velocity_n)
    columns = {
        **r.header(),
        "pose.pose.position.x": r.position,
        "pose.pose.orientation.x": r.xyzw,
        "twist.twist.linear.x": turn_body(body_velocity, r.frames.body_axes),
        "twist.twist.angular.x": turn_body(s.omega_ib_b, r.frames.body_axes),
    }
    if s.covariance_position_n is not None and s.covariance_attitude_n is not None:
        columns |= _block("pose.covariance", 0, r.turned_position)
        columns |= _block("pose.covariance", 3, r.turned_attitude)
    if s.covariance_velocity_n is not None:
        covariance = s.covariance_velocity_n
        if s.covariance_attitude_n is not None:
            covariance = covariance + of_turned(s.velocity_n, s.covariance_attitude_n)
        columns |= _block("twist.covariance", 0, r.in_body(covariance))
    return columns


def _block(path: str, first: int, covariance: np.ndarray) -> Columns:
    """Rows of a block of 3 x 3 on the diagonal of covariances of 6 x 6, which are 0 elsewhere."""
    return {f"{path}[{7 * first + 6 * i}]": covariance[:, i] for i in range(3)}


def _fix(r: Rows) -> Columns:
    s = r.solution
    assert s.position is not None
    columns = {
        **r.header(),
        "latitude": np.degrees(s.position[:, 0]),
        "longitude": np.degrees(s.position[:, 1]),
        "altitude": s.position[:, 2],
    }
    if s.covariance_position_n is not None:
        # always east, north, up in this message
        enu = r.frames.world == "enu"
        turned = r.turned_position if enu else enu_to_ned_covariance(s.covariance_position_n)
        columns["position_covariance"] = turned.reshape(-1, 9)
        columns["position_covariance_type"] = np.array(3)
    return columns


def _height(r: Rows) -> Columns:
    assert r.solution.vertical is not None
    return {**r.header(), "vector.x": r.solution.vertical}


@dataclass(frozen=True)
class Topic:
    """One topic that can be written."""

    topic: str
    type_name: str
    columns: Callable[[Rows], Columns]
    strings: Callable[[Frames], dict[str, str]]
    lengths: tuple[tuple[str, int], ...] = ()


def _in_reference(frames: Frames) -> dict[str, str]:
    return {"header.frame_id": frames.reference_id}


TOPICS = {
    "imu": Topic(
        "/sinstool/imu", "sensor_msgs/msg/Imu", _imu, lambda f: {"header.frame_id": f.body}
    ),
    "attitude": Topic(
        "/sinstool/attitude", "geometry_msgs/msg/QuaternionStamped", _attitude, _in_reference
    ),
    # Roll, pitch, heading are those of FRD in NED whatever the world of the quaternions.
    "euler": Topic(
        "/sinstool/euler",
        "geometry_msgs/msg/Vector3Stamped",
        _euler,
        lambda f: {"header.frame_id": f"{f.reference}_ned"},
    ),
    "odometry": Topic(
        "/sinstool/odometry",
        "nav_msgs/msg/Odometry",
        _odometry,
        lambda f: {"header.frame_id": f.reference_id, "child_frame_id": f.body.lstrip("/")},
    ),
    "pose": Topic("/sinstool/pose", "geometry_msgs/msg/PoseStamped", _pose, _in_reference),
    "fix": Topic(
        "/sinstool/fix", "sensor_msgs/msg/NavSatFix", _fix, lambda f: {"header.frame_id": f.body}
    ),
    "tf": Topic(
        "/tf",
        "tf2_msgs/msg/TFMessage",
        _tf,
        lambda f: {
            "transforms[0].header.frame_id": f.reference_id,
            # tf2 refuses the leading slash that old drivers write
            "transforms[0].child_frame_id": f.body.lstrip("/"),
        },
        (("transforms", 1),),
    ),
    "height": Topic("/sinstool/height", "geometry_msgs/msg/Vector3Stamped", _height, _in_reference),
    "vehicle": Topic(
        "/sinstool/vehicle", "geometry_msgs/msg/QuaternionStamped", _vehicle, _in_reference
    ),
}
DIAGNOSTICS_TOPIC = "/sinstool/diagnostics"
DIAGNOSTICS_TYPE = "diagnostic_msgs/msg/DiagnosticArray"


def topic_of(name: str) -> str:
    """The topic for a name of ``--emit``."""
    return DIAGNOSTICS_TOPIC if name == "diagnostics" else TOPICS[name].topic


def diagnostic_strings(names: Sequence[str], frames: Frames) -> dict[str, str]:
    """Text fields of diagnostic messages with values of these names."""
    strings = {
        "header.frame_id": frames.body,
        "status[0].name": "sinstool: filter",
        "status[0].hardware_id": "sinstool",
        "status[0].message": _LEVELS[0].decode(),
    }
    for k, name in enumerate(names):
        strings[f"status[0].values[{k}].key"] = name
        strings[f"status[0].values[{k}].value"] = " " * NUMBER_LENGTH
    return strings


_LEVELS = (b"ok             ", b"measurement off", b"restarted      ")


def diagnostic_columns(diagnostics: Diagnostics) -> Columns:
    """Columns of diagnostic messages: numbers as text of one length."""
    sec, nanosec = stamp(diagnostics.time_ns)
    messages = np.frombuffer(b"".join(_LEVELS), np.uint8).reshape(len(_LEVELS), -1)
    columns: Columns = {
        "header.stamp.sec": sec,
        "header.stamp.nanosec": nanosec,
        "status[0].level": diagnostics.level,
        "status[0].message": messages[diagnostics.level],
    }
    count, width = diagnostics.values.shape
    # one text of all of them, as a call for each number takes several times as long
    text = NUMBER * (count * width) % tuple(diagnostics.values.T.ravel().tolist())
    numbers = np.frombuffer(text.encode(), np.uint8).reshape(width, count, NUMBER_LENGTH)
    for k in range(width):
        columns[f"status[0].values[{k}].value"] = numbers[k]
    return columns
