"""Extensions from other distributions, through their entry points."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from sinstool.core.errors import ConfigurationError

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
