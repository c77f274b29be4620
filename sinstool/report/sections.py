"""The contents of a page."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from sinstool.report.figure import Figure

T = TypeVar("T")


@dataclass(frozen=True)
class Link:
    """Text that leads to another file.

    Attributes
    ----------
    target : str
        Relative to the page, with ``/``.
    """

    text: str
    target: str


Cell = str | float | int | bool | Link | None


@dataclass(frozen=True)
class Fact:
    """One number of those that answer the reader's question, or a word.

    Attributes
    ----------
    value : str
        With its unit.
    note : str
        What qualifies it, such as its sigma; empty for none.
    """

    name: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class Prose:
    """Paragraphs, and the key figures below them.

    Attributes
    ----------
    title : str
        Heading; empty for none.
    """

    paragraphs: tuple[str, ...]
    title: str = ""
    facts: tuple[Fact, ...] = ()


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Attributes
    ----------
    unit : str
        Empty for none.
    form : str or callable
        Format specification of its numbers that are not whole, or what writes them.
    """

    name: str
    unit: str = ""
    form: str | Callable[[float], str] = ".4g"


@dataclass(frozen=True)
class Table:
    """One table; the first cell of each row names the row.

    Attributes
    ----------
    rows : tuple of tuples
        Each as long as `columns`. None and NaN are shown as a dash.
    notes : tuple of str
        Sentences for below the table.
    folded : bool
        The reader has to unfold it, as it is long.
    """

    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()
    folded: bool = False

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(
                    f"{self.title}: a row has {len(row)} cells for {len(self.columns)} columns."
                )


def table_of(
    title: str,
    items: Iterable[T],
    columns: Sequence[tuple[Column, Callable[[T], Cell]]],
    notes: tuple[str, ...] = (),
    folded: bool = False,
) -> Table:
    """A table with a row for each item.

    Parameters
    ----------
    columns : sequence of (Column, callable)
        Each with what takes its cell from an item.
    """
    rows = tuple(tuple(cell(item) for _, cell in columns) for item in items)
    return Table(title, tuple(column for column, _ in columns), rows, notes, folded)


@dataclass(frozen=True)
class Rows:
    """Pairs of label and text."""

    title: str
    pairs: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Setting:
    """One setting of a run.

    Attributes
    ----------
    name : str
        As the configuration file or the command line has it.
    value : object
        None where the run chooses for itself.
    changed : bool
        It is not the default.
    meaning : str
        What it is, with its unit.
    """

    name: str
    value: object
    changed: bool = True
    meaning: str = ""


@dataclass(frozen=True)
class Settings:
    """Settings of the run: changed ones first, defaults folded."""

    items: tuple[Setting, ...]
    title: str = "Settings"


Section = Prose | Table | Rows | Settings | Figure


@dataclass(frozen=True)
class Page:
    """Content of a page.

    Attributes
    ----------
    subtitle : str
        What it is about, such as the log's name; empty for none.
    sections : tuple of sections
        In the order of the page.
    warnings : tuple of str
        What the reader must know first, above the sections; each is shown once.
    """

    title: str
    subtitle: str = ""
    sections: tuple[Section, ...] = ()
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        keys = [one.key for one in self.figures]
        if len(set(keys)) != len(keys):
            raise ValueError(f"{self.title}: two figures have one key.")

    @property
    def figures(self) -> tuple[Figure, ...]:
        """The figures, in order."""
        return tuple(one for one in self.sections if isinstance(one, Figure))
