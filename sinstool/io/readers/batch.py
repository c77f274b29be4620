"""Raw messages of a log, many at a time."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class RawBatch:
    """Consecutive undecoded messages, in the order of the file.

    Attributes
    ----------
    buffer : ndarray, uint8
        Holds the payloads.
    channel : ndarray of int64, shape (n,)
        Channel id of each message.
    offset, length : ndarray of int64, shape (n,)
        Where each payload lies in the buffer.
    log_time, publish_time : ndarray of int64, shape (n,)
        Nanoseconds; the same where the container keeps one only.
    sequence : ndarray of int64, shape (n,)
        The container's own count, 0 where it keeps none.
    position : int
        Bytes of the log read so far, for progress.
    """

    buffer: np.ndarray
    channel: np.ndarray
    offset: np.ndarray
    length: np.ndarray
    log_time: np.ndarray
    publish_time: np.ndarray
    sequence: np.ndarray
    position: int

    def __len__(self) -> int:
        return len(self.channel)

    def select(self, channels: Collection[int]) -> RawBatch:
        """The messages of the given channels."""
        if len(channels) == 1:
            keep = self.channel == next(iter(channels))
        else:
            keep = np.isin(self.channel, np.fromiter(channels, np.int64, len(channels)))
        if keep.all():
            return self
        return RawBatch(
            self.buffer,
            self.channel[keep],
            self.offset[keep],
            self.length[keep],
            self.log_time[keep],
            self.publish_time[keep],
            self.sequence[keep],
            self.position,
        )
