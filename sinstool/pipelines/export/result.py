"""Result of an export: the values of ``--json`` and of the terminal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sinstool.core.finding import Finding
from sinstool.core.result import Result
from sinstool.io.readers.lost import LogLosses


@dataclass(frozen=True)
class ExportedFrom:
    """The exported result.

    Attributes
    ----------
    path : str
        Of the result.
    rows : int
        Number of attitudes.
    first_ns, last_ns : int
        Times of the first and last.
    frame : str
        Frame of the attitudes; '' if unknown.
    """

    path: str
    rows: int
    first_ns: int
    last_ns: int
    frame: str


@dataclass(frozen=True)
class ExportedFile:
    """The written file.

    Attributes
    ----------
    path : str
        Of the file.
    format : str
        Its suffix.
    rows : int
        Number of rows.
    first_ns, last_ns : int
        Times of the first and last.
    columns : tuple of str
        Their names.
    """

    path: str
    format: str
    rows: int
    first_ns: int
    last_ns: int
    columns: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class ExportResult(Result):
    """A run of `export`.

    Attributes
    ----------
    input : ExportedFrom
        The result of `process`.
    output : ExportedFile
        The file.
    rate_hz : float or None
        Largest number of rows per second; None if every row was exported.
    position : bool
        Whether the result has positions.
    geoid_height_m : float or None
        Subtracted from heights.
    lost : LogLosses or None
        What could not be read of the result; None for a result in memory.
    findings : tuple of Finding
        About the result.
    """

    SCHEMA: ClassVar[str] = "sinstool.export/1"
    input: ExportedFrom
    output: ExportedFile
    rate_hz: float | None
    position: bool
    geoid_height_m: float | None
    lost: LogLosses | None
    findings: tuple[Finding, ...]
