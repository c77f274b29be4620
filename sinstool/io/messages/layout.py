"""The place of each field in a message, derived from the definition and the bytes.

A message's layout depends on its definition and on the lengths of its strings and sequences.
`walk` reads those lengths from one message and notes them as *guards*: any other message in
which every guard holds has the same layout, whatever its total length says (two frame names of
7 and 8 characters can pad to the same size).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np

from sinstool.io.messages.definitions import Definition, FieldType

CDR_HEADER = 4
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
# numpy's codes of the primitives, without byte order
_CODES = ("i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f4", "f8")
NUMPY = {np.dtype(code).name: code for code in _CODES}
NUMPY |= dict.fromkeys(("bool", "byte", "char"), "u1")
SIZES = {name: np.dtype(code).itemsize for name, code in NUMPY.items()}
# Most elements of a sequence of messages or strings: no type that is read has more, and a hostile
# length must not cost memory.
MAX_ELEMENTS = 4096
# Most fields of one message. Nested empty types take no bytes, so that the size is no limit.
MAX_FIELDS = 2**17


class LayoutError(ValueError):
    """A message does not fit its definition."""


@dataclass(frozen=True)
class Leaf:
    """A primitive, or a run of equal primitives without gaps.

    Attributes
    ----------
    offset : int
        Bytes from the start of the payload (for CDR the encapsulation header included).
    dtype : str
        numpy code without byte order, such as ``f8``.
    count : int
        Number of elements; 1 for a plain field, 0 for an empty sequence.
    """

    offset: int
    dtype: str
    count: int


@dataclass
class Layout:
    """Offsets of the fields of one message.

    Attributes
    ----------
    leaves : dict
        Dotted path to Leaf. Elements of sequences of messages are ``path[i].field``; a string
        is a Leaf of bytes without its terminator.
    guards : list of (int, bytes)
        Offsets, and the bytes that a message must have there for this layout to apply.
    size : int
        Bytes that all fields take.
    big_endian : bool
        Byte order of the payload.
    """

    leaves: dict[str, Leaf] = field(default_factory=dict)
    guards: list[tuple[int, bytes]] = field(default_factory=list)
    size: int = 0
    big_endian: bool = False

    def text(self, path: str, payload: bytes) -> str:
        """Text of a string field in a message with this layout."""
        leaf = self.leaves[path]
        raw = bytes(payload[leaf.offset : leaf.offset + leaf.count])
        return raw.decode("utf-8", errors="replace")


def walk(definition: Definition, payload: bytes) -> Layout:
    """Lay out one message.

    Parameters
    ----------
    definition : Definition
        Its type, with the encoding it is serialised in.
    payload : bytes
        The serialised message.

    Raises
    ------
    LayoutError
        The payload is too short for its type, declares impossible lengths, or uses an
        encapsulation other than plain CDR.
    """
    return _Walker(definition, bytes(payload)).run()


class _Descent(ABC):
    """Recursive descent through the fields of a message, with their paths."""

    def __init__(self, definition: Definition) -> None:
        self.definition = definition
        self.cdr = definition.encoding == "cdr"
        self.fields = 0

    @abstractmethod
    def _primitives(self, name: str, path: str, count: int) -> None:
        """Handle a run of primitives of one type, or a single string."""

    @abstractmethod
    def _count(self, ftype: FieldType, path: str, run: bool) -> int:
        """Number of elements of an array or a sequence; `run`: of primitives without gaps."""

    def _message(self, name: str, prefix: str) -> None:
        for field_name, ftype in self.definition.fields(name):
            self._field(ftype, f"{prefix}.{field_name}" if prefix else field_name)

    def _field(self, ftype: FieldType, path: str) -> None:
        self.fields += 1
        if self.fields > MAX_FIELDS:
            raise LayoutError(f"{self.definition.name} has more than {MAX_FIELDS} fields")
        if ftype.kind == "base":
            self._primitives(ftype.name, path, 1)
        elif ftype.kind == "message":
            self._message(ftype.name, path)
        elif ftype.element == "base" and ftype.name != "string":
            self._primitives(ftype.name, path, self._count(ftype, path, True))
        else:
            for index in range(self._count(ftype, path, False)):
                element = f"{path}[{index}]"
                if ftype.element == "base":
                    self._primitives(ftype.name, element, 1)
                else:
                    self._message(ftype.name, element)


class _Walker(_Descent):
    """The descent that `walk` makes, with its position in the payload."""

    def __init__(self, definition: Definition, payload: bytes) -> None:
        super().__init__(definition)
        self.payload = payload
        self.layout = Layout()
        self.pos = 0

    def run(self) -> Layout:
        if self.cdr:
            self._encapsulation()
        self._message(self.definition.name, "")
        self.layout.size = self.pos
        surplus = len(self.payload) - self.pos
        # Middlewares pad CDR payloads to 4 or 8 bytes; ROS 1 never pads.
        if surplus < 0 or surplus > (7 if self.cdr else 0):
            raise LayoutError(
                f"payload has {len(self.payload)} bytes, {self.definition.name} takes {self.pos}"
            )
        return self.layout

    def _encapsulation(self) -> None:
        head = self.payload[:CDR_HEADER]
        if len(head) < CDR_HEADER:
            raise LayoutError(f"payload of {len(head)} bytes is too short for CDR")
        if head == ZSTD_MAGIC:
            raise LayoutError("payload is compressed by zstd: open the bag's folder, not one file")
        if head[0] != 0 or head[1] not in (0, 1):
            kind = {6: "XCDR2", 7: "XCDR2", 2: "PL_CDR", 3: "PL_CDR"}.get(head[1], "unknown")
            raise LayoutError(
                f"CDR encapsulation 0x{head[:2].hex()} ({kind}); plain CDR (0x0000, 0x0001) is read"
            )
        self.layout.big_endian = head[1] == 0
        self.layout.guards.append((0, head[:2]))
        self.pos = CDR_HEADER

    def _align(self, size: int) -> None:
        if self.cdr:
            self.pos = CDR_HEADER + (self.pos - CDR_HEADER + size - 1) // size * size

    def _length(self) -> int:
        self._align(4)
        raw = self.payload[self.pos : self.pos + 4]
        if len(raw) < 4:
            raise LayoutError(f"payload ends at byte {len(self.payload)} inside a length")
        self.layout.guards.append((self.pos, raw))
        self.pos += 4
        return int.from_bytes(raw, "big" if self.layout.big_endian else "little")

    def _need(self, size: int) -> None:
        if self.pos + size > len(self.payload):
            raise LayoutError(
                f"payload ends at byte {len(self.payload)}, {self.definition.name} goes on"
            )

    def _count(self, ftype: FieldType, path: str, run: bool) -> int:
        count = ftype.count if ftype.kind == "array" else self._length()
        # Every element takes at least one byte, so a larger number is damage.
        if not run and count > len(self.payload) - self.pos:
            raise LayoutError(f"{path} declares {count} elements in {len(self.payload)} bytes")
        if not run and count > MAX_ELEMENTS:
            raise LayoutError(f"{path} has {count} elements; at most {MAX_ELEMENTS} are read")
        return count

    def _primitives(self, name: str, path: str, count: int) -> None:
        if name == "string":
            self._string(path)
            return
        if name not in SIZES:
            raise LayoutError(f"{path} is of type {name}, which is not read")
        size = SIZES[name]
        if count:
            self._align(size)
        self._need(size * count)
        self.layout.leaves[path] = Leaf(self.pos, NUMPY[name], count)
        self.pos += size * count

    def _string(self, path: str) -> None:
        length = self._length()
        self._need(length)
        # CDR counts the terminating NUL; some writers leave it out of empty strings.
        text = length - 1 if self.cdr and length else length
        self.layout.leaves[path] = Leaf(self.pos, "u1", text)
        self.pos += length


def template(
    definition: Definition, strings: dict[str, str], lengths: dict[str, int]
) -> tuple[Layout, np.ndarray]:
    """Layout and zero-filled payload of a message that is to be written.

    Parameters
    ----------
    definition : Definition
        Type and encoding.
    strings : dict
        Text of string fields by path; others are empty.
    lengths : dict
        Length of sequences by path; others are empty.

    Returns
    -------
    layout : Layout
    payload : ndarray, shape (size,), uint8
        Little-endian, lengths and strings in place.
    """
    return _Builder(definition, strings, lengths).run()


class _Builder(_Descent):
    """The descent that `template` makes: it writes a payload, whose layout `walk` then finds."""

    def __init__(
        self, definition: Definition, strings: dict[str, str], lengths: dict[str, int]
    ) -> None:
        super().__init__(definition)
        self.strings = strings
        self.lengths = lengths
        self.out = bytearray(b"\x00\x01\x00\x00" if self.cdr else b"")

    def run(self) -> tuple[Layout, np.ndarray]:
        self._message(self.definition.name, "")
        layout = walk(self.definition, bytes(self.out))
        return layout, np.frombuffer(bytes(self.out), np.uint8)

    def _align(self, size: int) -> None:
        if self.cdr:
            self.out += bytes(-(len(self.out) - CDR_HEADER) % size)

    def _put_length(self, value: int) -> None:
        self._align(4)
        self.out += value.to_bytes(4, "little")

    def _count(self, ftype: FieldType, path: str, run: bool) -> int:
        if ftype.kind == "array":
            return ftype.count
        count = self.lengths.get(path, 0)
        self._put_length(count)
        return count

    def _primitives(self, name: str, path: str, count: int) -> None:
        if name == "string":
            raw = self.strings.get(path, "").encode() + (b"\0" if self.cdr else b"")
            self._put_length(len(raw))
            self.out += raw
            return
        if count:
            self._align(SIZES[name])
        self.out += bytes(SIZES[name] * count)
