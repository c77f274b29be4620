"""Functions shared by commands on many logs: workers, bars, JSON lines, exit status."""

from __future__ import annotations

import contextlib
import functools
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from sinstool.cli.console import F, plain, print_json, verbose_option, warn
from sinstool.cli.help import Option
from sinstool.config import ProcessConfig
from sinstool.core.finding import Finding, Severity
from sinstool.report.text.table import columns, table

if TYPE_CHECKING:
    from sinstool.campaign.inputs import LogInput
    from sinstool.campaign.jobs import Job, Outcome, Workers
    from sinstool.pipelines.align.result import AlignResult
    from sinstool.pipelines.export.result import ExportResult
    from sinstool.pipelines.process.result import ProcessResult

INTERRUPTED = 130
COLOURS = {Severity.WARNING: "yellow", Severity.LOST: "red", Severity.FAILED: "red"}
# So many names of logs behind a warning
NAMED = 3
EXIT_HELP = (
    "Exit status with many logs: 1 if a log failed, else 3 if something was lost or withheld in"
    " one, else 0; the table, and each line of --json, have the status of the single log."
)


def workers_options(default: str) -> Callable[[F], F]:
    """Decorator: the options that say who works.

    Parameters
    ----------
    default : str
        Of ``--jobs``, in words.
    """

    def decorate(function: F) -> F:
        for name, of in (
            ("--tls-key", "your key, unless it is in the file of --tls-cert"),
            ("--tls-cert", "your certificate for a cluster at tls://"),
            (
                "--tls-ca",
                "certificate of the authority that signed a tls:// cluster's certificates",
            ),
        ):
            kind = click.Path(exists=True, dir_okay=False, path_type=Path)
            function = click.option(
                name, cls=Option, section="Many logs", type=kind, metavar="FILE", help=of
            )(function)
        function = click.option(
            "--scheduler",
            metavar="tcp://HOST:PORT",
            help="use a Dask cluster that sees the same files",
        )(function)
        return click.option(
            "-j",
            "--jobs",
            type=click.IntRange(min=1),
            metavar="N",
            help=f"processes on this machine [default: {default}]",
        )(function)

    return decorate


@dataclass(frozen=True)
class BatchOptions:
    """How a command runs on one or many logs, and what it prints.

    Attributes
    ----------
    jobs : int or None
        Processes of this machine.
    scheduler : str or None
        Address of that of a Dask cluster.
    as_json : bool
        A line of JSON for each log instead of a table.
    quiet : bool
        No bars and no summary.
    verbose : int
        How often ``-v`` stands in the command: twice for tracebacks.
    tls : tuple of Path or None
        Certificate of the authority, our certificate, and our key, for a cluster.
    """

    jobs: int | None = None
    scheduler: str | None = None
    as_json: bool = False
    quiet: bool = False
    verbose: int = 0
    tls: tuple[Path | None, Path | None, Path | None] = (None, None, None)


def batch_options(
    also: str = "",
    json_of: str = ", or one line for each log",
    quiet_of: str = "no progress and no summary",
) -> Callable[[F], F]:
    """Decorator: options for output and workers, passed to the command as ``batch``.

    Parameters
    ----------
    also : str
        What ``-v`` shows besides choices.
    json_of : str
        What ``--json`` prints besides one object.
    quiet_of : str
        What ``-q`` leaves out.
    """

    def decorate(function: F) -> F:
        @functools.wraps(function)
        def command(
            as_json: bool,
            quiet: bool,
            verbose: int,
            jobs: int | None = None,
            scheduler: str | None = None,
            tls_ca: Path | None = None,
            tls_cert: Path | None = None,
            tls_key: Path | None = None,
            **options: Any,
        ) -> Any:
            tls = (tls_ca, tls_cert, tls_key)
            batch = BatchOptions(jobs, scheduler, as_json, quiet, verbose, tls)
            return function(batch=batch, **options)

        text = f"one JSON object on stdout{json_of}"
        for option in (
            verbose_option(also),
            click.option("-q", "--quiet", is_flag=True, help=quiet_of),
            click.option("--json", "as_json", is_flag=True, help=text),
            click.option(
                "--print-config", "show", is_flag=True, help="print the configuration and stop"
            ),
        ):
            command = option(command)
        return cast(F, command)

    return decorate


def show_result(
    result: ProcessResult | AlignResult | ExportResult,
    batch: BatchOptions,
    rows: Callable[[Any, bool], list[tuple[str, str]]],
) -> int:
    """Print the result of one log: JSON or a summary, then its warnings.

    Parameters
    ----------
    rows : callable
        Makes the summary of the result; its second argument asks for details.

    Returns
    -------
    int
        Exit status.
    """
    if batch.as_json:
        print_json(result.to_json())
    elif not batch.quiet:
        table(rows(result, batch.verbose > 0))
    warn_of(result.findings)
    return result.exit_status


def warn_of(findings: Iterable[Finding]) -> None:
    """Findings that are more than notes on stderr, the gravest last, where the eye falls."""
    for finding in sorted(findings, key=lambda f: f.severity):
        if finding.severity > Severity.NOTE:
            warn(str(finding), COLOURS[finding.severity])


def log_table(
    header: Sequence[str],
    logs: Sequence[LogInput],
    rows: Sequence[dict[str, Any]],
    cells: Callable[[dict[str, Any]], Sequence[str]],
) -> None:
    """A line for each log on stdout: its status, its name, and the columns of `cells`."""
    lines = [
        (row["status"], str(log.path), *cells(row)) for log, row in zip(logs, rows, strict=True)
    ]
    columns(("status", "log", *header), lines)


