"""Machine code of kernels, cached in files and run without numba.

A kernel has one entry: a function that takes the address of a block of 64-bit words with the
arguments in order, and writes its results to the beginning of the block. An array is passed as its
address, shape and strides in bytes, a record as its address, a number as its value. LLVM loads the
code, which calls only functions of the C library.
"""

from __future__ import annotations

import ctypes
import os
import struct
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from threading import Lock
from typing import Any, NamedTuple

import numpy as np

from sinstool.core.compiled_files import CompiledFiles, base_name, folder_of, warn_uncached
from sinstool.core.compiled_sources import stamp

# Functions that LLVM makes calls of and that every C library has
_OF_C = {
    "acos", "asin", "atan", "atan2", "cbrt", "ceil", "copysign", "cos", "cosh", "erf", "erfc",
    "exp", "exp2", "expm1", "fabs", "floor", "fma", "fmod", "hypot", "ldexp", "lgamma", "log",
    "log10", "log1p", "log2", "memcpy", "memmove", "memset", "nearbyint", "pow", "rint", "round",
    "sin", "sinh", "sqrt", "tan", "tanh", "tgamma", "trunc",
}  # fmt: skip
# Version of the layout of the cached files
_FORM = 2
# Variables that change the code that numba and LLVM make
_VARIABLES = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_OPT", "NUMBA_BOUNDSCHECK")
_NUMBERS = {float: ("float64", "d"), int: ("int64", "q"), bool: ("bool", "q")}
_LETTERS = {"f": "d", "i": "q", "u": "Q", "b": "q"}
_OFF = os.environ.get("NUMBA_DISABLE_JIT", "0") != "0"


class Code(NamedTuple):
    """Machine code as it is cached."""

    object: bytes  # An object file of the system, not linked yet
    name: str  # Name of the entry
    returns: str  # A letter of `struct` for each returned number, "?" for a Boolean
    is_tuple: bool  # Whether the results are returned as a tuple
    needs: tuple[str, ...]  # Functions that it calls


@dataclass(frozen=True)
class Entry:
    """An entry to machine code.

    Parameters
    ----------
    address : int
        Address of the entry.
    returns, is_tuple
        As in :class:`Code`.
    holds : object
        Owner of the code, which must live as long as the entry.
    """

    address: int
    returns: str
    is_tuple: bool
    holds: Any

    def __post_init__(self) -> None:
        # Calls through ctypes release the interpreter lock, so that other threads can run
        call = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)(self.address)
        object.__setattr__(self, "_call", call)

    def __call__(self, words: tuple[str, list[Any]]) -> Any:
        """Run the code on arguments as :func:`described` puts them.

        Raises
        ------
        RuntimeError
            If the code reports an error; that of a kernel never does.
        """
        letters, values = words
        block = ctypes.create_string_buffer(8 * max(len(letters), len(self.returns), 1))
        struct.pack_into(letters, block, 0, *values)
        if self._call(block):  # type: ignore[attr-defined]
            raise RuntimeError("compiled code has failed")
        if not self.returns:
            return None
        found = struct.unpack_from(self.returns.replace("?", "q"), block)
        if "?" in self.returns:
            pairs = zip(self.returns, found, strict=True)
            found = tuple(bool(value) if letter == "?" else value for letter, value in pairs)
        return found if self.is_tuple else found[0]


def _asked_address(array: np.ndarray) -> int:
    return int(array.__array_interface__["data"][0])


def _read_address(array: np.ndarray) -> int:
    return _PLACE.from_address(id(array) + object.__basicsize__).value


def _way_to_addresses() -> Callable[[np.ndarray], int]:
    """The fastest function that returns the address of an array's first element.

    NumPy's own answer describes the whole array; for the twenty arguments of a kernel it takes
    longer than many calls. CPython's objects of NumPy hold the address right behind the fields that
    all objects have; it is read there if a test with three arrays succeeds.
    """
    if sys.implementation.name == "cpython":
        parts = np.arange(6.0).reshape(2, 3), np.zeros(3, np.uint8)[1:], np.empty(0)
        if all(_read_address(each) == _asked_address(each) for each in parts):
            return _read_address
    return _asked_address


_PLACE = ctypes.c_ssize_t
_ARRAYS = tuple("q" * (1 + 2 * ndim) for ndim in range(65))
address = _way_to_addresses()


