"""Rows of text from columns: one compiled pass formats the numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sinstool.core.parts import njit

# Rows that are made at once: their text stays in the processor's cache
ROWS = 4096
# Bytes of a number at most: sign, 19 digits, point
NUMBER = 21
_INTEGER, _FLOAT, _TEXT = 0, 1, 2
# A float64 holds all integers up to here; digits beyond would be noise
_EXACT = 9.0e15


@dataclass(frozen=True)
class Value:
    """A column, and how its values are written.

    Attributes
    ----------
    column : ndarray, shape (n,)
        int64: of units of the last decimal (``1500`` with three decimals is ``1.5``). float64: NaN
        and infinity become nothing. Bytes (``S``): as they are.
    decimals : int
        Digits behind the point at most; zeros at the end are left out, but one.
    """

    column: np.ndarray
    decimals: int = 0


def text_rows(parts: Sequence[str | Value]) -> Iterator[memoryview]:
    """A line, or whatever the parts make, for each row.

    Parameters
    ----------
    parts : sequence of str and Value
        Written one after the other: text as it is, of columns the row's value. At least one is a
        column.

    Yields
    ------
    memoryview
        Text of consecutive rows.
    """
    values = [part for part in parts if isinstance(part, Value)]
    count = len(values[0].column)
    literals = [""]
    for part in parts:
        if isinstance(part, Value):
            literals.append("")
        else:
            literals[-1] += part
    encoded = [text.encode() for text in literals]
    ends = np.cumsum([len(text) for text in encoded])
    literal = np.frombuffer(b"".join(encoded) or b"\0", np.uint8)
    kinds = np.array([_kind(one.column) for one in values])
    places = np.array([np.count_nonzero(kinds[:k] == kind) for k, kind in enumerate(kinds)])
    decimals = np.array([one.decimals for one in values])
    widths = [one.column.dtype.itemsize if k == _TEXT else NUMBER
              for one, k in zip(values, kinds, strict=True)]  # fmt: skip
    buffer = np.empty(ROWS * (int(ends[-1]) + sum(widths)), np.uint8)
    for begin in range(0, count, ROWS):
        rows = slice(begin, begin + ROWS)
        chosen = [one.column[rows] for one in values]
        size = _write(
            buffer,
            _stacked(chosen, kinds, _INTEGER, np.int64),
            _stacked(chosen, kinds, _FLOAT, np.float64),
            _texts(chosen, kinds),
            kinds,
            places,
            decimals,
            literal,
            ends,
        )
        yield buffer[:size].data


def _kind(column: np.ndarray) -> int:
    return {"i": _INTEGER, "f": _FLOAT, "S": _TEXT}[column.dtype.kind]


def _stacked(
    columns: Sequence[np.ndarray], kinds: np.ndarray, kind: int, dtype: type
) -> np.ndarray:
    """Columns of a kind as the columns of one array."""
    of_kind = [c for c, k in zip(columns, kinds, strict=True) if k == kind]
    return np.stack(of_kind, axis=1).astype(dtype) if of_kind else np.empty((0, 0), dtype)


def _texts(columns: Sequence[np.ndarray], kinds: np.ndarray) -> np.ndarray:
    """Texts as bytes, shape (k, n, w); 0 where one is shorter."""
    texts = [c for c, k in zip(columns, kinds, strict=True) if k == _TEXT]
    width = max((c.dtype.itemsize for c in texts), default=0)
    if not width:
        return np.empty((0, 0, 0), np.uint8)
    return np.stack([c.astype(f"S{width}").view(np.uint8).reshape(-1, width) for c in texts])


@njit(cache=True, nogil=True)
def _write(buffer, integers, floats, texts, kinds, places, decimals, literal, ends):  # type: ignore[no-untyped-def]
    """Put rows into the buffer; returns how many bytes they take."""
    at = 0
    rows = max(integers.shape[0], floats.shape[0], texts.shape[1])
    for row in range(rows):
        begin = 0
        for k in range(kinds.shape[0] + 1):
            for i in range(begin, ends[k]):
                buffer[at] = literal[i]
                at += 1
            begin = ends[k]
            if k == kinds.shape[0]:
                break
            place = places[k]
            if kinds[k] == _INTEGER:
                at = _put(buffer, at, integers[row, place], decimals[k])
            elif kinds[k] == _FLOAT:
                value = floats[row, place]
                if np.isfinite(value):
                    digits = decimals[k]
                    scale = 10.0**digits
                    while digits > 0 and abs(value) * scale > _EXACT:
                        digits -= 1
                        scale = 10.0**digits
                    # whole numbers that no int64 holds measure nothing
                    scaled = max(-9.2e18, min(9.2e18, value * scale))
                    at = _put(buffer, at, np.int64(np.rint(scaled)), digits)
            else:
                for i in range(texts.shape[2]):
                    if texts[place, row, i] == 0:
                        break
                    buffer[at] = texts[place, row, i]
                    at += 1
    return at


@njit(cache=True, nogil=True)
def _put(buffer, at, value, decimals):  # type: ignore[no-untyped-def]
    """Digits of a number in units of its last decimal; returns where they end."""
    if value < 0:
        buffer[at] = 45
        at += 1
        # the smallest int64 has no positive counterpart, its bits are the right unsigned number
        rest = np.uint64(-value)
    else:
        rest = np.uint64(value)
    if decimals > 0:
        # zeros at the end go, all but the first behind the point
        while decimals > 1 and rest % np.uint64(10) == 0:
            rest //= np.uint64(10)
            decimals -= 1
    size = 1
    power = np.uint64(10)
    while size < 20 and rest >= power:
        size += 1
        if size == 20:
            break
        power *= np.uint64(10)
    if decimals > 0:
        size = max(size, decimals + 1) + 1
    point = at + size - 1 - decimals if decimals > 0 else -1
    for i in range(at + size - 1, at - 1, -1):
        if i == point:
            buffer[i] = 46
        else:
            digit = rest % np.uint64(10)
            rest //= np.uint64(10)
            buffer[i] = 48 + digit
    return at + size
