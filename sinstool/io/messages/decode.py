"""Columns from bytes: selected fields of many messages in one compiled pass."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sinstool.core.parts import kernel, part
from sinstool.io.messages.definitions import Definition
from sinstool.io.messages.layout import NUMPY, Layout, LayoutError, Leaf, walk

# Layouts kept for a topic. A topic with more of them (JointState messages of changing size) is
# decoded one message at a time.
MAX_LAYOUTS = 64
# Most bytes in one row of a column; a covariance of 6 x 6 takes 288
MAX_ROW = 65536
_BY_NAME = re.compile(r"^(?P<array>[^\[\]]+)\[(?P<names>[^=\[\]]+)=(?P<name>.*)\]$")


@dataclass(frozen=True)
class Columns:
    """Decoded columns of a number of messages.

    Attributes
    ----------
    values : dict
        Column name to array (n,) or (n, k); rows that are not valid hold zeros.
    valid : ndarray of bool, shape (n,)
        False where a message does not fit its definition or lacks the field.
    """

    values: dict[str, np.ndarray]
    valid: np.ndarray


class _Plan(NamedTuple):
    """A layout as arrays, in the order of the kernel's arguments."""

    length: int
    guard_offset: np.ndarray
    guard_byte: np.ndarray
    big_endian: bool
    source: np.ndarray  # byte offset of each piece in the payload
    column: np.ndarray  # column of each piece
    within: np.ndarray  # byte offset of each piece inside the column's row
    size: np.ndarray  # bytes in each piece
    item: np.ndarray  # item size, for byte swapping


