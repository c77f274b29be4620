"""`sinstool allan`: noise of an IMU from the rests of its log, in one log or many."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import click

from sinstool.campaign.inputs import are_many, find_logs, output_paths
from sinstool.cli import many
from sinstool.cli.batch import (
    EXIT_HELP,
    BatchOptions,
    batch_options,
    warn_of,
    with_full_names,
    workers_options,
)
from sinstool.cli.console import Choice, PathName, print_json, progress_bar
from sinstool.cli.help import Command
from sinstool.cli.options import config_options, effective_config, path_option, print_config
from sinstool.config import ALLAN_OPTIONS, ProcessConfig
from sinstool.config.export import NoiseFormat

if TYPE_CHECKING:
    from sinstool.pipelines.allan.result import AllanResult

MAIN = ("output", "kind", "report", "overwrite")
FORMATS: tuple[NoiseFormat, ...] = get_args(NoiseFormat)
HEADER = ("rest s", "longest s", "gyro deg/sqrt(h)", "deg/h", "accel ug/sqrt(Hz)", "ug")


@click.command("allan", cls=Command, first=MAIN, epilog=EXIT_HELP)
@click.argument("logs", nargs=-1, type=PathName(), metavar="LOG...")
@workers_options("one for each core")
@config_options(*ALLAN_OPTIONS)
@path_option("-o", "--output", metavar="FILE",
             text="write the noise to this file; a folder for many logs")  # fmt: skip
@click.option("--format", "kind", type=Choice(FORMATS), metavar="NAME",
              help="program to write the file for: sinstool (process and align), kalibr,"
              " vins-fusion, openvins, fast-lio, robot-localization or kf-gins; printed if there"
              " is no --output [default: sinstool]")  # fmt: skip
@path_option("--report", metavar="FILE.html",
             text="also write a page of figures (.html), or its first figure (.png, .pdf,"
             " .svg); a folder for many logs")  # fmt: skip
@click.option("--overwrite", is_flag=True, help="replace an existing output or report")
@batch_options(quiet_of="no progress and no summary")
def command(
    logs: tuple[Path, ...],
    config_file: Path | None,
    output: Path | None,
    kind: NoiseFormat | None,
    report: Path | None,
    overwrite: bool,
    show: bool,
    batch: BatchOptions,
    **flags: Any,
) -> int:
    """Measure the noise of the IMU in LOG where it rests, and write it for a filter.

    Finds the stretches at rest by itself, fits the terms of the Allan variance (quantisation,
    white noise, bias instability, random walk, ramp) and gives each with its 95 % interval, or an
    upper bound where the log does not show it.

    Several LOGs, a folder or a quoted pattern give a table with a line for each log.

    \b
      sinstool allan rest.mcap -o noise.toml
      sinstool process drive.mcap --imu-noise noise.toml -o out.mcap
    """
    config = effective_config(config_file, flags)
    if show:
        print_config(config, *ALLAN_OPTIONS)
        return 0
    if not logs:
        raise click.UsageError("give a LOG with rests to measure on")
    if output is None and kind is not None and batch.as_json:
        raise click.UsageError("--format with --json needs --output: only one can be printed")
    if are_many(logs):
        if output is None and kind is not None:
            raise click.UsageError("--format of many logs needs --output, a folder")
        return allan_many(logs, config, output, kind or FORMATS[0], report, overwrite, batch)
    if batch.scheduler is not None:
        raise click.UsageError("--scheduler is for many logs")
    with progress_bar(logs[0].name, batch.quiet) as progress:
        settings = (config, kind or FORMATS[0], overwrite, None)
        result = allan_one(logs[0], output, report, *settings, progress)
    if batch.as_json:
        print_json(result.to_json())
    elif kind is not None and output is None:
        from sinstool.pipelines.allan.formats import text_of

        click.echo(text_of(result, kind), nl=False)
    elif not batch.quiet:
        from sinstool.report.text.allan import print_noise

        print_noise(result)
    warn_of(result.findings)
    return result.exit_status


def allan_one(
    log: Path,
    output: Path | None,
    report: Path | None,
    config: ProcessConfig,
    kind: NoiseFormat,
    overwrite: bool,
    script: Path | None,
    progress: Any,
) -> AllanResult:
    """Measure the noise of a log, and write the outputs.

    Raises
    ------
    SinstoolError
    """
    from sinstool.core.whole_file import check_output, commit_together
    from sinstool.pipelines.allan.formats import write_noise
    from sinstool.pipelines.allan.run import measure
    from sinstool.report.page import check_report

    if output is not None:
        check_output(output, [log], overwrite)
    check_report(report, inputs=[log], overwrite=overwrite)
    with commit_together():
        noise = measure(log, config, progress)
        result = noise.result
        if output is not None:
            result = write_noise(result, output, kind)
        if report is not None:
            from sinstool.report.pages.allan import write_page

            write_page(report, noise, config, overwrite, script)
    return result


def allan_many(
    inputs: Sequence[Path],
    config: ProcessConfig,
    folder: Path | None,
    kind: NoiseFormat,
    pages: Path | None,
    overwrite: bool,
    batch: BatchOptions,
) -> int:
    """Measure on many logs: a line for each.

    Parameters
    ----------
    inputs : sequence of Path
        Files, folders, patterns.
    folder, pages : Path or None
        Folders for the noise files and for the pages.

    Returns
    -------
    int
        Exit status.
    """
    from sinstool.pipelines.allan.formats import SUFFIXES

    logs = find_logs(inputs)
    suffix = SUFFIXES[kind]
    if folder is not None and folder.suffix.lower() in (".toml", ".yaml", ".yml"):
        raise click.UsageError(
            f"--output {folder}: with many logs give a folder, which gets a file for each"
        )
    files = [None] * len(logs) if folder is None else output_paths(logs, folder, suffix)
    whole = [None if file is None else file.absolute() for file in files]
    reports, script = many.page_paths(pages, logs)
    written = list(zip(whole, reports, strict=True))
    settings = (with_full_names(config), kind, overwrite, script)
    rows = many.work_on_logs(logs, allan_one, written, settings, [], batch)
    names = [str(log.path) for log in logs]
    where = "" if folder is None else f"; noise in {folder}"

    return many.finish(
        names, rows, batch, lambda: many.log_table(HEADER, logs, rows, _cells), where
    )


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    """White noise and bias instability over the axes, in the units of data sheets."""
    if "rest" not in row:
        return ("-",) * len(HEADER)
    from sinstool.config.noise import key_of
    from sinstool.report.text.allan import SHOWN

    cells = [f"{row['rest'][key]:.1f}" for key in ("total_s", "longest_s")]
    for sensor, terms in SHOWN.items():
        for term in ("white", "flicker"):
            coefficient = (row[sensor]["over_axes"] or {}).get(key_of(sensor, term))
            size = terms[term][2]
            if coefficient is None:
                cells.append("-")
            elif coefficient["value"] is None:
                cells.append(f"<{coefficient['high'] / size:.3g}")
            else:
                cells.append(f"{coefficient['value'] / size:.4g}")
    return tuple(cells)
