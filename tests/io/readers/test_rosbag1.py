import bz2
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Reader

from sinstool.core.errors import (
    DamagedLogError,
    NotALogError,
    SinstoolError,
    UnsupportedLogError,
)
from sinstool.io.readers import open_log
from tests.helpers.logs import (
    IMU,
    TOPICS,
    Row,
    bag_records,
    definition,
    memory_below,
    patched,
    payload_of,
    read_back,
    real,
    rows,
    same_time,
    unindexed,
    write_bag1,
)

MESSAGE, HEADER, INDEX, CHUNK, INFO, CONNECTION = 2, 3, 4, 5, 6, 7
COMPRESSIONS = [None, "lz4", "bz2"]


def content(count=300):
    return same_time(rows(count, 1))


def header(**fields):
    """Header of a bag record."""
    parts = [name.encode() + b"=" + value for name, value in fields.items()]
    body = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    return struct.pack("<I", len(body)) + body


def record(data, **fields):
    return header(**fields) + struct.pack("<I", len(data)) + data


def message_record(connection, row):
    time = struct.pack("<II", *divmod(row.log_time, 10**9))
    number = struct.pack("<I", connection)
    return record(row.payload, op=b"\x02", conn=number, time=time)


def nth_chunk(path, n):
    return [r for r in bag_records(path.read_bytes()) if r[0] == CHUNK][n]


def chunk_counts(path):
    """Messages of each chunk, by the bag's own chunk infos."""
    data = path.read_bytes()
    return [
        sum(count for _, count in struct.iter_unpack("<II", data[begin : begin + length]))
        for op, _, begin, length in bag_records(data)
        if op == INFO
    ]


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("chunk", [1, 16384, 2**24])
@pytest.mark.parametrize("indexed", [True, False])
@pytest.mark.parametrize("connections", [1, 2])
def test_every_shape_of_bag_reads_the_same(tmp_path, compression, chunk, indexed, connections):
    path = write_bag1(tmp_path / "a.bag", content(), compression, chunk, connections)
    if not indexed:
        unindexed(path)
    with open_log(path) as log:
        assert (log.format, log.profile) == ("rosbag1", "ros1")
        assert {c.topic: c.type for c in log.channels.values()} == TOPICS
        assert read_back(log) == content()
        imu = log.channels_of("/imu")
        assert len(imu) == connections
        assert read_back(log, [c.id for c in imu]) == [r for r in content() if r.topic == "/imu"]
        assert not log.lost
        assert sum(log.counts.values()) == (len(content()) if indexed else 0)
        text, md5 = definition(IMU, 1)
        assert imu[0].schema_text == text
        assert imu[0].type_name == "sensor_msgs/Imu"
        assert imu[0].metadata == {"md5sum": md5, "callerid": "/node0", "latching": "0"}
        assert imu[0].definition(path).encoding == "ros1"


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_order_is_that_of_the_file(tmp_path, compression):
    mixed = [content()[k] for k in np.random.default_rng(0).permutation(len(content()))]
    with open_log(write_bag1(tmp_path / "a.bag", mixed, compression)) as log:
        assert read_back(log) == mixed


def test_messages_outside_chunks(tmp_path):
    # What a killed recorder leaves: an open chunk of size 0, then records at the top level
    path = unindexed(write_bag1(tmp_path / "a.bag", content()))
    extra = [Row("/late", k, k, payload_of(IMU, k, 1)) for k in range(50)]
    text, md5 = definition(IMU, 1)
    described = header(
        topic=b"/late",
        type=b"sensor_msgs/Imu",
        md5sum=md5.encode(),
        message_definition=text.encode(),
    )[4:]
    tail = record(b"", op=b"\x05", compression=b"none", size=bytes(4))
    tail += record(described, op=b"\x07", conn=struct.pack("<I", 7), topic=b"/late")
    tail += b"".join(message_record(7, row) for row in extra[:30])
    tail += record(b"", op=b"\x04", ver=b"\1\0\0\0", conn=bytes(4), count=bytes(4))
    tail += b"".join(message_record(7, row) for row in extra[30:])
    path.write_bytes(path.read_bytes() + tail)
    with open_log(path) as log:
        assert [c.type for c in log.channels_of("/late")] == [IMU]
        assert read_back(log) == content() + extra
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(DamagedLogError, match="--salvage"):
        open_log(path)
    with open_log(path, salvage=True) as log:
        assert read_back(log) == content() + extra[:-1]
        assert log.lost


