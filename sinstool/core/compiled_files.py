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
from contextlib import suppress
from pathlib import Path
from typing import Any
from uuid import uuid4

from numba import __version__
from numba.core.serialize import dumps


class CompiledFiles:
    """A cache like numba's `IndexDataCacheFile`, without an index.

    Parameters
    ----------
    base : str
        Of all file names of the loop.
    stamp : object
        Of the loop's source; what bears another is out of date.
    """

    def __init__(self, folder: str, base: str, stamp: Any) -> None:
        self.folder = Path(folder)
        self.stamp = (__version__, stamp)
        self.every, self.start = f"{base}.", f"{base}.{_digest(self.stamp, 8)}."

    def save(self, key: Any, data: Any) -> None:
        """Store the code for a key, and remove files that are out of date.

        Raises
        ------
        OSError
            The folder or the disk does not allow it.
        """
        path = self._path(key)
        whole = dumps((self.stamp, key, data))
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
            Whatever pickle comes upon in a damaged file.
        """
        try:
            whole = self._path(key).read_bytes()
        except FileNotFoundError:
            return None
        stamp, own, data = pickle.loads(whole)
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


def _digest(value: Any, size: int) -> str:
    return hashlib.sha256(repr(value).encode()).hexdigest()[:size]
