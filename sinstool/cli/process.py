"""`sinstool process`: recorded IMU to corrected attitude."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sinstool.cli.console import print_json, progress_bar, table, warn
from sinstool.cli.options import config_options, effective_config, print_config
from sinstool.cli.process_rows import summary_rows

if TYPE_CHECKING:
    from sinstool.config import ProcessConfig
    from sinstool.process_figures import Recorder


@click.command("process")
@click.argument("log", type=click.Path(path_type=Path), required=False)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="MCAP file to write")
@config_options(
    "input",
    "coning",
    "align",
    "gnss",
    "in_flight",
    "navigation",
    "filter",
    "vertical",
    "hse",
    "output",
)
@click.option("--print-config", "show", is_flag=True, help="print the configuration and stop")
@click.option("--json", "as_json", is_flag=True, help="one JSON object on stdout")
@click.option("-q", "--quiet", is_flag=True, help="no progress and no summary")
@click.option("-v", "--verbose", is_flag=True, help="explain choices; tracebacks for errors")
def command(
    log: Path | None,
    output: Path | None,
    config_file: Path | None,
    show: bool,
    as_json: bool,
    quiet: bool,
    verbose: bool,
    **given: Any,
) -> int:
    """Recorded IMU of LOG to corrected attitude, written to OUTPUT as MCAP.

    LOG is an MCAP file, a ROS 1 bag, a ROS 2 bag directory or a single .db3. Its own messages
    are copied byte for byte; /sinstool/imu and /sinstool/attitude are added.

    \b
    Example:
      sinstool process flight.mcap -o flight.attitude.mcap --align level
    """
    config = effective_config(config_file, given)
    if show:
        print_config(config, "calibration")
        return 0
    if log is None:
        raise click.UsageError("give a LOG to process")
    if output is None:
        raise click.UsageError("give the output with -o FILE")
    report = None if config.output.report is None else Path(config.output.report)
    if report is not None:
        from sinstool.report.page import check_report

        check_report(report, inputs=[log], overwrite=config.output.overwrite)
        if report.absolute() == output.absolute():
            raise click.UsageError("--report and -o name one file")
    from sinstool.pipeline import process
    from sinstool.summary import something_lost
    from sinstool.writers.whole import together

    recorder = _recorder(log, config)
    with together(), progress_bar(log.name, quiet) as progress:
        summary = process(log, output, config, progress, recorder)
        if recorder is not None and config.output.truth:
            summary["truth"] = recorder.errors()
        if report is not None and recorder is not None:
            from sinstool.cli.process_report import write_page

            write_page(report, recorder, summary, config)
    for text in summary["warnings"]:
        warn(text)
    if as_json:
        print_json(summary)
    elif not quiet:
        table(summary_rows(summary, verbose))
    return 3 if something_lost(summary) else 0


def _recorder(log: Path, config: ProcessConfig) -> Recorder | None:
    """What collects figures and errors, where either is asked for."""
    told = config.output
    if told.report is None and not told.truth:
        return None
    from sinstool.process_figures import Recorder
    from sinstool.process_truth import read_references
    from sinstool.readers import open_log

    if not told.truth:
        return Recorder()
    with open_log(log, config.input.salvage) as opened:
        return Recorder(read_references(opened, told.truth, config.input.body_axes))
