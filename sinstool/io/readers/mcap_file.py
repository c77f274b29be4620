"""An MCAP file as bytes: its top-level records in file order.

The data section is always walked record by record (a handful of reads per chunk), so chunked and
unchunked files, with or without indexes, are handled alike. With `salvage`, the walk goes on after
damage at the next place that can be a record.
"""

from __future__ import annotations

import struct
from collections.abc import Generator, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mcap.opcode import Opcode

from sinstool.io.readers.batch import RawBatch
from sinstool.io.readers.compression import compression_of, packed_at, too_large
from sinstool.io.readers.file import FileLog
from sinstool.io.readers.formats import MCAP_MAGIC as MAGIC
from sinstool.io.readers.limits import ROWS, WINDOW
from sinstool.io.readers.lost import Lost
from sinstool.io.readers.resync import next_mcap
from sinstool.io.readers.salvage import channel_mask, search
from sinstool.io.readers.scan import END, FOREIGN, FULL, scan_mcap

MIN_MESSAGE = 31
_INSIDE_SUMMARY = {
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.STATISTICS,
    Opcode.METADATA_INDEX,
    Opcode.SUMMARY_OFFSET,
}
_BEHIND_DATA = _INSIDE_SUMMARY | {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.FOOTER}


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
    data_offset, data_length : int
        Of the compressed records.
    problem : str
        What is wrong with the record itself: it is cut short, or its lengths contradict each
        other. Such a place is given with `salvage` only.
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
    problem: str = ""

    @property
    def compressed(self) -> bool:
        """Whether its records are compressed."""
        return self.compression not in ("", "none")


@dataclass(frozen=True)
class OtherPlace:
    """A top-level record that is neither chunk nor message."""

    opcode: int
    offset: int
    length: int


