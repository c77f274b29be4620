"""Decompression of one block whose decompressed size is declared beside it, and checked."""

from __future__ import annotations

import bz2
import threading

import lz4.frame
import zstandard

# A declared size beyond this is refused: recorders use chunks of about 1 MiB, and a hostile or
# damaged size must not cost memory.
MAX_BLOCK = 256 * 2**20

_local = threading.local()


class CompressionError(ValueError):
    """A block does not decompress to what it declares."""


class UnknownCompressionError(CompressionError):
    """The name of the compression is none we know."""


def decompress(name: str, data: bytes | memoryview, size: int) -> bytes | memoryview:
    """Decompress one block.

    Parameters
    ----------
    name : {'', 'none', 'zstd', 'lz4', 'bz2'}
        As the container spells it.
    data : bytes-like
    size : int
        Decompressed size that the container declares.

    Returns
    -------
    bytes-like
        Exactly ``size`` bytes.

    Raises
    ------
    CompressionError
        The data is corrupt, declares more than 256 MiB, or has another size when decompressed.
    """
    if size > MAX_BLOCK:
        raise CompressionError(
            f"declares {size} bytes, more than the {MAX_BLOCK // 2**20} MiB that are accepted"
        )
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


def _zstd() -> zstandard.ZstdDecompressor:
    """This thread's decompressor: they are not safe to share."""
    if not hasattr(_local, "zstd"):
        _local.zstd = zstandard.ZstdDecompressor()
    return _local.zstd
