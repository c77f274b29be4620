"""Result of `process`: the values of ``--json``, the terminal and the page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from sinstool.core.finding import Finding
from sinstool.core.result import Result
from sinstool.pipelines.log_used import ImuTime, Lost
from sinstool.pipelines.plan import Plan
from sinstool.pipelines.process import summary
from sinstool.pipelines.process.travel import Travel

if TYPE_CHECKING:
    from sinstool.pipelines.process.errors_against_truth import RunErrors


@dataclass(frozen=True, kw_only=True)
class ProcessResult(Result):
    """A run of `process`.

    Attributes
    ----------
    findings : tuple of Finding
        All that a user should know of the log and of the run.
    truth : RunErrors or None
        Errors against a reference, where one was given.
    """

    SCHEMA: ClassVar[str] = "sinstool.process/1"
    OPTIONAL: ClassVar[tuple[str, ...]] = ("truth", "gnss_difference")
    input: summary.InputFile
    output: summary.OutputFile
    plan: Plan
    imu: ImuTime
    alignment: summary.FirstAttitude
    coning: summary.ConingUsed | None = None
    hse: summary.HseCorrection | None = None
    smoothing: summary.AttitudeSmoothing | None = None
    height: summary.HeightDamping | None = None
    filter: summary.FilterUsed | None = None
    gnss_difference: summary.GnssDifference | None = None
    travel: Travel
    final: summary.FinalState
    lost: Lost
    findings: tuple[Finding, ...]
    truth: RunErrors | None = None
