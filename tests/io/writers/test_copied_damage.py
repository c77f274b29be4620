"""What is copied from a log whose records contradict themselves: all that is sound, and no more."""

import bz2
import random
import sqlite3
import struct
from collections import Counter
from io import BytesIO

import pytest
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import Writer

from sinstool.core.errors import DamagedLogError, SinstoolError
from sinstool.io.readers import open_log
from sinstool.io.writers.copy import Copier
from sinstool.io.writers.mcap import McapWriter
from tests.helpers.logs import COMPRESSIONS, T0, mcap_records, patched, rows, write_db3, write_mcap

PHOTO = bytes(range(256)) * 9


def with_extras(path, compression="zstd", of_file=False):
    """A log of 300 messages with one Metadata record and two attachments."""
    with path.open("wb") as stream:
        writer = Writer(stream, 4096, COMPRESSIONS[compression])
        writer.start("ros2", "somebody")
        channels = [
            writer.register_channel(
                f"/{n}", "cdr", writer.register_schema(f"t/{n}", "ros2msg", b"x")
            )
            for n in "ab"
        ]
        writer.add_metadata("calibration", {"gyro": "1 2 3", "größe": "ü"})
        for k in range(300):
            writer.add_message(channels[k % 3 == 0], T0 + k, bytes([k % 256]) * 50, T0 + k, k)
        writer.add_attachment(T0, T0 + 1, "photo.jpg", "image/jpeg", PHOTO)
        writer.add_attachment(T0 + 2, 0, "notes.txt", "text/plain", b"whole")
        if of_file:
            writer.add_metadata("rosbag2", {"serialized_metadata": "message_count: 300"})
        writer.finish()
    return path


def copied(path, salvage=False):
    """The copy, what was lost, and what was found."""
    stream = BytesIO()
    with open_log(path, salvage) as log:
        writer = McapWriter(stream, "ros2", "test")
        try:
            copier = Copier(log, writer)
            copier.finish()
            writer.finish()
        except BaseException:
            writer.abort()
            raise
        return stream.getvalue(), [part.kind for part in log.lost], copier.findings


def messages(data, reader=make_reader):
    return [
        (c.topic, m.log_time, m.data)
        for _, c, m in reader(BytesIO(data), validate_crcs=True).iter_messages()
    ]


def place_of(path, opcode):
    data = path.read_bytes()
    return next(at for op, at, _ in mcap_records(data) if op == opcode) + 9


# Bytes of a record to overwrite: where behind its head, with what
DAMAGED_EXTRAS = {
    "metadata: length of a text": (Opcode.METADATA, 3, b"\x80"),
    "metadata: UTF-8": (Opcode.METADATA, 6, b"\xff"),
    "metadata: length of the map": (Opcode.METADATA, 15, b"\x01"),
    "metadata: UTF-8 of a value": (Opcode.METADATA, 40, b"\xff"),
    "attachment: length of the name": (Opcode.ATTACHMENT, 19, b"\x80"),
    "attachment: UTF-8 of the name": (Opcode.ATTACHMENT, 20, b"\xff"),
    "attachment: size of the data": (Opcode.ATTACHMENT, 50, b"\x01"),
    "attachment: a bit of the data": (Opcode.ATTACHMENT, 1000, b"\xaa"),
}


@pytest.mark.parametrize("case", DAMAGED_EXTRAS)
def test_damaged_extras_are_refused_or_left_out_and_said(tmp_path, case):
    opcode, offset, new = DAMAGED_EXTRAS[case]
    path = with_extras(tmp_path / "a.mcap")
    before = messages(path.read_bytes())
    patched(path, place_of(path, opcode) + offset, new)
    with pytest.raises(DamagedLogError, match="salvage"):
        copied(path)
    data, lost, _ = copied(path, salvage=True)
    assert lost == ["metadata" if opcode == Opcode.METADATA else "attachment"]
    assert messages(data) == before
    reader = make_reader(BytesIO(data))
    attached = {a.name: a.data for a in reader.iter_attachments()}
    described = [m.name for m in reader.iter_metadata()]
    if opcode == Opcode.METADATA:
        assert attached == {"photo.jpg": PHOTO, "notes.txt": b"whole"}
        assert described == []
    else:
        assert attached == {"notes.txt": b"whole"}
        assert described == ["calibration"]


