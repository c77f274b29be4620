"""Options generated from the configuration models, the same as the TOML keys."""

from __future__ import annotations

import types
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin

import click
from pydantic.fields import FieldInfo

from sinstool.cli.complete import completion
from sinstool.cli.console import Choice, PathName
from sinstool.cli.help import Option
from sinstool.config import ProcessConfig, load
from sinstool.core.options import Group

F = TypeVar("F", bound=Callable[..., Any])
G = TypeVar("G", bound=Group)


class Numbers(click.ParamType):
    """Comma-separated numbers, or one of a few words.

    Parameters
    ----------
    count : int, optional
        How many numbers; by default any.
    words : tuple of str, optional
        Words that are allowed instead of numbers.
    kind : type, optional
        int or float.
    """

    name = "numbers"

    def __init__(
        self, count: int | None = None, words: tuple[str, ...] = (), kind: type = float
    ) -> None:
        self.count = count
        self.words = words
        self.kind = kind

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[Any, ...] | str:
        """Parse the text of an option."""
        if not isinstance(value, str) or value in self.words:
            return value
        try:
            numbers = tuple(self.kind(part) for part in value.split(","))
        except ValueError:
            numbers = ()
        if not numbers or self.count not in (None, len(numbers)):
            words = f" or one of {', '.join(self.words)}" if self.words else ""
            whole = "whole " if self.kind is int else ""
            count = "" if self.count is None else f"{self.count} "
            self.fail(f"'{value}' is not {count}{whole}numbers separated by commas{words}", param)
        return numbers


class Words(click.ParamType):
    """Comma-separated words."""

    name = "words"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        """Split the text of an option."""
        if not isinstance(value, str):
            return tuple(value)
        return tuple(part.strip() for part in value.split(",") if part.strip())


def path_option(*names: str, text: str, metavar: str | None = None) -> Callable[[F], F]:
    """Decorator: an option that names a file or a folder."""
    return click.option(*names, type=PathName(), metavar=metavar, help=text)


def config_options(*paths: str, model: type[Group] = ProcessConfig) -> Callable[[F], F]:
    """Decorator: options of a configuration, and --config.

    Parameters
    ----------
    *paths : str
        Names of its groups, or of single fields as ``group.name``.
    """

    def decorate(function: F) -> F:
        for group, name, field in reversed(list(model.options(*paths))):
            function = _option(group, name, field, model.title_of(group))(function)
        text = "TOML file with options; the command line wins"
        return path_option("--config", "config_file", metavar="FILE", text=text)(function)

    return decorate


def _option(group: str, name: str, field: FieldInfo, section: str) -> Callable[[F], F]:
    flag = "--" + name.replace("_", "-")
    key = f"{group}__{name}"
    extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
    text, brief = field.description or "", extra.get("brief")
    default = field.default
    if field.annotation is bool:
        flags = f"{flag}/--no-{flag[2:]}" if default else flag
        return click.option(
            flags,
            key,
            cls=Option,
            section=section,
            brief=brief,
            is_flag=True,
            default=None,
            help=text,
        )
    if default not in (None, ()):
        shown = ",".join(map(str, default)) if isinstance(default, tuple) else str(default)
        text += f" [default: {shown}]"
    kind = _click_type(field.annotation)
    return click.option(
        flag,
        key,
        cls=Option,
        section=section,
        brief=brief,
        type=kind,
        multiple=isinstance(kind, Words),
        default=None,
        metavar=extra.get("metavar"),
        help=text,
        shell_complete=completion(name),
    )


def _click_type(annotation: Any) -> click.ParamType:
    options = [annotation]
    if get_origin(annotation) in (Union, types.UnionType):
        options = [a for a in get_args(annotation) if a is not type(None)]
    words = tuple(w for a in options if get_origin(a) is Literal for w in get_args(a))
    for tuple_of in (get_args(a) for a in options if get_origin(a) is tuple):
        if tuple_of[-1] is not Ellipsis:
            return Numbers(len(tuple_of), words)
        kind = getattr(tuple_of[0], "__origin__", tuple_of[0])  # of Annotated
        return Words() if kind is str else Numbers(kind=kind)
    if words:
        return Choice(words)
    if float in options:
        return click.FLOAT
    return click.INT if int in options else click.STRING


def effective_config(
    config_file: Path | None, flags: Mapping[str, Any], check: bool = True
) -> ProcessConfig:
    """Defaults, overlaid by the file, overlaid by flags.

    Parameters
    ----------
    flags : mapping
        Keyword arguments of a command; those named ``group__name`` are options.
    check : bool, optional
        Check also that the options go together.

    Raises
    ------
    ConfigurationError
    """
    return effective(ProcessConfig, config_file, flags, check)


def effective(
    model: type[G], config_file: Path | None, flags: Mapping[str, Any], check: bool = True
) -> G:
    """As :func:`effective_config`, for any model."""
    by_table = {}
    for key, value in flags.items():
        group, separator, name = key.partition("__")
        if separator and value is not None and value != ():
            by_table[group, name] = _flat(value)
    return load.effective(model, config_file, by_table, check)


def _flat(value: Any) -> Any:
    """The words of an option that was given several times, as one tuple."""
    if isinstance(value, tuple) and value and isinstance(value[0], tuple):
        return tuple(word for words in value for word in words)
    return value


def print_config(config: Group, *paths: str) -> None:
    """Print options of the effective configuration as TOML that --config reads."""
    from sinstool.config.commented import commented_toml

    click.echo(commented_toml(config, *paths), nl=False)
