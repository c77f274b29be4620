"""Execution of jobs: in processes on this machine or on a cluster."""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Sequence
from typing import Any

from sinstool.campaign.jobs import Event, Job, Outcome, Report, Task, Workers
from sinstool.core.choices import choices_are_shown, replay
from sinstool.core.errors import SinstoolError
from sinstool.core.whole_file import record_output


def run_jobs(jobs: Sequence[Job], workers: Workers) -> Generator[Event]:
    """Do jobs and yield their progress; the last event of each job has its outcome.

    Yields
    ------
    Event
        In the order in which they happen. Closing or interrupting the generator ends the workers
        and removes their unfinished files.

    Raises
    ------
    ConfigurationError
        If a worker of the cluster has a different sinstool or sees different files.
    SinstoolError
        If the scheduler does not answer, or has no worker.
    """
    tasks = [Task(number, job, log_choices=choices_are_shown()) for number, job in enumerate(jobs)]
    if workers.scheduler is None:
        from sinstool.campaign.local import run_local

        events = run_local(tasks, workers)
    else:
        from sinstool.campaign.cluster import run_on_cluster

        events = run_on_cluster(tasks, workers)
    with contextlib.closing(events):
        for event in events:
            if event.outcome is not None:
                # Record files and choices as if the job had run in this process
                record_output(*event.outcome.written)
                replay(jobs[event.number].name, event.outcome.choices)
            yield event


def results(jobs: Sequence[Job], workers: Workers, progress: Report | None = None) -> list[Any]:
    """The results of all jobs, in their order.

    Parameters
    ----------
    progress : callable, optional
        Called with the fraction done of all jobs together.

    Raises
    ------
    SinstoolError
        The error of the first job, in their order, that failed.
    """
    outcomes: dict[int, Outcome] = {}
    done: dict[int, float] = {}
    with contextlib.closing(run_jobs(jobs, workers)) as events:
        for event in events:
            if event.outcome is not None:
                outcomes[event.number] = event.outcome
            done[event.number] = 1.0 if event.outcome is not None else event.fraction or 0.0
            if progress is not None:
                progress(sum(done.values()) / len(jobs))
    ordered = [outcomes[number] for number in range(len(jobs))]
    for outcome in ordered:
        if outcome.error:
            error = SinstoolError(outcome.error)
            error.exit_code = outcome.exit_code
            raise error
    return [outcome.value for outcome in ordered]
