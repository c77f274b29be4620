"""Logs to be damaged, and ways to damage them: for ``fuzz_readers.py`` and the tests.

An input is made from a format, a seed and a number alone, so that each can be made again.
"""

from __future__ import annotations

import random
import shutil
import sqlite3
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import lz4.frame
import zstandard
from mcap.opcode import Opcode
from mcap.writer import IndexType

from tests.helpers.logs import rows, write_bag1, write_bag2, write_db3, write_mcap

MESSAGES = 20
FORMATS = ("mcap", "bag", "db3")
# What a size or a count can say to hurt
HOSTILE = (
    0, 1, 2, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 2**24, 2**28 - 1, 2**30, 2**31 - 1, 2**31, 2**32 - 1,
    2**32, 2**40, 2**53, 2**62, 2**63 - 1, 2**63, 2**64 - 9, 2**64 - 1,
)  # fmt: skip
Damage = Callable[[bytearray, random.Random], None]


# -- whole logs --------------------------------------------------------------------------------


def _mcaps(folder: Path) -> None:
    two, one = rows(MESSAGES, 2), rows(MESSAGES, 1)
    bare = {"index_types": IndexType.NONE, "use_statistics": False, "use_summary_offsets": False}
    for name in ("none", "lz4", "zstd"):
        chunk = {"chunk_size": 4096, "compression": name}
        write_mcap(folder / f"{name}.mcap", two, **chunk)
        write_mcap(folder / f"{name}-no-crc.mcap", two, enable_crcs=False, **chunk)
        write_mcap(folder / f"{name}-bare.mcap", two, enable_crcs=False, **bare, **chunk)
    write_mcap(folder / "unchunked.mcap", two, use_chunking=False, enable_crcs=False)
    write_mcap(folder / "unrepeated.mcap", two, enable_crcs=False, repeat_channels=False,
               repeat_schemas=False, compression="lz4")  # fmt: skip
    write_mcap(folder / "ros1.mcap", one, ros=1, enable_crcs=False, compression="lz4")
    write_mcap(folder / "channels.mcap", two, channels={"/imu": 3}, compression="none")


def _bags(folder: Path) -> None:
    for name in (None, "lz4", "bz2"):
        write_bag1(folder / f"{name}.bag", rows(MESSAGES, 1), name, chunk=4096)
    write_bag1(folder / "connections.bag", rows(MESSAGES, 1), None, chunk=2048, connections=2)


def _databases(folder: Path) -> None:
    for version in (1, 2, 3, 4):
        write_db3(folder / f"v{version}.db3", rows(MESSAGES, 2), version)
    for name in ("plain", "file", "message", "mcap"):
        storage = "mcap" if name == "mcap" else "db3"
        mode = name if name in ("file", "message") else None
        write_bag2(folder / f"{name}-folder", rows(MESSAGES, 2), storage, mode)


def make_logs(folder: Path) -> None:
    """Make the logs of every format, each in a folder of its name."""
    for name, make in zip(FORMATS, (_mcaps, _bags, _databases), strict=True):
        (folder / name).mkdir(parents=True)
        make(folder / name)


# -- damage to any bytes -----------------------------------------------------------------------


def _flip(data: bytearray, rng: random.Random) -> None:
    for _ in range(rng.choice((1, 1, 1, 2, 8, 64))):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def _overwrite(data: bytearray, rng: random.Random) -> None:
    at, size = rng.randrange(len(data)), rng.choice((1, 2, 4, 8, 64, 512))
    end = min(len(data), at + size)
    data[at:end] = rng.choice((bytes(end - at), b"\xff" * (end - at), rng.randbytes(end - at)))


def _cut(data: bytearray, rng: random.Random) -> None:
    del data[rng.randrange(len(data)) :]


def _cut_out(data: bytearray, rng: random.Random) -> None:
    at = rng.randrange(len(data))
    del data[at : at + rng.choice((1, 4, 9, 100, 3000))]


def _insert(data: bytearray, rng: random.Random) -> None:
    at = rng.randrange(len(data))
    data[at:at] = rng.randbytes(rng.choice((1, 4, 9, 100, 3000)))


