"""MCAP output in bulk: the order of the file, its summary and its indexes.

:mod:`~sinstool.io.writers.mcap_chunk` makes the chunks; the mcap package makes most other records.
The file has everything that existing readers rely on: an index for every channel of every chunk, no
chunk without messages, statistics, repeated schemas and channels, and summary offsets.
"""

from __future__ import annotations

import struct
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Sequence
from concurrent.futures import Future
from typing import IO

import mcap.records as records
from isal.isal_zlib import crc32
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from sinstool.core.threads import executor
from sinstool.io.readers.attachments import index_of
from sinstool.io.readers.batch import RawBatch
from sinstool.io.readers.formats import MCAP_MAGIC as MAGIC
from sinstool.io.writers.mcap_chunk import Chunk, pack

_AHEAD = 12 * 2**20  # most bytes accepted but not yet written
_U64 = 2**64 - 1  # times are int64 here and unsigned in the file, with the same bits


class McapWriter:
    """Writes one MCAP file.

    Parameters
    ----------
    stream : binary file
        Open for writing, at its beginning.
    profile : str
        ``ros2`` or ``ros1``.
    library : str
        Name of the writing program for the header.
    compression : {'zstd', 'lz4', 'none'}

    Notes
    -----
    Calls return before their data are in the file: two threads pack chunks, and a third writes
    everything in the order of the calls. An error there is raised by a later call, at the latest by
    `finish`.
    """

    def __init__(
        self, stream: IO[bytes], profile: str, library: str, compression: str = "zstd"
    ) -> None:
        self._stream = stream
        self._position = 0
        self.compression = "" if compression == "none" else compression
        self.schemas: dict[int, records.Schema] = {}
        self._schema_ids: dict[tuple[str, str, bytes], int] = {}
        self.channels: dict[int, records.Channel] = {}
        self.counts: Counter[int] = Counter()
        self._chunk_indexes: list[bytes] = []  # records of the summary
        self._attachment_indexes: list[records.AttachmentIndex] = []
        self._metadata_indexes: list[records.MetadataIndex] = []
        self._span: tuple[int, int] | None = None
        self._packers = executor(2, "sinstool-pack")
        self._file = executor(1, "sinstool-write")
        self._queue: deque[tuple[Future[None], int]] = deque()
        self._waiting = 0  # bytes in the queue
        self._write(MAGIC)
        self._write_record(records.Header(profile, library))

    # -- definitions -----------------------------------------------------------------------

    def add_schema(self, name: str, encoding: str, data: bytes, number: int | None = None) -> int:
        """Define a schema, or find an equal one that is defined already.

        Parameters
        ----------
        number : int, optional
            Id to give it; by default the next free one.
        """
        if number is None:
            same = self._schema_ids.get((name, encoding, data))
            if same is not None:
                return same
            number = _free(self.schemas)
        self._schema_ids.setdefault((name, encoding, data), number)
        schema = records.Schema(id=number, name=name, encoding=encoding, data=data)
        self.schemas[number] = schema
        self._enqueue(lambda: self._write_record(schema), len(data))
        return number

    def add_channel(
        self,
        topic: str,
        encoding: str,
        schema: int,
        metadata: dict[str, str],
        number: int | None = None,
    ) -> int:
        """Define a channel.

        Parameters
        ----------
        schema : int
            Its schema's id; 0 for none.
        number : int, optional
            Id to give it; by default the next free one.
        """
        if number is None:
            number = _free(self.channels)
        channel = records.Channel(
            id=number, topic=topic, message_encoding=encoding, metadata=metadata, schema_id=schema
        )
        self.channels[number] = channel
        self._enqueue(lambda: self._write_record(channel), 0)
        return number

    # -- messages --------------------------------------------------------------------------

    def write(self, parts: Sequence[RawBatch]) -> None:
        """Write messages, merged by log time, in chunks of about 1 MiB.

        Parameters
        ----------
        parts : sequence of RawBatch
            All messages of one span of time; calls are in the order of time.
        """
        self.write_made(lambda: parts, sum(int(p.length.sum()) for p in parts))

    def write_made(self, make: Callable[[], Sequence[RawBatch]], size: int) -> None:
        """Write messages as `write` does, but make them in one of the packing threads.

        Parameters
        ----------
        make : callable
            Returns what `write` takes.
        size : int
            Bytes of their payloads.
        """
        packed = self._packers.submit(pack, make, self.compression)

        def write() -> None:
            for chunk in packed.result():
                self._write_chunk(chunk)

        self._enqueue(write, size)

    def write_chunk(self, read: Callable[[], Chunk], size: int) -> None:
        """Write a chunk of another file unchanged.

        Parameters
        ----------
        read : callable
            Returns the chunk; called when it is to be written.
        size : int
            Compressed size of its messages, bytes.
        """
        self._enqueue(lambda: self._write_chunk(read()), size)

    # -- the rest --------------------------------------------------------------------------

    def write_record_bytes(self, opcode: int, record: bytes) -> None:
        """Write a top-level record unchanged; metadata and attachments are indexed.

        Parameters
        ----------
        record : bytes
            The whole record, its 9-byte head included. Attachments and metadata have to be sound
            (see `index_of`).
        """

        def write() -> None:
            index = index_of(opcode, record, self._position)
            self._write(record)
            if isinstance(index, records.MetadataIndex):
                self._metadata_indexes.append(index)
            elif index is not None:
                self._attachment_indexes.append(index)

        self._enqueue(write, len(record))

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a Metadata record; characters outside UTF-8 become ``?``."""
        texts = {key: value.encode("utf-8", "replace").decode() for key, value in values.items()}
        record = records.Metadata(name=name, metadata=texts)
        self.write_record_bytes(Opcode.METADATA, _bytes_of(record))

    def finish(self) -> None:
        """Write everything that is queued, the summary and the footer."""
        while self._queue:
            self._await_first()
        self._packers.shutdown()
        self._file.shutdown()
        self._write_record(records.DataEnd(data_section_crc=0))
        self._write_summary()
        self._write(MAGIC)

    def abort(self) -> None:
        """Drop all queued records; the file is unusable afterwards."""
        self._queue.clear()
        self._packers.shutdown(wait=True, cancel_futures=True)
        self._file.shutdown(wait=True, cancel_futures=True)

    # -- inside ----------------------------------------------------------------------------

    def _enqueue(self, write: Callable[[], None], size: int) -> None:
        """Queue a record; records are written in the order of the calls."""
        self._queue.append((self._file.submit(write), size))
        self._waiting += size
        while self._queue and (self._waiting > _AHEAD or self._queue[0][0].done()):
            self._await_first()

    def _await_first(self) -> None:
        written, size = self._queue.popleft()
        self._waiting -= size
        written.result()

    def _write(self, data: bytes | memoryview) -> None:
        self._stream.write(data)
        self._position += len(data)

    def _write_record(self, record: records.McapRecord) -> None:
        self._write(_bytes_of(record))

    def _write_chunk(self, chunk: Chunk) -> None:
        start = self._position
        for piece in chunk.record:
            self._write(piece)
        index_start = self._position
        offsets, at, pieces = [], index_start, []
        for channel, entries in chunk.indexes:
            offsets += [channel, at]
            pieces.append(
                struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + len(entries), channel, len(entries))
            )
            pieces.append(entries)
            at += 15 + len(entries)
        self._write(b"".join(pieces))
        self._chunk_indexes.append(_chunk_index(chunk, start, index_start, at, offsets))
        self.counts.update(chunk.counts)
        low, high = self._span or (chunk.start_time, chunk.end_time)
        self._span = (min(low, chunk.start_time), max(high, chunk.end_time))

    def _write_summary(self) -> None:
        start = self._position
        low, high = self._span or (0, 0)
        statistics = records.Statistics(
            attachment_count=len(self._attachment_indexes),
            channel_count=len(self.channels),
            channel_message_counts={c: self.counts[c] for c in self.channels},
            chunk_count=len(self._chunk_indexes),
            message_count=sum(self.counts.values()),
            message_end_time=high & _U64,
            message_start_time=low & _U64,
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self.schemas),
        )
        groups: list[tuple[int, Iterable[bytes]]] = [
            (Opcode.SCHEMA, map(_bytes_of, self.schemas.values())),
            (Opcode.CHANNEL, map(_bytes_of, self.channels.values())),
            (Opcode.STATISTICS, [_bytes_of(statistics)]),
            (Opcode.CHUNK_INDEX, self._chunk_indexes),
            (Opcode.ATTACHMENT_INDEX, map(_bytes_of, self._attachment_indexes)),
            (Opcode.METADATA_INDEX, map(_bytes_of, self._metadata_indexes)),
        ]
        summary = bytearray()
        offsets = bytearray()
        for opcode, members in groups:
            begin = len(summary)
            summary += b"".join(members)
            if len(summary) > begin:
                offset = records.SummaryOffset(opcode, start + begin, len(summary) - begin)
                offsets += _bytes_of(offset)
        offset_start = start + len(summary)
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
        crc = crc32(bytes(summary) + bytes(offsets) + footer)
        self._write(bytes(summary) + bytes(offsets) + footer + struct.pack("<I", crc))


def _chunk_index(chunk: Chunk, start: int, end: int, after: int, offsets: list[int]) -> bytes:
    """Chunk index record for the summary.

    Parameters
    ----------
    start, end, after : int
        Offsets in the file at which the chunk begins and ends, and its message indexes end.
    offsets : list of int
        Channel id and offset of each message index, alternating.
    """
    name = chunk.compression.encode()
    pairs = len(offsets) // 2
    body = struct.pack(
        f"<QQQQI{'HQ' * pairs}QI{len(name)}sQQ",
        chunk.start_time & _U64,
        chunk.end_time & _U64,
        start,
        end - start,
        10 * pairs,
        *offsets,
        after - end,
        len(name),
        name,
        chunk.compressed_size,
        chunk.size,
    )
    return struct.pack("<BQ", Opcode.CHUNK_INDEX, len(body)) + body


def _bytes_of(record: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def _free(taken: Collection[int]) -> int:
    """A free id: the largest plus one, or the first gap if 16 bits cannot hold that."""
    behind = max(taken, default=0) + 1
    if behind < 2**16:
        return behind
    return next(number for number in range(1, 2**16) if number not in taken)
