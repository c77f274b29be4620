import struct
from io import BytesIO

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.records import ChunkIndex
from mcap.writer import IndexType

from sinstool.core.errors import (
    DamagedLogError,
    NotALogError,
    SinstoolError,
    UnsupportedLogError,
)
from sinstool.io.readers import compression, open_log
from sinstool.io.readers.mcap import ChunkPlace, McapLog
from tests.helpers.logs import (
    IMU,
    TOPICS,
    Row,
    definition,
    mcap_records,
    memory_below,
    patched,
    payload_of,
    read_back,
    real,
    rows,
    stream_rows,
    write_mcap,
)

CHUNK, DATA_END, FOOTER = 0x06, 0x0F, 0x02
SCHEMA, CHANNEL, MESSAGE = 0x03, 0x04, 0x05
NO_SUMMARY = {
    "index_types": IndexType.NONE,
    "repeat_channels": False,
    "repeat_schemas": False,
    "use_statistics": False,
    "use_summary_offsets": False,
}
SHAPES = {
    "zstd": {},
    "lz4": {"compression": "lz4"},
    "none": {"compression": "none"},
    "unchunked": {"use_chunking": False},
    "no summary": NO_SUMMARY,
    "no summary, unchunked": NO_SUMMARY | {"use_chunking": False},
    "channels not repeated": {"repeat_channels": False},
    "schemas not repeated": {"repeat_schemas": False},
    "nothing repeated": {"repeat_channels": False, "repeat_schemas": False},
    "no message index": {"index_types": IndexType.CHUNK},
    "no chunk index": {"index_types": IndexType.MESSAGE},
    "no statistics": {"use_statistics": False},
    "no summary offsets": {"use_summary_offsets": False},
    "no CRCs": {"enable_crcs": False},
    "data CRC": {"enable_data_crcs": True},
    "two channels on a topic": {"channels": {"/imu": 2, "/baro": 3}},
    "one large chunk": {"chunk_size": 2**24},
    "a chunk for each message": {"chunk_size": 1},
    "no profile": {"profile": ""},
}


def nth_chunk(path, n):
    """Offset of the n-th chunk record."""
    return [pos for op, pos, _ in mcap_records(path.read_bytes()) if op == CHUNK][n]


@pytest.mark.parametrize("shape", SHAPES)
def test_every_shape_of_file_reads_the_same(tmp_path, shape):
    path = write_mcap(tmp_path / "a.mcap", rows(), **SHAPES[shape])
    with open_log(path) as log:
        assert log.format == "mcap"
        assert log.profile == SHAPES[shape].get("profile", "ros2")
        assert read_back(log) == rows() == stream_rows(path)
        assert {c.topic: c.type for c in log.channels.values()} == TOPICS
        assert len(log.channels_of("/imu")) == (2 if shape.startswith("two") else 1)
        imu = [c.id for c in log.channels_of("/imu")]
        assert read_back(log, imu) == [row for row in rows() if row.topic == "/imu"]
        assert read_back(log) == rows()
        assert not log.lost
        for channel in log.channels.values():
            assert channel.message_encoding == "cdr"
            assert channel.schema_text == definition(channel.type)[0]
            assert channel.definition(path).types
            assert "number" in channel.metadata


