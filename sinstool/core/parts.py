"""Compiled functions: kernels, which Python calls, parts, which kernels are made of, and others.

numba compiles all of them, but takes longer to import than most logs take to process. So nothing
here imports it before something has to be compiled: :mod:`~sinstool.core.machine_code` stores the
machine code of kernels and runs it. :mod:`~sinstool.core.dispatchers` describes which steps of
numba are left out for kernels and parts.

Kernels and parts do not count references and do not check for zero divisors unless they ask for it,
because both take longer to compile than the code that they guard. A function that allocates or
returns arrays must therefore be declared with ``allocates=True``.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial, update_wrapper
from threading import RLock
from typing import Any, TypeVar, cast

from sinstool.core.machine_code import Entry, described, load

__all__ = ["kernel", "njit", "part"]

Function = TypeVar("Function", bound=Callable[..., Any])


class _Compiled:
    """A function that numba compiles when Python calls it, or when a caller of it is compiled."""

    def __init__(self, function: Any, make: str, options: dict[str, Any]) -> None:
        update_wrapper(self, function)
        self.py_func = function
        self._make, self._options = make, options

    @cached_property
    def dispatcher(self) -> Any:
        """numba's dispatcher of the function."""
        from sinstool.core import dispatchers

        return getattr(dispatchers, self._make)(self.py_func, self._options)

    @property
    def _numba_type_(self) -> Any:
        """The function's type, for numba when it compiles a caller."""
        return self.dispatcher._numba_type_

    @property
    def targetoptions(self) -> Any:
        """The options, for numba when it decides on inlining."""
        return self.dispatcher.targetoptions

    def __call__(self, *args: Any, **keywords: Any) -> Any:
        return self.dispatcher(*args, **keywords)

    def __reduce__(self) -> Any:
        return type(self), (self.py_func, self._make, self._options)


class _Kernel(_Compiled):
    """A kernel, or a part that Python calls."""

    def __init__(self, function: Any, make: str, options: dict[str, Any]) -> None:
        super().__init__(function, make, options)
        self._entries: dict[Any, Entry | None] = {}
        self._lock = RLock()

    def __call__(self, *args: Any, **keywords: Any) -> Any:
        key, words = described(args)
        if key is None or keywords:
            return self.dispatcher(*args, **keywords)
        try:
            entry = self._entries[key]
        except KeyError:
            with self._lock:
                if key not in self._entries:
                    self._entries[key] = self._find(key, args)
            entry = self._entries[key]
        return self.dispatcher(*args) if entry is None else entry(words)

    def _find(self, key: Any, args: tuple[Any, ...]) -> Entry | None:
        """The entry to the machine code for argument types; None if numba must call it."""
        if self._options["_nrt"] or self.py_func.__closure__:
            return None
        options = {k: sorted(v) if isinstance(v, set) else v for k, v in self._options.items()}
        key = key, sorted(options.items())
        is_kept, entry = load(self.py_func, key)
        if is_kept:
            return entry
        from sinstool.core import dispatchers

        return dispatchers.way_in(self.dispatcher, key, args)


def kernel(
    *, allocates: bool = False, vectorizes: bool = True, **options: Any
) -> Callable[[Function], Function]:
    """Decorate a function that Python calls; its machine code is cached.

    Parameters
    ----------
    allocates : bool, optional
        Whether it allocates or returns arrays.
    vectorizes : bool, optional
        Whether its loops are vectorised. That makes long loops faster, but doubles the code and the
        time to compile it.
    **options
        Options of `numba.njit` that replace the defaults for loops over numbers.
    """
    options = {"_nrt": allocates, "vectorizes": vectorizes} | options
    return partial(_made, _Kernel, "dispatcher", options)


def part(*, allocates: bool = False, **options: Any) -> Callable[[Function], Function]:
    """Decorate a function that compiled functions call.

    Parameters
    ----------
    allocates : bool, optional
        Whether it allocates or returns arrays.
    **options
        Options of `numba.njit` that replace the defaults for loops over numbers.
    """
    options = {"_nrt": allocates} | options
    return partial(_made, _Kernel, "dispatcher", options)


def njit(**options: Any) -> Callable[[Function], Function]:
    """Decorate a function as `numba.njit` does, but import numba only when it is used."""
    return partial(_made, _Compiled, "jitted", options)


def _made(kind: Any, make: str, options: dict[str, Any], function: Function) -> Function:
    return cast(Function, kind(function, make, options))
