"""Jobs on an existing Dask cluster, whose workers see the same files as we do."""

from __future__ import annotations

import contextlib
import gc
import importlib
import queue
import secrets
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import Any

from sinstool.campaign import jobs
from sinstool.campaign.visible import not_seen, sights, tokens, what_differs
from sinstool.core import version
from sinstool.core.errors import ConfigurationError, SinstoolError
from sinstool.core.memory import memory_held

# Longest wait for the scheduler and a first worker, and for cancelled jobs to close their files, s
CONNECT = 10.0
LET_GO = 10.0
# The system closes the connection of a dead worker at once, its files up to this much later, s
DYING = 1.0
START = "dask worker --nworkers 2 --nthreads 1 {address}"


def run_on_cluster(tasks: Sequence[jobs.Task], workers: jobs.Workers) -> Generator[jobs.Event]:
    """Run tasks on a Dask cluster; see :func:`sinstool.campaign.run.run_jobs`.

    Raises
    ------
    ConfigurationError
        If the extra ``cluster`` is not installed, or a worker has a different sinstool or sees
        different files.
    SinstoolError
        If the scheduler does not answer, or has no worker.
    """
    address = workers.scheduler or ""
    folders = list(dict.fromkeys(f for task in tasks for f in task.job.folders))
    with _client(address, workers.tls) as client, tokens(folders) as folder_tokens:
        _require_version(client, address)
        _require_same_files(client, sights(workers.reads), folder_tokens)
        yield from _run(client, tasks)


def require_distributed() -> Any:
    """Import dask.distributed.

    Raises
    ------
    ConfigurationError
        If it is not installed.
    """
    try:
        return importlib.import_module("distributed")
    except ModuleNotFoundError as exc:
        if (exc.name or "").partition(".")[0] not in ("distributed", "dask"):
            raise
        raise ConfigurationError(
            "--scheduler needs dask.distributed", "pip install 'sinstool[cluster]'"
        ) from exc


