"""The interface of every recorded log: channels, and raw messages in batches."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from sinstool.core.errors import (
    SALVAGE_HINT,
    DamagedLogError,
    UnsupportedLogError,
    one_line,
)
from sinstool.core.plugins import blamed
from sinstool.io.messages.definitions import (
    ENCODINGS,
    Definition,
    DefinitionError,
    normalise_type_name,
    parse_definition,
)
from sinstool.io.readers.batch import RawBatch
from sinstool.io.readers.clock_steps import NOTHING, ChannelClocks, ClockSteps
from sinstool.io.readers.lost import LogLosses, Lost, LostParts
from sinstool.io.readers.side_channels import SideChannelCache


@dataclass(frozen=True)
class Channel:
    """One stream of messages in a log.

    Attributes
    ----------
    id : int
        The reader's number for it, unique in the log.
    recorded_topic, recorded_type : str
        As the log spells them, byte for byte; see `topic` and `type_name`.
    message_encoding : str
        ``cdr`` or ``ros1``; others are listed but not decoded.
    schema_encoding, schema_text : str
        The definition carried by the log; the text may be empty.
    metadata : dict
        Further text of the container (QoS profiles, MD5 sums).
    """

    id: int
    recorded_topic: str
    recorded_type: str
    message_encoding: str
    schema_encoding: str
    schema_text: str
    metadata: dict[str, str] = field(default_factory=dict)

    @cached_property
    def topic(self) -> str:
        """The topic's name, in one line that a terminal may show."""
        return one_line(self.recorded_topic)

    @cached_property
    def type_name(self) -> str:
        """The type's name as the log spells it, in one line that a terminal may show."""
        return one_line(self.recorded_type)

    @cached_property
    def type(self) -> str:
        """Type in ROS 2 spelling, ``package/msg/Type``."""
        return normalise_type_name(self.type_name)

    @cached_property
    def readable(self) -> bool:
        """Whether its messages can be decoded (see :meth:`definition`)."""
        try:
            self.definition(Path())
        except UnsupportedLogError:
            return False
        return True

    def definition(self, path: Path) -> Definition:
        """Parsed definition.

        Parameters
        ----------
        path : Path
            The log, for the error message.

        Raises
        ------
        UnsupportedLogError
            The encoding is not supported, or there is no usable definition.
        """
        if self.message_encoding not in ENCODINGS:
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


