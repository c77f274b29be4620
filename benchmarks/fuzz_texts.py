"""Damage to bytes and to text: for the fuzzers."""

from __future__ import annotations

import random
import re
import struct
from collections.abc import Callable, Sequence

# What a size or a count can say to hurt
HOSTILE = (
    0, 1, 2, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 2**24, 2**28 - 1, 2**30, 2**31 - 1, 2**31, 2**32 - 1,
    2**32, 2**40, 2**53, 2**62, 2**63 - 1, 2**63, 2**64 - 9, 2**64 - 1,
)  # fmt: skip
# Words that no reader of text should stumble over, whatever the text is
WORDS = (
    "", "0", "-0.0", "-1", "1e999", "-1e308", "5e-324", "nan", "inf", "-inf", "9" * 400, "0x10",
    "1_000", "true", "null", "''", '""', "'", '"', '"""', "[]", "{}", "[[1, 2], [3]]", "{a = 1}",
    ",", ":", "=", "#", "\\", "\\u0000", "\x00", "\x1b[2J", "\u202e", "\ufeff", "ß", "名" * 30,
    "\U0001f600", "%s%n", "${HOME}", "../../x", "1979-05-27T07:32:00Z", "x" * 3000,
    *map(str, HOSTILE),
)  # fmt: skip
_WORD = re.compile(r'"[^"\n]*"|[A-Za-z0-9_.+-]+')
Damage = Callable[[bytearray, random.Random], None]


# -- damage to any bytes -----------------------------------------------------------------------


def _flip(data: bytearray, rng: random.Random) -> None:
    for _ in range(rng.choice((1, 1, 1, 2, 8, 64))):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def _overwrite(data: bytearray, rng: random.Random) -> None:
    at, size = rng.randrange(len(data)), rng.choice((1, 2, 4, 8, 64, 512))
    end = min(len(data), at + size)
    data[at:end] = rng.choice((bytes(end - at), b"\xff" * (end - at), rng.randbytes(end - at)))


def _cut(data: bytearray, rng: random.Random) -> None:
    del data[rng.randrange(len(data)) :]


def _cut_out(data: bytearray, rng: random.Random) -> None:
    at = rng.randrange(len(data))
    del data[at : at + rng.choice((1, 4, 9, 100, 3000))]


def _insert(data: bytearray, rng: random.Random) -> None:
    at = rng.randrange(len(data))
    data[at:at] = rng.randbytes(rng.choice((1, 4, 9, 100, 3000)))


def _repeat(data: bytearray, rng: random.Random) -> None:
    at, to = rng.randrange(len(data)), rng.randrange(len(data))
    data[to:to] = data[at : at + rng.choice((9, 100, 3000))]


def _move(data: bytearray, rng: random.Random) -> None:
    at, to = rng.randrange(len(data)), rng.randrange(len(data))
    piece = data[at : at + rng.choice((4, 9, 100, 3000))]
    data[to : to + len(piece)] = piece


def _hostile_size(data: bytearray, rng: random.Random) -> None:
    """Overwrite a number that looks like a size, a count or an offset."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        width, code = rng.choice(((4, "<I"), (8, "<Q"), (2, "<H"), (4, ">I")))
        for _ in range(200):
            at = rng.randrange(max(1, len(data) - width))
            if at + width > len(data):
                return
            (value,) = struct.unpack_from(code, data, at)
            if value <= len(data):
                near = (value + 1, value - 1, 2 * value, len(data) - at, len(data))
                new = rng.choice((*HOSTILE, *near)) % (1 << 8 * width)
                struct.pack_into(code, data, at, new)
                break


ANY: tuple[Damage, ...] = (
    _flip, _overwrite, _cut, _cut_out, _insert, _repeat, _move, _hostile_size, _hostile_size,
)  # fmt: skip


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Bytes with one to three damages."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        if changed:
            rng.choice(ANY)(changed, rng)
    return bytes(changed)


# -- damage to text ----------------------------------------------------------------------------


def _one_word(text: str, rng: random.Random, words: Sequence[str]) -> str:
    """Another word in the place of one."""
    places = list(_WORD.finditer(text))
    if not places:
        return text + rng.choice(words)
    at = rng.choice(places)
    new = rng.choice(places).group() if rng.random() < 0.3 else rng.choice(words)
    return text[: at.start()] + new + text[at.end() :]


def _wrapped(text: str, rng: random.Random, words: Sequence[str]) -> str:
    """A word in brackets, often many."""
    places = list(_WORD.finditer(text))
    if not places:
        return text
    at = rng.choice(places)
    left, right = rng.choice((("[", "]"), ("{", "}"), ("{a = ", "}"), ('{"a": ', "}"), ("(", ")")))
    depth = rng.choice((1, 2, 50, 900, 3000))
    closed = right * (depth if rng.random() < 0.7 else 0)
    return text[: at.start()] + left * depth + at.group() + closed + text[at.end() :]


def _lines(text: str, rng: random.Random, words: Sequence[str]) -> str:
    """A line lost, repeated, moved, or one of nobody's."""
    lines = text.split("\n")
    at, to = rng.randrange(len(lines)), rng.randrange(len(lines))
    line = lines[at]
    if rng.random() < 0.6:
        del lines[at]
    if rng.random() < 0.6:
        lines.insert(to, line if rng.random() < 0.6 else rng.choice(words))
    return "\n".join(lines)


def _inserted(text: str, rng: random.Random, words: Sequence[str]) -> str:
    at = rng.randrange(len(text) + 1)
    return text[:at] + rng.choice(words) + text[at:]


def damaged_text(data: bytes, rng: random.Random, words: Sequence[str] = ()) -> bytes:
    """Text with one to three damages; `words` belong to its language."""
    if not data or rng.random() < 0.2:
        return damaged(data or rng.choice(WORDS).encode(), rng)
    text = data.decode(errors="surrogateescape")
    for _ in range(rng.choice((1, 1, 2, 3))):
        change = rng.choice((_one_word, _one_word, _one_word, _lines, _inserted, _wrapped))
        text = change(text, rng, words if words and rng.random() < 0.5 else WORDS)
    return text.encode(errors="surrogateescape")
