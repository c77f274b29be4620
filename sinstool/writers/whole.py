"""A file that appears under its name only when it is complete."""

from __future__ import annotations

import contextlib
import io
import os
import tempfile
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from sinstool.errors import OutputError

SYNC_BYTES = 48 * 2**20
# Not every system has the call that leaves the file's times alone.
_put_on_disk = getattr(os, "fdatasync", os.fsync)


def check_output(output: Path, inputs: list[Path], overwrite: bool) -> None:
    """Refuse an output that exists, is an input, or lies in a folder that cannot be written.

    Parameters
    ----------
    output : Path
    inputs : list of Path
    overwrite : bool
        An existing file may be replaced; an input never.

    Raises
    ------
    OutputError
    """
    try:
        _check_output(output, inputs, overwrite)
    except OSError as exc:
        # A folder that may not be looked into, a name too long for the file system
        raise OutputError(f"cannot write {output}: {exc.strerror}", "choose another -o") from exc


def _check_output(output: Path, inputs: list[Path], overwrite: bool) -> None:
    folder = output.parent if str(output.parent) else Path(".")
    if output.is_dir():
        raise OutputError(f"{output} is a folder", "give the name of a file with -o")
    for source in inputs:
        # A new file in a bag's folder would become part of the bag.
        if source.is_dir() and source.resolve() in output.resolve().parents:
            raise OutputError(
                f"{output} lies in the input's own folder", "choose another folder with -o"
            )
    if output.exists():
        for source in inputs:
            if output.samefile(source):
                raise OutputError(f"{output} is the input itself", "choose another file with -o")
        if not overwrite:
            raise OutputError(f"{output} exists already", "choose another name or add --overwrite")
    if not folder.is_dir():
        raise OutputError(f"the folder {folder} does not exist", "make it, or choose another")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputError(f"the folder {folder} cannot be written to", "choose another with -o")


class _SyncedFile(io.BufferedWriter):
    """A file whose content goes to the disk while the rest is made, not all of it at the end.

    The buffer joins small records; chunks are larger and go past it, not copied once more.
    """

    def __init__(self, handle: int) -> None:
        super().__init__(io.FileIO(handle, "wb"), 2**16)
        self._unsynced = 0
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="sinstool-sync")
        self._sync: Future[None] | None = None

    def write(self, data: Any, /) -> int:
        """Write, and now and then have what was written put on the disk."""
        count = super().write(data)
        self._unsynced += count
        if self._unsynced > SYNC_BYTES and (self._sync is None or self._sync.done()):
            # Errors show again, and are told, when everything is synced in the end.
            self._sync = self._pool.submit(_put_on_disk, self.fileno())
            self._unsynced = 0
        return count

    def close(self) -> None:
        """Close, when nothing is being synced any more."""
        self._pool.shutdown(wait=True)
        super().close()


class WholeFile:
    """Write to a temporary file beside the target; rename it on success, remove it otherwise.

    Parameters
    ----------
    path : Path
        The target.

    Raises
    ------
    OutputError
        The folder refuses a new file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            # cut, as a name may be so long already that nothing can be added to it
            handle, name = tempfile.mkstemp(
                prefix=f".{path.name[:40]}.", suffix=".part", dir=path.parent or "."
            )
        except OSError as exc:
            raise OutputError(f"cannot write in {path.parent}: {exc.strerror}") from exc
        self._part = Path(name)
        self.stream: IO[bytes] = _SyncedFile(handle)

    def __enter__(self) -> WholeFile:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        exc: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self._complete()
        else:
            self._discard()
            if isinstance(exc, OSError) and exc.errno is not None:
                raise OutputError(f"writing {self.path} failed: {exc.strerror}") from exc

    def _complete(self) -> None:
        try:
            self.stream.flush()
            os.fsync(self.stream.fileno())
            self.stream.close()
            # mkstemp makes files private; the user's own mask decides who may read the result.
            mask = os.umask(0)
            os.umask(mask)
            os.chmod(self._part, 0o666 & ~mask)
            os.replace(self._part, self.path)
        except BaseException as exc:
            self._discard()
            if isinstance(exc, OSError):
                raise OutputError(f"writing {self.path} failed: {exc.strerror}") from exc
            raise

    def _discard(self) -> None:
        # A full disk refuses the last flush too; the file goes anyway.
        with contextlib.suppress(OSError):
            self.stream.close()
        self._part.unlink(missing_ok=True)
