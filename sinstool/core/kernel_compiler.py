"""How numba compiles our kernels: only the passes that loops over numbers and arrays need.

numba's own pipeline looks in each function for closures, generators, `with` blocks and array
expressions, follows the lives of all variables anew after most of its 25 passes, so that references
can be counted, and makes and unmakes a structure for each element of an array that is read or
written. Kernels have no use for any of that, and it was more than half of the time that they took
to compile. What their machine code computes stays the same. A function that does need it takes
numba's own pipeline.
"""

from __future__ import annotations

import dis
import inspect
import operator
from functools import reduce
from typing import Any

from llvmlite.ir import Constant  # type: ignore[import-untyped]
from numba.core import compiler, errors, ir, types
from numba.core.analysis import dead_branch_prune
from numba.core.cgutils import get_record_member, pointer_add
from numba.core.compiler_machinery import FunctionPass, PassManager, register_pass
from numba.core.ir_utils import build_definitions
from numba.core.lowering import Lower
from numba.core.rewrites.static_getitem import RewriteConstGetitems, RewriteConstSetitems
from numba.core.ssa import reconstruct_ssa
from numba.core.transforms import canonicalize_cfg
from numba.core.typed_passes import (
    BaseNativeLowering,
    NoPythonBackend,
    NopythonTypeInference,
    PreLowerStripPhis,
)
from numba.core.untyped_passes import FixupArgs, InlineInlinables, TranslateByteCode

__all__ = ["KernelCompiler", "is_plain"]

# Closures and comprehensions, containers, exceptions and `with`
_UNUSUAL = {"MAKE_FUNCTION", "LIST_APPEND", "BUILD_LIST", "BUILD_MAP", "BUILD_SET", "RAISE_VARARGS",
            "PUSH_EXC_INFO"}  # fmt: skip
# What numba replaces by constants, or treats in ways of its own
_UNUSUAL_NAMES = {"ndim", "isinstance", "hasattr", "print", "prange", "literal_unroll", "literally"}
_PLAIN = (types.Number, types.Boolean, types.Array, types.Record, types.NoneType)


class KernelCompiler(compiler.Compiler):
    """A compiler for functions of numbers, arrays and records."""

    @property
    def lowering(self) -> Any:
        """The pass that makes LLVM's code."""
        return _Lowering

    def define_pipelines(self) -> Any:
        """The pipeline to run, which depends on the function and its arguments."""
        state = self.state
        flags = state.flags
        if flags.nrt or flags.debuginfo or not is_plain(state.func_id.func, state.args):
            return super().define_pipelines()
        manager = _Passes("nopython")
        for each in (
            TranslateByteCode,
            FixupArgs,
            InlineInlinables,
            _Rewriting,
            NopythonTypeInference,
            _StrippingPhis,
            self.lowering,
            NoPythonBackend,
        ):
            manager.add_pass(each, each.__name__)
        manager.finalize()
        return [manager]


def is_plain(function: Any, args: Any) -> bool:
    """Whether a function that allocates nothing needs none of what is left out."""
    code = function.__code__
    return (
        not inspect.isgeneratorfunction(function)
        and _UNUSUAL_NAMES.isdisjoint(code.co_names)
        and not any(each.opname in _UNUSUAL for each in dis.get_instructions(code))
        and all(isinstance(each, _PLAIN) for each in args)
    )


class _Passes(PassManager):
    """Passes, with nothing analysed between them."""

    def _runPass(self, index: int, pss: Any, internal_state: Any) -> None:
        pss.analysis = self._analysis
        pss.run_initialization(internal_state)
        pss.run_pass(internal_state)
        pss.run_finalizer(internal_state)


