"""Damaged and odd logs of 2000 messages each, and what there is to be had of them.

Each case writes one log and says how many messages the best of the usual readers gets out of it
(mcap's two, rosbags), as far as that is not the number that the intact part holds.
"""

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import zstandard
from mcap.writer import IndexType, Writer

from tests.helpers.logs import (
    IMU,
    bag_records,
    content,
    definition,
    mcap_records,
    patched,
    payload_of,
    rows,
    stream_rows,
    unindexed,
    write_bag1,
    write_db3,
    write_mcap,
)

COUNT = 2000
CHUNK, MESSAGE_INDEX, DATA_END, STATISTICS = 0x06, 0x07, 0x0F, 0x0B
NO_SUMMARY = {
    "index_types": IndexType.NONE,
    "repeat_channels": False,
    "repeat_schemas": False,
    "use_statistics": False,
    "use_summary_offsets": False,
}
ONE_CHUNK = {"chunk_size": 2**24}


@dataclass(frozen=True)
class Case:
    """A damaged log.

    Attributes
    ----------
    name : str
    make : callable
        Writes it into a folder and returns its path.
    best : int or callable
        Messages that the best of the usual readers gets, or how to find out.
    strict : str
        What the error says without --salvage ('' for no error).
    """

    name: str
    make: Callable[[Path], Path]
    best: int | Callable[[Path], int]
    strict: str = ""

    def at_least(self, path: Path) -> int:
        """Messages that have to come out of it."""
        return self.best if isinstance(self.best, int) else self.best(path)


CASES: list[Case] = []


def case(name: str, best: int | Callable[[Path], int] = COUNT, strict: str = ""):
    """Register a case; the function gets the path to write to."""

    def add(make):
        suffix = ".db3" if "db3" in name else ".bag" if "bag" in name else ".mcap"
        CASES.append(Case(name, lambda folder: make(folder / f"log{suffix}"), best, strict))
        return make

    return add


def streamed(path: Path) -> int:
    return len(stream_rows(path))


def good(path: Path, **options) -> Path:
    return write_mcap(path, rows(1500), **({"chunk_size": 65536} | options))


def chunks(path: Path) -> list[int]:
    return [pos for op, pos, _ in mcap_records(path.read_bytes()) if op == CHUNK]


def cut(path: Path, at: int | float) -> Path:
    data = path.read_bytes()
    path.write_bytes(data[: at if isinstance(at, int) else int(at * len(data))])
    return path


def flipped(path: Path, at: int) -> Path:
    return patched(path, at, bytes([path.read_bytes()[at] ^ 0x10]))


def ends(path: Path) -> int:
    return next(pos for op, pos, _ in mcap_records(path.read_bytes()) if op == DATA_END)


# -- what is hardly a log --------------------------------------------------------------------------


@case("0 bytes", 0, "empty")
def _(path):
    path.write_bytes(b"")
    return path


@case("3 bytes", 0, "not a log")
def _(path):
    path.write_bytes(b"\x89MC")
    return path


@case("text file", 0, "not a log")
def _(path):
    path.write_text("time,x,y,z\n1,2,3,4\n" * 100)
    return path


@case("magic only", 0, "cut short")
def _(path):
    return cut(good(path), 8)


@case("header only", 0, "cut short")
def _(path):
    return cut(good(path), 8 + 9 + mcap_records(good(path).read_bytes())[0][2])


# -- cut short -------------------------------------------------------------------------------------


@case("cut in a chunk", streamed, "cut short")
def _(path):
    return cut(good(path), 0.55)


@case("cut between chunks", streamed, "cut short")
def _(path):
    return cut(good(path), chunks(good(path))[7])


@case("cut in the summary", COUNT, "cut short")
def _(path):
    return cut(good(path), ends(good(path)) + 40)


@case("no end magic", COUNT, "cut short")
def _(path):
    return cut(good(path), len(good(path).read_bytes()) - 8)


@case("trailing zeros", COUNT, "cut short")
def _(path):
    data = good(path).read_bytes()
    path.write_bytes(data[: ends(path)] + bytes(2**20))
    return path


@case("unchunked, cut", streamed, "cut short")
def _(path):
    return cut(good(path, use_chunking=False), 0.6)


def cut_chunk(compression, share):
    """One chunk of 1 MiB, cut inside: what the usual readers get of it is nothing."""

    def make(path):
        write_mcap(path, rows(1500)[:2000], compression=compression, **ONE_CHUNK)
        (at,) = chunks(path)
        head = 9 + 40 + len(compression)
        (length,) = struct.unpack_from("<Q", path.read_bytes(), at + head - 8)
        return cut(path, at + head + int(share * length))

    return make


# zstd gives blocks of 128 KiB, LZ4 of 64 KiB: so many messages are before the last whole one
for _name, _share, _least in (
    ("zstd", 0.25, 200),
    ("zstd", 0.5, 650),
    ("zstd", 0.75, 1000),
    ("zstd", 0.95, 1500),
    ("lz4", 0.25, 350),
    ("lz4", 0.5, 850),
    ("lz4", 0.95, 1650),
):
    case(f"chunk of {_name} cut at {_share:.0%}", _least, "cut short")(cut_chunk(_name, _share))


