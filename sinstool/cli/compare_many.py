"""`sinstool compare-coning` on many logs."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sinstool.campaign.inputs import find_logs, output_paths
from sinstool.campaign.jobs import Job, Outcome
from sinstool.cli.compare_one import compare_one, told
from sinstool.cli.many import (
    Asked,
    absolute,
    finish,
    page_paths,
    row_of,
    work_through,
    workers_of,
)
from sinstool.core.whole_file import check_new_folder, make_folder
from sinstool.io.readers.log import path_size
from sinstool.pipelines.provenance import files
from sinstool.report.text.coning import drift, shown, write_table
from sinstool.report.text.table import columns

if TYPE_CHECKING:
    from sinstool.config import ProcessConfig
    from sinstool.pipelines.compare_coning.compare import Settings

SUMMARY = "summary.csv"
SUMMARY_COLUMNS = ("log", "status", "algorithm", "kept 1 of", "input", "drift [deg/h rms]")


def compare_many(given: Sequence[Path], options: dict[str, Any]) -> int:
    """Compare on every log, and over all.

    Parameters
    ----------
    given : sequence of Path
        Files, folders, patterns.
    options : dict
        Of the command line; ``csv_dir`` and ``report`` are folders.

    Returns
    -------
    int
        Exit status.
    """
    config, settings = told(options)
    config = absolute(config)
    folder = options["csv_dir"]
    asked = Asked(**{one.name: options[one.name] for one in fields(Asked)})
    if folder is not None:
        check_new_folder(folder, "--csv")
    logs = find_logs(given)
    paths = [log.path.absolute() for log in logs]
    tables: list[Path | None] = [None] * len(logs)
    if folder is not None:
        tables = [path.with_suffix("").absolute() for path in output_paths(logs, folder)]
    pages = page_paths(options["report"], logs)
    kept = {k: v for k, v in options.items() if "__" not in k}
    for name in ("truth", "gyro_response"):
        if kept[name] is not None and Path(kept[name]).is_file():
            kept[name] = str(Path(kept[name]).absolute())
    named = [Path(kept[k]) for k in ("truth", "gyro_response") if kept[k] is not None]
    reads = [*paths, *files(config).values(), *(p for p in named if p.is_file())]
    workers = workers_of(asked, reads, len(logs))
    jobs = []
    for log, path, table, page in zip(logs, paths, tables, pages, strict=True):
        folders = [p.parent for p in (table, page) if p is not None]
        for wanted in folders:
            make_folder(wanted)
        own = {**kept, "csv_dir": table, "report": page}
        arguments = (path, config, settings, own)
        jobs.append(
            Job(str(log.path), compare_one_of_many, arguments, path_size(path), tuple(folders))
        )

    def row(number: int, outcome: Outcome) -> dict[str, Any]:
        return row_of(outcome, paths[number])

    rows = work_through(jobs, workers, row, asked)
    names = [str(log.path) for log in logs]
    over_all = summary(names, rows)
    if folder is not None:
        _write_summary(folder / SUMMARY, names, rows)
    if not asked.as_json:  # with -q too, which is about progress here
        columns(*_table(names, rows))
        if over_all:
            click.echo()
            columns(ALGORITHM, over_all)
    return finish(rows, asked)


def compare_one_of_many(
    path: Path, config: ProcessConfig, settings: Settings, options: dict[str, Any], progress: Any
) -> dict[str, Any]:
    """One of many: the comparison on a log with ``input``, ``status`` and ``exit``.

    Raises
    ------
    SinstoolError
    """
    if options["report"] is not None:
        from sinstool.report.page import check_report

        check_report(options["report"], inputs=[path], overwrite=options["overwrite"])
    result = compare_one(path, config, settings, options, progress)
    status = {"status": "lost", "exit": 3} if result["lost"] else {"status": "done", "exit": 0}
    return {"input": {"path": str(path)}, **result, **status}


ALGORITHM = ("algorithm", "logs", "median deg/h rms", "worst", "of the log")


def summary(names: Sequence[str], rows: Sequence[dict[str, Any]]) -> list[tuple[str, ...]]:
    """What each algorithm does over all logs, as they are: the drift's median and its worst."""
    drifts: dict[str, list[tuple[float, str]]] = {}
    for name, row in zip(names, rows, strict=True):
        for alg in row.get("algs", ()):
            value = drift("slope_rms")(alg)
            if alg["decimate"] == 1 and value is not None and value == value:
                drifts.setdefault(alg["name"], []).append((value, name))
    found: list[tuple[str, ...]] = []
    for algorithm, values in drifts.items():
        worst, log = max(values)
        middle = statistics.median(value for value, _ in values)
        found.append((algorithm, str(len(values)), shown(middle), shown(worst), log))
    return found


HEADER = ("status", "log", "samples", "Hz", "gaps", "reference", "take")


def _table(
    names: Sequence[str], rows: Sequence[dict[str, Any]]
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    return HEADER, [
        (row["status"], name, *_cells(row)) for name, row in zip(names, rows, strict=True)
    ]


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
            value = drift("slope_rms")(alg) if alg else None
            said = [alg.get(k, "") for k in ("name", "decimate", "input")]
            cells.append((name, row["status"], *said, "" if value is None else value))
    write_table(path, SUMMARY_COLUMNS, cells)