class Decoder:
    """Gathers columns from the messages of one topic.

    Layouts are determined from the bytes and kept, so that a batch of messages of the same layout
    takes one compiled pass and makes no Python object per message.

    Parameters
    ----------
    definition : Definition
        The topic's type and encoding.
    columns : mapping of str to sequence of str
        Column name to the paths that make up one row of it, of equal type, such as
        ``{"gyro": ["angular_velocity.x", "angular_velocity.y", "angular_velocity.z"]}``. A path
        to a fixed array gives all its elements. ``position[name=table]`` is the element of
        the sequence ``position`` at the index of the string ``table`` in the sequence ``name``.

    Attributes
    ----------
    problem : str
        Why the first message that is not valid could not be decoded; '' so far.

    Raises
    ------
    LayoutError
        If a column has too many elements or, while decoding, its paths are of several types.
    """

    def __init__(self, definition: Definition, columns: Mapping[str, Sequence[str]]) -> None:
        self.definition = definition
        self.columns = {name: tuple(paths) for name, paths in columns.items()}
        self._plans: list[_Plan] = []
        self._dtypes: dict[str, tuple[str, int]] = {}
        for name, paths in self.columns.items():
            shapes = [_declared(definition, path) for path in paths]
            if None not in shapes and len({s[0] for s in shapes if s}) == 1:
                width = sum(s[1] for s in shapes if s)
                if width > MAX_ROW // 8:
                    raise LayoutError(f"{paths[0]} has {width} elements")
                self._dtypes[name] = shapes[0][0], width  # type: ignore[index]
        self.problem = ""

    def decode(self, buffer: np.ndarray, offset: np.ndarray, length: np.ndarray) -> Columns:
        """Gather columns from messages in a buffer.

        Parameters
        ----------
        buffer : ndarray, uint8
            Bytes that hold the payloads.
        offset, length : ndarray of int64, shape (n,)
            Where each payload starts and how long it is.
        """
        count = len(offset)
        done = np.zeros(count, np.bool_)
        valid = np.zeros(count, np.bool_)
        if len(self._dtypes) < len(self.columns) and not self._prime(buffer, offset, length):
            return Columns(self._empty(count), valid)
        names = list(self.columns)
        shapes = [self._dtypes[name] for name in names]
        sizes = np.array([np.dtype(dtype).itemsize * width for dtype, width in shapes], np.int64)
        # Each column starts on 8 bytes, so that its view is an aligned array.
        base = _bases(sizes * count)
        out = np.zeros(int(base[-1]), np.uint8)
        for plan in self._plans:
            _gather(buffer, offset, length, *plan, *_views(out), base, sizes, done, valid)
            if done.all():
                break
        while not done.all():
            index = int(np.argmin(done))
            new = self._plan_for(buffer, int(offset[index]), int(length[index]))
            if new is None:
                done[index] = True
            elif len(self._plans) < MAX_LAYOUTS:
                self._plans.append(new)
                _gather(buffer, offset, length, *new, *_views(out), base, sizes, done, valid)
            else:
                one = slice(index, index + 1)
                part = np.zeros(1, np.bool_), np.zeros(1, np.bool_)
                row_base = _bases(sizes)
                row = np.zeros(int(row_base[-1]), np.uint8)
                views = _views(row)
                _gather(buffer, offset[one], length[one], *new, *views, row_base, sizes, *part)
                for k in range(len(names)):
                    begin = int(base[k] + index * sizes[k])
                    out[begin : begin + sizes[k]] = row[row_base[k] : row_base[k] + sizes[k]]
                done[index], valid[index] = True, part[1][0]
        values = {}
        for k, (name, (dtype, width)) in enumerate(zip(names, shapes, strict=True)):
            column = out[base[k] : base[k] + sizes[k] * count].view("<" + dtype)
            values[name] = column.reshape(count, width) if width > 1 else column
        return Columns(values, valid)

    def _empty(self, count: int) -> dict[str, np.ndarray]:
        """Columns of zeros for messages none of which has a valid layout."""
        empty = {}
        for name, paths in self.columns.items():
            dtype, width = self._dtypes.get(name, ("f8", len(paths)))
            empty[name] = np.zeros((count, width) if width > 1 else count, "<" + dtype)
        return empty

    def _prime(self, buffer: np.ndarray, offset: np.ndarray, length: np.ndarray) -> bool:
        """Take types that the definition leaves open from the first message that fits it."""
        for index in range(len(offset)):
            plan = self._plan_for(buffer, int(offset[index]), int(length[index]))
            if plan is not None:
                self._plans.append(plan)
                return True
        return False

    def _plan_for(self, buffer: np.ndarray, offset: int, length: int) -> _Plan | None:
        payload = buffer[offset : offset + length].tobytes()
        try:
            layout = walk(self.definition, payload)
        except LayoutError as exc:
            self.problem = self.problem or str(exc)
            return None
        guards = list(layout.guards)
        shapes = dict(self._dtypes)
        pieces: list[tuple[int, int, int, int, int]] = []
        for k, (name, paths) in enumerate(self.columns.items()):
            within, kinds = 0, set()
            for path in paths:
                leaf = _resolve(layout, path, payload, guards)
                if leaf is None:
                    self.problem = self.problem or f"a message lacks {path}"
                    return None
                item = np.dtype(leaf.dtype).itemsize
                pieces.append((leaf.offset, k, within, item * leaf.count, item))
                within += item * leaf.count
                kinds.add(leaf.dtype)
            if within > MAX_ROW:
                self.problem = self.problem or f"{paths[0]} takes {within} bytes"
                return None
            if len(kinds) != 1:
                raise LayoutError(f"column {name} mixes the types {sorted(kinds)}")
            dtype = kinds.pop()
            shape = (dtype, within // np.dtype(dtype).itemsize)
            if shapes.setdefault(name, shape) != shape:
                self.problem = self.problem or f"a message has another number of {paths[0]}"
                return None
        self._dtypes = shapes
        guard = [(at + i, byte) for at, raw in guards for i, byte in enumerate(raw)]
        merged = np.array(_merge(pieces), np.int64).reshape(-1, 5)
        return _Plan(
            length,
            np.array([g[0] for g in guard], np.int64),
            np.array([g[1] for g in guard], np.uint8),
            layout.big_endian,
            *np.ascontiguousarray(merged.T),
        )


def _bases(sizes: np.ndarray) -> np.ndarray:
    """Offsets of the columns and the end of the last, aligned to 8 bytes for views and words."""
    return np.concatenate(([0], np.cumsum((sizes + 7) // 8 * 8)))


def _declared(definition: Definition, path: str) -> tuple[str, int] | None:
    """Type and number of elements of a path, if the definition alone determines them.

    Then even a batch of damaged messages has columns of the right type.
    """
    match = _BY_NAME.match(path)
    *parents, last = (match["array"] if match else path).split(".")
    here = definition.name
    for parent in parents:
        ftype = dict(definition.types.get(here, ())).get(parent.split("[")[0])
        if ftype is None:
            return None
        here = ftype.name
    ftype = dict(definition.types.get(here, ())).get(last)
    if ftype is None or ftype.name not in NUMPY or ftype.kind == "message":
        return None
    if match:
        return NUMPY[ftype.name], 1
    count = {"base": 1, "array": ftype.count}.get(ftype.kind, 0)
    return (NUMPY[ftype.name], count) if count else None


def _resolve(
    layout: Layout, path: str, payload: bytes, guards: list[tuple[int, bytes]]
) -> Leaf | None:
    """The leaf of a column's path in this layout; names that it depends on become guards."""
    match = _BY_NAME.match(path)
    if match is None:
        leaf = layout.leaves.get(path)
        return leaf if leaf is not None and leaf.count else None
    array = layout.leaves.get(match["array"])
    index, row = 0, -1
    while (name := layout.leaves.get(f"{match['names']}[{index}]")) is not None:
        raw = payload[name.offset : name.offset + name.count]
        guards.append((name.offset, raw))
        if raw == match["name"].encode():
            row = index
        index += 1
    if array is None or row < 0 or row >= array.count:
        return None
    return Leaf(array.offset + row * np.dtype(array.dtype).itemsize, array.dtype, 1)


def _merge(pieces: list[tuple[int, int, int, int, int]]) -> list[tuple[int, int, int, int, int]]:
    """Join pieces that follow each other in the payload and in their column."""
    merged: list[tuple[int, int, int, int, int]] = []
    for source, column, within, size, item in pieces:
        if merged:
            begin, of, inside, length, kind = merged[-1]
            if (begin + length, of, inside + length, kind) == (source, column, within, item):
                merged[-1] = (begin, of, inside, length + size, kind)
                continue
        merged.append((source, column, within, size, item))
    return merged


def _views(out: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return out, out.view(np.uint64), out.view(np.uint32)


@part()
def _word(b, p):  # type: ignore[no-untyped-def]
    # The compiler makes a single load of this, at any alignment, but not of a loop over bytes.
    return _half(b, p) | np.uint64(_half(b, p + np.uint64(4))) << np.uint64(32)


@part()
def _half(b, p):  # type: ignore[no-untyped-def]
    return (
        np.uint32(b[p])
        | np.uint32(b[p + np.uint64(1)]) << np.uint32(8)
        | np.uint32(b[p + np.uint64(2)]) << np.uint32(16)
        | np.uint32(b[p + np.uint64(3)]) << np.uint32(24)
    )


@kernel()
def _gather(  # type: ignore[no-untyped-def]
    buffer,
    offset,
    length,
    plan_length,
    guard_offset,
    guard_byte,
    swap,
    source,
    column,
    within,
    size,
    item,
    out,
    words,
    halves,
    base,
    sizes,
    done,
    valid,
):
    for i in range(offset.shape[0]):
        if done[i] or length[i] != plan_length:
            continue
        start = np.uint64(offset[i])
        same = True
        for g in range(guard_offset.shape[0]):
            if buffer[start + np.uint64(guard_offset[g])] != guard_byte[g]:
                same = False
                break
        if not same:
            continue
        for p in range(source.shape[0]):
            src = start + np.uint64(source[p])
            dst = np.uint64(base[column[p]] + i * sizes[column[p]] + within[p])
            n = np.uint64(size[p])
            if swap:
                width = np.uint64(item[p])
                for b in range(n):
                    inside = b % width
                    out[dst + b - inside + (width - np.uint64(1) - inside)] = buffer[src + b]
            elif (n | dst) & np.uint64(7) == 0:
                w = dst >> np.uint64(3)
                for b in range(n >> np.uint64(3)):
                    words[w + b] = _word(buffer, src + (b << np.uint64(3)))
            elif (n | dst) & np.uint64(3) == 0:
                w = dst >> np.uint64(2)
                for b in range(n >> np.uint64(2)):
                    halves[w + b] = _half(buffer, src + (b << np.uint64(2)))
            else:
                for b in range(n):
                    out[dst + b] = buffer[src + b]
        done[i] = True
        valid[i] = True
