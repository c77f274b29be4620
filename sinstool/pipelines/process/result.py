"""Result of `process`: the values of ``--json``, the terminal and the page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from sinstool.core.finding import Finding
from sinstool.core.result import Result
from sinstool.pipelines.log_used import ImuTime, Lost
from sinstool.pipelines.plan import Plan
from sinstool.pipelines.process import filter_used, height_used, hse_used, summary
from sinstool.pipelines.process.travel import Travel

if TYPE_CHECKING:
    from sinstool.pipelines.process.errors_against_truth import RunErrors


@dataclass(frozen=True, kw_only=True)
class ProcessResult(Result):
    """A run of `process`.

    Attributes
    ----------
    input : InputFile
        The log.
    output : OutputFile
        What was written.
    plan : Plan
        Choices, each with its reason.
    imu : ImuTime
        Samples of the IMU.
    alignment : FirstAttitude
        The first attitude.
    coning : ConingUsed or None
        None on a turntable.
    hse : HseCorrection or None
        Heading-sensitive error; None if the log is not of a turntable.
    smoothing : AttitudeSmoothing or None
        None if the attitude was not smoothed by gravity.
    height : HeightDamping or None
        None without damping of the height.
    filter : FilterUsed or None
        None but in mode ``ins-gnss``.
    gnss_difference : GnssDifference or None
        Of mode ``ins``, from the last fix; left out without fixes.
    travel : Travel
        Duration, distance, accuracy.
    final : FinalState
        The end of the solution.
    lost : Lost
        What could not be read.
    findings : tuple of Finding
        All that a user should know about the log and the run.
    truth : RunErrors or None
        Errors against ``--truth``; left out without it.
    """

    SCHEMA: ClassVar[str] = "sinstool.process/1"
    OPTIONAL: ClassVar[tuple[str, ...]] = ("truth", "gnss_difference")
    input: summary.InputFile
    output: summary.OutputFile
    plan: Plan
    imu: ImuTime
    alignment: summary.FirstAttitude
    coning: summary.ConingUsed | None = None
    hse: hse_used.HseCorrection | None = None
    smoothing: summary.AttitudeSmoothing | None = None
    height: height_used.HeightDamping | None = None
    filter: filter_used.FilterUsed | None = None
    gnss_difference: summary.GnssDifference | None = None
    travel: Travel
    final: summary.FinalState
    lost: Lost
    findings: tuple[Finding, ...]
    truth: RunErrors | None = None
