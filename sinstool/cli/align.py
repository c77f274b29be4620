"""`sinstool align`: where the vehicle points, at rest or in motion."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from sinstool.cli.choice import Choice
from sinstool.cli.console import print_json, progress_bar, warn
from sinstool.cli.many import EXIT_HELP, Asked, workers_options
from sinstool.cli.options import config_options, effective_config, print_config
from sinstool.cli.verbose import verbose_option
from sinstool.report.text.table import table

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
        found = align_log(log, config, progress, truth)
        if series is not None:
            from sinstool.pipelines.align.log import write_series

            write_series(series, found, config.output.overwrite)
        if report is not None:
            from sinstool.report.pages.align import write_page

            write_page(report, found, config, log)
    told = found.summary
    for text in told["warnings"]:
        warn(text)
    if as_json:
        print_json(told)
    elif not quiet:
        _print(told, verbose > 0)
    return 0 if told["status"] in ("ok", "degraded") else 3


def _print(told: dict[str, Any], verbose: bool) -> None:
    rows = [
        ("log", told["input"]),
        (
            "IMU",
            f"{told['imu']['topic']}: {told['imu_grade']['grade']}, {told['imu_grade']['why']}",
        ),
        ("status", told["status"]),
        ("method", told["method"] + (f", vectors {told['vectors']}" if told["vectors"] else "")),
    ]
    euler, sigma = told["euler_deg"], told["sigma_deg"]
    if euler is not None:
        heading = (
            f"{euler['heading']:.3f} deg" if euler["heading"] is not None else "not to be seen"
        )
        rows.append(
            (
                "attitude",
                f"roll {euler['roll']:.3f}, pitch {euler['pitch']:.3f}, heading {heading}, at"
                f" {told['t_s']:.3f} s",
            )
        )
        shown = ["-" if s is None else f"{s:.3g}" for s in sigma]
        rows.append(("sigma", f"{', '.join(shown)} deg about north, east, down"))
    if told["n_pairs"]:
        rows.append(
            (
                "used",
                f"{told['n_pairs']} pairs from {told['start_s']:.1f} to {told['stop_s']:.1f} s,"
                f" {told['n_rejected']} fixes rejected, chi2 {told['chi2']:.2f}",
            )
        )
    if told.get("truth") and told["truth"]["error_deg"] is not None:
        shown = ["-" if e is None else f"{e:.3g}" for e in told["truth"]["error_deg"]]
        rows.append(
            ("error", f"{', '.join(shown)} deg about north, east, down, by {told['truth']['name']}")
        )
    if verbose and told["refined_chi2"] is not None:
        rows.append(("refinement", f"chi2 {told['refined_chi2']:.2f}"))
    if verbose and told["observability"] is not None:
        rows.append(("geometry", f"{told['observability']:.4f} (0: one direction only; 1: best)"))
    if verbose and told["gyro_bias_deg_h"] is not None:
        bias = ", ".join(f"{b:.4g}" for b in told["gyro_bias_deg_h"])
        rows.append(("gyro bias", f"{bias} deg/h (FRD)"))
    table(rows)
