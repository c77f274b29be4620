"""What numba has for compiled functions: kernels that Python calls, and parts they are made of.

numba makes a library of each compiled function: it optimises it together with all that it calls,
makes machine code of it, and ways in for Python and C. Of what only compiled code calls none of
that is needed, as whatever calls it is optimised together with it again: a function that lies five
calls deep is optimised six times, and machine code is made of it as often.

A part is compiled into whatever calls it, and kept with that; it has no machine code of its own.
A kernel has one way in, that of :mod:`~sinstool.core.machine_code`. Called from Python, as tests
do, a part is compiled once more as a kernel. :mod:`~sinstool.core.kernel_compiler` says what of
numba's compiler both do without.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, cached_property
from typing import Any

from llvmlite.binding import Linkage  # type: ignore[import-untyped]
from numba import njit, version_info
from numba.core import codegen, config, cpu, errors, registry

from sinstool.core import compiling, kernel_typing
from sinstool.core.compiled import set_up_cache
from sinstool.core.kernel_typing import is_ours, turn
from sinstool.core.machine_code import Code, Entry, keep

# Versions of numba whose insides are as this module and the compiler of kernels have them.
INSIDES = {(0, 68)}

_Library = codegen.CPUCodeLibrary


class _Kernel(registry.CPUDispatcher):
    """A kernel whose way in is numba's: the functions that it calls are compiled as parts of it."""

    vectorizes = True

    def compile(self, signature: Any) -> Any:
        with _ours(self.vectorizes):
            return super().compile(signature)


class _Part(registry.CPUDispatcher):
    """Compiles for compiled code, and has a kernel compile for Python."""

    vectorizes = True

    @cached_property
    def _for_python(self) -> Any:
        options = {k: v for k, v in self.targetoptions.items() if k not in _NO_WAY_IN}
        made = _Kernel(
            self.py_func, targetoptions=options | _ONE_WAY_IN, pipeline_class=_compiler()
        )
        made.vectorizes = self.vectorizes
        made.enable_caching()
        return made

    def add_overload(self, compiled: Any) -> None:
        # Not where calls from Python look, which would find no way in
        self.overloads[tuple(compiled.signature.args)] = compiled

    def _compile_for_args(self, *args: Any, **keywords: Any) -> Any:
        return self._for_python._compile_for_args(*args, **keywords)

    def with_way_in(self, signature: Any) -> Any:
        """Compile the function as a kernel with the way in of machine code."""
        options = self.targetoptions | {"no_cpython_wrapper": False}
        from sinstool.core.way_in import WayInCompiler

        made = _Part(self.py_func, targetoptions=options, pipeline_class=WayInCompiler)
        with _ours(self.vectorizes):
            made.compile(signature)
        return made.overloads[signature]


_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
_ONE_WAY_IN = {"nopython": True, "no_cfunc_wrapper": True}
_NO_WAY_IN = _ONE_WAY_IN | {"no_cpython_wrapper": True}


def dispatcher(function: Any, options: dict[str, Any]) -> Any:
    """numba's of a kernel, or of a part."""
    vectorizes = options.get("vectorizes", True)
    options = _OPTIONS | {k: v for k, v in options.items() if k != "vectorizes"}
    if not _supported():
        return njit(cache=True, **options)(function)
    made = _Part(function, targetoptions=options | _NO_WAY_IN, pipeline_class=_compiler())
    made.vectorizes = vectorizes
    return made


def jitted(function: Any, options: dict[str, Any]) -> Any:
    """numba's of another function."""
    return njit(**options)(function)


def way_in(ours: Any, key: Any, args: tuple[Any, ...]) -> Entry | None:
    """Compile a function for arguments of these types, and keep its machine code.

    Returns
    -------
    Entry or None
        None where numba's own way in has to be taken: another version of numba, or a function that
        raises, allocates or takes or returns what is none of numbers, records and arrays.
    """
    if not isinstance(ours, _Part):
        return None
    from sinstool.core.kernel_compiler import is_plain

    signature = tuple(ours.typeof_pyval(each) for each in args)
    if not is_plain(ours.py_func, signature):
        return None
    compiling.begins()
    try:
        compiled = ours.with_way_in(signature)
    finally:
        compiling.ends()
    library = compiled.library
    name, returns, is_tuple = getattr(library, "way_in", (None, "", False))
    if name is None:
        keep(ours.py_func, key, None)
        return None
    functions = (each for each in library._final_module.functions if each.is_declaration)
    needs = tuple(each.name for each in functions if not each.name.startswith("llvm."))
    keep(ours.py_func, key, Code(library._get_compiled_object(), name, returns, is_tuple, needs))
    return Entry(library.get_pointer_to_function(name), returns, is_tuple, compiled)


