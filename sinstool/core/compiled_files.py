"""Files of compiled loops, one for each loop and its types of arguments.

numba keeps an index beside them, and numbers the files: processes that compile at the same time
give out the same number twice, and then machine code for other types is run; a process that is
killed between index and file leaves an index that names code of an earlier source. Here a file's
name follows from all that its code depends on, which stands in the file too, and a file appears
whole or not at all.
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
    base : str
        Of all file names of the loop.
    stamp : object
        Of the loop's source; what bears another is out of date.
    dumps : callable, optional
        Makes bytes of what is stored.
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
            The folder or the disk does not allow it.
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
        """The code for a key; None where there is none.

        Raises
        ------
        Exception
            The file is damaged; LLVM would end the program where its code is.
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
    """Start of the names of a function's files, as numba has it."""
    module = os.path.splitext(os.path.basename(function.__code__.co_filename))[0]
    name = function.__qualname__.replace("<", "").replace(">", "")
    version = "{}{}".format(*sys.version_info)
    return f"{module}.{name}-{function.__code__.co_firstlineno}.py{version}{sys.abiflags}"


@cache
def folder_of(file: str) -> str | None:
    """Folder for what is compiled from a source file: the first that can be written.

    It is one in the folder that NUMBA_CACHE_DIR names, or else `__pycache__` beside the file or one
    in the user's folder for caches. Where none can be written, `__pycache__` may still be read.

    Parameters
    ----------
    file : str
        A path.

    Returns
    -------
    str or None
        Where the source is no file, None.
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
    """Say once how compiled loops can be kept."""
    warnings.warn(
        f"compiled code cannot be cached ({reason}), so every run compiles it again: set the"
        " environment variable NUMBA_CACHE_DIR to a writable folder with free space",
        UncachedWarning,
        stacklevel=2,
    )


def _digest(value: Any, size: int) -> str:
    return hashlib.sha256(repr(value).encode()).hexdigest()[:size]
