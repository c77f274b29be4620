"""What mkdocs runs while it builds the site: generated parts of pages, and equations.

A page asks for a generated part with a comment, which GitHub's own rendering leaves out:

``<!-- commands -->``
    the table of commands;
``<!-- options: COMMAND [SUBCOMMAND] -->``
    every option of a command, from the command itself;
``<!-- conventions -->``
    the conventions, from `sinstool.core.conventions`;
``<!-- json: COMMAND -->``
    the keys of a command's ``--json``, from the dataclasses of its result;
``<!-- api -->``
    the Python API, from its docstrings.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from json_keys import json_keys
from mathml import equations
from mkdocs.exceptions import PluginError
from python_api import python_api
from reference import command_table, conventions, options

PARTS: dict[str, Callable[[str], str]] = {
    "commands": lambda _: command_table(),
    "options": options,
    "conventions": lambda _: conventions(),
    "json": json_keys,
    "api": lambda _: python_api(),
}
MARK = re.compile(r"^<!-- (\w+)(?:: ([^>]*?))? -->$", re.MULTILINE)


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Put generated parts where a page asks for them."""

    def part(match: re.Match[str]) -> str:
        make = PARTS.get(match[1])
        if make is None:
            return match[0]
        try:
            return make(match[2] or "")
        except ValueError as exc:
            raise PluginError(f"{page.file.src_uri}: {match[0]}: {exc}") from exc

    return MARK.sub(part, markdown)


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """Turn the equations of a page into MathML."""
    try:
        return equations(html)
    except ValueError as exc:
        raise PluginError(f"{page.file.src_uri}: {exc}") from exc
