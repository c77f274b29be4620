"""Compiled loops out of numba's cache, without what only its compiler needs.

Before numba looks into its cache it loads all that it knows of Python and NumPy, and `scipy.linalg`
with it: that takes longer than most logs. Machine code out of the cache needs none of it but the
runtime that counts references to arrays. A loop that has to be compiled after all makes numba's
compiler load the rest by itself, at any time.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from numba.core.caching import FunctionCache
from numba.core.runtime import rtsys

PACKAGE = __name__.partition(".")[0]


@cache
def load_quickly() -> None:
    """From now on load compiled loops of this package quickly; those of others as numba does."""
    theirs = FunctionCache.load_overload

    def load_overload(self: Any, signature: Any, target: Any) -> Any:
        if self._py_func.__module__.partition(".")[0] != PACKAGE:
            return theirs(self, signature, target)
        rtsys.initialize(target)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(signature, target)
        return None

    # Not of numba's public interface: another numba may do without them
    ours = ("_guard_against_spurious_io_errors", "_load_overload")
    if all(hasattr(FunctionCache, name) for name in ours):
        FunctionCache.load_overload = load_overload  # type: ignore[method-assign]
