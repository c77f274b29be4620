"""Work on the next few items while the current one is used."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from typing import TypeVar

from sinstool.core.threads import executor, is_single_threaded

Item = TypeVar("Item")
Result = TypeVar("Result")


def ahead(
    work: Callable[[Item], Result], items: Iterable[Item], depth: int = 3
) -> Iterator[Result]:
    """Map ``work`` over ``items`` in a thread, in order, at most ``depth`` results ahead.

    Decompression and checksums give up the interpreter lock, so reading overlaps with whatever
    the caller does; the bound keeps memory flat.

    Parameters
    ----------
    work : callable
    depth : int
        Results held at most.

    Yields
    ------
    Result
        In the order of ``items``; an exception of ``work`` is raised in its turn.
    """
    if is_single_threaded():
        yield from map(work, items)
        return
    with executor(1, "sinstool-read") as pool:
        waiting: deque[Future[Result]] = deque()
        try:
            for item in items:
                waiting.append(pool.submit(work, item))
                if len(waiting) >= depth:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()
