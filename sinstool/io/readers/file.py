"""A log in one file: reads bytes, decompresses blocks and reads batches ahead."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import TypeVar

from sinstool.core.errors import UnsupportedLogError
from sinstool.core.threads import executor, is_single_threaded
from sinstool.io.readers.batch import RawBatch
from sinstool.io.readers.compression import (
    CompressionError,
    UnknownCompressionError,
    decompress,
    too_large,
)
from sinstool.io.readers.limits import LARGE
from sinstool.io.readers.log import Log

Item = TypeVar("Item")
Result = TypeVar("Result")
Place = TypeVar("Place")

# Most results that `ahead` holds
DEPTH = 3


def ahead(work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Map ``work`` over ``items`` in a thread, in order, a few results ahead.

    Decompression and checksums release the interpreter lock, so reading overlaps with the work of
    the caller; the bound limits memory.

    Yields
    ------
    Result
        In the order of ``items``; an exception of ``work`` is raised in its turn.
    """
    if is_single_threaded():
        yield from map(work, items)
        return
    with executor(1, "sinstool-read") as pool:
        waiting: deque[Future[Result]] = deque()
        try:
            for item in items:
                waiting.append(pool.submit(work, item))
                if len(waiting) >= DEPTH:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


class FileLog(Log):
    """A file that is open as long as the log is.

    Parameters
    ----------
    salvage : bool
        Pass over damage and note it in `lost`.
    """

    def __init__(self, path: Path, salvage: bool) -> None:
        super().__init__(path, salvage)
        self._packed = False  # a compressed chunk was seen
        self._fd = os.open(path, os.O_RDONLY)

    def close(self) -> None:
        """Close the file."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def read_at(self, offset: int, length: int) -> bytes:
        """Bytes of the file; fewer where it ends, none beyond."""
        # Offsets and lengths come from the file, and may be more than a system call takes.
        if not 0 <= offset < self.size:
            return b""
        return os.pread(self._fd, min(length, self.size - offset), offset)

    def unpacked(
        self, name: str, size: int, offset: int, data_offset: int, data_length: int
    ) -> bytes | memoryview | str:
        """Decompressed content of a chunk, or why there is none.

        Parameters
        ----------
        name : str
            Compression, as the chunk has it.
        size : int
            Bytes of the content that it declares.
        offset, data_offset, data_length : int
            Where the chunk begins, and where its compressed content lies.

        Returns
        -------
        bytes-like or str
            The content; a str says what is wrong with the chunk.

        Raises
        ------
        UnsupportedLogError
            The compression is unknown, and `salvage` is off.
        """
        if why := too_large(data_length, data_length):
            return f"a chunk has {data_length} bytes, {why}"
        try:
            return decompress(name, self.read_at(data_offset, data_length), size)
        except UnknownCompressionError as exc:
            if not self.salvage:
                raise UnsupportedLogError(self.path, f"a chunk's {exc}", "", offset) from exc
            return f"a chunk's {exc}"
        except CompressionError as exc:
            return f"a chunk {exc}"


def read_ahead(
    places: Iterable[Place | RawBatch],
    size: Callable[[Place], int],
    batches: Callable[[Place], Iterator[RawBatch]],
) -> Iterator[RawBatch]:
    """The batches of a log's places in order, with the next few unpacked in a thread.

    Parameters
    ----------
    places : iterable
        Chunks, and batches of messages that lie in none.
    size : callable
        Bytes of a chunk; a large one is not read ahead.
    batches : callable
        Unpacks a chunk.
    """

    def load(place: Place | RawBatch) -> Place | list[RawBatch]:
        if isinstance(place, RawBatch):
            return [place]
        return place if size(place) > LARGE else list(batches(place))

    for loaded in ahead(load, places):
        yield from loaded if isinstance(loaded, list) else batches(loaded)
