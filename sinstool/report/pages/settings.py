"""What a page tells of a run's settings and input."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from sinstool.config import ProcessConfig
from sinstool.core import version
from sinstool.core.whole_file import path_for_now
from sinstool.io.readers.log import path_size
from sinstool.pipelines.provenance import sha256
from sinstool.report.sections import Rows, Setting, flat

# Of a command line: where to write and how much to say changes nothing of what is found.
SILENT = ("show", "as_json", "quiet", "verbose", "help")


def config_settings(config: ProcessConfig, *groups: str) -> tuple[Setting, ...]:
    """Effective settings of groups of the configuration.

    Parameters
    ----------
    *groups : str
        Names of its fields; those that are None are left out.

    Returns
    -------
    tuple of Setting
        Named by their keys in the file.
    """
    found: list[Setting] = []
    for group in groups:
        told = getattr(config, group)
        if isinstance(told, BaseModel):
            found += _of_model(told, group)
        elif told is not None:
            found += [replace(one, value=_plain(one.value)) for one in flat(told, f"{group}.")]
    return tuple(found)


def _of_model(model: BaseModel, path: str) -> Iterator[Setting]:
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        if isinstance(value, BaseModel):
            yield from _of_model(value, f"{path}.{name}")
        else:
            given = value != field.get_default(call_default_factory=True)
            yield Setting(f"{path}.{name}", _plain(value), given, _meaning(field))


def _meaning(field: FieldInfo) -> str:
    return field.description or ""


def _plain(value: Any) -> Any:
    """Matrices as they are written, row by row."""
    if isinstance(value, list | tuple) and value and isinstance(value[0], list | tuple):
        return "; ".join(", ".join(f"{v:.10g}" for v in row) for row in value)
    return value


def option_settings(
    command: click.Command, values: Mapping[str, Any], chosen: Mapping[str, Any] | None = None
) -> tuple[Setting, ...]:
    """Options of a command, but for those that come from the configuration.

    Parameters
    ----------
    values : mapping
        By the option's name, as the command was called with.
    chosen : mapping, optional
        What the command took where nothing was given.

    Returns
    -------
    tuple of Setting
        Named as on the command line.
    """
    context = click.Context(command)
    found = []
    for option in command.params:
        name = option.name or ""
        if not isinstance(option, click.Option) or "__" in name or name in SILENT:
            continue
        value = values.get(name)
        default = option.to_info_dict().get("default")
        if default is not None:
            default = option.type_cast_value(context, default)
        given = value not in (default, None, ())
        shown = value if given else (chosen or {}).get(name, value)
        if isinstance(shown, Path):
            shown = str(shown)
        found.append(Setting(option.opts[-1], _plain(shown), given, option.help or ""))
    return tuple(found)


@dataclass(frozen=True)
class Read:
    """A file that a page was made from.

    Attributes
    ----------
    size : int
        Bytes.
    """

    path: str
    size: int
    sha256: str

    @classmethod
    def of(cls, path: Path) -> Read:
        """Look at a file, or at all files of a directory."""
        there = path_for_now(path)
        return cls(str(path), path_size(there), sha256(there))


def input_rows(read: Sequence[Read], title: str = "Input") -> Rows:
    """What the page was made from, and by which version, so that it can be made again.

    Parameters
    ----------
    title : str, optional

    Returns
    -------
    Rows
    """
    pairs = [(one.path, f"{one.size} bytes, SHA-256 {one.sha256}") for one in read]
    return Rows(title, (*pairs, ("made by", f"sinstool {version.VERSION}")))