def test_records_with_fields_of_later_versions_are_copied_whole(tmp_path):
    path = with_extras(tmp_path / "a.mcap")
    data = path.read_bytes()
    longer = b""
    for op, at, length in mcap_records(data):
        more = b"later" if op in (Opcode.METADATA, Opcode.ATTACHMENT) else b""
        if op == Opcode.DATA_END:
            break
        longer += struct.pack("<BQ", op, length + len(more))
        longer += data[at + 9 : at + 9 + length] + more
    end = struct.pack("<BQI", Opcode.DATA_END, 4, 0)
    end += struct.pack("<BQQQI", Opcode.FOOTER, 20, 0, 0, 0)
    path.write_bytes(data[:8] + longer + end + data[:8])
    result, lost, _ = copied(path)
    assert not lost
    assert result.count(b"later") == 3
    assert [a.name for a in make_reader(BytesIO(result)).iter_attachments()] == [
        "photo.jpg",
        "notes.txt",
    ]


@pytest.mark.parametrize("damaged", [False, True])
def test_what_the_files_of_a_bag_hold_beside_messages_is_copied_or_said(tmp_path, damaged):
    folder = tmp_path / "bag"
    folder.mkdir()
    for name in ("bag_0.mcap", "bag_1.mcap"):
        path = with_extras(folder / name, of_file=True)
    before = 2 * messages(path.read_bytes())
    if damaged:
        patched(path, place_of(path, Opcode.ATTACHMENT) + 1000, b"\xaa")
        with pytest.raises(DamagedLogError, match="salvage"):
            copied(folder)
    data, lost, _ = copied(folder, salvage=damaged)
    assert lost == ["attachment"] * damaged
    assert Counter(messages(data)) == Counter(before)
    reader = make_reader(BytesIO(data))
    attached = Counter(a.name for a in reader.iter_attachments())
    assert attached == {"photo.jpg": 2 - damaged, "notes.txt": 2}
    # one describes the recording, the other the file that it was in
    assert [m.name for m in reader.iter_metadata()] == ["calibration", "calibration"]


def test_a_channel_without_its_schema_keeps_its_messages(tmp_path):
    path = with_extras(tmp_path / "a.mcap", "none")
    data = bytearray(path.read_bytes())
    before = messages(bytes(data))
    # The second channel, in its chunk and in the summary, points to a schema that is not there.
    at = 0
    while (at := data.find(struct.pack("<HHI2s", 2, 2, 2, b"/b"), at)) >= 0:
        data[at + 2] = 9
        at += 1
    path.write_bytes(without_crcs(bytes(data)))
    with pytest.raises(DamagedLogError, match=r"topic /b.*schema 9.*salvage"):
        copied(path)
    result, lost, _ = copied(path, salvage=True)
    assert lost == ["definition"]
    assert messages(result) == before
    assert [c.schema_id for c in make_reader(BytesIO(result)).get_summary().channels.values()] == [
        1,
        0,
    ]


def without_crcs(data):
    """The same file, whose chunks and summary say nothing of their CRC."""
    out = bytearray(data)
    for op, at, _ in mcap_records(data):
        if op == Opcode.CHUNK:
            out[at + 33 : at + 37] = bytes(4)
        if op == Opcode.FOOTER:
            out[at + 25 : at + 29] = bytes(4)
    return bytes(out)


def with_compression(path, name, pack):
    """Give every chunk of an uncompressed file another compression, in name and content."""
    data = path.read_bytes()
    out = data[:8]
    for op, at, length in mcap_records(data):
        body = data[at + 9 : at + 9 + length]
        if op == Opcode.DATA_END:
            break
        if op == Opcode.MESSAGE_INDEX:
            continue
        if op == Opcode.CHUNK:
            (name_length,) = struct.unpack_from("<I", body, 28)
            content = pack(body[40 + name_length :])
            body = body[:28] + struct.pack(f"<I{len(name)}sQ", len(name), name, len(content))
            body += content
        out += struct.pack("<BQ", op, len(body)) + body
    out += struct.pack("<BQI", Opcode.DATA_END, 4, 0)
    out += struct.pack("<BQQQI", Opcode.FOOTER, 20, 0, 0, 0) + data[:8]
    path.write_bytes(out)
    return path


