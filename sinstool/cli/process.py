"""`sinstool process`: attitude and navigation from one recorded IMU log or many."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sinstool.api.process import process_one
from sinstool.campaign.inputs import are_many, find_logs, output_paths
from sinstool.cli import many
from sinstool.cli.batch import (
    EXIT_HELP,
    BatchOptions,
    batch_options,
    show_result,
    with_full_names,
    workers_options,
)
from sinstool.cli.console import PathName, print_json, progress_bar, warn
from sinstool.cli.help import Command
from sinstool.cli.options import config_options, effective_config, path_option, print_config
from sinstool.config import PROCESS_OPTIONS, ProcessConfig
from sinstool.core.english import heading_text
from sinstool.core.errors import SinstoolError
from sinstool.core.finding import exit_status
from sinstool.core.whole_file import EXPORTED
from sinstool.report.text.process import summary_rows
from sinstool.report.text.table import table

if TYPE_CHECKING:
    from sinstool.core.progress import Progress
    from sinstool.pipelines.process.result import ProcessResult

MAIN = ("output", "navigation__mode", "filter__smooth", "output__report", "output__overwrite")
HEADER = ("samples", "Hz", "gaps", "roll", "pitch", "heading deg", "warnings")


@click.command("process", cls=Command, first=MAIN, epilog=EXIT_HELP)
@click.argument("logs", nargs=-1, type=PathName(), metavar="LOG...")
@path_option("-o", "--output", text="MCAP file to write; a folder for many logs")
@workers_options("one for each core")
@config_options(*PROCESS_OPTIONS)
@click.option(
    "--print-plan",
    "show_plan",
    is_flag=True,
    help="print what would be done and why, and stop",
)
@batch_options()
def command(
    logs: tuple[Path, ...],
    output: Path | None,
    config_file: Path | None,
    show: bool,
    show_plan: bool,
    batch: BatchOptions,
    **flags: Any,
) -> int:
    """Compute attitude, velocity and position from the IMU in LOG, and write them as MCAP.

    LOG is an MCAP file, a ROS 1 bag, a ROS 2 bag directory, a .db3 file or a ULog. Several LOGs, a
    folder or a quoted pattern are processed into the folder OUTPUT, where outputs that are complete
    already are kept.

    \b
      sinstool process flight.mcap -o flight.attitude.mcap --report flight.html
      sinstool process campaign/ -o results/ -j 4
    """
    config = effective_config(config_file, flags)
    if show:
        print_config(config, *PROCESS_OPTIONS, "rig")
        return 0
    if not logs:
        raise click.UsageError("give a LOG to process")
    if show_plan:
        if are_many(logs):
            raise click.UsageError("--print-plan is for a single log")
        return _print_plan(logs[0], config, batch)
    if output is None:
        raise click.UsageError("give the output with -o FILE")
    if are_many(logs):
        return process_many(logs, output, config, batch)
    if batch.scheduler is not None:
        raise click.UsageError("--scheduler is for many logs; one is processed here")
    log = logs[0]
    report = None if config.output.report is None else Path(config.output.report)
    from sinstool.report.page import check_report

    check_report(report, inputs=[log], overwrite=config.output.overwrite)
    if report is not None and report.absolute() == output.absolute():
        raise click.UsageError("--report and -o name one file")
    with progress_bar(log.name, batch.quiet) as progress:
        result = process_one(log, output, report, config, progress)
    return show_result(result, batch, summary_rows)


def _print_plan(log: Path, config: ProcessConfig, batch: BatchOptions) -> int:
    """What would be done with a log, and why; nothing is written."""
    from sinstool.core.result import as_json as plain
    from sinstool.pipelines.process.run import plan_of

    with progress_bar(log.name, batch.quiet) as progress:
        plan = plan_of(log, config, progress)
    for finding in plan.findings:
        warn(str(finding))
    if batch.as_json:
        print_json({"schema": "sinstool.plan/1", **plain(plan)})
    else:
        table(plan.rows())
    return exit_status(plan.findings)


def process_unless_done(
    log: Path,
    output: Path,
    report: Path | None,
    config: ProcessConfig,
    script: Path | None,
    progress: Progress | None,
) -> ProcessResult | dict[str, Any]:
    """Process one of many logs, unless its output exists and would come out the same.

    Returns
    -------
    ProcessResult or dict
        For an output that exists already only ``input``, ``output``, ``travel`` and the ``kinds``
        of its findings, with ``status`` and ``exit``.

    Raises
    ------
    SinstoolError
        Also if a different file has the output's name.
    """
    if output.exists() and not config.output.overwrite:
        from sinstool.pipelines.provenance import read_figures, require_same

        record = require_same(output, log, config)
        if report is None or report.exists():
            size, digest = int(record["input_size"]), record["input_sha256"]
            return {
                "input": {"path": str(log), "size": size, "sha256": digest},
                "output": {"path": str(output)},
                **read_figures(record),
                "status": "complete",
                "exit": 3 if record.get("status") == "lost" else 0,
            }
        # Only the page is missing: making it makes the output again, unchanged.
        again = config.output.model_copy(update={"overwrite": True})
        config = config.model_copy(update={"output": again})
    from sinstool.report.page import check_report

    check_report(report, inputs=[log], overwrite=config.output.overwrite)
    return process_one(log, output, report, config, progress, script=script)


def process_many(
    inputs: Sequence[Path], folder: Path, config: ProcessConfig, batch: BatchOptions
) -> int:
    """Process logs, each to an output of its own.

    Parameters
    ----------
    inputs : sequence of Path
        Files, folders, patterns.
    folder : Path
        Folder for the outputs.
    config : ProcessConfig
        ``output.report`` is a folder too.

    Returns
    -------
    int
        Exit status.
    """
    from sinstool.pipelines.provenance import files
    from sinstool.report.pages.campaign import (
        INDEX,
        Entry,
        check_index,
        throughput,
        write_index,
    )

    logs = find_logs(inputs, without=folder)
    if folder.suffix.lower() in (".mcap", *EXPORTED) and not folder.is_dir():
        raise click.UsageError(
            f"-o {folder}: with many logs give a folder, which gets an output for each"
            " (MCAP; `sinstool export` writes other formats of them)"
        )
    outputs = [path.absolute() for path in output_paths(logs, folder)]
    report = config.output.report
    check_index(folder)
    pages, script = many.page_paths(None if report is None else Path(report), logs)
    config = with_full_names(config)
    reads = [*files(config).values(), *map(Path, config.output.truth)]
    index = folder.absolute() / INDEX
    if index in pages:
        raise click.UsageError(
            f"--report {report}: {INDEX} is the table of all logs there; give another folder"
        )
    written = list(zip(outputs, pages, strict=True))
    began = time.monotonic()
    rows = many.work_on_logs(
        logs, process_unless_done, written, (config, script), reads, batch, named=True
    )
    seconds = time.monotonic() - began
    entries = [
        Entry(log.name, log.path, row, page)
        for log, row, page in zip(logs, rows, pages, strict=True)
    ]
    fault = None
    try:
        write_index(folder, entries, seconds)
    except (SinstoolError, OSError) as exc:
        # Raised only after the table: a full disk must not hide what was done
        fault = exc
    names = [str(log.path) for log in logs]
    status = many.finish(
        names, rows, batch, lambda: many.log_table(HEADER, logs, rows, _cells), f", in {folder}"
    )
    if not batch.quiet:
        click.echo(throughput(entries, seconds), err=True)
    if fault is not None:
        raise fault
    return status


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    if "imu" not in row:
        return ("-",) * 7
    imu, final = row["imu"], row["final"]
    return (
        str(imu["n"]),
        f"{imu['rate_hz']:.2f}",
        str(imu["gaps"]),
        *(f"{final[name]:.3f}" for name in ("roll_deg", "pitch_deg")),
        heading_text(final["heading_deg"], 3),
        str(len(row["warnings"])),
    )
