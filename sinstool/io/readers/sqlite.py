"""The SQLite storage of ROS 2 bags: one ``.db3`` file, schema versions 1 to 4."""

from __future__ import annotations

import os
import shutil
import sqlite3
import struct
from array import array
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

import numpy as np

from sinstool.core.errors import SALVAGE_HINT, DamagedLogError, NotALogError, UnsupportedLogError
from sinstool.core.temporary import TemporaryFolder
from sinstool.io.readers.batch import RawBatch
from sinstool.io.readers.limits import MAX_BLOCK, MAX_PLACES
from sinstool.io.readers.log import Channel, Log
from sinstool.io.readers.lost import Lost
from sinstool.io.readers.sqlite_pages import Pages, Row

# Small enough to stay in the processor's cache, which is worth a third of the time.
BATCH = 4096
# A batch also ends at this size, so that images do not make it large.
BATCH_BYTES = 32 * 2**20
_FIRST_ROW = -(2**63)
# Steps of SQLite's virtual machine, some milliseconds, between Python's checks for signals
_STEPS = 100_000

# Exceptions from a damaged database: MemoryError where a size is absurd, UnicodeDecodeError where
# SQLite's message quotes a damaged name
_UNREADABLE = (sqlite3.Error, OverflowError, MemoryError, UnicodeDecodeError)


