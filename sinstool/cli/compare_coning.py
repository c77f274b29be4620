"""`sinstool compare-coning`: coning algorithms side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from sinstool.campaign.inputs import are_many
from sinstool.cli.console import print_json, progress_bar, warn
from sinstool.cli.many import EXIT_HELP, BatchOptions, batch_options, workers_options
from sinstool.cli.options import config_options, effective_config, path_option, print_config
from sinstool.config.coning import COMPARISON_OPTIONS, check_comparison


@click.command("compare-coning", epilog=EXIT_HELP)
@click.argument("logs", nargs=-1, type=click.Path(path_type=Path), metavar="[LOG]...")
@workers_options("one for each core")
@click.option("--paper", is_flag=True, help="re-run the published experiment instead of a log")
@config_options(*COMPARISON_OPTIONS)
@path_option("--csv", "csv_dir", text="new folder for tables")
@path_option("--report", text="page (.html) or figure to write")
@click.option("--overwrite", is_flag=True, help="replace an existing report")
@batch_options(quiet_of="no progress")
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
    """Which coning algorithm, on LOG, and by how much.

    Runs the algorithms side by side on LOG, as it is and as if it had been taken at lower rates,
    and says how they drift from the sharpest of them, or from --truth, and what the log's own
    coning predicts. docs/compare-coning.md says what each column means.

    Many LOGs, a folder of them or a pattern in quotes: a line for each, and what every algorithm
    does over all. --csv and --report are then folders, with a folder or page for each log.

    With --paper it re-runs the published experiment instead, each printed figure beside ours.
    """
    # [coning] may name an algorithm of `process`, which these options need not fit.
    config = effective_config(config_file, flags, check=False)
    check_comparison(config.comparison, config.coning)
    if show:
        print_config(config, "input", "coning", "comparison")
        return 0
    if paper == bool(logs):
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
        result = compare_run.compare_one(logs[0], csv_dir, report, config, overwrite, progress)
    for text in result.warnings:
        warn(text)
    if batch.as_json:
        print_json(result.to_json())
    else:
        print_comparison(result)
    return 3 if result.lost else 0
