"""The bulk writer, judged by mcap's own readers and by the format's rules on offsets."""

import sqlite3
import struct
from collections import Counter
from io import BytesIO
from typing import get_args
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Chunk, MessageIndex
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap.writer import CompressionType, Writer

from sinstool.config import OutputOptions
from sinstool.io.readers import open_log
from sinstool.io.readers.batch import RawBatch
from sinstool.io.writers import mcap_chunk as module
from sinstool.io.writers.copy import Copier
from sinstool.io.writers.mcap import McapWriter
from tests.helpers.logs import COMPRESSIONS, T0, mcap_records, rows, write_db3, write_mcap

TOPICS = ("/a", "/b", "/c")


@st.composite
def parts(draw):
    """Messages of one channel: any sizes, times in any order, payloads anywhere in a buffer."""
    count = draw(st.integers(0, 30))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    length = rng.integers(0, draw(st.sampled_from([1, 40, 3000])), count)
    time = T0 + rng.integers(0, draw(st.sampled_from([2, 1000, 10**12])), count)
    gap = rng.integers(0, 5, count)
    offset = np.cumsum(length + gap) - length
    buffer = rng.integers(0, 256, int((length + gap).sum()) + 7).astype(np.uint8)
    sequence = rng.integers(0, 2**32, count)
    number = np.full(count, draw(st.integers(0, len(TOPICS) - 1)))
    return RawBatch(
        buffer, number, offset, length, time, time + rng.integers(0, 9, count), sequence
    )


def expected(calls):
    """(topic, log time, publish time, sequence, payload) of all messages."""
    listed = []
    for part in (part for call in calls for part in call):
        for k in range(len(part.channel)):
            at, length = int(part.offset[k]), int(part.length[k])
            listed.append(
                (
                    TOPICS[part.channel[k]],
                    int(part.log_time[k]),
                    int(part.publish_time[k]),
                    int(part.sequence[k]),
                    part.buffer[at : at + length].tobytes(),
                )
            )
    return listed


def written(calls, compression, chunk_size=2048, record=None):
    stream = BytesIO()
    with patch.object(module, "CHUNK_SIZE", chunk_size):
        writer = McapWriter(stream, "ros2", "test", compression)
        for number, topic in enumerate(TOPICS):
            schema = writer.add_schema("t/T", "ros2msg", b"uint8 x")
            assert schema == 1
            writer.add_channel(topic, "cdr", schema, {"key": topic}, number)
        for call in calls:
            writer.write(call)
        if record:
            writer.write_record_bytes(*record)
        writer.finish()
    return stream.getvalue()


def read(reader, **options):
    return [
        (c.topic, m.log_time, m.publish_time, m.sequence, m.data)
        for _, c, m in reader.iter_messages(**options)
    ]


@pytest.mark.slow
@settings(max_examples=60)
@given(st.lists(st.lists(parts(), max_size=4), max_size=4), st.sampled_from(sorted(COMPRESSIONS)))
def test_all_messages_come_back(calls, compression):
    data = written(calls, compression)
    target = expected(calls)
    by_index = read(make_reader(BytesIO(data), validate_crcs=True))
    assert Counter(by_index) == Counter(target)
    assert [m[1] for m in by_index] == sorted(m[1] for m in target)
    in_file = read(NonSeekingReader(BytesIO(data), validate_crcs=True), log_time_order=False)
    assert Counter(in_file) == Counter(target)
    for call in calls:
        # within a call the file is in order of time, and equal times keep the order given
        own = [m for m in in_file if m in set(expected([call]))]
        if len(calls) == 1:
            assert own == sorted(expected([call]), key=lambda m: m[1])
    summary = make_reader(BytesIO(data)).get_summary()
    assert summary.statistics.message_count == len(target)
    times = [m[1] for m in target] or [0]
    assert summary.statistics.message_start_time == min(times)
    assert summary.statistics.message_end_time == max(times)
    assert {c.topic: c.metadata for c in summary.channels.values()} == {
        topic: {"key": topic} for topic in TOPICS
    }


