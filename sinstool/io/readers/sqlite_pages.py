"""Rows on the pages of a bag's SQLite file that its tree of pages no longer leads to.

A page inside the tree lies anywhere in the file, and where the file is cut short the one that
leads to its beginning may be missing. The pages with the rows tell themselves what they are, so
that they can be found without: https://www.sqlite.org/fileformat2.html, sections 1.6 and 2.1.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

_LEAF = 0x0D  # first byte of a page with rows of a table
_LONGEST_VARINT = 9

Row = tuple[int, int, int, bytes]
"""Row id, topic, time and data of a message."""


class Pages:
    """The pages of a file.

    Parameters
    ----------
    path : Path
    columns : list of str
        Of the table of messages, in order.
    is_topic : callable
        Whether there is a topic of a number.
    """

    def __init__(self, path: Path, columns: list[str], is_topic: Callable[[int], bool]) -> None:
        self._path = path
        self._columns = columns
        self._is_topic = is_topic
        with path.open("rb") as stream:
            head = stream.read(100)
        (size,) = struct.unpack_from(">H", head, 16)
        self._size = 65536 if size == 1 else size
        self._usable = self._size - head[20]

    def messages(self, after: int) -> Iterator[Row]:
        """Messages in the order of their rows, those after a row, from all whole pages."""
        with self._path.open("rb") as stream:
            firsts = []
            number = 2  # the first page holds the schema
            while page := self._page(stream, number):
                rows = self._rows(page, stream)
                if (first := next(rows, None)) is not None:
                    firsts.append((first[0], number))
                number += 1
            for _, number in sorted(firsts):
                for row in self._rows(self._page(stream, number), stream):
                    if row[0] > after:
                        yield row

    def _page(self, stream: BinaryIO, number: int) -> bytes:
        """A page; nothing where the file has no such whole page."""
        stream.seek((number - 1) * self._size)
        page = stream.read(self._size)
        return page if len(page) == self._size else b""

    def _rows(self, page: bytes, stream: BinaryIO) -> Iterator[Row]:
        """Messages on a page; none if it is of another kind."""
        if page[0] != _LEAF:
            return
        (count,) = struct.unpack_from(">H", page, 3)
        if 8 + 2 * count > self._size:
            return
        for at in struct.unpack_from(f">{count}H", page, 8):
            try:
                row = self._row(page, at, stream)
            except (IndexError, struct.error):
                continue
            if row is not None:
                yield row

    def _row(self, page: bytes, at: int, stream: BinaryIO) -> Row | None:
        """The message of a cell; None if it is none, or not all of it is there."""
        length, at = _varint(page, at)
        number, at = _varint(page, at)
        payload = self._payload(page, at, length, stream)
        if len(payload) < length:
            return None
        header, position = _varint(payload, 0)
        types = []
        while position < header:
            kind, position = _varint(payload, position)
            types.append(kind)
        if len(types) != len(self._columns):
            return None
        values: dict[str, int | bytes | None] = {}
        for name, kind in zip(self._columns, types, strict=True):
            values[name], position = _value(payload, position, kind)
        topic, time, data = (values.get(name) for name in ("topic_id", "timestamp", "data"))
        if isinstance(topic, int) and isinstance(time, int) and isinstance(data, bytes):
            return (number, topic, time, data) if self._is_topic(topic) else None
        return None

    def _payload(self, page: bytes, at: int, length: int, stream: BinaryIO) -> bytes:
        """The payload of a cell, with what of it is on other pages, as far as they are there."""
        if length > self._file_size(stream):
            return b""
        here = self._here(length)
        payload = bytearray(page[at : at + min(here, length)])
        if here >= length:
            return bytes(payload)
        (following,) = struct.unpack_from(">I", page, at + here)
        while following and len(payload) < length:
            more = self._page(stream, following)
            if not more:
                break
            (following,) = struct.unpack_from(">I", more, 0)
            payload += more[4 : min(self._usable, 4 + length - len(payload))]
        return bytes(payload)

    def _file_size(self, stream: BinaryIO) -> int:
        return stream.seek(0, 2)

    def _here(self, length: int) -> int:
        """How much of a payload is on the page of its cell."""
        most = self._usable - 35
        if length <= most:
            return length
        least = (self._usable - 12) * 32 // 255 - 23
        kept = least + (length - least) % (self._usable - 4)
        return kept if kept <= most else least


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """A number of one to nine bytes, and where the next begins."""
    value = 0
    for k in range(_LONGEST_VARINT):
        byte = data[at + k]
        if k == _LONGEST_VARINT - 1:
            return value << 8 | byte, at + k + 1
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            break
    return value, at + k + 1


def _value(payload: bytes, at: int, kind: int) -> tuple[int | bytes | None, int]:
    """A value of a record, and where the next begins; of other types than a bag's None."""
    if kind >= 12:
        end = at + (kind - 12) // 2
        return (payload[at:end] if kind % 2 == 0 else None), end
    if kind in (8, 9):
        return kind - 8, at
    size = (0, 1, 2, 3, 4, 6, 8, 8, 0, 0, 0, 0)[kind]
    if not 1 <= kind <= 6:
        return None, at + size
    return int.from_bytes(payload[at : at + size], "big", signed=True), at + size
