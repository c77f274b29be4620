"""Temporary files and folders that are removed later even if the run is killed.

The process that makes one holds an advisory lock on it. The system releases the lock however the
process ends, so the next run that makes one in the same folder can tell the files of running
processes from those that a kill or a power cut has left, and removes the latter. A lock says
nothing on file systems without locks, or with locks that are seen only within each host. Therefore
the names contain the host, and files of other hosts, or that cannot be locked, are left alone until
they have not been written to for a day.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import platform
import re
import secrets
import shutil
import tempfile
import time
import zlib
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows, which removes no file that somebody has open
    fcntl = None  # type: ignore[assignment]

DAY = 86400.0
NAME_LENGTH = 40
_NAME = re.compile(r"\..*\.([0-9a-f]{8})-[0-9a-f]{16}\.sinstool-part", re.DOTALL)
# In place of a host, for files that are left alone for a day wherever they are seen
_NO_HOST = "00000000"
# Unfinished files of this process, removed at its end if a second interrupt stopped the clean-up
_unfinished: set[Path] = set()


def _host() -> str:
    return f"{zlib.crc32(platform.node().encode()):08x}"


def _hidden(folder: Path, name: str, host: str) -> Path:
    # cut, because the name of the target may already be as long as the file system allows
    return folder / f".{name[:NAME_LENGTH]}.{host}-{secrets.token_hex(8)}.sinstool-part"


def new_file(folder: Path, name: str) -> tuple[int, Path]:
    """Create a file, locked until it is closed, and remove leftovers of dead runs beside it.

    Parameters
    ----------
    name : str
        Name of the target; its beginning becomes part of the file's hidden name.

    Returns
    -------
    handle : int
        Open for reading and writing; not inherited by other programs.
    path : Path

    Raises
    ------
    OSError
        If the file cannot be made.
    """
    sweep(folder)
    while True:
        path = _hidden(folder, name, _host())
        _unfinished.add(path)
        try:
            flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
            handle = os.open(path, flags, 0o600)
        except OSError:  # not after an interrupt, when the file may exist already
            _unfinished.discard(path)
            raise
        if _locked_for_good(handle):
            return handle, path
        os.close(handle)


def unlocked_name(folder: Path, name: str) -> Path:
    """Name for a file that is not locked; :func:`sweep` removes it when it is a day old.

    Parameters
    ----------
    name : str
        Purpose; its beginning becomes part of the name.
    """
    return _hidden(folder, name, _NO_HOST)


def remove_file(path: Path) -> None:
    """Remove a file that :func:`new_file` made, and its folder, if they still exist."""
    with contextlib.suppress(FileNotFoundError):
        shutil.rmtree(_folder_of(path))
    path.unlink(missing_ok=True)
    forget(path)


def forget(path: Path) -> None:
    """Do not remove a file at the end of the process: it has been given its final name."""
    _unfinished.discard(path)


def _folder_of(path: Path) -> Path:
    return path.with_suffix(".sinstool-folder")


class TemporaryFolder:
    """A folder in the system's folder for temporary files; a file beside it holds its lock.

    Raises
    ------
    OSError
        If it cannot be made.
    """

    def __init__(self) -> None:
        self._handle, self._lock = new_file(Path(tempfile.gettempdir()), "folder")
        self.path = _folder_of(self._lock)
        self.path.mkdir(0o700)

    def cleanup(self) -> None:
        """Remove the folder and all that is in it."""
        with contextlib.suppress(OSError):
            remove_file(self._lock)
        os.close(self._handle)


def sweep(folder: Path) -> int:
    """Remove the temporary files and folders that ended runs have left in a folder.

    Parameters
    ----------
    folder : Path
        A folder that cannot be read, and files that cannot be removed, are skipped.

    Returns
    -------
    int
        Number of temporary files that are locked by other processes.
    """
    in_use = 0
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            match, path = _NAME.fullmatch(entry.name), Path(entry.path)
            if match and path not in _unfinished and entry.is_file(follow_symlinks=False):
                with contextlib.suppress(OSError):
                    in_use += _in_use(path, match[1])
    return in_use


def _in_use(path: Path, host: str) -> bool:
    """Whether a file is locked; if it is not, and it is of this host or old, it is removed."""
    # open for writing, which locks on network file systems require
    with path.open("r+b") as stream:
        locked = _lock(stream.fileno())
        if locked is False:
            return True
        old = time.time() - os.fstat(stream.fileno()).st_mtime > DAY
        if old or (locked and host == _host()):
            remove_file(path)
        return False


def _lock(handle: int, wait: bool = False) -> bool | None:
    """Whether the file could be locked; None if the system has no locks."""
    if fcntl is None:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return None
    return True


def _locked_for_good(handle: int) -> bool:
    """Lock a new file; False where a sweep has removed it in the meantime."""
    return _lock(handle, wait=True) is None or os.fstat(handle).st_nlink > 0


@atexit.register
def remove_unfinished() -> None:
    """Remove what an interrupted clean-up has left; a process that ends without exit handlers does
    so itself.
    """
    for path in tuple(_unfinished):
        with contextlib.suppress(OSError):
            remove_file(path)
