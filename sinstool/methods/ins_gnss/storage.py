"""Columns that grow by blocks: in memory while short, in a temporary file once long.

A smoother runs backward over everything the filter did, which of a long log is more than memory
should hold. The file has no name to be left behind: the system removes it when it is closed or
the process ends, however it ends (on systems that cannot do so, when it is closed).
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from sinstool.core.errors import OutputError

MEGABYTE = 1 << 20
DEFAULT_LIMIT = 256 * MEGABYTE
"""Bytes of all columns of a storage that are kept in memory."""


class Column:
    """Rows of one shape and type; made by :meth:`Storage.column`."""

    def __init__(self, storage: Storage, row_shape: tuple[int, ...], dtype: DTypeLike) -> None:
        self._storage = storage
        self._row_shape = row_shape
        self._dtype = np.dtype(dtype)
        self._parts: list[NDArray[Any]] = []
        self._file: BinaryIO | None = None
        self._rows = 0

    def __len__(self) -> int:
        return self._rows

    @property
    def spilled(self) -> bool:
        """Whether the rows are in a file."""
        return self._file is not None

    @property
    def nbytes(self) -> int:
        """Bytes of all rows."""
        return self._rows * self._dtype.itemsize * int(np.prod(self._row_shape, dtype=np.int64))

    def append(self, rows: ArrayLike) -> None:
        """Add rows; they are copied.

        Parameters
        ----------
        rows : array_like, shape (m, ...)

        Raises
        ------
        ValueError
            If the shape of a row is another, or the storage is closed.
        """
        values = np.asarray(rows, dtype=self._dtype)
        if values.shape[1:] != self._row_shape or values.ndim != len(self._row_shape) + 1:
            raise ValueError(f"Expected rows of shape {self._row_shape}, got {values.shape[1:]}.")
        self._storage._check_open()
        self._rows += len(values)
        if self._file is not None:
            self._write(values)
            return
        self._parts.append(np.array(values))
        self._storage._added(values.nbytes)

    def array(self) -> NDArray[Any]:
        """All rows.

        Returns
        -------
        ndarray, shape (n, ...)
            May be changed in place; valid until the next row is added or the storage closed.
            Rows in a file are mapped, not read.
        """
        self._storage._check_open()
        shape = (self._rows, *self._row_shape)
        if self._file is not None:
            with self._storage._told():
                self._file.flush()
            if not self._rows:
                return np.empty(shape, self._dtype)
            return np.memmap(self._file, self._dtype, "r+", 0, shape)
        if len(self._parts) != 1:
            none = np.empty((0, *self._row_shape), self._dtype)
            self._parts = [np.concatenate([none, *self._parts])]
        return self._parts[0]

    def _spill(self) -> None:
        folder = self._storage._folder
        with self._storage._told():
            self._file = tempfile.TemporaryFile(dir=folder, prefix="sinstool-")  # noqa: SIM115
        for part in self._parts:
            self._write(part)
        self._parts = []

    def _write(self, values: NDArray[Any]) -> None:
        assert self._file is not None
        with self._storage._told():
            self._file.write(np.ascontiguousarray(values).data)

    def _close(self) -> None:
        self._parts = []
        if self._file is not None:
            # What is still in its buffer goes with it, also where there was no room for it.
            with suppress(OSError):
                self._file.close()
            self._file = None


class Storage:
    """Columns that share one limit of memory; a context manager.

    Parameters
    ----------
    limit : int, optional
        Bytes kept in memory. When the columns together have more, all go to files.
    folder : path, optional
        Where the files lie; the system's folder for temporary files by default.

    Raises
    ------
    OutputError
        On appending, if the folder cannot be written or is full.
    """

    def __init__(self, limit: int = DEFAULT_LIMIT, folder: Path | str | None = None) -> None:
        self._limit = limit
        self._folder = None if folder is None else Path(folder)
        self._columns: list[Column] = []
        self._bytes = 0
        self._closed = False

    @property
    def spilled(self) -> bool:
        """Whether the columns are in files."""
        return any(column.spilled for column in self._columns)

    def column(self, row_shape: Sequence[int] = (), dtype: DTypeLike = np.float64) -> Column:
        """Add a column without rows.

        Parameters
        ----------
        row_shape : sequence of int, optional
            Of each row; scalars by default.
        dtype : optional

        Returns
        -------
        Column
        """
        self._check_open()
        column = Column(self, tuple(row_shape), dtype)
        self._columns.append(column)
        if self._bytes > self._limit:
            column._spill()
        return column

    def close(self) -> None:
        """Forget all rows and remove the files. Arrays given out must not be used after it."""
        for column in self._columns:
            column._close()
        self._closed = True

    def __enter__(self) -> Storage:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _added(self, size: int) -> None:
        self._bytes += size
        if self._bytes > self._limit:
            for column in self._columns:
                if not column.spilled:
                    column._spill()

    @contextmanager
    def _told(self) -> Iterator[None]:
        """What the system says of a file, told in terms of the folder that it is in."""
        try:
            yield
        except OSError as exc:
            room = "make room there"
            if self._folder is not None:
                where, hint = f" in {self._folder}", f"{room}, or choose another folder"
            else:
                # No file, nor a name, where none of the system's folders can be written
                where = f" in {tempfile.tempdir}" if tempfile.tempdir is not None else ""
                hint = f"{room}, or name another folder in the variable TMPDIR"
            raise OutputError(
                f"a temporary file{where} cannot be written: {exc.strerror or exc}", hint
            ) from exc

    def _check_open(self) -> None:
        if self._closed:
            raise ValueError("This storage is closed.")