class _Lower(Lower):
    """Lowering where no variable counts references: none has to be deleted or replaced."""

    def __init__(self, *args: Any, **keywords: Any) -> None:
        super().__init__(*args, **keywords)
        self._natural: dict[str, bool] = {}

    def storevar(self, value: Any, name: str, argidx: Any = None) -> None:
        if name in self._singly_assigned_vars:
            self._blk_local_varmap[name] = value
        else:
            self.builder.store(value, self.getvar(name))

    def lower_binop(self, resty: Any, expr: Any, op: Any) -> Any:
        lhs, rhs = expr.lhs.name, expr.rhs.name
        lty, rty = self.typeof(lhs), self.typeof(rhs)
        if expr.static_lhs is not ir.UNDEFINED or expr.static_rhs is not ir.UNDEFINED:
            return super().lower_binop(resty, expr, op)
        context, builder = self.context, self.builder
        typ = context.typing_context.resolve_value_type(op)
        signature = self.fndesc.calltypes[expr]
        left = context.cast(builder, self.loadvar(lhs), lty, signature.args[0])
        right = context.cast(builder, self.loadvar(rhs), rty, signature.args[1])
        sig = typ.get_call_type(context.typing_context, signature.args, {})
        result = context.get_function(typ, sig)(builder, (left, right))
        return context.cast(builder, result, signature.return_type, resty)

    def lower_expr(self, resty: Any, expr: Any) -> Any:
        if expr.op == "static_getitem" and self._is_place(expr.value, expr.index, expr.index_var):
            signature = self.fndesc.calltypes[expr]
            return self.lower_getitem(resty, expr, expr.value, expr.index_var, signature)
        if expr.op == "getattr" and isinstance(self.typeof(expr.value.name), types.Record):
            typ = self.typeof(expr.value.name)
            if typ.typeof(expr.attr) == resty and isinstance(resty, types.NestedArray):
                return self._nested_array(typ, self.loadvar(expr.value.name), expr.attr)
        return super().lower_expr(resty, expr)

    def lower_inst(self, inst: Any) -> Any:
        if isinstance(inst, ir.StaticSetItem) and self._is_place(
            inst.target, inst.index, inst.index_var
        ):
            signature = self.fndesc.calltypes[inst]
            return self.lower_setitem(inst.target, inst.index_var, inst.value, signature)
        return super().lower_inst(inst)

    def _is_place(self, array_var: Any, index: Any, index_var: Any) -> bool:
        """Whether a constant index is that of an array, for which numba has nothing special."""
        is_array = isinstance(self.typeof(array_var.name), types.Array)
        return is_array and index_var is not None and not isinstance(index, str)

    def lower_getitem(self, resty: Any, expr: Any, value: Any, index: Any, signature: Any) -> Any:
        pointer = self._element(value, index, signature.args[1])
        if pointer is None:
            return super().lower_getitem(resty, expr, value, index, signature)
        typ = self.typeof(value.name)
        align = None if typ.aligned else 1
        element = self.context.unpack_value(self.builder, typ.dtype, pointer, align)
        return self.context.cast(self.builder, element, signature.return_type, resty)

    def lower_setitem(self, target_var: Any, index_var: Any, value_var: Any, signature: Any) -> Any:
        typ, valty = self.typeof(target_var.name), self.typeof(value_var.name)
        pointer = None
        if isinstance(valty, types.Number | types.Boolean):
            pointer = self._element(target_var, index_var, signature.args[1])
        if pointer is None:
            return super().lower_setitem(target_var, index_var, value_var, signature)
        value = self.context.cast(
            self.builder, self.loadvar(value_var.name), valty, signature.args[2]
        )
        value = self.context.cast(self.builder, value, signature.args[2], typ.dtype)
        align = None if typ.aligned else 1
        self.context.pack_value(self.builder, typ.dtype, value, pointer, align=align)
        return None

    def _nested_array(self, record: Any, value: Any, attr: str) -> Any:
        """An array of a record, all of which but its address is constant."""
        context = self.context
        context.sentry_record_alignment(record, attr)
        typ = record.typeof(attr)
        model = context.data_model_manager[typ.as_array]
        struct = context.get_value_type(typ)
        numbers = {
            "nitems": typ.nitems,
            "itemsize": typ.dtype.bitwidth // 8,
            "shape": list(typ.shape),
            "strides": list(typ.strides),
        }
        fields = [Constant(each, None) for each in struct.elements]
        for name, number in numbers.items():
            at = model.get_field_position(name)
            fields[at] = Constant(struct.elements[at], number)
        data = get_record_member(
            self.builder, value, record.offset(attr), context.get_data_type(typ.dtype)
        )
        at = model.get_field_position("data")
        return self.builder.insert_value(Constant(struct, fields), data, at)

    def _element(self, array_var: Any, index_var: Any, indexty: Any) -> Any:
        """Pointer to an element of an array, as numba's own; None of what is no element."""
        context, builder, typ = self.context, self.builder, self.typeof(array_var.name)
        index_types = getattr(indexty, "types", (indexty,))
        if not (
            type(typ) in (types.Array, types.NestedArray)
            and typ.layout in "CA"
            and isinstance(typ.dtype, types.Number | types.Boolean)
            and len(index_types) == typ.ndim
            and all(isinstance(each, types.Integer) for each in index_types)
            and not context.enable_boundscheck
        ):
            return None
        naturals = self._naturals(index_var.name, typ.ndim)
        index = self.loadvar(index_var.name)
        index = context.cast(builder, index, self.typeof(index_var.name), indexty)
        indices = [index]
        if isinstance(indexty, types.BaseTuple):
            indices = [builder.extract_value(index, k) for k in range(typ.ndim)]
        array = self.loadvar(array_var.name)
        model = context.data_model_manager[typ.as_array]

        def field(name: str, k: int) -> Any:
            return builder.extract_value(array, (model.get_field_position(name), k))

        for k, (each, own) in enumerate(zip(indices, index_types, strict=True)):
            indices[k] = each = context.cast(
                builder, each, own, types.intp if own.signed else types.uintp
            )
            if own.signed and not naturals[k] and not _is_natural_constant(each):
                negative = builder.icmp_signed("<", each, each.type(0))
                from_end = builder.add(field("shape", k), each)
                indices[k] = builder.select(negative, from_end, each)
        data = builder.extract_value(array, model.get_field_position("data"))
        if typ.layout == "C":
            at = indices[0]
            for k in range(1, typ.ndim):
                at = builder.add(builder.mul(at, field("shape", k)), indices[k])
            return builder.gep(data, [at])
        offsets = [builder.mul(field("strides", k), each) for k, each in enumerate(indices)]
        return pointer_add(builder, data, reduce(builder.add, offsets))

    def _naturals(self, name: str, count: int) -> list[bool]:
        """Of each index of an element, whether it is sure to be none that counts from the end."""
        (found, *others) = self.func_ir._definitions.get(name, [None])
        if count > 1:
            is_tuple = not others and isinstance(found, ir.Expr) and found.op == "build_tuple"
            names = [each.name for each in found.items] if is_tuple else []
            return [self._is_natural(each) for each in names] or [False] * count
        return [self._is_natural(name)]

    def _is_natural(self, name: str) -> bool:
        """Whether a variable is 0 or counts up from there, or is what such a count comes from."""
        if name not in self._natural:
            self._natural[name] = True  # which is kept up if what it is made from is so, given that
            found = self.func_ir._definitions.get(name, ())
            if not (found and all(map(self._makes_natural, found))):
                names = list(self._natural)
                for each in names[names.index(name) :]:  # found meanwhile, given that
                    if self._natural[each]:
                        del self._natural[each]
                self._natural[name] = False
        return self._natural[name]

    def _makes_natural(self, value: Any) -> bool:
        if isinstance(value, ir.Var):
            return self._is_natural(value.name)
        if isinstance(value, ir.Const | ir.Global | ir.FreeVar):
            return isinstance(value.value, int) and value.value >= 0
        if not isinstance(value, ir.Expr):
            return False
        if value.op in ("pair_first", "iternext", "getiter", "cast"):
            return self._is_natural(value.value.name)
        if value.op in ("binop", "inplace_binop"):
            operation = value.fn if value.op == "binop" else value.immutable_fn
            sides = (value.lhs.name, value.rhs.name)
            return operation in _COUNTING and all(map(self._is_natural, sides))
        if value.op == "call" and not value.kws and not value.vararg:
            functions = self.func_ir._definitions.get(value.func.name, ())
            if [getattr(each, "value", None) for each in functions] == [range]:
                return len(value.args) == 1 or (
                    len(value.args) == 2 and self._is_natural(value.args[0].name)
                )
        return False


