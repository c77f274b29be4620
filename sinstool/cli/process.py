"""`sinstool process`: recorded IMU to corrected attitude."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from sinstool.cli.console import print_json, progress_bar, warn
from sinstool.cli.many import EXIT_HELP, BatchOptions, batch_options, show_result, workers_options
from sinstool.cli.options import config_options, effective_config, path_option, print_config
from sinstool.config import PROCESS_OPTIONS, ProcessConfig
from sinstool.core.finding import exit_status
from sinstool.report.text.process import summary_rows
from sinstool.report.text.table import table


@click.command("process", epilog=EXIT_HELP)
@click.argument("logs", nargs=-1, type=click.Path(path_type=Path), metavar="LOG...")
@path_option("-o", "--output", text="MCAP file to write; with many logs a folder")
@workers_options("one for each core")
@config_options(*PROCESS_OPTIONS)
@click.option(
    "--print-plan",
    "show_plan",
    is_flag=True,
    help="print what would be done with the log, and why, and stop",
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
    """Recorded IMU of LOG to corrected attitude, written to OUTPUT as MCAP.

    LOG is an MCAP file, a ROS 1 bag, a ROS 2 bag directory or a single .db3. Its own messages
    are copied byte for byte; /sinstool/imu and /sinstool/attitude are added.

    Many LOGs, a folder of them or a pattern in quotes: each has an output in the folder OUTPUT,
    named after it and laid out as in the folder that was given. Outputs that are complete are
    not made again. With --report FOLDER each has a page.

    \b
    Examples:
      sinstool process flight.mcap -o flight.attitude.mcap --align level
      sinstool process campaign/ -o results/ -j 4
    """
    config = effective_config(config_file, flags)
    if show:
        print_config(config, *PROCESS_OPTIONS, "rig")
        return 0
    if not logs:
        raise click.UsageError("give a LOG to process")
    from sinstool.campaign.inputs import are_many

    if show_plan:
        if are_many(logs):
            raise click.UsageError("--print-plan is about one log")
        return _print_plan(logs[0], config, batch)
    if output is None:
        raise click.UsageError("give the output with -o FILE")

    if are_many(logs):
        from sinstool.cli.process_many import process_many

        return process_many(logs, output, config, batch)
    if batch.scheduler is not None:
        raise click.UsageError("--scheduler is for many logs; one is processed here")
    log = logs[0]
    report = None if config.output.report is None else Path(config.output.report)
    if report is not None:
        from sinstool.report.page import check_report

        check_report(report, inputs=[log], overwrite=config.output.overwrite)
        if report.absolute() == output.absolute():
            raise click.UsageError("--report and -o name one file")
    from sinstool.cli.process_one import process_one

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
