"""Logs and files to be damaged, and ways to damage them: for the fuzzers and the tests.

An input is made from a format, a seed and a number alone, so that each can be made again.
"""

from __future__ import annotations

import random
import shutil
import sqlite3
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import lz4.frame
import zstandard
from mcap.opcode import Opcode
from mcap.writer import CompressionType, IndexType, Writer

from benchmarks.fuzz_texts import HOSTILE, damaged, damaged_text
from tests.helpers.imulogs import even_times, handheld, imu_messages, serialised, store
from tests.helpers.logs import (
    PRESSURE,
    TOPICS,
    Row,
    definition,
    write_bag1,
    write_bag2,
    write_db3,
    write_mcap,
)
from tests.helpers.paths import ROOT

MESSAGES = 20
FORMATS = ("mcap", "bag", "db3")
TEXTS = ("config", "noise", "calibration")
# A type of nobody's, whose definition has definitions behind it
OWN_TYPE = "my_msgs/msg/Foo"
OWN_DEFINITION = f"""\
uint8 LIMIT=5
std_msgs/Header header
my_msgs/Bar[] bars  # of any number
float64[3] values
string<=20 name
{"=" * 80}
MSG: my_msgs/Bar
string[<=4] names
uint8[] data
{"=" * 80}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""
DEFINITIONS = (
    "string", "wstring<=5", "float64[99999999999]", "uint8[]", "uint8[-1]", "Header",
    "std_msgs/Header", OWN_TYPE, "my_msgs/Bar", "a/b/c/d", "/", "MSG:", "MSG: my_msgs/Bar",
    "=" * 80, "=" * 79, "int32 X=5", "string S=#", "@verbatim", "module a { module b {",
    "struct Foo { double x; };", "time", "duration", "char[<=]", "float64[3][3]", "bool",
)  # fmt: skip


YAML = (
    "&a", "*a", "<<: *a", "!!python/object:os.system", "- ", "? ", "{a: b", "[a", "zstd", "FILE",
    "MESSAGE", "sqlite3", "mcap", "../../etc/passwd", "rosbag2_bagfile_information:",
    "message_count:", "files:", "relative_file_paths:", "|", ">", "---", "%YAML 9.9", "\t",
)  # fmt: skip
# Names of logs with side records begin so
SIDE = "side-"


# -- whole files that people write ----------------------------------------------------------------


def _configs(folder: Path) -> None:
    from sinstool.config import ProcessConfig
    from sinstool.config.load import build, dump_toml

    (folder / "defaults.toml").write_text(dump_toml(ProcessConfig()))
    chosen = {
        "input": {"imu_topic": "/imu", "start": "1", "end": "2023-11-14T22:13:40Z"},
        "navigation": {"mode": "ins-gnss", "imu_grade": "mems"},
        "coning": {"coning": "singular-perturbation", "epsilon": 1e-3, "beta": [1.0, 2.0, 3.0]},
        "align": {"align": "fixed", "initial_attitude": [0.0, 0.0, 90.0], "latitude": 48.0},
        "filter": {"smooth": True, "withhold_gnss": ["10:20", "30:40"], "mount": [0.0, 1.0, 2.0]},
        "output": {"emit": ["imu", "tf"], "compression": "lz4"},
    }
    (folder / "chosen.toml").write_text(dump_toml(build(ProcessConfig, chosen, check=False)))
    rig = (ROOT / "sample_data" / "hse" / "rig-a.toml").read_text()
    (folder / "rig.toml").write_text(rig)


def _noises(folder: Path) -> None:
    from sinstool.config.noise import KEYS, SCHEMA, key_of

    lines = [f'schema = "{SCHEMA}"', "[source]", "rate_hz = 100"]
    for sensor, terms in KEYS.items():
        for axis in "xyz":
            lines.append(f"[{sensor}.{axis}]")
            for k, term in enumerate(terms):
                if k % 2:
                    lines.append(f"{key_of(sensor, term, 'below')} = {k}e-5")
                else:
                    lines.append(f"{key_of(sensor, term)} = {k + 1}e-4")
                    lines.append(f"{key_of(sensor, term, '95')} = [{k + 1}e-5, {k + 2}e-4]")
    (folder / "all.toml").write_text("\n".join(lines))


def _calibrations(folder: Path) -> None:
    from sinstool.config import ProcessConfig
    from sinstool.config.load import build, load_toml
    from sinstool.pipelines.calibrate_hse.run import calibrate

    samples = ROOT / "sample_data" / "hse"
    config = build(ProcessConfig, load_toml(samples / "rig-a.toml"))
    logs = sorted(samples.glob("a-*.mcap"))
    calibrate(logs, folder / "hse.json", config)


def make_files(folder: Path) -> None:
    """Make the files of `TEXTS`, each in a folder of its name; they are sound."""
    for name, make in zip(TEXTS, (_configs, _noises, _calibrations), strict=True):
        (folder / name).mkdir(parents=True)
        make(folder / name)


@cache
def rows(count: int, ros: int) -> list[Row]:
    """Imu at 200 Hz that turns by hand on /imu, every third time FluidPressure on /baro."""
    times = even_times(count)
    gyro, accel, _ = handheld(count)
    pressure = store(ros).types[PRESSURE]
    out = []
    for k, m in enumerate(imu_messages(times, gyro, accel, log_ns=times + 900_000, ros=ros)):
        payload = serialised(m.message, m.type_name, ros)
        out.append(Row("/imu", m.log_ns, m.log_ns - 1000, payload))
        if k % 3 == 0:
            at = m.log_ns + 1_000_000
            value = pressure(header=m.message.header, fluid_pressure=95e3 + k, variance=0.0)
            out.append(Row("/baro", at, at, serialised(value, PRESSURE, ros)))
    return out


# -- whole logs --------------------------------------------------------------------------------


def _with_side_records(path: Path, count: int, compression: CompressionType) -> None:
    """An MCAP that holds what a recorder adds: metadata, attachments, a type of nobody's."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=4096, compression=compression)
        writer.start(profile="ros2")
        writer.add_metadata("rig", {"operator": "A. B.", "place": "Zürich", "": ""})
        writer.add_attachment(1, 2, "camera.yaml", "text/yaml", b"fx: 500\n" * 40)
        own = writer.register_schema(OWN_TYPE, "ros2msg", OWN_DEFINITION.encode())
        bare = writer.register_schema("a.B", "", b"")
        ids = {"/own": writer.register_channel("/own", "cdr", own, {"offered_qos_profiles": "-"})}
        writer.register_channel("/bare", "json", bare)
        writer.register_channel("/none", "json", 0)
        for topic, name in TOPICS.items():
            schema = writer.register_schema(name, "ros2msg", definition(name)[0].encode())
            ids[topic] = writer.register_channel(topic, "cdr", schema)
        for k, row in enumerate(rows(count, 2)):
            writer.add_message(ids[row.topic], row.log_time, row.payload, row.publish_time, k)
            writer.add_message(ids["/own"], row.log_time, bytes(80), row.publish_time, k)
        writer.add_attachment(3, 0, "empty", "", b"")
        writer.add_metadata("end", {})
        writer.finish()


