"""Settings and input of a run on a page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from sinstool.core import version
from sinstool.core.options import Group
from sinstool.core.whole_file import path_for_now
from sinstool.io.readers.log import path_size
from sinstool.pipelines.process.summary import InputFile
from sinstool.pipelines.provenance import sha256
from sinstool.report.sections import Rows, Setting


def config_settings(config: Group, *paths: str) -> tuple[Setting, ...]:
    """Effective settings of groups of the configuration.

    Parameters
    ----------
    *paths : str
        Names of groups, or of single fields as ``group.name``; groups that are None are left out.

    Returns
    -------
    tuple of Setting
        Named by their keys in the file.
    """
    settings: list[Setting] = []
    for path in paths:
        group = getattr(config, path.partition(".")[0])
        if isinstance(group, Group):
            for table, name, field in config.options(path):
                value = getattr(group, name)
                chosen = value != field.get_default(call_default_factory=True)
                text = field.description or ""
                settings.append(Setting(f"{table}.{name}", _plain(value), chosen, text))
        elif group is not None:
            settings += _flat(group, f"{path}.")
    return tuple(settings)


def _flat(table: Mapping[str, Any], before: str) -> Iterator[Setting]:
    """Settings of a table; the names of tables in it are joined by dots."""
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{before}{name}.")
        else:
            yield Setting(f"{before}{name}", _plain(value))


def _plain(value: Any) -> Any:
    """Matrices as they are written, row by row."""
    if isinstance(value, list | tuple) and value and isinstance(value[0], list | tuple):
        return "; ".join(", ".join(f"{v:.10g}" for v in row) for row in value)
    return value


def read_file(path: Path) -> InputFile:
    """Look at a file, or at all files of a directory, that a page was made from."""
    there = path_for_now(path)
    return InputFile(str(path), path_size(there), sha256(there))


def input_rows(read: Sequence[InputFile], title: str = "Input") -> Rows:
    """Inputs and version of the page, so that it can be made again."""
    pairs = [(one.path, f"{one.size} bytes, SHA-256 {one.sha256}") for one in read]
    return Rows(title, (*pairs, ("made by", f"sinstool {version.VERSION}")))
