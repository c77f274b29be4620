"""Parts of a log that could not be read or verified: where, when, and how much."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from sinstool.core.english import counted
from sinstool.core.finding import Finding, Severity

# Most lost parts of a log that are described one by one
MAX_PARTS = 1000


@dataclass(frozen=True)
class LogLosses:
    """Parts of a log that were lost.

    Attributes
    ----------
    parts : tuple of str
        Description of each.
    places : tuple of dict
        The same with the keys of :meth:`Lost.as_json`.
    chunks : int
        Number of lost chunks.
    messages_read, messages_declared : int or None
        Messages in the channels that were read; None if nothing was lost, or if the log does not
        declare them.
    """

    parts: tuple[str, ...]
    places: tuple[dict[str, Any], ...]
    chunks: int
    messages_read: int | None
    messages_declared: int | None

    def findings(self) -> list[Finding]:
        """A finding for each lost part."""
        return [Finding("lost-part", f"lost: {part}", Severity.LOST) for part in self.parts]


@dataclass(eq=False)
class Lost:
    """A part of a log that was lost or recovered only in part.

    Attributes
    ----------
    what : str
        What was wrong with it.
    kind : str
        ``chunk``, ``record``, ``end`` (of the file), ``index``, ``channel``, ``count``, ``file``,
        ``row``, ``attachment``, ``metadata`` or ``definition``.
    offset, end : int or None
        Bytes of the file between which it lies.
    start_ns, end_ns : int or None
        Log times between which nothing, or only part, was recovered. None where nothing was
        read before it, or after it.
    declared : int or None
        Messages that the part held, where the log itself still declares them.
    recovered : int or None
        Messages recovered from the part itself.
    proved : bool
        Whether a CRC proves that the recovered messages are correct.
    file : str
        Name of the file, in a bag of several.
    """

    what: str
    kind: str = "record"
    offset: int | None = None
    end: int | None = None
    start_ns: int | None = None
    end_ns: int | None = None
    recovered: int | None = None
    declared: int | None = None
    proved: bool = False
    file: str = ""

    def __str__(self) -> str:
        where = []
        if self.offset is not None:
            to = f" to {self.end}" if self.end is not None and self.end > self.offset else ""
            where.append(f"at byte {self.offset}{to}")
        if self.recovered is not None:
            of = f" of {self.declared}" if self.declared is not None else ""
            proof = ", proved by their CRC" if self.proved else ", unproved"
            where.append(f"{self.recovered}{of} messages kept{proof if self.recovered else ''}")
        elif self.declared is not None:
            where.append(counted(self.declared, "message"))
        if self.start_ns is not None and self.end_ns is not None:
            where.append(f"log time {_seconds(self.start_ns)} to {_seconds(self.end_ns)} s")
        elif self.start_ns is not None:
            where.append(f"log time {_seconds(self.start_ns)} s and later")
        elif self.end_ns is not None:
            where.append(f"log time before {_seconds(self.end_ns)} s")
        name = f"{self.file}: " if self.file else ""
        return f"{name}{self.what}" + (f" ({'; '.join(where)})" if where else "")

    def as_json(self) -> dict[str, Any]:
        """Values for JSON; times as strings of nanoseconds."""
        return {
            "kind": self.kind,
            "text": str(self),
            "file": self.file or None,
            "offset": self.offset,
            "end_offset": self.end,
            "start_ns": None if self.start_ns is None else str(self.start_ns),
            "end_ns": None if self.end_ns is None else str(self.end_ns),
            "messages_kept": self.recovered,
            "messages_declared": self.declared,
            "proved": self.proved,
        }


@dataclass
class LostParts:
    """All losses of a log, each part once however often the log is read.

    Attributes
    ----------
    parts : dict
        By text and offset.
    more : bool
        Whether there are more than are described.
    """

    parts: dict[tuple[str, int | None], Lost] = field(default_factory=dict)
    more: bool = False
    _open: list[Lost] = field(default_factory=list)

    def note(self, part: Lost, always: bool = False) -> Lost:
        """Record a part, and return it, or the equal one recorded before.

        Parameters
        ----------
        always : bool
            Record it beyond the limit too, as it says that reading was given up.
        """
        key = part.what, part.offset
        same = self.parts.get(key)
        if same is not None:
            return same
        if len(self.parts) >= MAX_PARTS and not always:
            self.more = True
            return part
        self.parts[key] = part
        if part.offset is not None and part.start_ns is None and part.end_ns is None:
            self._open.append(part)
        return part

    def between(self, position: int, before_ns: int | None, after_ns: int | None) -> None:
        """Set the log times of the parts that lie before a position in the file.

        Parameters
        ----------
        position : int
            Byte at which the messages read last end.
        before_ns, after_ns : int or None
            Log times of the messages on either side of it.
        """
        for part in [p for p in self._open if p.offset is not None and p.offset < position]:
            self._open.remove(part)
            span = [before_ns, after_ns]
            if before_ns is not None and after_ns is not None:
                span.sort()  # chunks may overlap in time
            part.start_ns, part.end_ns = span

    @property
    def waiting(self) -> bool:
        """Whether parts lack their log times."""
        return bool(self._open)

    def all(self) -> list[Lost]:
        """The parts, in the order of their discovery."""
        last = [Lost(f"more than the {MAX_PARTS} places listed")] if self.more else []
        return [*self.parts.values(), *last]


def _seconds(ns: int) -> str:
    return f"{ns // 10**9}.{ns % 10**9:09d}"
