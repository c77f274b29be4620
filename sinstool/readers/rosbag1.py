"""ROS 1 bags (version 2.0), read from front to back.

The walk over the records is all that is needed for messages, so a bag that was never indexed, or
whose index is wrong, reads like any other. The index section only saves a second walk: it names
the connections before the first message, and in salvage the chunks behind a damaged one.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Collection, Generator, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sinstool.errors import DamagedLogError, NotALogError, UnsupportedLogError
from sinstool.readers.ahead import ahead
from sinstool.readers.compression import (
    MAX_BLOCK,
    CompressionError,
    UnknownCompressionError,
    decompress,
)
from sinstool.readers.log import Channel, Log, RawBatch
from sinstool.readers.mcap import SALVAGE_HINT
from sinstool.readers.scan import END, FOREIGN, foreign_rosbag1, scan_rosbag1

MAGIC = b"#ROSBAG V2.0\n"
BAG_HEADER_SIZE = 4096
WINDOW = 4 * 2**20
MAX_HEADER = 2**20
MAX_INDEX = 256 * 2**20
# Record lengths, and the op, conn and time fields of a message's header.
_MIN_MESSAGE = 46

_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_METADATA = ("md5sum", "callerid", "latching")


class _BadRecordError(ValueError):
    """Bytes that are no bag record."""


@dataclass(frozen=True)
class _Record:
    """A record as its header describes it; ``end`` is where the next one begins."""

    op: int
    fields: dict[str, bytes]
    offset: int
    data_offset: int
    data_length: int

    @property
    def end(self) -> int:
        return self.data_offset + self.data_length

    def number(self, name: str) -> int:
        """An unsigned field of 4 or 8 bytes."""
        raw = self.fields.get(name, b"")
        if len(raw) not in (4, 8):
            raise _BadRecordError(f"it has no field {name}")
        return int.from_bytes(raw, "little")


class Rosbag1Log(Log):
    """A ROS 1 bag.

    Parameters
    ----------
    path : Path
    salvage : bool
        Pass over damaged chunks and a missing end, and note them in `lost`.

    Raises
    ------
    NotALogError, DamagedLogError, UnsupportedLogError
    """

    format = "rosbag1"
    profile = "ros1"

    def __init__(self, path: Path, salvage: bool = False) -> None:
        super().__init__(path, salvage)
        self._chunk_starts: list[int] = []
        self._fd = os.open(path, os.O_RDONLY)
        try:
            self._open()
        except BaseException:
            os.close(self._fd)
            raise

    def close(self) -> None:
        """Close the file."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _read_at(self, offset: int, length: int) -> bytes:
        return os.pread(self._fd, length, offset)

    def _damage(self, what: str, offset: int) -> None:
        if not self.salvage:
            raise DamagedLogError(self.path, what, SALVAGE_HINT, offset)
        self.note_lost(f"{what} (at byte {offset})")

    # -- opening ---------------------------------------------------------------------------

    def _open(self) -> None:
        magic = self._read_at(0, len(MAGIC))
        if magic != MAGIC:
            if magic.startswith(b"#ROSBAG V") and not MAGIC.startswith(magic):
                version = magic[9:].split(b"\n")[0].decode("ascii", "replace")
                raise UnsupportedLogError(
                    self.path, f"a bag of version {version}", "`rosbag fix` makes it version 2.0"
                )
            raise NotALogError(self.path, "not a ROS 1 bag: its first bytes are not a bag's")
        try:
            head = self._record(len(MAGIC))
            if head.op != _BAG:
                raise _BadRecordError("it is another record")
            index = head.number("index_pos")
            counts = head.number("conn_count"), head.number("chunk_count")
        except _BadRecordError as exc:
            self._damage(f"the bag header record cannot be read ({exc})", len(MAGIC))
            self._first = len(MAGIC) + BAG_HEADER_SIZE
            self._discover()
            return
        self._first = head.end
        if encryptor := head.fields.get("encryptor"):
            name = encryptor.decode("ascii", "replace")
            raise UnsupportedLogError(
                self.path, f"encrypted by {name}", "`rosbag decrypt` makes it readable"
            )
        if index > self.size:
            self._damage(
                f"cut short: its index is at byte {index}, behind the end of the file", self.size
            )
        if not (self._first <= index < self.size and self._read_index(index, *counts)):
            self._discover()

    def _record(self, pos: int) -> _Record:
        """The record at a place of the file; `_BadRecordError` where there is no whole one."""
        head = self._read_at(pos, 512)
        if len(head) >= 4:
            width = int.from_bytes(head[:4], "little")
            if width > MAX_HEADER:
                raise _BadRecordError(f"its header declares {width} bytes")
            if width + 8 > len(head):
                head = self._read_at(pos, width + 8)
        record = _parse(head, 0, pos)
        # the size of a message index is looked at by the walk itself
        if record.end > self.size and record.op != _INDEX:
            raise _BadRecordError(
                f"it declares {record.data_length} bytes where {self.size - record.data_offset} are"
            )
        return record

    def _read_index(self, start: int, connections: int, chunks: int) -> bool:
        """Connections and counts from the index section; False if it is not what it should be."""
        if self.size - start > MAX_INDEX:
            return False
        section = self._read_at(start, self.size - start)
        counts: dict[int, int] = {}
        chunk_starts: list[int] = []
        found: dict[int, Channel] = {}
        pos = 0
        try:
            while pos < len(section):
                record = _parse(section, pos, 0)
                if record.end > len(section):
                    raise _BadRecordError("it is cut short")
                data = section[record.data_offset : record.end]
                if record.op == _CONNECTION:
                    channel = _channel(record, data)
                    found[channel.id] = channel
                elif record.op == _CHUNK_INFO:
                    chunk_starts.append(record.number("chunk_pos"))
                    for number, count in struct.iter_unpack("<II", data):
                        counts[number] = counts.get(number, 0) + count
                pos = record.end
        except (_BadRecordError, struct.error):
            return False
        if (len(found), len(chunk_starts)) != (connections, chunks) or counts.keys() - found.keys():
            return False
        self.channels, self.counts, self._chunk_starts = found, counts, sorted(chunk_starts)
        return True

    def _discover(self) -> None:
        """Connections from the records themselves, chunks included."""
        for place in self._places():
            if isinstance(place, RawBatch):
                continue
            if place.op == _CONNECTION:
                data = self._read_at(place.data_offset, place.data_length)
                self._define(place, data, place.offset)
            elif place.op == _CHUNK and (chunk := self._load(place)) is not None:
                found = np.empty(1024, np.int64)
                if (count := foreign_rosbag1(chunk, found)) > len(found):
                    found = np.empty(count, np.int64)
                    foreign_rosbag1(chunk, found)
                for pos in found[:count].tolist():
                    self._define_from(chunk, pos, place.offset)

    def _define_from(self, chunk: np.ndarray, pos: int, offset: int) -> None:
        try:
            record = _parse(chunk.data, pos, 0)
        except _BadRecordError as exc:
            self._damage(f"a record inside a chunk cannot be read: {exc}", offset)
            return
        if record.op == _CONNECTION:
            self._define(record, chunk[record.data_offset : record.end].tobytes(), offset)

    def _define(self, record: _Record, data: bytes, offset: int) -> None:
        try:
            channel = _channel(record, data)
        except _BadRecordError as exc:
            self._damage(f"a connection record cannot be read: {exc}", offset)
        else:
            self.channels.setdefault(channel.id, channel)

    # -- walking ---------------------------------------------------------------------------

    def _places(self) -> Iterator[_Record | RawBatch]:
        """Records at the top level, in file order; runs of messages come as batches."""
        pos = self._first
        while pos < self.size:
            try:
                record = self._record(pos)
                if record.op == _INDEX:
                    pos = self._behind_index(record)
                    continue
            except _BadRecordError as exc:
                self._damage(f"a record cannot be read: {exc}", pos)
                pos = min((s for s in self._chunk_starts if s > pos), default=self.size)
                continue
            if record.op in (_MESSAGE, _CONNECTION) and record.data_length > MAX_BLOCK:
                self._damage(f"a record of {record.data_length} bytes is more than we take", pos)
            elif record.op == _MESSAGE:
                stop = yield from self._run(record)
                if stop > pos:
                    pos = stop
                    continue
                self._damage("a message lacks its connection or its time", pos)
            elif record.op in (_CHUNK, _CONNECTION):
                yield record
            pos = record.end

    def _behind_index(self, record: _Record) -> int:
        """End of a message index, whose own size is not to be relied on where it lies."""
        for end in (record.end, record.data_offset + 12 * record.number("count")):
            if end == self.size:
                return end
            with suppress(_BadRecordError):
                self._record(end)
                return end
        if record.end > self.size:
            raise _BadRecordError("a message index runs over the end of the file")
        return record.end

    def _run(self, record: _Record) -> Generator[RawBatch, None, int]:
        """Messages at the top level; returns where the next other record begins."""
        pos = record.offset
        need = record.end - record.offset
        while True:
            window = np.frombuffer(self._read_at(pos, max(WINDOW, need)), np.uint8)
            found, stop, why = _scan(window, True)
            if found.shape[1]:
                yield _batch(window, found, pos + stop)
            pos += stop
            if why == FOREIGN or not stop:
                return pos
            need = 0

    def _load(self, place: _Record) -> np.ndarray | None:
        """A chunk's records, decompressed; None where damage is passed over."""
        try:
            name = place.fields.get("compression", b"").decode("ascii")
            size = place.number("size")
            if place.data_length > MAX_BLOCK:
                raise _BadRecordError(f"{place.data_length} bytes are more than we take")
            data = self._read_at(place.data_offset, place.data_length)
            raw = decompress(name, data, size)
        except UnknownCompressionError as exc:
            raise UnsupportedLogError(self.path, f"a chunk's {exc}", "", place.offset) from exc
        except CompressionError as exc:
            self._damage(f"a chunk {exc}", place.offset)
            return None
        except (_BadRecordError, UnicodeDecodeError) as exc:
            self._damage(f"a chunk's header cannot be used ({exc})", place.offset)
            return None
        return np.frombuffer(raw, np.uint8)

    def _chunk_batch(self, place: _Record) -> RawBatch | None:
        chunk = self._load(place)
        if chunk is None:
            return None
        found, stop, why = _scan(chunk, False)
        if why != END:
            self._damage(f"a record inside a chunk is not whole (at {stop})", place.offset)
        return _batch(chunk, found, place.end)

    def batches(self, channels: Collection[int] | None = None) -> Iterator[RawBatch]:
        """Raw messages, chunk by chunk (see `Log.batches`)."""
        wanted = None if channels is None else frozenset(channels)

        def load(place: _Record | RawBatch) -> RawBatch | None:
            return place if isinstance(place, RawBatch) else self._chunk_batch(place)

        needed = (p for p in self._places() if isinstance(p, RawBatch) or p.op == _CHUNK)
        for batch in ahead(load, needed):
            if batch is not None and len(batch := self._selected(batch, wanted)):
                yield batch


