"""Words of which one is wanted: options' values and commands, with the nearest one suggested."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import click


class Choice(click.Choice):
    """One of a few words."""

    def get_invalid_choice_message(self, value: Any, *_: Any, **__: Any) -> str:
        """Say what there is, and what may have been meant."""
        from sinstool.core.suggest import nearest

        text = f"'{value}' is not one of {', '.join(map(str, self.choices))}"
        near = nearest(str(value), map(str, self.choices))
        return f"{text}; {near}" if near else text


class Group(click.Group):
    """Commands, of which the nearest is suggested where there is none of a name."""

    what = "command"

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command that is meant, or say which may be."""
        names = self.list_commands(ctx)
        if args and args[0] not in names and not args[0].startswith("-"):
            hint = _hint(args[0], names)
            raise click.UsageError(f"there is no {self.what} '{args[0]}': {hint}", ctx)
        return super().resolve_command(ctx, args)


def _hint(word: str, names: Iterable[str]) -> str:
    from sinstool.core.suggest import nearest

    return nearest(word, names) or f"there are {', '.join(names)}"
