"""Cache of the messages of small topics, so that one pass over a log serves all users."""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np

from sinstool.core.parts import kernel
from sinstool.io.readers.batch import RawBatch

# Largest size of the cache, columns included; larger topics are read again from the log
MAX_BYTES = 64 * 2**20
# Most messages in a batch
ROWS = 2**16


class SideChannelCache:
    """The messages of some channels, filled by a pass over the log.

    Attributes
    ----------
    channels : frozenset of int
        Empty where they turned out too large.
    filling : bool
        Whether a pass is under way that fills the cache.
    complete : bool
        Whether such a pass came to its end.
    """

    def __init__(self, channels: Collection[int] = ()) -> None:
        self.channels = frozenset(channels)
        self.filling = False
        self.complete = False
        self._empty()

    def _empty(self) -> None:
        # One buffer that grows in place, as joining pieces would need their memory twice
        self._payload = bytearray()
        self._messages = 0
        self._columns: dict[str, list[np.ndarray]] = {name: [] for name in _COLUMNS}
        self._whole: RawBatch | None = None

    def begin(self) -> None:
        """A pass begins."""
        self.filling = True
        self._empty()

    def add(self, batch: RawBatch) -> None:
        """Copy the messages of the cached channels."""
        if not self.channels:
            return
        chosen = batch.select(self.channels)
        if not len(chosen):
            return
        ends = np.cumsum(chosen.length)
        begins = ends - chosen.length
        size = len(self._payload)
        self._messages += len(chosen)
        if size + int(ends[-1]) + self._messages * 8 * len(_COLUMNS) > MAX_BYTES:
            self.channels = frozenset()
            self._empty()
            return
        together = np.empty(int(ends[-1]), np.uint8)
        _put_together(chosen.buffer, chosen.offset, chosen.length, together)
        self._payload += together.data
        for name, columns in self._columns.items():
            columns.append(size + begins if name == "offset" else getattr(chosen, name).copy())
        self._position = batch.position

    def end(self, complete: bool) -> None:
        """A pass ended."""
        self.filling, self.complete = False, complete
        if not complete or not self._columns["channel"]:
            self._empty()
            return
        columns = {name: np.concatenate(self._columns.pop(name)) for name in _COLUMNS}
        if np.array_equal(columns["publish_time"], columns["log_time"]):
            columns["publish_time"] = columns["log_time"]
        buffer = np.frombuffer(self._payload or bytes(1), np.uint8)
        # Read-only, as from the readers, so that compiled loops need no second version
        buffer.flags.writeable = False
        self._whole = RawBatch(buffer, **columns, position=self._position)

    def covers(self, selection: Collection[int] | None) -> bool:
        """Whether the cache holds all messages of these channels."""
        return self.complete and selection is not None and self.channels.issuperset(selection)

    def batches(self, selection: Collection[int]) -> Iterator[RawBatch]:
        """The messages of some of the channels, in the order of the file."""
        whole = self._whole
        if whole is None:
            return
        for begin in range(0, len(whole), ROWS):
            part = whole.rows(slice(begin, begin + ROWS))
            if len(chosen := part.select(selection)):
                yield chosen


@kernel()
def _put_together(buffer, offset, length, out):  # type: ignore[no-untyped-def]
    """Copy messages one behind the other."""
    # Unsigned, as in the writer of chunks: the compiler vectorises the inner loop
    at = np.uint64(0)
    for i in range(offset.shape[0]):
        o = np.uint64(offset[i])
        n = np.uint64(length[i])
        for b in range(n):
            out[at + b] = buffer[o + b]
        at += n


_COLUMNS = ("channel", "offset", "length", "log_time", "publish_time", "sequence")