class McapFile(FileLog):
    """The records of an MCAP file.

    Parameters
    ----------
    salvage : bool
        Pass over damage and note it in `lost`.

    Attributes
    ----------
    complete : bool
        The file ends as MCAP files do.
    data_end : int
        Where the data section has to end, if the footer says so; else -1.
    chunk_starts : set of int
        Offsets of chunks, as far as the summary lists them.
    """

    def __init__(self, path: Path, salvage: bool) -> None:
        super().__init__(path, salvage)
        self.complete = False
        self.data_end = -1
        self.chunk_starts: frozenset[int] = frozenset()

    def places(self) -> Iterator[ChunkPlace | OtherPlace | RawBatch]:
        """Top level of the data section in file order; runs of messages come as batches."""
        pos = len(MAGIC)
        end = self.size - len(MAGIC) if self.complete else self.size
        # Where a search begins if the next record is damaged: the record before may have had a
        # wrong length.
        doubt = pos
        while pos < end:
            head = self.read_at(pos, 9)
            op, length = (head[0], record_length(head)) if len(head) == 9 else (0, 0)
            if op == Opcode.MESSAGE and pos not in self.chunk_starts:
                stop, last = yield from self._run(pos, end)
                if stop > pos:
                    pos, doubt = stop, last + 1
                    continue
                what = "a message record runs over the end of the file"
                if length <= end - pos - 9:
                    what = f"a message has {length} bytes, {too_large(length, length)}"
            elif len(head) < 9:
                what = "the file ends inside a record"
            elif op == 0 or length > end - pos - 9:
                what = f"a record (opcode {op}) declares {length} bytes, more than are left"
            elif op in (Opcode.DATA_END, Opcode.FOOTER):
                if self._ends_data(pos + 9 + length):
                    return
                what = "the data section ends here, but the file does not"
            elif op != Opcode.CHUNK and pos in self.chunk_starts:
                what = f"the index lists a chunk where there is a record of opcode {op}"
            else:
                what = ""
                if op == Opcode.CHUNK:
                    place = self._chunk_place(pos, length)
                    if place is not None:
                        self._packed = self._packed or place.compressed
                        yield place
                        doubt = place.data_offset + place.data_length
                    else:
                        doubt = pos + 1
                else:
                    if op == Opcode.ATTACHMENT:  # which may hold anything, even another log
                        doubt = pos + 9 + length
                    elif op <= Opcode.DATA_END:
                        doubt = pos + 1
                    if op not in _INSIDE_SUMMARY:
                        yield OtherPlace(op, pos, 9 + length)
                pos += 9 + length
                doubt = min(doubt, pos)
            if what:
                pos = yield from self._behind_damage(what, pos, doubt, end)
                doubt = pos + 1

    def _behind_damage(
        self, what: str, pos: int, doubt: int, end: int
    ) -> Generator[ChunkPlace, None, int]:
        """Find where to resume after an invalid record; yields the readable part of a chunk."""
        self.refuse(what, pos)
        head = self.read_at(pos, 512)
        chunk = None
        if head[:1] == bytes([Opcode.CHUNK]) or pos in self.chunk_starts:
            chunk = self._parse_chunk(pos, end)
        if chunk is None and (at := packed_at(head)) >= 0:
            # A chunk whose header is gone: the data themselves show their compression.
            chunk = ChunkPlace(pos, 0, 0, -1, 0, 0, compression_of(head[at:]), pos + at, 0)
        if chunk is None:
            again = self._next(min(pos + 1, doubt), end)
            self.note_lost(Lost(what, "record", min(pos, again), max(pos, again)))
            return again
        if not chunk.compressed:
            # What lies in it are records like any other.
            self.note_lost(Lost(what, "chunk", pos, chunk.data_offset))
            return chunk.data_offset
        self._packed = True
        again = self._next(chunk.data_offset, end)
        yield replace(
            chunk, length=again - pos, data_length=again - chunk.data_offset, problem=what
        )
        return again

    def _next(self, start: int, end: int) -> int:
        """The next record that can be one."""
        mask = channel_mask(self.channels)

        def following(buffer: np.ndarray, left: int) -> int:
            return int(next_mcap(buffer, 0, left, mask, self._packed))

        return search(self.read_at, start, end, following)

    def _ends_data(self, after: int) -> bool:
        """Whether a record that says so and ends at `after` ends the data section."""
        if self.data_end >= 0:
            return after in (self.data_end, self.size - len(MAGIC))
        head = self.read_at(after, 9)
        return len(head) < 9 or head[0] in _BEHIND_DATA or head.startswith(MAGIC)

    def _run(self, pos: int, end: int) -> Generator[RawBatch, None, tuple[int, int]]:
        """Messages at top level; returns where they end, and where the last of them begins."""
        last = pos
        need = 0
        while pos < end:
            window = np.frombuffer(self.read_at(pos, min(max(WINDOW, need), end - pos)), np.uint8)
            if not len(window):  # the file has become shorter
                break
            out = np.empty((6, min(ROWS, len(window) // MIN_MESSAGE + 1)), np.int64)
            count, stop, why = scan_mcap(window, 0, out, True)
            if count:
                last = pos + int(out[1, count - 1]) - MIN_MESSAGE
                yield batch_of(window, out[:, :count], pos + stop)
            pos += stop
            if why == FOREIGN:
                break
            if why in (END, FULL) or count:
                need = 0
                continue
            head = self.read_at(pos, 9)
            length = record_length(head) if len(head) == 9 else 0
            if not 22 <= length <= end - pos - 9 or too_large(length, length) or need:
                break
            need = 9 + length
        return pos, last

    def _parse_chunk(self, pos: int, end: int) -> ChunkPlace | None:
        """A chunk's header; None where there is none."""
        head = self.read_at(pos, 9 + 32 + 256)
        try:
            start, stop, size, crc, name_length = struct.unpack_from("<QQQII", head, 9)
            name = head[41 : 41 + name_length].decode("ascii")
            (data_length,) = struct.unpack_from("<Q", head, 41 + name_length)
        except (struct.error, UnicodeDecodeError):
            return None
        length = 9 + record_length(head)
        data_offset = pos + 49 + name_length
        if data_offset > end:
            return None
        return ChunkPlace(pos, length, start, stop, size, crc, name, data_offset, data_length)

    def _chunk_place(self, pos: int, length: int) -> ChunkPlace | None:
        end = pos + 9 + length
        place = self._parse_chunk(pos, end)
        what = "a chunk's header cannot be read"
        if place is not None:
            if place.data_offset + place.data_length <= end:
                return place
            what = f"a chunk declares {place.data_length} bytes of data, more than it has"
        self.refuse(what, pos)
        if place is not None and place.compression in ("", "lz4", "zstd"):
            return replace(place, data_length=end - place.data_offset, problem=what)
        # The compression cannot be read: the data show it, or else are plain records.
        head = self.read_at(pos, min(512, end - pos))
        if len(head) < 37:
            self.note_lost(Lost(what, "chunk", pos, end))
            return None
        start, stop, size, crc = struct.unpack_from("<QQQI", head, 9)
        at = packed_at(head)
        name = compression_of(head[at:]) if at >= 0 else ""
        data = pos + at if at >= 0 else pos + 37
        return ChunkPlace(pos, 9 + length, start, stop, size, crc, name, data, end - data, what)


def record_length(head: bytes) -> int:
    """Length that the 9 bytes at the beginning of a record declare."""
    return int.from_bytes(head[1:9], "little")


def batch_of(buffer: np.ndarray, columns: np.ndarray | list[np.ndarray], position: int) -> RawBatch:
    """A batch from the result of `scan_mcap`."""
    channel, offset, length, log_time, publish_time, sequence = columns
    return RawBatch(buffer, channel, offset, length, log_time, publish_time, sequence, position)
