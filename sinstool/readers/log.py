"""What every recorded log looks like to the rest: channels, and raw messages in batches."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sinstool.errors import UnsupportedLogError
from sinstool.messages.definitions import (
    Definition,
    DefinitionError,
    normalise_type_name,
    parse_definition,
)


@dataclass(frozen=True)
class Channel:
    """One stream of messages in a log.

    Attributes
    ----------
    id : int
        The reader's number for it, unique in the log.
    topic : str
    type_name : str
        As the log spells it.
    message_encoding : str
        ``cdr`` or ``ros1``; others are listed but not decoded.
    schema_encoding, schema_text : str
        The definition carried by the log; the text may be empty.
    metadata : dict
        Whatever the container keeps (QoS profiles, MD5 sums).
    """

    id: int
    topic: str
    type_name: str
    message_encoding: str
    schema_encoding: str
    schema_text: str
    metadata: dict[str, str] = field(default_factory=dict)

    @property
    def type(self) -> str:
        """Type in ROS 2 spelling, ``package/msg/Type``."""
        return normalise_type_name(self.type_name)

    def definition(self, path: Path) -> Definition:
        """Parsed definition.

        Parameters
        ----------
        path : Path
            The log, for the error message.

        Raises
        ------
        UnsupportedLogError
            The encoding is not read, or the definition cannot be had.
        """
        if self.message_encoding not in ("cdr", "ros1"):
            raise UnsupportedLogError(
                path,
                f"topic {self.topic} is encoded as '{self.message_encoding or 'unknown'}'",
                "sinstool reads ROS messages, encoded as cdr or ros1",
            )
        try:
            return parse_definition(
                self.type_name, self.schema_encoding, self.schema_text, self.message_encoding
            )
        except DefinitionError as exc:
            raise UnsupportedLogError(path, f"topic {self.topic}: {exc}") from exc


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


class Log(ABC):
    """A recorded log, opened.

    Attributes
    ----------
    path : Path
    format : str
        ``mcap``, ``rosbag1`` or ``rosbag2``.
    profile : str
        ``ros1`` or ``ros2`` or what an MCAP header says.
    channels : dict of int to Channel
    size : int
        Bytes on disk.
    salvage : bool
        Whether damaged parts are passed over (and noted in `lost`) instead of refused.
    lost : list of str
        What was passed over, in words.
    counts : dict of int to int
        Messages by channel as the log itself declares them, where it does; not checked.
    """

    format: str
    profile: str

    def __init__(self, path: Path, salvage: bool) -> None:
        self.path = path
        self.salvage = salvage
        self.channels: dict[int, Channel] = {}
        self.lost: list[str] = []
        self.counts: dict[int, int] = {}
        self._undefined: set[int] = set()
        self.size = path_size(path)

    @abstractmethod
    def batches(self, channels: Collection[int] | None = None) -> Iterator[RawBatch]:
        """Raw messages, a bounded number at a time.

        Parameters
        ----------
        channels : collection of int, optional
            Only these; by default all.

        Yields
        ------
        RawBatch

        Raises
        ------
        DamagedLogError
            A part is corrupt or missing and `salvage` is off.
        """

    def channels_of(self, topic: str) -> list[Channel]:
        """All channels that carry a topic, by id."""
        return [c for _, c in sorted(self.channels.items()) if c.topic == topic]

    def close(self) -> None:  # noqa: B027 - not every log holds something
        """Give back what the reader holds."""

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _selected(self, batch: RawBatch, wanted: frozenset[int] | None) -> RawBatch:
        """The wanted messages of a batch; those of channels the log never defines are noted."""
        numbers: Iterable[int] = ()
        if len(batch):
            low, high = int(batch.channel.min()), int(batch.channel.max())
            # sorting out which there are costs more than reading; mostly all between are known
            if high - low >= len(self.channels) or not self.channels.keys() >= {
                *range(low, high + 1)
            }:
                numbers = np.unique(batch.channel).tolist()
        for number in numbers:
            if number not in self.channels and number not in self._undefined:
                self._undefined.add(number)
                self.note_lost(f"messages of channel {number}, which the log does not define")
        if self._undefined:
            batch = batch.select(self.channels.keys())
        return batch if wanted is None else batch.select(wanted)

    def note_lost(self, what: str) -> None:
        """Remember a passed-over part, once."""
        if what not in self.lost:
            self.lost.append(what)


def path_size(path: Path) -> int:
    """Bytes of a file, or of all files in a folder."""
    if path.is_dir():
        return sum(p.stat().st_size for p in path.rglob("*") if p.is_file())
    return os.stat(path).st_size