def workers_of(batch: BatchOptions, reads: Sequence[Path], most: int) -> Workers:
    """The workers of a batch: by default a process for each core of this machine.

    Parameters
    ----------
    most : int
        Jobs that there are.

    Raises
    ------
    UsageError
        Both kinds of workers are named, or encryption only in part.
    """
    from sinstool.campaign.jobs import Tls, Workers

    if batch.jobs is not None and batch.scheduler is not None:
        raise click.UsageError(
            "--jobs is for this machine and --scheduler for a cluster: give one of them"
        )
    if batch.scheduler is not None:
        from sinstool.campaign.cluster import require_distributed

        require_distributed()
    authority, certificate, key = batch.tls
    encrypted = (batch.scheduler or "").startswith("tls://")
    tls = None
    if encrypted and authority is not None and certificate is not None:
        tls = Tls(authority, certificate, key)
    elif encrypted:
        raise click.UsageError("--scheduler tls:// needs --tls-ca and --tls-cert")
    elif any(batch.tls):
        raise click.UsageError("--tls-ca, --tls-cert and --tls-key go with --scheduler tls://")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    processes = max(1, min(batch.jobs or cores or 1, most))
    return Workers(processes, batch.scheduler, tuple(reads), tls)


def full_name(name: str | None) -> str | None:
    """The absolute name of a file, because workers may run elsewhere."""
    return str(Path(name).absolute()) if name is not None and Path(name).is_file() else name


def absolute(config: ProcessConfig) -> ProcessConfig:
    """The configuration with full names of files."""
    changes: dict[str, dict[str, Any]] = {
        "hse": {"hse": full_name(config.hse.hse)},
        "navigation": {"imu_noise": full_name(config.navigation.imu_noise)},
        "coning": {"gyro_response": full_name(config.coning.gyro_response)},
        "comparison": {"truth": full_name(config.comparison.truth)},
        "output": {"truth": tuple(full_name(name) or name for name in config.output.truth)},
    }
    groups = {name: getattr(config, name).model_copy(update=v) for name, v in changes.items()}
    return config.model_copy(update=groups)


def page_paths(
    folder: Path | None, logs: Sequence[LogInput]
) -> tuple[list[Path | None], Path | None]:
    """A page for each log, in the folder that ``--report`` names.

    Returns
    -------
    list of Path
        Of each log.
    Path or None
        The script that draws their figures, which is there then.

    Raises
    ------
    UsageError
        It is the name of a file.
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
        Takes the log, its outputs, the settings, and what shows progress.
    outputs : sequence of tuple
        What is written of each log; None for what is not.
    reads : sequence of Path
        Files that workers read besides the logs.
    named : bool
        Whether the row of a log that failed names the first of its outputs.
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
    """Do all jobs; errors go to stderr as they come.

    Parameters
    ----------
    row : callable
        Makes the row of ``--json`` from a job's number and outcome, with ``status`` and ``exit``;
        `row_of` does most of it.
    batch : BatchOptions
        With ``as_json`` a line is printed for each row, in the order of the jobs.

    Returns
    -------
    list of dict
        The rows.

    Raises
    ------
    click.exceptions.Exit
        With 130 when interrupted, after saying what is done.
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
    """Say how it went: a table, unless there were lines of JSON, warnings, and how many ended how.

    Parameters
    ----------
    names : sequence of str
        The logs.
    rows : sequence of dict
        Of :func:`work_through`.
    table : callable, optional
        Prints it.
    where : str
        Where the outputs are, for the last line.

    Returns
    -------
    int
        Exit status: 1 if a log failed, else 3 if something was lost in one, else 0.
    """
    if table is not None and not batch.as_json and not batch.quiet:
        table()
    _warn_together(names, rows)
    if not batch.quiet:
        words = sorted(row["status"] for row in rows)
        counted = [f"{words.count(word)} {word}" for word in dict.fromkeys(words)]
        logs = "log" if len(rows) == 1 else "logs"
        click.echo(f"{len(rows)} {logs}: {', '.join(counted)}{where}", err=batch.as_json)
    codes = {row["exit"] for row in rows}
    if codes - {0, 3}:
        return 1
    return 3 if 3 in codes else 0


def _warn_together(names: Sequence[str], rows: Sequence[dict[str, Any]]) -> None:
    """Findings of many logs on stderr, a line for each kind, with the logs that it is about."""
    about: dict[str, dict[str, str]] = {}
    for name, row in zip(names, rows, strict=True):
        for finding in row.get("findings", ()):
            if finding["severity"] != "note":
                text = ": ".join(filter(None, (finding["text"], finding["answer"])))
                about.setdefault(finding["kind"], {}).setdefault(name, text)
    for by_log in about.values():
        names, different = list(by_log), list(dict.fromkeys(by_log.values()))
        shown = ", ".join(names[:NAMED])
        more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
        others = "" if len(different) == 1 else f" (shown: {names[0]}; the others are similar)"
        warn(f"{shown}{more}: {different[0]}{others}")


@contextlib.contextmanager
def _bars(jobs: Sequence[Job], quiet: bool) -> Iterator[Callable[[int, float | None, bool], None]]:
    """A bar for all, and one for each log that is being worked on; on a terminal only."""
    if quiet or not sys.stderr.isatty():
        yield lambda number, fraction, ended: None
        return
    from rich import progress
    from rich.console import Console

    # What has no input has no bytes.
    in_bytes = any(job.size for job in jobs)
    with progress.Progress(
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.DownloadColumn() if in_bytes else progress.MofNCompleteColumn(),
        progress.TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        # else lines of JSON would be written to stderr
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
