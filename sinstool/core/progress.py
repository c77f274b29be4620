"""Progress of a pass over a log."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float], None]


def share(
    progress: Progress | None, size: int, begin: float, part: float = 0.5
) -> Callable[[int], None] | None:
    """Progress of one pass over the log, in bytes of it."""
    if progress is None:
        return None
    return lambda position: progress(begin + part * min(1.0, position / max(size, 1)))
