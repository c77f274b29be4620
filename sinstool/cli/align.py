"""`sinstool align`: where the vehicle points, at rest or in motion."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sinstool.cli.choice import Choice
from sinstool.cli.console import print_json, progress_bar, warn
from sinstool.cli.many import EXIT_HELP, Asked, workers_options
from sinstool.cli.options import config_options, effective_config, print_config
from sinstool.cli.verbose import verbose_option
from sinstool.report.text.table import table

if TYPE_CHECKING:
    from sinstool.pipelines.align.result import AlignResult

GROUPS = ("input", "align", "gnss", "in_flight")


@click.command("align", epilog=EXIT_HELP)
@click.argument("logs", nargs=-1, type=click.Path(path_type=Path), metavar="LOG...")
@workers_options("one for each core")
@config_options(*GROUPS)
@click.option(
    "--method",
    type=Choice(["svd", "quest", "davenport", "triad", "gyrocompass", "level"]),
    help="the same as --align",
)
@click.option("--imu-grade", "navigation__imu_grade",
              type=Choice(["auto", "mems", "tactical", "navigation"]),
              help="of the sensors [default: auto]")  # fmt: skip
@click.option("--series", type=click.Path(path_type=Path), metavar="FILE.csv",
              help="also write the solution at every fix")  # fmt: skip
@click.option("--truth", metavar="TOPIC|FILE.csv",
              help="reference attitudes: say how wrong the answer is")  # fmt: skip
@click.option("--report", type=click.Path(path_type=Path), metavar="FILE.html",
              help="also write a page of figures")  # fmt: skip
@click.option("--overwrite", "output__overwrite", is_flag=True, default=None,
              help="replace existing outputs")  # fmt: skip
@click.option("--print-config", "show", is_flag=True, help="print the configuration and stop")
@click.option(
    "--json", "as_json", is_flag=True, help="one JSON object on stdout, or one line for each log"
)
@click.option("-q", "--quiet", is_flag=True, help="no progress and no summary")
@verbose_option()
def command(
    logs: tuple[Path, ...],
    jobs: int | None,
    scheduler: str | None,
    config_file: Path | None,
    method: str | None,
    series: Path | None,
    truth: str | None,
    report: Path | None,
    show: bool,
    as_json: bool,
    quiet: bool,
    verbose: int,
    **given: Any,
) -> int:
    """Attitude of the vehicle of LOG with its covariance, or why it cannot be seen.

    \b
    In motion (svd, quest, davenport, triad) GNSS position and velocity are needed, at rest
    (gyrocompass, level) a log that begins still. Exits with 3 where heading is withheld.

    Many LOGs, a folder of them or a pattern in quotes: a row for each, and with --truth the root
    mean square of the errors, as of a Monte Carlo that `simulate --monte-carlo` made.

    \b
    Example:
      sinstool align flight.mcap --method svd --json
    """
    if method is not None:
        if given.get("align__align") not in (None, method):
            raise click.UsageError("--method and --align say different things")
        given["align__align"] = method
    config = effective_config(config_file, given)
    if show:
        print_config(config, *GROUPS)
        return 0
    if not logs:
        raise click.UsageError("give a LOG to align")
    from sinstool.campaign.inputs import are_many

    if are_many(logs):
        if series is not None or report is not None:
            raise click.UsageError("--series and --report are about one log")
        from sinstool.cli.align_many import align_many

        asked = Asked(jobs, scheduler, as_json, quiet, verbose)
        return align_many(logs, config, truth, asked)
    if scheduler is not None:
        raise click.UsageError("--scheduler is for many logs")
    log = logs[0]
    from sinstool.core.whole_file import check_output, commit_together
    from sinstool.pipelines.align.log import align_log

    if series is not None:
        check_output(series, [log], config.output.overwrite)
    if report is not None:
        from sinstool.report.page import check_report

        check_report(report, inputs=[log], overwrite=config.output.overwrite)
    with commit_together(), progress_bar(log.name, quiet) as progress:
        alignment = align_log(log, config, progress, truth)
        if series is not None:
            from sinstool.pipelines.align.log import write_series

            write_series(series, alignment, config.output.overwrite)
        if report is not None:
            from sinstool.report.pages.align import write_page

            write_page(report, alignment, config, log)
    result = alignment.result
    for text in result.warnings:
        warn(text)
    if as_json:
        print_json(result.to_json())
    elif not quiet:
        _print(result, verbose > 0)
    return result.exit_status


def _print(result: AlignResult, verbose: bool) -> None:
    rows = [
        ("log", result.input.path),
        (
            "IMU",
            f"{result.imu.topic}: {result.imu_grade.grade}, {result.imu_grade.why}",
        ),
        ("status", result.status),
        ("method", result.method + (f", vectors {result.vectors}" if result.vectors else "")),
    ]
    if result.roll_deg is not None:
        heading = (
            "not to be seen" if result.heading_deg is None else f"{result.heading_deg:.3f} deg"
        )
        rows.append(
            (
                "attitude",
                f"roll {result.roll_deg:.3f}, pitch {result.pitch_deg:.3f}, heading {heading}, at"
                f" {result.time_s:.3f} s",
            )
        )
        shown = ["-" if s is None else f"{s:.3g}" for s in result.sigma_deg]
        rows.append(("sigma", f"{', '.join(shown)} deg about north, east, down"))
    if result.n_pairs and result.start_s is not None and result.stop_s is not None:
        rows.append(
            (
                "used",
                f"{result.n_pairs} pairs from {result.start_s:.1f} to {result.stop_s:.1f} s,"
                f" {result.n_rejected} fixes rejected, chi2 {result.chi2:.2f}",
            )
        )
    if result.truth is not None and result.truth.error_deg is not None:
        shown = ["-" if e is None else f"{e:.3g}" for e in result.truth.error_deg]
        rows.append(
            (
                "error",
                f"{', '.join(shown)} deg about north, east, down, by {result.truth.name}",
            )
        )
    if verbose and result.refined_chi2 is not None:
        rows.append(("refinement", f"chi2 {result.refined_chi2:.2f}"))
    if verbose and result.observability is not None:
        rows.append(("geometry", f"{result.observability:.4f} (0: one direction only; 1: best)"))
    if verbose and result.gyro_bias_deg_h is not None:
        bias = ", ".join(f"{b:.4g}" for b in result.gyro_bias_deg_h)
        rows.append(("gyro bias", f"{bias} deg/h (FRD)"))
    table(rows)
