"""Calibration of heading-sensitive error: from a rig's logs to a calibration file.

`calibrate` reads every log, finds its stretches at constant rate, aligns on each, fits, judges,
and writes the calibration; what it returns is what a summary and a page need.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from sinstool.campaign.jobs import Job, Workers
from sinstool.campaign.run import results
from sinstool.config import CalibrationOptions, ProcessConfig
from sinstool.core import version
from sinstool.core.arrays import FloatArray
from sinstool.core.choices import log_choice
from sinstool.core.english import counted, counted_clause
from sinstool.core.errors import AlignmentError, ConfigurationError, SinstoolError
from sinstool.core.finding import Finding, Severity
from sinstool.core.progress import Progress, share
from sinstool.core.rotation import wrapped
from sinstool.core.units import DEGREE
from sinstool.core.whole_file import check_output, write_whole
from sinstool.io.readers import open_log
from sinstool.io.readers.log import path_size
from sinstool.io.readers.lost import Lost
from sinstool.methods.hse.calibration import (
    CorrectedHeading,
    HseCalibration,
    correct_heading,
    from_fit,
)
from sinstool.methods.hse.fit import fit
from sinstool.methods.hse.fit_result import FitOptions, HseFit
from sinstool.methods.hse.rig import Rig, from_table
from sinstool.methods.hse.run import RATE_GAP, HseRun
from sinstool.methods.hse.segments import CHANGING, SegmentRules
from sinstool.methods.hse.statistics import ValidationTable, validation_table
from sinstool.methods.hse.status import judge
from sinstool.methods.hse.whole_turn import WholeTurnAlignment, run_from_turns
from sinstool.pipelines.calibrate_hse.calibration_file import dumps
from sinstool.pipelines.calibrate_hse.result import Calibration, PositionSpread
from sinstool.survey.rig import (
    RigTurns,
    angles_at_stamps,
    denied_angles,
    find_turns,
    nothing_to_use,
    read_rig_log,
)


def rig_of(config: ProcessConfig) -> Rig:
    """The rig that a configuration describes.

    Raises
    ------
    ConfigurationError
        It describes none.
    """
    if config.rig is None:
        raise ConfigurationError("no rig is described", "give a table [rig] with --config RIG.toml")
    return from_table(config.rig)


def segment_rules(options: CalibrationOptions) -> SegmentRules:
    """Requirements on a stretch to align on, from the configuration."""
    return SegmentRules(
        settle_s=options.settle,
        min_turns=options.min_turns,
        min_duration_s=options.min_duration,
        align_duration_s=options.align_duration,
        skip_warmup_s=options.skip_warmup,
    )


def calibrate(
    paths: Sequence[Path],
    output: Path | None,
    config: ProcessConfig,
    progress: Progress | None = None,
    workers: Workers | None = None,
) -> Calibration:
    """Calibrate a rig's heading-sensitive error from its logs.

    Parameters
    ----------
    output : Path or None
        JSON file to write; None to write none.
    config : ProcessConfig
        With a rig.
    progress : callable, optional
        Called with the fraction done.
    workers : Workers, optional
        Who reads the logs; by default this process, one after the other.

    Returns
    -------
    Calibration
        Whatever its status is: one that must not be applied says so itself.

    Raises
    ------
    SinstoolError
        A log cannot be read, or not one of them has a stretch to align on.
    """
    rig = rig_of(config)
    if output is not None:
        check_output(output, list(paths), config.output.overwrite)
    options = config.calibration
    logs, findings = read_logs(paths, rig, config, progress, workers)
    stand = azimuths(options, [log.source for log in logs])
    runs = align_runs(logs, rig, options)
    unknown = sorted(set(options.exclude) - {run.id for run in runs})
    if unknown:
        raise ConfigurationError(
            f"--exclude {unknown[0]}: there is no such run",
            f"runs are {', '.join(run.id for run in runs[:12])}{' ...' * (len(runs) > 12)}",
        )
    result = fit(runs, fit_options(options))
    stretches = counted_clause(len(runs), "stretch", "has", "have")
    log_choice("runs", f"{stretches} whole turns, in {counted(len(logs), 'log')}")
    log_choice("method", _method_why(options.method, result.method, len(runs)))
    judged = judge(result)
    created = datetime.now(UTC).isoformat(timespec="seconds")
    tool = f"sinstool {version.VERSION}"
    file = from_fit(result, judged, created, tool, rig.sha256())
    table, spread = _headings(runs, result, file, stand)
    if output is not None:
        write_whole(output, dumps(file))
    remarks = (Finding("rig", text) for text in rig.remarks())
    return Calibration(
        rig,
        tuple(logs),
        tuple(runs),
        result,
        file,
        table,
        spread,
        (*remarks, *findings, *unused_rates(logs), *judged.findings),
    )


def unused_rates(logs: Sequence[RigTurns]) -> Iterator[Finding]:
    """A warning of rates at which the table turned, but of which no stretch could be used."""
    used = np.array([s.rate for log in logs for s in log.segmentation.used])
    lost = [
        (log.source, segment)
        for log in logs
        for segment in log.segmentation.rejected
        if segment.turns >= 1.0
        and segment.reason != CHANGING
        and not np.any(np.abs(used - segment.rate) <= RATE_GAP * abs(segment.rate))
    ]
    if not lost:
        return
    rates = sorted({round(segment.rate / DEGREE, 1) for _, segment in lost})
    source, first = lost[0]
    yield Finding(
        "rate-left-out",
        f"the table also turned at {', '.join(f'{rate:g}' for rate in rates)} deg/s, but no run has"
        f" {'this rate' if len(rates) == 1 else 'these rates'}: in {source} at"
        f" {max(first.start_s, 0.0):.1f} s, {first.reason}",
        answer="let the table turn for longer at each rate, or require less: --min-turns,"
        " --min-duration",
        numbers={"stretches": float(len(lost))},
    )


def _method_why(option: str, used: str, runs: int) -> str:
    """Source of the coefficient."""
    if option == used:
        over = "as specified" if option != "joint" else f"over {counted(runs, 'run')}"
        return f"{used}, {over}"
    return f"{used}, as the runs do not determine {option}"


def read_logs(
    paths: Sequence[Path],
    rig: Rig,
    config: ProcessConfig,
    progress: Progress | None,
    workers: Workers | None = None,
) -> tuple[list[RigTurns], list[Finding]]:
    """Turns of every log; a log without any is a finding, unless all are without.

    Raises
    ------
    SinstoolError
    """
    resolved = [path.resolve() for path in paths]
    for path in paths:
        if resolved.count(path.resolve()) > 1:
            raise ConfigurationError(f"{path} is given twice", "give every log once")
    rules = segment_rules(config.calibration)
    logs: list[RigTurns] = []
    findings: list[Finding] = []
    empty: list[SinstoolError] = []
    names = _names(paths)
    arguments = [(path, names[path], rig, config) for path in paths]
    for path, (turns, parts) in zip(paths, _each(arguments, progress, workers), strict=True):
        findings += [Finding("lost-part", f"{path}: lost: {part}", Severity.LOST) for part in parts]
        findings += [replace(one, text=f"{path}: {one.text}") for one in turns.findings]
        if turns.turns:
            logs.append(turns)
        else:
            empty.append(nothing_to_use(turns, path, rules))
    if not logs:
        raise empty[0]
    findings += [
        Finding("log-left-out", f"left out: {error.message}", answer=error.hint) for error in empty
    ]
    return logs, findings


def _names(paths: Sequence[Path]) -> dict[Path, str]:
    """Short names of the logs, with their folders where several are called the same."""
    stems = [p.stem for p in paths]
    return {p: p.stem if stems.count(p.stem) == 1 else str(p.with_suffix("")) for p in paths}


def _each(
    arguments: Sequence[tuple[Path, str, Rig, ProcessConfig]],
    progress: Progress | None,
    workers: Workers | None,
) -> Iterator[tuple[RigTurns, list[Lost]]]:
    """:func:`read_turns` of each log, here or by workers, in the order of the logs."""
    count = len(arguments)
    if workers is None:
        for number, one in enumerate(arguments):
            yield read_turns(*one, _part(progress, number, count))
        return
    jobs = [
        # workers may stand elsewhere
        Job(
            str(path), read_turns, (path.absolute(), *rest), path_size(path) if path.exists() else 0
        )
        for path, *rest in arguments
    ]
    yield from results(jobs, workers, progress)


def read_turns(
    path: Path, name: str, rig: Rig, config: ProcessConfig, progress: Progress | None
) -> tuple[RigTurns, list[Lost]]:
    """Turns of one log, and its losses.

    Raises
    ------
    SinstoolError
    """
    with open_log(path, config.input.salvage) as log:
        samples = read_rig_log(log, rig, config.input, share(progress, log.size, 0.0, 1.0))
        turns = find_turns(samples, rig, segment_rules(config.calibration), name)
        if turns.turns:
            denied = denied_angles(samples, turns, angles_at_stamps(samples, rig, turns))
            turns = replace(turns, findings=(*turns.findings, *denied))
        return turns, list(log.lost)


def _part(progress: Progress | None, number: int, count: int) -> Progress | None:
    if progress is None:
        return None
    return lambda fraction: progress((number + fraction) / count)


def align_runs(logs: Sequence[RigTurns], rig: Rig, options: CalibrationOptions) -> list[HseRun]:
    """Every stretch of every log, aligned.

    Raises
    ------
    AlignmentError, ConfigurationError
        With the name of the log.
    """
    runs = []
    for log in logs:
        for number, turns in enumerate(log.turns, 1):
            name = f"{log.source}#{number}"
            try:
                run = run_from_turns(
                    turns,
                    rig,
                    id=name,
                    source=log.source,
                    log_start_ns=log.start_ns,
                    level_rate=options.level_rate,
                    gyro_bias_sigma=options.gyro_bias_sigma * DEGREE / 3600.0,
                )
            except (AlignmentError, ConfigurationError) as exc:
                raise type(exc)(f"{name}: {exc.message}", exc.hint) from exc
            runs.append(run)
    return runs


def fit_options(options: CalibrationOptions) -> FitOptions:
    """Options as the fit takes them."""
    return FitOptions(
        method=options.method,
        form=options.form,
        weights=options.weights,
        drift=options.drift,
        exclude=options.exclude,
        reject_outliers=not options.keep_outliers,
    )


def azimuths(options: CalibrationOptions, sources: Sequence[str]) -> dict[str, float]:
    """Azimuths of the stand, rad, by log.

    Raises
    ------
    ConfigurationError
        One is not NAME=DEGREES, or of no log.
    """
    azimuth: dict[str, float] = {}
    for text in options.azimuth:
        name, sign, value = text.rpartition("=")
        try:
            degrees = float(value)
        except ValueError:
            degrees = np.nan
        if not sign or not np.isfinite(degrees):
            raise ConfigurationError(f"--azimuth {text}: not NAME=DEGREES")
        if name not in sources:
            raise ConfigurationError(
                f"--azimuth {text}: no log is called {name}", f"logs are {', '.join(sources)}"
            )
        azimuth[name] = float(np.radians(degrees))
    return azimuth


def correct_runs(
    runs: Sequence[HseRun] | Sequence[WholeTurnAlignment], calibration: HseCalibration
) -> CorrectedHeading:
    """Headings of stretches at constant rate, corrected for heading-sensitive error."""

    def column(name: str) -> FloatArray:
        return np.array([getattr(run, name) for run in runs])

    return correct_heading(
        calibration,
        column("heading"),
        column("sigma_heading"),
        column("rate"),
        column("C23"),
        column("latitude"),
        np.nan_to_num(column("sigma_C23")),
    )


def _headings(
    runs: Sequence[HseRun], result: HseFit, file: HseCalibration, stand: dict[str, float]
) -> tuple[ValidationTable | None, tuple[PositionSpread, ...]]:
    """Headings before and after correction: against azimuths, and within positions."""
    if file.lambda2_rad is None:
        return None, ()
    chosen = [
        (run, fitted.position)
        for run, fitted in zip(runs, result.run_fits, strict=True)
        if fitted.used
    ]
    used = [run for run, _ in chosen]
    before = np.array([run.heading for run in used])
    after = correct_runs(used, file).heading
    position = np.array([k for _, k in chosen])
    spread = []
    for k in np.unique(position).tolist():
        here = np.flatnonzero(position == k)
        from_first = wrapped(after[here] - after[here[0]])
        middle = float((after[here[0]] + from_first.mean()) % (2.0 * np.pi))
        spread.append(
            PositionSpread(
                k,
                middle,
                tuple(used[i].id for i in here),
                wrapped(before[here] - middle),
                wrapped(after[here] - middle),
            )
        )
    placed = [i for i, run in enumerate(used) if run.source in stand]
    table = None
    if placed:
        azimuth = np.array([stand[used[i].source] for i in placed])
        names = [used[i].id for i in placed]
        table = validation_table(azimuth, before[placed], after[placed], names)
    return table, tuple(spread)