def _mcaps(folder: Path, count: int) -> None:
    two, one = rows(count, 2), rows(count, 1)
    bare = {"index_types": IndexType.NONE, "use_statistics": False, "use_summary_offsets": False}
    for name in ("none", "lz4", "zstd"):
        chunk = {"chunk_size": 4096, "compression": name}
        write_mcap(folder / f"{name}.mcap", two, **chunk)
        write_mcap(folder / f"{name}-no-crc.mcap", two, enable_crcs=False, **chunk)
        write_mcap(folder / f"{name}-bare.mcap", two, enable_crcs=False, **bare, **chunk)
    write_mcap(folder / "unchunked.mcap", two, use_chunking=False, enable_crcs=False)
    write_mcap(folder / "unrepeated.mcap", two, enable_crcs=False, repeat_channels=False,
               repeat_schemas=False, compression="lz4")  # fmt: skip
    write_mcap(folder / "ros1.mcap", one, ros=1, enable_crcs=False, compression="lz4")
    write_mcap(folder / "channels.mcap", two, channels={"/imu": 3}, compression="none")
    for compression in CompressionType:
        name = f"{SIDE}{compression.name.lower()}.mcap"
        _with_side_records(folder / name, count, compression)


def _bags(folder: Path, count: int) -> None:
    for name in (None, "lz4", "bz2"):
        write_bag1(folder / f"{name}.bag", rows(count, 1), name, chunk=4096)
    write_bag1(folder / "connections.bag", rows(count, 1), None, chunk=2048, connections=2)