_COUNTING = {operator.add, operator.mul}


def _is_natural_constant(value: Any) -> bool:
    return isinstance(value, Constant) and value.constant >= 0


@register_pass(mutates_CFG=True, analysis_only=False)
class _StrippingPhis(PreLowerStripPhis):
    """Each block assigns what others choose by where they come from."""

    _name = "kernel_stripping_phis"

    def run_pass(self, state: Any) -> bool:
        state.func_ir = self._strip_phi_nodes(state.func_ir)
        state.func_ir._definitions = build_definitions(state.func_ir.blocks)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class _Rewriting(FunctionPass):
    """Constant indices are noticed, and each variable is assigned once."""

    _name = "kernel_rewriting"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        function = state.func_ir
        if types.none in state.args:
            dead_branch_prune(function, state.args)
        function.blocks = blocks = canonicalize_cfg(function.blocks)
        infer = function.infer_constant
        seen: dict[str, bool] = {}
        function.infer_constant = lambda name: (
            infer(name) if _may_be_constant(function, str(name), seen) else _give_up()
        )
        for each in (RewriteConstGetitems, RewriteConstSetitems):
            rewrite = each(state)
            for key, block in list(blocks.items()):
                while rewrite.match(function, block, None, None):
                    blocks[key] = block = rewrite.apply()
        del function.infer_constant
        reconstruct_ssa(function)
        function._definitions = build_definitions(function.blocks)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(BaseNativeLowering):
    _name = "kernel_lowering"  # type: ignore[assignment]

    lowering_class = _Lower


def _may_be_constant(function: Any, name: str, seen: dict[str, bool]) -> bool:
    """Whether to ask numba for the value of a variable; if it has none, it words a long message."""
    if name not in seen:
        seen[name] = False
        found = function._definitions.get(name, ())
        if len(found) == 1:
            (value,) = found
            if isinstance(value, ir.Expr):
                names = {each.name for each in value.list_vars()}
                constant = value.op in ("call", "getattr", "build_tuple")
                seen[name] = constant and all(_may_be_constant(function, n, seen) for n in names)
            elif isinstance(value, ir.Var):
                seen[name] = _may_be_constant(function, value.name, seen)
            else:
                seen[name] = not isinstance(value, ir.Arg)
    return seen[name]


def _give_up() -> Any:
    raise _NOT_CONSTANT


_NOT_CONSTANT = errors.ConstantInferenceError("not constant")