def test_chunks_of_a_compression_that_is_none_of_the_format_are_written_anew(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", rows(), compression="none")
    before = messages(path.read_bytes())
    with_compression(path, b"bz2", bz2.compress)
    data, lost, _ = copied(path)
    assert not lost
    assert Counter(messages(data)) == Counter(before)
    used = {c.compression for c in make_reader(BytesIO(data)).get_summary().chunk_indexes}
    assert used == {"zstd"}


@pytest.mark.parametrize("name", [b"bz2", b"zstd", b"snappy"])
def test_chunks_that_only_claim_to_be_compressed_are_read_where_their_crc_proves_them(
    tmp_path, name
):
    path = write_mcap(tmp_path / "a.mcap", rows(), compression="none")
    before = messages(path.read_bytes())
    with_compression(path, name, bytes)
    with pytest.raises(SinstoolError):
        copied(path)
    data, lost, _ = copied(path, salvage=True)
    assert set(lost) == {"chunk"}
    assert Counter(messages(data)) == Counter(before)


@pytest.mark.parametrize("start", [2**63, 2**64 - 1])
def test_a_chunk_that_begins_at_no_time_keeps_back_nothing(tmp_path, start):
    """As of a writer that searched the earliest message of a chunk without messages."""
    path = with_extras(tmp_path / "a.mcap")
    data = path.read_bytes()
    before = messages(data)
    chunks = [at for op, at, _ in mcap_records(data) if op == Opcode.CHUNK]
    assert len(chunks) > 2
    patched(path, chunks[1] + 9, struct.pack("<Q", start))
    data, lost, _ = copied(path)
    assert sorted(messages(data)) == sorted(before) and not lost


@pytest.mark.parametrize("spelling", ["my_msgs/msg/Foo", "my_msgs/Foo", "Foo", "a/b/c/d", "/", ""])
def test_a_type_whose_definition_is_nowhere_is_copied_and_said(tmp_path, spelling):
    path = write_db3(tmp_path / "a.db3", rows(), 3)
    with sqlite3.connect(path) as database:
        database.execute("UPDATE topics SET type = ? WHERE name = '/baro'", (spelling,))
    database.close()
    data, lost, findings = copied(path)
    assert not lost
    assert [(f.kind, f.topic) for f in findings] == [("no-definition", "/baro")]
    assert Counter(messages(data)) == Counter((r.topic, r.log_time, r.payload) for r in rows())
    schemas = {s.name: s.data for s in make_reader(BytesIO(data)).get_summary().schemas.values()}
    assert schemas[spelling] == b""
    assert len(schemas["sensor_msgs/msg/Imu"]) > 100


def test_messages_of_another_serialisation_without_a_definition_are_copied_and_said(tmp_path):
    path = write_db3(tmp_path / "a.db3", rows(), 3)
    with sqlite3.connect(path) as database:
        database.execute("UPDATE topics SET serialization_format = 'protobuf' WHERE name = '/baro'")
        database.execute("DROP TABLE IF EXISTS message_definitions")
    database.close()
    data, lost, findings = copied(path)
    assert not lost
    assert [(f.kind, f.topic) for f in findings] == [("no-definition", "/baro")]
    assert "encoded as 'protobuf'" in findings[0].text
    assert Counter(messages(data)) == Counter((r.topic, r.log_time, r.payload) for r in rows())
    summary = make_reader(BytesIO(data)).get_summary()
    (baro,) = [c for c in summary.channels.values() if c.topic == "/baro"]
    schema = summary.schemas[baro.schema_id]
    assert (baro.message_encoding, schema.encoding, schema.data) == ("protobuf", "", b"")


@pytest.mark.slow
def test_a_copy_of_damage_is_always_a_sound_file(tmp_path):
    """Flipped bits: refused, or a file in which readers, index and statistics agree."""
    source = with_extras(tmp_path / "a.mcap", "none").read_bytes()
    source = without_crcs(source)
    random_ = random.Random(7)
    path = tmp_path / "b.mcap"
    survived = 0
    for _ in range(250):
        damaged = bytearray(source)
        for _ in range(random_.choice([1, 1, 2, 8])):
            at = random_.randrange(8, len(damaged) - 8)
            damaged[at] ^= 1 << random_.randrange(8)
        path.write_bytes(damaged)
        for salvage in (False, True):
            try:
                data, _, _ = copied(path, salvage)
            except SinstoolError:
                continue
            survived += 1
            summary = make_reader(BytesIO(data)).get_summary()
            by_index = messages(data)
            assert Counter(by_index) == Counter(messages(data, NonSeekingReader))
            assert summary.statistics.message_count == len(by_index)
            assert list(make_reader(BytesIO(data)).iter_metadata()) is not None
            for attachment in make_reader(BytesIO(data)).iter_attachments():
                assert attachment.data is not None
    assert survived > 250
