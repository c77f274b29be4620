"""Raw messages of a log, many at a time."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

FEW = 8


@dataclass(frozen=True)
class RawBatch:
    """Undecoded messages: of a log in the order of its file, or to be written.

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
    position: int = 0

    @staticmethod
    def from_rows(
        channel: int, payload: np.ndarray, log_time: np.ndarray, sequence: np.ndarray
    ) -> RawBatch:
        """Messages of one channel and one size, to be written.

        Parameters
        ----------
        payload : ndarray of uint8, shape (n, size)
        log_time, sequence : ndarray of int64, shape (n,)
        """
        count, size = payload.shape
        offset = np.arange(count, dtype=np.int64) * size
        numbers, lengths = (np.full(count, value, np.int64) for value in (channel, size))
        return RawBatch(payload.reshape(-1), numbers, offset, lengths, log_time, log_time, sequence)

    def __len__(self) -> int:
        return len(self.channel)

    def select(self, channels: Collection[int]) -> RawBatch:
        """The messages of some channels."""
        if 0 < len(channels) <= FEW:
            # a comparison each is quicker than np.isin
            keep = np.logical_or.reduce([self.channel == channel for channel in channels])
        else:
            keep = np.isin(self.channel, np.fromiter(channels, np.int64, len(channels)))
        if keep.all():
            return self
        return self.rows(np.flatnonzero(keep))

    def rows(self, which: np.ndarray | list[int] | slice) -> RawBatch:
        """Messages by mask, index or slice, in the same buffer."""
        columns = {name: column for name, column in vars(self).items() if np.ndim(column)}
        del columns["buffer"]
        return replace(self, **{name: column[which] for name, column in columns.items()})
