"""What a run of `process` comes to: the values of ``--json``, the terminal and the page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sinstool.core.finding import Finding, Severity, exit_status
from sinstool.core.result import as_json
from sinstool.pipelines.plan import Plan
from sinstool.pipelines.process import summary
from sinstool.pipelines.process.errors_against_truth import RunErrors

SCHEMA = "sinstool.process/1"


@dataclass(frozen=True, kw_only=True)
class ProcessResult:
    """A run of `process`.

    Attributes
    ----------
    findings : tuple of Finding
        All that a user should know of the log and of the run.
    truth : RunErrors or None
        Errors against a reference, where one was given.
    """

    input: summary.InputFile
    output: summary.OutputFile
    plan: Plan
    imu: summary.ImuTime
    alignment: summary.FirstAttitude
    coning: summary.ConingUsed | None = None
    hse: summary.HseCorrection | None = None
    height: summary.HeightDamping | None = None
    filter: summary.FilterUsed | None = None
    gnss_difference: summary.GnssDifference | None = None
    final: summary.FinalState
    lost: summary.Lost
    findings: tuple[Finding, ...]
    truth: RunErrors | None = None

    @property
    def exit_status(self) -> int:
        """0, or 3 where something was lost or withheld."""
        return exit_status(self.findings)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings that a user has to be told, in words."""
        return tuple(str(f) for f in self.findings if f.severity > Severity.NOTE)

    def to_json(self) -> dict[str, Any]:
        """The values of ``--json``."""
        values: dict[str, Any] = as_json(self)
        if self.truth is None:
            del values["truth"]
        if self.gnss_difference is None:
            del values["gnss_difference"]
        return {"schema": SCHEMA, **values, "warnings": list(self.warnings)}