def test_messages_larger_than_what_is_read_at_once(tmp_path):
    path = unindexed(write_bag1(tmp_path / "a.bag", content(3)))
    large = [Row("/imu", k, k, bytes([k]) * n) for k, n in enumerate([3, 9 * 2**20, 0, 5 * 2**20])]
    path.write_bytes(path.read_bytes() + b"".join(message_record(0, row) for row in large))
    with open_log(path) as log:
        assert read_back(log) == content(3) + large


@pytest.mark.parametrize("claim", [0, 1, 12 * 7, 2**31, 2**32 - 1])
def test_an_index_that_lies_about_its_size(tmp_path, claim):
    path = write_bag1(tmp_path / "a.bag", content(), "lz4")
    data = path.read_bytes()
    for op, _, begin, _ in bag_records(data):
        if op == INDEX:
            patched(path, begin - 4, struct.pack("<I", claim))
    with open_log(path) as log:
        assert read_back(log) == content()


@pytest.mark.parametrize("field", [b"conn_count=", b"chunk_count="])
def test_a_bag_header_that_lies(tmp_path, field):
    path = write_bag1(tmp_path / "a.bag", content(), "lz4")
    at = path.read_bytes().index(field) + len(field)
    patched(path, at, struct.pack("<I", 2**31))
    with open_log(path) as log:
        assert {c.topic: c.type for c in log.channels.values()} == TOPICS
        assert read_back(log) == content()
        assert log.counts == {}


def test_an_index_that_claims_more_than_a_file_can_have(tmp_path):
    """A count of 8 bytes, and behind it nothing that can be a record."""
    path = write_bag1(tmp_path / "a.bag", content())
    data = path.read_bytes()
    op, at, begin, length = next(r for r in bag_records(data) if r[0] == INDEX)
    assert op == INDEX
    wide = header(op=b"\x04", ver=bytes(4), conn=bytes(4), count=b"\xff" * 8)
    wide += struct.pack("<I", length)
    path.write_bytes(data[:at] + wide + data[begin : begin + length - 3] + b"\xff" * 40)
    with pytest.raises(DamagedLogError), open_log(path) as log:
        read_back(log)
    with open_log(path, salvage=True) as log:
        result = read_back(log)
        assert result and result == content()[: len(result)]


def test_an_index_position_in_the_middle_of_something(tmp_path):
    path = write_bag1(tmp_path / "a.bag", content(), "lz4")
    at = path.read_bytes().index(b"index_pos=") + 10
    patched(path, at, struct.pack("<Q", 5000))
    with open_log(path) as log:
        assert read_back(log) == content()


# -- damage --------------------------------------------------------------------------------


