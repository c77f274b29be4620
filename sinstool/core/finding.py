"""A fact about a log or result for the user, in one form from detection to output.

The terminal, ``--json``, the page and the table over many logs all show findings, and their
severity decides how a command ends.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any


class Severity(IntEnum):
    """How serious a finding is."""

    NOTE = 0
    """Worth knowing; nothing is wrong."""
    WARNING = 1
    """The result may be worse for it."""
    LOST = 2
    """Something of the log was lost, or something of the result is withheld."""
    FAILED = 3
    """There is no result."""


_EXIT = {Severity.NOTE: 0, Severity.WARNING: 0, Severity.LOST: 3, Severity.FAILED: 1}


@dataclass(frozen=True)
class Finding:
    """One thing that a user should know.

    Attributes
    ----------
    kind : str
        Short name, stable, for programs and for grouping over many logs.
    text : str
        What was found.
    severity : Severity
        How serious it is.
    answer : str
        What to do, with the option that does it; '' if nothing needs doing.
    topic : str
        The topic concerned; '' for the log as a whole.
    start_ns, end_ns : int or None
        The span of time concerned; None for the whole log.
    numbers : mapping of str to float
        Measured values, by names that contain their units.
    """

    kind: str
    text: str
    severity: Severity = Severity.WARNING
    answer: str = ""
    topic: str = ""
    start_ns: int | None = None
    end_ns: int | None = None
    numbers: Mapping[str, float] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.text}: {self.answer}" if self.answer else self.text

    def to_json(self) -> dict[str, Any]:
        """The values as JSON: times are strings, as everywhere in sinstool's JSON."""
        span = {"start_ns": self.start_ns, "end_ns": self.end_ns}
        return {
            "kind": self.kind,
            "severity": self.severity.name.lower(),
            "text": self.text,
            "answer": self.answer,
            "topic": self.topic,
            **{name: None if time is None else str(time) for name, time in span.items()},
            "numbers": dict(self.numbers),
        }


def exit_status(findings: Iterable[Finding]) -> int:
    """Exit status of a command: 0 done, 3 something lost or withheld, 1 failed."""
    return _EXIT[max((f.severity for f in findings), default=Severity.NOTE)]