# -- indexes that are missing ----------------------------------------------------------------------


@case("no summary at all")
def _(path):
    return good(path, **NO_SUMMARY)


@case("no message index")
def _(path):
    return good(path, index_types=IndexType.CHUNK)


@case("channels and schemas not repeated")
def _(path):
    return good(path, repeat_channels=False, repeat_schemas=False)


# -- damage ----------------------------------------------------------------------------------------


@case("bad chunk CRC", COUNT, "CRC does not match")
def _(path):
    return flipped(good(path), chunks(good(path))[3] + 9 + 24)


@case("bit flip in zstd data", streamed, "chunk")
def _(path):
    return flipped(good(path), chunks(good(path))[3] + 9 + 44 + 20_000)


@case("bit flip in a payload", COUNT, "CRC does not match")
def _(path):
    return flipped(good(path, compression="none"), chunks(good(path, compression="none"))[3] + 300)


@case("bit flip in lz4 data", streamed, "chunk")
def _(path):
    good(path, compression="lz4")
    return flipped(path, chunks(path)[3] + 9 + 43 + 5)


@case("bit flip in a record length", 1819, "chunk")
def _(path):
    good(path, compression="none")
    at = path.read_bytes().index(payload_of(IMU, 700)) - 30
    return patched(path, at + 1, bytes([path.read_bytes()[at + 1] ^ 0x40]))


def claim(compression, value):
    def make(path):
        good(path, compression=compression)
        return patched(path, chunks(path)[3] + 9 + 16, struct.pack("<Q", value))

    return make


case("uncompressed size 2^40, zstd", COUNT, "declares 1099511627776")(claim("zstd", 2**40))
case("uncompressed size 2^40, lz4", COUNT, "declares 1099511627776")(claim("lz4", 2**40))
case("uncompressed size 2^40, none", COUNT, "declares 1099511627776")(claim("none", 2**40))


@case("record length 2^62", COUNT, "declares 46116860184")
def _(path):
    return patched(good(path), chunks(good(path))[3] + 1, struct.pack("<Q", 2**62))


@case("record length 2^62, no summary", COUNT, "declares 46116860184")
def _(path):
    good(path, **NO_SUMMARY)
    return patched(path, chunks(path)[3] + 1, struct.pack("<Q", 2**62))


def with_record(path, record, before):
    data = path.read_bytes()
    path.write_bytes(data[:before] + record + data[before:])
    return path


@case("zstd bomb of 1 GiB", COUNT, "declares 1073741824")
def _(path):
    good(path, **NO_SUMMARY)
    packer = zstandard.ZstdCompressor(write_content_size=False).compressobj()
    bomb = b"".join(packer.compress(bytes(2**24)) for _ in range(64)) + packer.flush()
    head = struct.pack("<QQQI", 1, 2, 2**30, 0) + struct.pack("<I", 4) + b"zstd"
    body = head + struct.pack("<Q", len(bomb)) + bomb
    return with_record(path, bytes([CHUNK]) + struct.pack("<Q", len(body)) + body, chunks(path)[3])


@case("unknown opcode at top level")
def _(path):
    good(path, **NO_SUMMARY)
    return with_record(path, b"\x7b" + struct.pack("<Q", 30) + bytes(30), chunks(path)[3])


def remade(path, change):
    """The file with its fourth chunk's content changed, and its CRC right again."""
    good(path, compression="none", **NO_SUMMARY)
    data = path.read_bytes()
    at = chunks(path)[3]
    (length,) = struct.unpack_from("<Q", data, at + 1)
    body = change(data[at + 49 : at + 9 + length])
    head = data[at + 9 : at + 25] + struct.pack("<QI", len(body), zlib.crc32(body))
    record = head + bytes(4) + struct.pack("<Q", len(body)) + body
    record = bytes([CHUNK]) + struct.pack("<Q", len(record)) + record
    path.write_bytes(data[:at] + record + data[at + 9 + length :])
    return path


@case("unknown opcode in a chunk")
def _(path):
    return remade(path, lambda body: b"\x7b" + struct.pack("<Q", 30) + bytes(30) + body)


@case("unknown compression", lambda path: streamed(path), "'zip'")
def _(path):
    good(path, compression="lz4")
    at = chunks(path)[3] + 9 + 32
    return patched(patched(path, at, b"zip"), at + 11, b"PK\3\4")


@case("message of an unknown channel", COUNT - 1)
def _(path):
    at = good(path, use_chunking=False).read_bytes().index(payload_of(IMU, 0)) - 22
    return patched(path, at, struct.pack("<H", 999))


@case("messages out of order")
def _(path):
    return write_mcap(path, rows(1500)[::-1], chunk_size=65536)


