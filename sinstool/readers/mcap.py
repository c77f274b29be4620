"""MCAP logs, by their own records: summary when it can be trusted, a walk otherwise.

The data section is always walked record by record at its top level (a handful of reads per
chunk), so chunked and unchunked files, with or without indexes, take one path. The summary saves
only the discovery of channels and the decompression of chunks nobody asked for.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Collection, Generator, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import mcap.records as records
import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode

from sinstool.errors import DamagedLogError, NotALogError, UnsupportedLogError
from sinstool.readers.ahead import ahead
from sinstool.readers.compression import (
    MAX_BLOCK,
    CompressionError,
    UnknownCompressionError,
    decompress,
)
from sinstool.readers.log import Channel, Log, RawBatch
from sinstool.readers.scan import END, FOREIGN, foreign_mcap, scan_mcap

MAGIC = b"\x89MCAP0\r\n"
WINDOW = 4 * 2**20
SALVAGE_HINT = "run again with --salvage to use what is whole"
# A record other than a chunk or an attachment that claims more than this is damage.
MAX_RECORD = 64 * 2**20
_MIN_MESSAGE = 31


@dataclass(frozen=True)
class ChunkPlace:
    """A chunk as its record header describes it.

    Attributes
    ----------
    offset, length : int
        Of the whole record, its 9-byte head included.
    start_time, end_time : int
        Log times it declares, ns.
    size, crc : int
        Uncompressed bytes and their CRC-32 (0: none).
    compression : str
    data_offset, data_length : int
        Of the compressed records.
    """

    offset: int
    length: int
    start_time: int
    end_time: int
    size: int
    crc: int
    compression: str
    data_offset: int
    data_length: int


@dataclass(frozen=True)
class OtherPlace:
    """A top-level record that is neither chunk nor message."""

    opcode: int
    offset: int
    length: int


class McapLog(Log):
    """An MCAP file, profile ``ros2`` or ``ros1`` or none.

    Parameters
    ----------
    path : Path
    salvage : bool
        Pass over damaged chunks and a missing end, and note them in `lost`.

    Raises
    ------
    NotALogError, DamagedLogError, UnsupportedLogError
    """

    format = "mcap"

    def __init__(self, path: Path, salvage: bool = False) -> None:
        super().__init__(path, salvage)
        self._fd = os.open(path, os.O_RDONLY)
        self.profile = ""
        self.chunk_channels: dict[int, frozenset[int]] = {}
        self.schemas: dict[int, records.Schema] = {}
        self.schema_ids: dict[int, int] = {}
        # Messages by channel of each chunk that was ever walked, by the chunk's offset
        self.chunk_counts: dict[int, dict[int, int]] = {}
        self._chunk_starts: list[int] = []
        self._sound: set[int] = set()  # offsets of chunks whose CRC was found right
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

    def read_at(self, offset: int, length: int) -> bytes:
        """Bytes of the file; fewer where it ends."""
        return os.pread(self._fd, length, offset)

    # -- opening ---------------------------------------------------------------------------

    def _open(self) -> None:
        if self.size < len(MAGIC) or self.read_at(0, len(MAGIC)) != MAGIC:
            raise NotALogError(self.path, "not an MCAP file: its first bytes are not MCAP's")
        self.complete = (
            self.size >= 2 * len(MAGIC) + 29
            and self.read_at(self.size - len(MAGIC), len(MAGIC)) == MAGIC
        )
        if not self.complete:
            self._damage("cut short: the end of an MCAP file is missing", self.size)
        head = self.read_at(len(MAGIC), 9)
        if len(head) < 9 or head[0] != Opcode.HEADER:
            self._damage("no header record after the magic", len(MAGIC))
        else:
            length = self._record_length(head)
            if length <= MAX_RECORD:
                body = self.read_at(len(MAGIC), 9 + length)
                header = self._parse(records.Header, body[9:], len(MAGIC))
                self.profile = header.profile if header else ""
        if not (self.complete and self._read_summary()):
            self._discover()

    @staticmethod
    def _record_length(head: bytes) -> int:
        return int.from_bytes(head[1:9], "little")

    def _parse(self, kind: type, body: bytes, offset: int):  # type: ignore[no-untyped-def]
        """A record by mcap's own class; None (or an error) where it does not parse."""
        try:
            return kind.read(ReadDataStream(BytesIO(body)))  # type: ignore[attr-defined]
        except Exception as exc:  # mcap raises struct.error, EndOfFile, UnicodeDecodeError ...
            self._damage(f"a {kind.__name__} record cannot be read ({exc!r})", offset)
            return None

    def _damage(self, what: str, offset: int) -> None:
        if not self.salvage:
            raise DamagedLogError(self.path, what, SALVAGE_HINT, offset)
        self.note_lost(f"{what} (at byte {offset})")

    def _read_summary(self) -> bool:
        """Channels, counts and chunk contents from the summary; False if it does not give them."""
        end = self.size - len(MAGIC)
        foot = self.read_at(end - 29, 29)
        if foot[0] != Opcode.FOOTER or self._record_length(foot) != 20:
            self._damage("the footer record is missing", end - 29)
            return False
        start, _, crc = struct.unpack("<QQI", foot[9:])
        if start == 0:
            return False
        if start < len(MAGIC) or start > end - 29:
            self._damage(f"the footer points to a summary at {start}, outside the file", end - 29)
            return False
        if end - 29 - start > 2**30:
            return False
        summary = self.read_at(start, end - 29 - start)
        # The CRC covers the summary and the footer up to the CRC itself.
        if crc and zlib.crc32(summary + foot[:25]) != crc:
            self._damage("the summary's CRC does not match", start)
            return False
        statistics = None
        pos = 0
        channels: list[records.Channel] = []
        while pos + 9 <= len(summary):
            op, length = summary[pos], int.from_bytes(summary[pos + 1 : pos + 9], "little")
            body = summary[pos + 9 : pos + 9 + length]
            if len(body) < length:
                self._damage("the summary ends inside a record", start + pos)
                return False
            if op == Opcode.SCHEMA and (schema := self._parse(records.Schema, body, start + pos)):
                self.schemas[schema.id] = schema
            elif op == Opcode.CHANNEL and (ch := self._parse(records.Channel, body, start + pos)):
                channels.append(ch)
            elif op == Opcode.STATISTICS:
                statistics = self._parse(records.Statistics, body, start + pos)
            elif op == Opcode.CHUNK_INDEX:
                index = self._parse(records.ChunkIndex, body, start + pos)
                if index:
                    self._chunk_starts.append(index.chunk_start_offset)
                if index and index.message_index_offsets:
                    self.chunk_channels[index.chunk_start_offset] = frozenset(
                        index.message_index_offsets
                    )
            pos += 9 + length
        if statistics is None or len({c.id for c in channels}) < statistics.channel_count:
            return False
        if any(c.schema_id and c.schema_id not in self.schemas for c in channels):
            return False
        for channel in channels:
            self._add_channel(channel)
        self.counts = dict(statistics.channel_message_counts)
        return True

    def _discover(self) -> None:
        """Channels from the data section itself, chunks included."""
        for place in self.places():
            if isinstance(place, OtherPlace):
                if place.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    if place.length > MAX_RECORD:
                        self._damage(f"a record declares {place.length} bytes", place.offset)
                        continue
                    body = self.read_at(place.offset + 9, place.length - 9)
                    self._define(place.opcode, body, place.offset)
            elif isinstance(place, ChunkPlace):
                chunk = self._load(place)
                if chunk is None:
                    continue
                found = np.empty((3, 1024), np.int64)
                count = foreign_mcap(chunk, found)
                if count > found.shape[1]:
                    found = np.empty((3, count), np.int64)
                    foreign_mcap(chunk, found)
                for op, offset, length in found[:, :count].T.tolist():
                    if op in (Opcode.SCHEMA, Opcode.CHANNEL):
                        self._define(op, chunk[offset : offset + length].tobytes(), place.offset)

    def _define(self, op: int, body: bytes, offset: int) -> None:
        if op == Opcode.SCHEMA:
            schema = self._parse(records.Schema, body, offset)
            if schema:
                self.schemas.setdefault(schema.id, schema)
        else:
            channel = self._parse(records.Channel, body, offset)
            if channel and channel.id not in self.channels:
                self._add_channel(channel)

    def _add_channel(self, channel: records.Channel) -> None:
        schema = self.schemas.get(channel.schema_id)
        self.schema_ids[channel.id] = channel.schema_id
        encoding = channel.message_encoding
        self.channels[channel.id] = Channel(
            channel.id,
            channel.topic,
            schema.name if schema else "",
            encoding,
            schema.encoding if schema else "",
            schema.data.decode("utf-8", "replace") if schema else "",
            dict(channel.metadata),
        )

    # -- walking ---------------------------------------------------------------------------

    def places(self) -> Iterator[ChunkPlace | OtherPlace | RawBatch]:
        """Top level of the data section in file order; runs of messages come as batches.

        Yields
        ------
        ChunkPlace, OtherPlace or RawBatch
        """
        pos = len(MAGIC)
        end = self.size - len(MAGIC) if self.complete else self.size
        while pos < end:
            head = self.read_at(pos, 9)
            if len(head) < 9:
                self._damage("the file ends inside a record", pos)
                return
            op, length = head[0], self._record_length(head)
            if op == Opcode.MESSAGE:
                stop = yield from self._run(pos, end)
                pos = stop if stop >= 0 else self._next_chunk(pos, end)
                continue
            if op == 0 or length > end - pos - 9:
                self._damage(f"a record (opcode {op}) declares {length} bytes, more than left", pos)
                pos = self._next_chunk(pos, end)
                continue
            if op in (Opcode.DATA_END, Opcode.FOOTER):
                return
            if op == Opcode.CHUNK:
                place = self._chunk_place(pos, length)
                if place is not None:
                    yield place
            else:
                yield OtherPlace(op, pos, 9 + length)
            pos += 9 + length

    def _next_chunk(self, pos: int, end: int) -> int:
        """Where to go on behind damage: the next chunk that the summary lists, or the end."""
        return min((start for start in self._chunk_starts if start > pos), default=end)

    def _run(self, pos: int, end: int) -> Generator[RawBatch, None, int]:
        """Messages at top level from `pos` on; returns where another begins, or -1."""
        while pos < end:
            window = np.frombuffer(self.read_at(pos, min(WINDOW, end - pos)), np.uint8)
            out = np.empty((6, len(window) // _MIN_MESSAGE + 1), np.int64)
            count, stop, why = scan_mcap(window, 0, out, True)
            if count:
                yield _batch(window, out[:, :count], pos + stop)
            pos += stop
            if why == FOREIGN:
                return pos
            if why == END:
                continue
            if count == 0:
                head = self.read_at(pos, 9)
                length = self._record_length(head) if len(head) == 9 else 0
                if not 22 <= length <= end - pos - 9 or length > MAX_RECORD * 4:
                    self._damage("a message record runs over the end of the file", pos)
                    return -1
                window = np.frombuffer(self.read_at(pos, 9 + length), np.uint8)
                count, stop, _ = scan_mcap(window, 0, out, True)
                yield _batch(window, out[:, :count], pos + stop)
                pos += stop
        return pos

    def _chunk_place(self, pos: int, length: int) -> ChunkPlace | None:
        head = self.read_at(pos + 9, min(length, 32 + 256))
        try:
            start, end, size, crc, name_length = struct.unpack_from("<QQQII", head)
            name = head[32 : 32 + name_length].decode("ascii")
            (data_length,) = struct.unpack_from("<Q", head, 32 + name_length)
        except (struct.error, UnicodeDecodeError):
            self._damage("a chunk's header cannot be read", pos)
            return None
        data_offset = pos + 9 + 40 + name_length
        if data_offset + data_length > pos + 9 + length:
            self._damage(f"a chunk declares {data_length} bytes of data, more than it has", pos)
            return None
        return ChunkPlace(pos, 9 + length, start, end, size, crc, name, data_offset, data_length)

    def _load(self, place: ChunkPlace) -> np.ndarray | None:
        """A chunk's records, decompressed and checked; None where damage is passed over."""
        if place.data_length > MAX_BLOCK:
            self._damage(f"a chunk of {place.data_length} bytes is more than we take", place.offset)
            return None
        data = self.read_at(place.data_offset, place.data_length)
        try:
            raw = decompress(place.compression, data, place.size)
        except UnknownCompressionError as exc:
            raise UnsupportedLogError(self.path, f"a chunk's {exc}", "", place.offset) from exc
        except CompressionError as exc:
            self._damage(f"a chunk {exc}", place.offset)
            return None
        if place.crc and place.offset not in self._sound:
            if zlib.crc32(raw) != place.crc:
                self._damage("a chunk's CRC does not match its content", place.offset)
                return None
            self._sound.add(place.offset)
        return np.frombuffer(raw, np.uint8)

    def chunk_batch(self, place: ChunkPlace) -> RawBatch | None:
        """All messages of one chunk; None where damage is passed over.

        Raises
        ------
        DamagedLogError
            The chunk is corrupt and `salvage` is off.
        """
        chunk = self._load(place)
        if chunk is None:
            return None
        out = np.empty((6, len(chunk) // _MIN_MESSAGE + 1), np.int64)
        count, stop, why = scan_mcap(chunk, 0, out, False)
        if why != END:
            self._damage(f"a record inside a chunk runs over its end (at {stop})", place.offset)
        numbers = np.bincount(out[0, :count])
        self.chunk_counts[place.offset] = {int(c): int(numbers[c]) for c in np.flatnonzero(numbers)}
        return _batch(chunk, out[:, :count], place.offset + place.length)

    def batches(self, channels: Collection[int] | None = None) -> Iterator[RawBatch]:
        """Raw messages, chunk by chunk (see `Log.batches`)."""
        wanted = None if channels is None else frozenset(channels)

        def needed() -> Iterator[ChunkPlace | RawBatch]:
            for place in self.places():
                if isinstance(place, RawBatch):
                    yield place
                elif isinstance(place, ChunkPlace):
                    holds = self.chunk_channels.get(place.offset)
                    if wanted is None or holds is None or holds & wanted:
                        yield place

        def load(place: ChunkPlace | RawBatch) -> RawBatch | None:
            return place if isinstance(place, RawBatch) else self.chunk_batch(place)

        for batch in ahead(load, needed()):
            if batch is not None and len(batch := self._selected(batch, wanted)):
                yield batch


def _batch(buffer: np.ndarray, found: np.ndarray, position: int) -> RawBatch:
    channel, offset, length, log_time, publish_time, sequence = found
    return RawBatch(buffer, channel, offset, length, log_time, publish_time, sequence, position)
