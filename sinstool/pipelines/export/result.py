"""Result of an export: the values of ``--json`` and of the terminal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sinstool.core.finding import Finding
from sinstool.core.result import Result
from sinstool.io.readers.lost import LogLosses


@dataclass(frozen=True)
class ExportedFrom:
    """The exported result: its rows, and the frame of its attitudes ('' if unknown)."""

    path: str
    rows: int
    first_ns: int
    last_ns: int
    frame: str


@dataclass(frozen=True)
class ExportedFile:
    """The written file: its rows and columns."""

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
    rate_hz : float or None
        Rows per second at most; None where every row was taken.
    position : bool
        Whether the result has positions.
    geoid_height_m : float or None
        Subtracted from heights.
    lost : LogLosses or None
        What could not be read of the result; None where it was in memory.
    """

    SCHEMA: ClassVar[str] = "sinstool.export/1"
    input: ExportedFrom
    output: ExportedFile
    rate_hz: float | None
    position: bool
    geoid_height_m: float | None
    lost: LogLosses | None
    findings: tuple[Finding, ...]