@settings(max_examples=60)
@given(st.lists(st.lists(parts(), max_size=4), max_size=3), st.sampled_from(sorted(COMPRESSIONS)))
def test_every_offset_points_where_it_says(calls, compression):
    data = written(calls, compression)
    records = mcap_records(data)
    place = {at: (op, length) for op, at, length in records}
    summary = make_reader(BytesIO(data)).get_summary()
    chunks = [at for op, at, _ in records if op == Opcode.CHUNK]
    assert [index.chunk_start_offset for index in summary.chunk_indexes] == chunks
    for index in summary.chunk_indexes:
        start, length = index.chunk_start_offset, index.chunk_length
        assert place[start] == (Opcode.CHUNK, length - 9)
        chunk = Chunk.read(stream_of(data, start))
        content, _ = get_chunk_data_stream(chunk, validate_crc=True)
        body = content.read(chunk.uncompressed_size)
        assert len(body) == index.uncompressed_size == chunk.uncompressed_size
        assert len(chunk.data) == index.compressed_size
        assert index.compression == chunk.compression == compression.replace("none", "")
        assert chunk.uncompressed_crc
        times, seen = [], []
        for number, at in index.message_index_offsets.items():
            assert place[at][0] == Opcode.MESSAGE_INDEX
            entries = MessageIndex.read(stream_of(data, at))
            assert entries.channel_id == number
            assert entries.records
            for time, offset in entries.records:
                # opcode, length, channel, sequence, log time of a message record
                op, size, channel, _, log_time = struct.unpack_from("<BQHIQ", body, offset)
                assert (op, channel, log_time) == (Opcode.MESSAGE, number, time)
                times.append(time)
                seen.append((offset, offset + 9 + size))
        seen.sort()
        assert [a for a, _ in seen] == [0, *(b for _, b in seen[:-1])]
        assert seen[-1][1] == len(body)
        assert (index.message_start_time, index.message_end_time) == (min(times), max(times))
        assert (chunk.message_start_time, chunk.message_end_time) == (min(times), max(times))
        ends = [at + 9 + place[at][1] for at in index.message_index_offsets.values()]
        assert index.message_index_length == max(ends) - start - length
    check_summary_offsets(data, place)


def stream_of(data, at):
    """A record's body, as mcap's classes read it."""
    return ReadDataStream(BytesIO(data[at + 9 :]))


def check_summary_offsets(data, place):
    start, offsets, _ = struct.unpack("<QQI", data[-28:-8])
    assert place[start][0] == Opcode.SCHEMA
    covered = start
    for at, (op, _) in place.items():
        if op != Opcode.SUMMARY_OFFSET:
            continue
        assert at >= offsets
        group, begin, length = struct.unpack_from("<BQQ", data, at + 9)
        assert begin == covered
        inside = [p for p in place if begin <= p < begin + length]
        assert inside
        assert {place[p][0] for p in inside} == {group}
        covered = begin + length
    assert covered == offsets


@pytest.mark.parametrize("size", [0, 1, module.CHUNK_SIZE, 3 * module.CHUNK_SIZE])
def test_messages_around_the_size_of_a_chunk(size):
    payload = np.arange(2 * size, dtype=np.uint64).astype(np.uint8).reshape(2, size)
    part = RawBatch.from_rows(1, payload, np.array([T0, T0 + 1]), np.arange(2))
    data = written([[part]], "zstd", module.CHUNK_SIZE)
    result = read(make_reader(BytesIO(data), validate_crcs=True))
    assert [m[4] for m in result] == [row.tobytes() for row in payload]


def test_chunks_are_of_the_size_asked_for():
    payload = np.zeros((20_000, 324), np.uint8)
    time = T0 + np.arange(20_000)
    data = written([[RawBatch.from_rows(0, payload, time, time - T0)]], "none", 2**20)
    sizes = [c.uncompressed_size for c in make_reader(BytesIO(data)).get_summary().chunk_indexes]
    assert sum(sizes) == 20_000 * 355
    assert all(2**20 - 355 < size <= 2**20 for size in sizes[:-1])


def test_nothing_written_is_a_whole_file():
    data = written([[]], "zstd")
    assert not [op for op, _, _ in mcap_records(data) if op == Opcode.CHUNK]
    assert read(make_reader(BytesIO(data), validate_crcs=True)) == []


def test_ids_are_found_where_the_largest_is_taken():
    writer = McapWriter(BytesIO(), "ros2", "test")
    assert writer.add_schema("a/A", "ros2msg", b"", 65535) == 65535
    assert writer.add_schema("b/B", "ros2msg", b"") == 1
    assert writer.add_channel("/a", "cdr", 1, {}, 65535) == 65535
    assert writer.add_channel("/b", "cdr", 1, {}) == 1
    assert writer.add_channel("/c", "cdr", 1, {}) == 2
    writer.finish()


def test_what_fails_in_a_thread_is_raised():
    class Full(BytesIO):
        def write(self, data):
            if self.tell() > 1000:
                raise OSError(28, "No space left on device")
            return super().write(data)

    writer = McapWriter(Full(), "ros2", "test", "none")
    writer.add_channel("/a", "cdr", writer.add_schema("t/T", "ros2msg", b"uint8 x"), {})
    payload = np.zeros((10, 1000), np.uint8)
    times = np.arange(10)
    with pytest.raises(OSError, match="No space"):
        for _ in range(3):
            writer.write([RawBatch.from_rows(1, payload, times, times)])
        writer.finish()
    writer.abort()