def _parse(data: bytes | memoryview, at: int, base: int) -> _Record:
    """A record that begins at ``data[at]``; its places count from ``base``."""
    if at + 8 > len(data):
        raise _BadRecordError("the file ends inside it")
    (width,) = struct.unpack_from("<I", data, at)
    end = at + 4 + width
    if end + 4 > len(data):
        raise _BadRecordError("the file ends inside its header")
    fields = _fields(bytes(data[at + 4 : end]))
    op = fields.get("op", b"")
    if len(op) != 1 or not _MESSAGE <= op[0] <= _CONNECTION:
        raise _BadRecordError("it is of no known kind")
    (length,) = struct.unpack_from("<I", data, end)
    return _Record(op[0], fields, base + at, base + end + 4, length)


def _fields(header: bytes) -> dict[str, bytes]:
    """Named fields of a record's header, or of a connection's data."""
    fields: dict[str, bytes] = {}
    pos = 0
    while pos < len(header):
        width = int.from_bytes(header[pos : pos + 4], "little")
        name, equals, value = header[pos + 4 : pos + 4 + width].partition(b"=")
        pos += 4 + width
        if pos > len(header) or not equals:
            raise _BadRecordError("its fields cannot be read")
        fields[name.decode("ascii", "replace")] = value
    return fields


def _channel(record: _Record, data: bytes) -> Channel:
    """The channel a connection record defines."""
    text = {name: raw.decode("utf-8", "replace") for name, raw in _fields(data).items()}
    topic = record.fields.get("topic", b"").decode("utf-8", "replace") or text.get("topic", "")
    if not topic or not text.get("type"):
        raise _BadRecordError("it lacks a topic or a type")
    return Channel(
        record.number("conn"),
        topic,
        text["type"],
        "ros1",
        "ros1msg",
        text.get("message_definition", ""),
        {name: text[name] for name in _METADATA if name in text},
    )


def _scan(buffer: np.ndarray, stop_at_foreign: bool) -> tuple[np.ndarray, int, int]:
    out = np.empty((4, len(buffer) // _MIN_MESSAGE + 1), np.int64)
    count, stop, why = scan_rosbag1(buffer, 0, out, stop_at_foreign)
    return out[:, :count], stop, why


def _batch(buffer: np.ndarray, found: np.ndarray, position: int) -> RawBatch:
    channel, offset, length, time = found
    return RawBatch(buffer, channel, offset, length, time, time, np.zeros_like(time), position)