def test_ros1_inside_mcap(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", rows(30, 1), ros=1)
    with open_log(path) as log:
        assert log.profile == "ros1"
        assert read_back(log) == rows(30, 1)
        channel = log.channels_of("/imu")[0]
        assert (channel.type_name, channel.type) == ("sensor_msgs/Imu", IMU)
        assert channel.definition(path).encoding == "ros1"


def test_overlapping_chunks_and_times_out_of_order_come_in_file_order(tmp_path):
    order = np.random.default_rng(0).permutation(len(rows()))
    content = [rows()[k] for k in order]
    with open_log(write_mcap(tmp_path / "a.mcap", content)) as log:
        assert read_back(log) == content


def test_times_at_the_ends_of_their_range(tmp_path):
    late = 2**63 - 1
    content = [Row("/imu", t, t, payload_of(IMU, 0)) for t in (0, 1, late, 5)]
    with open_log(write_mcap(tmp_path / "a.mcap", content)) as log:
        assert read_back(log) == content


def test_large_messages_and_empty_ones(tmp_path):
    sizes = [0, 1, 5 * 2**20, 0, 9 * 2**20, 3]
    content = [Row("/imu", k, k, bytes([k]) * n) for k, n in enumerate(sizes)]
    for shape in ({}, {"use_chunking": False}, {"compression": "none"}):
        with open_log(write_mcap(tmp_path / "a.mcap", content, **shape)) as log:
            assert read_back(log) == content


def test_a_log_without_messages(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", [])
    with open_log(path) as log:
        assert read_back(log) == []
        assert not log.channels


def test_chunks_nobody_asked_for_are_not_decompressed(tmp_path):
    content = sorted(rows(), key=lambda row: row.topic)  # chunks of one topic each, mostly
    path = write_mcap(tmp_path / "a.mcap", content)
    last = nth_chunk(path, -1)
    patched(path, last + 9 + 60, b"\xff" * 20)
    with open_log(path) as log:
        baro = [c.id for c in log.channels_of("/baro")]
        assert read_back(log, baro) == [row for row in rows() if row.topic == "/baro"]
        with pytest.raises(DamagedLogError):
            read_back(log)


# -- damage --------------------------------------------------------------------------------


def chunk_rows(path):
    """Messages of each chunk of a sound file."""
    with McapLog(path) as log:
        out = []
        for place in log.places():
            if isinstance(place, ChunkPlace):
                batch = log.chunk_batch(place)
                out.append(len(batch))
        return out


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
@pytest.mark.parametrize("what", ["crc", "data"])
def test_a_damaged_chunk_is_refused_or_passed_over(tmp_path, compression, what):
    path = write_mcap(tmp_path / "a.mcap", rows(), compression=compression)
    counts = chunk_rows(path)
    at = nth_chunk(path, 2)
    # a chunk record: start, end, size (8 each), CRC (4), compression, length, data
    patched(path, at + 9 + 24 if what == "crc" else at + 9 + 500, b"\x13\x57")
    with open_log(path) as log, pytest.raises(DamagedLogError) as caught:
        read_back(log)
    assert "--salvage" in str(caught.value)
    assert f"at byte {at}" in str(caught.value)
    with open_log(path, salvage=True) as log:
        before, missing = sum(counts[:2]), counts[2]
        result = read_back(log)
        (part,) = log.lost
        recovered = len(result) - (len(rows()) - missing)
        assert result[:before] == rows()[:before]
        assert result[before + recovered :] == rows()[before + missing :]
        if what == "crc":  # a CRC that is wrong itself: all is there, and nothing proves it
            assert result == rows()
        else:  # one place of a chunk is damaged, so at most all behind it is lost
            times = [row.log_time for row in result[before : before + recovered]]
            assert set(times) <= {row.log_time for row in rows()[before : before + missing]}
            assert times == sorted(set(times))
        assert (part.kind, part.offset, part.recovered, part.declared) == (
            "chunk",
            at,
            recovered,
            missing,
        )
        times = [row.log_time for row in rows()[before : before + missing]]
        assert (part.start_ns, part.end_ns, part.proved) == (min(times), max(times), False)
        assert f"at byte {at} to" in str(part)
        assert f"{recovered} of {missing} messages kept" in str(part)
        assert read_back(log) == result  # not taken on trust in the second pass either
        assert log.lost == [part]


@pytest.mark.parametrize("shape", ["zstd", "none", "unchunked"])
def test_a_file_cut_short_gives_what_is_whole(tmp_path, shape):
    path = write_mcap(tmp_path / "a.mcap", rows(), **SHAPES[shape])
    data = path.read_bytes()
    cut = len(data) // 2
    path.write_bytes(data[:cut])
    with pytest.raises(DamagedLogError, match=r"cut short.*--salvage"):
        open_log(path)
    with open_log(path, salvage=True) as log:
        result = read_back(log)
        assert len(stream_rows(path)) <= len(result) < len(rows())
        assert result == rows()[: len(result)]
        assert "cut short" in str(log.lost[0])
        # what follows the last message is lost, to an unknown end or to that of its chunk
        gone = rows()[len(result)].log_time
        assert any(
            part.start_ns <= gone and (part.end_ns is None or gone <= part.end_ns)
            for part in log.lost
        )


def test_zeros_behind_the_end_and_an_end_without_summary(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", rows())
    data = path.read_bytes()
    ends = [pos for op, pos, _ in mcap_records(data) if op == DATA_END]
    for damaged in (data + bytes(10_000), data[: ends[0]], data[:-9], data[: ends[0]] + bytes(99)):
        path.write_bytes(damaged)
        with open_log(path, salvage=True) as log:
            assert read_back(log) == rows()
            assert log.lost


def test_salvage_goes_on_behind_a_record_that_lies(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", rows())
    counts = chunk_rows(path)
    patched(path, nth_chunk(path, 2) + 1, struct.pack("<Q", 2**62))
    with open_log(path) as log, pytest.raises(DamagedLogError, match="declares 46116860184"):
        read_back(log)
    with open_log(path, salvage=True) as log:
        assert read_back(log) == rows()  # where the chunk ends is seen from what follows it
        (part,) = log.lost
        assert part.proved and (part.recovered, part.declared) == (counts[2], counts[2])


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
@pytest.mark.parametrize("size", [2**28 + 1, 2**40, 2**62, 2**64 - 1])
def test_sizes_that_lie_cost_no_memory(tmp_path, compression, size):
    path = write_mcap(tmp_path / "a.mcap", rows(), compression=compression)
    at = nth_chunk(path, 0)
    name = len(compression) if compression != "none" else 0
    sound = path.read_bytes()
    for field in (16, 32 + name):  # the uncompressed size; the length of the data
        path.write_bytes(sound)
        patched(path, at + 9 + field, struct.pack("<Q", size))
        with memory_below(64 * 2**20):
            with open_log(path) as log, pytest.raises(DamagedLogError):
                read_back(log)
            with open_log(path, salvage=True) as log:
                assert read_back(log) == rows()
                assert log.lost[0].proved


def test_a_zstd_frame_that_swells_is_stopped(tmp_path):
    import zstandard

    path = write_mcap(tmp_path / "a.mcap", rows(10))
    with open_log(path, salvage=True) as log:  # what the first reading imports does not count
        assert read_back(log) == rows(10)
    data = path.read_bytes()
    op, at, length = next(r for r in mcap_records(data) if r[0] == CHUNK)
    bomb = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(2**28))
    head = data[at + 9 : at + 9 + 36] + struct.pack("<Q", len(bomb))
    chunk = bytes([op]) + struct.pack("<Q", len(head) + len(bomb)) + head + bomb
    path.write_bytes(data[:at] + chunk + data[at + 9 + length :])
    with memory_below(64 * 2**20), open_log(path, salvage=True) as log:
        assert read_back(log) == []
        assert "corrupt" in str(log.lost[-1])


def test_an_unknown_compression_is_named(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", rows(), compression="lz4")
    counts = chunk_rows(path)
    at = nth_chunk(path, 0) + 9 + 32
    patched(path, at, b"xyz")
    with open_log(path) as log, pytest.raises(UnsupportedLogError, match="'xyz'"):
        read_back(log)
    with open_log(path, salvage=True) as log:  # the data say themselves what they are
        assert read_back(log) == rows()
        assert "'xyz'" in str(log.lost[0]) and log.lost[0].proved
    patched(path, at + 11, b"\xff\xff\xff\xff")
    with open_log(path, salvage=True) as log:
        assert read_back(log) == rows()[counts[0] :]
        assert (log.lost[0].recovered, log.lost[0].declared) == (0, counts[0])


def test_messages_of_an_undefined_channel_are_noted(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", rows(), use_chunking=False)
    data = path.read_bytes()
    op, at, _ = [r for r in mcap_records(data) if r[0] == 0x05][5]
    assert op == 0x05
    patched(path, at + 9, struct.pack("<H", 999))
    with open_log(path) as log:
        assert read_back(log) == rows()[:5] + rows()[6:]
        assert [str(part) for part in log.lost] == [
            "messages of channel 999, which the log does not define (0 of 1 messages kept)"
        ]


def test_other_encodings_are_listed_and_refused_only_when_asked_for(tmp_path):
    from mcap.writer import Writer

    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("Thing", "jsonschema", b"{}")
        channel = writer.register_channel("/thing", "json", schema)
        bare = writer.register_channel("/bare", "", 0)
        writer.add_message(channel, 1, b"{}", 1)
        writer.add_message(bare, 2, b"x", 2)
        writer.finish()
    with open_log(path) as log:
        assert [row.topic for row in read_back(log)] == ["/thing", "/bare"]
        with pytest.raises(UnsupportedLogError, match="topic /thing is encoded as 'json'"):
            log.channels_of("/thing")[0].definition(path)
        with pytest.raises(UnsupportedLogError, match="'unknown'"):
            log.channels_of("/bare")[0].definition(path)


@pytest.mark.parametrize(
    "content", [b"", b"\x89MC", b"hello, this is text", b"\x89MCAP1\r\n" + bytes(99)]
)
def test_what_is_no_log(tmp_path, content):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(NotALogError, match=r"a\.mcap"):
        open_log(path)


def test_magic_alone_and_header_alone(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", rows(3))
    data = path.read_bytes()
    for cut in (8, 9, 17, 20, 40):
        path.write_bytes(data[:cut])
        with pytest.raises(DamagedLogError):
            open_log(path)
        with open_log(path, salvage=True) as log:
            assert read_back(log) == []


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["zstd", "none", "unchunked"])
def test_cut_at_every_byte(tmp_path, shape):
    path = write_mcap(
        tmp_path / "a.mcap",
        rows(6),
        chunk_size=700,
        **{key: value for key, value in SHAPES[shape].items() if key != "chunk_size"},
    )
    data = path.read_bytes()
    most = 0
    for cut in range(0, len(data), 7):
        path.write_bytes(data[:cut])
        with pytest.raises(SinstoolError), open_log(path) as log:
            read_back(log)
        if cut < 8:
            continue
        with open_log(path, salvage=True) as log:
            result = read_back(log)
        assert result == rows(6)[: len(result)]
        assert len(result) >= most
        most = len(result)
    assert most == len(rows(6))


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["zstd", "lz4", "unchunked", "no summary"])
@given(seed=st.integers(0, 2**32))
@settings(max_examples=60, deadline=None)
def test_flipped_bits_give_an_error_of_ours_or_nothing(tmp_path_factory, shape, seed):
    rng = np.random.default_rng(seed)
    folder = tmp_path_factory.mktemp("flip")
    path = write_mcap(folder / "a.mcap", rows(12), chunk_size=1500, **SHAPES[shape])
    data = bytearray(path.read_bytes())
    for at in rng.integers(8, len(data), rng.integers(1, 4)):
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
@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_no_flipped_bit_of_a_file_with_crcs_goes_unseen(tmp_path, compression):
    path = write_mcap(tmp_path / "a.mcap", rows(12), chunk_size=1500, compression=compression)
    data = path.read_bytes()
    rng = np.random.default_rng(1)
    for at in range(8, len(data), 7):
        broken = bytearray(data)
        broken[at] ^= 1 << rng.integers(0, 8)
        path.write_bytes(broken)
        try:
            with open_log(path) as log:
                assert read_back(log) == rows(12) or log.lost
        except SinstoolError:
            pass
        if compression == "none":  # where one bit is one record, not more than that is lost
            with open_log(path, salvage=True) as log:
                result = read_back(log)
            assert len(result) >= len(rows(12)) - 2
            assert len([row for row in result if row not in rows(12)]) <= 1


def test_an_index_taken_for_a_message_is_counted(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", rows())
    at = next(pos for op, pos, _ in mcap_records(path.read_bytes()) if op == 0x07)
    patched(path, at, b"\x05")
    with open_log(path) as log:
        assert len(read_back(log)) == len(rows()) + 1
        assert [part.kind for part in log.lost] == ["count"]
        assert "301 messages, but the log's own count is 300" in str(log.lost[0])


@pytest.mark.parametrize(
    "name",
    [
        "imu_tools/phidgets_imu_upside_down.ros1profile.mcap",
        "px4/px4_fmuv6c_inflight_6s.mcap",
        "vehicle_gnss/yk_urban_short_turn_loop_nominal_002.mcap",
    ],
)
def test_real_logs_read_as_mcap_reads_them(name):
    path = real(name)
    with open_log(path) as log:
        assert read_back(log) == stream_rows(path)
        assert not log.lost


def test_a_message_that_memory_has_no_room_for_is_refused_by_its_size(tmp_path, monkeypatch):
    monkeypatch.setattr(compression, "available", lambda: 1000 * 2**20)
    path = tmp_path / "a.mcap"
    whole = write_mcap(tmp_path / "b.mcap", rows(3), use_chunking=False).read_bytes()
    (_, at, _) = next(r for r in mcap_records(whole) if r[0] == 5)
    size = 300 * 2**20
    path.write_bytes(whole[:at] + b"\x05" + size.to_bytes(8, "little"))
    with path.open("r+b") as stream:  # a hole takes no disk
        stream.seek(at + 9 + size)
        stream.write(b"\x0f" + (4).to_bytes(8, "little") + bytes(4))
        stream.write(b"\x02" + (20).to_bytes(8, "little") + bytes(20) + whole[:8])
    with (
        pytest.raises(
            SinstoolError,
            match="314572800 bytes, which takes 1200 MiB of memory, where 1000 MiB are",
        ),
        open_log(path) as log,
    ):
        list(log.batches())


@given(
    offsets=st.dictionaries(st.integers(0, 2**16 - 1), st.integers(0, 2**64 - 1), max_size=5),
    name=st.sampled_from(["", "zstd", "lz4", "other"]),
    start=st.integers(0, 2**64 - 1),
    cut=st.integers(0, 12),
    flipped=st.one_of(st.none(), st.tuples(st.integers(0, 200), st.integers(0, 7))),
)
@settings(max_examples=300)
def test_a_chunk_index_is_what_mcap_reads(offsets, name, start, cut, flipped):
    index = ChunkIndex(1, start, name, 2, 3, 4, offsets, 5, 6)
    builder = RecordBuilder()
    index.write(builder)
    body = bytearray(builder.end()[9:])
    if flipped and flipped[0] < len(body):
        body[flipped[0]] ^= 1 << flipped[1]
    body = bytes(body[: len(body) - cut])
    try:
        read = ChunkIndex.read(ReadDataStream(BytesIO(body)))
        expected = read.chunk_start_offset, frozenset(read.message_index_offsets)
    except Exception:  # of any kind: it cannot be read
        expected = None
    log = object.__new__(McapLog)
    log.damage = lambda *said: None
    assert log._chunk_index(body, 0) == expected


@pytest.mark.parametrize("again", ["channel", "schema"])
def test_a_number_that_is_used_again_for_another_topic_or_type_is_refused(tmp_path, again):
    """No MCAP has that, and the messages of both would be taken for those of the first."""
    path = write_mcap(tmp_path / "a.mcap", rows(30), use_chunking=False, **NO_SUMMARY)
    data = path.read_bytes()
    at = next(at for op, at, _ in mcap_records(data) if op == MESSAGE)
    first = {op: data[pos : pos + 9 + length] for op, pos, length in mcap_records(data[:at])}
    record = first[CHANNEL if again == "channel" else SCHEMA]
    # A topic or a type of the same length
    name = b"/baro" if again == "channel" else b"sensor_msgs"
    assert name in record
    other = record.replace(name, name[:-1] + b"x")
    copy = tmp_path / "b.mcap"
    copy.write_bytes(data[:at] + record + data[at:])
    with open_log(copy) as log:  # the same again is right
        assert read_back(log) == rows(30)
    copy.write_bytes(data[:at] + other + data[at:])
    with pytest.raises(DamagedLogError, match=f"{again} .* and again"):
        open_log(copy)
    with open_log(copy, salvage=True) as log:
        assert read_back(log) == rows(30)
        assert "definition" in [part.kind for part in log.lost]
