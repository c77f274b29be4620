"""numba's cache of compiled loops, for those that are run by numba.

Before numba looks into its cache, it loads its implementations of Python and NumPy, and
`scipy.linalg` with them, which takes longer than most logs. Machine code from the cache needs only
the runtime that counts references to arrays, and only that is loaded here. If a loop has to be
compiled after all, numba's compiler loads the rest by itself.

numba raises an error if it has no folder for a loop's cache, or if the folder is full or holds a
damaged file. Here such loops are compiled for one run, and a warning says so once.
"""

from __future__ import annotations

import os
from contextlib import suppress
from functools import cache
from typing import Any

from numba import __version__
from numba.core import caching
from numba.core.caching import FunctionCache
from numba.core.runtime import rtsys
from numba.core.serialize import dumps

from sinstool.core import compiling
from sinstool.core.compiled_files import CompiledFiles, warn_uncached
from sinstool.core.compiled_sources import stamp

__all__ = ["set_up_cache"]

PACKAGE = __name__.partition(".")[0]


def _is_ours(function: Any) -> bool:
    return str(function.__module__).partition(".")[0] == PACKAGE


@cache
def set_up_cache() -> None:
    """Replace numba's cache files for this package's loops; other packages keep numba's own."""
    theirs_load, theirs_save = FunctionCache.load_overload, FunctionCache.save_overload

    def set_files(self: Any) -> None:
        if not isinstance(self._cache_file, CompiledFiles):
            impl = self._impl
            name = f"{impl.filename_base}.numba"
            stamped = __version__, stamp(self._py_func)
            self._cache_file = CompiledFiles(self._cache_path, name, stamped, dumps)

    def load_overload(self: Any, signature: Any, target: Any) -> Any:
        if not _is_ours(self._py_func):
            return theirs_load(self, signature, target)
        rtsys.initialize(target)
        set_files(self)
        loaded = None
        try:
            with self._guard_against_spurious_io_errors():
                loaded = self._load_overload(signature, target)
        except Exception:  # with a damaged file pickle may raise anything
            with suppress(OSError):
                self.flush()
        if loaded is None:
            compiling.begins()
        return loaded

    def save_overload(self: Any, signature: Any, data: Any) -> None:
        if not _is_ours(self._py_func):
            theirs_save(self, signature, data)
            return
        compiling.ends()
        set_files(self)
        try:
            theirs_save(self, signature, data)
        except Exception as exc:  # from numba or the disk; the loop is compiled and can run
            warn_uncached(getattr(exc, "strerror", None) or type(exc).__name__)

    # Not numba's public interface: other versions may lack these methods
    ours = ("_guard_against_spurious_io_errors", "_load_overload", "save_overload", "flush")
    if all(hasattr(FunctionCache, name) for name in ours):
        FunctionCache.load_overload = load_overload  # type: ignore[method-assign]
        FunctionCache.save_overload = save_overload  # type: ignore[method-assign]
    locators = getattr(caching.CacheImpl, "_locator_classes", None)
    if locators is not None and hasattr(caching, "InTreeCacheLocator"):
        caching.CacheImpl._locator_classes = [*locators, _last_resort()]


def _last_resort() -> Any:
    """Locator of last resort for a loop's cache: beside its source, even if that is read-only."""

    class BesideTheSource(caching.InTreeCacheLocator):
        @classmethod
        def from_function(cls, py_func: Any, py_file: str) -> Any:
            there = _is_ours(py_func) and os.path.exists(py_file)
            return cls(py_func, py_file) if there else None

    return BesideTheSource
