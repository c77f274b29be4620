"""Results of commands: their warnings."""

from dataclasses import dataclass
from typing import ClassVar

from sinstool.core.finding import Finding, Severity
from sinstool.core.result import Result


@dataclass(frozen=True)
class Found(Result):
    SCHEMA: ClassVar[str] = "test"
    findings: tuple[Finding, ...]


def test_the_gravest_warnings_come_first():
    """On a page what makes a result untrustworthy stood below what is usual."""
    found = Found(
        (
            Finding("a", "usual"),
            Finding("b", "worth knowing", Severity.NOTE),
            Finding("c", "do not trust it", Severity.LOST),
            Finding("d", "usual too"),
        )
    )
    assert found.warnings == ("do not trust it", "usual", "usual too")
