"""Aligned columns of text."""

from __future__ import annotations

from collections.abc import Sequence

import click

from sinstool.core.errors import one_line


def table(rows: list[tuple[str, str]]) -> None:
    """Two columns on stdout: what, and how much."""
    width = max((len(name) for name, _ in rows), default=0)
    for name, value in rows:
        first, *rest = map(one_line, value.split("\n"))
        click.echo(f"{one_line(name):<{width}}  {first}")
        for line in rest:
            click.echo(f"{'':<{width}}  {line}")


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
