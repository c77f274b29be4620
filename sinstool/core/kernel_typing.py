"""How numba finds the types in kernels: what it has found is not asked again.

numba goes over all statements of a function until no type changes, twice at least, and looks up
each operation and attribute each time. In a kernel only what one variable takes over from another
can change after the first time: where a loop begins, a variable has what the loop leaves in it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from threading import local
from types import BuiltinFunctionType
from typing import Any

from numba.core import base, interpreter, ssa, typeinfer, types, typing
from numba.core.errors import TypingError

__all__ = ["is_ours", "set_up", "turn"]

# Of a thread: whether it compiles a kernel, what functions it has met, and how the kernel is made
turn = local()

_PLAIN = (types.Number, types.Boolean, types.Array, types.BaseTuple, types.Record)


def is_ours() -> bool:
    """Whether this thread compiles a kernel."""
    return getattr(turn, "ours", False)


def set_up() -> None:
    """Have numba do so; other functions than kernels and parts are left alone."""
    typing.Context.resolve_value_type = _value_type(  # type: ignore[method-assign]
        typing.Context.resolve_value_type
    )
    types.BaseFunction.get_call_type = _call_type(  # type: ignore[method-assign]
        types.BaseFunction.get_call_type
    )
    typeinfer.TypeInferer.propagate = _propagate(  # type: ignore[method-assign]
        typeinfer.TypeInferer.propagate
    )
    base.BaseContext.get_abi_sizeof = _size(  # type: ignore[method-assign]
        base.BaseContext.get_abi_sizeof
    )
    base._has_loc = cache(base._has_loc)
    ssa._run_block_rewrite = _rewriting_of_blocks(ssa._run_block_rewrite)
    interpreter.peep_hole_delete_with_exit = _without_with(interpreter.peep_hole_delete_with_exit)


def _value_type(theirs: Callable[..., Any]) -> Callable[..., Any]:
    def resolve_value_type(self: Any, value: Any) -> Any:
        if not isinstance(value, BuiltinFunctionType) or not is_ours():
            return theirs(self, value)
        if value not in turn.values:
            turn.values[value] = theirs(self, value)
        return turn.values[value]

    return resolve_value_type


def _call_type(theirs: Callable[..., Any]) -> Callable[..., Any]:
    inferred: dict[tuple[int, Any], tuple[Any, Any]] = {}

    def get_call_type(self: Any, context: Any, args: Any, keywords: Any) -> Any:
        if keywords or not is_ours() or not all(map(_is_plain, map(type, args))):
            return theirs(self, context, args, keywords)
        key = (id(self), args)
        found = inferred.get(key)
        if found is None:
            found = inferred[key] = (self, theirs(self, context, args, keywords))
        return found[1]

    return get_call_type


@cache
def _is_plain(kind: Any) -> bool:
    return issubclass(kind, _PLAIN)


def _propagate(theirs: Callable[..., Any]) -> Callable[..., Any]:
    def propagate(self: Any, raise_errors: bool = True) -> Any:
        if is_ours() and _settled(self):
            return None
        return theirs(self, raise_errors)

    return propagate


def _settled(inferer: Any) -> bool:
    """Whether types do not change any more after all statements have been looked at once."""
    constraints = inferer.constraints.constraints
    try:
        for each in constraints:
            each(inferer)
        before = inferer.get_state_token()
        for each in constraints:
            if type(each) is typeinfer.Propagate:
                each(inferer)
    except TypingError:  # often for want of what comes later
        return False
    return inferer.get_state_token() == before and all(
        each.defined and not isinstance(each.type, types.RecursiveCall)
        for each in inferer.typevars.values()
    )


def _rewriting_of_blocks(theirs: Callable[..., Any]) -> Callable[..., Any]:
    """One variable after the other is renamed: blocks that do not name it stay as they are."""

    def run_block_rewrite(blocks: Any, states: Any, handler: Any) -> Any:
        if not is_ours():
            return theirs(blocks, states, handler)
        done = {}
        for label, block in blocks.items():
            if not hasattr(block, "named"):
                block.named = {each.name for stmt in block.body for each in stmt.list_vars()}
            if states["varname"] in block.named:
                named = block.named
                (block,) = theirs({label: block}, states, handler).values()
                block.named = named
            done[label] = block
        return done

    return run_block_rewrite


def _without_with(theirs: Callable[..., Any]) -> Callable[..., Any]:
    """Kernels have no `with`."""

    def peep_hole_delete_with_exit(func_ir: Any) -> Any:
        return func_ir if is_ours() else theirs(func_ir)

    return peep_hole_delete_with_exit


def _size(theirs: Callable[..., Any]) -> Callable[..., Any]:
    sizes: dict[tuple[int, str], int] = {}

    def get_abi_sizeof(self: Any, ty: Any) -> int:
        key = (id(self), str(ty))  # LLVM is asked by way of a module made for the purpose
        if key not in sizes:
            sizes[key] = theirs(self, ty)
        return sizes[key]

    return get_abi_sizeof
