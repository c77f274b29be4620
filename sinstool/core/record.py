"""Dataclasses that are made in a fourth of the time.

Of each class `dataclasses.dataclass` writes and compiles six functions, while its module is
imported; with a hundred classes that takes longer than all else that a short log needs. Here only
`__init__` is made so, and the others are the same functions for all classes.
"""

from __future__ import annotations

import dataclasses
from dataclasses import FrozenInstanceError, fields
from functools import partial
from reprlib import recursive_repr
from typing import TYPE_CHECKING, Any

__all__ = ["dataclass"]


def _dataclass(
    cls: Any = None,
    /,
    *,
    frozen: bool = False,
    eq: bool = True,
    repr: bool = True,
    kw_only: bool = False,
) -> Any:
    """Make a class a dataclass, as `dataclasses.dataclass` does."""
    if cls is None:
        return partial(_dataclass, frozen=frozen, eq=eq, repr=repr, kw_only=kw_only)
    own = vars(cls)
    if repr and "__repr__" not in own:
        cls.__repr__ = _repr
    if eq and "__eq__" not in own:
        # Python itself sets a class's hash to None where it has a comparison of its own
        explicit = own.get("__hash__")
        cls.__eq__ = _eq
        cls.__hash__ = explicit or (_hash if frozen else None)
    if frozen:
        cls.__setattr__, cls.__delattr__ = _set_once, _delete
    return dataclasses.dataclass(repr=False, eq=False, kw_only=kw_only)(cls)


@recursive_repr()
def _repr(self: Any) -> str:
    shown = (f"{each.name}={getattr(self, each.name)!r}" for each in fields(self) if each.repr)
    return f"{type(self).__qualname__}({', '.join(shown)})"


def _eq(self: Any, other: object) -> bool:
    if type(other) is not type(self):
        return NotImplemented
    return _compared(self) == _compared(other)


def _hash(self: Any) -> int:
    return hash(_compared(self))


def _compared(record: Any) -> tuple[Any, ...]:
    return tuple(getattr(record, each.name) for each in fields(record) if each.compare)


def _set_once(self: Any, name: str, value: object) -> None:
    """Set an attribute of a frozen class, which `__init__` alone can: there is none before."""
    if name in self.__dict__ or name not in self.__dataclass_fields__:
        raise FrozenInstanceError(f"cannot assign to field {name!r}")
    self.__dict__[name] = value


def _delete(self: Any, name: str) -> None:
    raise FrozenInstanceError(f"cannot delete field {name!r}")


if TYPE_CHECKING:
    from dataclasses import dataclass
else:
    dataclass = _dataclass
