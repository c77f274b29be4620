"""Keyword arguments of the API as a configuration, with the names of the command line."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, TypeVar, get_args, get_origin

import numpy as np

from sinstool.core.errors import ConfigurationError
from sinstool.core.options import Group
from sinstool.core.suggest import nearest

if TYPE_CHECKING:
    from sinstool.config import ProcessConfig

G = TypeVar("G", bound=Group)
# More options than these are not listed in a message
SOME = 40
PathLike = str | os.PathLike[str]


def configured(
    command: str,
    paths: tuple[str, ...],
    options: Mapping[str, Any],
    config: PathLike | None = None,
    check: bool = True,
) -> ProcessConfig:
    """The configuration that keywords describe.

    Parameters
    ----------
    command : str
        Named in errors.
    paths : tuple of str
        Tables and keys that the command takes.
    options : mapping
        The keywords; those that are None are not set.
    config : path-like, optional
        A TOML file as ``--config`` takes, which keywords override.

    Raises
    ------
    ConfigurationError
        A keyword is none of the command's, or its value is impossible.
    """
    from sinstool.config import ProcessConfig

    return configured_by(ProcessConfig, command, paths, options, config, check)


def configured_by(
    model: type[G],
    command: str,
    paths: tuple[str, ...],
    options: Mapping[str, Any],
    config: PathLike | None = None,
    check: bool = True,
) -> G:
    """As `configured`, of any model."""
    from sinstool.config.load import effective

    fields = {name: (table, field) for table, name, field in model.options(*paths)}
    values = {}
    for name, value in options.items():
        if name not in fields:
            near = nearest(name, fields)
            raise ConfigurationError(
                f"{command} has no option {name}", near or _listing(command, fields)
            )
        if value is not None:
            table, field = fields[name]
            values[table, name] = _plain(value, field.annotation)
    file = None if config is None else path_of(config, "config")
    return effective(model, file, values, check)


def _listing(command: str, names: Mapping[str, Any]) -> str:
    """The options, or where they are listed if they are many."""
    if len(names) <= SOME:
        return f"its options are {', '.join(sorted(names))}"
    of = {"survey": "info", "navigate": "process"}.get(command, command.replace("_", "-"))
    of = of.replace("scenario ", "simulate ")
    return f"`sinstool {of} --help-all` lists them"


def _plain(value: Any, annotation: Any) -> Any:
    """A value as a configuration file would hold it."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    elif isinstance(value, np.generic):
        value = value.item()
    elif isinstance(value, PurePath):
        value = str(value)
    kinds = [one for one in (annotation, *get_args(annotation)) if get_origin(one) is tuple]
    if isinstance(value, str) and any(get_args(kind) == (str, ...) for kind in kinds):
        return [value]
    if isinstance(value, (list, tuple)):
        return [_plain(one, None) for one in value]
    return value


def path_of(value: Any, what: str = "log") -> Path:
    """A path from any kind of path argument.

    Raises
    ------
    ConfigurationError
        It is none.
    """
    if value == "":
        # which would be the folder in which the program runs
        raise ConfigurationError(f"the {what} is an empty text", "give its path")
    try:
        return Path(value)
    except TypeError:
        raise ConfigurationError(
            f"the {what} is of type {type(value).__name__}", "give a path, as text or pathlib.Path"
        ) from None
