"""Help in two lengths: the options that matter most, and all of them, in named groups."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import click

# A command with more options than this shows the most important ones under --help
FEW = 20
MAIN = "Main options"
# Sections of the options that belong to the command line alone, by the name of the parameter
SECTIONS = {
    "jobs": "Many logs",
    "scheduler": "Many logs",
    "config_file": "Configuration",
    "show": "Configuration",
    "show_plan": "Configuration",
    "as_json": "Messages",
    "quiet": "Messages",
    "verbose": "Messages",
    "_click_default_help": "Messages",
    "help_all": "Messages",
}
LAST = ("Many logs", "Configuration", "Messages")
# Headings of the short help in order, and under which of them the sections of the full help
# appear; sections not listed appear under "Methods"
METHODS = "Methods"
ORDER = (MAIN, "Input", METHODS, "Running")
SHORT = {MAIN: MAIN, "Input": "Input", "Output": MAIN, **dict.fromkeys(LAST, "Running")}


class Option(click.Option):
    """An option that knows its place in the help.

    Parameters
    ----------
    section : str
        Heading it stands under.
    brief : str or None
        Its line in the short help; None: it is in the full help only.
    """

    def __init__(
        self, *args: Any, section: str = "", brief: str | None = None, **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self.section = section
        self.brief = brief


class Command(click.Command):
    """A command whose ``--help`` fits a screen, with ``--help-all`` for every option.

    Parameters
    ----------
    first : sequence of str
        Parameters that are shown first, in this order.
    """

    def __init__(self, *args: Any, first: Sequence[str] = (), **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.first = tuple(first)
        # Where --help shows every option, --help-all is hidden but works the same
        self.params.append(
            click.Option(
                ["--help-all"],
                is_flag=True,
                is_eager=True,
                expose_value=False,
                hidden=not self.long,
                callback=_show_all,
                help=f"show all {len(self.params) + 2} options",
            )
        )

    @property
    def long(self) -> bool:
        """Whether the help needs a short form: more options than fit a screen."""
        chosen = any(isinstance(o, Option) and o.brief is not None for o in self.params)
        return chosen and sum(p.name != "help_all" for p in self.params) > FEW

    def sections(self, ctx: click.Context) -> dict[str, list[click.Option]]:
        """Its options by heading, in the order in which they are shown."""
        options = [p for p in self.get_params(ctx) if isinstance(p, click.Option)]
        by_name = {option.name: option for option in options}
        main = [by_name[name] for name in self.first]
        sections = {MAIN: main} if main else {}
        for option in options:
            if option in main or option.hidden:
                continue
            section = option.section if isinstance(option, Option) else ""
            section = section or SECTIONS.get(str(option.name), MAIN)
            sections.setdefault(section, []).append(option)
        for name in LAST:
            if name in sections:
                sections[name] = sections.pop(name)
        return sections

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the epilog, in the full help only."""
        if ctx.meta.get(_ALL) or not self.long:
            super().format_epilog(ctx, formatter)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options in their groups; without --help-all those that matter most."""
        everything = bool(ctx.meta.get(_ALL)) or not self.long
        rows: dict[str, list[tuple[str, str]]] = {} if everything else {h: [] for h in ORDER}
        for title, options in self.sections(ctx).items():
            heading = title if everything else SHORT.get(title, METHODS)
            shown = [row for o in options if (row := _row(o, ctx, everything)) is not None]
            rows.setdefault(heading, []).extend(shown)
        for heading in rows:
            if rows[heading]:
                with formatter.section(heading):
                    formatter.write_dl(rows[heading])


_ALL = "sinstool.help_all"


def _row(option: click.Option, ctx: click.Context, everything: bool) -> tuple[str, str] | None:
    row = option.get_help_record(ctx)
    if row is None or everything or not isinstance(option, Option) or not option.section:
        return row
    if option.brief is None:
        return None
    # The words to choose from are in the text
    words = isinstance(option.type, click.Choice) and option.metavar is None
    name = f"{option.opts[0]} {option.opts[0].split('-')[-1].upper()}" if words else row[0]
    return name, option.brief


def _show_all(ctx: click.Context, _: click.Parameter, value: bool) -> None:
    """Print the full help and end."""
    if value and not ctx.resilient_parsing:
        ctx.meta[_ALL] = True
        click.echo(ctx.get_help(), color=ctx.color)
        ctx.exit()
