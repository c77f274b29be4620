"""The MCAP format's conformance set: what is in its files, and which features are combined."""

import struct
import zlib
from collections.abc import Iterator
from itertools import combinations

# Abbreviations as in the names of the set's files: chunks, message index, statistics, repeated
# schemas and channels, attachment, metadata and chunk index, summary offsets, padded records
FEATURES = ("ch", "mx", "st", "rsh", "rch", "ax", "mdx", "chx", "sum", "pad")
IN_SUMMARY = {"chx", "rsh", "rch", "mdx", "ax", "st"}
# What a feature is about, without which it makes no sense
NEEDS = {
    "ax": {"Attachment"},
    "mdx": {"Metadata"},
    "rsh": {"Schema"},
    "rch": {"Channel"},
    "ch": {"Message", "Channel", "Schema"},
}

_SCHEMA = {"type": "Schema", "id": 1, "name": "Example", "encoding": "c", "data": [4, 5, 6]}
_CHANNEL = {
    "type": "Channel",
    "id": 1,
    "topic": "example",
    "schemaId": 1,
    "messageEncoding": "a",
    "metadata": {"foo": "bar"},
}


def _message(log_time: int, publish_time: int, sequence: int) -> dict:
    return {
        "type": "Message",
        "channelId": 1,
        "publishTime": str(publish_time),
        "logTime": str(log_time),
        "data": [1, 2, 3],
        "sequence": sequence,
    }


INPUTS: dict[str, list[dict]] = {
    "NoData": [],
    "OneSchemalessMessage": [
        _CHANNEL | {"schemaId": 0, "messageEncoding": "text", "metadata": {}},
        _message(2, 1, 10),
    ],
    "OneMessage": [_SCHEMA, _CHANNEL, _message(2, 1, 10)],
    "OneAttachment": [
        {
            "type": "Attachment",
            "name": "myFile",
            "mediaType": "application/octet-stream",
            "logTime": "2",
            "createTime": "1",
            "data": [1, 2, 3],
        }
    ],
    "OneMetadata": [{"type": "Metadata", "name": "myMetadata", "metadata": {"foo": "bar"}}],
    "TenMessages": [
        _SCHEMA,
        _CHANNEL,
        *(_message(t, t, k) for k, t in enumerate((0, 2, 1, 3, 3, 5, 4, 7, 8, 9))),
    ],
}


def variants() -> Iterator[dict]:
    """All files of the set: name, features, and records."""
    for base, records in INPUTS.items():
        there = {record["type"] for record in records}
        for size in range(len(FEATURES) + 1):
            for chosen in combinations(FEATURES, size):
                has = set(chosen)
                if any(f in has and not NEEDS[f] & there for f in NEEDS):
                    continue
                if has & {"chx", "mx"} and "ch" not in has:
                    continue
                if "sum" in has and not has & IN_SUMMARY:
                    continue
                yield {
                    "name": "-".join([base, *sorted(chosen)]),
                    "features": list(chosen),
                    "records": records,
                }


# -- the same files without @mcap/core -----------------------------------------------------------

PADDING = b"\x01\xff\xff"
_OPCODES = {"Schema": 3, "Channel": 4, "Message": 5, "Attachment": 9, "Metadata": 12}
_NOT_PADDED = (2, 5, 6, 15)  # footer, message, chunk, end of data


def _string(text: str | bytes) -> bytes:
    raw = text.encode() if isinstance(text, str) else text
    return struct.pack("<I", len(raw)) + raw


def _map(items: dict[str, str]) -> bytes:
    return _string(b"".join(_string(key) + _string(value) for key, value in items.items()))


def _body(r: dict) -> bytes:
    """What follows the opcode and the length."""
    data = bytes(r.get("data", ()))
    match r["type"]:
        case "Schema":
            text = _string(r["name"]) + _string(r["encoding"]) + _string(data)
            return struct.pack("<H", r["id"]) + text
        case "Channel":
            head = struct.pack("<HH", r["id"], r["schemaId"])
            return head + _string(r["topic"]) + _string(r["messageEncoding"]) + _map(r["metadata"])
        case "Message":
            times = int(r["logTime"]), int(r["publishTime"])
            return struct.pack("<HIQQ", r["channelId"], r["sequence"], *times) + data
        case "Attachment":
            body = struct.pack("<QQ", int(r["logTime"]), int(r["createTime"]))
            body += _string(r["name"]) + _string(r["mediaType"])
            body += struct.pack("<Q", len(data)) + data
            return body + struct.pack("<I", zlib.crc32(body))
    return _string(r["name"]) + _map(r["metadata"])


