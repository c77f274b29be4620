"""`sinstool compare-coning` on many logs."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from sinstool.campaign.inputs import find_logs, output_paths
from sinstool.campaign.jobs import Job
from sinstool.cli.compare_run import Outputs, compare_one_of_many
from sinstool.cli.many import (
    BatchOptions,
    absolute,
    finish,
    page_paths,
    row_of,
    work_through,
    workers_of,
)
from sinstool.config import ProcessConfig
from sinstool.core.whole_file import make_folder
from sinstool.io.readers.log import path_size
from sinstool.pipelines.provenance import files
from sinstool.report.text.coning import shown, write_table
from sinstool.report.text.table import columns

SUMMARY = "summary.csv"
SUMMARY_COLUMNS = ("log", "status", "algorithm", "kept 1 of", "input", "drift [deg/h rms]")


def compare_many(
    inputs: Sequence[Path], config: ProcessConfig, outputs: Outputs, batch: BatchOptions
) -> int:
    """Compare on every log, and over all.

    Parameters
    ----------
    inputs : sequence of Path
        Files, folders, patterns.
    outputs : Outputs
        ``csv`` and ``page`` are folders.

    Returns
    -------
    int
        Exit status.
    """
    config = absolute(config)
    truth, reads = config.comparison.truth, [*files(config).values()]
    if truth is not None and Path(truth).is_file():
        reads.append(Path(truth).absolute())
        comparison = config.comparison.model_copy(update={"truth": str(reads[-1])})
        config = config.model_copy(update={"comparison": comparison})
    logs = find_logs(inputs)
    paths = [log.path.absolute() for log in logs]
    tables: list[Path | None] = [None] * len(logs)
    if outputs.csv is not None:
        tables = [path.with_suffix("").absolute() for path in output_paths(logs, outputs.csv)]
    pages = page_paths(outputs.page, logs)
    workers = workers_of(batch, [*paths, *reads], len(logs))
    jobs = []
    for log, path, table, page in zip(logs, paths, tables, pages, strict=True):
        folders = tuple(p.parent for p in (table, page) if p is not None)
        for folder in folders:
            make_folder(folder)
        arguments = (path, config, Outputs(table, page, outputs.overwrite))
        jobs.append(Job(str(log.path), compare_one_of_many, arguments, path_size(path), folders))
    rows = work_through(jobs, workers, lambda k, outcome: row_of(outcome, paths[k]), batch)
    names = [str(log.path) for log in logs]
    over_all = summary(names, rows)
    if outputs.csv is not None:
        _write_summary(outputs.csv / SUMMARY, names, rows)
    if not batch.as_json:  # with -q too, which is about progress here
        cells = [(row["status"], name, *_cells(row)) for name, row in zip(names, rows, strict=True)]
        columns(HEADER, cells)
        if over_all:
            click.echo()
            columns(ALGORITHM, over_all)
    return finish(rows, batch)


ALGORITHM = ("algorithm", "logs", "median deg/h rms", "worst", "of the log")


def summary(names: Sequence[str], rows: Sequence[dict[str, Any]]) -> list[tuple[str, ...]]:
    """What each algorithm does over all logs, as they are: the drift's median and its worst."""
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


HEADER = ("status", "log", "samples", "Hz", "gaps", "reference", "take")


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
    write_table(path, SUMMARY_COLUMNS, cells)