def _databases(folder: Path, count: int) -> None:
    for version in (1, 2, 3, 4):
        write_db3(folder / f"v{version}.db3", rows(count, 2), version)
    for name in ("plain", "file", "message", "mcap"):
        storage = "mcap" if name == "mcap" else "db3"
        mode = name if name in ("file", "message") else None
        write_bag2(folder / f"{name}-folder", rows(count, 2), storage, mode)


def make_logs(folder: Path, count: int = MESSAGES) -> None:
    """Make the logs of every format, each in a folder of its name, with so many Imu messages."""
    for name, make in zip(FORMATS, (_mcaps, _bags, _databases), strict=True):
        (folder / name).mkdir(parents=True)
        make(folder / name, count)


def _spliced(data: bytearray, rng: random.Random, others: list[Path]) -> None:
    other = rng.choice(others).read_bytes()
    start, at = rng.randrange(len(other)), rng.randrange(len(data))
    piece = other[start : start + rng.choice((50, 1000, len(other)))]
    data[at : at + rng.choice((0, len(piece)))] = piece


# -- damage behind compression and checksums ----------------------------------------------------


def _inside_mcap(data: bytes, rng: random.Random) -> bytes:
    """Damage what a chunk holds, and pack it again so that only its content is wrong."""
    out, pos = bytearray(data[:8]), 8
    while pos + 9 <= len(data) - 8:
        length = int.from_bytes(data[pos + 1 : pos + 9], "little")
        body = data[pos + 9 : pos + 9 + length]
        if data[pos] == Opcode.CHUNK and rng.random() < 0.7:
            body = _repacked_chunk(body, rng)
        elif data[pos] in (Opcode.METADATA, Opcode.ATTACHMENT) and rng.random() < 0.3:
            body = damaged(body, rng)
            if data[pos] == Opcode.ATTACHMENT and rng.random() < 0.7:
                body = _attachment(body, rng)
        elif data[pos] == Opcode.SCHEMA and rng.random() < 0.3:
            body = _schema(body, rng)
        elif data[pos] not in (Opcode.CHUNK, Opcode.MESSAGE) and rng.random() < 0.05:
            body = damaged(body, rng)
        out += bytes([data[pos]]) + len(body).to_bytes(8, "little") + body
        pos += 9 + length
    return bytes(out + data[pos:])


def _attachment(body: bytes, rng: random.Random) -> bytes:
    """An attachment whose checksum agrees with it, or is none."""
    content = body[:-4]
    return content + (zlib.crc32(content) if rng.random() < 0.7 else 0).to_bytes(4, "little")


def _schema(body: bytes, rng: random.Random) -> bytes:
    """A schema whose name, encoding or definition is another, its sizes right."""
    out, at, texts = body[:2], 2, []
    for _ in range(3):
        (size,) = struct.unpack_from("<I", body, at)
        texts.append(body[at + 4 : at + 4 + size])
        at += 4 + size
    k = rng.choice((0, 1, 2, 2, 2))
    others = ((OWN_TYPE, "sensor_msgs/msg/Imu", "x", ""), ("ros2msg", "ros2idl", "ros1msg", "a"))
    if k < 2 and rng.random() < 0.5:
        texts[k] = rng.choice(others[k]).encode()
    else:
        texts[k] = damaged_text(texts[k], rng, DEFINITIONS)
    return out + b"".join(struct.pack("<I", len(text)) + text for text in texts)


def _definitions_of_chunk(records: bytes, rng: random.Random) -> bytes:
    """The records of a chunk, schemas among them damaged."""
    out, at = b"", 0
    while at + 9 <= len(records):
        length = int.from_bytes(records[at + 1 : at + 9], "little")
        body = records[at + 9 : at + 9 + length]
        if records[at] == Opcode.SCHEMA and rng.random() < 0.7:
            body = _schema(body, rng)
        out += records[at : at + 1] + len(body).to_bytes(8, "little") + body
        at += 9 + length
    return out


