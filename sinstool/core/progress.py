"""Progress of a pass over a log."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float], None]


def share(
    progress: Progress | None, size: int, begin: float, part: float = 0.5
) -> Callable[[int], None] | None:
    """Progress of one pass over a log, for a reader that reports its position in bytes.

    Parameters
    ----------
    progress : callable or None
        Takes the fraction done of all passes.
    size : int
        Bytes of the log.
    begin, part : float
        Fraction done when the pass begins, and the fraction that the pass adds.
    """
    if progress is None:
        return None
    return lambda position: progress(begin + part * min(1.0, position / max(size, 1)))
