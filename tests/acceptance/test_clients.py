"""What `process` writes, opened by the programs that people will open it with."""

import hashlib
import json
import shutil
import subprocess
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Channel, Chunk, ChunkIndex, Message, MessageIndex
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import IndexType
from rosbags.highlevel import AnyReader

from sinstool.config import ProcessConfig
from sinstool.pipelines.process.run import process
from tests.helpers.imulogs import (
    IMU,
    even_times,
    handheld,
    imu_messages,
    serialised,
    stamp_ns,
    store,
)
from tests.helpers.logs import PRESSURE, Row, mcap_records, real, write_bag1, write_bag2, write_mcap

pytestmark = pytest.mark.slow

OURS = {"/sinstool/imu": IMU, "/sinstool/attitude": "geometry_msgs/msg/QuaternionStamped"}
COUNT = 600


def small(ros):
    """IMU that turns by hand, and pressure that comes late: the file is not in order of time."""
    times = even_times(COUNT)
    gyro, accel, _ = handheld(COUNT)
    pressure = store(ros).types[PRESSURE]
    rows = []
    for k, m in enumerate(imu_messages(times, gyro, accel, log_ns=times + 900_000, ros=ros)):
        payload = serialised(m.message, m.type_name, ros)
        rows.append(Row("/imu", m.log_ns, m.log_ns if ros == 1 else m.log_ns - 1000, payload))
        if k % 10 == 0:
            late = m.log_ns - 2_000_000
            value = pressure(header=m.message.header, fluid_pressure=95e3 + k, variance=0.0)
            rows.append(Row("/baro", late, late, serialised(value, PRESSURE, ros)))
    return rows


def one_time(rows):
    return [row._replace(publish_time=row.log_time) for row in rows]


NO_INDEX = {"index_types": IndexType.NONE, "use_statistics": False}
MADE = {
    "zstd": lambda p: write_mcap(p / "a.mcap", small(2)),
    "lz4": lambda p: write_mcap(p / "a.mcap", small(2), compression="lz4"),
    "none": lambda p: write_mcap(p / "a.mcap", small(2), compression="none"),
    "unchunked": lambda p: write_mcap(p / "a.mcap", small(2), use_chunking=False),
    "no index": lambda p: write_mcap(p / "a.mcap", small(2), **NO_INDEX),
    "channels on a topic": lambda p: write_mcap(p / "a.mcap", small(2), channels={"/imu": 2}),
    "ros1 mcap": lambda p: write_mcap(p / "a.mcap", small(1), ros=1),
    "bag": lambda p: write_bag1(p / "a.bag", small(1), "lz4"),
    "db3": lambda p: write_bag2(p / "bag", small(2)),
}
REAL = (
    "imu_tools/sparkfun_razor.bag",
    "imu_tools/phidgets_imu_upside_down.ros1profile.mcap",
    "imu_tools/ardrone_imu_ros2_db3",
    "px4/px4_fmuv6c_inflight_6s.mcap",
    "vehicle_gnss/yk_urban_short_turn_loop_nominal_002.mcap",
)
EVERY = (*MADE, *REAL)
ROS1 = (
    "ros1 mcap",
    "bag",
    "imu_tools/sparkfun_razor.bag",
    "imu_tools/phidgets_imu_upside_down.ros1profile.mcap",
)
ROS2 = tuple(name for name in EVERY if name not in ROS1)
NO_MCAP = ("bag", "db3", "imu_tools/sparkfun_razor.bag", "imu_tools/ardrone_imu_ros2_db3")


def of_logs(names):
    """The cases that a test is about."""
    return pytest.mark.parametrize("case", names, indirect=True, scope="session")


@dataclass(frozen=True)
class Case:
    log: Path
    output: Path
    summary: dict
    ros: int
    made: bool


