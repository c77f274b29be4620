"""A command on many logs: its jobs, bars, JSON lines, table, warnings and exit status."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sinstool.cli.batch import BatchOptions, workers_of
from sinstool.cli.console import plain, warn
from sinstool.report.text.status import shown_status
from sinstool.report.text.table import columns

if TYPE_CHECKING:
    from sinstool.campaign.inputs import LogInput
    from sinstool.campaign.jobs import Job, Outcome, Workers

INTERRUPTED = 130
# Most logs that a warning names
NAMED = 3


def log_table(
    header: Sequence[str],
    logs: Sequence[LogInput],
    rows: Sequence[dict[str, Any]],
    cells: Callable[[dict[str, Any]], Sequence[str]],
) -> None:
    """Print a line for each log: its status, its path, and the columns that `cells` makes."""
    lines = [
        (shown_status(row), str(log.path), *cells(row)) for log, row in zip(logs, rows, strict=True)
    ]
    columns(("status", "log", *header), lines)


def page_paths(
    folder: Path | None, logs: Sequence[LogInput]
) -> tuple[list[Path | None], Path | None]:
    """Paths of the pages, one for each log, in the folder that ``--report`` names.

    Returns
    -------
    list of Path or None
        One for each log; None without a folder.
    Path or None
        The script that draws the figures of all pages; it is written here.

    Raises
    ------
    UsageError
        The folder has the name of a file.
    OutputError
        The script cannot be written.
    """
    if folder is None:
        return [None] * len(logs), None
    from sinstool.campaign.inputs import output_paths
    from sinstool.report.library import share_script

    if folder.suffix.lower() in (".html", ".htm", ".png", ".pdf", ".svg"):
        raise click.UsageError(
            f"--report {folder}: with many logs give a folder, which gets a page for each"
        )
    pages: list[Path | None] = [path.absolute() for path in output_paths(logs, folder, ".html")]
    return pages, share_script(folder)


def work_on_logs(
    logs: Sequence[LogInput],
    function: Callable[..., Any],
    outputs: Sequence[tuple[Path | None, ...]],
    settings: tuple[Any, ...],
    reads: Sequence[Path],
    batch: BatchOptions,
    named: bool = False,
) -> list[dict[str, Any]]:
    """Do one job for each log, as :func:`work_through` does jobs.

    Parameters
    ----------
    function : callable
        Takes the log, its outputs, the settings, and a callable that is passed the fraction done.
    outputs : sequence of tuple
        Paths of the outputs of each log; None for one that is not requested.
    reads : sequence of Path
        Files that workers read besides the logs.
    named : bool
        Whether the row of a log that failed names its first output.

    Returns
    -------
    list of dict
        A row for each log.
    """
    from sinstool.campaign.jobs import Job
    from sinstool.core.whole_file import make_folder
    from sinstool.io.readers.log import path_size

    paths = [log.path.absolute() for log in logs]
    workers = workers_of(batch, [*paths, *(path.absolute() for path in reads)], len(logs))
    jobs = []
    for log, path, written in zip(logs, paths, outputs, strict=True):
        folders = tuple(output.parent for output in written if output is not None)
        for folder in folders:
            make_folder(folder)
        arguments = (path, *written, *settings)
        jobs.append(Job(str(log.path), function, arguments, path_size(path), folders))

    def row(number: int, outcome: Outcome) -> dict[str, Any]:
        return row_of(outcome, paths[number], outputs[number][0] if named else None)

    return work_through(jobs, workers, row, batch)


def work_through(
    jobs: Sequence[Job],
    workers: Workers,
    row: Callable[[int, Outcome], dict[str, Any]],
    batch: BatchOptions,
) -> list[dict[str, Any]]:
    """Do all jobs; errors are printed on stderr as they occur.

    Parameters
    ----------
    row : callable
        Makes the row of ``--json``, with ``status`` and ``exit``, from a job's number and outcome,
        usually by :func:`row_of`.
    batch : BatchOptions
        With ``as_json`` a line is printed for each row, in the order of the jobs.

    Returns
    -------
    list of dict
        The rows.

    Raises
    ------
    click.exceptions.Exit
        With status 130 if interrupted, after printing how many jobs are complete.
    """
    from sinstool.campaign.run import run_jobs

    ended: dict[int, dict[str, Any]] = {}
    printed = 0
    try:
        with (
            _bars(jobs, batch.quiet) as show,
            contextlib.closing(run_jobs(jobs, workers)) as events,
        ):
            for event in events:
                show(event.number, event.fraction, event.outcome is not None)
                if event.outcome is None:
                    continue
                ended[event.number] = row(event.number, event.outcome)
                if event.outcome.error:
                    trace = f"{event.outcome.trace}\n" if batch.verbose > 1 else ""
                    click.echo(f"{trace}sinstool: {event.outcome.error}", err=True)
                while batch.as_json and printed in ended:
                    click.echo(json.dumps(plain(ended[printed]), allow_nan=False))
                    printed += 1
    except KeyboardInterrupt:
        click.echo(f"sinstool: interrupted; {len(ended)} of {len(jobs)} are complete", err=True)
        raise click.exceptions.Exit(INTERRUPTED) from None
    return [ended[number] for number in range(len(jobs))]


def finish(
    names: Sequence[str],
    rows: Sequence[dict[str, Any]],
    batch: BatchOptions,
    table: Callable[[], None] | None = None,
    where: str = "",
) -> int:
    """Print the table (unless JSON was printed), the warnings, and the number of logs by status.

    Parameters
    ----------
    names : sequence of str
        The logs.
    rows : sequence of dict
        The rows that :func:`work_through` returns.
    table : callable, optional
        Prints the table.
    where : str
        Text for the end of the last line: where the outputs are.

    Returns
    -------
    int
        Exit status: 1 if a log failed, else 3 if something was lost in one, else 0.
    """
    if table is not None and not batch.as_json and not batch.quiet:
        table()
    _warn_together(names, rows)
    if not batch.quiet:
        words = sorted(shown_status(row) for row in rows)
        counted = [f"{words.count(word)} {word}" for word in dict.fromkeys(words)]
        logs = "log" if len(rows) == 1 else "logs"
        click.echo(f"{len(rows)} {logs}: {', '.join(counted)}{where}", err=batch.as_json)
    codes = {row["exit"] for row in rows}
    if codes - {0, 3}:
        return 1
    return 3 if 3 in codes else 0


def _warn_together(names: Sequence[str], rows: Sequence[dict[str, Any]]) -> None:
    """Print findings of many logs on stderr, a line for each kind with the logs that have it."""
    about: dict[str, dict[str, str]] = {}
    for name, row in zip(names, rows, strict=True):
        for finding in row.get("findings", ()):
            if finding["severity"] != "note":
                text = ": ".join(filter(None, (finding["text"], finding["answer"])))
                about.setdefault(finding["kind"], {}).setdefault(name, text)
    for by_log in about.values():
        logs, different = list(by_log), list(dict.fromkeys(by_log.values()))
        shown = ", ".join(logs[:NAMED])
        more = f" and {len(logs) - NAMED} more" if len(logs) > NAMED else ""
        others = "" if len(different) == 1 else f" (shown: {logs[0]}; the others are similar)"
        warn(f"{shown}{more}: {different[0]}{others}")


@contextlib.contextmanager
def _bars(jobs: Sequence[Job], quiet: bool) -> Iterator[Callable[[int, float | None, bool], None]]:
    """Show a bar for all jobs and one for each that is running, if stderr is a terminal."""
    if quiet or not sys.stderr.isatty():
        yield lambda number, fraction, ended: None
        return
    from rich import progress
    from rich.console import Console

    # Jobs without an input, as those of `simulate`, have no size.
    in_bytes = any(job.size for job in jobs)
    with progress.Progress(
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.DownloadColumn() if in_bytes else progress.MofNCompleteColumn(),
        progress.TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        # otherwise rich would send lines of JSON to stderr
        redirect_stdout=sys.stdout.isatty(),
    ) as bar:
        every = bar.add_task(f"0 of {len(jobs)}", total=sum(job.size for job in jobs) or len(jobs))
        running: dict[int, progress.TaskID] = {}
        done: dict[int, float] = {}
        ends: set[int] = set()

        def show(number: int, fraction: float | None, ended: bool) -> None:
            job = jobs[number]
            if number not in running and not ended:
                running[number] = bar.add_task(Path(job.name).name, total=job.size or 1)
            done[number] = (1.0 if ended else fraction or 0.0) * (job.size or 1)
            if ended:
                ends.add(number)
                if number in running:
                    bar.remove_task(running.pop(number))
            else:
                bar.update(running[number], completed=done[number])
            name = f"{len(ends)} of {len(jobs)}"
            bar.update(every, completed=sum(done.values()), description=name)

        yield show


def row_of(outcome: Outcome, log: Path, output: Path | None = None) -> dict[str, Any]:
    """The row of a log: the result of its job, or its status and error."""
    if not outcome.error:
        row: dict[str, Any] = outcome.value
        return row
    row = {"input": {"path": str(log)}}
    if output is not None:
        row["output"] = {"path": str(output)}
    status = "missing" if outcome.died else "failed"
    return {**row, "status": status, "exit": outcome.exit_code, "error": outcome.error}
