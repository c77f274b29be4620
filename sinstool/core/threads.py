"""Threads beside the main one: as many as are asked for, or none where a process has one core.

A command that works on one log has the machine to itself, and reads, compresses and writes in
threads while it computes. A worker of a campaign has one core: there threads would take it from
the other workers, so that what they would do is done where it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")
_alone = False


def keep_to_one_core() -> None:
    """From now on this process does all of its work in the thread that asks for it."""
    global _alone
    _alone = True


def one_core() -> bool:
    """Whether this process keeps to one core."""
    return _alone


def executor(threads: int, name: str) -> Executor:
    """What takes work off the caller.

    Parameters
    ----------
    name : str
        Of the threads, for who looks at the process.
    """
    if _alone:
        return AtOnce()
    return ThreadPoolExecutor(threads, thread_name_prefix=name)


class AtOnce(Executor):
    """Does what is submitted before it returns."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Call `fn`; what it returns or raises is in the future, as if a thread had done it."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as exc:
            future.set_exception(exc)
        return future

    def map(self, fn: Callable[..., T], *iterables: Any, **_: Any) -> Iterator[T]:
        """Call `fn` on each, when its result is asked for."""
        return map(fn, *iterables)