@contextlib.contextmanager
def _client(address: str, tls: jobs.Tls | None) -> Iterator[Any]:
    distributed = require_distributed()
    security = None
    if tls is not None:
        security = distributed.Security(
            require_encryption=True,
            tls_ca_file=str(tls.authority),
            tls_client_cert=str(tls.certificate),
            tls_client_key=None if tls.key is None else str(tls.key),
        )
    import logging

    # We report errors ourselves, in one line.
    for name in ("distributed.client", "distributed.comm", "distributed.core"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = distributed.Client(
            address, timeout=CONNECT, set_as_default=False, security=security
        )
    except (OSError, TimeoutError, ValueError) as exc:
        raise SinstoolError(
            f"no Dask scheduler answers at {address} ({' '.join(str(exc).split())[:120]})",
            "start one with: dask scheduler",
        ) from exc
    try:
        try:
            client.wait_for_workers(1, timeout=CONNECT)
        except TimeoutError as exc:
            raise SinstoolError(
                f"the scheduler at {address} has no worker",
                f"start some with: {START.format(address=address)}",
            ) from exc
        yield client
    finally:
        with contextlib.suppress(OSError, TimeoutError):
            client.close(timeout=CONNECT)


def _require_version(client: Any, address: str) -> None:
    # A nested function is sent with its code, so that a worker with another version of sinstool, or
    # without it, can answer too.
    def theirs() -> str:
        import importlib

        return str(importlib.import_module("sinstool.core.version").VERSION)

    ours = version.VERSION
    for worker, said in sorted(client.run(theirs, on_error="return").items()):
        if said != ours:
            what = f"has sinstool {said}" if isinstance(said, str) else f"has no sinstool ({said})"
            raise ConfigurationError(
                f"the worker {worker} of {address} {what}, and this machine {ours}",
                f"pip install 'sinstool[cluster]=={ours}' in its environment",
            )


def _require_same_files(client: Any, seen: Sequence[Any], folder_tokens: Sequence[Any]) -> None:
    """Refuse a cluster with a worker that does not see the same files, before anything starts."""
    hint = "inputs and outputs must lie where all workers see them under the same path"
    replies = client.run(what_differs, seen, folder_tokens, on_error="return")
    differing: list[str] = []
    for worker, reply in sorted(replies.items()):
        if isinstance(reply, BaseException):
            differing.append(f"the worker {worker} failed ({type(reply).__name__}: {reply})")
            continue
        said, answers = reply
        missing = not_seen(answers)
        if said:
            differing.append(f"the worker {worker} {said}")
        elif missing is not None:
            differing.append(f"the worker {worker} writes to a different {missing}")
    if differing:
        more = f" ({len(differing)} workers in all)" if len(differing) > 1 else ""
        raise ConfigurationError(differing[0] + more, hint)


def _run(client: Any, tasks: Sequence[jobs.Task]) -> Iterator[jobs.Event]:
    """Submit all tasks and pass on the events that come back."""
    topic = f"sinstool-{secrets.token_hex(8)}"
    news: queue.SimpleQueue[jobs.Event | tuple[int, Any]] = queue.SimpleQueue()
    client.subscribe_topic(topic, lambda event: news.put(jobs.Event(*event[1])))
    futures: dict[int, Any] = {}
    for rank, task in enumerate(jobs.largest_first(tasks)):
        key = f"{topic}-{task.number}"
        future = client.submit(_work, task, key, topic, key=key, pure=False, priority=-rank)
        futures[task.number] = future
        future.add_done_callback(_done(news, task.number))
    left = dict(futures)
    lost: list[jobs.Task] = []
    try:
        while left:
            item = news.get()
            if isinstance(item, jobs.Event):
                if item.number in left:
                    yield item
                continue
            number, future = item
            if left.pop(number, None) is None:
                continue
            # Unfinished files of a worker that died before another one did the job
            jobs.remove_left(tasks[number])
            outcome = _outcome(tasks[number], future)
            if outcome.died:
                lost.append(tasks[number])
            yield jobs.Event(number, outcome=outcome)
        until = time.monotonic() + DYING
        while sum(jobs.remove_left(task) for task in lost) and time.monotonic() < until:
            time.sleep(0.02)
    finally:
        if left:
            _give_up(client, topic, list(left.values()))


def _done(news: queue.SimpleQueue[Any], number: int) -> Callable[[Any], None]:
    return lambda future: news.put((number, future))


def _outcome(task: jobs.Task, future: Any) -> jobs.Outcome:
    """The outcome that a future holds, or an outcome made of its error."""
    name = task.job.name
    if future.status == "finished":
        outcome: jobs.Outcome = future.result()
        return outcome
    if future.status != "error":
        return jobs.Outcome(
            None, f"{name}: the scheduler gave up on it ({future.status})", 1, died=True
        )
    exc = future.exception()
    if type(exc).__name__ == "KilledWorker":
        deaths = f"{exc.allowed_failures + 1} times"
        return jobs.Outcome(None, f"{name}: its worker died, {deaths}", 1, died=True)
    said = f"{name}: {type(exc).__name__}: {' '.join(str(exc).split())}"
    return jobs.Outcome(error=said, exit_code=1)


def _give_up(client: Any, topic: str, futures: Sequence[Any]) -> None:
    """Cancel jobs, and wait until those that had begun have closed their files."""
    with contextlib.suppress(Exception):
        client.cancel(list(futures), force=True)
        until = time.monotonic() + LET_GO
        while time.monotonic() < until and any(client.run(_busy, topic).values()):
            time.sleep(0.05)


def _busy(topic: str, dask_worker: Any) -> bool:
    """Whether a worker still works on a job of ours."""
    return any(str(key).startswith(topic) for key in dask_worker.state.tasks)


class _Cancelled(BaseException):
    """The client has cancelled this job, or is gone."""


@contextlib.contextmanager
def _seldom_collected() -> Iterator[None]:
    """Collect garbage as seldom as local workers do: a job leaves hardly any."""
    before = gc.get_threshold()
    gc.set_threshold(*jobs.GARBAGE)
    try:
        yield
    finally:
        gc.set_threshold(*before)


def _work(task: jobs.Task, key: str, topic: str) -> jobs.Outcome:
    """Do a task, on a worker."""
    from distributed import get_worker

    worker: Any = get_worker()

    def tell(fraction: float) -> None:
        state = worker.state.tasks.get(key)
        if state is None or state.state == "cancelled":
            raise _Cancelled
        worker.log_event(topic, (task.number, fraction))

    if not all(Path(folder).is_dir() for folder in task.job.folders):
        # A worker that joined the cluster after the check
        return jobs.Outcome(error=f"{task.job.name}: a worker does not see the output", exit_code=1)
    try:
        with memory_held(), _seldom_collected():
            return jobs.perform(task, tell)
    except _Cancelled:
        return jobs.Outcome(error="cancelled", exit_code=130)
