"""Compiled functions: kernels, which Python calls, parts, which kernels are made of, and others.

numba compiles all of them, and takes longer to import than most logs take to process. So nothing
here imports it before something has to be compiled: :mod:`~sinstool.core.machine_code` keeps what
it makes of a kernel, and runs it. :mod:`~sinstool.core.dispatchers` says what kernels and parts do
without.

Neither counts references nor looks for zero divisors, unless asked to, as both take longer to
compile than what they guard. What allocates or returns arrays has to say so.
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
    """A function that numba compiles, as soon as it is called or compiled code is to call it."""

    def __init__(self, function: Any, make: str, options: dict[str, Any]) -> None:
        update_wrapper(self, function)
        self.py_func = function
        self._make, self._options = make, options

    @cached_property
    def dispatcher(self) -> Any:
        """What numba has for the function."""
        from sinstool.core import dispatchers

        return getattr(dispatchers, self._make)(self.py_func, self._options)

    @property
    def _numba_type_(self) -> Any:
        """Type to numba, where compiled code names the function."""
        return self.dispatcher._numba_type_

    @property
    def targetoptions(self) -> Any:
        """Options, where numba looks for functions to put into others."""
        return self.dispatcher.targetoptions

    def __call__(self, *args: Any, **keywords: Any) -> Any:
        return self.dispatcher(*args, **keywords)

    def __reduce__(self) -> Any:
        return type(self), (self.py_func, self._make, self._options)


class _Kernel(_Compiled):
    """A kernel, or a part as Python calls it."""

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
        """The way into machine code for types of arguments; None: numba's has to be taken."""
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
    """Decorate a function that Python calls; its machine code is kept.

    Parameters
    ----------
    allocates : bool, optional
        It makes arrays.
    vectorizes : bool, optional
        Its loops are made into ones over several elements at a time, which are quicker where they
        are long; the code is twice as large, and so is the time that it takes to compile.
    **options
        Of `numba.njit`, by default those for loops over numbers.
    """
    options = {"_nrt": allocates, "vectorizes": vectorizes} | options
    return partial(_made, _Kernel, "dispatcher", options)


def part(*, allocates: bool = False, **options: Any) -> Callable[[Function], Function]:
    """Decorate a function that compiled functions call.

    Parameters
    ----------
    allocates : bool, optional
        It makes arrays.
    **options
        Of `numba.njit`, by default those for loops over numbers.
    """
    options = {"_nrt": allocates} | options
    return partial(_made, _Kernel, "dispatcher", options)


def njit(**options: Any) -> Callable[[Function], Function]:
    """Decorate a function as `numba.njit` does, when it is used."""
    return partial(_made, _Compiled, "jitted", options)


def _made(kind: Any, make: str, options: dict[str, Any], function: Function) -> Function:
    return cast(Function, kind(function, make, options))
