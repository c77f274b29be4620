"""The few functions of LLVM that load machine code, of the library that llvmlite brings.

llvmlite itself describes all of LLVM and a language for programs besides, which takes four times as
long to import as all of the machine code of a run takes to load.
"""

from __future__ import annotations

import ctypes
import os
import platform
from ctypes import POINTER, c_bool, c_char_p, c_int, c_size_t, c_uint64, c_void_p
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

_TEXT = POINTER(c_char_p)
# Types of arguments, and of what is returned
_FUNCTIONS: dict[str, tuple[Any, ...]] = {
    "InitializeNativeTarget": (None,),
    "InitializeNativeAsmPrinter": (None,),
    "GetDefaultTargetTriple": (_TEXT, None),
    "GetProcessTriple": (_TEXT, None),
    "GetHostCPUName": (_TEXT, None),
    "GetHostCPUFeatures": (_TEXT, c_int),
    "DisposeString": (c_void_p, None),
    "GetTargetFromTriple": (c_char_p, _TEXT, c_void_p),
    "CreateTargetMachine": (
        *(c_void_p, c_char_p, c_char_p, c_char_p, c_int),
        *(c_char_p, c_char_p, c_int, c_int, c_char_p, c_void_p),
    ),
    "ContextCreate": (c_void_p,),
    "ParseAssembly": (c_void_p, c_char_p, _TEXT, c_void_p),
    "CreateMCJITCompiler": (c_void_p, c_void_p, c_bool, _TEXT, c_void_p),
    "CreateObjectFile": (c_char_p, c_size_t, c_void_p),
    "MCJITAddObjectFile": (c_void_p, c_void_p, None),
    "FinalizeObject": (c_void_p, None),
    "GetFunctionAddress": (c_void_p, c_char_p, c_uint64),
    "SearchAddressOfSymbol": (c_char_p, c_void_p),
}


@cache
def _library() -> dict[str, Any]:
    """LLVM's functions by name, for this machine's processor."""
    package = find_spec("llvmlite")
    name = {"nt": "llvmlite.dll"}.get(os.name, "libllvmlite.so")
    name = "libllvmlite.dylib" if platform.system() == "Darwin" else name
    folder = Path((package and package.origin) or "").parent / "binding"
    library = ctypes.CDLL(str(folder / name))
    functions = {}
    for each, types in _FUNCTIONS.items():
        function = functions[each] = library[f"LLVMPY_{each}"]
        *function.argtypes, function.restype = types
    functions["InitializeNativeTarget"]()
    functions["InitializeNativeAsmPrinter"]()
    return functions


def _text(name: str) -> bytes:
    """What a function says of the machine."""
    functions, out = _library(), c_char_p()
    functions[name](ctypes.byref(out))
    text = out.value or b""
    functions["DisposeString"](out)
    return text


@cache
def processor() -> tuple[str, ...]:
    """The system and the processor that code is made for, and what the processor can do."""
    features = sorted(_text("GetHostCPUFeatures").decode().split(","))
    names = (_text(name).decode() for name in ("GetProcessTriple", "GetHostCPUName"))
    return *names, ",".join(features)


def has(name: str) -> bool:
    """Whether a function is in this process."""
    return bool(_library()["SearchAddressOfSymbol"](name.encode()))


class Engine:
    """Holds code, which lives as long as the process."""

    def __init__(self) -> None:
        self._functions = lib = _library()
        triple, error = _text("GetDefaultTargetTriple"), ctypes.byref(c_char_p())
        target = lib["GetTargetFromTriple"](triple, error)
        # Of code that is run at once Windows, too, takes ELF only
        triple += b"-elf" if os.name == "nt" else b""
        machine = lib["CreateTargetMachine"](
            target, triple, b"", b"", 2, b"default", b"jitdefault", 0, 1, b""
        )
        # A context of its own, as numba may use LLVM's in another thread
        module = lib["ParseAssembly"](lib["ContextCreate"](), b"", error)
        arm = platform.machine().lower() in ("arm64", "aarch64")
        self._engine = lib["CreateMCJITCompiler"](module, machine, arm, error)
        if not self._engine:
            raise RuntimeError("LLVM makes no engine")

    def address(self, code: bytes, name: str) -> int:
        """Take in a file of machine code, and find a function of it."""
        lib = self._functions
        lib["MCJITAddObjectFile"](self._engine, lib["CreateObjectFile"](code, len(code)))
        lib["FinalizeObject"](self._engine)
        return int(lib["GetFunctionAddress"](self._engine, name.encode()))
