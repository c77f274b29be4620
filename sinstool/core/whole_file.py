"""Files that appear under their names only when they are complete."""

from __future__ import annotations

import contextlib
import csv
import io
import os
import shlex
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from sinstool.core.errors import ConfigurationError, OutputError
from sinstool.core.temporary import forget, new_file, remove_file, sweep

# Suffixes of what `sinstool export` writes
EXPORTED = (".csv", ".parquet", ".tum", ".kml", ".gpx", ".geojson")
SYNC_BYTES = 48 * 2**20
# fdatasync does not write the file's times, but not every system has it
_put_on_disk = getattr(os, "fdatasync", os.fsync)


@contextlib.contextmanager
def _as_output_error(what: str, hint: str = "") -> Iterator[None]:
    """Turn an error of the operating system into one line."""
    try:
        yield
    except OSError as exc:
        if exc.errno is None:
            raise
        raise OutputError(f"{what}: {exc.strerror}", hint) from exc


def check_output(output: Path, inputs: list[Path], overwrite: bool) -> None:
    """Refuse an output that exists, is an input, or lies in a folder that cannot be written.

    Parameters
    ----------
    overwrite : bool
        Whether an existing file may be replaced; an input never is.

    Raises
    ------
    OutputError
    """
    if str(output) == "-":
        raise OutputError("files are not written to standard output", "give the name of one")
    # For example: no permission to search a folder, or a name too long for the file system
    with _as_output_error(f"cannot write {output}", "choose another -o"):
        # A symbolic link is kept, and its target is written.
        folder = _real(output).parent
        if output.is_dir():
            raise OutputError(f"{output} is a folder", "give the name of a file with -o")
        if output.exists() and not output.is_file():
            raise OutputError(f"{output} is a device or a pipe", "give the name of a file with -o")
        for source in inputs:
            # A new file in a bag's folder would become part of the bag.
            if source.is_dir() and source.resolve() in output.resolve().parents:
                problem = f"{output} lies in the input's own folder"
                raise OutputError(problem, "choose another folder with -o")
            # What is missing is told of when it is opened.
            if output.exists() and source.exists() and output.samefile(source):
                raise OutputError(f"{output} is the input itself", "choose another file with -o")
        if output.exists() and not overwrite:
            raise OutputError(f"{output} exists already", "choose another name or add --overwrite")
        if not folder.is_dir():
            raise OutputError(f"the folder {folder} does not exist", "make it, or choose another")
        if not os.access(folder, os.W_OK | os.X_OK):
            problem = f"the folder {folder} cannot be written to"
            raise OutputError(problem, "choose another with -o")


def check_mcap_name(output: Path, of_log: bool = False) -> None:
    """Refuse a name for an MCAP that has the suffix of another format.

    Parameters
    ----------
    of_log : bool, optional
        Whether the output is a log, which `sinstool export` cannot convert, and not a result.

    Raises
    ------
    ConfigurationError
        If the name has a suffix other than ``.mcap``; it may have none.
    """
    suffix = output.suffix.lower()
    if suffix in ("", ".mcap"):
        return
    mcap = output.with_suffix(".mcap")
    if of_log:
        formats = suffix if suffix in EXPORTED else ", ".join(EXPORTED)
        then = f"; `sinstool export` writes {formats} from the output of `sinstool process`"
    elif suffix in EXPORTED:
        then = f", then run `{shlex.join(['sinstool', 'export', str(mcap), '-o', str(output)])}`"
    else:
        then = f"; `sinstool export` converts it to {', '.join(EXPORTED)}"
    raise ConfigurationError(f"-o {output}: the output is an MCAP", f"give -o {mcap}{then}")


def check_new_folder(folder: Path, option: str) -> None:
    """Refuse a folder for tables that exists and is not empty.

    Parameters
    ----------
    option : str
        The option that names the folder, for the message.

    Raises
    ------
    OutputError
    """
    sweep(folder)
    with _as_output_error(f"the folder {folder} cannot be read"):
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            problem = f"{folder} exists and is not an empty folder"
            raise OutputError(problem, f"give another {option}")


def _real(path: Path) -> Path:
    return Path(os.path.realpath(path))


@dataclass
class _Group:
    """Files that get their names only when all of them are complete, and new folders."""

    files: list[WholeFile] = field(default_factory=list)
    folders: list[Path] = field(default_factory=list)


_group: ContextVar[_Group | None] = ContextVar("_group", default=None)


@contextlib.contextmanager
def commit_together() -> Iterator[None]:
    """Context at whose end the files completed inside appear together; after an error, none.

    Raises
    ------
    OutputError
        If a file was written twice, or its folder no longer exists.
    """
    if _group.get() is not None:
        yield
        return
    group = _Group()
    token = _group.set(group)
    try:
        yield
        for file in group.files:
            file.appear()
    except BaseException:
        for file in group.files:
            file.discard()
        for folder in reversed(group.folders):
            # fails for a folder that another program has used meanwhile
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise
    finally:
        _group.reset(token)


def path_for_now(path: Path) -> Path:
    """Path under which a file can be read before the end of :func:`commit_together`.

    Returns
    -------
    Path
        The temporary file; `path` itself if the file is not waiting.
    """
    group = _group.get() or _Group()
    target = _real(path)
    return next((file._part for file in group.files if file._target == target), path)


