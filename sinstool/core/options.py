"""Options as models: one field defines a flag, its help, its range and a key of a file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic.fields import FieldInfo


def option(
    default: Any,
    text: str,
    metavar: str | None = None,
    *,
    brief: str | None = None,
    **limits: float,
) -> Any:
    """A field with its command-line attributes.

    Parameters
    ----------
    text : str
        The option's help.
    metavar : str, optional
        Placeholder for its value in the help: a unit, or a form.
    brief : str, optional
        One line for ``--help``, which shows the options that matter most; those without it are
        shown by ``--help-all`` only.
    **limits : float
        Bounds ``ge``, ``gt``, ``le`` and ``lt`` of the value.
    """
    extra = {"metavar": metavar, "brief": brief}
    return Field(default, description=text, json_schema_extra=extra, **limits)  # type: ignore[call-overload]


class Group(BaseModel):
    """Options that belong together: a table of the configuration file."""

    title: ClassVar[str] = ""
    """Heading of its options in help and documentation."""

    # strict: no words for numbers, and no numbers for booleans
    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True
    )

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, data: Any) -> Any:
        """Convert the lists of TOML to the tuples that strict models need."""
        return {k: _tuple(v) for k, v in data.items()} if isinstance(data, dict) else data

    def check(self) -> None:
        """Check that the options go together.

        Raises
        ------
        ConfigurationError
            If they do not.
        """

    @classmethod
    def options(cls, *paths: str) -> Iterator[tuple[str, str, FieldInfo]]:
        """Fields of some of its tables, as (table, name, field).

        Parameters
        ----------
        *paths : str
            Names of tables, or of single fields as ``table.name``.
        """
        for path in paths:
            table, _, single = path.partition(".")
            model = cls.model_fields[table].annotation
            assert isinstance(model, type) and issubclass(model, Group)
            for name, field in model.model_fields.items():
                if single in ("", name):
                    yield table, name, field

    @classmethod
    def title_of(cls, table: str) -> str:
        """Heading of the options of one of its tables."""
        model = cls.model_fields[table].annotation
        assert isinstance(model, type) and issubclass(model, Group)
        return model.title


def _tuple(value: Any) -> Any:
    return tuple(map(_tuple, value)) if isinstance(value, list) else value


def span(text: str) -> tuple[float, float]:
    """The two times of a span START:END, s.

    Raises
    ------
    ValueError
        If the text is not such a span, or does not end after it starts.
    """
    start, separator, end = text.partition(":")
    try:
        begin, stop = float(start), float(end)
    except ValueError:
        separator = ""
        begin = stop = 0.0
    if not separator or not begin < stop:
        raise ValueError(f"'{text}' is not START:END in seconds")
    return begin, stop
