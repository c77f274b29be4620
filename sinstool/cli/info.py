"""`sinstool info`: contents and anomalies of one log or many."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from sinstool.campaign.inputs import are_many, find_logs
from sinstool.cli import many
from sinstool.cli.batch import (
    EXIT_HELP,
    BatchOptions,
    batch_options,
    with_full_names,
    workers_options,
)
from sinstool.cli.console import PathName, print_json, progress_bar
from sinstool.cli.help import Command
from sinstool.cli.options import config_options, effective_config, path_option, print_config
from sinstool.config import INFO_OPTIONS, ProcessConfig

HEADER = ("duration s", "IMU samples", "Hz", "gaps", "mode", "first attitude", "findings")


@click.command("info", cls=Command, first=("report", "overwrite"), epilog=EXIT_HELP)
@click.argument("logs", nargs=-1, type=PathName(), metavar="LOG...")
@workers_options("one for each core")
@config_options(*INFO_OPTIONS)
@path_option("--report", metavar="FILE.html",
             text="also write a page of figures (.html), or its first figure (.png, .pdf,"
             " .svg); a folder for many logs")  # fmt: skip
@click.option("--overwrite", is_flag=True, help="replace an existing report")
@batch_options("all still spans", quiet_of="no progress")
def command(
    logs: tuple[Path, ...],
    config_file: Path | None,
    report: Path | None,
    overwrite: bool,
    show: bool,
    batch: BatchOptions,
    **flags: Any,
) -> int:
    """Show what LOG holds, what is wrong with it, and what process would do with it.

    Several LOGs, a folder or a quoted pattern give a table with a line for each log.
    """
    config = effective_config(config_file, flags)
    if show:
        print_config(config, *INFO_OPTIONS)
        return 0
    if not logs:
        raise click.UsageError("give a LOG to inspect")
    if are_many(logs):
        return info_many(logs, report, config, overwrite, batch)
    if batch.scheduler is not None:
        raise click.UsageError("--scheduler is for many logs")
    from sinstool.report.text.info import print_inspection

    with progress_bar(logs[0].name, batch.quiet) as progress:
        inspection = info_one(logs[0], report, config, overwrite, None, progress)
    if batch.as_json:
        print_json(inspection.to_json())
    else:
        print_inspection(inspection, batch.verbose > 0)
    status: int = inspection.exit_status
    return status


def info_one(
    log: Path,
    report: Path | None,
    config: ProcessConfig,
    overwrite: bool,
    script: Path | None,
    progress: Any,
) -> Any:
    """Inspect a log, and write its page if one is requested.

    Raises
    ------
    SinstoolError
    """
    from sinstool.pipelines.info.run import Shown, inspect
    from sinstool.report.page import check_report

    check_report(report, inputs=[log], overwrite=overwrite)
    shown = None if report is None else Shown()
    inspection = inspect(log, config, progress, shown)
    if report is not None and shown is not None:
        from sinstool.report.pages.info import write_page

        write_page(report, inspection, shown, config, overwrite, script)
    return inspection


def info_row(*arguments: Any) -> dict[str, Any]:
    """As :func:`info_one`: the values of ``--json`` with ``status`` and ``exit``.

    Raises
    ------
    SinstoolError
    """
    inspection = info_one(*arguments)
    status = inspection.exit_status
    findings = [finding.to_json() for finding in inspection.findings]
    ended = {"findings": findings, "status": "lost" if status else "done", "exit": status}
    return {**inspection.to_json(), **ended}


def info_many(
    inputs: Sequence[Path],
    folder: Path | None,
    config: ProcessConfig,
    overwrite: bool,
    batch: BatchOptions,
) -> int:
    """Inspect many logs: a line for each.

    Parameters
    ----------
    inputs : sequence of Path
        Files, folders, patterns.
    folder : Path or None
        Folder for the pages.

    Returns
    -------
    int
        Exit status.
    """
    logs = find_logs(inputs)
    pages, script = many.page_paths(folder, logs)
    settings = (with_full_names(config), overwrite, script)
    rows = many.work_on_logs(logs, info_row, [(page,) for page in pages], settings, [], batch)
    names = [str(log.path) for log in logs]
    return many.finish(names, rows, batch, lambda: many.log_table(HEADER, logs, rows, _cells))


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    if "process" not in row:
        return ("-",) * len(HEADER)
    imu, plan = _taken(row), row["process"]["plan"]
    samples, rate, gaps = ("-",) * 3
    if imu is not None:
        samples, rate, gaps = str(imu["n"]), f"{imu['rate_hz']:.2f}", str(imu["gaps"])
    source = row["input"]
    span = (int(source["end_ns"]) - int(source["start_ns"])) / 1e9
    chosen = (
        [plan[name]["value"] for name in ("mode", "first_attitude")] if plan else ["refused", "-"]
    )
    return (f"{span:.1f}", samples, rate, gaps, *chosen, str(len(row["findings"])))


def _taken(row: dict[str, Any]) -> dict[str, Any] | None:
    """The IMU topic that `process` would use, else the first one with a known rate."""
    usable = [imu for imu in row["imu"] if "rate_hz" in imu]
    same = [imu for imu in usable if imu["topic"] == row["process"]["imu_topic"]]
    return next(iter(same or usable), None)
