"""Solutions as ROS messages: which topics there are, and what each carries."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sinstool.messages.definitions import md5_sum, ros1_type_name, schema_text, type_hash
from sinstool.messages.encode import Encoder
from sinstool.readers.frames import q_for_log, turn_body
from sinstool.rotation import to_euler
from sinstool.streams import Solution, concatenate
from sinstool.writers.chunks import Messages
from sinstool.writers.mcap import McapWriter

# Numeric, as the oldest supported rosbag2 reads nothing else: keep last 10, reliable, volatile.
QOS = """- history: 1
  depth: 10
  reliability: 1
  durability: 2
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false"""
# Small enough for what is made of it to stay in the processor's cache: two chunks.
BATCH = 4096


@dataclass(frozen=True)
class Frames:
    """Names and axes of what is written.

    Attributes
    ----------
    world : {'enu', 'ned'}
    reference : str
        ``map`` where heading is referenced to north, ``odom`` where it is not.
    body : str
        Frame id of the sensor.
    body_axes : {'flu', 'frd'}
    """

    world: str
    reference: str
    body: str
    body_axes: str

    @property
    def reference_id(self) -> str:
        """Frame id of the reference; NED frames say so in their name."""
        return f"{self.reference}_ned" if self.world == "ned" else self.reference


Columns = dict[str, np.ndarray]


class _Rows:
    """A batch of solutions as messages give it; what several topics share is made once."""

    def __init__(self, solution: Solution, frames: Frames) -> None:
        self.solution = solution
        self.frames = frames

    def header(self, prefix: str = "") -> Columns:
        sec, nanosec = self._stamp
        return {f"{prefix}header.stamp.sec": sec, f"{prefix}header.stamp.nanosec": nanosec}

    @cached_property
    def _stamp(self) -> tuple[np.ndarray, np.ndarray]:
        time_ns = self.solution.time_ns
        sec = time_ns // 1_000_000_000
        # numpy divides by a constant quickly, but takes remainders slowly
        return sec, time_ns - sec * 1_000_000_000

    @cached_property
    def xyzw(self) -> np.ndarray:
        q = q_for_log(self.solution.q_nb, self.frames.body_axes, self.frames.world)
        return q[:, [1, 2, 3, 0]]


def _imu(r: _Rows) -> Columns:
    return {
        **r.header(),
        "orientation.x": r.xyzw,
        "angular_velocity.x": turn_body(r.solution.omega_ib_b, r.frames.body_axes),
        "linear_acceleration.x": turn_body(r.solution.specific_force_b, r.frames.body_axes),
    }


def _attitude(r: _Rows) -> Columns:
    return {**r.header(), "quaternion.x": r.xyzw}


def _euler(r: _Rows) -> Columns:
    return {**r.header(), "vector.x": to_euler(r.solution.q_nb)}


def _pose(r: _Rows) -> Columns:
    return {**r.header(), "pose.orientation.x": r.xyzw}


def _tf(r: _Rows) -> Columns:
    first = "transforms[0]."
    return {**r.header(first), f"{first}transform.rotation.x": r.xyzw}


@dataclass(frozen=True)
class _Topic:
    """One topic that can be written."""

    topic: str
    type_name: str
    columns: Callable[[_Rows], Columns]
    strings: Callable[[Frames], dict[str, str]]
    lengths: tuple[tuple[str, int], ...] = ()


def _in_reference(frames: Frames) -> dict[str, str]:
    return {"header.frame_id": frames.reference_id}


TOPICS = {
    "imu": _Topic(
        "/sinstool/imu", "sensor_msgs/msg/Imu", _imu, lambda f: {"header.frame_id": f.body}
    ),
    "attitude": _Topic(
        "/sinstool/attitude", "geometry_msgs/msg/QuaternionStamped", _attitude, _in_reference
    ),
    # Roll, pitch, heading are those of FRD in NED whatever the world of the quaternions.
    "euler": _Topic(
        "/sinstool/euler",
        "geometry_msgs/msg/Vector3Stamped",
        _euler,
        lambda f: {"header.frame_id": f"{f.reference}_ned"},
    ),
    "pose": _Topic("/sinstool/pose", "geometry_msgs/msg/PoseStamped", _pose, _in_reference),
    "tf": _Topic(
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
}


class SolutionWriter:
    """Serialises solutions and hands them to a McapWriter in batches of a fixed size.

    Parameters
    ----------
    writer : McapWriter
    encoding : {'cdr', 'ros1'}
    emits : sequence of str
        Keys of TOPICS.
    frames : Frames
    before_batch : callable
        Called with the last log time of a batch before it is written, so that what belongs
        before it can be.
    """

    def __init__(
        self,
        writer: McapWriter,
        encoding: str,
        emits: Sequence[str],
        frames: Frames,
        before_batch: Callable[[int], None],
    ) -> None:
        self._writer = writer
        self._encoding = encoding
        self._frames = frames
        self._before = before_batch
        self._topics = [TOPICS[name] for name in emits]
        self._encoders = [
            Encoder(t.type_name, encoding, t.strings(frames), dict(t.lengths)) for t in self._topics
        ]
        self._payload_size = sum(e.encode({}, 1).shape[1] for e in self._encoders)
        self._numbers = [self._define(t) for t in self._topics]
        self._held: list[Solution] = []
        self._count = 0
        self.written = 0

    def _define(self, topic: _Topic) -> int:
        ros1 = self._encoding == "ros1"
        name = ros1_type_name(topic.type_name) if ros1 else topic.type_name
        text = schema_text(topic.type_name, self._encoding).encode()
        schema = self._writer.add_schema(name, "ros1msg" if ros1 else "ros2msg", text)
        if ros1:
            metadata = {"md5sum": md5_sum(topic.type_name), "latching": "0", "callerid": "sinstool"}
        else:
            metadata = {
                "offered_qos_profiles": QOS,
                "topic_type_hash": type_hash(topic.type_name),
            }
        return self._writer.add_channel(topic.topic, self._encoding, schema, metadata)

    def push(self, solution: Solution) -> None:
        """Take solutions, in the order of time."""
        self._held.append(solution)
        self._count += len(solution)
        while self._count >= BATCH:
            whole = concatenate(self._held)
            self._write(whole.rows(slice(0, BATCH)))
            self._held = [whole.rows(slice(BATCH, None))]
            self._count -= BATCH

    def finish(self) -> None:
        """Write what is held."""
        if self._count:
            self._write(concatenate(self._held))
        self._held, self._count = [], 0

    def _write(self, solution: Solution) -> None:
        count = len(solution)
        self._before(int(solution.log_time_ns.max()))
        sequence = np.arange(self.written, self.written + count, dtype=np.int64)
        self._writer.write_made(
            lambda: self._messages(solution, sequence), count * self._payload_size
        )
        self.written += count

    def _messages(self, solution: Solution, sequence: np.ndarray) -> list[Messages]:
        """Serialise a batch; runs in the writer's threads, so it changes nothing of ours."""
        rows = _Rows(solution, self._frames)
        parts = []
        for topic, encoder, number in zip(self._topics, self._encoders, self._numbers, strict=True):
            columns = topic.columns(rows)
            for path in encoder.layout.leaves:
                if path.endswith("header.seq"):
                    columns[path] = sequence
            payload = encoder.encode(columns, len(solution))
            parts.append(Messages.from_rows(number, payload, solution.log_time_ns, sequence))
        return parts
