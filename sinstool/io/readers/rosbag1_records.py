"""Records of a ROS 1 bag: a header of named fields, and data behind it."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from sinstool.io.readers.log import Channel

MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
_METADATA = ("md5sum", "callerid", "latching")


class BadRecordError(ValueError):
    """Bytes that are no bag record."""


@dataclass(frozen=True)
class Record:
    """A record as its header describes it.

    ``problem`` is what is wrong with a chunk that is given in part only.
    """

    op: int
    fields: dict[str, bytes]
    offset: int
    data_offset: int
    data_length: int
    problem: str = ""

    @property
    def end(self) -> int:
        """Where the next record begins."""
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
