"""Messages of small topics in memory, so that one pass over a log serves all users."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np

from sinstool.io.readers.batch import RawBatch

# Topics that are larger together are read again from the log.
MAX_BYTES = 64 * 2**20


class SideChannelCache:
    """The messages of some channels, filled by a pass over the log.

    Attributes
    ----------
    channels : frozenset of int
        None of them where they turned out too large.
    filling : bool
        A pass is under way that fills it.
    complete : bool
        One came to the end.
    """

    def __init__(self, channels: Collection[int] = ()) -> None:
        self.channels = frozenset(channels)
        self.filling = False
        self.complete = False
        self._parts: list[RawBatch] = []
        self._size = 0

    def begin(self) -> None:
        """A pass begins."""
        self.filling, self._parts, self._size = True, [], 0

    def add(self, batch: RawBatch) -> None:
        """Copy the messages that are of the channels."""
        if not self.channels:
            return
        chosen = batch.select(self.channels)
        if not len(chosen):
            return
        ends = np.cumsum(chosen.length)
        self._size += int(ends[-1])
        if self._size > MAX_BYTES:
            self.channels, self._parts = frozenset(), []
            return
        begins = ends - chosen.length
        places = np.repeat(chosen.offset - begins, chosen.length) + np.arange(ends[-1])
        self._parts.append(replace(chosen, buffer=chosen.buffer[places], offset=begins))

    def end(self, complete: bool) -> None:
        """A pass ended."""
        self.filling, self.complete = False, complete
        if not complete or len(self._parts) < 2:
            self._parts = self._parts if complete else []
            return
        sizes = np.array([len(part.buffer) for part in self._parts])
        shift = np.repeat(np.cumsum(sizes) - sizes, [len(part) for part in self._parts])
        columns = {
            name: np.concatenate([getattr(part, name) for part in self._parts])
            for name in vars(self._parts[0])
            if name != "position"
        }
        columns["offset"] = columns["offset"] + shift
        # as the readers give it, so that compiled loops need no second version
        columns["buffer"].flags.writeable = False
        self._parts = [RawBatch(**columns, position=self._parts[-1].position)]

    def covers(self, selection: Collection[int] | None) -> bool:
        """Whether these channels can be had without the log."""
        return self.complete and selection is not None and self.channels.issuperset(selection)

    def batches(self, selection: Collection[int]) -> Iterator[RawBatch]:
        """The messages of some of the channels, in the order of the file."""
        for part in self._parts:
            if len(chosen := part.select(selection)):
                yield chosen