@pytest.fixture(scope="session", params=EVERY)
def case(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("case")
    log = MADE[request.param](folder) if request.param in MADE else real(request.param)
    output = folder / "out.mcap"
    summary = process(log, output, ProcessConfig(navigation={"mode": "attitude"})).to_json()
    ros = 1 if request.param in ROS1 else 2
    return Case(log, output, summary, ros, request.param in MADE)


@pytest.fixture(scope="session")
def written(case):
    """All messages of the output, as mcap's indexed reader finds them."""
    with case.output.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        return [
            Row(channel.topic, message.log_time, message.publish_time, message.data)
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]


def counted(rows):
    return Counter(row.topic for row in rows)


def input_rows(case):
    """All messages of the input, by the readers its own makers recommend."""
    if case.log.suffix == ".mcap":
        topics, rows = {}, []
        with case.log.open("rb") as stream:
            for record in StreamReader(stream, validate_crcs=True).records:
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Message):
                    times = record.log_time, record.publish_time
                    rows.append(Row(topics[record.channel_id], *times, record.data))
        return rows
    with AnyReader([case.log]) as reader:
        return [Row(c.topic, at, at, bytes(data)) for c, at, data in reader.messages()]


def test_mcap_reads_it_by_index_and_as_a_stream(case, written):
    with case.output.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == f"ros{case.ros}"
        statistics = reader.get_summary().statistics
        times = [message.log_time for _, _, message in reader.iter_messages()]
    assert times == sorted(times)
    assert len(times) == len(written) == statistics.message_count
    with case.output.open("rb") as stream:
        reader = NonSeekingReader(stream, validate_crcs=True)
        streamed = Counter(c.topic for _, c, _ in reader.iter_messages(log_time_order=False))
    assert streamed == counted(written)
    for topic in OURS:
        assert streamed[topic] == case.summary["output"]["attitudes"]


def test_every_message_of_the_input_is_there_unchanged(case, written):
    expected = input_rows(case)
    rest = [row for row in written if not row.topic.startswith("/sinstool/")]
    assert Counter(rest) == Counter(expected)
    if case.made:
        rows = small(case.ros)
        has_publish_times = case.log.suffix == ".mcap"
        assert Counter(expected) == Counter(rows if has_publish_times else one_time(rows))


@of_logs(ROS2)  # rosbags reads MCAP of profile ros2 only
def test_rosbags_reads_it(case, written):
    with AnyReader([case.output]) as reader:
        assert Counter(c.topic for c, _, _ in reader.messages()) == counted(written)
        assert {t: reader.topics[t].msgtype for t in OURS} == OURS
        for connection in reader.connections:
            if connection.topic in OURS:
                (qos,) = connection.ext.offered_qos_profiles
                assert (qos.depth, qos.history.name) == (10, "KEEP_LAST")
                assert (qos.reliability.name, qos.durability.name) == ("RELIABLE", "VOLATILE")
        topic = case.summary["imu"]["topic"]
        times = {"/sinstool/imu": [], "/sinstool/attitude": [], topic: []}
        q, logged = [], {"/sinstool/imu": {}, topic: {}}
        expected = [c for c in reader.connections if c.topic in times]
        for connection, log_time, data in reader.messages(connections=expected):
            message = reader.deserialize(data, connection.msgtype)
            times[connection.topic].append(stamp_ns(message))
            if connection.topic in logged:
                logged[connection.topic].setdefault(times[connection.topic][-1], log_time)
            if connection.topic in OURS:
                value = getattr(message, "orientation", None) or message.quaternion
                q.append((value.x, value.y, value.z, value.w))
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, rtol=0, atol=1e-12)
    assert times["/sinstool/imu"] == times["/sinstool/attitude"]
    own = sorted(set(times[topic]))
    assert times["/sinstool/imu"] == own[len(own) - len(times["/sinstool/imu"]) :]
    assert logged["/sinstool/imu"].items() <= logged[topic].items()
    if case.made:
        assert own == even_times(COUNT).tolist()
        assert len(times["/sinstool/imu"]) == COUNT


