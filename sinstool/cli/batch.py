"""Options of commands that take many logs: output, workers, and file names for workers."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from sinstool.cli.console import F, PathName, print_json, verbose_option, warn
from sinstool.cli.help import Option
from sinstool.config import ProcessConfig
from sinstool.core.finding import Finding, Severity
from sinstool.report.text.table import table

if TYPE_CHECKING:
    from sinstool.campaign.jobs import Workers
    from sinstool.pipelines.align.result import AlignResult
    from sinstool.pipelines.export.result import ExportResult
    from sinstool.pipelines.process.result import ProcessResult

COLOURS = {Severity.WARNING: "yellow", Severity.LOST: "red", Severity.FAILED: "red"}
EXIT_HELP = (
    "Exit status with many logs: 1 if a log failed, else 3 if something was lost or withheld in"
    " one, else 0. The table and the lines of --json show how each log ended."
)


def workers_options(default: str) -> Callable[[F], F]:
    """Decorator: the options that choose the workers.

    Parameters
    ----------
    default : str
        Default of ``--jobs``, in words.
    """

    def decorate(function: F) -> F:
        for name, text in (
            ("--tls-key", "your key, unless it is in the file of --tls-cert"),
            ("--tls-cert", "your certificate for a cluster at tls://"),
            (
                "--tls-ca",
                "certificate of the authority that signed a tls:// cluster's certificates",
            ),
        ):
            kind = PathName(exists=True, dir_okay=False)
            function = click.option(
                name, cls=Option, section="Many logs", type=kind, metavar="FILE", help=text
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
        Number of processes on this machine.
    scheduler : str or None
        Address of the scheduler of a Dask cluster.
    as_json : bool
        Print JSON, one line for each of many logs, instead of a table.
    quiet : bool
        Print no progress bars and no summary.
    verbose : int
        How often ``-v`` was given: 1 explains choices, 2 shows tracebacks.
    tls : tuple of Path or None
        For a cluster at tls://: the authority's certificate, our certificate and our key.
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
    """Print findings that are more than notes on stderr, the gravest last, to be seen first."""
    for finding in sorted(findings, key=lambda f: f.severity):
        if finding.severity > Severity.NOTE:
            warn(str(finding), COLOURS[finding.severity])


def workers_of(batch: BatchOptions, reads: Sequence[Path], most: int) -> Workers:
    """The workers of a batch: by default a process for each core of this machine.

    Parameters
    ----------
    reads : sequence of Path
        Files that the workers read.
    most : int
        Number of jobs, beyond which more processes would be idle.

    Raises
    ------
    UsageError
        If both kinds of workers are requested, or the TLS files are incomplete.
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
    """The absolute path of a file, because workers may run in other folders."""
    return str(Path(name).absolute()) if name is not None and Path(name).is_file() else name


def with_full_names(config: ProcessConfig) -> ProcessConfig:
    """The configuration with absolute paths of its files."""
    changes: dict[str, dict[str, Any]] = {
        "hse": {"hse": full_name(config.hse.hse)},
        "navigation": {"imu_noise": full_name(config.navigation.imu_noise)},
        "coning": {"gyro_response": full_name(config.coning.gyro_response)},
        "comparison": {"truth": full_name(config.comparison.truth)},
        "output": {"truth": tuple(full_name(name) or name for name in config.output.truth)},
    }
    groups = {name: getattr(config, name).model_copy(update=v) for name, v in changes.items()}
    return config.model_copy(update=groups)
