"""`sinstool conventions`: frames, axes, quaternions, units, time."""

from __future__ import annotations

import inspect
import re

import click

from sinstool.cli.help import Command
from sinstool.core import conventions


def sections() -> list[tuple[str, str]]:
    """The conventions as titles and texts.

    Returns
    -------
    list of tuple
        In the order of the docstring of :mod:`sinstool.core.conventions`; texts are paragraphs with
        ``names`` in double backticks.
    """
    text = inspect.cleandoc(conventions.__doc__ or "") + "\n"
    matches = re.findall(r"^(\S.*)\n((?:    .*\n|\n)+)", text, re.MULTILINE)
    # A title stands right above its indented text; paragraphs of prose are not indented.
    return [(title, inspect.cleandoc(body)) for title, body in matches if body.startswith("    ")]


@click.command("conventions", cls=Command)
def command() -> None:
    """Frames, axes, quaternions, units, gravity and time, as they are everywhere in sinstool."""
    for title, text in sections():
        click.echo(title)
        for line in text.replace("``", "").split("\n"):
            click.echo(f"    {line}".rstrip())
        click.echo("")
