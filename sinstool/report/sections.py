"""What a page holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from sinstool.figures import Figure

Cell = str | float | int | bool | None


@dataclass(frozen=True)
class Prose:
    """Paragraphs.

    Attributes
    ----------
    paragraphs : tuple of str
    title : str
        Heading; empty for none.
    """

    paragraphs: tuple[str, ...]
    title: str = ""


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Attributes
    ----------
    name : str
    unit : str
        Empty for none.
    form : str
        Format specification of its numbers that are not whole.
    """

    name: str
    unit: str = ""
    form: str = ".4g"


@dataclass(frozen=True)
class Table:
    """One table; the first cell of each row names the row.

    Attributes
    ----------
    title : str
    columns : tuple of Column
    rows : tuple of tuples
        Each as long as `columns`. None and NaN are shown as a dash.
    notes : tuple of str
        Sentences for below the table.
    """

    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(
                    f"{self.title}: a row has {len(row)} cells for {len(self.columns)} columns."
                )


@dataclass(frozen=True)
class Warnings:
    """What the reader must know first: shown at the top wherever it stands.

    Attributes
    ----------
    messages : tuple of str
        None of them: nothing is shown.
    """

    messages: tuple[str, ...]


@dataclass(frozen=True)
class Settings:
    """What was done, and with which settings.

    Attributes
    ----------
    items : mapping
        Name to value. A mapping in it is taken apart, its names joined by dots.
    title : str
    """

    items: Mapping[str, object]
    title: str = "Settings"


Body = Prose | Table | Settings | Figure
Section = Body | Warnings


@dataclass(frozen=True)
class Page:
    """All that a page shows.

    Attributes
    ----------
    title : str
    subtitle : str
        What it is about, such as the log's name; empty for none.
    sections : tuple of sections
        In the order of the page, except that warnings come first.
    """

    title: str
    subtitle: str = ""
    sections: tuple[Section, ...] = field(default=())

    def __post_init__(self) -> None:
        keys = [one.key for one in self.figures]
        if len(set(keys)) != len(keys):
            raise ValueError(f"{self.title}: two figures have one key.")

    @property
    def figures(self) -> tuple[Figure, ...]:
        """The figures, in order."""
        return tuple(one for one in self.sections if isinstance(one, Figure))

    @property
    def warnings(self) -> tuple[str, ...]:
        """All warnings, in order, each once."""
        found = (one.messages for one in self.sections if isinstance(one, Warnings))
        return tuple(dict.fromkeys(message for messages in found for message in messages))