class SqliteLog(Log):
    """A single ``.db3`` file of a ROS 2 bag.

    Messages come in the order they were inserted. Their payloads are given as they are stored:
    a bag that compresses each message is decompressed by its folder's reader.

    Parameters
    ----------
    salvage : bool
        Skip rows that the database cannot return, and record them in `lost`.

    Raises
    ------
    NotALogError
        The database has no tables of a ROS 2 bag.
    DamagedLogError
        SQLite cannot read it.
    """

    format = "rosbag2"
    profile = "ros2"

    def __init__(self, path: Path, salvage: bool = False) -> None:
        super().__init__(path, salvage)
        self._beside: TemporaryFolder | None = None
        self._database: sqlite3.Connection | None = None
        try:
            self._database = self._connect()
            if self.salvage and (short := self._cut_short()):
                self.note_lost(Lost(short, "end", self.size))
            self._read_topics(self._database)
        except (*_UNREADABLE, TypeError, ValueError) as exc:
            self.close()
            raise self._damaged(exc) from exc
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the database, and remove the copy that was read instead of it."""
        if self._database is not None:
            self._database.close()
            self._database = None
        if self._beside is not None:
            self._beside.cleanup()
            self._beside = None

    def _damaged(self, exc: Exception) -> DamagedLogError:
        _raise_if_interrupted(exc)
        recover = f"`sqlite3 '{self.path}' .recover | sqlite3 recovered.db3` may save more"
        hint = recover if self.salvage else f"{SALVAGE_HINT}; {recover}"
        what = f"SQLite cannot read it ({exc})"
        if short := self._cut_short():
            return DamagedLogError(self.path, f"{short}; {what}", hint, self.size)
        return DamagedLogError(self.path, what, hint)

    def _cut_short(self) -> str:
        """A description of what is missing from the file; '' where it is complete."""
        page, pages = self._pages()
        if page * pages > self.size or self.size % page:
            return f"cut short: {self.size} of {max(page * pages, self.size)} bytes"
        return ""

    def _pages(self) -> tuple[int, int]:
        """Size and number of pages, by the file's own header."""
        with suppress(OSError, struct.error), self.path.open("rb") as stream:
            head = stream.read(100)
            (page,) = struct.unpack_from(">H", head, 16)
            (pages,) = struct.unpack_from(">I", head, 28)
            return (65536 if page == 1 else max(512, page)), pages
        return 512, 0

    # -- opening ---------------------------------------------------------------------------

    def _connect(self) -> sqlite3.Connection:
        """Open read-only, including rows that are still in the write-ahead log."""
        journal, wal, shared = (
            self.path.with_name(self.path.name + tail) for tail in ("-journal", "-wal", "-shm")
        )
        page, _ = self._pages()
        torn = self.size % page
        if torn and not self.salvage:
            raise sqlite3.DatabaseError("it ends inside a page")
        if not _filled(wal) and not _filled(journal) and not torn:
            # Nothing pending: SQLite needs neither locks nor a writable folder.
            return _open(self.path, "immutable=1", damaged=self.salvage)
        if not _filled(journal) and not torn:
            # Rows may still be in the write-ahead log. While a recorder is running its shared index
            # is used; otherwise nobody can be writing, and SQLite makes an index in memory. Neither
            # way creates files beside the bag.
            live = shared.exists()
            with suppress(*_UNREADABLE):
                mode = "readonly_shm=1" if live else "vfs=unix-none"
                return _open(self.path, f"mode=ro&{mode}", exclusive=not live, damaged=self.salvage)
        # With a transaction to roll back, a folder in which SQLite cannot create its lock file, or
        # half a page at the end, which it would read as if zeros followed: work on a copy.
        self._beside = TemporaryFolder()
        copy = self._beside.path / self.path.name
        try:
            for source in (self.path, wal, journal):
                if source.exists():
                    shutil.copyfile(source, copy.with_name(source.name))
            if torn:
                os.truncate(copy, self.size - torn)
        except OSError as exc:
            raise UnsupportedLogError(
                self.path,
                f"cannot be copied into {self._beside.path} ({exc.strerror})",
                "set TMPDIR to a folder with room for it",
            ) from exc
        return _open(copy, "mode=rw", damaged=self.salvage)

    def _read_topics(self, database: sqlite3.Connection) -> None:
        # A view or a virtual table may produce endless rows.
        computed = database.execute(
            "SELECT name, type FROM sqlite_master WHERE lower(name) IN"
            " ('topics', 'messages', 'message_definitions') AND (type = 'view' OR rootpage = 0)"
        ).fetchone()
        if computed is not None:
            what = f"not a ROS 2 bag: {computed[0]} is a {computed[1]} that computes its rows"
            raise NotALogError(self.path, what)
        tables = {
            name: [row[1] for row in database.execute(f"PRAGMA table_info({name})")]
            for name in ("topics", "messages", "message_definitions")
        }
        if not {"id", "name", "type"} <= set(tables["topics"]) or not (
            {"topic_id", "timestamp", "data"} <= set(tables["messages"])
        ):
            raise NotALogError(self.path, "an SQLite database, but not of a ROS 2 bag")
        self._message_columns = tables["messages"]
        definitions: dict[str, tuple[str, str]] = {}
        if tables["message_definitions"]:
            rows = database.execute(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
            definitions = {str(name): (str(kind), str(text)) for name, kind, text in rows}
        # Columns came with the versions of the schema: 2 brought QoS, 4 the type hashes.
        optional = [
            name
            for name in ("serialization_format", "offered_qos_profiles", "type_description_hash")
            if name in tables["topics"]
        ]
        columns = ", ".join(["id", "name", "type", *optional])
        for number, topic, kind, *rest in database.execute(f"SELECT {columns} FROM topics"):
            more = {name: str(value) for name, value in zip(optional, rest, strict=True) if value}
            encoding = more.pop("serialization_format", "cdr")
            schema_encoding, text = definitions.get(str(kind), ("ros2msg", ""))
            self.channels[int(number)] = Channel(
                int(number), str(topic), str(kind), encoding, schema_encoding, text, more
            )
        self._last_row = 0
        try:
            (last,) = database.execute("SELECT max(rowid) FROM messages").fetchone()
            self._last_row = int(last or 0)
        except _UNREADABLE as exc:
            _raise_if_interrupted(exc)
            if not self.salvage:
                raise self._damaged(exc) from exc

    # -- reading ---------------------------------------------------------------------------

    def _read(self, selection: frozenset[int] | None) -> Iterator[RawBatch]:
        """Raw messages in the order they were inserted (see `Log.batches`)."""
        chosen = ""
        if selection is not None:
            chosen = f" AND topic_id IN ({', '.join(map(str, sorted(selection)))})"
        # The alias avoids the name in the schema, which may be damaged and not decodable.
        columns = "rowid AS row, topic_id, timestamp, data"
        query = f"SELECT {columns} FROM messages WHERE rowid > ?{chosen}"
        assert self._database is not None, "the log is closed"
        gathering = _Gathering(self._position, self._odd_row)
        begun = _FIRST_ROW
        places, limit = 0, ""
        unreachable = False
        while places < MAX_PLACES:
            places += gathering.row < begun  # damaged pages may lead back, and again and again
            begun = gathering.row
            try:
                rows = self._database.execute(f"{query} ORDER BY rowid{limit}", (begun,))
                yield from gathering.batches(rows)
                if not limit or gathering.row == begun:
                    break
                limit = ""
            except _UNREADABLE as exc:
                _raise_if_interrupted(exc)
                if not self.salvage:
                    raise self._damaged(exc) from exc
                if not limit:
                    # Python reads one row ahead, and returns none where the next cannot be read.
                    limit = " LIMIT 1"
                    continue
                limit = ""
                before = max(gathering.row, 0)  # ids of a bag begin with 1
                there = None if selection is None else self._row_after(before)
                if there is not None and there[0] > gathering.row:
                    # of a topic that was not chosen: what is damaged comes later
                    gathering.row = there[0]
                    continue
                again, time = self._next_readable(before)
                if again <= gathering.row:  # damaged pages may lead back
                    again = 0
                places += 1
                if not again and self._cut_short():
                    unreachable = True
                    break
                to = f" to {again - 1}" if again else " and those after it"
                what = f"message {before + 1}{to} cannot be read: {exc}"
                self.note_lost(Lost(what, "row", start_ns=gathering.last_ns, end_ns=time))
                if not again:
                    break
                gathering.row = max(again - 1, gathering.row + 1)
        else:
            what = f"messages after {gathering.row} were not read: {places} damaged places"
            self.note_lost(
                Lost(f"{what} precede them", "row", start_ns=gathering.last_ns), always=True
            )
        if unreachable:
            after = max(gathering.row, 0)
            pages = self._on_pages(after)
            yield from gathering.batches(
                row for row in pages if selection is None or row[1] in selection
            )
            # the same for every selection of topics
            what = f"message {after + 1} and those after it cannot be read but for whole pages"
            self.note_lost(Lost(what, "row"))
        if gathering.waits:
            yield gathering.take()

    def _odd_row(self, row: int, last_ns: int | None, exc: TypeError) -> None:
        """Note a row with values of types that no bag has."""
        if not self.salvage:
            raise self._damaged(exc) from exc
        self.note_lost(Lost(f"message {row}: {exc}", "row", start_ns=last_ns))

    def _on_pages(self, after: int) -> Iterator[Row]:
        """Messages behind a row on whole pages that the file still has, wherever they are."""
        return Pages(self.path, self._message_columns, self.channels.__contains__).messages(after)

    def _next_readable(self, row: int) -> tuple[int, int | None]:
        """The next readable row after a damaged page, and its time; 0 without one."""
        # Exponential search for a readable row, then bisection for the first one
        step = 1
        while (good := self._row_after(row + step)) is None:
            step *= 2
            if row + step >= 2**62:
                return 0, None
        bad, readable = step // 2, step
        while readable - bad > 1:
            middle = (bad + readable) // 2
            there = self._row_after(row + middle)
            if there is None:
                bad = middle
            else:
                readable, good = middle, there
        number, time = good
        return number, time if isinstance(time, int) else None

    def _row_after(self, row: int) -> tuple[int, int | None] | None:
        """The row after another, and its time; (0, None) if there is none, None if unreadable."""
        assert self._database is not None
        query = "SELECT rowid AS row, timestamp, data FROM messages WHERE rowid > ? ORDER BY rowid"
        try:
            found = self._database.execute(f"{query} LIMIT 1", (row,)).fetchone()
        except _UNREADABLE as exc:
            _raise_if_interrupted(exc)
            return None
        return (0, None) if found is None else (found[0], found[1])

    def _position(self, row: int) -> int:
        return int(self.size * min(1.0, max(0, row) / max(1, self._last_row)))


class _Gathering:
    """Messages of rows, gathered in flat arrays until they make a batch.

    Parameters
    ----------
    position : callable
        How far into the file a row is, bytes.
    odd : callable
        Called for each row that holds values of other types, with the time of the one before.

    Attributes
    ----------
    row : int
        The last row that was read.
    last_ns : int or None
        Time of its message.
    """

    def __init__(
        self,
        position: Callable[[int], int],
        odd: Callable[[int, int | None, TypeError], None],
    ) -> None:
        self._position, self._odd = position, odd
        self.row = _FIRST_ROW
        self.last_ns: int | None = None
        self._empty()

    def _empty(self) -> None:
        self._topics, self._times, self._lengths = array("q"), array("q"), array("q")
        self._data = bytearray()

    def batches(self, rows: Iterable[Row]) -> Iterator[RawBatch]:
        """Batches as rows fill them; what is left over waits for more rows."""
        row, last_ns = self.row, self.last_ns
        topics, times, lengths, data = self._topics, self._times, self._lengths, self._data
        try:
            # A single loop, as every statement here is executed for every message.
            for row, topic, time, blob in rows:
                try:
                    topics.append(topic)
                    times.append(time)
                    data += blob
                except TypeError as exc:
                    # SQLite allows any type in any column; a bag does not.
                    del topics[len(lengths) :], times[len(lengths) :]
                    self._odd(row, last_ns, exc)
                    continue
                last_ns = time
                lengths.append(len(blob))
                if len(lengths) == BATCH or len(data) >= BATCH_BYTES:
                    self.row = row
                    yield self.take()
                    topics, times, lengths = self._topics, self._times, self._lengths
                    data = self._data
        finally:
            self.row, self.last_ns = row, last_ns

    @property
    def waits(self) -> bool:
        """Whether there are messages that make no whole batch yet."""
        return bool(self._lengths)

    def take(self) -> RawBatch:
        """All that waits, as a batch."""
        buffer = np.frombuffer(self._data, np.uint8)
        # Read-only, as from all other readers, so that compiled loops need no second version
        buffer.flags.writeable = False
        topic, time, length = (
            np.frombuffer(a, np.int64) for a in (self._topics, self._times, self._lengths)
        )
        self._empty()
        sequence = np.zeros(len(length), np.int64)
        first, position = np.cumsum(length) - length, self._position(self.row)
        return RawBatch(buffer, topic, first, length, time, time, sequence, position)


def _raise_if_interrupted(exc: Exception) -> None:
    """Raise an interruption by a signal during a query, which SQLite reports as its own error."""
    if isinstance(exc, sqlite3.OperationalError) and str(exc) == "interrupted":
        raise KeyboardInterrupt from exc


def _filled(path: Path) -> bool:
    return path.exists() and path.stat().st_size > 0


def _open(
    path: Path, mode: str, *, exclusive: bool = False, damaged: bool = False
) -> sqlite3.Connection:
    # Batches may be read in another thread than the one that opened the log.
    database = sqlite3.connect(
        f"file:{quote(str(path.absolute()))}?{mode}", uri=True, check_same_thread=False
    )
    database.text_factory = _text
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_BLOCK)
    # Python runs signal handlers when SQLite calls this function.
    database.set_progress_handler(lambda: 0, _STEPS)
    try:
        if exclusive:
            database.execute("PRAGMA locking_mode=EXCLUSIVE")
        if damaged:
            # Otherwise SQLite refuses a truncated file altogether.
            database.execute("PRAGMA writable_schema=ON")
        database.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except _UNREADABLE:
        database.close()
        raise
    return database


def _text(raw: bytes) -> str:
    return raw.decode("utf-8", "replace")