@contextmanager
def _ours(vectorizes: bool) -> Iterator[None]:
    """This thread compiles a kernel."""
    before = is_ours()
    if not before:
        _load_without_scipy()
        turn.values, turn.vectorizes = {}, vectorizes
    turn.ours = True
    collects = gc.isenabled()
    gc.disable()  # the compiler makes objects by the million, and few circles
    try:
        yield
    finally:
        turn.ours = before
        if collects:
            gc.freeze()  # or the next collection would go through all of them
            gc.enable()


@cache
def _load_without_scipy() -> None:
    """Load what numba knows of NumPy; SciPy's linear algebra, which it looks for, waits for use."""
    from numba.np import linalg

    theirs = linalg.ensure_blas
    linalg.ensure_blas = lambda: None
    try:
        import numba.np.arraymath  # noqa: F401
    finally:
        linalg.ensure_blas = theirs


class _Plain:
    """Colours of numba's messages, most of which it makes, while it tries what fits, for nobody."""

    def __getattr__(self, name: str) -> Callable[[str], str]:
        return str


@cache
def _compiler() -> Any:
    """The compiler of kernels; another numba may lack what it is made of, and never gets here."""
    from sinstool.core.kernel_compiler import KernelCompiler

    return KernelCompiler


@cache
def _supported() -> bool:
    """Have numba leave libraries of parts to the libraries that they become parts of.

    Not of its public interface: any other version than those of `INSIDES` does without, and
    compiles for longer.
    """
    if version_info.short not in INSIDES or getattr(config, "DISABLE_JIT", False):
        return False
    theirs_get = cpu.CPUContext.get_executable
    theirs_add = _Library.add_linking_library
    theirs_optimize = _Library._optimize_functions
    theirs_optimize_final = _Library._optimize_final_module
    theirs_builder = codegen.CPUCodegen._pass_builder
    kernel_typing.set_up()
    errors._termcolor_inst = _Plain()  # type: ignore[attr-defined]

    def get_executable(self: Any, library: Any, fndesc: Any, env: Any) -> Any:
        if not _without_way_in(library, fndesc):
            return theirs_get(self, library, fndesc, env)
        library._is_part = library._finalized = True
        name = fndesc.qualname.split(".")[-1]
        return cpu._dynfunc.make_function(fndesc.lookup_module(), name, "", 0, env, (library,))

    def optimize_functions(self: Any, module: Any) -> None:
        # What becomes part of others is optimised there; doing so before takes as long again
        if not is_ours():
            theirs_optimize(self, module)
        module.data_layout = self._codegen._data_layout

    def optimize_final_module(self: Any) -> None:
        # numba's first round is for counts of references, of which there are none
        if not is_ours():
            theirs_optimize_final(self)
            return
        passes, builder = self._codegen._module_pass_manager()
        passes.run(self._final_module, builder)
        # Machine code of several kernels is kept together, and names of parts are not unique
        for each in self._final_module.functions:
            if each.linkage is Linkage.linkonce_odr:
                each.linkage = Linkage.internal

    def pass_builder(self: Any, **keywords: Any) -> Any:
        if is_ours() and not turn.vectorizes:
            keywords["loop_vectorize"] = False
        return theirs_builder(self, **keywords)

    def add_linking_library(self: Any, library: Any) -> None:
        theirs_add(self, library)
        if getattr(library, "_is_part", False):
            for each in library._linking_libraries:
                if each not in self._linking_libraries:
                    add_linking_library(self, each)

    cpu.CPUContext.get_executable = get_executable  # type: ignore[method-assign]
    codegen.CPUCodegen._pass_builder = pass_builder  # type: ignore[method-assign]
    _Library._optimize_functions = optimize_functions  # type: ignore[method-assign]
    _Library._optimize_final_module = optimize_final_module  # type: ignore[method-assign]
    _Library.add_linking_library = add_linking_library  # type: ignore[method-assign]
    return True


def _without_way_in(library: Any, fndesc: Any) -> bool:
    """Whether a library of a kernel's can only be called by other compiled code."""
    if library._finalized or not is_ours():
        return False
    ways_in = {fndesc.llvm_cpython_wrapper_name, fndesc.llvm_cfunc_wrapper_name}
    module = library._final_module
    # What calls itself is found by its address
    return not any(f.name in ways_in for f in module.functions) and not any(
        g.name.startswith(codegen.RuntimeLinker.PREFIX) for g in module.global_variables
    )


set_up_cache()
