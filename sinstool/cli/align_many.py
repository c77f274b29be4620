"""`sinstool align` on many logs: each answer, and with a truth how wrong they are over all."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sinstool.campaign.inputs import find_logs
from sinstool.campaign.jobs import Job
from sinstool.cli.many import BatchOptions, finish, log_table, row_of, work_through, workers_of
from sinstool.io.readers.log import path_size

if TYPE_CHECKING:
    from sinstool.config import ProcessConfig

AXES = ("north", "east", "down")


def align_many(
    inputs: Sequence[Path], config: ProcessConfig, truth: str | None, batch: BatchOptions
) -> int:
    """Align on every log.

    Parameters
    ----------
    inputs : sequence of Path
        Files, folders, patterns.
    truth : str or None
        A topic of the logs, or a file.

    Returns
    -------
    int
        Exit status.
    """
    logs = find_logs(inputs)
    paths = [log.path.absolute() for log in logs]
    reads = list(paths)
    if truth is not None and Path(truth).is_file():
        truth = str(Path(truth).absolute())
        reads.append(Path(truth))
    workers = workers_of(batch, reads, len(logs))
    tasks = [
        Job(str(log.path), align_one, (path, config, truth), path_size(path))
        for log, path in zip(logs, paths, strict=True)
    ]
    rows = work_through(tasks, workers, lambda k, outcome: row_of(outcome, paths[k]), batch)
    names = [str(log.path) for log in logs]

    def table() -> None:
        log_table(("method", "roll", "pitch", "heading", *AXES), names, rows, _cells)
        what = "errors about" if truth is not None else "sigmas about"
        click.echo(f"degrees; {what} north, east and down")
        for line in _errors(rows):
            click.echo(line)

    return finish(rows, batch, table)


def align_one(path: Path, config: ProcessConfig, truth: str | None, progress: Any) -> Any:
    """One of many: the values of ``--json`` with ``exit``.

    Raises
    ------
    SinstoolError
    """
    from sinstool.pipelines.align.log import align_log

    result = align_log(path, config, progress, truth).result
    return {**result.to_json(), "exit": result.exit_status}


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