def described(args: Sequence[Any]) -> tuple[Any, tuple[str, list[Any]]]:
    """Types of arguments, None where some are of others than kernels take, and their words."""
    types: list[Any] = []
    letters: list[str] = []
    words: list[Any] = []
    for each in args:
        kind = type(each)
        if kind is np.ndarray:
            flags, shape = each.flags.num, each.shape
            # Rows or columns together, or neither; aligned, and written to
            types.append((each.dtype, len(shape), flags & 1 or flags & 2, flags & 0x500))
            letters.append(_ARRAYS[len(shape)])
            words.append(address(each))
            words += shape
            words += each.strides
        elif kind in _NUMBERS:
            name, letter = _NUMBERS[kind]
            if kind is int and not -(2**63) <= each < 2**63:
                return None, ("", [])
            types.append(name)
            letters.append(letter)
            words.append(each)
        elif each is None:
            types.append(None)
        elif isinstance(each, np.void):
            types.append((each.dtype,))
            letters.append("q")
            words.append(address(np.frombuffer(each, np.uint8)))
        elif isinstance(each, np.generic) and each.dtype.kind in _LETTERS:
            types.append(each.dtype.name)
            letters.append(_LETTERS[each.dtype.kind])
            words.append(each.item())
        else:
            return None, ("", [])
    return tuple(types), ("".join(letters), words)


def load(function: Any, key: Any) -> tuple[bool, Entry | None]:
    """Load the cached code of a function for types of arguments.

    Returns
    -------
    is_kept : bool
        Whether the cache knows the function with these types.
    entry : Entry or None
        None if nothing is cached, or if the function has to be run by numba.
    """
    files = None if _OFF else _files(function)
    if files is None:
        return False, None
    try:
        code = files.load(_whole(key))
        if code is not None:
            return True, _linked(Code(*code)) if code else None
    except Exception:  # with a damaged file pickle may raise anything
        with suppress(OSError):
            files.flush()
    return False, None


def keep(function: Any, key: Any, code: Code | None) -> None:
    """Cache machine code; if it needs more than the C library, only note that numba must run it."""
    files = _files(function)
    if files is None:
        return
    try:
        files.save(_whole(key), tuple(code) if code and _OF_C.issuperset(code.needs) else ())
    except OSError as exc:
        warn_uncached(exc.strerror or type(exc).__name__)


def _files(function: Any) -> CompiledFiles | None:
    folder = folder_of(function.__code__.co_filename)
    if folder is None:
        return None
    # A base other than that of numba's files, or each would remove the other's as out of date
    return CompiledFiles(folder, f"{base_name(function)}.code", (_made_by(), stamp(function)))


def _linked(code: Code) -> Entry | None:
    """The entry to code; None if functions that it needs are missing."""
    from llvmlite import binding  # type: ignore[import-untyped]

    _set_up_llvm()
    with _lock:
        # Making an engine takes ten times as long as adding code to one. Only a second entry of the
        # same name needs an engine of its own.
        engine = _engine() if code.name in _named else _shared_engine()
        # Before the first engine LLVM knows no function
        if not all(binding.address_of_symbol(name) for name in code.needs):
            return None
        _named.add(code.name)
        engine.add_object_file(binding.ObjectFileRef.from_data(code.object))
        engine.finalize_object()
        address = engine.get_function_address(code.name)
    return Entry(address, code.returns, code.is_tuple, engine)


def _engine() -> Any:
    """An engine of LLVM, still without code."""
    from llvmlite import binding

    machine = binding.Target.from_default_triple().create_target_machine(jit=True)
    return binding.create_mcjit_compiler(binding.parse_assembly(""), machine)


_lock = Lock()
_named: set[str] = set()
_shared_engine = cache(_engine)


@cache
def _set_up_llvm() -> None:
    from llvmlite import binding

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()


def _whole(key: Any) -> Any:
    """The whole key of cached code: types of arguments, and the processor."""
    return repr(key), _processor()


@cache
def _processor() -> tuple[Any, ...]:
    from llvmlite import binding

    features = binding.get_host_cpu_features().flatten()
    asked = tuple(os.environ.get(name) for name in _VARIABLES)
    return binding.get_process_triple(), binding.get_host_cpu_name(), features, asked


@cache
def _made_by() -> tuple[Any, ...]:
    """State of the installed numba and llvmlite, found without importing them, and the layout."""
    found: list[Any] = [_FORM]
    for package in ("numba", "llvmlite"):
        spec = find_spec(package)
        for place in (spec and spec.submodule_search_locations) or ():
            status = os.stat(os.path.join(place, "_version.py"))
            found.append((package, status.st_mtime_ns, status.st_size))
    return tuple(found)