def _repacked_chunk(body: bytes, rng: random.Random) -> bytes:
    change = _definitions_of_chunk if rng.random() < 0.3 else damaged
    (width,) = struct.unpack_from("<I", body, 28)
    kind = body[32 : 32 + width].decode()
    records = body[40 + width :]
    if kind == "lz4":
        records = lz4.frame.compress(change(lz4.frame.decompress(records), rng))
    elif kind == "zstd":
        plain = zstandard.ZstdDecompressor().decompress(records, max_output_size=2**20)
        packer = zstandard.ZstdCompressor(write_content_size=rng.random() < 0.5)
        records = packer.compress(change(plain, rng))
    else:
        records = change(records, rng)
    # times, size as it was declared; no checksum
    head = body[:24] + bytes(4) + body[28 : 32 + width]
    return head + len(records).to_bytes(8, "little") + records


def _bag_records(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Headers and bodies of a bag's records, or of those in a chunk."""
    at = 0
    while at + 8 <= len(data):
        (width,) = struct.unpack_from("<I", data, at)
        (length,) = struct.unpack_from("<I", data, at + 4 + width)
        begin = at + 8 + width
        yield data[at + 4 : at + 4 + width], data[begin : begin + length]
        at = begin + length


def _bag_record(head: bytes, body: bytes) -> bytes:
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(body)) + body


def _connection(body: bytes, rng: random.Random) -> bytes:
    """A connection one of whose fields is another: mostly the definition."""
    fields, at = [], 0
    while at + 4 <= len(body):
        (size,) = struct.unpack_from("<I", body, at)
        fields.append(body[at + 4 : at + 4 + size])
        at += 4 + size
    chosen = [k for k, f in enumerate(fields) if f.startswith(b"message_definition=")]
    k = chosen[0] if chosen and rng.random() < 0.7 else rng.randrange(len(fields))
    name, sign, value = fields[k].partition(b"=")
    fields[k] = name + sign + damaged_text(value, rng, DEFINITIONS)
    return b"".join(struct.pack("<I", len(field)) + field for field in fields)


def _definitions_of_bag_chunk(records: bytes, rng: random.Random) -> bytes:
    return b"".join(
        _bag_record(head, _connection(body, rng) if b"op=\x07" in head else body)
        for head, body in _bag_records(records)
    )


def _inside_bag(data: bytes, rng: random.Random) -> bytes:
    """Damage what a chunk of a ROS 1 bag holds, lz4 packed again."""
    out = bytearray(data[:13])
    for head, body in _bag_records(data[13:]):
        changed = head, body
        if b"op=\x05" in head and rng.random() < 0.7:
            change = _definitions_of_bag_chunk if rng.random() < 0.3 else damaged
            if b"compression=lz4" in head:
                changed = head, lz4.frame.compress(change(lz4.frame.decompress(body), rng))
            elif b"compression=none" in head:
                changed = head, change(body, rng)
        elif b"op=\x07" in head and rng.random() < 0.3:
            changed = head, _connection(body, rng)
        elif rng.random() < 0.05:
            changed = damaged(head, rng), damaged(body, rng) if body else body
        out += _bag_record(*changed)
    return bytes(out)


def _inside_database(path: Path, rng: random.Random) -> None:
    """Put other values into the rows of a database that stays whole itself."""
    database = sqlite3.connect(path)
    try:
        database.execute("PRAGMA synchronous = OFF")
        for _ in range(rng.choice((1, 2, 5))):
            if rng.random() < 0.3:
                _one_definition(database, rng)
            else:
                _one_row(database, rng)
        database.commit()
    finally:
        database.close()