def _repeat(data: bytearray, rng: random.Random) -> None:
    at, to = rng.randrange(len(data)), rng.randrange(len(data))
    data[to:to] = data[at : at + rng.choice((9, 100, 3000))]


def _move(data: bytearray, rng: random.Random) -> None:
    at, to = rng.randrange(len(data)), rng.randrange(len(data))
    piece = data[at : at + rng.choice((4, 9, 100, 3000))]
    data[to : to + len(piece)] = piece


def _hostile_size(data: bytearray, rng: random.Random) -> None:
    """Overwrite a number that looks like a size, a count or an offset."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        width, code = rng.choice(((4, "<I"), (8, "<Q"), (2, "<H"), (4, ">I")))
        for _ in range(200):
            at = rng.randrange(max(1, len(data) - width))
            if at + width > len(data):
                return
            (value,) = struct.unpack_from(code, data, at)
            if value <= len(data):
                near = (value + 1, value - 1, 2 * value, len(data) - at, len(data))
                new = rng.choice((*HOSTILE, *near)) % (1 << 8 * width)
                struct.pack_into(code, data, at, new)
                break


ANY: tuple[Damage, ...] = (
    _flip, _overwrite, _cut, _cut_out, _insert, _repeat, _move, _hostile_size, _hostile_size,
)  # fmt: skip


def _spliced(data: bytearray, rng: random.Random, others: list[Path]) -> None:
    other = rng.choice(others).read_bytes()
    start, at = rng.randrange(len(other)), rng.randrange(len(data))
    piece = other[start : start + rng.choice((50, 1000, len(other)))]
    data[at : at + rng.choice((0, len(piece)))] = piece


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Bytes with one to three damages."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        if changed:
            rng.choice(ANY)(changed, rng)
    return bytes(changed)


# -- damage behind compression and checksums ----------------------------------------------------


def _inside_mcap(data: bytes, rng: random.Random) -> bytes:
    """Damage what a chunk holds, and pack it again so that only its content is wrong."""
    out, pos = bytearray(data[:8]), 8
    while pos + 9 <= len(data) - 8:
        length = int.from_bytes(data[pos + 1 : pos + 9], "little")
        body = data[pos + 9 : pos + 9 + length]
        if data[pos] == Opcode.CHUNK and rng.random() < 0.7:
            body = _repacked_chunk(body, rng)
        elif data[pos] not in (Opcode.CHUNK, Opcode.MESSAGE) and rng.random() < 0.05:
            body = damaged(body, rng)
        out += bytes([data[pos]]) + len(body).to_bytes(8, "little") + body
        pos += 9 + length
    return bytes(out + data[pos:])


def _repacked_chunk(body: bytes, rng: random.Random) -> bytes:
    (width,) = struct.unpack_from("<I", body, 28)
    kind = body[32 : 32 + width].decode()
    records = body[40 + width :]
    if kind == "lz4":
        records = lz4.frame.compress(damaged(lz4.frame.decompress(records), rng))
    elif kind == "zstd":
        plain = zstandard.ZstdDecompressor().decompress(records, max_output_size=2**20)
        packer = zstandard.ZstdCompressor(write_content_size=rng.random() < 0.5)
        records = packer.compress(damaged(plain, rng))
    else:
        records = damaged(records, rng)
    # times, size as it was declared; no checksum
    head = body[:24] + bytes(4) + body[28 : 32 + width]
    return head + len(records).to_bytes(8, "little") + records


def _inside_bag(data: bytes, rng: random.Random) -> bytes:
    """Damage what a chunk of a ROS 1 bag holds, lz4 packed again."""
    out, pos = bytearray(data[:13]), 13
    while pos + 8 <= len(data):
        (width,) = struct.unpack_from("<I", data, pos)
        (length,) = struct.unpack_from("<I", data, pos + 4 + width)
        head = data[pos + 4 : pos + 4 + width]
        body = data[pos + 8 + width : pos + 8 + width + length]
        if b"op=\x05" in head and rng.random() < 0.7:
            if b"compression=lz4" in head:
                body = lz4.frame.compress(damaged(lz4.frame.decompress(body), rng))
            elif b"compression=none" in head:
                body = damaged(body, rng)
        elif rng.random() < 0.05:
            head, body = damaged(head, rng), damaged(body, rng) if body else body
        out += struct.pack("<I", len(head)) + head + struct.pack("<I", len(body)) + body
        pos += 8 + width + length
    return bytes(out)


def _inside_database(path: Path, rng: random.Random) -> None:
    """Put other values into the rows of a database that stays whole itself."""
    database = sqlite3.connect(path)
    try:
        database.execute("PRAGMA synchronous = OFF")
        for _ in range(rng.choice((1, 2, 5))):
            _one_row(database, rng)
        database.commit()
    finally:
        database.close()


def _one_row(database: sqlite3.Connection, rng: random.Random) -> None:
    number, elsewhere = rng.randrange(1, MESSAGES), rng.choice(HOSTILE) % 2**63
    result = database.execute("SELECT data FROM messages WHERE id = ?", (number,)).fetchone()
    payload = result[0] if result else b""
    other = rng.choice(("text", None, 5, 1.5, b"", rng.choice(HOSTILE) % 2**63, -1, 1e300))
    payload = damaged(payload, rng) if isinstance(payload, bytes) and payload else b"\x00\x01"
    texts = ("", "x" * 3000, "sensor_msgs/msg/Imu", "std_msgs/msg/Header", "\x00", "a/b")
    statement, values = rng.choice((
        ("UPDATE messages SET data = ? WHERE id = ?", (payload, number)),
        ("UPDATE messages SET data = ? WHERE id = ?", (payload, number)),
        ("UPDATE OR IGNORE messages SET data = ? WHERE id = ?", (other, number)),
        ("UPDATE OR IGNORE messages SET timestamp = ? WHERE id = ?", (other, number)),
        ("UPDATE OR IGNORE messages SET topic_id = ? WHERE id = ?", (other, number)),
        ("UPDATE OR IGNORE messages SET id = ? WHERE id = ?", (elsewhere, number)),
        ("UPDATE OR IGNORE topics SET type = ? WHERE id = 1", (rng.choice(texts),)),
        ("UPDATE OR IGNORE topics SET name = ? WHERE id = 1", (rng.choice(texts),)),
        ("UPDATE OR IGNORE topics SET serialization_format = ?", (rng.choice(texts),)),
        ("UPDATE OR IGNORE topics SET name = x'ff00fe'", ()),
        ("DELETE FROM topics WHERE id = ?", (rng.choice((1, 2)),)),
    ))  # fmt: skip
    database.execute(statement, values)


# -- inputs ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Input:
    """A damaged log, the log it was made from, and how it is to be opened."""

    path: Path
    """A file or a bag's folder."""
    base: str
    salvage: bool


