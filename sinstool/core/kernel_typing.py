"""Faster type inference for kernels: types that numba has found once are not inferred again.

numba goes over all statements of a function until no type changes, at least twice, and looks up
every operation and attribute each time. In a kernel only assignments from one variable to another
can change a type after the first round, because a variable at the beginning of a loop takes the
type that it has at the end of the loop.
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

# State of each thread: whether it compiles a kernel, the functions it has met, and the options
turn = local()

_PLAIN = (types.Number, types.Boolean, types.Array, types.BaseTuple, types.Record)


def is_ours() -> bool:
    """Whether this thread compiles a kernel."""
    return getattr(turn, "ours", False)


def set_up() -> None:
    """Patch numba accordingly; functions that are not kernels or parts are not affected."""
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
    """Whether no type changes any more after one round over all statements."""
    constraints = inferer.constraints.constraints
    try:
        for each in constraints:
            each(inferer)
        before = inferer.get_state_token()
        for each in constraints:
            if type(each) is typeinfer.Propagate:
                each(inferer)
    except TypingError:  # often because a type that is needed is found only later
        return False
    return inferer.get_state_token() == before and all(
        each.defined and not isinstance(each.type, types.RecursiveCall)
        for each in inferer.typevars.values()
    )


def _rewriting_of_blocks(theirs: Callable[..., Any]) -> Callable[..., Any]:
    """Renaming of variables, one at a time: blocks that do not name the variable are skipped."""

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
    """Skip the search for `with` statements, which kernels do not have."""

    def peep_hole_delete_with_exit(func_ir: Any) -> Any:
        return func_ir if is_ours() else theirs(func_ir)

    return peep_hole_delete_with_exit


def _size(theirs: Callable[..., Any]) -> Callable[..., Any]:
    sizes: dict[tuple[int, str], int] = {}

    def get_abi_sizeof(self: Any, ty: Any) -> int:
        key = (id(self), str(ty))  # numba makes a module of LLVM for each question
        if key not in sizes:
            sizes[key] = theirs(self, ty)
        return sizes[key]

    return get_abi_sizeof
