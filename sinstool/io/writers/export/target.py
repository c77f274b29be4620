"""The input of every exported file, and the interface of its writer."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import BinaryIO

from sinstool.io.readers.results import ResultBlock


@dataclass(frozen=True)
class Described:
    """Description of an exported file, written into it.

    Attributes
    ----------
    name : str
        Name of the result.
    reference : str
        Frame id of its attitudes; '' if it is unknown.
    first_ns : int
        Time from which seconds are counted: the result's first.
    geoid_height : float or None
        Height of the geoid above the ellipsoid, m, for formats with heights above the geoid.
    """

    name: str
    reference: str
    first_ns: int
    geoid_height: float | None = None


class Writer(ABC):
    """Writes blocks of a result to a stream, in the order of time.

    Parameters
    ----------
    stream : binary file
        Open for writing.

    Attributes
    ----------
    columns : tuple of str
        Names of the columns, for formats that have them; known after the first block.
    """

    needs_position = False
    """Whether the format consists of latitudes and longitudes."""

    def __init__(self, stream: BinaryIO, about: Described) -> None:
        self.stream = stream
        self.about = about
        self.columns: tuple[str, ...] = ()

    @abstractmethod
    def push(self, block: ResultBlock) -> None:
        """Write the rows of a block, at least one."""

    def finish(self) -> None:  # noqa: B027 - not every format has an end
        """Write the end of the file, after the last row."""
