"""Helper threads, or none where a process should use one core only.

A command that works on one log has the machine to itself, and reads, compresses and writes in
threads while it computes. A worker of a campaign has one core; its threads would take time from
the other workers, so the calling thread does their work.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")
_single: ContextVar[bool] = ContextVar("_single", default=False)


@contextmanager
def single_threaded() -> Iterator[None]:
    """Context in which all work is done in the calling thread."""
    token = _single.set(True)
    try:
        yield
    finally:
        _single.reset(token)


def is_single_threaded() -> bool:
    """Whether this is inside :func:`single_threaded`."""
    return _single.get()


def executor(threads: int, name: str) -> Executor:
    """An executor for work in another thread.

    Parameters
    ----------
    threads : int
        Most threads at a time.
    name : str
        Prefix of the threads' names, which tools such as `top` show.
    """
    if is_single_threaded():
        return AtOnce()
    return ThreadPoolExecutor(threads, thread_name_prefix=name)


class AtOnce(Executor):
    """An executor that runs a submitted function at once."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Call `fn`; the future holds its result or exception."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as exc:
            future.set_exception(exc)
        return future

    def map(self, fn: Callable[..., T], *iterables: Any, **_: Any) -> Iterator[T]:
        """Call `fn` on each item when its result is read."""
        return map(fn, *iterables)
