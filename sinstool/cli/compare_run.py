"""Comparisons of coning algorithms on one log or on many, with their tables and pages."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from sinstool.campaign.inputs import find_logs, output_paths
from sinstool.cli import many
from sinstool.cli.batch import BatchOptions, with_full_names
from sinstool.config import ProcessConfig
from sinstool.core.progress import Progress
from sinstool.core.whole_file import commit_together, write_table
from sinstool.pipelines.compare_coning.log import compare_log
from sinstool.pipelines.compare_coning.summary import ComparisonResult, summarise
from sinstool.pipelines.provenance import files
from sinstool.report.figures.coning import figures
from sinstool.report.page import check_report, write_report
from sinstool.report.pages.compare_coning import comparison_page
from sinstool.report.text.coning import LINE_END, shown, write_csv
from sinstool.report.text.table import columns

SUMMARY = "summary.csv"
SUMMARY_COLUMNS = ("log", "status", "algorithm", "kept 1 of", "input", "drift [deg/h rms]")
HEADER = ("samples", "Hz", "gaps", "reference", "take")
ALGORITHM = ("algorithm", "logs", "median deg/h rms", "worst", "of the log")


def compare_one(
    log: Path,
    tables: Path | None,
    report: Path | None,
    config: ProcessConfig,
    overwrite: bool,
    script: Path | None,
    progress: Progress | None,
) -> ComparisonResult:
    """Compare on a log, and write its outputs, all or none.

    Parameters
    ----------
    tables : Path or None
        Folder for CSV files.
    report : Path or None
        Page of figures, or one figure.
    overwrite : bool
        Whether the report may be replaced.
    script : Path or None
        Script that draws the figures, where many pages share it.

    Raises
    ------
    SinstoolError
    """
    check_report(report, inputs=[log], overwrite=overwrite)
    comparison = compare_log(log, config, progress)
    result = summarise(comparison)
    with commit_together():
        if tables is not None:
            write_csv(tables, result)
        if report is not None:
            page = comparison_page(log, figures(comparison), config, result)
            write_report(report, page, overwrite=overwrite, script=script)
    return result


def compare_many(
    inputs: Sequence[Path],
    config: ProcessConfig,
    csv: Path | None,
    report: Path | None,
    overwrite: bool,
    batch: BatchOptions,
) -> int:
    """Compare on every log, and summarise over all of them.

    Parameters
    ----------
    inputs : sequence of Path
        Files, folders, patterns.
    csv, report : Path or None
        Folders, with a folder of tables and a page for each log.
    overwrite : bool
        Whether pages may be replaced.

    Returns
    -------
    int
        Exit status.
    """
    config = with_full_names(config)
    truth = config.comparison.truth
    reads = [*files(config).values(), *([] if truth is None else [Path(truth)])]
    logs = find_logs(inputs)
    tables: list[Path | None] = [None] * len(logs)
    if csv is not None:
        tables = [path.with_suffix("").absolute() for path in output_paths(logs, csv)]
    pages, script = many.page_paths(report, logs)
    written = list(zip(tables, pages, strict=True))
    settings = (config, overwrite, script)
    rows = many.work_on_logs(logs, compare_one, written, settings, reads, batch)
    names = [str(log.path) for log in logs]
    over_all = summary(names, rows)
    if csv is not None:
        _write_summary(csv / SUMMARY, names, rows)
    if not batch.as_json:  # with -q too, which is about progress here
        many.log_table(HEADER, logs, rows, _cells)
        if over_all:
            click.echo()
            columns(ALGORITHM, over_all)
    return many.finish(names, rows, batch)


def summary(names: Sequence[str], rows: Sequence[dict[str, Any]]) -> list[tuple[str, ...]]:
    """Median and worst drift of each algorithm over all logs at their own rates."""
    drifts: dict[str, list[tuple[float, str]]] = {}
    for name, row in zip(names, rows, strict=True):
        for alg in row.get("algs", ()):
            value = _drift(alg)
            if alg["decimate"] == 1 and value is not None and value == value:
                drifts.setdefault(alg["name"], []).append((value, name))
    lines: list[tuple[str, ...]] = []
    for algorithm, values in drifts.items():
        worst, log = max(values)
        middle = statistics.median(value for value, _ in values)
        lines.append((algorithm, str(len(values)), shown(middle), shown(worst), log))
    return lines


def _drift(alg: dict[str, Any]) -> float | None:
    drift: dict[str, Any] | None = alg.get("drift_dph")
    return None if drift is None else drift["slope_rms"]


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    if "meta" not in row:
        return ("-",) * 5
    checks = row["checks"]
    return (
        str(row["meta"]["samples"]),
        f"{checks['rate_hz']:.2f}",
        str(checks["gaps"]),
        row["reference"]["name"],
        row["verdict"]["algorithm"] or "-",
    )


def _write_summary(path: Path, names: Sequence[str], rows: Sequence[dict[str, Any]]) -> None:
    """Every algorithm on every log in one table."""
    cells: list[Sequence[Any]] = []
    for name, row in zip(names, rows, strict=True):
        for alg in row.get("algs", ({},)):
            value = _drift(alg)
            which = [alg.get(k, "") for k in ("name", "decimate", "input")]
            cells.append((name, row["status"], *which, "" if value is None else value))
    write_table(path, SUMMARY_COLUMNS, cells, LINE_END)
