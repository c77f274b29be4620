"""`sinstool compare-coning`: coning algorithms side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from sinstool.campaign.inputs import are_many
from sinstool.cli.batch import EXIT_HELP, BatchOptions, batch_options, warn_of, workers_options
from sinstool.cli.console import PathName, print_json, progress_bar
from sinstool.cli.help import Command
from sinstool.cli.options import config_options, effective_config, path_option, print_config
from sinstool.config.coning import COMPARISON_OPTIONS, check_comparison

MAIN = ("comparison__algorithms", "report", "csv_dir", "overwrite", "paper")


@click.command("compare-coning", cls=Command, first=MAIN, epilog=EXIT_HELP)
@click.argument("logs", nargs=-1, type=PathName(), metavar="[LOG]...")
@workers_options("one for each core")
@click.option("--paper", is_flag=True, help="re-run the published experiment; needs no log")
@config_options(*COMPARISON_OPTIONS)
@path_option("--csv", "csv_dir", metavar="FOLDER", text="also write tables to this new folder")
@path_option("--report", metavar="FILE", text="also write a page of figures (.html), or a figure")
@click.option("--overwrite", is_flag=True, help="replace an existing report")
@batch_options("tables of lower rates too", quiet_of="no progress")
def command(
    logs: tuple[Path, ...],
    paper: bool,
    config_file: Path | None,
    csv_dir: Path | None,
    report: Path | None,
    overwrite: bool,
    show: bool,
    batch: BatchOptions,
    **flags: Any,
) -> int:
    """Compare coning algorithms on LOG, and say which one it needs.

    Runs the algorithms side by side, at the log's rate and at lower ones. Shows their drift against
    the most accurate one, or against --truth, and the drift predicted from the log's own coning.

    Several LOGs, a folder or a quoted pattern give a table with a line for each log; --csv and
    --report are then folders. --paper re-runs the published experiment and shows our results beside
    the printed ones.
    """
    # [coning] may choose an algorithm for `process` that the options given here do not go with.
    config = effective_config(config_file, flags, check=False)
    check_comparison(config.comparison, config.coning)
    if show:
        print_config(config, *COMPARISON_OPTIONS)
        return 0
    if paper and logs:
        raise click.UsageError("--paper simulates its own motion: leave it out, or the LOG")
    if not paper and not logs:
        raise click.UsageError("give a LOG to compare on, or --paper")
    from sinstool.cli import compare_run
    from sinstool.core.whole_file import check_new_folder

    if csv_dir is not None:
        check_new_folder(csv_dir, "--csv")
    if are_many(logs):
        return compare_run.compare_many(logs, config, csv_dir, report, overwrite, batch)
    if batch.scheduler is not None:
        raise click.UsageError("--scheduler is for many logs")
    if paper:
        from sinstool.cli.compare_paper import run_paper

        with progress_bar("the paper's experiment", batch.quiet) as progress:
            run_paper(config, csv_dir, report, overwrite, batch.as_json, progress)
        return 0
    from sinstool.report.text.coning import print_comparison

    with progress_bar(logs[0].name, batch.quiet) as progress:
        result = compare_run.compare_one(
            logs[0], csv_dir, report, config, overwrite, None, progress
        )
    if batch.as_json:
        print_json(result.to_json())
    else:
        print_comparison(result, batch.verbose > 0)
    warn_of(result.findings)
    return result.exit_status