def _one_row(database: sqlite3.Connection, rng: random.Random) -> None:
    number, elsewhere = rng.randrange(1, MESSAGES), rng.choice(HOSTILE) % 2**63
    result = database.execute("SELECT data FROM messages WHERE id = ?", (number,)).fetchone()
    payload = result[0] if result else b""
    other = rng.choice(("text", None, 5, 1.5, b"", rng.choice(HOSTILE) % 2**63, -1, 1e300))
    payload = damaged(payload, rng) if isinstance(payload, bytes) and payload else b"\x00\x01"
    texts = ("", "x" * 3000, "sensor_msgs/msg/Imu", "std_msgs/msg/Header", "\x00", "a/b")
    statement, values = rng.choice((
        ("UPDATE messages SET data = ? WHERE id = ?", (payload, number)),
        ("UPDATE messages SET data = ? WHERE id = ?", (payload, number)),
        ("UPDATE OR IGNORE messages SET data = ? WHERE id = ?", (other, number)),
        ("UPDATE OR IGNORE messages SET timestamp = ? WHERE id = ?", (other, number)),
        ("UPDATE OR IGNORE messages SET topic_id = ? WHERE id = ?", (other, number)),
        ("UPDATE OR IGNORE messages SET id = ? WHERE id = ?", (elsewhere, number)),
        ("UPDATE OR IGNORE topics SET type = ? WHERE id = 1", (rng.choice(texts),)),
        ("UPDATE OR IGNORE topics SET name = ? WHERE id = 1", (rng.choice(texts),)),
        ("UPDATE OR IGNORE topics SET serialization_format = ?", (rng.choice(texts),)),
        ("UPDATE OR IGNORE topics SET name = x'ff00fe'", ()),
        ("DELETE FROM topics WHERE id = ?", (rng.choice((1, 2)),)),
    ))  # fmt: skip
    database.execute(statement, values)


def _one_definition(database: sqlite3.Connection, rng: random.Random) -> None:
    """Damage a definition, where the recorder was new enough to store them."""
    with suppress(sqlite3.OperationalError, sqlite3.IntegrityError):
        result = database.execute(
            "SELECT id, encoded_message_definition FROM message_definitions"
        ).fetchall()
        number, text = rng.choice(result)
        text = text.encode() if isinstance(text, str) else b"uint8 x"
        new = damaged_text(text, rng, DEFINITIONS).decode(errors="replace")
        database.execute(*rng.choice((
            ("UPDATE message_definitions SET encoded_message_definition = ? WHERE id = ?",
             (new, number)),
            ("UPDATE message_definitions SET encoded_message_definition = ? WHERE id = ?",
             (rng.choice((None, 5, b"\xff\x00", "")), number)),
            ("UPDATE message_definitions SET encoding = ?",
             (rng.choice(("ros2idl", "", "ros1msg", None)),)),
            ("UPDATE message_definitions SET topic_type = ? WHERE id = ?",
             (rng.choice((OWN_TYPE, "", "x")), number)),
            ("UPDATE topics SET type = ? WHERE id = 1", (OWN_TYPE,)),
        )))  # fmt: skip


# -- inputs ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Input:
    """A damaged log or file, what it was made from, and how a log is to be opened."""

    path: Path
    """A file or a bag's folder."""
    base: str
    salvage: bool


def make_input(logs: Path, kind: str, seed: int, number: int, folder: Path) -> Input:
    """Make an input from what :func:`make_logs` or `make_files` made, in an empty folder."""
    rng = random.Random(f"{kind} {seed} {number}")
    bases = sorted((logs / kind).iterdir())
    folders = [b for b in bases if b.is_dir()]
    # A folder takes several times as long to read as a file.
    sides = [b for b in bases if b.name.startswith(SIDE)]
    if sides and rng.random() < 0.3:
        base = rng.choice(sides)
    else:
        few = folders and rng.random() < 0.2
        base = rng.choice(folders if few else [b for b in bases if b not in folders])
    target = folder / base.name
    if base.is_dir():
        shutil.copytree(base, target)
        files = sorted(target.iterdir())
    else:
        shutil.copyfile(base, target)
        files = [target]
    file = rng.choice(files)
    if kind in TEXTS:
        file.write_bytes(damaged_text(file.read_bytes(), rng))
        return Input(target, base.name, False)
    inside = rng.random() < (0.7 if base in sides else 0.4)
    if inside and file.suffix == ".yaml":
        file.write_bytes(damaged_text(file.read_bytes(), rng, YAML))
    elif inside and file.suffix == ".db3":
        _inside_database(file, rng)
    else:
        data = file.read_bytes()
        if inside and file.suffix in (".mcap", ".bag"):
            data = (_inside_mcap if file.suffix == ".mcap" else _inside_bag)(data, rng)
        elif rng.random() < 0.1:
            spliced = bytearray(data)
            _spliced(spliced, rng, [b for b in bases if b.is_file()])
            data = bytes(spliced)
        else:
            data = damaged(data, rng)
        file.write_bytes(data)
    return Input(target, base.name, rng.random() < 0.5)
