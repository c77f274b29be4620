"""Control of freed memory, and the amount that is still available.

The C library returns large pieces to the system as soon as they are freed, and the system clears
them before it hands them out again. For columns that live for one block of a log this takes longer
than the computation, so freed memory is kept for the next block. glibc learns this by itself with
time, unless something has set its limits, as Dask does for its workers.
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
# Default of both limits in glibc, bytes
_USUAL = 128 * 1024
# Bytes. Pieces up to the first size, larger than any column of a block, are kept when they are
# freed, as long as no more than the second is unused at the top of the heap.
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
        return_freed_memory()


@cache
def keep_freed_memory() -> None:
    """Make the process keep some 64 MB of freed memory from now on.

    Freeing one large piece raises glibc's dynamic limits (see mallopt(3)). Without this, a program
    that does little but read a log spends a quarter of its time on memory that is returned and
    obtained again with each chunk.
    """
    if _glibc() is not None:
        bytes(PIECE - 2**20)  # freed at once; zeros take no physical memory until they are read


def return_freed_memory() -> None:
    """Return freed memory to the system; to be called after freeing much."""
    library = _glibc()
    if library is not None:
        library.malloc_trim(0)


def joined(blocks: list[np.ndarray]) -> np.ndarray:
    """Blocks of rows joined in one array.

    Parameters
    ----------
    blocks : list of ndarray, shape (n_k, ...)
        At least one. The list is emptied as blocks are copied, so that no more than one block is in
        memory twice.
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
            return_freed_memory()
            waiting = 0
    return rows


def available() -> int | None:
    """Bytes of memory that are still available; None if the system does not say."""
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
