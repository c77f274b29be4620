"""Files of compiled loops, one for each loop and combination of argument types.

numba numbers its files and keeps an index of them. Processes that compile at the same time may use
the same number twice, so that machine code for other types is run; and a process that is killed
between writing index and file leaves an index that names code of an earlier source. Here the name
of a file is a hash of all that its code depends on, the file also contains these values, and it
appears whole or not at all.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import sys
import tempfile
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any
from uuid import uuid4

from sinstool.core.errors import UncachedWarning


class CompiledFiles:
    """A cache like numba's `IndexDataCacheFile`, without an index.

    Parameters
    ----------
    folder : str
        Where the files are.
    base : str
        Beginning of the names of all files of the loop.
    stamp : object
        State of the loop's source; files with a different stamp are out of date.
    dumps : callable, optional
        Serialises what is stored.
    """

    def __init__(
        self, folder: str, base: str, stamp: Any, dumps: Callable[[Any], bytes] = pickle.dumps
    ) -> None:
        self.folder = Path(folder)
        self.stamp = stamp
        self.dumps = dumps
        self.every, self.start = f"{base}.", f"{base}.{_digest(self.stamp, 8)}."

    def save(self, key: Any, data: Any) -> None:
        """Store the code for a key, and remove files that are out of date.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        path = self._path(key)
        body = self.dumps((self.stamp, key, data))
        whole = hashlib.sha256(body).digest() + body
        beside = path.with_name(f"{path.name}.{uuid4().hex[:8]}")
        try:
            beside.write_bytes(whole)
            os.replace(beside, path)
        except BaseException:
            with suppress(OSError):
                beside.unlink()
            raise
        for name in self._names():
            if not name.startswith(self.start):
                self._remove(name)

    def load(self, key: Any) -> Any:
        """The code for a key; None if there is none.

        Raises
        ------
        Exception
            If the file is damaged. Damaged machine code must not reach LLVM, which would abort.
        """
        try:
            whole = self._path(key).read_bytes()
        except FileNotFoundError:
            return None
        if hashlib.sha256(whole[32:]).digest() != whole[:32]:
            raise ValueError("the file is damaged")
        stamp, own, data = pickle.loads(whole[32:])
        return data if (stamp, own) == (self.stamp, key) else None

    def flush(self) -> None:
        """Remove all code of the loop, as far as the folder allows."""
        for name in self._names():
            self._remove(name)

    def _path(self, key: Any) -> Path:
        return self.folder / f"{self.start}{_digest(key, 16)}.nbc"

    def _names(self) -> list[str]:
        return [name for name in os.listdir(self.folder) if name.startswith(self.every)]

    def _remove(self, name: str) -> None:
        with suppress(OSError):
            (self.folder / name).unlink()


def base_name(function: Any) -> str:
    """Beginning of the names of a function's files, formed as numba forms it."""
    module = os.path.splitext(os.path.basename(function.__code__.co_filename))[0]
    name = function.__qualname__.replace("<", "").replace(">", "")
    version = "{}{}".format(*sys.version_info)
    return f"{module}.{name}-{function.__code__.co_firstlineno}.py{version}{sys.abiflags}"


@cache
def folder_of(file: str) -> str | None:
    """Folder for the compiled loops of a source file: the first that can be written to.

    The candidates are a folder in NUMBA_CACHE_DIR, if that is set, `__pycache__` beside the file,
    and a folder in the user's cache. If none can be written to, `__pycache__` is still read.

    Parameters
    ----------
    file : str
        Path of the source.

    Returns
    -------
    str or None
        None if the source is not a file.
    """
    if not os.path.exists(file):
        return None
    source = os.path.dirname(os.path.abspath(file))
    inside = f"{os.path.basename(source)}_{_digest(source, 40)}"
    beside = os.path.join(source, "__pycache__")
    asked = os.environ.get("NUMBA_CACHE_DIR")
    users = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    places = [beside, os.path.join(users, "numba", inside)]
    for place in [os.path.join(asked, inside), *places] if asked else places:
        with suppress(OSError):
            os.makedirs(place, exist_ok=True)
            tempfile.TemporaryFile(dir=place).close()
            return place
    return beside


@cache
def warn_uncached(reason: str) -> None:
    """Warn once that compiled loops cannot be cached, and say what to do."""
    warnings.warn(
        f"compiled code cannot be cached ({reason}), so every run compiles it again: set the"
        " environment variable NUMBA_CACHE_DIR to a writable folder with free space",
        UncachedWarning,
        stacklevel=2,
    )


def _digest(value: Any, size: int) -> str:
    return hashlib.sha256(repr(value).encode()).hexdigest()[:size]
