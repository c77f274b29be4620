"""`dataclass` of the standard library, whose frozen classes are made in a fifth of the time.

Before Python 3.13 that compiles six methods for each class, for 0.3 ms, and a run of `process`
loads more than a hundred classes: an eighth of what it takes on a short log. Here a frozen class
has a constructor of its own, and the rest in common with all others. To type checkers, and to
whoever uses the classes, they are dataclasses like any other.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from reprlib import recursive_repr
from typing import TYPE_CHECKING, Any

__all__ = ["dataclass"]

if TYPE_CHECKING:
    from dataclasses import dataclass
else:

    def dataclass(
        cls: type | None = None, /, *, frozen: bool = False, kw_only: bool = False, **options: Any
    ) -> Any:
        """As `dataclasses.dataclass`, with its options."""

        def made(cls: type) -> type:
            shared = _shared(cls, **options) if frozen else None
            if shared is None:
                return dataclasses.dataclass(cls, frozen=frozen, kw_only=kw_only, **options)
            for name, method in shared.items():
                if name not in vars(cls):
                    setattr(cls, name, method)
            return dataclasses.dataclass(cls, eq=False, repr=False, kw_only=kw_only)

        return made if cls is None else made(cls)


def _shared(
    cls: type, *, eq: bool = True, repr: bool = True, **others: Any
) -> dict[str, Callable[..., Any]] | None:
    """Methods that a frozen class has in common with others; None: it needs its own."""
    if others or "__eq__" in vars(cls) or "__hash__" in vars(cls):
        return None
    methods: dict[str, Callable[..., Any]] = {"__setattr__": _set, "__delattr__": _delete}
    if eq:
        methods |= {"__eq__": _equal, "__hash__": _hashed}
    return methods | {"__repr__": _shown} if repr else methods


def _set(self: Any, name: str, value: Any) -> None:
    # The constructor sets each field once
    if name in vars(self) or name not in self.__dataclass_fields__:
        raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")
    object.__setattr__(self, name, value)


def _delete(self: Any, name: str) -> None:
    raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")


def _compared(self: Any) -> Iterator[Any]:
    return (getattr(self, one.name) for one in dataclasses.fields(self) if one.compare)


def _equal(self: Any, other: object) -> bool:
    if other.__class__ is not self.__class__:
        return NotImplemented
    return tuple(_compared(self)) == tuple(_compared(other))


def _hashed(self: Any) -> int:
    return hash(tuple(_compared(self)))


@recursive_repr()
def _shown(self: Any) -> str:
    parts = (
        f"{one.name}={getattr(self, one.name)!r}" for one in dataclasses.fields(self) if one.repr
    )
    return f"{self.__class__.__qualname__}({', '.join(parts)})"
