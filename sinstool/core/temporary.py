"""Temporary files and folders that are removed later even if the run is killed.

Whoever makes one holds an advisory lock on it. The system gives the lock back however a process
ends, so the next run that makes one in the same folder can tell those of running processes from
those that a kill or a power cut has left, and removes the latter first. Two cases remain in which
a lock says nothing: a file system that has no locks, and one that keeps them within each host.
Names hold the host, therefore, and what another host made, or what cannot be locked, is left alone
until nobody has written to it for a day.
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
# Of this process: removed at its end, should a second interruption have broken off tidying up
_unfinished: set[Path] = set()


def _host() -> str:
    return f"{zlib.crc32(platform.node().encode()):08x}"


def _hidden(folder: Path, name: str, host: str) -> Path:
    # cut, as a name may be so long already that nothing can be added to it
    return folder / f".{name[:NAME_LENGTH]}.{host}-{secrets.token_hex(8)}.sinstool-part"


def new_file(folder: Path, name: str) -> tuple[int, Path]:
    """Create a file, locked until it is closed, and remove leftovers of dead runs beside it.

    Parameters
    ----------
    name : str
        What it is for; the beginning of it becomes part of the file's hidden name.

    Returns
    -------
    handle : int
        Open for reading and writing; not inherited by other programs.
    path : Path

    Raises
    ------
    OSError
        The folder refuses a new file.
    """
    sweep(folder)
    while True:
        path = _hidden(folder, name, _host())
        _unfinished.add(path)
        try:
            flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
            handle = os.open(path, flags, 0o600)
        except OSError:  # not of an interruption: the file may be there already
            _unfinished.discard(path)
            raise
        if _locked_for_good(handle):
            return handle, path
        os.close(handle)


def unlocked_name(folder: Path, name: str) -> Path:
    """Name for a file that nobody locks; it is removed when it is a day old.

    Parameters
    ----------
    name : str
        What it is for.
    """
    return _hidden(folder, name, _NO_HOST)


def remove_file(path: Path) -> None:
    """Remove a file of :func:`new_file` and its folder, if they are still there."""
    with contextlib.suppress(FileNotFoundError):
        shutil.rmtree(_folder_of(path))
    path.unlink(missing_ok=True)
    forget(path)


def forget(path: Path) -> None:
    """Leave a file alone: it has another name now."""
    _unfinished.discard(path)


def _folder_of(path: Path) -> Path:
    return path.with_suffix(".sinstool-folder")


class TemporaryFolder:
    """A folder in the system's place for temporary files; the file beside it holds its lock.

    Raises
    ------
    OSError
        It cannot be made.
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
        Nothing happens where it cannot be read, or what lies in it cannot be removed.

    Returns
    -------
    int
        How many are in use by others.
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
    """Whether somebody has it locked; if nobody has and it is ours or old, it is removed."""
    # for writing, as locks of a network's file system want it
    with path.open("r+b") as stream:
        locked = _lock(stream.fileno())
        if locked is False:
            return True
        old = time.time() - os.fstat(stream.fileno()).st_mtime > DAY
        if old or (locked and host == _host()):
            remove_file(path)
        return False


def _lock(handle: int, wait: bool = False) -> bool | None:
    """Whether a lock was had; None where there are none."""
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
def _tidy() -> None:
    for path in tuple(_unfinished):
        with contextlib.suppress(OSError):
            remove_file(path)
