"""Compiled scans of the records of a chunk: the place of every message.

The record headers are read instead of the chunk's own message index, as the index can be missing
or wrong. Where a header is wrong, the chunk itself is damaged.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.parts import kernel, part

# What stopped a walk
END, PARTIAL, FOREIGN, FULL = 0, 1, 2, 3

_SCHEMA, _CHANNEL, _MESSAGE = 0x03, 0x04, 0x05
_MESSAGE_HEADER = 22
_RECORD_HEADER = 9
# Of ROS 1 bags
_CONNECTION = 7


@part()
def u16(b, p):  # type: ignore[no-untyped-def]
    """Two bytes, little-endian."""
    return np.int64(b[p]) | np.int64(b[p + 1]) << 8


@part()
def u32(b, p):  # type: ignore[no-untyped-def]
    """Four bytes, little-endian."""
    return u16(b, p) | u16(b, p + 2) << 16


@part()
def u64(b, p):  # type: ignore[no-untyped-def]
    """Eight bytes, little-endian; negative from 2^63 on."""
    return u32(b, p) | u32(b, p + 4) << 32


@kernel()
def scan_mcap(buffer, start, out, stop_at_foreign):  # type: ignore[no-untyped-def]
    """Walk MCAP records.

    Parameters
    ----------
    buffer : ndarray, uint8
    start : int
        Where the first record begins.
    out : ndarray of int64, shape (6, m)
        Receives channel, offset, length, log time, publish time, sequence of each message.
    stop_at_foreign : bool
        Stop at records that are no messages (top level of a file) or step over them (chunks).

    Returns
    -------
    count : int
        Messages found.
    end : int
        Where the walk stopped.
    why : int
        END at the buffer's end, PARTIAL at a record that runs over it (or declares a negative
        or too small length, or has the invalid opcode 0), FOREIGN at a record that is not a
        message, FULL at a message for which there is no room.
    """
    size = buffer.shape[0]
    pos = start
    count = 0
    room = out.shape[1]
    while pos < size:
        if pos + _RECORD_HEADER > size:
            return count, pos, PARTIAL
        length = u64(buffer, pos + 1)
        if buffer[pos] != _MESSAGE:
            if stop_at_foreign:
                return count, pos, FOREIGN
            if length < 0 or length > size - pos - _RECORD_HEADER or buffer[pos] == 0:
                return count, pos, PARTIAL
            pos += _RECORD_HEADER + length
            continue
        if length < _MESSAGE_HEADER or length > size - pos - _RECORD_HEADER:
            return count, pos, PARTIAL
        if count == room:
            return count, pos, FULL
        body = pos + _RECORD_HEADER
        out[0, count] = u16(buffer, body)
        out[5, count] = u32(buffer, body + 2)
        out[3, count] = u64(buffer, body + 6)
        out[4, count] = u64(buffer, body + 14)
        out[1, count] = body + _MESSAGE_HEADER
        out[2, count] = length - _MESSAGE_HEADER
        count += 1
        pos = body + length
    return count, pos, END


@kernel()
def definitions_mcap(buffer, start, out):  # type: ignore[no-untyped-def]
    """Places of the schemas and channels in a chunk.

    Parameters
    ----------
    buffer : ndarray, uint8
    start : int
        Where the first record begins.
    out : ndarray of int64, shape (3, m)
        Receives opcode, offset of the body, length.

    Returns
    -------
    count : int
        How many were found.
    end : int
        Where the walk stopped; continue there if `out` is full.
    """
    size = buffer.shape[0]
    pos = start
    count = 0
    while pos + _RECORD_HEADER <= size and count < out.shape[1]:
        length = u64(buffer, pos + 1)
        if length < 0 or length > size - pos - _RECORD_HEADER:
            break
        if buffer[pos] == _SCHEMA or buffer[pos] == _CHANNEL:
            out[0, count] = buffer[pos]
            out[1, count] = pos + _RECORD_HEADER
            out[2, count] = length
            count += 1
        pos += _RECORD_HEADER + length
    return count, pos


@part()
def rosbag1_record(buffer, pos):  # type: ignore[no-untyped-def]
    """Op (-1: no complete record), connection, time (ns), offset and length of a record's data."""
    size = buffer.shape[0]
    nothing = (np.int64(-1), np.int64(-1), np.int64(-1), np.int64(0), np.int64(0))
    if pos + 8 > size:
        return nothing
    header = u32(buffer, pos)
    if header > size - pos - 8:
        return nothing
    field = pos + 4
    header_end = field + header
    op = np.int64(-1)
    connection = np.int64(-1)
    time = np.int64(-1)
    while field < header_end:
        if field + 4 > header_end:
            return nothing
        width = u32(buffer, field)
        name = field + 4
        field = name + width
        if field > header_end:
            return nothing
        # a field is recognised by its first letter and width: op=., conn=...., time=........
        if width == 4 and buffer[name] == 111 and buffer[name + 2] == 61:
            op = np.int64(buffer[name + 3])
        elif width == 9 and buffer[name] == 99 and buffer[name + 4] == 61:
            connection = u32(buffer, name + 5)
        elif width == 13 and buffer[name] == 116 and buffer[name + 4] == 61:
            time = u32(buffer, name + 5) * 1_000_000_000 + u32(buffer, name + 9)
    length = u32(buffer, header_end)
    if length > size - header_end - 4 or (op == 2 and (connection < 0 or time < 0)):
        return nothing
    return op, connection, time, header_end + 4, length


@kernel()
def scan_rosbag1(buffer, start, out, stop_at_foreign):  # type: ignore[no-untyped-def]
    """Walk the records of a ROS 1 bag and note the messages.

    Parameters
    ----------
    buffer : ndarray, uint8
        Decompressed chunk, or a piece of the file's top level.
    start : int
        Where the first record begins.
    out : ndarray of int64, shape (4, m)
        Receives connection, offset, length and time (ns) of each message.
    stop_at_foreign : bool
        Stop at records that are no messages (top level of a file) or step over them (chunks).

    Returns
    -------
    count : int
        Messages found.
    end : int
        Where the walk stopped.
    why : int
        END at the buffer's end, PARTIAL at a record that runs over it or is invalid, FOREIGN at a
        record that is not a message, FULL at a message for which there is no room.
    """
    size = buffer.shape[0]
    pos = start
    count = 0
    while pos < size:
        op, connection, time, offset, length = rosbag1_record(buffer, pos)
        if op < 0:
            return count, pos, PARTIAL
        if op == 2 and count == out.shape[1]:
            return count, pos, FULL
        if op == 2:
            out[0, count] = connection
            out[1, count] = offset
            out[2, count] = length
            out[3, count] = time
            count += 1
        elif stop_at_foreign:
            return count, pos, FOREIGN
        pos = offset + length
    return count, pos, END


@kernel()
def definitions_rosbag1(buffer, start, out):  # type: ignore[no-untyped-def]
    """Places of the connection records in a ROS 1 bag chunk.

    Parameters
    ----------
    buffer : ndarray, uint8
    start : int
        Where the first record begins.
    out : ndarray of int64, shape (m,)
        Receives where each begins.

    Returns
    -------
    count : int
        How many were found.
    end : int
        Where the walk stopped; continue there if `out` is full.
    """
    pos = start
    count = 0
    while pos < buffer.shape[0] and count < out.shape[0]:
        op, _, _, offset, length = rosbag1_record(buffer, pos)
        if op < 0:
            break
        if op == _CONNECTION:
            out[count] = pos
            count += 1
        pos = offset + length
    return count, pos