@case("overlapping chunks")
def _(path):
    mixed = [row for k in range(7) for row in rows(1500)[k::7]]
    return write_mcap(path, mixed, chunk_size=65536)


@case("two channels on a topic")
def _(path):
    return good(path, channels={"/imu": 2})


def one_payload(change):
    def make(path):
        mixed = list(rows(1500))
        mixed[1000] = mixed[1000]._replace(payload=change(mixed[1000].payload))
        return write_mcap(path, mixed, chunk_size=65536)

    return make


case("a payload cut short")(one_payload(lambda payload: payload[:50]))
case("an empty payload")(one_payload(lambda payload: b""))
case("a payload in XCDR2")(one_payload(lambda payload: b"\x00\x07" + payload[2:]))


@case("big-endian payloads")
def _(path):
    from tests.helpers.logs import store

    swapped = [
        row._replace(payload=bytes(store(2).serialize_cdr(message, IMU, little_endian=False)))
        for row in rows(1500)
        if row.topic == "/imu"
        for message in [store(2).deserialize_cdr(row.payload, IMU)]
    ]
    again = [swapped[k % len(swapped)]._replace(log_time=k, publish_time=k) for k in range(COUNT)]
    return write_mcap(path, again, chunk_size=65536)


def index_claim(field, value):
    def make(path):
        data = good(path).read_bytes()
        at = next(pos for op, pos, _ in mcap_records(data) if op == MESSAGE_INDEX)
        return patched(path, at + 9 + 6 + 8 * field, struct.pack("<Q", value))

    return make


case("message index offset wrong")(index_claim(1, 12345))
case("message index offset 2^50")(index_claim(1, 2**50))


@case("statistics of 2^50 messages")
def _(path):
    data = good(path, enable_crcs=False).read_bytes()
    at = next(pos for op, pos, _ in mcap_records(data) if op == STATISTICS)
    patched(path, at + 9, struct.pack("<Q", 2**50))
    return patched(path, at + 9 + 46 + 2, struct.pack("<Q", 2**50))


# -- encodings -------------------------------------------------------------------------------------


def encoded(message_encoding, schema_encoding, text, profile="ros2", name=IMU):
    def make(path):
        with path.open("wb") as stream:
            writer = Writer(stream, chunk_size=65536)
            writer.start(profile=profile)
            schema = 0
            if schema_encoding is not None:
                schema = writer.register_schema(name, schema_encoding, text.encode())
            channel = writer.register_channel("/imu", message_encoding, schema)
            imu = [row for row in rows(1500) if row.topic == "/imu"]
            for k in range(COUNT):
                writer.add_message(channel, k, imu[k % len(imu)].payload, k)
            writer.finish()
        return path

    return make


MSG = definition(IMU)[0]
case("schema encoding jsonschema")(encoded("json", "jsonschema", "{}"))
case("schema encoding protobuf")(encoded("protobuf", "protobuf", "\n\5hello"))
case("ROS 1 definition, CDR messages")(encoded("cdr", "ros1msg", MSG))
case("no profile")(encoded("cdr", "ros2msg", MSG, profile=""))
case("no schema")(encoded("cdr", None, ""))
case("empty schema text")(encoded("cdr", "ros2msg", ""))


# -- ROS 1 bags ------------------------------------------------------------------------------------


def good_bag(path, compression=None):
    path.unlink(missing_ok=True)
    return write_bag1(path, content(1500, 1), compression, 65536)


@case("bag without an index")
def _(path):
    return unindexed(good_bag(path))


@case("bag cut in a chunk", 1000, "cut short")
def _(path):
    return cut(good_bag(path), 0.6)


@case("bag of lz4, cut", 1000, "cut short")
def _(path):
    return cut(good_bag(path, "lz4"), 0.6)


@case("bag.active: an open chunk", COUNT, "--salvage")
def _(path):
    # the recorder writes the size of a chunk when it closes it
    data = unindexed(good_bag(path, "bz2")).read_bytes()
    _, at, begin, length = [r for r in bag_records(data) if r[0] == 5][-1]
    size = data.index(b"size=", at, begin) + 5
    data = data[:size] + bytes(4) + data[size + 4 : begin - 4] + bytes(4) + data[begin:]
    path.write_bytes(data[: begin + length])
    return path


@case("bag with a bit flip in lz4", 1770, "--salvage")
def _(path):
    data = good_bag(path, "lz4").read_bytes()
    return flipped(path, [r for r in bag_records(data) if r[0] == 5][2][2] + 5)


# -- SQLite ----------------------------------------------------------------------------------------


@case("db3 with a write-ahead log")
def _(path):
    live = path.with_name("live")
    live.mkdir(exist_ok=True)
    made, database = write_db3(live / path.name, content(1500), wal=True)
    for tail in ("", "-wal"):
        path.with_name(path.name + tail).write_bytes(Path(f"{made}{tail}").read_bytes())
    database.close()
    return path


@case("db3 cut short", 1000, "cut short")
def _(path):
    return cut(write_db3(path, content(1500)), 0.6)
