"""Steps of clocks in the middle of a log, undone as its messages are read.

A log is read several times, by topics and by parts. So what the survey has found out about a clock
is kept with the log, by the place of each message among those of its channel: from one pass to the
next that is the same, whatever the times say.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from sinstool.core.arrays import IntArray

NONE = np.zeros(0, np.int64)


@dataclass(frozen=True)
class Undone:
    """Steps of the clocks of one channel: times before each are moved to the clock behind it.

    Attributes
    ----------
    row : ndarray, shape (k,)
        Number of the first message behind each step, in the order of the file.
    stamp_ns, log_ns : ndarray, shape (k,)
        By how much header stamps and log times before it are moved.
    """

    row: IntArray = field(default_factory=lambda: NONE)
    stamp_ns: IntArray = field(default_factory=lambda: NONE)
    log_ns: IntArray = field(default_factory=lambda: NONE)

    def and_also(self, row: int, stamp_ns: int, log_ns: int) -> Undone:
        """With one more step."""
        at = int(np.searchsorted(self.row, row))
        return Undone(
            np.insert(self.row, at, row),
            np.insert(self.stamp_ns, at, stamp_ns),
            np.insert(self.log_ns, at, log_ns),
        )

    def moves(self, first: int, count: int) -> tuple[IntArray, IntArray]:
        """By how much stamps and log times of so many messages from one on are moved."""
        behind = np.searchsorted(self.row, np.arange(first, first + count), side="right")
        return _sums(self.stamp_ns)[behind], _sums(self.log_ns)[behind]


@dataclass(frozen=True)
class Recorder:
    """Steps of the recorder's clock, in the order of time.

    Attributes
    ----------
    until_ns : ndarray, shape (k,)
        Log times, as they are read, before which each lies.
    size_ns : ndarray, shape (k,)
        By how much times before it are moved.
    """

    until_ns: IntArray = field(default_factory=lambda: NONE)
    size_ns: IntArray = field(default_factory=lambda: NONE)

    def and_also(self, until_ns: Sequence[int], size_ns: Sequence[int]) -> Recorder:
        """With more steps."""
        until = np.append(self.until_ns, until_ns)
        order = np.argsort(until, kind="stable")
        return Recorder(until[order], np.append(self.size_ns, size_ns)[order])

    def recorded(self, log_time_ns: IntArray) -> IntArray:
        """Log times as they are in the file, of those as they are read."""
        behind = np.searchsorted(self.until_ns, log_time_ns, side="right")
        return np.asarray(log_time_ns - _sums(self.size_ns)[behind])


def _sums(sizes: IntArray) -> IntArray:
    """Of each and all behind it, and 0 behind the last."""
    return np.append(np.cumsum(sizes[::-1])[::-1], 0)
