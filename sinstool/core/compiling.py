"""Whether loops are being compiled, for progress bars, without importing numba."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Lock

_watchers: list[Callable[[bool], None]] = []
_lock = Lock()
_running = 0


@contextmanager
def watched(show: Callable[[bool], None]) -> Iterator[None]:
    """Call a function with True when compilation begins, with False when all of it has ended."""
    _watchers.append(show)
    try:
        yield
    finally:
        _watchers.remove(show)


def begins() -> None:
    """Count a loop whose compilation begins."""
    _count(1)


def ends() -> None:
    """Count a loop that is compiled."""
    _count(-1)


def _count(change: int) -> None:
    global _running
    with _lock:
        before, _running = _running, max(_running + change, 0)
        busy = _running > 0
    if busy != (before > 0):
        for show in list(_watchers):
            show(busy)
