"""User dialogue that commands share: words to choose from, ``-v``, progress, JSON."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import click

from sinstool.core.compiling import watched
from sinstool.core.errors import one_line

F = TypeVar("F", bound=Callable[..., Any])
# Most characters of a file's name beside a progress bar
LONGEST_LABEL = 32
# Shown while numba compiles loops that its cache does not hold yet
COMPILING = "compiling, in the first run only"


class Choice(click.Choice):
    """One of a few words."""

    def get_invalid_choice_message(self, value: Any, *_: Any, **__: Any) -> str:
        """Name the valid choices and the likely one."""
        from sinstool.core.suggest import nearest

        text = f"'{value}' is not one of {', '.join(map(str, self.choices))}"
        near = nearest(str(value), map(str, self.choices))
        return f"{text}; {near}" if near else text


class PathName(click.Path):
    """The name of a file or folder; empty, as of a variable that is not set, it is refused."""

    def __init__(self, **options: Any) -> None:
        super().__init__(path_type=Path, **options)

    def convert(self, value: Any, *where: Any) -> Any:
        """Refuse the empty name, which would be the folder that the command runs in."""
        if value == "":
            self.fail("the name is empty", *where)
        return super().convert(value, *where)


class Group(click.Group):
    """Commands by name; for an unknown name, the nearest one is suggested."""

    what = "command"

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find a command by name; for an unknown name, suggest the nearest one."""
        names = self.list_commands(ctx)
        if args and args[0] not in names and not args[0].startswith("-"):
            from sinstool.core.suggest import nearest

            hint = nearest(args[0], names) or f"there are {', '.join(names)}"
            raise click.UsageError(f"there is no {self.what} '{args[0]}': {hint}", ctx)
        return super().resolve_command(ctx, args)


@contextmanager
def progress_bar(label: str, quiet: bool) -> Iterator[Callable[[float], None] | None]:
    """A progress bar on stderr, on a terminal only.

    Parameters
    ----------
    quiet : bool
        Show no bar.

    Yields
    ------
    callable or None
        Takes the fraction done, from 0 to 1; None without a bar.
    """
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich import progress
    from rich.console import Console

    with progress.Progress(
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.TaskProgressColumn(),
        progress.TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    ) as bar:
        name = shortened(label)
        task = bar.add_task(name, total=1.0)

        def show_compiling(busy: bool) -> None:
            bar.update(task, description=f"{name}: {COMPILING}" if busy else name)

        with watched(show_compiling):
            yield lambda fraction: bar.update(task, completed=fraction)


def shortened(name: str) -> str:
    """A name with its middle left out, where it is too long for a label."""
    name, most = one_line(name), LONGEST_LABEL
    if len(name) <= most:
        return name
    head = (most - 1) // 2
    return f"{name[:head]}…{name[head + 1 - most :]}"


def print_json(value: Any) -> None:
    """One JSON object on stdout; NaN and infinity become null, as JSON has none."""
    click.echo(json.dumps(plain(value), indent=2, allow_nan=False))


def plain(value: Any) -> Any:
    """A value that JSON can hold: NaN and infinity become None."""
    if isinstance(value, dict):
        return {key: plain(v) for key, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if (isinstance(value, float) and value != value) or value in (float("inf"), float("-inf")):
        return None
    return value


def warn(text: str, colour: str = "yellow") -> None:
    """A warning on stderr, coloured on a terminal."""
    click.echo(f"{click.style('warning:', fg=colour, bold=True)} {one_line(text)}", err=True)


class _Shown(logging.Handler):
    """Prints each choice once for each log, although several passes may make it again."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self._printed: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        """Print a line on the current sys.stderr, which a progress bar may have replaced."""
        text = record.getMessage()
        if text.startswith("log: "):
            self._printed.clear()
        if text not in self._printed:
            self._printed.add(text)
            click.echo(f"- {one_line(text)}", err=True)


def verbose_option(also: str = "") -> Callable[[F], F]:
    """Decorator: the option ``-v``, passed to the command as ``verbose``, its number of uses.

    Parameters
    ----------
    also : str
        What else the command shows with it, for the help.
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
        help=f"show what is chosen and why{more}; -vv: tracebacks",
    )
