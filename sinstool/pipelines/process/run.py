"""A run of `process` from log to solution, readable from top to bottom.

`process` opens the log, surveys it, makes the plan, has it carried out by the mode that it names,
and returns the result. The output appears when all of it is written.
"""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import cast

from sinstool.config import ProcessConfig
from sinstool.core.choices import log_choice
from sinstool.core.errors import AlignmentError, in_log
from sinstool.core.progress import Progress, share
from sinstool.io.readers import open_log
from sinstool.pipelines.log_used import ImuTime, Lost
from sinstool.pipelines.plan import Plan
from sinstool.pipelines.planning import as_planned, make_plan
from sinstool.pipelines.process.mode import Mode
from sinstool.pipelines.process.output import Output
from sinstool.pipelines.process.result import ProcessResult
from sinstool.pipelines.process.summary import FinalState, Sink
from sinstool.survey.antenna import with_antenna
from sinstool.survey.source import Source, prepare

# What a mode needs is imported when it runs: together it takes longer to import than most logs to
# process.
MODES = {
    "attitude": "sinstool.pipelines.process.attitude:AttitudeMode",
    "ins": "sinstool.pipelines.process.ins:InsMode",
    "ins-gnss": "sinstool.pipelines.process.ins_gnss.run:FilterRun",
}


def process(
    path: Path,
    output: Path | None,
    config: ProcessConfig,
    progress: Progress | None = None,
    sink: Sink | None = None,
) -> ProcessResult:
    """Process a recorded IMU to attitude and navigation.

    Parameters
    ----------
    path : Path
        The log.
    output : Path or None
        MCAP to write, which appears when it is complete; None to write no file.
    progress : callable, optional
        Called with the fraction done.
    sink : Sink, optional
        Gets all that is computed, for figures.

    Raises
    ------
    SinstoolError
        With one line that says what was wrong and what to do; no output is left behind.
    """
    with (
        in_log(path),
        open_log(path, config.input.salvage) as log,
        Output(log, output, config, sink) as written,
    ):
        log.references = frozenset(config.output.truth)
        log_choice("log", f"{path}, {log.format}, {log.size / 1e6:.1f} MB")
        if config.hse.hse is not None:
            from sinstool.pipelines.process.turntable import process_turntable

            result = process_turntable(log, config, written, share(progress, log.size, 0.0, 1.0))
        else:
            source = prepare(log, config, share(progress, log.size, 0.0))
            plan = make_plan(source, config)
            result = _carry_out(source, plan, config, written, progress)
    if progress:
        progress(1.0)
    return result


def plan_of(path: Path, config: ProcessConfig, progress: Progress | None = None) -> Plan:
    """The plan of `process` for a log.

    Raises
    ------
    SinstoolError
        It would refuse the log: with the reason and what to do.
    """
    with in_log(path), open_log(path, config.input.salvage) as log:
        log.references = frozenset(config.output.truth)
        if config.hse.hse is not None:
            from sinstool.pipelines.process.turntable import plan_turntable

            return plan_turntable(log, config)
        source = prepare(log, config, share(progress, log.size, 0.0, 1.0))
        return make_plan(source, config)


def _carry_out(
    source: Source, plan: Plan, config: ProcessConfig, written: Output, progress: Progress | None
) -> ProcessResult:
    """Write the solutions of the mode that the plan names."""
    config = with_antenna(as_planned(config, plan.gyro_samples.value), source.antenna_b)
    module, _, name = MODES[plan.mode.value].partition(":")
    mode = cast(Mode, getattr(import_module(module), name)(source, config, plan))
    computing = share(progress, source.log.size, 0.5)
    mode.find_out(computing)
    left_out = written.open(
        source.encoding, mode.emits, mode.frames, source.tf_parent, mode.diagnostic_names
    )
    sink = written.sink
    if sink is not None:
        mode.show(sink)
    for solution in mode.solutions(computing):
        written.push(solution)
        for diagnostics in mode.new_diagnostics():
            written.note(diagnostics)
    if written.last is None:
        raise AlignmentError(
            f"{source.path}: not one IMU sample lies after the run's start",
            "check --start and --end, and the clocks of IMU and GNSS",
        )
    outcome = mode.conclude(written.last, sink)
    written.complete()
    lost = Lost.of(source)
    # A finding of the run includes that of the survey of the same kind and topic
    said = {(finding.kind, finding.topic) for finding in outcome.findings}
    survey = (f for f in source.findings if (f.kind, f.topic) not in said)
    findings = (*survey, *plan.findings, *left_out, *outcome.findings, *lost.findings())
    input_file, output_file = written.finish(findings)
    return ProcessResult(
        input=input_file,
        output=output_file,
        plan=plan,
        imu=ImuTime.of(source),
        travel=written.odometer.travel(),
        final=FinalState.of(written.last, output_file.origin is not None),
        lost=lost,
        **vars(replace(outcome, findings=findings)),
    )
