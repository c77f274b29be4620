"""Logs that are large in one way: five hours, a message of 1 GB, ten thousand topics.

    python benchmarks/large_logs.py --dir /tmp/large

Each goes through whole commands, `process --mode attitude`, plain `process` and `info`, whose loops
a short log has compiled before. Printed are CPU time and peak memory of the process. Each output
must hold every message of the input: the `mcap` package counts them one by one, and of the long
logs, which would take it many minutes, reads the statistics. The logs (5 GB in all) are made one by
one and removed again. Exits with 1 where attitude mode takes more than 1.1 times the memory of an
hour for five.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

from benchmarks.commands import PROGRAM, folder_for_logs, run_child
from benchmarks.common import parser, print_table

Result = TypeVar("Result")

LARGE = 10**9
SECONDS, RATE = 60, 200


def a_minute(path: Path) -> None:
    _with_imu(path, {})


def an_hour(path: Path) -> None:
    _hours(path, 1)


def five_hours(path: Path) -> None:
    _hours(path, 5)


def _hours(path: Path, hours: int) -> None:
    program = Path(__file__).with_name("one_hour.py")
    run_child([sys.executable, str(program), "--make", "zstd", "--minutes", str(60 * hours),
               "--fast-make", "--log", str(path)])  # fmt: skip


def a_large_message(path: Path) -> None:
    _large_message(path, chunked=False)


def a_large_chunk(path: Path) -> None:
    _large_message(path, chunked=True)


def _large_message(path: Path, chunked: bool) -> None:
    """A minute of IMU, and half-way a point cloud of 1 GB that hardly compresses."""
    import numpy as np

    blocks = np.random.default_rng(1).integers(0, 256, 2**20, np.uint8).tobytes()
    cloud = (blocks * (LARGE // len(blocks) + 1))[:LARGE]
    _with_imu(path, {"/cloud": [cloud]}, chunked)


def many_topics(path: Path) -> None:
    """A minute of IMU, and ten thousand topics with two messages each."""
    _with_imu(
        path, {f"/robot/{k}/state": [b"\x00\x01\x00\x00" + bytes(60)] * 2 for k in range(10_000)}
    )


def _with_imu(path: Path, others: dict[str, list[bytes]], chunked: bool = True) -> None:
    from mcap.writer import Writer

    from tests.helpers.imulogs import even_times, handheld, imu_messages, serialised
    from tests.helpers.logs import IMU, definition

    times = even_times(SECONDS * RATE, RATE)
    gyro, accel, _ = handheld(len(times), RATE, rest_s=10.0)
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=chunked)
        writer.start("ros2")
        schema = writer.register_schema(IMU, "ros2msg", definition(IMU)[0].encode())
        own = writer.register_schema("my_msgs/msg/State", "ros2msg", b"uint8[60] data")
        imu = writer.register_channel("/imu", "cdr", schema)
        ids = {topic: writer.register_channel(topic, "cdr", own) for topic in others}
        for k, m in enumerate(imu_messages(times, gyro, accel)):
            writer.add_message(imu, m.log_ns, serialised(m.message, m.type_name, 2), m.log_ns, k)
            if k == len(times) // 2:
                for topic, payloads in others.items():
                    for payload in payloads:
                        writer.add_message(ids[topic], m.log_ns, payload, m.log_ns)
        writer.finish()


def declared(path: Path) -> Counter[str]:
    """Messages by topic, as the statistics of a file have them."""
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None and summary.statistics is not None
    counts = summary.statistics.channel_message_counts
    return Counter({summary.channels[number].topic: n for number, n in counts.items()})


def counted(path: Path) -> Counter[str]:
    """Messages by topic and size, counted one by one."""
    from mcap.exceptions import McapError
    from mcap.records import Channel, Message
    from mcap.stream_reader import StreamReader

    topics, counts = {}, Counter[str]()
    with path.open("rb") as stream:
        try:
            for record in StreamReader(stream, record_size_limit=None).records:
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Message):
                    counts[f"{topics[record.channel_id]} {len(record.data)}"] += 1
        except McapError as exc:
            raise SystemExit(f"{path}: {exc}") from exc
    return counts


LOGS: dict[str, Callable[[Path], None]] = {
    "a minute": a_minute, "an hour": an_hour, "five hours": five_hours,
    "a message of 1 GB": a_large_message, "the same in a chunk": a_large_chunk,
    "10 000 topics": many_topics,
}  # fmt: skip


def apart(function: Callable[[Path], Result], path: Path) -> Result:
    """Call a function in a process of its own: a child's peak is at least its parent's memory."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(function, path).result()


def measure(name: str, folder: Path) -> list[tuple[str, str, float, float]]:
    """Make a log, and run the commands on it: log, command, CPU s and peak MB."""
    log, out = folder / "log.mcap", folder / "out.mcap"
    rows = []
    try:
        apart(LOGS[name], log)
        commands = {
            "process --mode attitude": ["process", str(log), "--mode", "attitude", "-o", str(out)],
            "process": ["process", str(log), "-o", str(out), "--overwrite"],
            "info": ["info", str(log)],
        }
        for shown, arguments in commands.items():
            text, _, cpu, peak = run_child([*PROGRAM, *arguments, "--json", "-q"])
            rows.append((name, shown, cpu, peak))
            if shown != "info":
                said = json.loads(text)["output"]
                count = declared if "hour" in name else counted
                written = apart(count, out)
                ours = {k: n for k, n in written.items() if k.startswith("/sinstool/")}
                assert ours, f"{name}: no results"
                assert said["attitudes"] in ours.values(), f"{name}: {ours}, {said}"
                assert written - Counter(ours) == apart(count, log), f"{name}: messages are missing"
    finally:
        log.unlink(missing_ok=True)
        out.unlink(missing_ok=True)
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    made = parser(__doc__)
    made.add_argument("--dir", type=Path, help="where the logs are made")
    made.add_argument("--logs", nargs="+", choices=LOGS, default=list(LOGS)[1:])
    options = made.parse_args(arguments)
    peaks = {}
    rows = []
    with folder_for_logs(options.dir) as folder:
        measure("a minute", folder)
        for name in options.logs:
            print(f"{name} ...", file=sys.stderr, flush=True)
            for row in measure(name, folder):
                peaks[row[:2]] = row[3]
                rows.append((*row[:2], f"{row[2]:.1f}", f"{row[3]:.0f}"))
    print_table(("log", "command", "CPU s", "peak MB"), rows)
    hours = ("an hour", "five hours")
    if not all(name in options.logs for name in hours):
        return 0
    print()
    for command in dict.fromkeys(shown for _, shown in peaks):
        one, five = (peaks[name, command] for name in hours)
        print(f"{command}: five hours take {five / one:.3f} times the memory of an hour")
    one, five = (peaks[name, "process --mode attitude"] for name in hours)
    return 1 if five > 1.1 * one else 0


if __name__ == "__main__":
    sys.exit(main())
