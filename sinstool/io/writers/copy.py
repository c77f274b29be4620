"""The input's own messages copied to the output, interleaved with ours by time."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from mcap.opcode import Opcode
from mcap.records import MetadataIndex

from sinstool.core.finding import Finding
from sinstool.io.messages.definitions import (
    ENCODINGS,
    DefinitionError,
    normalise_type_name,
    schema_text,
)
from sinstool.io.readers.attachments import CHECKED, RecordError, index_of
from sinstool.io.readers.batch import RawBatch
from sinstool.io.readers.log import Channel, Log
from sinstool.io.readers.mcap import McapLog
from sinstool.io.readers.mcap_file import ChunkPlace, OtherPlace
from sinstool.io.writers.mcap import McapWriter
from sinstool.io.writers.mcap_chunk import Chunk, message_indexes

_START, _END = np.iinfo(np.int64).min, np.iinfo(np.int64).max
# Compressions that the MCAP format defines; chunks with others are compressed anew
COPIED = ("", "lz4", "zstd")


@dataclass(frozen=True)
class _Chunk:
    """A chunk of the input and its message index records."""

    place: ChunkPlace
    indexes: list[OtherPlace]


class Copier:
    """Copies a log into a writer, up to the time of the results.

    MCAP chunks with a complete message index are copied without decompression; everything else is
    written anew, with unchanged payloads.

    Parameters
    ----------
    writer : McapWriter
        It gets the log's schemas and channels, under their own ids if the log is MCAP.

    Attributes
    ----------
    findings : list of Finding
        Message definitions that neither the log nor, therefore, the output has.

    Raises
    ------
    DamagedLogError
        A channel or a record is inconsistent and the log is not read with `salvage`; with it, such
        a record is left out and noted in the log's `lost`.
    """

    def __init__(self, log: Log, writer: McapWriter) -> None:
        self._log = log
        self._writer = writer
        self._wide: np.ndarray | None = None
        self.findings: list[Finding] = []
        self._define()
        self._items = self._mcap_items(log) if isinstance(log, McapLog) else log.batches()
        self._next = next(self._items, None)

    def advance(self, until_ns: int) -> None:
        """Copy everything that begins at or before a log time."""
        while self._next is not None and self._begins(self._next) <= until_ns:
            self._copy(self._next)
            self._next = next(self._items, None)

    def finish(self) -> None:
        """Copy the rest of the log, with the attachments and metadata of its files."""
        self.advance(_END)
        for part in self._log.parts:
            if not isinstance(part, McapLog):
                continue
            for place in part.places():
                if isinstance(place, OtherPlace) and place.opcode in CHECKED:
                    self._copy_record(part, place)

    def _define(self) -> None:
        if isinstance(self._log, McapLog):
            self._define_as_in(self._log)
            return
        numbers = sorted(self._log.channels)
        if numbers and numbers[-1] >= 2**16:  # bags have room for more than MCAP
            self._wide = np.array(numbers)
        undefined: dict[str, Channel] = {}
        for place, number in enumerate(numbers):
            channel = self._log.channels[number]
            schema = _schema(channel)
            if not schema[2]:
                undefined.setdefault(channel.type, channel)
            self._writer.add_channel(
                channel.recorded_topic,
                channel.message_encoding,
                self._writer.add_schema(*schema),
                channel.metadata,
                number if self._wide is None else place,
            )
        for type_name, channel in undefined.items():
            encoding = channel.message_encoding
            why = "not a standard type" if encoding in ENCODINGS else f"encoded as '{encoding}'"
            text = (
                f"the log has no definition of {type_name}, and it is {why}: the messages of"
                f" {channel.topic} are copied without one, and viewers cannot show them"
            )
            self.findings.append(Finding("no-definition", text, topic=channel.topic))

    def _define_as_in(self, log: McapLog) -> None:
        """Define the schemas and channels of an MCAP file under their own ids."""
        for number, schema in log.schemas.items():
            self._writer.add_schema(schema.name, schema.encoding, schema.data, number)
        for number, channel in log.channels.items():
            schema_id = log.schema_ids[number]
            if schema_id and schema_id not in log.schemas:
                what = (
                    f"the definition of topic {channel.topic}: its channel points to schema"
                    f" {schema_id}, which the log does not have"
                )
                log.damage(what, kind="definition")
                schema_id = 0  # no schema, which the format allows
            self._writer.add_channel(
                channel.recorded_topic,
                channel.message_encoding,
                schema_id,
                channel.metadata,
                number,
            )

    @staticmethod
    def _mcap_items(log: McapLog) -> Iterator[_Chunk | RawBatch | OtherPlace]:
        """Top-level records of an MCAP file, with the index records of each chunk joined to it."""
        chunk: _Chunk | None = None
        for place in log.places():
            if isinstance(place, OtherPlace) and place.opcode == Opcode.MESSAGE_INDEX:
                if chunk is not None:
                    chunk.indexes.append(place)
                continue
            if chunk is not None:
                yield chunk
                chunk = None
            if isinstance(place, ChunkPlace):
                chunk = _Chunk(place, [])
            else:
                yield place
        if chunk is not None:
            yield chunk

    @staticmethod
    def _begins(item: _Chunk | RawBatch | OtherPlace) -> int:
        if isinstance(item, _Chunk):
            # Later ones are no times: of a chunk without messages, say, or damaged
            return item.place.start_time if item.place.start_time <= _END else _START
        if isinstance(item, RawBatch) and len(item):
            return int(item.log_time[0])
        return _START

    def _copy(self, item: _Chunk | RawBatch | OtherPlace) -> None:
        if isinstance(item, RawBatch):
            # A message of an undefined channel would make the output unreadable.
            messages = item.select(self._log.channels.keys())
            if self._wide is not None:
                messages = replace(messages, channel=np.searchsorted(self._wide, messages.channel))
            self._writer.write([messages])
        elif isinstance(item, _Chunk):
            self._copy_chunk(item)
        elif item.opcode not in (Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL):
            assert isinstance(self._log, McapLog)
            self._copy_record(self._log, item)

    def _copy_record(self, log: McapLog, place: OtherPlace) -> None:
        """Copy a top-level record unchanged, if it is valid."""
        record = log.read_at(place.offset, place.length)
        try:
            index = index_of(place.opcode, record, place.offset)
        except RecordError as exc:
            kind = CHECKED[Opcode(place.opcode)]
            what = f"an {kind}" if kind == "attachment" else f"a {kind} record"
            log.damage(f"{what} cannot be copied: {exc}", place.offset, kind)
            return
        # rosbag2's metadata describes one file of a bag, which is wrong for their union.
        of_file = isinstance(index, MetadataIndex) and index.name == "rosbag2"
        if log is self._log or not of_file:
            self._writer.write_record_bytes(place.opcode, record)

    def _copy_chunk(self, chunk: _Chunk) -> None:
        log, place = self._log, chunk.place
        assert isinstance(log, McapLog)
        indexes = self._own_indexes(chunk)
        anew = place.offset in log.broken or place.compression not in COPIED
        if indexes is None or log.salvage or anew:
            batch = log.chunk_batch(place)
            if not len(batch):
                return
            defined = batch.select(log.channels.keys())
            if place.offset in log.broken or anew or len(defined) < len(batch):
                self._writer.write([defined])
                return
            # 31 bytes of record head and fixed fields stand before each payload
            indexes = message_indexes(batch.channel, batch.log_time, batch.offset - 31)[0]
            times = int(batch.log_time.min()), int(batch.log_time.max())
        else:
            times = place.start_time, place.end_time
        if not indexes:
            return
        described = (indexes, *times, place.compression, place.data_length, place.size)
        self._writer.write_chunk(
            lambda: Chunk((log.read_at(place.offset, place.length),), *described),
            place.data_length,
        )

    def _own_indexes(self, chunk: _Chunk) -> list[tuple[int, bytes]] | None:
        """The chunk's message index in the log; None if it is damaged or incomplete."""
        log = self._log
        assert isinstance(log, McapLog)
        entries_of: list[tuple[int, bytes]] = []
        for place in chunk.indexes:
            record = log.read_at(place.offset, place.length)
            if len(record) < 15:
                return None
            channel, size = struct.unpack_from("<HI", record, 9)
            entries = record[15:]
            if size != len(entries) or size % 16 or channel not in log.channels:
                return None
            if entries:
                entries_of.append((channel, entries))
        counts = {channel: len(entries) // 16 for channel, entries in entries_of}
        defined = log.chunk_counts.get(chunk.place.offset)
        if defined is None or defined != counts:
            return None
        return entries_of


def _schema(channel: Channel) -> tuple[str, str, bytes]:
    """Name, encoding and text of the schema of a channel that comes from a bag."""
    text = channel.schema_text
    encoding = channel.schema_encoding or (
        "ros1msg" if channel.message_encoding == "ros1" else "ros2msg"
    )
    if not text and channel.message_encoding not in ENCODINGS:
        encoding = ""
    elif not text:
        # Old ROS 2 bags carry no definitions; fall back on those of the standard types.
        try:
            text = schema_text(normalise_type_name(channel.type_name), channel.message_encoding)
        except DefinitionError:
            text = ""
    return channel.recorded_type, encoding, text.encode()
