"""ROS 1 bags (version 2.0), read from front to back.

Messages come from a walk over the records, so a bag that was never indexed, or whose index is
wrong, reads like any other. The index section only saves a second walk, as it gives the connections
before the first message.
"""

from __future__ import annotations

import struct
from collections.abc import Generator, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sinstool.core.errors import NotALogError, UnsupportedLogError
from sinstool.io.readers.batch import RawBatch
from sinstool.io.readers.compression import packed_at, too_large
from sinstool.io.readers.file import FileLog, read_ahead
from sinstool.io.readers.formats import ROSBAG1_MAGIC
from sinstool.io.readers.limits import MAX_DEFINITIONS, MAX_INDEX, ORDINARY_BLOCK, ROWS, WINDOW
from sinstool.io.readers.log import Channel
from sinstool.io.readers.lost import Lost
from sinstool.io.readers.resync import next_rosbag1, run_rosbag1
from sinstool.io.readers.salvage import search, unpack, whole_parts
from sinstool.io.readers.scan import END, FOREIGN, FULL, definitions_rosbag1, scan_rosbag1

MAGIC = ROSBAG1_MAGIC + b"2.0\n"
BAG_HEADER_SIZE = 4096
MAX_HEADER = 2**20
# Bytes of the smallest message record: two lengths, and the op, conn and time fields of its header
_MIN_MESSAGE = 46
MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
_METADATA = ("md5sum", "callerid", "latching")


class BadRecordError(ValueError):
    """Bytes that are not a bag record."""


@dataclass(frozen=True)
class Record:
    """A record as its header describes it.

    ``problem`` says what is wrong with a damaged chunk; '' for a sound record.
    """

    op: int
    fields: dict[str, bytes]
    offset: int
    data_offset: int
    data_length: int
    problem: str = ""

    @property
    def end(self) -> int:
        """Offset of the next record."""
        return self.data_offset + self.data_length

    def number(self, name: str) -> int:
        """An unsigned field of 4 or 8 bytes."""
        raw = self.fields.get(name, b"")
        if len(raw) not in (4, 8):
            raise BadRecordError(f"it has no field {name}")
        return int.from_bytes(raw, "little")


def record_at(data: bytes | memoryview, at: int, base: int) -> Record:
    """A record that begins at ``data[at]``; its places count from ``base``."""
    if at + 8 > len(data):
        raise BadRecordError("the file ends inside it")
    (width,) = struct.unpack_from("<I", data, at)
    end = at + 4 + width
    if end + 4 > len(data):
        raise BadRecordError("the file ends inside its header")
    fields = _fields(bytes(data[at + 4 : end]))
    op = fields.get("op", b"")
    if len(op) != 1 or not MESSAGE <= op[0] <= CONNECTION:
        raise BadRecordError("it is of no known kind")
    (length,) = struct.unpack_from("<I", data, end)
    return Record(op[0], fields, base + at, base + end + 4, length)


def _fields(header: bytes) -> dict[str, bytes]:
    """Named fields of a record's header, or of a connection's data."""
    fields: dict[str, bytes] = {}
    pos = 0
    while pos < len(header):
        width = int.from_bytes(header[pos : pos + 4], "little")
        name, equals, value = header[pos + 4 : pos + 4 + width].partition(b"=")
        pos += 4 + width
        if pos > len(header) or not equals:
            raise BadRecordError("its fields cannot be read")
        fields[name.decode("ascii", "replace")] = value
    return fields


def read_channel(record: Record, data: bytes) -> Channel:
    """The channel a connection record defines."""
    text = {name: raw.decode("utf-8", "replace") for name, raw in _fields(data).items()}
    topic = record.fields.get("topic", b"").decode("utf-8", "replace") or text.get("topic", "")
    if not topic or not text.get("type"):
        raise BadRecordError("it lacks a topic or a type")
    return Channel(
        record.number("conn"),
        topic,
        text["type"],
        "ros1",
        "ros1msg",
        text.get("message_definition", ""),
        {name: text[name] for name in _METADATA if name in text},
    )


