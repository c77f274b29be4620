"""Extensions from other distributions, through their entry points."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any

from sinstool.core.errors import ConfigurationError, SinstoolError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


@cache
def plugins(group: str) -> dict[str, EntryPoint]:
    """Entry points of the installed distributions, by name.

    Parameters
    ----------
    group : str
        ``sinstool.coning`` or ``sinstool.readers``.
    """
    # Slow, because it looks through all installed distributions; few commands need it.
    from importlib.metadata import entry_points

    return {entry.name: entry for entry in entry_points(group=group)}


def load(group: str, name: str) -> Any:
    """The object that an entry point names.

    Raises
    ------
    ConfigurationError
        If its module cannot be imported, or lacks the object.
    """
    entry = plugins(group)[name]
    try:
        return entry.load()
    except Exception as exc:  # importing a foreign module may raise anything
        owner = "" if entry.dist is None else f" of {entry.dist.name}"
        raise ConfigurationError(
            f"the plug-in {name}{owner} cannot be loaded: {type(exc).__name__}: {exc}",
            f"repair or uninstall it ({entry.value})",
        ) from exc


@contextmanager
def blamed(who: object, error: Callable[[str], SinstoolError]) -> Iterator[None]:
    """Errors of somebody else's code in the body become errors that name it.

    Parameters
    ----------
    who : object
        What runs: an instance or a class. What is sinstool's own keeps its traceback.
    error : callable
        From the text of an exception to the error.
    """
    try:
        yield
    except (SinstoolError, MemoryError):
        raise
    except Exception as exc:  # whatever the code of somebody else does
        kind = who if isinstance(who, type) else type(who)
        if kind.__module__.startswith("sinstool."):
            raise
        raise error(f"{type(exc).__name__}: {exc}") from exc
