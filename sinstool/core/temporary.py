"""Temporary files and folders that a killed run cannot leave behind for good.

Whoever makes one holds an advisory lock on it. The system gives the lock back however a process
ends, so the next run that makes one in the same folder can tell those of running processes from
those that a kill or a power cut has left, and removes the latter first. Two cases remain in which
a lock says nothing: a file system that has no locks, and one that keeps them within each host.
Their names hold the host, therefore, and what another host or no lock stands for is left alone
until nobody has written to it for a day.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import platform
import re
import shutil
import stat
import tempfile
import time
import zlib
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows, which does not remove a file that somebody has open
    fcntl = None  # type: ignore[assignment]

DAY = 86400.0
NAME_LENGTH = 40
_FILE = re.compile(r"\..*\.([0-9a-f]{8})-[0-9a-f]{16}\.sinstool-part", re.DOTALL)
_FOLDER = re.compile(r"sinstool-([0-9a-f]{8})-[0-9a-f]{16}")
# In place of a host: what another one stands for is left alone for a day
_NOWHERE = "00000000"
# Of this process: removed at its end, should a second interruption have broken off tidying up
_made: set[Path] = set()


def _token() -> str:
    host = zlib.crc32(platform.node().encode())
    return f"{host:08x}-{os.urandom(8).hex()}"


def new_file(folder: Path, name: str) -> tuple[int, Path]:
    """Make a file, open and locked until it is closed, and remove what dead runs left beside it.

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
        # cut, as a name may be so long already that nothing can be added to it
        path = folder / f".{name[:NAME_LENGTH]}.{_token()}.sinstool-part"
        _made.add(path)
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL
        flags |= getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
        try:
            handle = os.open(path, flags, 0o600)
        except OSError:  # not of an interruption: the file may be there already
            _made.discard(path)
            raise
        if _locked_for_good(handle):
            return handle, path
        os.close(handle)


def unheld(folder: Path, name: str) -> Path:
    """Name of a file that nobody holds a lock on; it is removed when it is a day old.

    Parameters
    ----------
    name : str
        What it is for.
    """
    return folder / f".{name[:NAME_LENGTH]}.{_NOWHERE}-{os.urandom(8).hex()}.sinstool-part"


def remove_file(path: Path) -> None:
    """Remove a file of :func:`new_file`, if it is still there under its temporary name."""
    path.unlink(missing_ok=True)
    forget(path)


def forget(path: Path) -> None:
    """Leave a file alone: it has another name now."""
    _made.discard(path)


class TemporaryFolder:
    """A folder in the system's place for temporary files.

    Raises
    ------
    OSError
        It cannot be made.
    """

    def __init__(self) -> None:
        place = Path(tempfile.gettempdir())
        sweep(place)
        while True:
            self.path = place / f"sinstool-{_token()}"
            _made.add(self.path)
            try:
                self.path.mkdir(0o700)
            except OSError:
                _made.discard(self.path)
                raise
            with contextlib.suppress(FileNotFoundError):  # where a sweep came between
                self._handle = _open_folder(self.path)
                if self._handle is None or _locked_for_good(self._handle):
                    return
                os.close(self._handle)

    def cleanup(self) -> None:
        """Remove the folder and all that is in it."""
        shutil.rmtree(self.path, ignore_errors=True)
        _made.discard(self.path)
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None


def sweep(folder: Path) -> int:
    """Remove the temporary files and folders that ended runs have left in a folder.

    Parameters
    ----------
    folder : Path
        Nothing happens where it cannot be read, or what lies in it cannot be removed.

    Returns
    -------
    int
        How many others hold.
    """
    held = 0
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            found = _FILE.fullmatch(entry.name) or _FOLDER.fullmatch(entry.name)
            if found and Path(entry.path) not in _made:
                with contextlib.suppress(OSError):
                    held += _held_or_removed(Path(entry.path), found[1])
    return held


def _held_or_removed(path: Path, host: str) -> bool:
    """Whether somebody holds it; if nobody does and it is ours or old, it is removed."""
    kind = path.lstat().st_mode
    if stat.S_ISREG(kind):
        # for writing, as locks of a network's file system want it
        handle: int | None = os.open(path, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0))
    elif stat.S_ISDIR(kind):
        handle = _open_folder(path)
    else:
        return False
    try:
        free = None if handle is None else _lock(handle, wait=False)
        if free is False:
            return True
        ours = host == f"{zlib.crc32(platform.node().encode()):08x}"
        if not (free and ours) and time.time() - path.lstat().st_mtime < DAY:
            return False
        if stat.S_ISDIR(kind):
            shutil.rmtree(path)
            return False
        if fcntl is None and handle is not None:
            os.close(handle)
            handle = None
        path.unlink()
        return False
    finally:
        if handle is not None:
            os.close(handle)


def _open_folder(path: Path) -> int | None:
    """Handle of a folder; None where folders cannot be opened."""
    if not hasattr(os, "O_DIRECTORY"):
        return None
    return os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)


def _lock(handle: int, wait: bool) -> bool | None:
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
    """Lock what was just made; false where a sweep came between, and it is no longer there."""
    return _lock(handle, wait=True) is None or os.fstat(handle).st_nlink > 0


@atexit.register
def _tidy() -> None:
    for path in tuple(_made):
        with contextlib.suppress(OSError):
            if path.is_dir():
                shutil.rmtree(path)
            else:
                remove_file(path)
