"""Chunks of an MCAP file: message records by one compiled scatter, indexes, compression."""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import lz4.frame
import numpy as np
import zstandard
from isal.isal_zlib import crc32
from mcap.opcode import Opcode

from sinstool.core.parts import kernel, part
from sinstool.io.readers.batch import RawBatch

CHUNK_SIZE = 2**20
ZSTD_LEVEL = -1  # 20 % less time than level 1 for 3 % more bytes
# log2 of the size of zstd's hash table. This one fits into the first-level cache: 10 % less time
# for 1 % more bytes.
ZSTD_TABLE = 12
_RECORD = 31  # bytes of head and fixed fields of a message record

_local = threading.local()


@dataclass(frozen=True)
class Chunk:
    """A chunk ready for the file: pieces of its record, its indexes, and values for the summary."""

    record: Sequence[bytes]
    indexes: list[tuple[int, bytes]]
    start_time: int
    end_time: int
    compression: str
    compressed_size: int
    size: int

    @property
    def counts(self) -> dict[int, int]:
        """Messages by channel."""
        return {channel: len(entries) // 16 for channel, entries in self.indexes}


def _compress(name: str, data: np.ndarray) -> bytes:
    if name == "zstd":
        if not hasattr(_local, "zstd"):
            settings = zstandard.ZstdCompressionParameters.from_level(
                ZSTD_LEVEL, source_size=CHUNK_SIZE, hash_log=ZSTD_TABLE
            )
            _local.zstd = zstandard.ZstdCompressor(compression_params=settings)
        return bytes(_local.zstd.compress(data))
    if name == "lz4":
        return bytes(lz4.frame.compress(data, store_size=True))
    return data.tobytes()


def message_indexes(
    channel: np.ndarray, log_time: np.ndarray, offset: np.ndarray, bases: Sequence[int] = (0,)
) -> list[list[tuple[int, bytes]]]:
    """Entries of the message indexes of chunks that follow each other.

    Parameters
    ----------
    channel, log_time, offset : ndarray of int64, shape (n,)
        Values of all messages in order; offsets of their records in the uncompressed contents of
        all chunks.
    bases : sequence of int, optional
        Offsets at which the chunks begin.

    Returns
    -------
    list of list of (int, bytes)
        For each chunk, the channel ids and the entries of each, sorted by id.
    """
    # Ids have 16 bits, and numpy sorts 16-bit integers by radix, which is faster
    order = np.argsort(channel.astype(np.uint16), kind="stable")
    entries = np.empty((len(channel), 2), "<i8")
    entries[:, 0] = log_time[order]
    entries[:, 1] = offset[order]
    counts = np.bincount(channel)
    indexes: list[list[tuple[int, bytes]]] = [[] for _ in bases]
    begin = 0
    for number in np.flatnonzero(counts).tolist():
        some = entries[begin : begin + counts[number]]
        begin += counts[number]
        edges = [*np.searchsorted(some[:, 1], bases).tolist(), len(some)]
        for base, index, (first, last) in zip(bases, indexes, pairwise(edges), strict=True):
            if first < last:
                some[first:last, 1] -= base
                index.append((number, some[first:last].tobytes()))
    return indexes


def pack(make: Callable[[], Sequence[RawBatch]], compression: str) -> list[Chunk]:
    """Chunks of the messages of one call to the writer; runs in a packing thread."""
    parts = [p for p in make() if len(p)]
    if not parts:
        return []
    log_time = np.concatenate([p.log_time for p in parts])
    size = np.concatenate([p.length for p in parts]) + _RECORD
    order = np.argsort(log_time, kind="stable")
    ends = np.cumsum(size[order])
    place = np.empty(len(order), np.int64)
    place[order] = ends - size[order]
    body = np.empty(int(ends[-1]), np.uint8)
    begin = 0
    for piece in parts:
        end = begin + len(piece)
        _scatter(
            body,
            place[begin:end],
            piece.channel,
            piece.sequence,
            piece.log_time,
            piece.publish_time,
            piece.buffer,
            piece.offset,
            piece.length,
        )
        begin = end
    firsts = [0]
    while True:
        edge = int(np.searchsorted(ends, int(place[order[firsts[-1]]]) + CHUNK_SIZE, side="right"))
        following = max(edge, firsts[-1] + 1)
        if following >= len(order):
            break
        firsts.append(following)
    times, place = log_time[order], place[order]
    bases = place[firsts].tolist()
    channel = np.concatenate([p.channel for p in parts])[order]
    indexes = message_indexes(channel, times, place, bases)
    return [
        _pack_one(body[base:behind], times[first:last], index, compression)
        for base, behind, first, last, index in zip(
            bases,
            [*bases[1:], len(body)],
            firsts,
            [*firsts[1:], len(order)],
            indexes,
            strict=True,
        )
    ]


def _pack_one(
    chunk: np.ndarray, times: np.ndarray, indexes: list[tuple[int, bytes]], compression: str
) -> Chunk:
    """Compress a chunk's records."""
    data = _compress(compression, chunk)
    name = compression.encode()
    start, end = int(times.min()), int(times.max())
    crc = crc32(chunk.data)
    fields = f"<qqQII{len(name)}sQ"
    body = struct.pack(fields, start, end, len(chunk), crc, len(name), name, len(data))
    head = struct.pack("<BQ", Opcode.CHUNK, len(body) + len(data)) + body
    return Chunk((head, data), indexes, start, end, compression, len(data), len(chunk))


@part()
def _put(body, at, value, width):  # type: ignore[no-untyped-def]
    for b in range(np.uint64(width)):
        body[at + b] = (value >> (8 * b)) & 0xFF


@kernel()
def _scatter(body, place, channel, sequence, log_time, publish_time, buffer, offset, length):  # type: ignore[no-untyped-def]
    """Write message records, each at its place in the chunk body."""
    for i in range(place.shape[0]):
        # Unsigned indices cannot count from an array's end, so the loops have no branches and the
        # compiler vectorises them: four times as fast.
        p = np.uint64(place[i])
        body[p] = 0x05
        _put(body, p + np.uint64(1), length[i] + 22, 8)
        _put(body, p + np.uint64(9), channel[i], 2)
        _put(body, p + np.uint64(11), sequence[i], 4)
        _put(body, p + np.uint64(15), log_time[i], 8)
        _put(body, p + np.uint64(23), publish_time[i], 8)
        p += np.uint64(31)
        o = np.uint64(offset[i])
        for b in range(np.uint64(length[i])):
            body[p + b] = buffer[o + b]
