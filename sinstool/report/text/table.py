"""Aligned columns of text."""

from __future__ import annotations

import shutil
import sys
import textwrap
from collections.abc import Sequence

import click

from sinstool.core.errors import one_line

# Narrower columns of text are not worth wrapping into
NARROWEST = 20


def table(rows: list[tuple[str, str]]) -> None:
    """Print two columns, label and text, wrapped to the width of a terminal."""
    width = max((len(name) for name, _ in rows), default=0)
    room = terminal_width()
    for name, value in rows:
        lines = [one_line(line) for line in value.split("\n")]
        if room is not None:
            lines = [part for line in lines for part in wrapped(line, room - width - 2)]
        for before, line in zip((one_line(name), *[""] * len(lines)), lines, strict=False):
            click.echo(f"{before:<{width}}  {line}")


def terminal_width() -> int | None:
    """Columns of the terminal that stdout is; None where it is a file or a pipe."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def wrapped(text: str, width: int) -> list[str]:
    """Lines of at most so many characters; words stay whole."""
    lines = textwrap.wrap(
        text, max(width, NARROWEST), break_long_words=False, break_on_hyphens=False
    )
    return lines or [""]


def aligned(rows: Sequence[Sequence[str]], right: Sequence[bool] | None = None) -> list[str]:
    """Lines of a table, each column as wide as it must be.

    Parameters
    ----------
    right : sequence of bool, optional
        Of each column; by default all but the first.
    """
    widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)]
    sides = right if right is not None else [k > 0 for k in range(len(widths))]
    return [
        "  ".join(
            f"{cell:>{width}}" if side else f"{cell:<{width}}"
            for cell, width, side in zip(row, widths, sides, strict=True)
        ).rstrip()
        for row in rows
    ]


def columns(names: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table on stdout, numbers to the right."""
    numeric = [all(_is_number(row[k]) for row in rows) for k in range(len(names))]
    for line in aligned([names, *rows], numeric):
        click.echo(line)


def _is_number(text: str) -> bool:
    if text in ("", "-"):
        return True
    try:
        float(text)
    except ValueError:
        return False
    return True
