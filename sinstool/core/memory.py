"""Memory: what is left of it, and what was freed.

What was freed stays with the process, as the next block of a log needs it again.

The C library gives large pieces back to the system as soon as they are freed, and the system clears
them before it gives them out anew: for columns that live for a block this takes longer than what is
computed of them. glibc learns with time to keep them, unless something has set its limits, as Dask
does for its workers.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

# Numbers of glibc's malloc.h
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
# Its own limits, without anything set, in bytes
_USUAL = 128 * 1024
# Larger than any column of a block; what is beyond is given back.
PIECE, UNUSED_AT_MOST = 32 * 2**20, 128 * 2**20


@contextmanager
def memory_held() -> Iterator[None]:
    """Context in which the process keeps freed memory; at its end all of it is returned.

    Nothing happens where the C library is not glibc.
    """
    library = _glibc()
    if library is None:
        yield
        return
    library.mallopt(_MMAP_THRESHOLD, PIECE)
    library.mallopt(_TRIM_THRESHOLD, UNUSED_AT_MOST)
    try:
        yield
    finally:
        for number, name in (
            (_MMAP_THRESHOLD, "MALLOC_MMAP_THRESHOLD_"),
            (_TRIM_THRESHOLD, "MALLOC_TRIM_THRESHOLD_"),
        ):
            said = os.environ.get(name, "")
            library.mallopt(number, int(said) if said.isdecimal() else _USUAL)
        give_back()


@cache
def keep_freed() -> None:
    """Have freed memory stay with the process, some 64 MB of it, from now on; it costs nothing.

    This is what glibc learns by itself, from the largest piece that was freed (its dynamic limits,
    see mallopt(3)). Without it a program that reads a log, and little else, spends a fourth of the
    time on memory that comes and goes with each chunk.
    """
    if _glibc() is not None:
        bytes(PIECE - 2**20)  # zeros, which are nowhere until somebody reads them


def give_back() -> None:
    """Return freed memory to the system; to be called after freeing much."""
    library = _glibc()
    if library is not None:
        library.malloc_trim(0)


def joined(blocks: list[np.ndarray]) -> np.ndarray:
    """Blocks of rows, at least one, in one array; they are taken off the list as they are copied.

    So all of them are in memory but once.
    """
    import numpy as np

    rows = np.empty((sum(map(len, blocks)), *blocks[0].shape[1:]), blocks[0].dtype)
    end, waiting = len(rows), 0
    while blocks:
        block = blocks.pop()
        rows[end - len(block) : end] = block
        end -= len(block)
        waiting += block.nbytes
        if waiting > PIECE // 2:
            del block
            give_back()
            waiting = 0
    return rows


def available() -> int | None:
    """Bytes of memory that the system can still give out; None where it does not say."""
    try:
        with open("/proc/meminfo", encoding="ascii") as lines:
            for line in lines:
                if line.startswith("MemAvailable:"):
                    return 1024 * int(line.split()[1])
    except (OSError, ValueError, IndexError):
        pass
    return None


@cache
def _glibc() -> Any:
    """The C library, if it is glibc."""
    if sys.platform != "linux":
        return None
    try:
        library = ctypes.CDLL(None)
        library.gnu_get_libc_version  # noqa: B018 - only glibc has it
    except (AttributeError, OSError):
        return None
    return library