@of_logs(ROS1)
def test_ros1_in_gives_ros1_out(case, written):
    names = {"/sinstool/imu": IMU, "/sinstool/attitude": OURS["/sinstool/attitude"]}
    with case.output.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert (channel.message_encoding, schema.encoding) == ("ros1", "ros1msg")
        if channel.topic in names:
            assert schema.name == names[channel.topic].replace("/msg/", "/")
            assert channel.metadata["md5sum"] == store(1).generate_msgdef(names[channel.topic])[1]
            text = schema.data.decode()
            assert text.startswith("std_msgs/Header header") or "\nstd_msgs/Header header" in text
    stamps = set()
    for row in written:
        if row.topic == case.summary["imu"]["topic"]:
            stamps.add(stamp_ns(store(1).deserialize_ros1(row.payload, IMU)))
    seq = 0
    for row in written:
        if row.topic == "/sinstool/imu":
            message = store(1).deserialize_ros1(row.payload, IMU)
            q = message.orientation
            assert abs(q.x**2 + q.y**2 + q.z**2 + q.w**2 - 1.0) < 1e-12
            assert stamp_ns(message) in stamps
            assert message.header.seq == seq
            seq += 1


def chunk_bodies(path):
    data = path.read_bytes()
    return [
        hashlib.sha256(data[at + 9 : at + 9 + length]).hexdigest()
        for op, at, length in mcap_records(data)
        if op == Opcode.CHUNK
    ]


@of_logs([name for name in EVERY if name not in NO_MCAP])
def test_chunks_of_an_mcap_are_copied_as_they_are(case):
    bodies = chunk_bodies(case.log)
    there = chunk_bodies(case.output)
    assert [body for body in there if body in set(bodies)] == bodies
    assert len(there) > len(bodies)


def test_indexes_and_summary_are_whole(case, written):
    listed, counts, chunk, headers = {}, Counter(), None, 0
    with case.output.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    topics = {number: channel.topic for number, channel in summary.channels.items()}
    with case.output.open("rb") as stream:
        for record in StreamReader(stream, emit_chunks=True, validate_crcs=True).records:
            headers += type(record).__name__ == "Header"
            if isinstance(record, Chunk):
                chunk = Counter(
                    m.channel_id for m in breakup_chunk(record, True) if isinstance(m, Message)
                )
                assert chunk, "a chunk without messages"
                counts += chunk
            elif isinstance(record, MessageIndex):
                assert chunk.pop(record.channel_id) == len(record.records)
                listed[record.channel_id] = listed.get(record.channel_id, 0) + len(record.records)
            elif isinstance(record, ChunkIndex):
                assert record.message_index_offsets
            elif chunk is not None:
                assert not chunk, "a chunk lacks a message index"
    assert headers == 1
    assert (
        listed
        == counts
        == {c: n for c, n in summary.statistics.channel_message_counts.items() if n}
    )
    assert Counter({topics[c]: 0 for c in listed} | counted(written)) == counted(written)
    statistics = summary.statistics
    assert statistics.message_count == len(written)
    assert statistics.message_start_time == min(row.log_time for row in written)
    assert statistics.message_end_time == max(row.log_time for row in written)
    assert statistics.chunk_count == len(summary.chunk_indexes)
    assert statistics.channel_count == len(summary.channels)
    assert statistics.schema_count == len(summary.schemas)
    with case.output.open("rb") as stream:
        names = [record.name for record in make_reader(stream).iter_metadata()]
    assert "sinstool" in names
    assert statistics.metadata_count == len(names)


@pytest.fixture(scope="session")
def node(npm_packages):
    """The script, in a folder with the packages that it needs."""
    return shutil.copy(Path(__file__).with_name("read_all.mjs"), npm_packages)


def test_mcap_core_reads_it_by_index_and_as_a_stream(case, written, node):
    # With threads of its own V8 now and then waits for ever for its WebAssembly compiler when all
    # is said and done (seen with node 20): one thread has nobody to wait for.
    command = ["node", "--single-threaded", node, case.output]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    expected = counted(written)
    assert said["indexed"] == {"counts": expected, "ascending": True, "declared": len(written)}
    assert said["streamed"] == {"counts": expected, "headers": 1, "done": True}
