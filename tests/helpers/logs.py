"""Small logs, written by other people's writers, and what they must read back as."""

import sqlite3
import struct
import tracemalloc
from contextlib import contextmanager
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from mcap.records import Channel as McapChannel
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter
from rosbags.typesys import Stores, get_typestore

from tests.helpers.paths import ROOT

DATA = ROOT / ".." / "shared" / "data"
IMU = "sensor_msgs/msg/Imu"
PRESSURE = "sensor_msgs/msg/FluidPressure"
COMPRESSIONS = {
    "zstd": CompressionType.ZSTD,
    "lz4": CompressionType.LZ4,
    "none": CompressionType.NONE,
}
STORAGES = {"db3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}
T0 = 1_700_000_000_000_000_000


class Row(NamedTuple):
    """One message, as far as every container keeps it."""

    topic: str
    log_time: int
    publish_time: int
    payload: bytes


@cache
def store(ros=2):
    return get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)


@cache
def definition(name, ros=2):
    return store(ros).generate_msgdef(name, ros_version=ros)


def real(path):
    """A real log, or the reason why the test is skipped."""
    file = DATA / path
    if not file.exists():
        pytest.skip(f"no real logs here ({path} is looked for in ../shared/data)")
    return file


def payload_of(name, k, ros=2, frame="imu_link"):
    types = store(ros).types
    stamp = types["builtin_interfaces/msg/Time"](sec=1_700_000_000 + k, nanosec=k)
    extra = {"seq": k} if ros == 1 else {}
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **extra)
    rng = np.random.default_rng(k)
    if name == IMU:
        vector = types["geometry_msgs/msg/Vector3"]
        turned = types["geometry_msgs/msg/Quaternion"](*rng.normal(size=4))
        cov = rng.normal(size=(3, 9))
        message = types[name](
            header=header,
            orientation=turned,
            orientation_covariance=cov[0],
            angular_velocity=vector(*rng.normal(size=3)),
            angular_velocity_covariance=cov[1],
            linear_acceleration=vector(*rng.normal(size=3)),
            linear_acceleration_covariance=cov[2],
        )
    else:
        message = types[name](header=header, fluid_pressure=rng.normal(), variance=0.0)
    if ros == 1:
        return bytes(store(1).serialize_ros1(message, name))
    return bytes(store(2).serialize_cdr(message, name))


@cache
def rows(count=300, ros=2):
    """Imu on /imu, every third time FluidPressure on /baro; publish before log time."""
    out = []
    for k in range(count):
        time = T0 + k * 5_000_000
        out.append(Row("/imu", time, time - 900_000, payload_of(IMU, k, ros)))
        if k % 3 == 0:
            time += 1_000_000
            out.append(Row("/baro", time, time, payload_of(PRESSURE, k, ros, "baro")))
    return out


TOPICS = {"/imu": IMU, "/baro": PRESSURE}


def write_mcap(path, content, ros=2, channels=None, compression="zstd", profile=None, **options):
    """MCAP by mcap's own writer; `channels` gives topics a list of channels to alternate on."""
    options = {"chunk_size": 16384, **options}
    with path.open("wb") as stream:
        writer = Writer(stream, compression=COMPRESSIONS[compression], **options)
        writer.start(profile=f"ros{ros}" if profile is None else profile)
        ids = {}
        for topic in dict.fromkeys(row.topic for row in content):
            name = TOPICS[topic]
            shown = name.replace("/msg/", "/") if ros == 1 else name
            text = definition(name, ros)[0].encode()
            schema = writer.register_schema(shown, f"ros{ros}msg", text)
            encoding = "ros1" if ros == 1 else "cdr"
            ids[topic] = [
                writer.register_channel(topic, encoding, schema, {"number": str(i)})
                for i in range((channels or {}).get(topic, 1))
            ]
        for k, row in enumerate(content):
            choice = ids[row.topic]
            writer.add_message(
                choice[k % len(choice)], row.log_time, row.payload, row.publish_time, k
            )
        writer.finish()
    return path


def write_bag1(path, content, compression=None, chunk=16384, connections=1):
    with_writer = BagWriter(path)
    if compression:
        with_writer.set_compression(BagWriter.CompressionFormat[compression.upper()])
    with_writer.chunk_threshold = chunk
    with with_writer as writer:
        ids = {
            topic: [
                writer.add_connection(
                    topic, TOPICS[topic], typestore=store(1), callerid=f"/node{i}", latching=i
                )
                for i in range(connections)
            ]
            for topic in dict.fromkeys(row.topic for row in content)
        }
        for k, row in enumerate(content):
            choice = ids[row.topic]
            writer.write(choice[k % len(choice)], row.log_time, row.payload)
    return path


def write_bag2(path, content, storage="db3", mode=None, types=None):
    """A ROS 2 bag folder by rosbags' writer; `mode` is what zstd packs, 'file' or 'message'."""
    types = types or TOPICS
    writer = FolderWriter(path, version=9, storage_plugin=STORAGES[storage])
    if mode:
        writer.set_compression(CompressionMode[mode.upper()], CompressionFormat.ZSTD)
    with writer:
        ids = {
            topic: writer.add_connection(topic, types[topic], typestore=store())
            for topic in dict.fromkeys(row.topic for row in content)
        }
        for row in content:
            writer.write(ids[row.topic], row.log_time, row.payload)
    return path