def make_input(logs: Path, kind: str, seed: int, number: int, folder: Path) -> Input:
    """Make an input from the logs of :func:`make_logs`, in an empty folder."""
    rng = random.Random(f"{kind} {seed} {number}")
    bases = sorted((logs / kind).iterdir())
    folders = [b for b in bases if b.is_dir()]
    # A folder takes several times as long to read as a file.
    base = rng.choice(
        folders if folders and rng.random() < 0.2 else [b for b in bases if b not in folders]
    )
    target = folder / base.name
    if base.is_dir():
        shutil.copytree(base, target)
        files = sorted(target.iterdir())
    else:
        shutil.copyfile(base, target)
        files = [target]
    file = rng.choice(files)
    inside = rng.random() < 0.4
    if inside and file.suffix == ".db3":
        _inside_database(file, rng)
    else:
        data = file.read_bytes()
        if inside and file.suffix in (".mcap", ".bag"):
            data = (_inside_mcap if file.suffix == ".mcap" else _inside_bag)(data, rng)
        elif rng.random() < 0.1:
            spliced = bytearray(data)
            _spliced(spliced, rng, [b for b in bases if b.is_file()])
            data = bytes(spliced)
        else:
            data = damaged(data, rng)
        file.write_bytes(data)
    return Input(target, base.name, rng.random() < 0.5)
