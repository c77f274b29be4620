"""`-v`: what a command chooses, and why, on stderr while it chooses."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])


class _Shown(logging.Handler):
    """Each choice once a log, although several passes may make it again."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self._printed: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line to whatever stderr is now: a progress bar may have its hands on it."""
        text = record.getMessage()
        if text.startswith("log: "):
            self._printed.clear()
        if text not in self._printed:
            self._printed.add(text)
            click.echo(f"- {text}", err=True)


def verbose_option(also: str = "") -> Callable[[F], F]:
    """The option ``-v``: how often it was given, as ``verbose``.

    Parameters
    ----------
    also : str
        What a command shows with it besides.
    """

    def listen(context: click.Context, _: click.Parameter, value: int) -> int:
        if value and not context.resilient_parsing:
            from sinstool.core.choices import LOGGER

            handler = _Shown()
            before = LOGGER.level
            LOGGER.setLevel(logging.INFO)
            LOGGER.addHandler(handler)
            context.call_on_close(lambda: LOGGER.removeHandler(handler))
            context.call_on_close(lambda: LOGGER.setLevel(before))
        return value

    more = f", {also}" if also else ""
    return click.option(
        "-v",
        "--verbose",
        count=True,
        callback=listen,
        help=f"say what is chosen, and why{more}; -vv: with a traceback for an error",
    )
