"""Index entries of an MCAP's attachments and metadata, read from the records.

These records are copied byte for byte. One that contradicts itself would make the copy unreadable,
or pass on data that differ from what was recorded.
"""

from __future__ import annotations

import struct

import mcap.records as records
from isal.isal_zlib import crc32
from mcap.opcode import Opcode

_HEAD = 9
CHECKED = {Opcode.ATTACHMENT: "attachment", Opcode.METADATA: "metadata"}
Index = records.AttachmentIndex | records.MetadataIndex


class RecordError(ValueError):
    """A record contradicts itself; the message says how."""


def index_of(opcode: int, record: bytes, offset: int) -> Index | None:
    """Index of an attachment or a metadata record.

    Parameters
    ----------
    record : bytes
        The whole record, its 9-byte head included.
    offset : int
        Where it lies in its file.

    Returns
    -------
    AttachmentIndex or MetadataIndex or None
        None for records of other kinds.

    Raises
    ------
    RecordError
        Its lengths do not fit together, a name is not UTF-8, or the CRC does not match.
    """
    if opcode not in CHECKED:
        return None
    if len(record) < _HEAD or int.from_bytes(record[1:_HEAD], "little") != len(record) - _HEAD:
        raise RecordError("it is cut short")
    try:
        return (_attachment if opcode == Opcode.ATTACHMENT else _metadata)(record, offset)
    except struct.error:
        raise RecordError("its lengths do not fit together") from None
    except UnicodeDecodeError:
        raise RecordError("a text in it is not UTF-8") from None


def _attachment(record: bytes, offset: int) -> records.AttachmentIndex:
    log_time, create_time = struct.unpack_from("<QQ", record, _HEAD)
    name, pos = _text(record, _HEAD + 16)
    media_type, pos = _text(record, pos)
    (size,) = struct.unpack_from("<Q", record, pos)
    end = pos + 8 + size  # later versions of the format may put more behind the CRC
    if end + 4 > len(record):
        raise RecordError("its lengths do not fit together")
    (crc,) = struct.unpack_from("<I", record, end)
    if crc and crc32(memoryview(record)[_HEAD:end]) != crc:
        raise RecordError("its CRC does not match its content")
    return records.AttachmentIndex(
        offset=offset,
        length=len(record),
        log_time=log_time,
        create_time=create_time,
        data_size=size,
        name=name,
        media_type=media_type,
    )


def _metadata(record: bytes, offset: int) -> records.MetadataIndex:
    name, pos = _text(record, _HEAD)
    (size,) = struct.unpack_from("<I", record, pos)
    pos += 4
    end = pos + size
    while pos < end:
        for _ in ("key", "value"):
            _, pos = _text(record, pos)
    if pos != end or end > len(record):
        raise RecordError("its lengths do not fit together")
    return records.MetadataIndex(offset, len(record), name)


def _text(record: bytes, pos: int) -> tuple[str, int]:
    """A text behind its length, and where it ends."""
    (length,) = struct.unpack_from("<I", record, pos)
    (raw,) = struct.unpack_from(f"{length}s", record, pos + 4)
    return raw.decode(), pos + 4 + length
