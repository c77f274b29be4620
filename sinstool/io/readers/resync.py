"""The next record after a damaged one: compiled searches that visit each byte once.

A position counts as the start of a record only where opcode, length and fields agree with one
another, so that payloads and compressed bytes are not taken for records.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.parts import njit
from sinstool.io.readers.limits import MAX_BLOCK, MAX_RECORD
from sinstool.io.readers.scan import rosbag1_record, u16, u32, u64

_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _INDEX, _DATA_END = 0x03, 0x04, 0x05, 0x06, 0x07, 0x0F
_HEAD = 9
_MAX_ROSBAG1_HEADER = 4096
# Ops of ROS 1 bags
_ROSBAG1_MESSAGE, _ROSBAG1_INDEX, _ROSBAG1_CHUNK, _ROSBAG1_CONNECTION = 2, 4, 5, 7


@njit(cache=True, nogil=True)
def _strings(b, p, end, count):  # type: ignore[no-untyped-def]
    """End of a number of length-prefixed strings that begin at p; -1 where one runs over."""
    for _ in range(count):
        if p + 4 > end:
            return -1
        p += 4 + u32(b, p)
        if p > end:
            return -1
    return p


@njit(cache=True, nogil=True)
def _plain_record(b, p, left, defined):  # type: ignore[no-untyped-def]
    """Whether a schema, a channel or a message begins at p; `left` bytes are there from p on."""
    size = b.shape[0]
    if p + _HEAD > size:
        return False
    op = b[p]
    length = u64(b, p + 1)
    if length < 0 or length > left - _HEAD or length > MAX_RECORD:
        return False
    body = p + _HEAD
    end = body + length
    if op == _MESSAGE:
        if length < 22 or body + 22 > size or defined[u16(b, body)] == 0:
            return False
        return u64(b, body + 6) >= 0 and u64(b, body + 14) >= 0
    if end > size:
        return False
    if op == _SCHEMA:
        return length >= 14 and u16(b, body) > 0 and _strings(b, body + 2, end, 3) == end
    if op == _CHANNEL:
        return length >= 16 and _strings(b, body + 4, end, 3) == end
    return False


@njit(cache=True, nogil=True)
def next_mcap_inside(buffer, start, defined):  # type: ignore[no-untyped-def]
    """Next record inside a decompressed chunk.

    Parameters
    ----------
    buffer : ndarray, uint8
    start : int
        Where to begin.
    defined : ndarray of uint8, shape (65536,)
        1 for channels that exist.

    Returns
    -------
    int
        Where it begins, or -1.
    """
    size = buffer.shape[0]
    for p in range(start, size - 30):
        if not _SCHEMA <= buffer[p] <= _MESSAGE or not _plain_record(buffer, p, size - p, defined):
            continue
        after = p + _HEAD + u64(buffer, p + 1)
        if after + _HEAD > size or (
            _SCHEMA <= buffer[after] <= _MESSAGE and 0 <= u64(buffer, after + 1) <= MAX_RECORD
        ):
            return p
    return -1


@njit(cache=True, nogil=True)
def _chunk(b, p, left):  # type: ignore[no-untyped-def]
    """Whether a chunk record begins at p, complete or cut off by the end of the file."""
    body = p + _HEAD
    if body + 44 > b.shape[0] or left < 53:
        return False
    length = u64(b, p + 1)
    start, end, size = u64(b, body), u64(b, body + 8), u64(b, body + 16)
    name = u32(b, body + 28)
    if not (0 <= start <= end and 0 <= size <= MAX_BLOCK and (name == 0 or 3 <= name <= 4)):
        return False
    at = body + 32
    if name == 3 and not (b[at] == 108 and b[at + 1] == 122 and b[at + 2] == 52):  # lz4
        return False
    if name == 4 and not (b[at] == 122 and b[at + 1] == 115 and b[at + 2] == 116):  # zstd
        return False
    if at + name + 8 > b.shape[0]:
        return False
    data = u64(b, at + name)
    return data == length - 40 - name and (name > 0 or data == size)


@njit(cache=True, nogil=True)
def next_mcap(buffer, start, left, defined, packed):  # type: ignore[no-untyped-def]
    """Next record at the top level of an MCAP file.

    Parameters
    ----------
    buffer : ndarray, uint8
        A piece of the file.
    start : int
        Where to begin.
    left : int
        Bytes of the file from the beginning of the buffer on.
    defined : ndarray of uint8, shape (65536,)
        1 for channels that exist.
    packed : bool
        The file has compressed chunks, in which LZ4 leaves many headers readable, so that messages
        and definitions at top level are not searched for.

    Returns
    -------
    int
        Where a chunk, message, schema, channel, message index or the end of data begins, or -1.
    """
    size = buffer.shape[0]
    for p in range(start, size - _HEAD):
        op = buffer[p]
        if op < _SCHEMA or op > _DATA_END:
            continue
        if op == _CHUNK:
            if _chunk(buffer, p, left - p):
                return p
            continue
        length = u64(buffer, p + 1)
        if length < 0 or length > left - p - _HEAD or length > MAX_RECORD:
            continue
        after = p + _HEAD + length
        if after + _HEAD <= size:
            # The next record need not be sound, but must begin with a valid opcode
            following = buffer[after]
            if following == 0 or following > _DATA_END or u64(buffer, after + 1) < 0:
                continue
        if op == _INDEX:
            if p + _HEAD + 6 <= size and length >= 6:
                entries = u32(buffer, p + _HEAD + 2)
                if entries == length - 6 and entries % 16 == 0:
                    return p
        elif op == _DATA_END:
            if length == 4 and after + _HEAD <= size and buffer[after] != _MESSAGE:
                return p
        elif op <= _MESSAGE and not packed and _plain_record(buffer, p, left - p, defined):
            return p
    return -1


@njit(cache=True, nogil=True)
def _rosbag1_fields(b, p):  # type: ignore[no-untyped-def]
    """Op of the record header that begins at p, and where its data begin; -1 where there is none.

    Unlike the walk, this asks for the fields that the kind of record has.
    """
    size = b.shape[0]
    if p + 8 > size:
        return -1, 0
    header = u32(b, p)
    if header < 12 or header > _MAX_ROSBAG1_HEADER or p + 8 + header > size:
        return -1, 0
    field, end = p + 4, p + 4 + header
    op = -1
    conn, count, time, length = False, False, False, False
    while field < end:
        if field + 4 > end:
            return -1, 0
        width = u32(b, field)
        name = field + 4
        field = name + width
        if width < 2 or field > end:
            return -1, 0
        first = b[name]
        if width == 4 and first == 111 and b[name + 1] == 112 and b[name + 2] == 61:
            op = np.int64(b[name + 3])
        elif width == 9 and first == 99 and b[name + 1] == 111 and b[name + 4] == 61:
            conn = True
        elif width == 10 and first == 99 and b[name + 1] == 111 and b[name + 5] == 61:
            count = True
        elif width == 9 and first == 115 and b[name + 1] == 105 and b[name + 4] == 61:
            length = True
        elif width == 13 and first == 116 and b[name + 1] == 105 and b[name + 4] == 61:
            time = True
        elif first < 97 or first > 122:  # names of fields are words
            return -1, 0
    whole = (
        (op == _ROSBAG1_MESSAGE and conn and time)
        or (op == _ROSBAG1_CONNECTION and conn)
        or (op == _ROSBAG1_CHUNK and length)
        or (op == _ROSBAG1_INDEX and conn and count)
    )
    return (op, end) if whole else (-1, 0)


@njit(cache=True, nogil=True)
def next_rosbag1(buffer, start, left, whole, packed):  # type: ignore[no-untyped-def]
    """Next message, connection, chunk or message index of a ROS 1 bag.

    Parameters
    ----------
    buffer : ndarray, uint8
        A decompressed chunk, or a piece of the file.
    start : int
        Where to begin.
    left : int
        Bytes of the file or chunk from the beginning of the buffer on.
    whole : bool
        Only records that end before `left`; otherwise also a chunk that is cut short.
    packed : bool
        Search for chunks and their indexes only, as the chunks are compressed (see `next_mcap`).

    Returns
    -------
    int
        Where it begins, or -1.
    """
    for p in range(start, buffer.shape[0] - 11):
        if buffer[p + 2] or buffer[p + 3]:
            continue
        op, data = _rosbag1_fields(buffer, p)
        if op < 0 or data + 4 > buffer.shape[0]:
            continue
        if packed and op != _ROSBAG1_CHUNK and op != _ROSBAG1_INDEX:
            continue
        length = u32(buffer, data)
        fits = length <= left - data - 4
        after = data + 4 + length
        if fits and after + 4 <= buffer.shape[0] and u32(buffer, after) > _MAX_ROSBAG1_HEADER:
            continue  # what follows is no record
        if fits or (op == _ROSBAG1_CHUNK and not whole):
            return p
    return -1


@njit(cache=True, nogil=True)
def run_mcap(buffer, start):  # type: ignore[no-untyped-def]
    """Walk whole MCAP records inside a chunk: where the last of them begins, and where it ends."""
    size = buffer.shape[0]
    last, pos = -1, start
    while pos + _HEAD <= size:
        length = u64(buffer, pos + 1)
        if length < 0 or length > size - pos - _HEAD or buffer[pos] == 0:
            break
        if buffer[pos] == _MESSAGE and length < 22:
            break
        last = pos
        pos += _HEAD + length
    return last, pos


@njit(cache=True, nogil=True)
def run_rosbag1(buffer, start):  # type: ignore[no-untyped-def]
    """Walk whole records of a ROS 1 bag: where the last of them begins, and where it ends."""
    last, pos = -1, start
    while pos < buffer.shape[0]:
        op, _, _, offset, length = rosbag1_record(buffer, pos)
        if op < 0:
            break
        last = pos
        pos = offset + length
    return last, pos
