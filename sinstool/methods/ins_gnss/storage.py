"""Columns that grow by blocks: in memory while short, in a temporary file once long.

A smoother runs backward over everything the filter did, which of a long log is more than memory
should hold. The files have no names to be left behind: the system removes them when they are
closed or the process ends, however it ends (on systems that cannot do so, when they are closed).
"""

from __future__ import annotations

import mmap
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from sinstool.core.errors import OutputError
from sinstool.core.memory import return_freed_memory

DEFAULT_LIMIT = 64 << 20
"""Bytes of all columns of a storage that are held in memory."""


class Storage:
    """Columns by name that share one limit of memory; a context manager.

    Parameters
    ----------
    limit : int, optional
        Bytes held in memory. When the columns together have more, all go to files.
    """

    def __init__(self, limit: int = DEFAULT_LIMIT) -> None:
        self._room = limit
        self._parts: dict[str, list[NDArray[Any]]] = {}
        self._files: dict[str, BinaryIO] = {}
        self._rows: dict[str, int] = {}
        self._maps: dict[str, np.memmap[Any, Any]] = {}

    def append(self, name: str, rows: NDArray[Any]) -> None:
        """Add rows to a column; they are copied.

        Parameters
        ----------
        rows : ndarray, shape (m, ...)
            Of the same type and shape of a row as those before.

        Raises
        ------
        OutputError
            If the folder cannot be written or is full.
        """
        self._maps.pop(name, None)
        self._rows[name] = self._rows.get(name, 0) + len(rows)
        if name in self._files:
            with _failures_explained():
                self._files[name].write(np.ascontiguousarray(rows).data)
            return
        parts = self._parts.setdefault(name, [])
        parts.append(np.array(rows, order="C"))
        self._room -= parts[-1].nbytes
        if self._room < 0:
            self._room = 0
            for each in self._parts:
                if each not in self._files:
                    self._spill(each)
            return_freed_memory()

    def array(self, name: str) -> NDArray[Any]:
        """All rows of a column.

        Returns
        -------
        ndarray, shape (n, ...)
            May be changed in place; valid until the next row is added or the storage closed.
            Rows in a file are mapped, not read: see :meth:`release`.
        """
        if name in self._files and self._rows[name]:
            if name not in self._maps:
                with _failures_explained():
                    self._files[name].flush()
                one = self._parts[name][0]
                shape = (self._rows[name], *one.shape[1:])
                self._maps[name] = np.memmap(self._files[name], one.dtype, "r+", 0, shape)
            return self._maps[name]
        self._parts[name] = [np.concatenate(self._parts[name])]
        return self._parts[name][0]

    def release(self) -> None:
        """Give back the memory of mapped rows; arrays stay valid, and read what they need anew.

        Whoever walks through a long column calls it from time to time, as the system counts what
        was looked at as this process's memory until another process wants it.
        """
        if hasattr(mmap, "MADV_DONTNEED"):
            for rows in self._maps.values():
                rows._mmap.madvise(mmap.MADV_DONTNEED)  # type: ignore[attr-defined]

    def close(self) -> None:
        """Forget all rows and remove the files. Arrays given out must not be used after it."""
        for file in self._files.values():
            # What is still in its buffer goes with it, also where there was no room for it.
            with suppress(OSError):
                file.close()
        self._parts, self._files, self._rows, self._maps = {}, {}, {}, {}

    def __enter__(self) -> Storage:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _spill(self, name: str) -> None:
        """Move the rows of a column in memory to its file; an empty part stays, for its type."""
        with _failures_explained():
            file = tempfile.TemporaryFile(prefix="sinstool-")  # noqa: SIM115
            self._files[name] = file
            parts, self._parts[name] = self._parts[name], [self._parts[name][0][:0].copy()]
            for part in parts:
                file.write(part.data)


@contextmanager
def _failures_explained() -> Iterator[None]:
    try:
        yield
    except OSError as exc:
        # No file, nor a name, where none of the system's folders can be written
        where = f" in {tempfile.tempdir}" if tempfile.tempdir is not None else ""
        raise OutputError(
            f"a temporary file{where} cannot be written: {exc.strerror or exc}",
            "make room there, or name another folder in the variable TMPDIR",
        ) from exc
