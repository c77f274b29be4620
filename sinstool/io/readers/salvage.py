"""Whole records from a damaged part of a log, wherever they begin again."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from isal.isal_zlib import crc32

from sinstool.io.readers.compression import decompress_prefix
from sinstool.io.readers.limits import MAX_PLACES, ORDINARY_BLOCK, WINDOW

# Overlap of windows: a record up to this size that begins in one is complete in the next
_OVERLAP = 2**20

Run = Callable[[np.ndarray, int], tuple[int, int]]
Next = Callable[[np.ndarray, int], int]


def unpack(name: str, data: bytes, size: int, crc: int) -> tuple[np.ndarray, bool]:
    """The readable part of a damaged chunk, decompressed as far as possible.

    Parameters
    ----------
    name : str
        Compression, as the chunk has it.
    size, crc : int
        Size and CRC-32 of the content by the chunk's header (CRC 0: none); either may be wrong.

    Returns
    -------
    content : ndarray, uint8
    proved : bool
        Whether the CRC matches the content, so that only the chunk's header is wrong.
    """
    if crc and len(data) == size and crc32(data) == crc:  # not compressed, despite its name
        return np.frombuffer(data, np.uint8), True
    raw = memoryview(decompress_prefix(name, data, ORDINARY_BLOCK))
    for length in {len(raw), min(size, len(raw))}:
        if crc and crc32(raw[:length]) == crc:
            return np.frombuffer(raw[:length], np.uint8), True
    return np.frombuffer(raw, np.uint8), False


def whole_parts(buffer: np.ndarray, run: Run, following: Next) -> list[tuple[int, int]]:
    """Runs of whole records in a buffer that has damaged places.

    Parameters
    ----------
    buffer : ndarray, uint8
    run : callable
        Walks whole records from a place on: where the last begins and where it ends.
    following : callable
        Finds the next record that can be one, from a place on; -1 where there is none.

    Returns
    -------
    list of (int, int)
        Where each run begins and ends, in order.
    """
    parts: list[tuple[int, int]] = []
    pos = 0
    for _ in range(MAX_PLACES):
        last, stop = run(buffer, pos)
        if stop == len(buffer):
            parts.append((pos, stop))
            break
        # Either the record at `stop` is damaged, or the length of the one before it.
        again = following(buffer, (last if last >= 0 else stop) + 1)
        parts.append((pos, last if 0 <= again < stop else stop))
        if again < 0:
            break
        pos = again
    return [(begin, end) for begin, end in parts if end > begin]


def search(
    read_at: Callable[[int, int], bytes],
    start: int,
    end: int,
    following: Callable[[np.ndarray, int], int],
) -> int:
    """Find the next record in a file.

    Parameters
    ----------
    read_at : callable
        Bytes of the file at an offset.
    start, end : int
        Where to begin, and where the file ends.
    following : callable
        Finds it in a piece of the file, given how many bytes there are from the piece on.

    Returns
    -------
    int
        Where it begins; `end` where there is none.
    """
    pos = start
    while pos < end:
        window = np.frombuffer(read_at(pos, min(WINDOW, end - pos)), np.uint8)
        at = following(window, end - pos)
        if at >= 0:
            return pos + at
        if len(window) < WINDOW:
            break
        pos += len(window) - _OVERLAP
    return end


def channel_mask(channels: object) -> np.ndarray:
    """1 for each channel that an MCAP file defines; all channels before the first definition."""
    numbers = [n for n in channels if 0 <= n < 2**16]  # type: ignore[attr-defined]
    mask = np.full(2**16, 0 if numbers else 1, np.uint8)
    mask[numbers] = 1
    return mask


def inside(log_time: np.ndarray, start: int, end: int) -> np.ndarray:
    """Which messages lie between the log times that their chunk declares.

    In a damaged chunk a time outside is itself damaged; where most are outside, the declared
    times are.
    """
    good = (log_time >= start) & (log_time <= end)
    return good if 2 * np.count_nonzero(good) > len(good) else log_time >= 0