@pytest.mark.parametrize("compression", ["lz4", "bz2"])
def test_a_damaged_chunk_is_refused_or_passed_over(tmp_path, compression):
    path = write_bag1(tmp_path / "a.bag", content(), compression)
    counts = chunk_counts(path)
    _, at, begin, _ = nth_chunk(path, 2)
    # in the frame's own header: lz4 frames of bags need not carry a checksum
    patched(path, begin, b"\x13\x57\xff\x00\xff")
    with open_log(path) as log, pytest.raises(DamagedLogError, match=f"at byte {at}.*--salvage"):
        read_back(log)
    with open_log(path, salvage=True) as log:
        before = sum(counts[:2])
        assert read_back(log) == content()[:before] + content()[before + counts[2] :]
        (part,) = log.lost
        assert (part.kind, part.offset, part.recovered, part.declared) == (
            "chunk",
            at,
            0,
            counts[2],
        )
        assert part.start_ns == content()[before - 1].log_time
        assert part.end_ns == content()[before + counts[2]].log_time
    unindexed(path)
    with pytest.raises(DamagedLogError, match="--salvage"):
        open_log(path)


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_bag_cut_short_gives_what_is_whole(tmp_path, compression):
    path = write_bag1(tmp_path / "a.bag", content(), compression)
    counts = chunk_counts(path)
    _, _, begin, length = nth_chunk(path, 3)
    path.write_bytes(path.read_bytes()[: begin + length // 2])
    with pytest.raises(DamagedLogError, match=r"cut short.*--salvage"):
        open_log(path)
    with open_log(path, salvage=True) as log:
        result = read_back(log)
        assert result == content()[: len(result)]
        # a block of LZ4 or bzip2 is larger than this chunk, and gives nothing before it is whole
        assert sum(counts[:3]) + (compression is None) <= len(result) < sum(counts[:4])
        assert "cut short" in str(log.lost[0])


def test_salvage_goes_on_behind_a_record_that_lies(tmp_path):
    path = write_bag1(tmp_path / "a.bag", content(), "lz4")
    counts = chunk_counts(path)
    _, _, begin, _ = nth_chunk(path, 1)
    patched(path, begin - 4, struct.pack("<I", 2**32 - 1))
    with open_log(path) as log, pytest.raises(DamagedLogError, match="declares 4294967295"):
        read_back(log)
    with open_log(path, salvage=True) as log:
        assert read_back(log) == content()
        assert (log.lost[0].recovered, log.lost[0].declared) == (counts[1], counts[1])


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_sizes_that_lie_cost_no_memory(tmp_path, compression):
    path = write_bag1(tmp_path / "a.bag", content(), compression)
    data = path.read_bytes()
    _, at, begin, _ = nth_chunk(path, 0)
    size = data.index(b"size=", at, begin) + 5
    for value in (0, 1, 2**27, 2**32 - 1):
        path.write_bytes(data)
        patched(path, size, struct.pack("<I", value))
        with memory_below(200 * 2**20):
            with open_log(path) as log, pytest.raises(DamagedLogError):
                read_back(log)
            with open_log(path, salvage=True) as log:
                assert read_back(log) == content()
                assert log.lost[0].offset == at


@pytest.mark.slow
def test_a_chunk_that_swells_is_stopped(tmp_path):
    path = unindexed(write_bag1(tmp_path / "a.bag", content(3)))
    with open_log(path, salvage=True) as log:  # what the first reading imports does not count
        assert read_back(log) == content(3)
    bomb = bz2.compress(bytes(2**26))
    tail = record(bomb, op=b"\x05", compression=b"bz2", size=struct.pack("<I", 1000))
    path.write_bytes(path.read_bytes() + tail)
    with memory_below(2**24), open_log(path, salvage=True) as log:
        assert read_back(log) == content(3)
        assert "1001 bytes where 1000" in str(log.lost[0])


def test_a_record_inside_a_chunk_that_runs_over(tmp_path):
    path = write_bag1(tmp_path / "a.bag", content())
    data = path.read_bytes()
    first = content()[0].payload
    at = data.index(first)
    patched(path, at - 4, struct.pack("<I", 2**31))
    with open_log(path) as log, pytest.raises(DamagedLogError, match="inside a chunk"):
        read_back(log)
    with open_log(path, salvage=True) as log:
        assert read_back(log) == content()[1:]


def test_what_we_do_not_read_is_named(tmp_path):
    path = write_bag1(tmp_path / "a.bag", content(3), "lz4")
    data = path.read_bytes()
    path.write_bytes(data.replace(b"compression=lz4", b"compression=xyz"))
    with open_log(path) as log, pytest.raises(UnsupportedLogError, match="'xyz'"):
        read_back(log)
    encrypted = record(
        b" ",
        op=b"\x03",
        index_pos=bytes(8),
        conn_count=bytes(4),
        chunk_count=bytes(4),
        encryptor=b"rosbag/AesCbcEncryptor",
    )
    path.write_bytes(b"#ROSBAG V2.0\n" + encrypted)
    with pytest.raises(UnsupportedLogError, match=r"AesCbc.*rosbag decrypt"):
        open_log(path)
    path.write_bytes(b"#ROSBAG V1.2\n" + data[13:])
    with pytest.raises(UnsupportedLogError, match=r"version 1\.2.*rosbag fix"):
        open_log(path)
    path.write_bytes(b"#ROSBAG V2")
    with pytest.raises(NotALogError):
        open_log(path)
    path.write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(DamagedLogError, match="bag header"):
        open_log(path)


def test_messages_of_an_undefined_connection_are_noted(tmp_path):
    path = write_bag1(tmp_path / "a.bag", content())
    path.write_bytes(path.read_bytes() + message_record(55, content()[0]))
    with open_log(path) as log:
        assert read_back(log) == content()
        assert [str(part) for part in log.lost] == [
            "messages of channel 55, which the log does not define (0 of 1 messages kept)"
        ]


def test_a_message_without_its_time_is_damage_not_an_endless_walk(tmp_path):
    path = unindexed(write_bag1(tmp_path / "a.bag", content(3)))
    odd = record(b"abc", op=b"\x02", conn=bytes(4))
    path.write_bytes(path.read_bytes() + odd + message_record(0, content()[0]))
    with pytest.raises(DamagedLogError, match="lacks its"):
        open_log(path)
    with open_log(path, salvage=True) as log:
        assert read_back(log) == [*content(3), content()[0]]


@pytest.mark.slow
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_cut_at_every_byte(tmp_path, compression):
    path = write_bag1(tmp_path / "a.bag", content(6), compression, 700)
    data = path.read_bytes()
    start = bag_records(data)[1][1]
    most = 0
    end = [begin + length for op, _, begin, length in bag_records(data) if op == INDEX][-1]
    for cut in (*range(0, start, 101), *range(start, len(data), 7)):
        path.write_bytes(data[:cut])
        if cut < end:
            with pytest.raises(SinstoolError), open_log(path) as log:
                read_back(log)
        if cut < 13:
            continue
        with open_log(path, salvage=True) as log:
            result = read_back(log)
        assert result == content(6)[: len(result)]
        assert len(result) >= most
        most = len(result)
    assert most == len(content(6))


@pytest.mark.slow
@pytest.mark.parametrize("compression", COMPRESSIONS)
@given(seed=st.integers(0, 2**32))
@settings(max_examples=60, deadline=None)
def test_flipped_bits_give_an_error_of_ours_or_nothing(tmp_path_factory, compression, seed):
    rng = np.random.default_rng(seed)
    path = write_bag1(tmp_path_factory.mktemp("flip") / "a.bag", content(9), compression, 1500)
    data = bytearray(path.read_bytes())
    places = np.concatenate((np.arange(13, 120), np.arange(4100, len(data))))
    for at in rng.choice(places, rng.integers(1, 4)):
        data[at] ^= 1 << rng.integers(0, 8)
    path.write_bytes(data)
    for salvage in (False, True):
        with memory_below(600 * 2**20):
            try:
                with open_log(path, salvage) as log:
                    read_back(log)
            except SinstoolError as exc:
                assert "\n" not in str(exc)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["phidgets_imu_upside_down.bag", "ardrone_imu.bag", "sparkfun_razor.bag"]
)
def test_real_bags_read_as_rosbags_reads_them(tmp_path, name):
    path = real(f"imu_tools/{name}")
    with Reader(path) as reader:
        theirs = [Row(c.topic, time, time, bytes(data)) for c, time, data in reader.messages()]
        types = {c.topic: c.msgtype for c in reader.connections}
    with open_log(path) as log:
        assert sorted(read_back(log)) == sorted(theirs)
        assert {c.topic: c.type for c in log.channels.values()} == types
        assert sum(log.counts.values()) == len(theirs)
        whole = log.channels
    copy = tmp_path / name
    copy.write_bytes(path.read_bytes())
    with open_log(unindexed(copy)) as log:
        assert log.channels == whole
        assert sorted(read_back(log)) == sorted(theirs)
