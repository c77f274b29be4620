"""MCAP logs: their channels, and their messages in file order.

A summary that can be trusted only saves the search for channels and the decompression of chunks
that are not needed: messages always come from the walk over the records.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import mcap.records as records
import numpy as np
from isal.isal_zlib import crc32
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode

from sinstool.core.english import counted
from sinstool.core.errors import NotALogError, one_line
from sinstool.io.readers.batch import RawBatch
from sinstool.io.readers.file import read_ahead
from sinstool.io.readers.formats import MCAP_MAGIC as MAGIC
from sinstool.io.readers.limits import (
    MAX_DEFINITIONS,
    MAX_INDEX,
    MAX_RECORD,
    ORDINARY_BLOCK,
    ROWS,
)
from sinstool.io.readers.log import Channel
from sinstool.io.readers.lost import Lost
from sinstool.io.readers.mcap_file import (
    MIN_MESSAGE,
    ChunkPlace,
    McapFile,
    OtherPlace,
    batch_of,
    record_length,
)
from sinstool.io.readers.resync import next_mcap_inside, run_mcap
from sinstool.io.readers.salvage import channel_mask, inside, unpack, whole_parts
from sinstool.io.readers.scan import END, FULL, definitions_mcap, scan_mcap


class McapLog(McapFile):
    """An MCAP file, profile ``ros2`` or ``ros1`` or none.

    Parameters
    ----------
    salvage : bool
        Skip damaged chunks, accept a missing end, and record both in `lost`.

    Raises
    ------
    NotALogError, DamagedLogError, UnsupportedLogError
    """

    format = "mcap"

    def __init__(self, path: Path, salvage: bool = False) -> None:
        super().__init__(path, salvage)
        self.profile = ""
        self.chunk_channels: dict[int, frozenset[int]] = {}
        self.schemas: dict[int, records.Schema] = {}
        self.schema_ids: dict[int, int] = {}
        # Messages by channel of each chunk that was read, by the chunk's offset
        self.chunk_counts: dict[int, dict[int, int]] = {}
        # Offsets of chunks whose CRC matches, and of those that are damaged or whose definitions
        # differ from those of the log
        self._sound: set[int] = set()
        self.broken: set[int] = set()
        self._agreeing: set[bytes] = set()  # definitions inside chunks that agree with the log
        self._defined = 0
        self._counts_proved = False
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    # -- opening ---------------------------------------------------------------------------

    def _open(self) -> None:
        if self.size < len(MAGIC) or self.read_at(0, len(MAGIC)) != MAGIC:
            raise NotALogError(self.path, "not an MCAP file: its first bytes are not MCAP's")
        self.complete = (
            self.size >= 2 * len(MAGIC) + 29
            and self.read_at(self.size - len(MAGIC), len(MAGIC)) == MAGIC
        )
        if not self.complete:
            self.damage("cut short: the end of an MCAP file is missing", self.size, "end")
        head = self.read_at(len(MAGIC), 9)
        if len(head) < 9 or head[0] != Opcode.HEADER:
            self.damage("no header record after the magic", len(MAGIC))
        else:
            length = record_length(head)
            if length <= MAX_RECORD:
                body = self.read_at(len(MAGIC), 9 + length)
                header = self._parse(records.Header, body[9:], len(MAGIC))
                self.profile = header.profile if header else ""
        if not (self.complete and self._read_summary()):
            self._discover()

    def _parse(self, kind: type, body: bytes, offset: int):  # type: ignore[no-untyped-def]
        """A record by mcap's own class; None (or an error) where it does not parse."""
        try:
            return kind.read(ReadDataStream(BytesIO(body)))  # type: ignore[attr-defined]
        except Exception as exc:  # mcap raises struct.error, EndOfFile, UnicodeDecodeError ...
            self.damage(f"a {kind.__name__} record cannot be read ({exc!r})", offset)
            return None

    def _chunk_index(self, body: bytes, offset: int) -> tuple[int, frozenset[int]] | None:
        """Where a chunk begins and the channels that its index names; None where it has none."""
        length = int.from_bytes(body[32:36], "little")
        name = body[44 + length + 4 : -16]
        said = body[44 + length : 44 + length + 4]
        if (
            length % 10 == 0
            and name in _COMPRESSIONS
            and said == len(name).to_bytes(4, "little")
            and len(body) == 64 + length + len(name)
        ):
            # The usual case: mcap's own class would take longer than reading a chunk's head
            (start,) = struct.unpack_from("<Q", body, 16)
            return start, frozenset(struct.unpack_from("<" + "H8x" * (length // 10), body, 36))
        index = self._parse(records.ChunkIndex, body, offset)
        return index and (index.chunk_start_offset, frozenset(index.message_index_offsets))

    def _read_summary(self) -> bool:
        """Channels, counts and chunk contents from the summary; False if it does not give them."""
        end = self.size - len(MAGIC)
        foot = self.read_at(end - 29, 29)
        if len(foot) < 29 or foot[0] != Opcode.FOOTER or record_length(foot) != 20:
            self.damage("the footer record is missing", end - 29, "index")
            return False
        start, _, crc = struct.unpack("<QQI", foot[9:])
        self.data_end = start or end - 29
        if start == 0:
            return False
        if start < len(MAGIC) or start > end - 29:
            self.data_end = -1
            what = f"the footer points to a summary at {start}, outside the file"
            self.damage(what, end - 29, "index")
            return False
        if end - 29 - start > MAX_INDEX:
            return False
        summary = self.read_at(start, end - 29 - start)
        # The CRC covers the summary and the footer up to the CRC itself.
        if crc and crc32(summary + foot[:25]) != crc:
            self.data_end = -1
            self.damage("the summary's CRC does not match", start, "index")
            return False
        statistics = None
        pos = 0
        channels: list[records.Channel] = []
        chunk_starts: list[int] = []
        while pos + 9 <= len(summary):
            op, length = summary[pos], int.from_bytes(summary[pos + 1 : pos + 9], "little")
            body = summary[pos + 9 : pos + 9 + length]
            if len(body) < length:
                self.damage("the summary ends inside a record", start + pos, "index")
                return False
            if op == Opcode.SCHEMA and (schema := self._parse(records.Schema, body, start + pos)):
                self.schemas[schema.id] = schema
            elif op == Opcode.CHANNEL and (ch := self._parse(records.Channel, body, start + pos)):
                channels.append(ch)
            elif op == Opcode.STATISTICS:
                statistics = self._parse(records.Statistics, body, start + pos)
            elif op == Opcode.CHUNK_INDEX:
                index = self._chunk_index(body, start + pos)
                if index is not None:
                    chunk_starts.append(index[0])
                # Only a proved index may decide which chunks are skipped.
                if index is not None and index[1] and crc:
                    self.chunk_channels[index[0]] = index[1]
            pos += 9 + length
        self.chunk_starts = frozenset(chunk_starts)
        if statistics is None or len({c.id for c in channels}) < statistics.channel_count:
            return False
        if any(c.schema_id and c.schema_id not in self.schemas for c in channels):
            return False
        for channel in channels:
            self._add_channel(channel)
        self.counts = dict(statistics.channel_message_counts)
        # A CRC proves the counts; some writers leave them out.
        self._counts_proved = bool(crc and self.counts)
        return True

    def _discover(self) -> None:
        """Channels from the data section itself, chunks included."""
        for place in self.places():
            if isinstance(place, OtherPlace):
                if place.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    if place.length > MAX_RECORD:
                        self.damage(f"a record declares {place.length} bytes", place.offset)
                        continue
                    body = self.read_at(place.offset + 9, place.length - 9)
                    self._define(place.opcode, body, place.offset)
            elif isinstance(place, ChunkPlace):
                for part in self._whole_parts(place):
                    self._define_all(part, place.offset)

    def _define_all(self, records_: np.ndarray, offset: int) -> None:
        """Schemas and channels out of a run of whole records."""
        pos, count, places = 0, 1, np.empty((3, 1024), np.int64)
        while count and self._defined <= MAX_DEFINITIONS:
            count, pos = definitions_mcap(records_, pos, places)
            for op, at, length in places[:, :count].T.tolist():
                self._define(op, records_[at : at + length].tobytes(), offset)

    def _contradicts(self, chunk: np.ndarray) -> bool:
        """Whether definitions in a chunk differ from those of the log as a whole."""
        pos, count, places = 0, 1, np.empty((3, 1024), np.int64)
        while count:
            count, pos = definitions_mcap(chunk, pos, places)
            for op, at, length in places[:, :count].T.tolist():
                record = chunk[at - 9 : at + length].tobytes()
                if record not in self._agreeing:
                    if not self._agrees(op, record[9:]):
                        return True
                    self._agreeing.add(record)
        return False

    def _agrees(self, op: int, body: bytes) -> bool:
        kind = records.Schema if op == Opcode.SCHEMA else records.Channel
        try:
            record = kind.read(ReadDataStream(BytesIO(body)))
        except Exception:  # see `_parse`
            return False
        if isinstance(record, records.Schema):
            return self.schemas.get(record.id) == record
        channel = self.channels.get(record.id)
        return (
            channel is not None
            and (channel.recorded_topic, channel.message_encoding, channel.metadata)
            == (record.topic, record.message_encoding, record.metadata)
            and self.schema_ids[record.id] == record.schema_id
            and (not record.schema_id or record.schema_id in self.schemas)
        )

    def _whole_parts(self, place: ChunkPlace) -> list[np.ndarray]:
        """The records of a chunk; with `salvage` without the damaged ones."""
        chunk = None if place.problem else self._load(place)
        if isinstance(chunk, np.ndarray):
            _, stop = run_mcap(chunk, 0)
            if stop == len(chunk):
                return [chunk]
        content, parts, _ = self._salvaged(place)
        return [content[begin:end] for begin, end in parts]

    def _define(self, op: int, body: bytes, offset: int) -> None:
        self._defined += 1
        if self._defined > MAX_DEFINITIONS:
            self.damage(f"more than {MAX_DEFINITIONS} schemas and channels", offset)
            return
        if op == Opcode.SCHEMA:
            schema = self._parse(records.Schema, body, offset)
            if schema and (known := self.schemas.setdefault(schema.id, schema)).name != schema.name:
                names = f"{one_line(known.name)}, and again {one_line(schema.name)}"
                what = f"schema {schema.id} is {names}: nothing shows whose is whose"
                self.damage(what, offset, "definition")
        else:
            channel = self._parse(records.Channel, body, offset)
            if channel and channel.id not in self.channels:
                self._add_channel(channel)
            elif channel:
                self._refuse_another(channel, offset)

    def _refuse_another(self, channel: records.Channel, offset: int) -> None:
        """Damage, if a channel's number belongs to another topic or type already."""
        known, schema = self.channels[channel.id], self.schemas.get(channel.schema_id)
        ours = known.recorded_topic, known.recorded_type
        theirs = channel.topic, schema.name if schema else ""
        if theirs != ours:
            what = (
                f"channel {channel.id} is {known.topic} of type {known.type_name or 'unknown'}, and"
                f" again {one_line(theirs[0])} of type {one_line(theirs[1]) or 'unknown'}:"
                " nothing shows whose messages are whose"
            )
            self.damage(what, offset, "definition")

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

    def _load(self, place: ChunkPlace) -> np.ndarray | str:
        """A chunk's records, decompressed and checked; a str says what is wrong with them."""
        raw = self.unpacked(
            place.compression, place.size, place.offset, place.data_offset, place.data_length
        )
        if isinstance(raw, str):
            what = raw
        elif not place.crc or place.offset in self._sound:
            return np.frombuffer(raw, np.uint8)
        elif crc32(raw) == place.crc:
            self._sound.add(place.offset)
            return np.frombuffer(raw, np.uint8)
        else:
            what = "a chunk's CRC does not match its content"
        self.refuse(what, place.offset)
        return what

    def _salvaged(self, place: ChunkPlace) -> tuple[np.ndarray, list[tuple[int, int]], bool]:
        """The readable part of a damaged chunk: its bytes, its runs of whole records, and whether
        its CRC proves them."""
        length = min(ORDINARY_BLOCK, place.offset + place.length - place.data_offset)
        data = self.read_at(place.data_offset, length)
        content, proved = unpack(place.compression, data, place.size, place.crc)
        mask = channel_mask(self.channels)
        parts = whole_parts(content, run_mcap, lambda b, at: next_mcap_inside(b, at, mask))
        return content, parts, proved

    def _salvaged_batch(self, place: ChunkPlace, what: str) -> RawBatch:
        """The intact messages of a damaged chunk; the losses are recorded."""
        content, parts, proved = self._salvaged(place)
        rows = np.concatenate(
            [np.empty((6, 0), np.int64), *(_rows(content, part) for part in parts)], axis=1
        )
        start, end = place.start_time, place.end_time
        if not proved:
            defined = np.isin(rows[0], list(self.channels))
            rows = rows[:, defined & inside(rows[3], start, end)]
        sensible = 0 <= start <= end < 2**63
        self.note_lost(
            Lost(
                what,
                "chunk",
                place.offset,
                place.offset + place.length,
                start if sensible else None,
                end if sensible else None,
                rows.shape[1],
                self._indexed(place),
                proved,
            )
        )
        # At the position of its start, so that the loss lies between it and the next chunk
        return batch_of(content, rows, place.offset)

    def _indexed(self, place: ChunkPlace) -> int | None:
        """Number of messages by the index behind a chunk; None without an index."""
        pos, count = place.offset + place.length, 0
        while (head := self.read_at(pos, 15)) and len(head) == 15:
            length = record_length(head)
            size = int.from_bytes(head[11:15], "little")
            if head[0] != Opcode.MESSAGE_INDEX or length < size + 6 or size % 16:
                break
            count += size // 16
            pos += 9 + length
        return count or None

    def chunk_batch(self, place: ChunkPlace) -> RawBatch:
        """All readable messages of one chunk.

        Raises
        ------
        DamagedLogError
            The chunk is corrupt and `salvage` is off.
        """
        batches = list(self._chunk_batches(place))
        if len(batches) > 1:
            columns = [[getattr(b, name) for b in batches] for name in _COLUMNS]
            return batch_of(
                batches[0].buffer, [np.concatenate(f) for f in columns], batches[0].position
            )
        return batches[0]

    def _chunk_batches(self, place: ChunkPlace) -> Iterator[RawBatch]:
        """The messages of one chunk, in batches of bounded size."""
        chunk = place.problem or self._load(place)
        counts: dict[int, int] = {}
        if self.salvage and not isinstance(chunk, str) and run_mcap(chunk, 0)[1] < len(chunk):
            chunk = "a record inside a chunk runs over its end"
        if not isinstance(chunk, str):
            pos, why, in_messages = 0, FULL, 0
            while why == FULL:
                out = np.empty((6, min(ROWS, (len(chunk) - pos) // MIN_MESSAGE + 1)), np.int64)
                count, pos, why = scan_mcap(chunk, pos, out, False)
                if why not in (END, FULL):
                    what = f"a record inside a chunk runs over its end (at byte {pos} of it)"
                    self.damage(what, place.offset, "chunk")
                _add(counts, out[0, :count])
                in_messages += int(out[2, :count].sum()) + count * MIN_MESSAGE
                yield batch_of(chunk, out[:, :count], place.offset + place.length)
            self.chunk_counts[place.offset] = counts
            # Most chunks hold nothing else
            if in_messages < len(chunk) and self._contradicts(chunk):
                self.broken.add(place.offset)
        else:
            self.broken.add(place.offset)
            yield self._salvaged_batch(place, chunk)

    def _read(self, selection: frozenset[int] | None) -> Iterator[RawBatch]:
        """Raw messages, chunk by chunk (see `Log.batches`)."""

        def needed() -> Iterator[ChunkPlace | RawBatch]:
            for place in self.places():
                if isinstance(place, RawBatch):
                    yield place
                elif isinstance(place, ChunkPlace):
                    holds = self.chunk_channels.get(place.offset)
                    if selection is None or holds is None or holds & selection:
                        yield place

        def size(place: ChunkPlace) -> int:
            return max(place.size, place.data_length)

        totals: dict[int, int] = {}
        for batch in read_ahead(needed(), size, self._chunk_batches):
            _add(totals, batch.channel)
            yield batch
        if self._counts_proved and not self.lost:
            for channel in self.channels if selection is None else selection & self.channels.keys():
                self._check_count(channel, totals.get(channel, 0))

    def _check_count(self, channel: int, count: int) -> None:
        """Compare with the log's own count: nothing else shows that a record's opcode changed."""
        declared = self.counts.get(channel, 0)
        if count != declared:
            what = (
                f"topic {self.channels[channel].topic} has {counted(count, 'message')}, but the"
                f" log's own count is {declared}"
            )
            self.note_lost(Lost(what, "count"))


_COMPRESSIONS = (b"", b"lz4", b"zstd")
_COLUMNS = ("channel", "offset", "length", "log_time", "publish_time", "sequence")


def _add(counts: dict[int, int], channels: np.ndarray) -> None:
    """Count the messages of each channel."""
    numbers = np.bincount(channels)
    for channel in np.flatnonzero(numbers).tolist():
        counts[channel] = counts.get(channel, 0) + int(numbers[channel])


def _rows(buffer: np.ndarray, part: tuple[int, int]) -> np.ndarray:
    """Offsets of the messages in a run of whole records."""
    begin, end = part
    out = np.empty((6, (end - begin) // MIN_MESSAGE + 1), np.int64)
    count, _, _ = scan_mcap(buffer[:end], begin, out, False)
    return out[:, :count]