def write_db3(path, messages, version=3, wal=False):
    """A .db3 as the versions of rosbag2 made it; the connection comes too while `wal`."""
    database = sqlite3.connect(path)
    if wal:
        database.execute("PRAGMA journal_mode=wal")
        database.execute("PRAGMA wal_autocheckpoint=0")
    more = {1: "", 2: ", offered_qos_profiles TEXT NOT NULL"}.get(version)
    if more is None:
        database.execute("CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT)")
        database.execute("INSERT INTO schema VALUES (?, 'x')", (version,))
        more = ", offered_qos_profiles TEXT NOT NULL"
    if version >= 4:
        more += ", type_description_hash TEXT NOT NULL"
        database.execute(
            "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT,"
            " encoding TEXT, encoded_message_definition TEXT, type_description_hash TEXT)"
        )
    database.execute(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
        f" serialization_format TEXT NOT NULL{more})"
    )
    database.execute(
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
        " timestamp INTEGER NOT NULL, data BLOB NOT NULL)"
    )
    database.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
    ids = {}
    for topic in dict.fromkeys(row.topic for row in messages):
        ids[topic] = len(ids) + 1
        values = [ids[topic], topic, TOPICS[topic], "cdr", "- history: 1", "RIHS01_00"]
        values = values[: {1: 4, 2: 5, 3: 5}.get(version, 6)]
        marks = ", ".join("?" * len(values))
        database.execute(f"INSERT INTO topics VALUES ({marks})", values)
        if version >= 4:
            values = (topic and TOPICS[topic], "ros2msg", definition(TOPICS[topic])[0], "RIHS01_00")
            database.execute("INSERT INTO message_definitions VALUES (NULL, ?, ?, ?, ?)", values)
    database.commit()
    database.executemany(
        "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
        [(ids[row.topic], row.log_time, row.payload) for row in messages],
    )
    database.commit()
    if wal:
        return path, database
    database.close()
    return path


def read_back(log, channels=None):
    """All messages of a log as rows, in its order."""
    out = []
    last = 0
    for batch in log.batches(channels):
        assert last <= batch.position <= log.size
        last = batch.position
        data = batch.buffer.data
        for number, at, length, log_time, publish_time in zip(
            batch.channel.tolist(),
            batch.offset.tolist(),
            batch.length.tolist(),
            batch.log_time.tolist(),
            batch.publish_time.tolist(),
            strict=True,
        ):
            topic = log.channels[number].topic
            out.append(Row(topic, log_time, publish_time, bytes(data[at : at + length])))
    return out


def stream_rows(path):
    """What mcap's own sequential reader finds, as far as it gets."""
    topics, out = {}, []
    with path.open("rb") as stream:
        records = StreamReader(stream).records
        while True:
            try:
                record = next(records)
            except Exception:  # it has many: damaged files end here
                return out
            if isinstance(record, McapChannel):
                topics[record.id] = record.topic
            elif isinstance(record, McapMessage) and record.channel_id in topics:
                out.append(
                    Row(
                        topics[record.channel_id],
                        record.log_time,
                        record.publish_time,
                        bytes(record.data),
                    )
                )


def same_time(content):
    """The rows as containers with one time for each message have them."""
    return [row._replace(publish_time=row.log_time) for row in content]


def mcap_records(data):
    """(opcode, offset, length of the body) of the records at the top level."""
    pos, out = 8, []
    while pos + 9 <= len(data) - 8:
        length = int.from_bytes(data[pos + 1 : pos + 9], "little")
        out.append((data[pos], pos, length))
        pos += 9 + length
    return out


def bag_records(data):
    """(op, offset, offset of the data, length of the data) of the records at the top level."""
    pos, out = 13, []
    while pos < len(data):
        (width,) = struct.unpack_from("<I", data, pos)
        (length,) = struct.unpack_from("<I", data, pos + 4 + width)
        op = data[data.index(b"op=", pos + 4, pos + 4 + width) + 3]
        out.append((op, pos, pos + 8 + width, length))
        pos += 8 + width + length
    return out


def patched(path, at, new):
    """Overwrite bytes of a file."""
    data = bytearray(path.read_bytes())
    data[at : at + len(new)] = new
    path.write_bytes(data)
    return path


def unindexed(path):
    """Take the index off a bag, as a recorder that was killed leaves it."""
    data = path.read_bytes()
    records = b"".join(
        data[at : begin + length]
        for op, at, begin, length in bag_records(data)
        if op in (3, 5)  # the bag header, and chunks
    )
    path.write_bytes(data[:13] + records)
    at = data.index(b"index_pos=") + 10
    return patched(path, at, bytes(8))


@contextmanager
def memory_below(limit):
    """Fails where Python and numpy take more memory than that at any time."""
    tracemalloc.start()
    try:
        yield
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < limit, f"{peak / 2**20:.0f} MiB"


def content(count=300, ros=2):
    """`rows` as containers with one time keep them."""
    return same_time(rows(count, ros))


def snapshot(folder):
    """Everything in a folder, to see that nothing was changed."""
    return {p.name: (p.stat().st_mtime_ns, p.read_bytes()) for p in folder.iterdir()}
