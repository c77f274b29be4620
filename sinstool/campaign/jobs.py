"""Independent jobs, run by processes on this machine or on a cluster.

A job is a function of plain values, so that it does not matter where it runs: in a process on
this machine (`local`) or on a Dask cluster (`cluster`). Both return a stream of events.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sinstool.core import version
from sinstool.core.choices import record_choices
from sinstool.core.errors import ConfigurationError, SinstoolError
from sinstool.core.result import Result
from sinstool.core.temporary import sweep
from sinstool.core.threads import single_threaded
from sinstool.core.whole_file import completed_outputs

Report = Callable[[float], None]
# Shortest interval between two reports of progress, s
TELL_EVERY = 0.2
# Thresholds of the workers' garbage collection, for gc.set_threshold
GARBAGE = (100_000, 50, 50)


@dataclass(frozen=True)
class Job:
    """A piece of work that does not depend on any other.

    Attributes
    ----------
    name : str
        Name for messages.
    function : callable
        A function at the top level of a module, because workers import it by name. It is called as
        ``function(*arguments, progress)``, where ``progress`` takes the fraction done, and returns
        plain values, or a `Result`, of which its row is sent back.
    arguments : tuple
        Plain values.
    size : int
        Bytes of its input; the largest jobs are begun first.
    folders : tuple of Path
        Folders that it writes to.
    """

    name: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    size: int = 0
    folders: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """The outcome of a job.

    Attributes
    ----------
    value : object
        What its function returned; None if it failed.
    error : str
        One line; empty if there was no error.
    exit_code : int
        Exit status that belongs to the error.
    died : bool
        Whether it was given up because its worker died on every attempt.
    trace : str
        The traceback of the error.
    written : tuple of Path
        Files that it completed.
    choices : tuple of str
        Choices and their reasons, if the task asked for them.
    """

    value: Any = None
    error: str = ""
    exit_code: int = 0
    died: bool = False
    trace: str = ""
    written: tuple[Path, ...] = ()
    choices: tuple[str, ...] = ()


@dataclass(frozen=True)
class Event:
    """News of a job: the fraction done, or its outcome.

    Attributes
    ----------
    number : int
        Number of the job.
    fraction : float or None
        Fraction done; None with an outcome, and where the job begins anew after its worker died.
    outcome : Outcome or None
        None until the job has ended.
    """

    number: int
    fraction: float | None = None
    outcome: Outcome | None = None


@dataclass(frozen=True)
class Tls:
    """PEM files for an encrypted connection to a cluster.

    Attributes
    ----------
    authority : Path
        Certificate of the authority that signed the scheduler's and the workers' certificates;
        all others are refused.
    certificate : Path
        Our certificate.
    key : Path or None
        Our key; None if it is in the file of the certificate.
    """

    authority: Path
    certificate: Path
    key: Path | None = None


@dataclass(frozen=True)
class Workers:
    """Where jobs are done, and by how many processes.

    Attributes
    ----------
    processes : int
        Number of processes on this machine.
    scheduler : str or None
        Address of a Dask scheduler, whose workers do the jobs instead.
    reads : tuple of Path
        Inputs, which workers on other machines must see under the same paths.
    tls : Tls or None
        For a scheduler at ``tls://``.
    """

    processes: int = 1
    scheduler: str | None = None
    reads: tuple[Path, ...] = ()
    tls: Tls | None = None


@dataclass(frozen=True)
class Task:
    """A job with the data that its worker needs.

    Attributes
    ----------
    number : int
        Position of the job among all jobs.
    version : str
        The client's version of sinstool.
    log_choices : bool
        Whether the outcome is to hold what was chosen, and why.
    """

    number: int
    job: Job
    version: str = version.VERSION
    log_choices: bool = False


def perform(task: Task, tell: Report) -> Outcome:
    """Run a job in this thread; an error becomes part of the outcome.

    Parameters
    ----------
    tell : callable
        Called with the fraction done now and then; an exception that it raises ends the job.
    """
    if task.version != version.VERSION:
        said = f"this worker has sinstool {version.VERSION}, the client {task.version}"
        return Outcome(error=f"{task.job.name}: {said}", exit_code=ConfigurationError.exit_code)
    with (
        single_threaded(),
        record_choices(task.log_choices) as choices,
        completed_outputs() as outputs,
    ):
        outcome = _perform(task.job, tell)
    return replace(outcome, written=tuple(outputs), choices=tuple(choices))


def _perform(job: Job, tell: Report) -> Outcome:
    try:
        value = job.function(*job.arguments, _seldom(tell))
        return Outcome(value=value.row() if isinstance(value, Result) else value)
    except SinstoolError as exc:
        return Outcome(error=str(exc), exit_code=exc.exit_code, trace=traceback.format_exc())
    except MemoryError:
        return Outcome(error=f"{job.name}: out of memory", exit_code=1)
    except Exception as exc:
        said = f"{job.name}: {type(exc).__name__}: {' '.join(str(exc).split())}"
        return Outcome(error=said, exit_code=1, trace=traceback.format_exc())


def _seldom(tell: Report) -> Report:
    """Pass reports of progress on, but not too often."""
    last = time.monotonic() - TELL_EVERY

    def report(fraction: float) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= TELL_EVERY:
            last = now
            tell(fraction)

    return report


def remove_left(task: Task) -> int:
    """Remove the unfinished files of a dead worker.

    Returns
    -------
    int
        Number of unfinished files in the same folders that are still open somewhere.
    """
    return sum(sweep(folder) for folder in task.job.folders)


def largest_first(tasks: Sequence[Task]) -> list[Task]:
    """Tasks in the order in which they are begun, so that no long one is left to the end."""
    return sorted(tasks, key=lambda task: (-task.job.size, task.number))
