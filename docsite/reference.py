"""Reference pages made from the program itself, so that they cannot say what it does not do."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import click

from sinstool.cli.conventions import sections
from sinstool.cli.help import Command
from sinstool.cli.main import COMMANDS, cli


def command_table() -> str:
    """The commands, each with its line and a link to its page."""
    rows = ["| command | what it does |", "|---|---|"]
    for name, line in COMMANDS.items():
        page = f"{name}.md" if name not in ("conventions", "completion") else "shell.md"
        rows.append(f"| [`sinstool {name}`]({page}) | {line} |")
    return "\n".join(rows)


def conventions() -> str:
    """The conventions, as headings and text."""
    parts = [f"## {title}\n\n{text}" for title, text in sections() if title]
    return "\n\n".join(parts).replace("``", "`")


def options(path: str) -> str:
    """Every option of a command, in the groups of its help.

    Parameters
    ----------
    path : str
        Names of the command and its subcommand.

    Raises
    ------
    ValueError
        There is no such command.
    """
    command: click.Command | None = cli
    context = click.Context(cli, info_name="sinstool", **cli.context_settings)
    for name in path.split():
        command = command.get_command(context, name) if isinstance(command, click.Group) else None
        if command is None:
            raise ValueError(f"no command {path}")
        context = click.Context(command, parent=context, info_name=name)
    assert command is not None
    lines = [f"```text\n{command.get_usage(context)}\n```", ""]
    sections = _sections(command, context)
    level = "#" * (2 + path.count(" ") + 1)
    for title, members in sections.items():
        if len(sections) > 1:
            anchor = f"{path} {title}".replace(" ", "-").replace("/", "-").lower()
            lines += [f"{level} {title}{_table(members)} {{#{anchor}}}", ""]
        for member in members:
            lines += _entry(member, context, path)
    return "\n".join(lines)


def _sections(command: click.Command, context: click.Context) -> dict[str, list[click.Option]]:
    """Options under the headings of the command's own help."""
    if isinstance(command, Command):
        return command.sections(context)
    return {"Options": [p for p in command.params if isinstance(p, click.Option)]}


def _table(members: list[click.Option]) -> str:
    """The table of the configuration file that all options of a section are in."""
    tables = {str(o.name).partition("__")[0] for o in members if "__" in str(o.name)}
    own = [o for o in members if "__" not in str(o.name)]
    return f" — `[{tables.pop()}]`" if len(tables) == 1 and not own else ""


def _entry(option: click.Option, context: click.Context, path: str) -> Iterator[str]:
    names = [*option.opts, *option.secondary_opts]
    value = "" if option.is_flag or option.count else f" {_values(option, context)}"
    shown = ", ".join(f"`{name}`" for name in names) + value
    anchor = f"{path.replace(' ', '-')}{names[-1] if len(option.opts) > 1 else names[0]}"
    text = (option.help or "").strip()
    text, default = _default(text, option)
    text = text[:1].upper() + text[1:]
    if text and not text.endswith((".", ")")):
        text += "."
    text = text.replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*")
    if default:
        text += f" Default: `{default}`."
    if "__" in str(option.name):
        group, _, name = str(option.name).partition("__")
        text += f" In a file: `{group}.{name}`."
    yield f'<span id="{anchor}">{shown}</span>'
    yield f":   {text.strip() or 'See the examples.'}"
    yield ""


def _values(option: click.Option, context: click.Context) -> str:
    if isinstance(option.type, click.Choice) and option.metavar is None:
        return " \\| ".join(f"`{choice}`" for choice in option.type.choices)
    return f"`{option.make_metavar(context)}`"


def _default(text: str, option: click.Option) -> tuple[str, str]:
    """Text without its default, and the default; both kinds of saying it are in use."""
    match = re.search(r"\s*\[default: (.*)\]$", text)
    if match:
        return text[: match.start()], match[1]
    default: Any = option.default
    if option.show_default and default is not None and not option.is_flag:
        return text, str(default)
    return text, ""
