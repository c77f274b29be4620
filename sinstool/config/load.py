"""Validated configurations from plain data and TOML, with errors that name the key."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from sinstool.core.errors import ConfigurationError
from sinstool.core.options import Group
from sinstool.core.small_file import read_text
from sinstool.core.suggest import nearest

G = TypeVar("G", bound=Group)


def build(model: type[G], data: dict[str, Any], source: str = "", check: bool = True) -> G:
    """Validate plain data into a configuration.

    Parameters
    ----------
    model : type
        ProcessConfig, or a group of it.
    source : str
        Named in errors: a file; empty for the command line, whose options are named instead.
    check : bool
        Check also that options fit each other.

    Raises
    ------
    ConfigurationError
        An unknown key, a wrong type or an impossible value, with the key's path.
    """
    try:
        config = model.model_validate(data)
    except ValidationError as exc:
        raise ConfigurationError(_first_error(exc, model, source)) from exc
    except ConfigurationError as exc:  # of a table that knows its own keys
        raise ConfigurationError(
            f"{source}: {exc.message}" if source else exc.message, exc.hint
        ) from exc
    if check:
        config.check()
    return config


def _first_error(exc: ValidationError, model: type[Group], source: str) -> str:
    """One line about the first thing that is wrong, with the key's path or the option's name."""
    errors = exc.errors()
    tables = _tables(model, errors[0]["loc"])
    depth = len(tables)
    key = errors[0]["loc"][:depth]
    # All branches of a union complain; the one that got furthest into the value knows best.
    same = [e for e in errors if e["loc"][:depth] == key]
    error = max(same, key=lambda e: len(e["loc"]))
    path = ".".join(map(str, key))
    where = f"{source}: " if source else ""
    if error["type"] == "extra_forbidden":
        near = nearest(str(key[-1]), tables[-1].model_fields)
        return f"{where}unknown key {path}" + (f": {near}" if near else "")
    if error["type"] == "missing" and len(error["loc"]) == depth:
        return f"{where}{path} is missing"
    if len(same) > 1 and len(error["loc"]) <= depth + 1 and error["type"] != "missing":
        said = " or ".join(dict.fromkeys(_said(e) for e in same))
    else:
        said = _said(error)
    # Branches of unions have names, elements of lists have numbers.
    element = next((p for p in error["loc"][depth:] if isinstance(p, int)), None)
    if error["type"] == "missing":
        element = None
    if element is not None:
        path += f"[{element}]"
    if not source and depth == 2:
        value = error["input"]
        listed = ",".join(map(str, value)) if isinstance(value, list | tuple) else _shown(value)
        return f"--{str(key[1]).replace('_', '-')} {listed}: {said}"
    return f"{where}{path} = {_shown(error['input'])}: {said}"


def _tables(model: type[Group], place: tuple[int | str, ...]) -> list[type[BaseModel]]:
    """The tables on the way to an error, from the whole file on: one for each key of its path."""
    tables = []
    table: type[BaseModel] | None = model
    for name in place:
        if table is None:
            break
        tables.append(table)
        field = table.model_fields.get(str(name))
        table = None if field is None else _table(field.annotation)
    return tables


def _table(annotation: Any) -> type[BaseModel] | None:
    """The model that a field holds, if it holds one."""
    for kind in (annotation, *get_args(annotation)):
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            return kind
    return None


def _shown(value: Any) -> str:
    """A value as TOML writes it, or nearly."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(_shown(v) for v in value)}]"
    return repr(value)


def _said(error: Any) -> str:
    """An error of pydantic, in the terms of the configuration file."""
    words = {
        "tuple_type": "must be a list",
        "model_type": "must be a table",
        "missing": "too few values",
        "too_long": "too many values",
    }
    if error["type"] in words:
        return words[error["type"]]
    said = str(error["msg"]).removeprefix("Value error, ").removeprefix("Input ")
    return said.replace("should be", "must be", 1)


def load_toml(path: Path) -> dict[str, Any]:
    """Read a configuration file.

    Raises
    ------
    ConfigurationError
        It cannot be read or is no TOML.
    """
    import tomllib

    text = read_text(path)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as exc:
        raise ConfigurationError(f"{path}: not valid TOML ({exc})") from exc
    except RecursionError:
        raise ConfigurationError(f"{path}: not valid TOML (lists in lists, too deep)") from None


def effective(
    model: type[G], config_file: Path | None, overrides: Mapping[tuple[str, str], Any], check: bool
) -> G:
    """Defaults, overlaid by a file, overlaid by options.

    Parameters
    ----------
    config_file : Path or None
    overrides : mapping
        Values by table and key.
    check : bool
        Check also that options fit each other.

    Raises
    ------
    ConfigurationError
    """
    data: dict[str, Any] = {}
    if config_file is not None:
        data = load_toml(config_file)
        # The file alone first: its errors are then reported with its name.
        build(model, data, str(config_file), check=False)
    for (table, key), value in overrides.items():
        data.setdefault(table, {})[key] = value
    return build(model, data, check=check)


def dump_toml(config: Group, *without: str) -> str:
    """The effective configuration as TOML that `--config` reads back.

    Parameters
    ----------
    *without : str
        Groups that do not concern the command.
    """
    import tomli_w

    data = config.model_dump(mode="json", exclude_none=True, exclude=set(without))
    return tomli_w.dumps({k: v for k, v in data.items() if v not in ({}, None)})
