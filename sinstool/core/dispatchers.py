"""numba's dispatchers of compiled functions: kernels, which Python calls, and their parts.

numba makes a library of each compiled function: it optimises the function together with all that it
calls, and makes machine code of it with entries for Python and C. A function that only compiled
code calls needs none of this, because it is optimised again together with each caller: one that is
five calls deep is optimised six times, and as often turned into machine code.

A part is compiled into its callers only, and cached with them; it has no machine code of its own.
A kernel has one entry, that of :mod:`~sinstool.core.machine_code`. A part that Python calls, as
tests do, is compiled once more as a kernel. :mod:`~sinstool.core.kernel_compiler` describes which
steps of numba's compiler are left out for both.
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

# Versions of numba whose internals this module and the compiler of kernels know
INSIDES = {(0, 68)}

_Library = codegen.CPUCodeLibrary


class _Kernel(registry.CPUDispatcher):
    """A kernel that numba's own entry calls; the functions that it calls are compiled as parts."""

    vectorizes = True

    def compile(self, signature: Any) -> Any:
        with _ours(self.vectorizes):
            return super().compile(signature)


class _Part(registry.CPUDispatcher):
    """Compiles a function for compiled callers; for Python it compiles a kernel of it."""

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
        # Not to where calls from Python look: the code has no entry for them
        self.overloads[tuple(compiled.signature.args)] = compiled

    def _compile_for_args(self, *args: Any, **keywords: Any) -> Any:
        return self._for_python._compile_for_args(*args, **keywords)

    def with_way_in(self, signature: Any) -> Any:
        """Compile the function as a kernel with the entry of :mod:`~sinstool.core.machine_code`."""
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
    """The dispatcher of a kernel or of a part."""
    vectorizes = options.get("vectorizes", True)
    options = _OPTIONS | {k: v for k, v in options.items() if k != "vectorizes"}
    if not supported():
        return njit(cache=True, **options)(function)
    made = _Part(function, targetoptions=options | _NO_WAY_IN, pipeline_class=_compiler())
    made.vectorizes = vectorizes
    return made


def jitted(function: Any, options: dict[str, Any]) -> Any:
    """The dispatcher of any other function."""
    return njit(**options)(function)


def way_in(ours: Any, key: Any, args: tuple[Any, ...]) -> Entry | None:
    """Compile a function for arguments of these types, and cache its machine code.

    Returns
    -------
    Entry or None
        None if numba's own entry must be used: with another version of numba, or for a function
        that raises, allocates, or has an argument or a result other than a number, record or array.
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
    """Context in which this thread compiles a kernel or its parts."""
    before = is_ours()
    if not before:
        _load_without_scipy()
        turn.values, turn.vectorizes = {}, vectorizes
    turn.ours = True
    collects = gc.isenabled()
    gc.disable()  # the compiler makes millions of objects, but few reference cycles
    try:
        yield
    finally:
        turn.ours = before
        if collects:
            gc.freeze()  # or the next collection would go through all of them
            gc.enable()


@cache
def _load_without_scipy() -> None:
    """Load numba's implementations of NumPy, but not SciPy's linear algebra, until it is used."""
    from numba.np import linalg

    theirs = linalg.ensure_blas
    linalg.ensure_blas = lambda: None
    try:
        import numba.np.arraymath  # noqa: F401
    finally:
        linalg.ensure_blas = theirs


class _Plain:
    """No colours in numba's messages: it makes many while it tries types, and drops most."""

    def __getattr__(self, name: str) -> Callable[[str], str]:
        return str


@cache
def _compiler() -> Any:
    """The compiler of kernels, imported only with a version of numba that it is made for."""
    from sinstool.core.kernel_compiler import KernelCompiler

    return KernelCompiler


@cache
def supported() -> bool:
    """Patch numba so that parts are compiled only into their callers.

    This changes numba's internals. Versions other than those in `INSIDES` are left as they are, and
    take longer to compile.

    Returns
    -------
    bool
        Whether numba is patched.
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
        # Parts are optimised within their callers; doing it here too would take as long again
        if not is_ours():
            theirs_optimize(self, module)
        module.data_layout = self._codegen._data_layout

    def optimize_final_module(self: Any) -> None:
        # numba's first round serves reference counts, which kernels do not have
        if not is_ours():
            theirs_optimize_final(self)
            return
        passes, builder = self._codegen._module_pass_manager()
        passes.run(self._final_module, builder)
        # One engine holds several kernels, and the names of their parts are not unique
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
    """Whether only compiled code can call a library made while compiling a kernel."""
    if library._finalized or not is_ours():
        return False
    ways_in = {fndesc.llvm_cpython_wrapper_name, fndesc.llvm_cfunc_wrapper_name}
    module = library._final_module
    # A recursive function is called by its address and needs a library of its own
    return not any(f.name in ways_in for f in module.functions) and not any(
        g.name.startswith(codegen.RuntimeLinker.PREFIX) for g in module.global_variables
    )


set_up_cache()
