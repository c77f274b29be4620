"""`sinstool compare-coning`: coning algorithms side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sinstool.cli.choice import Choice
from sinstool.cli.compare_one import compare_one, told
from sinstool.cli.complete import coning_list, coning_names
from sinstool.cli.console import print_json, progress_bar, warn
from sinstool.cli.many import EXIT_HELP, workers_options
from sinstool.cli.options import Words, config_options
from sinstool.cli.verbose import verbose_option
from sinstool.report.text.coning import print_comparison

if TYPE_CHECKING:
    from sinstool.pipelines.compare_coning.paper import Reproduction


class Whole(click.ParamType):
    """Whole numbers with commas between."""

    name = "whole numbers"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, ...]:
        """Parse the text of an option."""
        if not isinstance(value, str):
            return tuple(value)
        try:
            numbers = tuple(int(part) for part in value.split(","))
        except ValueError:
            numbers = ()
        if not numbers or min(numbers) < 1:
            self.fail(f"'{value}' is not a list of whole numbers from 1 on", param)
        return tuple(dict.fromkeys((1, *numbers)))


@click.command("compare-coning", epilog=EXIT_HELP)
@click.argument("logs", nargs=-1, type=click.Path(path_type=Path), metavar="[LOG]...")
@workers_options("one for each core")
@click.option("--paper", is_flag=True, help="re-run the published experiment instead of a log")
@click.option(
    "--algorithms",
    type=Words(),
    metavar="A,B,...",
    help="coning algorithms [default: ten]",
    shell_complete=coning_list,
)
@click.option(
    "--reference",
    default="auto",
    show_default=True,
    metavar="NAME",
    shell_complete=coning_names,
    help="what the others are measured against: an algorithm, auto (quatfiter-4), or none",
)
@click.option(
    "--decimate",
    type=Whole(),
    default="1,2,4",
    show_default=True,
    metavar="M,...",
    help="also as if logged at lower rates: one sample of so many",
)
@click.option("--passband", type=float, metavar="HZ", help="coning above this is noise")
@click.option(
    "--stopband",
    type=float,
    metavar="HZ",
    help="above this nothing moves: what is answered there is pseudo-coning",
)
@click.option(
    "--gyro-response",
    metavar="none|cheb:N,DB,HZ|butter:N,HZ|FILE",
    help="of the gyro; for gyro-tuned, and for --paper",
)
@click.option(
    "--window",
    type=float,
    default=10.0,
    show_default=True,
    metavar="S",
    help="drift is measured in windows of this many seconds",
)
@click.option(
    "--tolerance",
    type=float,
    default=0.01,
    show_default=True,
    metavar="DEG/H",
    help="drift that does not matter",
)
@click.option(
    "--sp-preset",
    type=Choice(["best", "paper", "auto"]),
    default="best",
    show_default=True,
    help="parameters of singular-perturbation; auto tunes them to the coning in --passband",
)
@click.option(
    "--truth",
    metavar="TOPIC|FILE",
    help="true attitude as reference: Imu, QuaternionStamped, PoseStamped or Odometry, or CSV",
)
@click.option(
    "--phase",
    type=Choice(["consistent", "literal"]),
    default="consistent",
    show_default=True,
    help="with --paper: how eq. (20) is read",
)
@config_options("input")
@click.option("--csv", "csv_dir", type=click.Path(path_type=Path), help="new folder for tables")
@click.option("--report", type=click.Path(path_type=Path), help="page (.html) or figure to write")
@click.option("--overwrite", is_flag=True, help="replace an existing report")
@click.option(
    "--json", "as_json", is_flag=True, help="one JSON object on stdout, or one line for each log"
)
@click.option("-q", "--quiet", is_flag=True, help="no progress")
@verbose_option()
def command(logs: tuple[Path, ...], paper: bool, **options: Any) -> int:
    """Which coning algorithm, on LOG, and by how much.

    Runs the algorithms side by side on LOG, as it is and as if it had been taken at lower rates,
    and says how they drift from the sharpest of them, or from --truth, and what the log's own
    coning predicts. docs/compare-coning.md says what each column means.

    Many LOGs, a folder of them or a pattern in quotes: a line for each, and what every algorithm
    does over all. --csv and --report are then folders, with a folder or page for each log.

    With --paper it re-runs the published experiment instead, each printed figure beside ours.
    """
    if paper == bool(logs):
        raise click.UsageError("give a LOG to compare on, or --paper")
    from sinstool.campaign.inputs import are_many

    if are_many(logs):
        from sinstool.cli.compare_many import compare_many

        return compare_many(logs, options)
    if options["scheduler"] is not None:
        raise click.UsageError("--scheduler is for many logs")
    if options["report"] is not None:
        from sinstool.report.page import check_report

        check_report(options["report"], inputs=logs, overwrite=options["overwrite"])
    return _log(logs[0], options) if logs else _paper(options)


def _paper(options: dict[str, Any]) -> int:
    from sinstool.cli.compare_paper import run_paper

    response = options["gyro_response"] or "cheb:6"

    def report(found: Reproduction) -> None:
        if options["report"] is not None:
            from sinstool.report.pages.compare_coning import write_reproduction

            settings = {"phase": options["phase"], "gyro_response": response}
            write_reproduction(command, options, found, settings)

    with progress_bar("the paper's experiment", options["quiet"]) as progress:
        run_paper(
            options["phase"],
            response,
            options["algorithms"] or (),
            options["csv_dir"],
            options["as_json"],
            progress,
            report,
        )
    return 0


def _log(log: Path, options: dict[str, Any]) -> int:
    config, settings = told(options)
    from sinstool.core.whole_file import check_new_folder

    if options["csv_dir"] is not None:
        check_new_folder(options["csv_dir"], "--csv")
    with progress_bar(log.name, options["quiet"]) as progress:
        result = compare_one(log, config, settings, options, progress)
    for text in result["warnings"]:
        warn(text)
    if options["as_json"]:
        print_json(result)
    else:
        print_comparison(result)
    return 3 if result["lost"] else 0
