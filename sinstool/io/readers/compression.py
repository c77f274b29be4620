"""Decompression of one block, with a check of its declared size."""

from __future__ import annotations

import bz2
import threading
from typing import Any

import lz4.frame
import zstandard

from sinstool.core.memory import available
from sinstool.io.readers.limits import MAX_BLOCK, ORDINARY_BLOCK

_MAGICS = {"zstd": b"\x28\xb5\x2f\xfd", "lz4": b"\x04\x22\x4d\x18", "bz2": b"BZh91AY&SY"}
# Largest factor by which real data expands; data that expands more is a decompression bomb.
MOST_SWELLING = 1024
_PIECE = 256
# Most copies of a block in memory: as read, decompressed, compressed again, and written
COPIES = 4

_local = threading.local()


class CompressionError(ValueError):
    """A block does not decompress to what it declares."""


class UnknownCompressionError(CompressionError):
    """The name of the compression is unknown."""


def too_large(size: int, packed: int) -> str:
    """Why a block is refused, in words that follow its size; empty for an accepted one.

    Parameters
    ----------
    size : int
        Bytes of its content.
    packed : int
        Bytes of it in the file; equal to `size` where it is not compressed.
    """
    if size <= ORDINARY_BLOCK:
        return ""
    if size > min(MAX_BLOCK, MOST_SWELLING * packed):
        most = max(ORDINARY_BLOCK, min(MAX_BLOCK, MOST_SWELLING * packed))
        return f"more than the {most // 2**20} MiB that are accepted"
    free = available()
    if free is not None and COPIES * size > free:
        return (
            f"which takes {COPIES * size // 2**20} MiB of memory, where {free // 2**20} MiB"
            " are available"
        )
    return ""


def decompress(name: str, data: bytes | memoryview, size: int) -> bytes | memoryview:
    """Decompress one block.

    Parameters
    ----------
    name : {'', 'none', 'zstd', 'lz4', 'bz2'}
        As the container spells it.
    size : int
        Decompressed size that the container declares.

    Returns
    -------
    bytes-like
        Exactly ``size`` bytes.

    Raises
    ------
    CompressionError
        The data is corrupt, has another size when decompressed, or is too large.
    """
    if why := too_large(size, len(data)):
        raise CompressionError(f"declares {size} bytes, {why}")
    try:
        out = _decompress(name, data, size)
    except UnknownCompressionError:
        raise
    except (zstandard.ZstdError, RuntimeError, OSError, EOFError, ValueError) as exc:
        raise CompressionError(f"{name} data is corrupt ({exc})") from exc
    if len(out) != size:
        raise CompressionError(f"holds {len(out)} bytes where {size} are declared")
    return out


def _decompress(name: str, data: bytes | memoryview, size: int) -> bytes | memoryview:
    if name in ("", "none"):
        return data
    if name not in ("zstd", "lz4", "bz2"):
        raise UnknownCompressionError(f"compression '{name}' is not one of zstd, lz4, bz2, none")
    if not len(data) and size == 0:
        return b""
    if name == "zstd":
        declared = zstandard.frame_content_size(data)
        if declared not in (-1, size):
            raise CompressionError(f"its zstd frame declares {declared} bytes, not {size}")
        return _zstd().decompress(data, max_output_size=max(size, 1))
    if name == "lz4":
        unpacked = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
        return bytes(unpacked)
    return bz2.BZ2Decompressor().decompress(data, max_length=size + 1)


def decompress_prefix(name: str, data: bytes | memoryview, limit: int) -> bytes | bytearray:
    """The readable beginning of a damaged block.

    Parameters
    ----------
    name : str
        As for `decompress`. Data with the magic bytes of zstd, lz4 or bz2 is taken for that.
    limit : int
        Most bytes to return.

    Returns
    -------
    bytes-like
        The data before the first place that does not decompress. Nothing proves it correct: a
        changed byte may decompress to something else.
    """
    name = compression_of(data) or name
    if name in ("", "none"):
        return bytes(data[:limit])
    if name not in ("zstd", "lz4", "bz2"):
        return b""
    limit = min(limit, ORDINARY_BLOCK, MOST_SWELLING * len(data) + _PIECE)
    out, good = _feed(name, data, 0, _PIECE, limit)
    if good < len(data) and len(out) < limit:
        # The damage lies in the next piece: recover everything before it byte by byte.
        out, _ = _feed(name, data[: good + _PIECE], good, 1, limit)
    return out


def compression_of(data: bytes | memoryview) -> str:
    """Compression of data by its first bytes; '' where it is unknown."""
    head = bytes(data[:10])
    return next((name for name, magic in _MAGICS.items() if head.startswith(magic)), "")


def packed_at(data: bytes) -> int:
    """Offset of compressed data in the first bytes of a file; -1 where there is none."""
    places = [data.find(magic) for magic in _MAGICS.values()]
    return min((place for place in places if place >= 0), default=-1)


def _feed(
    name: str, data: bytes | memoryview, whole: int, piece: int, limit: int
) -> tuple[bytearray, int]:
    """Decompress the first `whole` bytes in large pieces, and the rest in pieces of a given size.

    Returns what came out, and how many bytes went in before the first that would not.
    """
    out = bytearray()
    step: Any = {
        "zstd": lambda: zstandard.ZstdDecompressor().decompressobj(),
        "lz4": lz4.frame.LZ4FrameDecompressor,
        "bz2": bz2.BZ2Decompressor,
    }[name]()
    pos = 0
    while pos < len(data) and len(out) < limit and not step.eof:
        size = min(_PIECE, whole - pos) if pos < whole else piece
        try:
            if name == "zstd":
                out += step.decompress(data[pos : pos + size])
            else:
                out += step.decompress(data[pos : pos + size], limit - len(out))
                while not step.needs_input and not step.eof and len(out) < limit:
                    out += step.decompress(b"", limit - len(out))
        except (zstandard.ZstdError, RuntimeError, OSError, EOFError, ValueError):
            return out[:limit], pos
        pos += size
    return out[:limit], len(data)


def _zstd() -> zstandard.ZstdDecompressor:
    """This thread's decompressor: they are not safe to share."""
    if not hasattr(_local, "zstd"):
        _local.zstd = zstandard.ZstdDecompressor()
    return _local.zstd