def make_folder(path: Path) -> None:
    """Make a folder and its parents; if :func:`commit_together` fails, it removes them again.

    Parameters
    ----------
    path : Path
        It may exist already.

    Raises
    ------
    OutputError
    """
    group = _group.get() or _Group()
    with _as_output_error(f"cannot make the folder {path}"):
        for folder in reversed([p for p in (path, *path.parents) if not p.exists()]):
            folder.mkdir()
            group.folders.append(folder)


class _SyncedFile(io.BufferedWriter):
    """A file that is synced to the disk while it is written, not only at the end.

    The buffer joins small records; chunks are larger than it and are written without a copy.
    """

    def __init__(self, handle: int) -> None:
        super().__init__(io.FileIO(handle, "wb"), 2**16)
        self._unsynced = 0
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="sinstool-sync")
        self._sync: Future[None] | None = None

    def write(self, data: Any, /) -> int:
        """Write, and regularly flush the data to the disk."""
        count = super().write(data)
        self._unsynced += count
        if self._unsynced > SYNC_BYTES and (self._sync is None or self._sync.done()):
            # An error here is ignored: the last sync will raise it again.
            self._sync = self._pool.submit(_put_on_disk, self.fileno())
            self._unsynced = 0
        return count

    def close(self) -> None:
        """Close the file once the sync in progress has ended."""
        self._pool.shutdown(wait=True)
        super().close()


class WholeFile:
    """Write to a temporary file beside the target; rename it on success, remove it otherwise.

    Inside :func:`commit_together` the renaming waits for the end of that context.

    Parameters
    ----------
    path : Path
        The target; a symbolic link is followed.

    Raises
    ------
    OutputError
        If the folder cannot be written to, or the target is already written inside the same
        :func:`commit_together`.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._target = _real(path)
        group = _group.get() or _Group()
        if any(self._target == file._target for file in group.files):
            raise OutputError(f"{path} is named twice", "choose another name")
        with _as_output_error(f"cannot write in {path.parent}"):
            handle, self._part = new_file(self._target.parent, path.name)
        self.stream = _SyncedFile(handle)

    def __enter__(self) -> WholeFile:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        exc: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._or_nothing():
            if exc is not None:
                raise exc
            self.stream.flush()
            # Temporary files are private; the user's own mask decides who may read the result.
            mask = os.umask(0)
            os.umask(mask)
            os.chmod(self._part, 0o666 & ~mask)
            os.fsync(self.stream.fileno())
        group = _group.get()
        if group is None:
            self.appear()
        else:
            group.files.append(self)

    def appear(self) -> None:
        """Give the complete file its name.

        Raises
        ------
        OutputError
            If the folder no longer exists, or the name is now that of a folder.
        """
        with self._or_nothing():
            if os.name == "nt":  # which renames no open file
                self.stream.close()
            # Renamed while open, and so locked: another run would remove it as a leftover.
            os.replace(self._part, self._target)
            record_output(self.path)
            forget(self._part)
            self.stream.close()
            _sync_folder(self._target.parent)

    def discard(self) -> None:
        """Remove the unfinished file; a completed one stays."""
        # On a full disk the last flush fails too; the file is removed anyway.
        with contextlib.suppress(OSError):
            self.stream.close()
        with contextlib.suppress(OSError):
            remove_file(self._part)

    @contextlib.contextmanager
    def _or_nothing(self) -> Iterator[None]:
        try:
            with _as_output_error(f"writing {self.path} failed"):
                yield
        except BaseException:
            self.discard()
            raise


def write_whole(path: Path, content: bytes | str) -> None:
    """Write a whole file; text is encoded in UTF-8.

    Raises
    ------
    OutputError
    """
    with WholeFile(path) as file:
        # File names in the text may not be UTF-8, but its readers expect UTF-8
        raw = content.encode(errors="replace") if isinstance(content, str) else content
        file.stream.write(raw)


def write_table(
    path: Path, names: Sequence[str], rows: Iterable[Sequence[Any]], end: str = "\n"
) -> None:
    """Write a whole CSV file.

    Parameters
    ----------
    path : Path
        The file.
    names : sequence of str
        The header.
    rows : iterable of sequence
        The values of each row.
    end : str, optional
        End of each line.

    Raises
    ------
    OutputError
    """
    buffer = io.StringIO(newline="")
    writer = csv.writer(buffer, lineterminator=end)
    writer.writerow(names)
    writer.writerows(rows)
    write_whole(path, buffer.getvalue())


def _sync_folder(folder: Path) -> None:
    """Sync a folder, so that a new name in it survives a power cut."""
    # Some systems cannot sync a folder; the file is whole there too.
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


_outputs: ContextVar[list[Path] | None] = ContextVar("_outputs", default=None)


@contextlib.contextmanager
def completed_outputs() -> Iterator[list[Path]]:
    """Collect the files that are completed inside.

    Yields
    ------
    list of Path
        The files so far; it grows while files are completed.
    """
    outputs: list[Path] = []
    token = _outputs.set(outputs)
    try:
        yield outputs
    finally:
        _outputs.reset(token)


def record_output(*paths: Path) -> None:
    """Add files to the list of :func:`completed_outputs`, if there is one."""
    outputs = _outputs.get()
    if outputs is not None:
        outputs += paths
