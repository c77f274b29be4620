"""The entry to a kernel that :mod:`~sinstool.core.machine_code` calls, as numba compiles it."""

from __future__ import annotations

from typing import Any

from llvmlite.ir import Function, FunctionType, IntType, IRBuilder  # type: ignore[import-untyped]
from numba.core import types
from numba.core.compiler_machinery import register_pass
from numba.np.arrayobj import make_array, populate_array

from sinstool.core import kernel_compiler
from sinstool.core.kernel_compiler import KernelCompiler

__all__ = ["WayInCompiler"]

_INTEGER: Any = types.Integer


class _Lower(kernel_compiler._Lower):
    """Lowering with our entry in place of numba's, where the types allow it."""

    def create_cpython_wrapper(self, release_gil: bool = False) -> None:
        fndesc = self.fndesc
        results = getattr(fndesc.restype, "types", (fndesc.restype,))
        returns = "".join(map(_letter, results)) if fndesc.restype != types.none else ""
        if " " in returns or not all(map(_is_passed, fndesc.argtypes)):
            super().create_cpython_wrapper(release_gil)
            return
        context, name = self.context, fndesc.llvm_cpython_wrapper_name
        module = context.create_module("way_in")
        kind = context.call_conv.get_function_type(fndesc.restype, fndesc.argtypes)
        callee = Function(module, kind, fndesc.llvm_func_name)
        whole = Function(module, FunctionType(IntType(32), [IntType(64).as_pointer()]), name)
        builder = IRBuilder(whole.append_basic_block())
        words = _Words(context, builder, whole.args[0])
        args = [words.argument(each) for each in fndesc.argtypes]
        status, result = context.call_conv.call_function(
            builder, callee, fndesc.restype, fndesc.argtypes, args, attrs=("noinline",)
        )
        words = _Words(context, builder, whole.args[0])
        is_tuple = isinstance(fndesc.restype, types.BaseTuple)
        for k, each in enumerate(results if returns else ()):
            value = builder.extract_value(result, k) if is_tuple else result
            words.put(each, value)
        builder.ret(builder.zext(status.is_error, IntType(32)))
        self.library.add_ir_module(module)
        self.library.way_in = name, returns, is_tuple


def _letter(typ: Any) -> str:
    """The letter of `struct` for a type of result; a space if it has none."""
    if isinstance(typ, types.Boolean):
        return "?"
    if isinstance(typ, types.Float):
        return "d"
    if isinstance(typ, _INTEGER):
        return "q" if typ.signed else "Q"
    return " "


def _is_passed(typ: Any) -> bool:
    return type(typ) is types.Array or typ == types.none or isinstance(typ, _PASSED)


_PASSED = (types.Boolean, types.Float, types.Integer, types.Record)


class _Words:
    """Access to the words of a block in order."""

    def __init__(self, context: Any, builder: Any, at: Any) -> None:
        self.context, self.builder, self.at = context, builder, at
        self.count = 0

    def _place(self, typ: Any) -> Any:
        at = self.builder.gep(self.at, [IntType(64)(self.count)])
        self.count += 1
        return self.builder.bitcast(at, self.context.get_value_type(typ).as_pointer())

    def _number(self, typ: Any) -> Any:
        return self.builder.load(self._place(typ))

    def argument(self, typ: Any) -> Any:
        """The next argument."""
        context, builder = self.context, self.builder
        if typ == types.none:
            return context.get_dummy_value()
        wide = _wide(typ)
        if wide is not None:
            return context.cast(builder, self._number(wide), wide, typ)
        address = self._number(types.intp)
        if isinstance(typ, types.Record):
            return builder.inttoptr(address, context.get_value_type(typ))
        array = make_array(typ)(context, builder)
        data = builder.inttoptr(address, array.data.type)
        shape, strides = ([self._number(types.intp) for _ in range(typ.ndim)] for _ in range(2))
        size = context.get_abi_sizeof(context.get_data_type(typ.dtype))
        populate_array(array, data, shape, strides, size, None)
        return array._getvalue()

    def put(self, typ: Any, value: Any) -> None:
        """Store the next result."""
        wide = _wide(typ)
        value = self.context.cast(self.builder, value, typ, wide)
        self.builder.store(value, self._place(wide))


def _wide(typ: Any) -> Any:
    """The 64-bit type for a type of number; None for other types."""
    if isinstance(typ, types.Float):
        return types.float64
    if isinstance(typ, _INTEGER):
        return types.int64 if typ.signed else types.uint64
    return types.int64 if isinstance(typ, types.Boolean) else None


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(kernel_compiler._Lowering):
    _name = "way_in_lowering"

    lowering_class = _Lower


class WayInCompiler(KernelCompiler):
    """A compiler for functions that Python calls."""

    @property
    def lowering(self) -> Any:
        """The pass that makes LLVM's code."""
        return _Lowering