def test_messages_that_cannot_be_made_are_no_silent_loss():
    def make():
        raise ZeroDivisionError

    writer = McapWriter(BytesIO(), "ros2", "test")
    with pytest.raises(ZeroDivisionError):
        writer.write_made(make, 100)
        writer.finish()
    writer.abort()


# -- the copy of a log -------------------------------------------------------------------------


def with_extras(path, compression):
    """A log with metadata before, between and after its messages, and two attachments."""
    with path.open("wb") as stream:
        writer = Writer(stream, 4096, COMPRESSIONS[compression])
        writer.start("ros2", "somebody")
        schema = writer.register_schema("t/T", "ros2msg", b"uint8 x")
        channel = writer.register_channel("/a", "cdr", schema, {"offered_qos_profiles": ""})
        writer.add_metadata("first", {"a": "1"})
        for k in range(500):
            writer.add_message(channel, T0 + k, bytes([k % 256]) * 50, T0 + k - 5, k)
            if k == 250:
                writer.add_metadata("calibration", {"gyro": "1 2 3", "größe": "ü"})
                writer.add_attachment(T0, T0 + 1, "photo.jpg", "image/jpeg", bytes(range(256)) * 9)
        writer.add_attachment(T0 + 2, 0, "", "", b"")
        writer.finish()
    return path


def copied(path, compression="zstd"):
    stream = BytesIO()
    with open_log(path) as log:
        writer = McapWriter(stream, "ros2", "test", compression)
        Copier(log, writer).finish()
        writer.finish()
    return stream.getvalue()


@pytest.mark.parametrize("compression", sorted(COMPRESSIONS))
def test_metadata_and_attachments_are_copied_and_indexed(tmp_path, compression):
    path = with_extras(tmp_path / "a.mcap", compression)
    data = copied(path)
    for method in ("iter_metadata", "iter_attachments"):
        with path.open("rb") as stream:
            before = list(getattr(make_reader(stream), method)())
        assert list(getattr(make_reader(BytesIO(data)), method)()) == before
    with path.open("rb") as stream:
        before = make_reader(stream).get_summary()
        after = make_reader(BytesIO(data)).get_summary()
    assert after.statistics == before.statistics
    assert after.schemas == before.schemas
    assert after.channels == before.channels
    for kind in ("attachment_indexes", "metadata_indexes"):
        for old, new in zip(getattr(before, kind), getattr(after, kind), strict=True):
            assert (
                data[new.offset : new.offset + new.length]
                == (path.read_bytes()[old.offset : old.offset + old.length])
            )
            assert {**vars(new), "offset": 0} == {**vars(old), "offset": 0}
    headers = [op for op, _, _ in mcap_records(data) if op == Opcode.HEADER]
    assert len(headers) == 1


@pytest.mark.parametrize("chunk", [1, 300, 2**20])
def test_a_log_is_copied_whatever_its_chunks(tmp_path, chunk):
    path = write_mcap(tmp_path / "a.mcap", rows(), chunk_size=chunk)
    result = make_reader(BytesIO(copied(path)), validate_crcs=True).iter_messages()
    there = [(c.topic, m.log_time, m.publish_time, m.data) for _, c, m in result]
    assert Counter(there) == Counter(tuple(row) for row in rows())


def test_a_damaged_message_index_is_made_anew(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", rows(), compression="none")
    data = bytearray(path.read_bytes())
    at = next(at for op, at, _ in mcap_records(bytes(data)) if op == Opcode.MESSAGE_INDEX)
    data[at + 9 : at + 11] = struct.pack("<H", 999)
    path.write_bytes(data)
    result = copied(path)
    actual = read(make_reader(BytesIO(result), validate_crcs=True))
    assert Counter((m[0], m[1], m[2], m[4]) for m in actual) == Counter(tuple(r) for r in rows())
    for record in StreamReader(BytesIO(result), emit_chunks=True).records:
        if isinstance(record, MessageIndex):
            assert record.channel_id != 999


def test_topics_of_a_bag_keep_apart_whatever_their_ids(tmp_path):
    path = write_db3(tmp_path / "a.db3", rows(), 4)
    database = sqlite3.connect(path)
    for table, column in (("topics", "id"), ("messages", "topic_id")):
        database.execute(f"UPDATE {table} SET {column} = {column} + 70000 * ({column} - 1)")
    database.commit()
    database.close()
    result = read(make_reader(BytesIO(copied(path)), validate_crcs=True))
    assert Counter((m[0], m[1], m[4]) for m in result) == Counter(
        (r.topic, r.log_time, r.payload) for r in rows()
    )


def test_compressions_of_the_test_are_all():
    options = get_args(OutputOptions.model_fields["compression"].annotation)
    assert set(COMPRESSIONS) == set(options)
    assert {c.name.lower() for c in CompressionType} == set(COMPRESSIONS)