class Log(ABC):
    """A recorded log, opened.

    Attributes
    ----------
    format : str
        ``mcap``, ``rosbag1``, ``rosbag2`` or ``ulog``.
    profile : str
        ``ros1`` or ``ros2``, or the profile of an MCAP's header.
    size : int
        Bytes on disk.
    salvage : bool
        Whether damaged parts are skipped (and recorded in `lost`) instead of refused.
    lost : list of Lost
        Parts that were skipped, or recovered without proof.
    channels : dict of int to Channel
        By id.
    parts : list of Log
        The opened files of a log of several files, in order; empty for a single file.
    counts : dict of int to int
        Messages by channel as the log itself declares them; empty where it does not. Not checked.
    recovered : dict of int to int
        Messages by channel that the last complete pass gave; counted when `salvage` is on.
    clocks : dict of int to ChannelClocks
        Steps of clocks by channel. Columns of messages are read without them; raw messages are as
        they were recorded.
    recorder : ClockSteps
        Steps of the recorder's clock, by log times as they are read instead of by numbers.
    references : frozenset of str
        Topics that results are compared with, which are measurements only if they are named.
    """

    format: str
    profile: str

    def __init__(self, path: Path, salvage: bool) -> None:
        self.path = path
        self.salvage = salvage
        self.channels: dict[int, Channel] = {}
        self.parts: list[Log] = []
        self.counts: dict[int, int] = {}
        self.recovered: dict[int, int] = {}
        self.clocks: dict[int, ChannelClocks] = {}
        self.recorder: ClockSteps = NOTHING
        self.references: frozenset[str] = frozenset()
        # Channels by topic, and of which channels it was made
        self._by_topic: dict[str, list[Channel]] = {}
        self._topics_of = (0, 0)
        self._lost = LostParts()
        self._cache = SideChannelCache()
        self.size = path_size(path)

    @property
    def lost(self) -> list[Lost]:
        """Parts that were skipped so far, or recovered without proof."""
        return self._lost.all()

    @abstractmethod
    def _read(self, selection: frozenset[int] | None) -> Iterator[RawBatch]:
        """Batches that hold the selected messages, and maybe others, in the order of the file."""

    def batches(self, channels: Collection[int] | None = None) -> Iterator[RawBatch]:
        """Raw messages, a bounded number at a time.

        Parameters
        ----------
        channels : collection of int, optional
            Only these; by default all.

        Raises
        ------
        DamagedLogError
            A part is corrupt or missing and `salvage` is off.
        """
        selection = None if channels is None else frozenset(int(c) for c in channels)
        if selection is not None and self._cache.covers(selection):
            yield from self._cache.batches(selection)
            return
        if not self._cache.channels or self._cache.filling or self._cache.complete:
            yield from self._pass(selection, selection, None)
            return
        complete = False
        self._cache.begin()
        try:
            through = None if selection is None else selection | self._cache.channels
            yield from self._pass(selection, through, self._cache)
            complete = True
        finally:
            self._cache.end(complete)

    def cache(self, channels: Collection[int]) -> None:
        """Have the next pass read small channels as well, and cache their messages."""
        self._cache = SideChannelCache(channels)

    def _batches(self, selection: frozenset[int] | None) -> Iterator[RawBatch]:
        """What the reader reads; a plug-in is named where it fails."""
        whose = f"the reader {type(self).__name__} of {type(self).__module__} fails on it"
        with blamed(self, lambda text: UnsupportedLogError(self.path, f"{whose}: {text}")):
            yield from self._read(selection)

    def _pass(
        self,
        selection: frozenset[int] | None,
        through: frozenset[int] | None,
        cache: SideChannelCache | None,
    ) -> Iterator[RawBatch]:
        """The selected messages, from a pass over the log that may also fill the cache."""
        undefined: dict[int, int] = {}
        counts: dict[int, int] = {}
        latest: int | None = None
        reached = 0
        for batch in self._batches(through):
            if not len(batch):
                continue
            # After a record with a wrong length the walk takes a step back.
            reached = max(reached, batch.position)
            if batch.position < reached:
                batch = replace(batch, position=reached)
            if self.salvage:
                if self._lost.waiting:
                    self._lost.between(batch.position, latest, int(batch.log_time.min()))
                latest = int(batch.log_time.max())
                for number, count in zip(
                    *np.unique(batch.channel, return_counts=True), strict=True
                ):
                    counts[int(number)] = counts.get(int(number), 0) + int(count)
            chosen = self._without_undefined(batch, undefined)
            if cache is not None:
                cache.add(chosen)
            if selection is not None:
                chosen = chosen.select(selection)
            if len(chosen):
                yield chosen
        if self.salvage:
            self._lost.between(self.size + 1, latest, None)
            met = self.channels if through is None else through
            self.recovered.update({number: counts.get(number, 0) for number in met})

    def channels_of(self, topic: str, *types: str) -> list[Channel]:
        """All channels that carry a topic, or those of some types alone, by id.

        Of those types only channels that can be read, if there are any.
        """
        if self._topics_of != (id(self.channels), len(self.channels)):
            self._by_topic = {}
            for _, channel in sorted(self.channels.items()):
                self._by_topic.setdefault(channel.topic, []).append(channel)
            self._topics_of = (id(self.channels), len(self.channels))
        channels = self._by_topic.get(topic, [])
        if not types:
            return list(channels)
        suitable = [c for c in channels if c.type in types]
        return [c for c in suitable if c.readable] or suitable

    def close(self) -> None:  # noqa: B027 - not every log holds something
        """Close files and free memory."""

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _without_undefined(self, batch: RawBatch, undefined: dict[int, int]) -> RawBatch:
        """A batch without messages of channels the log never defines, which are noted."""
        numbers: Iterable[int] = ()
        low, high = int(batch.channel.min()), int(batch.channel.max())
        # Finding the distinct numbers costs more than reading; usually all in the range are known
        if high - low >= len(self.channels) or not self.channels.keys() >= {*range(low, high + 1)}:
            numbers = np.unique(batch.channel).tolist()
        strange = [number for number in numbers if number not in self.channels]
        for number in strange:
            undefined[number] = undefined.get(number, 0) + int((batch.channel == number).sum())
            what = f"messages of channel {number}, which the log does not define"
            part = self.note_lost(Lost(what, "channel", recovered=0))
            part.declared = max(part.declared or 0, undefined[number])
        return batch.select(self.channels.keys()) if strange else batch

    def refuse(self, what: str, offset: int | None = None) -> None:
        """Raise `DamagedLogError`, unless `salvage` is on."""
        if not self.salvage:
            raise DamagedLogError(self.path, what, SALVAGE_HINT, offset)

    def damage(self, what: str, offset: int | None = None, kind: str = "record") -> None:
        """Refuse damage, or with `salvage` record it as a lost part (see `Lost`)."""
        self.refuse(what, offset)
        self.note_lost(Lost(what, kind, offset))

    def note_lost(self, part: Lost, always: bool = False) -> Lost:
        """Record a skipped part, once (see `LostParts.note`)."""
        return self._lost.note(part, always)

    def account(self) -> LogLosses:
        """The losses, once the log has been read."""
        parts = self.lost
        read = sum(self.recovered.values()) if parts and self.recovered else None
        declared = None
        if read is not None and self.counts:
            declared = sum(self.counts.get(number, 0) for number in self.recovered)
        return LogLosses(
            parts=tuple(str(part) for part in parts),
            places=tuple(part.as_json() for part in parts),
            chunks=sum(part.kind == "chunk" for part in parts),
            messages_read=read,
            messages_declared=declared,
        )


def path_size(path: Path) -> int:
    """Bytes of a file, or of all files in a folder."""
    if path.is_dir():
        return sum(p.stat().st_size for p in path.rglob("*") if p.is_file())
    return os.stat(path).st_size
