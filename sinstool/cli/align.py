"""`sinstool align`: attitude of a vehicle, at rest or in motion, in one log or many."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sinstool.campaign.inputs import are_many, find_logs
from sinstool.cli import many
from sinstool.cli.batch import (
    EXIT_HELP,
    BatchOptions,
    batch_options,
    full_name,
    show_result,
    with_full_names,
    workers_options,
)
from sinstool.cli.console import Choice, PathName, progress_bar
from sinstool.cli.help import Command, Option
from sinstool.cli.options import config_options, effective_config, path_option, print_config
from sinstool.config import ALIGN_OPTIONS, ProcessConfig
from sinstool.core.english import counted, heading_text

if TYPE_CHECKING:
    from sinstool.pipelines.align.result import AlignResult

MAIN = ("align__align", "report", "series", "truth", "output__overwrite")
AXES = ("north", "east", "down")


@click.command("align", cls=Command, first=MAIN, epilog=EXIT_HELP)
@click.argument("logs", nargs=-1, type=PathName(), metavar="LOG...")
@workers_options("one for each core")
@config_options(*ALIGN_OPTIONS)
@click.option(
    "--method",
    type=Choice(["svd", "quest", "davenport", "triad", "gyrocompass", "level"]),
    help="same as --align",
    cls=Option,
    section="First attitude",
)
@path_option("--series", metavar="FILE.csv", text="also write the solution at every fix")
@click.option("--truth", metavar="TOPIC|FILE.csv",
              help="reference attitudes, to show the error")  # fmt: skip
@path_option("--report", metavar="FILE.html", text="also write a page of figures")
@batch_options()
def command(
    logs: tuple[Path, ...],
    config_file: Path | None,
    method: str | None,
    series: Path | None,
    truth: str | None,
    report: Path | None,
    show: bool,
    batch: BatchOptions,
    **flags: Any,
) -> int:
    """Find the attitude at the start of LOG, with its covariance, or say why it is unknown.

    Alignment in motion (svd, quest, davenport, triad) needs GNSS; alignment at rest (gyrocompass,
    level) needs a log that begins at rest. The exit status is 3 if heading is withheld.

    Several LOGs, a folder or a quoted pattern give a table with a line for each log, and with
    --truth the rms errors over all of them.

    \b
      sinstool align flight.mcap --align svd --report align.html
    """
    if method is not None:
        if flags.get("align__align") not in (None, method):
            raise click.UsageError("--method and --align contradict each other")
        flags["align__align"] = method
    config = effective_config(config_file, flags)
    if show:
        print_config(config, *ALIGN_OPTIONS)
        return 0
    if not logs:
        raise click.UsageError("give a LOG to align")
    if are_many(logs):
        if series is not None or report is not None:
            raise click.UsageError("--series and --report are for a single log")
        return align_many(logs, config, truth, batch)
    if batch.scheduler is not None:
        raise click.UsageError("--scheduler is for many logs")
    log = logs[0]
    from sinstool.core.whole_file import check_output, commit_together
    from sinstool.pipelines.align.log import align_log, write_series
    from sinstool.report.page import check_report

    if series is not None:
        if series.suffix.lower() not in ("", ".csv"):
            table = series.with_suffix(".csv")
            raise click.UsageError(f"--series {series}: the table is CSV, give --series {table}")
        check_output(series, [log], config.output.overwrite)
    check_report(report, inputs=[log], overwrite=config.output.overwrite)
    with commit_together(), progress_bar(log.name, batch.quiet) as progress:
        alignment = align_log(log, config, progress, truth)
        if series is not None:
            write_series(series, alignment, config.output.overwrite)
        if report is not None:
            from sinstool.report.pages.align import write_page

            write_page(report, alignment, config, log)
    return show_result(alignment.result, batch, _rows)


def _rows(result: AlignResult, verbose: bool) -> list[tuple[str, str]]:
    """The summary as pairs of label and text."""
    rows = [
        ("log", result.input.path),
        ("IMU", f"{result.imu.topic}: {result.imu_grade.grade}, {result.imu_grade.why}"),
        ("status", result.status),
        ("method", result.method_text),
    ]
    if result.roll_deg is not None:
        heading = (
            "not observable"
            if result.heading_deg is None
            else f"{heading_text(result.heading_deg, 3)} deg"
        )
        angles = f"roll {result.roll_deg:z.3f}, pitch {result.pitch_deg:z.3f}, heading {heading}"
        rows.append(("attitude", f"{angles}, at {result.time_s:.3f} s"))
        shown = ["-" if s is None else f"{s:.3g}" for s in result.sigma_deg]
        rows.append(("sigma", f"{', '.join(shown)} deg about north, east, down"))
    if result.n_pairs and result.start_s is not None and result.stop_s is not None:
        pairs = f"{result.n_pairs} pairs from {result.start_s:.1f} to {result.stop_s:.1f} s"
        rejected = f"{counted(result.n_rejected or 0, 'fix')} rejected"
        rows.append(("used", f"{pairs}, {rejected}, chi2 {result.chi2:.2f}"))
    if result.truth is not None and result.truth.error_deg is not None:
        shown = ["-" if e is None else f"{e:.3g}" for e in result.truth.error_deg]
        named = f"{', '.join(shown)} deg about north, east, down, by {result.truth.name}"
        rows.append(("error", named))
    if verbose and result.refined_chi2 is not None:
        rows.append(("refinement", f"chi2 {result.refined_chi2:.2f}"))
    if verbose and result.observability is not None:
        rows.append(("geometry", f"{result.observability:.4f} (0: one direction only; 1: best)"))
    if verbose and result.gyro_bias_deg_h is not None:
        bias = ", ".join(f"{b:.4g}" for b in result.gyro_bias_deg_h)
        rows.append(("gyro bias", f"{bias} deg/h (FRD)"))
    return rows


def align_many(
    inputs: Sequence[Path], config: ProcessConfig, truth: str | None, batch: BatchOptions
) -> int:
    """Align on every log.

    Parameters
    ----------
    inputs : sequence of Path
        Files, folders, patterns.
    truth : str or None
        A topic of the logs, or a CSV file.

    Returns
    -------
    int
        Exit status.
    """
    logs, truth = find_logs(inputs), full_name(truth)
    config = with_full_names(config)
    reads = [Path(name) for name in (truth, config.navigation.imu_noise) if name is not None]
    rows = many.work_on_logs(logs, align_one, [()] * len(logs), (config, truth), reads, batch)

    def table() -> None:
        many.log_table(("method", "roll", "pitch", "heading", *AXES), logs, rows, _cells)
        what = "errors about" if truth is not None else "sigmas about"
        click.echo(f"degrees; {what} north, east and down")
        for line in _errors(rows):
            click.echo(line)

    return many.finish([str(log.path) for log in logs], rows, batch, table)


def align_one(path: Path, config: ProcessConfig, truth: str | None, progress: Any) -> AlignResult:
    """Align on one of many logs.

    Raises
    ------
    SinstoolError
    """
    from sinstool.pipelines.align.log import align_log

    return align_log(path, config, progress, truth).result


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    if "roll_deg" not in row:
        return ("-",) * 7
    shown = row["truth"]["error_deg"] if row.get("truth") else row["sigma_deg"]
    angles = [row[f"{name}_deg"] for name in ("roll", "pitch", "heading")]
    about = [_number(v, 4) for v in shown or (None,) * 3]
    return (row["method"] or "-", *(_number(v, 3) for v in angles), *about)


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _errors(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Root mean square of the errors over the logs that have one."""
    errors = [
        row["truth"]["error_deg"] for row in rows if (row.get("truth") or {}).get("error_deg")
    ]
    if not errors:
        return []
    parts = []
    for k, axis in enumerate(AXES):
        values = [error[k] for error in errors if error[k] is not None]
        if values:
            rms = sqrt(sum(v * v for v in values) / len(values))
            parts.append(f"{axis} {rms:.4f} ({len(values)})")
    return [f"rms error (logs): {', '.join(parts)}"]
