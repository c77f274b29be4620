"""Jobs in processes on this machine.

Workers are forked from a server that has imported what they need and has no threads (on systems
without a fork server they are started from scratch), and use one core each. Each has its own pipe,
which shows the job that was lost when a worker dies.
"""

from __future__ import annotations

import contextlib
import gc
import multiprocessing
import os
import signal
import threading
import time
import warnings
from collections import Counter, deque
from collections.abc import Collection, Generator, Iterator, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.context import BaseContext
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import Any

from sinstool.campaign import jobs
from sinstool.core.errors import UncachedWarning
from sinstool.core.temporary import remove_unfinished

# A job whose worker dies is tried once more.
ATTEMPTS = 2
# Time to remove unfinished files before a worker is killed, s.
GRACE = 2.0


class _Worker:
    """A process, its pipe, and the task it works on."""

    def __init__(self, context: BaseContext, task: jobs.Task) -> None:
        self.pipe, theirs = context.Pipe()
        self.process: BaseProcess = context.Process(  # type: ignore[attr-defined]
            target=_serve, args=(theirs,), name="sinstool-worker", daemon=True
        )
        self.process.start()
        theirs.close()
        self.task: jobs.Task | None = None
        self.give(task)

    def give(self, task: jobs.Task) -> None:
        """Send a task to the worker."""
        self.task = task
        # If it has died meanwhile, reading its pipe will show it.
        with contextlib.suppress(OSError):
            self.pipe.send(task)

    def died(self) -> str:
        """The cause of its death."""
        self.process.join(GRACE)
        code = self.process.exitcode
        if code is not None and code < 0:
            with contextlib.suppress(ValueError):
                return f"was killed by {signal.Signals(-code).name}"
        return f"ended with status {code}"


def run_local(tasks: Sequence[jobs.Task], workers: jobs.Workers) -> Generator[jobs.Event]:
    """Run tasks in processes of this machine; see :func:`sinstool.campaign.run.run_jobs`."""
    context = _context({task.job.function.__module__ for task in tasks})
    waiting = deque(jobs.largest_first(tasks))
    deaths: Counter[int] = Counter()
    crew: list[_Worker] = []
    try:
        while waiting or crew:
            while waiting and len(crew) < workers.processes:
                crew.append(_Worker(context, waiting.popleft()))
            wait([worker.pipe for worker in crew])
            for worker in list(crew):
                yield from _listen(worker, waiting, deaths)
                if worker.task is None:
                    crew.remove(worker)
    finally:
        _stop(crew)


def _listen(
    worker: _Worker, waiting: deque[jobs.Task], deaths: Counter[int]
) -> Iterator[jobs.Event]:
    """Read a worker's message; after its last one, send the next task, or dismiss the worker."""
    task = worker.task
    assert task is not None
    try:
        while worker.pipe.poll():
            message = worker.pipe.recv()
            if isinstance(message, float):
                yield jobs.Event(task.number, message)
                continue
            if isinstance(message, UncachedWarning):
                warnings.warn(message, stacklevel=2)  # every worker sends it; shown once
                continue
            worker.task = None
            yield jobs.Event(task.number, outcome=message)
            if not waiting:
                # The worker ends when its pipe is closed.
                worker.pipe.close()
                return
            task = waiting.popleft()
            worker.give(task)
    except (EOFError, OSError):
        worker.task = None
        said = worker.died()
        jobs.remove_left(task)
        deaths[task.number] += 1
        if deaths[task.number] < ATTEMPTS:
            waiting.appendleft(task)
            yield jobs.Event(task.number)
        else:
            lost = f"{task.job.name}: its worker {said}, {ATTEMPTS} times"
            yield jobs.Event(task.number, outcome=jobs.Outcome(None, lost, 1, died=True))


def _stop(crew: Sequence[_Worker]) -> None:
    """End workers at once, and remove their unfinished files."""
    for worker in crew:
        worker.process.terminate()
    until = time.monotonic() + GRACE
    for worker in crew:
        worker.process.join(max(0.0, until - time.monotonic()))
        if worker.process.is_alive():
            worker.process.kill()
            worker.process.join()
        if worker.task is not None:
            jobs.remove_left(worker.task)


def _context(modules: Collection[str]) -> BaseContext:
    # A plain fork would copy the locks of threads that hold them (of a progress bar, say).
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__, *sorted(modules)])
    # Workers inherit the server's environment; each has one core.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    return context


def _serve(pipe: Connection) -> None:
    """Perform the tasks that come through the pipe until it closes: the main loop of a worker."""
    # Ctrl-C and the end of a terminal reach all processes; the parent ends its workers itself.
    for number in ("SIGINT", "SIGHUP"):
        if hasattr(signal, number):
            signal.signal(getattr(signal, number), signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _terminated)
    threading.Thread(target=_with_parent, daemon=True).start()
    gc.set_threshold(*jobs.GARBAGE)
    show = warnings.showwarning

    def hand_on(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if isinstance(message, UncachedWarning):
            pipe.send(message)
        else:
            show(message, category, *where, **more)

    warnings.showwarning = hand_on
    try:
        with contextlib.suppress(EOFError, OSError):
            while True:
                task = pipe.recv()
                pipe.send(jobs.perform(task, pipe.send))
    finally:
        # The signal may have interrupted the removal of files, when the pipe broke before it came;
        # multiprocessing calls no exit handlers.
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        remove_unfinished()
    # The system frees the memory faster than the interpreter would.
    os._exit(0)


def _terminated(number: int, frame: FrameType | None) -> None:
    del number, frame
    # A second signal must not interrupt the removal of unfinished files.
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise SystemExit(1)


def _with_parent() -> None:
    """End this worker when its parent process ends."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os.kill(os.getpid(), signal.SIGTERM)
