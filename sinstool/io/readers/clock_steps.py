"""Steps of clocks in the middle of a log, undone as its messages are read.

A log is read several times, by topics and by parts. So what the survey has found out about a clock
is kept with the log, by the place of each message among those of its channel: from one pass to the
next that is the same, whatever the times say.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sinstool.core.arrays import IntArray

NONE = np.zeros(0, np.int64)


@dataclass(frozen=True)
class ClockSteps:
    """Steps of one clock, by the messages of a channel.

    Attributes
    ----------
    row : ndarray, shape (k,)
        Number of the first message behind each step, in the order of the file.
    size_ns : ndarray, shape (k,)
        By how much the clock was set forward.
    whole_ns : int
        By how much all times are moved besides: times before each step are moved by its size.
    """

    row: IntArray = field(default_factory=lambda: NONE)
    size_ns: IntArray = field(default_factory=lambda: NONE)
    whole_ns: int = 0

    def with_step(self, row: int, size_ns: int, from_there: bool) -> ClockSteps:
        """With one more step; times from there on are moved, or those before."""
        at = int(np.searchsorted(self.row, row))
        return ClockSteps(
            np.insert(self.row, at, row),
            np.insert(self.size_ns, at, size_ns),
            self.whole_ns - (size_ns if from_there else 0),
        )

    def moves(self, row: IntArray) -> IntArray:
        """By how much the times of messages are moved, by their numbers."""
        behind = np.searchsorted(self.row, row, side="right")
        return np.append(np.cumsum(self.size_ns[::-1])[::-1], 0)[behind] + self.whole_ns


NOTHING = ClockSteps()


@dataclass(frozen=True)
class ChannelClocks:
    """Steps of the clocks that stamp and that record the messages of a channel."""

    stamp: ClockSteps = NOTHING
    log: ClockSteps = NOTHING


def recorded(log: ClockSteps, log_time_ns: IntArray) -> IntArray:
    """Log times as they are in the file, of those as they are read.

    Parameters
    ----------
    log : ClockSteps
        With log times, as they are read, in place of numbers of messages.
    """
    return np.asarray(log_time_ns - log.moves(log_time_ns))
