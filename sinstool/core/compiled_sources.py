"""What the machine code of a compiled loop depends on: all functions and constants it is made of.

numba checks only the file of the loop itself. But the functions that a loop calls, and constants,
are compiled into it wherever they are defined: after a change of those, a cached loop would still
run the old code.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import cache
from types import CodeType, ModuleType
from typing import Any

PACKAGE = __name__.partition(".")[0]
_CONSTANTS = (bool, int, float, complex, str, bytes, type(None))


def stamp(function: Any) -> tuple[Any, ...]:
    """State of a loop's sources: equal in every process as long as none of them changes.

    Parameters
    ----------
    function : function
        The Python function. The functions that it calls are looked up now, so their modules must be
        loaded.

    Returns
    -------
    tuple
        Names, times and sizes of files, and names and values of constants.
    """
    files: set[str] = set()
    values: set[tuple[str, str]] = set()
    left, seen = [function], {id(function)}
    while left:
        each = left.pop()
        files.add(each.__code__.co_filename)
        for name, value in _named(each):
            called = getattr(value, "py_func", None)
            if isinstance(value, ModuleType):
                files.add(str(value.__file__))
            elif called is None:
                values.add((name, repr(value)))
            elif id(called) not in seen:
                seen.add(id(called))
                left.append(called)
    return (*((os.path.basename(f), *_state(f)) for f in sorted(files)), *sorted(values))


def _named(function: Any) -> Iterator[tuple[str, Any]]:
    """Modules of this package, its compiled functions, and constants that a function uses."""
    names = set(_names(function.__code__))
    places = [function.__globals__]
    for name in sorted(names & set(function.__globals__)):
        value = function.__globals__[name]
        if isinstance(value, ModuleType) and _is_ours(value.__name__):
            yield name, value
            places.append(vars(value))
    for place in places:
        for name in sorted(names & set(place)):
            value = place[name]
            compiled = getattr(value, "py_func", None)
            ours = compiled is not None and _is_ours(str(compiled.__module__))
            if ours or _is_constant(value):
                yield name, value


def _is_constant(value: Any) -> bool:
    if isinstance(value, tuple):
        return all(_is_constant(each) for each in value)
    return isinstance(value, _CONSTANTS)


def _names(code: CodeType) -> Iterator[str]:
    """Names of globals and attributes in code, nested functions included."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _is_ours(module: str) -> bool:
    return module.partition(".")[0] == PACKAGE


@cache
def _state(file: str) -> tuple[int, int]:
    """Time of the last change, ns, and size of a file; zeros for code outside files."""
    try:
        status = os.stat(file)
    except OSError:
        return 0, 0
    return status.st_mtime_ns, status.st_size
