"""Independent jobs, run by processes of this machine or of a cluster.

A job is a function of plain values, so that it does not matter where it runs: in a process of
this machine (`local`) or of a Dask cluster (`cluster`). What comes back is a stream of events.
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
# Progress is reported at most that often, s.
TELL_EVERY = 0.2
# When workers look for garbage: objects made, and how often among older ones.
GARBAGE = (100_000, 50, 50)


@dataclass(frozen=True)
class Job:
    """Something to do, apart from everything else.

    Attributes
    ----------
    name : str
        For people.
    function : callable
        Of a module, found by name on the other side: ``function(*arguments, progress)``, where
        ``progress`` takes the fraction done. What it returns travels back, so: plain values, or a
        result, which travels as its row.
    size : int
        Bytes of its input; the largest are begun first.
    folders : tuple of Path
        Where it writes.
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
        What its function returned; None unless it did.
    error : str
        One line, empty if there was none.
    exit_code : int
        That of the error.
    died : bool
        Its worker died, again and again.
    trace : str
        The traceback, for who wants to see it.
    written : tuple of Path
        Files that it completed.
    choices : tuple of str
        Choices and their reasons, if the task asks for them.
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
        Of the job.
    fraction : float or None
        None where it was given back because its worker died.
    """

    number: int
    fraction: float | None = None
    outcome: Outcome | None = None


@dataclass(frozen=True)
class Tls:
    """Files by which a cluster and we know each other, in PEM.

    Attributes
    ----------
    authority : Path
        Certificate of the authority that signed those of scheduler and workers; who has no
        certificate from it is not talked to.
    certificate, key : Path
        Ours; no key where the certificate's file has it.
    """

    authority: Path
    certificate: Path
    key: Path | None = None


@dataclass(frozen=True)
class Workers:
    """Where and by how many processes jobs are done.

    Attributes
    ----------
    processes : int
        Of this machine.
    scheduler : str or None
        Address of a Dask scheduler, whose workers do them instead.
    reads : tuple of Path
        Inputs, which workers elsewhere must see as we do.
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
    version : str
        Of the sinstool that asks.
    log_choices : bool
        Whether what is chosen, and why, is to be in the outcome.
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
        Gets the fraction done, now and then. What it raises ends the job.
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
        How many unfinished files beside it are in somebody's hands.
    """
    return sum(sweep(folder) for folder in task.job.folders)


def largest_first(tasks: Sequence[Task]) -> list[Task]:
    """Tasks in the order in which they are begun, so that no long one is left to the end."""
    return sorted(tasks, key=lambda task: (-task.job.size, task.number))
