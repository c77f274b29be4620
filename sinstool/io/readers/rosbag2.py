"""ROS 2 bag folders: ``metadata.yaml`` and the files in it, as one log.

The content of each file shows its format (SQLite, MCAP, or one of these inside zstd), and that of
each message whether it is compressed, so the metadata only gives the order of the files.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO

import numpy as np
import zstandard
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from sinstool.core.arrays import BoolArray
from sinstool.core.errors import DamagedLogError, LogError, NotALogError, UnsupportedLogError
from sinstool.core.temporary import TemporaryFolder
from sinstool.io.messages.layout import ZSTD_MAGIC
from sinstool.io.readers.batch import RawBatch
from sinstool.io.readers.compression import MOST_SWELLING, CompressionError, decompress
from sinstool.io.readers.formats import METADATA, kind_of
from sinstool.io.readers.limits import ORDINARY_BLOCK
from sinstool.io.readers.log import Log
from sinstool.io.readers.lost import Lost
from sinstool.io.readers.mcap import McapLog
from sinstool.io.readers.sqlite import SqliteLog

MAX_METADATA = 4 * 2**20
# Decompressed messages are handed on in portions of about this many bytes.
PORTION = 32 * 2**20
_PIECE = 8192
_SUFFIXES = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd")
_COMPANIONS = ("-wal", "-shm", "-journal")


class Rosbag2Log(Log):
    """A ROS 2 bag folder, its files read one after the other.

    A channel is one topic of one type and encoding, with the same number in all files.
    """

    format = "rosbag2"
    profile = "ros2"

    def __init__(self, path: Path, salvage: bool = False) -> None:
        super().__init__(path, salvage)
        self._disk_sizes: list[int] = []
        self._numbers: list[dict[int, int]] = []
        self._unpacked: TemporaryFolder | None = None
        self._compressed_messages = False
        self._declared: dict[str, int] = {}  # messages by topic, as the metadata has them
        try:
            for file in self._files():
                self._add_part(file)
            if not self.parts:
                what = "none of the bag's files could be opened"
                raise DamagedLogError(path, what, "; ".join(map(str, self.lost)))
        except OSError as exc:
            self.close()
            raise NotALogError(path, f"cannot be read ({exc.strerror}: {exc.filename})") from exc
        except BaseException:
            self.close()
            raise
        self._unify()

    def close(self) -> None:
        """Close all files and remove decompressed copies."""
        for part in self.parts:
            part.close()
        if self._unpacked is not None:
            self._unpacked.cleanup()
            self._unpacked = None

    @property
    def lost(self) -> list[Lost]:
        """Parts that were skipped so far, in all files."""
        theirs = [replace(n, file=part.path.name) for part in self.parts for n in part.lost]
        return [*self._lost.all(), *theirs]

    # -- opening ---------------------------------------------------------------------------

    def _files(self) -> list[Path]:
        """The bag's files, in order."""
        if not (self.path / METADATA).is_file():
            return self._files_without_metadata()
        information = self._metadata()
        if information is None:
            return self._files_without_metadata()
        storage = information.get("storage_identifier", "")
        if storage not in ("sqlite3", "mcap"):
            raise UnsupportedLogError(
                self.path, f"its storage is '{storage}'", "sinstool reads sqlite3 and mcap"
            )
        mode = str(information.get("compression_mode") or "").lower()
        kind = str(information.get("compression_format") or "").lower()
        if mode in ("file", "message") and kind != "zstd":
            raise UnsupportedLogError(
                self.path, f"it is compressed with '{kind}'", "sinstool reads zstd"
            )
        self._compressed_messages = mode == "message"
        self._declared = _declared_counts(information.get("topics_with_message_count"))
        files = []
        for listed in information.get("relative_file_paths") or []:
            # Early versions wrote the folder's own name too; files always lie in the folder.
            name = PurePosixPath(str(listed)).name
            candidates = [self.path / name, self.path / f"{name}.zstd"]
            file = next((c for c in candidates if c.is_file()), None)
            if file is None:
                self.damage(f"{METADATA} lists {name}, which is missing", kind="file")
            else:
                files.append(file)
        if not files:
            self.damage(f"{METADATA} lists no file that exists", kind="file")
            return self._files_without_metadata()
        return files

    def _metadata(self) -> dict[str, Any] | None:
        file = self.path / METADATA
        try:
            if file.stat().st_size > MAX_METADATA:
                raise ValueError(f"it has {file.stat().st_size} bytes")
            information = YAML(typ="safe").load(file.read_text("utf-8"))[
                "rosbag2_bagfile_information"
            ]
            if not isinstance(information, dict):
                raise TypeError("it describes no bag")
        except (YAMLError, OSError, ValueError, TypeError, KeyError, RecursionError) as exc:
            reason = " ".join(str(exc).split())[:200]
            self.damage(f"{METADATA} cannot be used ({reason or type(exc).__name__})", kind="file")
            return None
        return information

    def _files_without_metadata(self) -> list[Path]:
        files = [
            p
            for p in self.path.iterdir()
            if p.is_file() and not p.name.startswith(".") and p.name != METADATA
        ]
        files = [p for p in files if not p.name.endswith(_COMPANIONS)]
        logs = [p for p in files if p.name.endswith(_SUFFIXES)]
        kinds = {p.name.removesuffix(".zstd").rsplit(".", 1)[1] for p in logs}
        if len(kinds) == 1 and len(logs) == len(files):
            return sorted(logs, key=_natural)
        counts = Counter(p.suffix or p.name for p in files)
        holds = ", ".join(f"{n} {suffix}" for suffix, n in sorted(counts.items())) or "no files"
        raise NotALogError(
            self.path,
            f"a folder without {METADATA} that holds {holds}",
            "name one log, or a ROS 2 bag folder",
        )

    def _add_part(self, file: Path) -> None:
        try:
            part = self._open_part(file)
        except LogError as exc:
            if not self.salvage or isinstance(exc, UnsupportedLogError):
                raise
            self.note_lost(Lost(str(exc), "file"))
            return
        self.parts.append(part)
        self._disk_sizes.append(file.stat().st_size)

    def _open_part(self, file: Path) -> Log:
        with file.open("rb") as stream:
            kind, head = kind_of(stream)
        if head.startswith(ZSTD_MAGIC):
            file = self._decompressed(file)
            with file.open("rb") as stream:
                kind, head = kind_of(stream)
        if kind == "mcap":
            return McapLog(file, self.salvage)
        if kind == "sqlite":
            return SqliteLog(file, self.salvage)
        raise NotALogError(file, f"neither SQLite nor MCAP: it begins with {head[:8]!r}")

    def _decompressed(self, file: Path) -> Path:
        """Decompress a file of the bag into a temporary folder, which `close` removes."""
        if self._unpacked is None:
            self._unpacked = TemporaryFolder()
        target = self._unpacked.path / file.name.removesuffix(".zstd")
        try:
            with file.open("rb") as source, target.open("wb") as sink:
                # A file that expands more is no recording, and would only fill the disk.
                limit = max(ORDINARY_BLOCK, MOST_SWELLING * file.stat().st_size)
                whole = _unzstd(source, sink, limit)
        except zstandard.ZstdError as exc:
            self.damage(f"{file.name}: zstd data is corrupt ({exc})", kind="file")
        except OSError as exc:
            raise UnsupportedLogError(
                file,
                f"cannot be decompressed into {self._unpacked.path} ({exc.strerror})",
                "set TMPDIR to a folder with room for it",
            ) from exc
        else:
            if not whole:
                swollen = target.stat().st_size > limit
                what = f"it unpacks to more than {limit} bytes, more than any recording"
                what = what if swollen else "the zstd data ends too early"
                self.damage(f"{file.name}: {what}", kind="file")
        return target

    def _unify(self) -> None:
        """Number the channels of all files as one log."""
        numbers_of: dict[tuple[str, str, str], list[int]] = {}
        for part in self.parts:
            numbers = {}
            for number, channel in sorted(part.channels.items()):
                key = (channel.recorded_topic, channel.type, channel.message_encoding)
                same = [
                    n
                    for n in numbers_of.setdefault(key, [])
                    if self.channels[n].schema_text == channel.schema_text
                    or not self.channels[n].schema_text
                    or not channel.schema_text
                ]
                here = same[0] if same else len(self.channels) + 1
                if not same:
                    numbers_of[key].append(here)
                if not same or not self.channels[here].schema_text:
                    self.channels[here] = replace(channel, id=here)
                numbers[number] = here
            self._numbers.append(numbers)
        if self._declared and (self._lost.all() or not all(p.counts for p in self.parts)):
            for topic, count in self._declared.items():
                if channels := self.channels_of(topic):
                    self.counts[channels[0].id] = count
        elif all(part.counts for part in self.parts):
            for part, numbers in zip(self.parts, self._numbers, strict=True):
                for number, count in part.counts.items():
                    if number in numbers:
                        here = numbers[number]
                        self.counts[here] = self.counts.get(here, 0) + count

    # -- reading ---------------------------------------------------------------------------

    def _read(self, selection: frozenset[int] | None) -> Iterator[RawBatch]:
        """Raw messages, file after file (see `Log.batches`)."""
        before = 0
        for part, numbers, size in zip(self.parts, self._numbers, self._disk_sizes, strict=True):
            chosen = [n for n, here in numbers.items() if selection is None or here in selection]
            theirs = np.array(sorted(numbers), np.int64)
            ours = np.array([numbers[n] for n in theirs.tolist()], np.int64)
            for batch in part.batches(None if selection is None else chosen) if chosen else ():
                position = before + int(size * min(1.0, batch.position / max(1, part.size)))
                channel = ours[np.searchsorted(theirs, batch.channel)]
                batch = replace(batch, channel=channel, position=position)
                packed = _packed(batch)
                if self._compressed_messages or packed.any():
                    yield from self._decompress_messages(batch, packed, part)
                else:
                    yield batch
            before += size

    def _decompress_messages(
        self, batch: RawBatch, packed: BoolArray, part: Log
    ) -> Iterator[RawBatch]:
        """The batch with every payload decompressed, in portions of bounded size."""
        data = batch.buffer.data
        payloads: list[bytes] = []
        rows: list[int] = []
        size = 0
        for row, (offset, length) in enumerate(
            zip(batch.offset.tolist(), batch.length.tolist(), strict=True)
        ):
            raw = data[offset : offset + length]
            # CDR begins with a zero; other bytes are damage where the metadata promises zstd
            plain = not packed[row] and (raw[:1] == b"\0" or not self._compressed_messages)
            try:
                payload = bytes(raw) if plain else _unzstd_message(raw)
            except CompressionError as exc:
                self.damage(f"{part.path.name}: a message's {exc}", kind="file")
                continue
            payloads.append(payload)
            rows.append(row)
            size += len(payload)
            if size > PORTION:
                yield _repacked(batch, rows, payloads)
                payloads, rows, size = [], [], 0
        if rows:
            yield _repacked(batch, rows, payloads)


