"""Heading-sensitive error calibrated: from a rig's logs to the file that `process --hse` takes.

`calibrate` reads every log, finds its stretches at constant rate, aligns on each, fits, judges,
and writes the calibration; what it returns is what a summary and a page need.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

import sinstool
from sinstool.config import CalibrationOptions, ProcessConfig
from sinstool.errors import AlignmentError, ConfigurationError, SinstoolError
from sinstool.hse.calibration_file import HseCalibration, dumps, from_fit
from sinstool.hse.correction import correct_heading
from sinstool.hse.fit import fit
from sinstool.hse.fit_result import FitOptions, HseFit
from sinstool.hse.rig import Rig, from_table
from sinstool.hse.run import HseRun
from sinstool.hse.segments import SegmentRules
from sinstool.hse.status import Judgement, judge
from sinstool.hse.table import ValidationTable, validation_table
from sinstool.hse.whole_turn import run_from_turns
from sinstool.readers import open_log
from sinstool.rig_log import RigTurns, find_turns, nothing_to_use, read_rig_log
from sinstool.units import DEGREE
from sinstool.writers.whole import WholeFile, check_output

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Calibration:
    """What a calibration found.

    Attributes
    ----------
    rig : Rig
    logs : tuple of RigTurns
        Of each log that could be used.
    runs : tuple of HseRun
    fit : HseFit
    judgement : Judgement
    kept : HseCalibration
        As written.
    table : ValidationTable or None
        Headings before and after at the azimuths that were given, or at those found.
    azimuths_given : bool
    warnings : tuple of str
        Beside those of the judgement.
    """

    rig: Rig
    logs: tuple[RigTurns, ...]
    runs: tuple[HseRun, ...]
    fit: HseFit
    judgement: Judgement
    kept: HseCalibration
    table: ValidationTable | None
    azimuths_given: bool
    warnings: tuple[str, ...]


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
    """What makes a stretch good enough to align on."""
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
) -> Calibration:
    """Calibrate a rig's heading-sensitive error from its logs.

    Parameters
    ----------
    paths : sequence of Path
    output : Path or None
        JSON file to write; None to write none.
    config : ProcessConfig
        With a rig.
    progress : callable, optional
        Called with the fraction done.

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
    logs, warnings = read_logs(paths, rig, config, progress)
    runs = align_runs(logs, rig, config.calibration)
    options = config.calibration
    unknown = sorted(set(options.exclude) - {run.id for run in runs})
    if unknown:
        raise ConfigurationError(
            f"--exclude {unknown[0]}: there is no such run",
            f"runs are {', '.join(run.id for run in runs[:12])}{' ...' * (len(runs) > 12)}",
        )
    result = fit(runs, fit_options(options))
    judged = judge(result)
    created = datetime.now(UTC).isoformat(timespec="seconds")
    tool = f"sinstool {sinstool.__version__}"
    kept = from_fit(result, judged, created, tool, rig.sha256())
    if output is not None:
        with WholeFile(output) as whole:
            whole.stream.write(dumps(kept).encode())
    table, given = _validation(runs, result, kept, options)
    return Calibration(
        rig,
        tuple(logs),
        tuple(runs),
        result,
        judged,
        kept,
        table,
        given,
        (*rig.remarks(), *warnings),
    )


def read_logs(
    paths: Sequence[Path], rig: Rig, config: ProcessConfig, progress: Progress | None
) -> tuple[list[RigTurns], list[str]]:
    """Turns of every log; logs without any are told, unless all are."""
    rules = segment_rules(config.calibration)
    logs: list[RigTurns] = []
    warnings: list[str] = []
    empty: list[SinstoolError] = []
    names = _names(paths)
    for number, path in enumerate(paths):
        with open_log(path, config.input.salvage) as log:
            report = _part(progress, log.size, number, len(paths))
            found = find_turns(
                read_rig_log(log, rig, config.input, report), rig, rules, names[path]
            )
            warnings += [f"{path}: lost: {part}" for part in log.lost]
        warnings += [f"{path}: {count} messages of {what}" for what, count in found.counts.items()]
        if found.turns:
            logs.append(found)
        else:
            empty.append(nothing_to_use(found, path, rules))
    if not logs:
        raise empty[0]
    warnings += [f"left out: {exc}" for exc in empty]
    return logs, warnings


def _names(paths: Sequence[Path]) -> dict[Path, str]:
    """Short names of the logs, with their folders where several are called the same."""
    stems = [p.stem for p in paths]
    return {p: p.stem if stems.count(p.stem) == 1 else str(p.with_suffix("")) for p in paths}


def _part(
    progress: Progress | None, size: int, number: int, count: int
) -> Callable[[int], None] | None:
    if progress is None:
        return None
    return lambda position: progress((number + min(1.0, position / max(size, 1))) / count)


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
    """Azimuths that were given, rad, by log.

    Raises
    ------
    ConfigurationError
        One is not NAME=DEGREES, or of no log.
    """
    found: dict[str, float] = {}
    for text in options.azimuth:
        name, sign, value = text.rpartition("=")
        try:
            found[name] = float(np.radians(float(value)))
        except ValueError:
            sign = ""
        if not sign:
            raise ConfigurationError(f"--azimuth {text}: not NAME=DEGREES")
        if name not in sources:
            raise ConfigurationError(
                f"--azimuth {text}: no log is called {name}", f"logs are {', '.join(sources)}"
            )
    return found


def _validation(
    runs: Sequence[HseRun], result: HseFit, kept: HseCalibration, options: CalibrationOptions
) -> tuple[ValidationTable | None, bool]:
    """Headings before and after correction against azimuth."""
    given = azimuths(options, list(dict.fromkeys(run.source for run in runs)))
    if kept.lambda2_rad is None:
        return None, bool(given)
    chosen = [
        run
        for run, fitted in zip(runs, result.run_fits, strict=True)
        if fitted.used and (not given or run.source in given)
    ]
    if not chosen:
        return None, bool(given)
    heading = np.array([run.heading for run in chosen])
    after = correct_heading(
        kept,
        heading,
        np.array([run.sigma_heading for run in chosen]),
        np.array([run.rate for run in chosen]),
        np.array([run.C23 for run in chosen]),
        np.array([run.latitude for run in chosen]),
    ).heading
    if given:
        azimuth = np.array([given[run.source] for run in chosen])
    else:
        azimuth = _found_azimuths(chosen, result, after)
    return validation_table(azimuth, heading, after, [run.id for run in chosen]), bool(given)


def _found_azimuths(chosen: Sequence[HseRun], result: HseFit, after: np.ndarray) -> np.ndarray:
    """Mean corrected heading of each position, for its rows."""
    position = {
        run.id: fitted.position for run, fitted in zip(result.runs, result.run_fits, strict=True)
    }
    group = np.array([position[run.id] for run in chosen])
    azimuth = np.empty(len(chosen))
    for k in np.unique(group):
        mine = group == k
        mean = np.angle(np.mean(np.exp(1j * after[mine])))
        azimuth[mine] = mean % (2.0 * np.pi)
    return azimuth
