"""`sinstool process` on many logs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from sinstool.campaign.inputs import find_logs, output_paths
from sinstool.campaign.jobs import Job
from sinstool.cli.many import (
    BatchOptions,
    absolute,
    finish,
    log_table,
    page_paths,
    row_of,
    work_through,
    workers_of,
)
from sinstool.cli.process_one import process_unless_done
from sinstool.config import ProcessConfig
from sinstool.core.whole_file import make_folder
from sinstool.io.readers.log import path_size
from sinstool.pipelines.provenance import files
from sinstool.report.text.process import compass

HEADER = ("samples", "Hz", "gaps", "roll", "pitch", "heading deg", "warnings")


def process_many(
    inputs: Sequence[Path], folder: Path, config: ProcessConfig, batch: BatchOptions
) -> int:
    """Process logs, each to an output of its own.

    Parameters
    ----------
    inputs : sequence of Path
        Files, folders, patterns.
    folder : Path
        Of the outputs.
    config : ProcessConfig
        ``output.report`` is a folder too.

    Returns
    -------
    int
        Exit status.
    """
    logs = find_logs(inputs, without=folder)
    if folder.suffix.lower() == ".mcap" and not folder.is_dir():
        raise click.UsageError(
            f"-o {folder}: with many logs give a folder, which gets an output for each"
        )
    outputs = [path.absolute() for path in output_paths(logs, folder)]
    report = config.output.report
    pages = page_paths(None if report is None else Path(report), logs)
    config = absolute(config)
    paths = [log.path.absolute() for log in logs]
    reads = [*paths, *files(config).values(), *_truth_files(config)]
    workers = workers_of(batch, reads, len(logs))
    for output, page in zip(outputs, pages, strict=True):
        make_folder(output.parent)
        if page is not None:
            make_folder(page.parent)
    tasks = [
        Job(
            str(log.path),
            process_unless_done,
            (path, output, page, config),
            path_size(path),
            (output.parent, *((page.parent,) if page is not None else ())),
        )
        for log, path, output, page in zip(logs, paths, outputs, pages, strict=True)
    ]
    rows = work_through(tasks, workers, lambda k, one: row_of(one, paths[k], outputs[k]), batch)
    names = [str(log.path) for log in logs]
    return finish(rows, batch, lambda: log_table(HEADER, names, rows, _cells), f", in {folder}")


def _truth_files(config: ProcessConfig) -> list[Path]:
    return [Path(name) for name in config.output.truth if Path(name).is_file()]


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    if "imu" not in row:
        return ("-",) * 7
    imu, final = row["imu"], row["final"]
    return (
        str(imu["n"]),
        f"{imu['rate_hz']:.2f}",
        str(imu["gaps"]),
        *(f"{final[name]:.3f}" for name in ("roll_deg", "pitch_deg")),
        compass(final["heading_deg"], 3),
        str(len(row["warnings"])),
    )