def _declared_counts(listed: object) -> dict[str, int]:
    """Messages by topic out of the metadata, as far as they can be read."""
    counts: dict[str, int] = {}
    for entry in listed if isinstance(listed, list) else ():
        with suppress(TypeError, ValueError, KeyError):
            topic, count = str(entry["topic_metadata"]["name"]), int(entry["message_count"])
            if 0 <= count < 2**63:
                counts[topic] = counts.get(topic, 0) + count
    return counts


def _packed(batch: RawBatch) -> BoolArray:
    """Which messages begin as zstd data do, and no CDR does."""
    packed = batch.length >= len(ZSTD_MAGIC)
    for place, byte in enumerate(ZSTD_MAGIC):
        packed[packed] = batch.buffer[batch.offset[packed] + place] == byte
        if not packed.any():
            break
    return np.asarray(packed)


def _repacked(batch: RawBatch, rows: list[int], payloads: list[bytes]) -> RawBatch:
    length = np.fromiter(map(len, payloads), np.int64, len(payloads))
    buffer = np.frombuffer(b"".join(payloads), np.uint8)
    offset = np.cumsum(length) - length
    return replace(batch.rows(rows), buffer=buffer, offset=offset, length=length)


def _unzstd_message(data: memoryview) -> bytes:
    try:
        size = zstandard.frame_content_size(data)
        if size >= 0:
            return bytes(decompress("zstd", data, size))
        out = BytesIO()
        whole = _unzstd(BytesIO(data), out, ORDINARY_BLOCK)
    except zstandard.ZstdError as exc:
        raise CompressionError(f"zstd data is corrupt ({exc})") from exc
    if not whole:
        raise CompressionError(f"zstd data ends too early or is more than {ORDINARY_BLOCK} bytes")
    return out.getvalue()


def _unzstd(source: BinaryIO, sink: BinaryIO, limit: int | None = None) -> bool:
    """Decompress any number of frames; False where the data ends inside one, or at the limit."""
    # Input goes in by small pieces, as hostile data can expand by a factor of 32768.
    pending = b""
    while True:
        frame = zstandard.ZstdDecompressor().decompressobj()
        pending = pending or source.read(_PIECE)
        if not pending:
            return True
        while not frame.eof:
            if not pending:
                return False
            sink.write(frame.decompress(pending))
            if limit is not None and sink.tell() > limit:
                return False
            pending = source.read(_PIECE) if not frame.eof else frame.unused_data


def _natural(path: Path) -> list[tuple[int, str]]:
    """Order by the numbers in a name: bag_2 before bag_10."""
    return [
        (int(part), "") if part.isdecimal() else (-1, part)
        for part in re.split(r"(\d+)", path.name)
    ]
