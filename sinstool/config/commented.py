"""A configuration as a commented file: every option with its help, unset ones too."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from typing import Any

import tomli_w

from sinstool.core.options import Group

WIDTH = 96


def commented_toml(config: Group, *paths: str) -> str:
    """The effective configuration as TOML for ``--config``, with a comment on each option.

    Options that are not set stand in it as comments, so that a reader learns that they exist.
    Printed again from itself it is the same text.

    Parameters
    ----------
    *paths : str
        Tables, or single keys as ``table.key``, that concern the command.
    """
    tables = [path for path in paths if isinstance(getattr(config, path.split(".")[0]), Group)]
    fields: dict[str, list[str]] = {}
    for table, name, field in config.options(*tables):
        value = getattr(getattr(config, table), name)
        lines = textwrap.wrap(_sentence(field.description or ""), WIDTH - 2)
        entry = "".join(f"# {line}\n" for line in lines) + _key(name, value)
        fields.setdefault(table, []).append(entry)
    parts = [
        f"# {config.title_of(table)}\n[{table}]\n" + "\n".join(entries)
        for table, entries in fields.items()
    ]
    parts += _plain_tables(config, [path for path in paths if path not in tables])
    return "\n".join(parts)


def _plain_tables(config: Group, names: list[str]) -> Iterator[str]:
    """Tables whose keys are not options, such as that of a rig."""
    for name in names:
        if (value := getattr(config, name)) is not None:
            yield tomli_w.dumps({name: value})


def _key(name: str, value: Any) -> str:
    """The line of a key; as a comment, if it is not set."""
    if value is None:
        return f"# {name} =\n"
    if isinstance(value, tuple):
        return f"{name} = [{', '.join(map(_scalar, value))}]\n"
    return f"{name} = {_scalar(value)}\n"


def _scalar(value: Any) -> str:
    return tomli_w.dumps({"x": value}).removeprefix("x = ").rstrip("\n")


def _sentence(text: str) -> str:
    """An option's help as a sentence of its own."""
    text = text[:1].upper() + text[1:]
    return text if text.endswith((".", ")")) else text + "."