def built(features: list[str], records: list[dict]) -> bytes:
    """A file of the set, by the format's description."""
    has = set(features)
    out = bytearray(b"\x89MCAP0\r\n")

    def record(op: int, body: bytes, padded: bool = True) -> bytes:
        if "pad" in has and padded and op not in _NOT_PADDED:
            body += PADDING
        return struct.pack("<BQ", op, len(body)) + body

    def write(op: int, body: bytes) -> tuple[int, int]:
        """Offset and length of the record."""
        start = len(out)
        out.extend(record(op, body))
        return start, len(out) - start

    write(1, _string("") + _string(""))
    messages = [r for r in records if r["type"] == "Message"]
    times = [int(r["logTime"]) for r in messages] or [0]
    chunk, entries, attached, described = b"", {}, [], []
    for r in records:
        if r["type"] == "Attachment":
            attached.append((r, *write(9, _body(r))))
        elif r["type"] == "Metadata":
            described.append((r, *write(12, _body(r))))
        elif "ch" in has:
            if r["type"] == "Message":
                here = entries.setdefault(r["channelId"], b"")
                here += struct.pack("<QQ", int(r["logTime"]), len(chunk))
                entries[r["channelId"]] = here
            chunk += record(_OPCODES[r["type"]], _body(r), padded=False)
        else:
            write(_OPCODES[r["type"]], _body(r))
    if "ch" in has:
        body = struct.pack("<QQQI", min(times), max(times), len(chunk), zlib.crc32(chunk))
        place = write(6, body + _string("") + struct.pack("<Q", len(chunk)) + chunk)
        index_start, offsets = len(out), b""
        for channel, listed in entries.items() if "mx" in has else ():
            offset, _ = write(7, struct.pack("<H", channel) + _string(listed))
            offsets += struct.pack("<HQ", channel, offset)
        index_length = len(out) - index_start
    write(15, struct.pack("<I", zlib.crc32(out)))

    start, groups = len(out), []
    counts: dict[int, int] = {}
    for r in messages:
        counts[r["channelId"]] = counts.get(r["channelId"], 0) + 1

    def group(op: int, feature: str, bodies: list[bytes]) -> None:
        begin = len(out)
        for body in bodies if feature in has else ():
            write(op, body)
        if len(out) > begin:
            groups.append(struct.pack("<BQQ", op, begin, len(out) - begin))

    number = {kind: sum(r["type"] == kind for r in records) for kind in _OPCODES}
    statistics = struct.pack(
        "<QHIIIIQQ",
        len(messages),
        *(number[kind] for kind in ("Schema", "Channel", "Attachment", "Metadata")),
        "ch" in has,
        min(times),
        max(times),
    )
    statistics += _string(b"".join(struct.pack("<HQ", *item) for item in counts.items()))
    group(3, "rsh", [_body(r) for r in records if r["type"] == "Schema"])
    group(4, "rch", [_body(r) for r in records if r["type"] == "Channel"])
    group(11, "st", [statistics])
    group(13, "mdx", [struct.pack("<QQ", *at) + _string(r["name"]) for r, *at in described])
    indexed = []
    for r, *at in attached:
        body = struct.pack("<QQQQQ", *at, int(r["logTime"]), int(r["createTime"]), len(r["data"]))
        indexed.append(body + _string(r["name"]) + _string(r["mediaType"]))
    group(10, "ax", indexed)
    if "chx" in has:
        body = struct.pack("<QQQQ", min(times), max(times), *place) + _string(offsets)
        body += struct.pack("<Q", index_length) + _string("")
        group(8, "chx", [body + struct.pack("<QQ", len(chunk), len(chunk))])
    offset_start = len(out) if "sum" in has else 0
    for body in groups if "sum" in has else ():
        write(14, body)
    footer = struct.pack("<BQQQ", 2, 20, start if groups else 0, offset_start)
    crc = zlib.crc32(bytes(out[start:]) + footer)
    return bytes(out) + footer + struct.pack("<I", crc) + out[:8]