class Rosbag1Log(FileLog):
    """A ROS 1 bag.

    Parameters
    ----------
    salvage : bool
        Skip damaged chunks, accept a missing end, and record both in `lost`.

    Raises
    ------
    NotALogError, DamagedLogError, UnsupportedLogError
    """

    format = "rosbag1"
    profile = "ros1"

    def __init__(self, path: Path, salvage: bool = False) -> None:
        super().__init__(path, salvage)
        self._defined = 0
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    # -- opening ---------------------------------------------------------------------------

    def _open(self) -> None:
        magic = self.read_at(0, len(MAGIC))
        if magic != MAGIC:
            if magic.startswith(ROSBAG1_MAGIC) and not MAGIC.startswith(magic):
                version = magic[len(ROSBAG1_MAGIC) :].split(b"\n")[0].decode("ascii", "replace")
                raise UnsupportedLogError(
                    self.path, f"a bag of version {version}", "`rosbag fix` makes it version 2.0"
                )
            raise NotALogError(self.path, "not a ROS 1 bag: its first bytes are not a bag's")
        try:
            head = self._record(len(MAGIC))
            if head.op != BAG:
                raise BadRecordError("the first record is of another kind")
            index = head.number("index_pos")
            counts = head.number("conn_count"), head.number("chunk_count")
        except BadRecordError as exc:
            self.damage(f"the bag header record cannot be read ({exc})", len(MAGIC))
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
            what = f"cut short: its index is at byte {index}, beyond the end of the file"
            self.damage(what, self.size, "end")
        if not (self._first <= index < self.size and self._read_index(index, *counts)):
            self._discover()

    def _record(self, pos: int) -> Record:
        """The record at a place of the file; `BadRecordError` where there is no whole one."""
        head = self.read_at(pos, 512)
        if len(head) >= 4:
            width = int.from_bytes(head[:4], "little")
            if width > MAX_HEADER:
                raise BadRecordError(f"its header declares {width} bytes")
            if width + 8 > len(head):
                head = self.read_at(pos, width + 8)
        record = record_at(head, 0, pos)
        # The walk itself checks the size of a message index
        if record.end > self.size and record.op != INDEX:
            raise BadRecordError(
                f"it declares {record.data_length} bytes, and {self.size - record.data_offset} are"
                " left"
            )
        return record

    def _read_index(self, start: int, connections: int, chunks: int) -> bool:
        """Read connections and counts from the index section; False if it is invalid."""
        if self.size - start > MAX_INDEX:
            return False
        section = self.read_at(start, self.size - start)
        counts: dict[int, int] = {}
        chunk_infos = 0
        channels: dict[int, Channel] = {}
        pos = 0
        try:
            while pos < len(section):
                record = record_at(section, pos, 0)
                if record.end > len(section):
                    raise BadRecordError("it is cut short")
                data = section[record.data_offset : record.end]
                if record.op == CONNECTION:
                    channel = read_channel(record, data)
                    channels[channel.id] = channel
                elif record.op == CHUNK_INFO:
                    chunk_infos += 1
                    for number, count in struct.iter_unpack("<II", data):
                        counts[number] = counts.get(number, 0) + count
                pos = record.end
        except (BadRecordError, struct.error):
            return False
        if (len(channels), chunk_infos) != (connections, chunks) or counts.keys() - channels.keys():
            return False
        self.channels, self.counts = channels, counts
        return True

    def _discover(self) -> None:
        """Connections from the records themselves, chunks included."""
        for place in self._places():
            if isinstance(place, RawBatch):
                continue
            if place.op == CONNECTION:
                data = self.read_at(place.data_offset, place.data_length)
                self._define(place, data, place.offset)
            elif place.op == CHUNK:
                content, parts = self._content(place)
                for begin, end in parts:
                    self._define_all(content[begin:end], place.offset)

    def _define_all(self, records: np.ndarray, offset: int) -> None:
        """Connections out of a run of whole records."""
        pos, count, offsets = 0, 1, np.empty(1024, np.int64)
        while count and self._defined <= MAX_DEFINITIONS:
            count, pos = definitions_rosbag1(records, pos, offsets)
            for at in offsets[:count].tolist():
                self._define_from(records, at, offset)

    def _define_from(self, chunk: np.ndarray, pos: int, offset: int) -> None:
        try:
            record = record_at(chunk.data, pos, 0)
        except BadRecordError as exc:
            self.damage(f"a record inside a chunk cannot be read: {exc}", offset)
            return
        if record.op == CONNECTION:
            self._define(record, chunk[record.data_offset : record.end].tobytes(), offset)

    def _define(self, record: Record, data: bytes, offset: int) -> None:
        self._defined += 1
        if self._defined > MAX_DEFINITIONS:
            self.damage(f"more than {MAX_DEFINITIONS} connections", offset)
            return
        try:
            channel = read_channel(record, data)
        except BadRecordError as exc:
            self.damage(f"a connection record cannot be read: {exc}", offset)
        else:
            self.channels.setdefault(channel.id, channel)

    # -- walking ---------------------------------------------------------------------------

    def _places(self) -> Iterator[Record | RawBatch]:
        """Records at the top level, in file order; runs of messages come as batches."""
        pos = self._first
        # Where a search begins if the next record is damaged: the record before may have had a
        # wrong length.
        doubt = pos
        while pos < self.size:
            try:
                record = self._record(pos)
                if record.op == INDEX:
                    doubt = pos + 1
                    pos = self._behind_index(record)
                    continue
                length = record.data_length
                if record.op in (MESSAGE, CONNECTION) and (why := too_large(length, length)):
                    raise BadRecordError(f"it has {length} bytes, {why}")
                if record.op == CHUNK:
                    self._check_sizes(record)
            except BadRecordError as exc:
                what = f"a record cannot be read: {exc}"
                pos = yield from self._behind_damage(what, pos, doubt)
                doubt = pos + 1
                continue
            if record.op == MESSAGE:
                stop, last = yield from self._run(record)
                if stop > pos:
                    pos, doubt = stop, last + 1
                    continue
                self.damage("a message lacks its connection or its time", pos)
            elif record.op in (CHUNK, CONNECTION):
                self._packed = self._packed or (
                    record.op == CHUNK and record.fields.get("compression") != b"none"
                )
                yield record
            pos = record.end
            doubt = record.data_offset if record.op != CHUNK else pos

    def _check_sizes(self, chunk: Record) -> None:
        """An uncompressed chunk declares its size twice."""
        plain = chunk.fields.get("compression") == b"none"
        if plain and chunk.data_length != chunk.number("size"):
            raise BadRecordError(
                f"a chunk holds {chunk.data_length} bytes, and {chunk.number('size')} are declared"
            )

    def _behind_damage(self, what: str, pos: int, doubt: int) -> Generator[Record, None, int]:
        """Find where to resume after an invalid record; yields the readable part of a chunk."""
        self.refuse(what, pos)
        chunk = None
        with suppress(BadRecordError):
            chunk = record_at(self.read_at(pos, MAX_HEADER), 0, pos)
        at = packed_at(self.read_at(pos, 512))
        if (chunk is None or chunk.op != CHUNK) and at >= 0:
            # A killed recorder leaves an empty chunk record with its data after it; or the chunk's
            # header is lost.
            chunk = Record(CHUNK, {}, pos, pos + at, 0)
        if chunk is None or chunk.op != CHUNK:
            again = self._next(min(pos + 1, doubt))
            self.note_lost(Lost(what, "record", min(pos, again), max(pos, again)))
            return again
        if chunk.fields.get("compression") == b"none":
            # What lies in it are records like any other.
            self.note_lost(Lost(what, "chunk", pos, chunk.data_offset))
            return chunk.data_offset
        self._packed = True
        again = self._next(chunk.data_offset + 1)
        yield replace(chunk, data_length=again - chunk.data_offset, problem=what)
        return again

    def _next(self, start: int) -> int:
        """The next record that can be one."""

        def following(buffer: np.ndarray, left: int) -> int:
            return int(next_rosbag1(buffer, 0, left, False, self._packed))

        return search(self.read_at, start, self.size, following)

    def _behind_index(self, record: Record) -> int:
        """End of a message index, whose own size may be wrong."""
        for end in (record.end, record.data_offset + 12 * record.number("count")):
            if end == self.size:
                return end
            with suppress(BadRecordError):
                self._record(end)
                return end
        if record.end > self.size:
            raise BadRecordError("a message index extends beyond the end of the file")
        return record.end

    def _run(self, record: Record) -> Generator[RawBatch, None, tuple[int, int]]:
        """Messages at the top level; returns where they end, and where the last of them begins."""
        pos = last = record.offset
        need = record.end - record.offset
        while True:
            window = np.frombuffer(self.read_at(pos, max(WINDOW, need)), np.uint8)
            columns, stop, why = _scan(window, 0, True)
            if columns.shape[1]:
                # no later than its data, and no earlier than the record itself
                last = pos + int(columns[1, -1]) - 1
                yield _batch(window, columns, pos + stop)
            pos += stop
            if why == FOREIGN or not stop:
                return pos, last
            need = 0

    def _load(self, place: Record) -> np.ndarray | str:
        """A chunk's records, decompressed; a str says what is wrong with them."""
        try:
            name = place.fields.get("compression", b"").decode("ascii")
            size = place.number("size")
        except (BadRecordError, UnicodeDecodeError) as exc:
            raw: bytes | memoryview | str = f"a chunk's header cannot be used ({exc})"
        else:
            raw = self.unpacked(name, size, place.offset, place.data_offset, place.data_length)
        if not isinstance(raw, str):
            return np.frombuffer(raw, np.uint8)
        self.refuse(raw, place.offset)
        return raw

    def _content(self, place: Record) -> tuple[np.ndarray, list[tuple[int, int]]]:
        """A chunk's bytes and its runs of intact records: a single run for a sound chunk."""
        chunk = place.problem or self._load(place)
        if not isinstance(chunk, str):
            if run_rosbag1(chunk, 0)[1] == len(chunk):
                return chunk, [(0, len(chunk))]
            content = chunk
        else:
            # Up to the next possible record, as the chunk's own length may be wrong
            end = min(self._next(place.data_offset + 1), place.data_offset + ORDINARY_BLOCK)
            data = self.read_at(place.data_offset, end - place.data_offset)
            name = place.fields.get("compression", b"").decode("ascii", "replace")
            content, _ = unpack(name, data, 0, 0)
        return content, whole_parts(
            content, run_rosbag1, lambda b, at: next_rosbag1(b, at, len(b), True, False)
        )

    def _salvaged_batch(self, place: Record, what: str) -> RawBatch:
        """The intact messages of a damaged chunk; the losses are recorded."""
        content, parts = self._content(place)
        runs = [_scan(content[:end], begin, False)[0] for begin, end in parts]
        rows = np.concatenate([np.empty((4, 0), np.int64), *runs], axis=1)
        rows = rows[:, np.isin(rows[0], list(self.channels))]
        part = Lost(what, "chunk", place.offset, place.end, recovered=rows.shape[1])
        part.declared = self._indexed(place)
        if len(parts) > 1 and runs[0].shape[1] and runs[-1].shape[1]:
            part.start_ns, part.end_ns = sorted((int(runs[0][3, -1]), int(runs[-1][3, 0])))
        self.note_lost(part)
        # At the position of its start, so that the loss lies between it and the next chunk
        return _batch(content, rows, place.offset)

    def _indexed(self, place: Record) -> int | None:
        """Number of messages by the index behind a chunk; None without an index."""
        pos, count = place.end, 0
        with suppress(BadRecordError):
            while pos < self.size and (record := self._record(pos)).op == INDEX:
                count += record.number("count")
                pos = self._behind_index(record)
        return count or None

    def _chunk_batches(self, place: Record) -> Iterator[RawBatch]:
        """The messages of one chunk, in batches of bounded size."""
        chunk = place.problem or self._load(place)
        if self.salvage and not isinstance(chunk, str) and run_rosbag1(chunk, 0)[1] < len(chunk):
            chunk = "a record inside a chunk is not complete"
        if isinstance(chunk, str):
            yield self._salvaged_batch(place, chunk)
            return
        pos, why = 0, FULL
        while why == FULL:
            columns, pos, why = _scan(chunk, pos, False)
            if why not in (END, FULL):
                what = f"a record inside a chunk is not complete (at byte {pos} of it)"
                self.refuse(what, place.offset)
            yield _batch(chunk, columns, place.end)

    def _read(self, selection: frozenset[int] | None) -> Iterator[RawBatch]:
        """Raw messages, chunk by chunk (see `Log.batches`)."""

        def size(chunk: Record) -> int:
            declared = int.from_bytes(chunk.fields.get("size", b""), "little")
            return max(declared, chunk.data_length)

        needed = (p for p in self._places() if isinstance(p, RawBatch) or p.op == CHUNK)
        yield from read_ahead(needed, size, self._chunk_batches)


def _scan(buffer: np.ndarray, start: int, stop_at_foreign: bool) -> tuple[np.ndarray, int, int]:
    """Messages from a place on, a batch of them at most (see `scan_rosbag1`)."""
    out = np.empty((4, min(ROWS, (len(buffer) - start) // _MIN_MESSAGE + 1)), np.int64)
    count, stop, why = scan_rosbag1(buffer, start, out, stop_at_foreign)
    return out[:, :count], stop, why


def _batch(buffer: np.ndarray, columns: np.ndarray, position: int) -> RawBatch:
    channel, offset, length, time = columns
    return RawBatch(buffer, channel, offset, length, time, time, np.zeros_like(time), position)
