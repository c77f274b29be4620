"""Solutions written to an MCAP: serialised in batches, in step with the other messages."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from sinstool.core.streams import Diagnostics, Solution, concatenate
from sinstool.io.messages.definitions import md5_sum, ros1_type_name, schema_text, type_hash
from sinstool.io.messages.encode import Encoder
from sinstool.io.readers.batch import RawBatch
from sinstool.io.writers.mcap import McapWriter
from sinstool.io.writers.solution_topics import (
    DIAGNOSTICS_TOPIC,
    DIAGNOSTICS_TYPE,
    TOPICS,
    Columns,
    Frames,
    Rows,
    diagnostic_columns,
    diagnostic_strings,
)

# Keep last 10, reliable, volatile, as numbers: the oldest supported rosbag2 reads nothing else
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
# Bytes serialised at a time, about six chunks: with fewer, the threads wait longer for each other;
# with more, the data no longer fit into the processor's cache.
BATCH_BYTES = 6 * 2**20


class SolutionWriter:
    """Serialises solutions and hands them to a McapWriter in batches of a fixed size.

    Parameters
    ----------
    encoding : {'cdr', 'ros1'}
    emits : sequence of str
        Keys of TOPICS, and ``diagnostics``.
    before_batch : callable
        Called with the last log time of a batch before it is written, so that earlier messages can
        be written first.
    diagnostic_names : sequence of str, optional
        Names of the columns of the diagnostics.
    """

    def __init__(
        self,
        writer: McapWriter,
        encoding: str,
        emits: Sequence[str],
        frames: Frames,
        before_batch: Callable[[int], None],
        diagnostic_names: Sequence[str] = (),
    ) -> None:
        self._writer = writer
        self._encoding = encoding
        self._frames = frames
        self._before = before_batch
        self._topics = [TOPICS[name] for name in emits if name in TOPICS]
        self._encoders = [
            Encoder(t.type_name, encoding, t.strings(frames), dict(t.lengths)) for t in self._topics
        ]
        self._payload_size = sum(e.encode({}, 1).shape[1] for e in self._encoders)
        self._batch = max(1, BATCH_BYTES // max(1, self._payload_size))
        self._numbers = [self._define(t.topic, t.type_name) for t in self._topics]
        self._diagnostics: list[Diagnostics] = []
        self._diagnosed = 0
        if "diagnostics" in emits:
            self._diagnostic_number = self._define(DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE)
            self._diagnostic_encoder: Encoder | None = Encoder(
                DIAGNOSTICS_TYPE,
                encoding,
                diagnostic_strings(diagnostic_names, frames),
                {"status": 1, "status[0].values": len(diagnostic_names)},
            )
        else:
            self._diagnostic_encoder = None
        self._held: list[Solution] = []
        self._count = 0
        self.written = 0

    def _define(self, topic: str, type_name: str) -> int:
        ros1 = self._encoding == "ros1"
        name = ros1_type_name(type_name) if ros1 else type_name
        text = schema_text(type_name, self._encoding).encode()
        schema = self._writer.add_schema(name, "ros1msg" if ros1 else "ros2msg", text)
        if ros1:
            metadata = {"md5sum": md5_sum(type_name), "latching": "0", "callerid": "sinstool"}
        else:
            metadata = {"offered_qos_profiles": QOS, "topic_type_hash": type_hash(type_name)}
        return self._writer.add_channel(topic, self._encoding, schema, metadata)

    def push(self, solution: Solution) -> None:
        """Take solutions, in the order of time."""
        begin = 0
        while self._count + len(solution) - begin >= self._batch:
            # only batches that span two blocks are copied
            end = begin + self._batch - self._count
            self._held.append(solution.rows(slice(begin, end)))
            self._write(concatenate(self._held))
            self._held, self._count, begin = [], 0, end
        if begin < len(solution):
            self._held.append(solution.rows(slice(begin, None)))
            self._count += len(solution) - begin

    def note(self, diagnostics: Diagnostics) -> None:
        """Take diagnostics, in the order of time; they are written beside the solutions."""
        if len(diagnostics):
            self._diagnostics.append(diagnostics)

    def finish(self) -> None:
        """Write the solutions held back so far."""
        if self._count:
            self._write(concatenate(self._held))
        self._held, self._count = [], 0
        rest = self._due(None)
        if rest is not None:
            self._writer.write([self._diagnosis(*rest)])

    def _due(self, log_time_ns: int | None) -> tuple[Diagnostics, np.ndarray] | None:
        """Diagnostics up to a log time (all of them for None), with their sequence numbers."""
        if self._diagnostic_encoder is None or not self._diagnostics:
            return None
        held = concatenate(self._diagnostics)
        count = len(held)
        if log_time_ns is not None:
            count = int(np.searchsorted(held.log_time_ns, log_time_ns, "right"))
        self._diagnostics = [held.rows(slice(count, None))] if count < len(held) else []
        if not count:
            return None
        sequence = np.arange(self._diagnosed, self._diagnosed + count, dtype=np.int64)
        self._diagnosed += count
        return held.rows(slice(0, count)), sequence

    def _diagnosis(self, diagnostics: Diagnostics, sequence: np.ndarray) -> RawBatch:
        assert self._diagnostic_encoder is not None
        return _serialised(
            self._diagnostic_encoder,
            self._diagnostic_number,
            diagnostic_columns(diagnostics),
            diagnostics.log_time_ns,
            sequence,
        )

    def _write(self, solution: Solution) -> None:
        count = len(solution)
        last = int(solution.log_time_ns.max())
        self._before(last)
        due = self._due(last)
        sequence = np.arange(self.written, self.written + count, dtype=np.int64)
        self._writer.write_made(
            lambda: self._messages(solution, sequence, due), count * self._payload_size
        )
        self.written += count

    def _messages(
        self, solution: Solution, sequence: np.ndarray, due: tuple[Diagnostics, np.ndarray] | None
    ) -> list[RawBatch]:
        """Serialise a batch; runs in the writer's threads, so it must not change any state."""
        rows = Rows(solution, self._frames)
        parts = []
        for topic, encoder, number in zip(self._topics, self._encoders, self._numbers, strict=True):
            columns = topic.columns(rows)
            parts.append(_serialised(encoder, number, columns, solution.log_time_ns, sequence))
        if due is not None:
            parts.append(self._diagnosis(*due))
        return parts


def _serialised(
    encoder: Encoder, channel: int, columns: Columns, log_time: np.ndarray, sequence: np.ndarray
) -> RawBatch:
    """Messages of one topic, for ROS 1 with the sequence number in the header too."""
    for path in encoder.layout.leaves:
        if path.endswith("header.seq"):
            columns[path] = sequence
    payload = encoder.encode(columns, len(sequence))
    return RawBatch.from_rows(channel, payload, log_time, sequence)
