"""An hour of IMU at 400 Hz: sinstool beside the stock ways of reading and writing it.

Makes the log (1.44 M Imu, FluidPressure at 50 Hz, NavSatFix at 10 Hz, about 570 MB of messages)
where it is not there yet, runs every method in a process of its own, and prints wall and CPU
time, peak memory, and the ratio to iterating over the undecoded messages with `mcap`:

    python benchmarks/one_hour.py --dir /tmp/one_hour

The processes run one after the other, round by round, so that a busy machine slows all of them.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.commands import PROGRAM, folder_for_logs, run_child

if TYPE_CHECKING:
    import numpy as np

# numpy and sinstool are imported by the functions that need them: a child's peak memory counts
# from its parent's size at the fork, so the parent stays a bare interpreter.

RATE = 400
START_NS = 1_700_000_000_000_000_000
SEED = 20240229
JITTER_NS = 40_000
DELAY_NS = 900_000
CHUNK_SIZE = 2**20
IMU, PRESSURE, FIX = (f"sensor_msgs/msg/{name}" for name in ("Imu", "FluidPressure", "NavSatFix"))
QUATERNION = "geometry_msgs/msg/QuaternionStamped"
TOPICS = {"/imu/data": IMU, "/baro": PRESSURE, "/gnss/fix": FIX}


# -- the log -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Stream:
    """All messages of one topic: when each was logged, and their payloads, one a row."""

    log_time: np.ndarray
    payload: np.ndarray


def header(frame: str) -> list[tuple[Any, ...]]:
    """Fields of a CDR std_msgs/Header whose frame_id ends where the next double begins."""
    size = (12 + len(frame) + 1 + 7) // 8 * 8 - 12
    return [
        ("encapsulation", "u1", 4),
        ("sec", "<i4"),
        ("nanosec", "<u4"),
        ("frame_length", "<u4"),
        ("frame", f"S{size}"),
    ]


def rows(fields: list[tuple[Any, ...]], frame: str, stamp: np.ndarray) -> np.ndarray:
    """Payloads of one type with their headers filled in."""
    import numpy as np

    out = np.zeros(len(stamp), np.dtype(header(frame) + fields))
    out["encapsulation"] = (0, 1, 0, 0)
    out["sec"], out["nanosec"] = stamp // 10**9, stamp % 10**9
    out["frame_length"], out["frame"] = len(frame) + 1, frame.encode()
    return out


def stamps(rng: np.random.Generator, seconds: float, rate: int) -> tuple[np.ndarray, np.ndarray]:
    """Header stamps with jitter, and the log times that follow them."""
    import numpy as np

    count = round(seconds * rate)
    stamp = START_NS + np.arange(count, dtype=np.int64) * (10**9 // rate)
    stamp += rng.integers(-JITTER_NS, JITTER_NS + 1, count)
    delay = DELAY_NS + rng.gamma(2.0, 50_000.0, count).astype(np.int64)
    return stamp, np.maximum.accumulate(stamp + delay)


def imu_stream(rng: np.random.Generator, seconds: float) -> Stream:
    """A body that rolls to and fro after ten still seconds, through a 16-bit sensor."""
    import numpy as np

    stamp, log_time = stamps(rng, seconds, RATE)
    t = (stamp - START_NS) / 1e9
    moving = np.clip((t - 10.0) / 2.0, 0.0, 1.0)
    roll = 0.5 * moving * np.sin(1.3 * t)
    zero = np.zeros_like(t)
    rate = np.stack((np.gradient(roll, t), zero, zero), axis=1)
    force = 9.80665 * np.stack((zero, np.sin(roll), np.cos(roll)), axis=1)
    # least significant bits of a 16-bit part at 2000 deg/s and 16 g
    gyro_bit, accel_bit = np.radians(2000.0) / 2**15, 16 * 9.80665 / 2**15
    rate += rng.normal(0.0, 2e-3, rate.shape)
    force += rng.normal(0.0, 2e-2, force.shape)
    angle = 0.5 * (roll + rng.normal(0.0, 1e-3, len(t)))
    heading = rng.normal(0.0, 1e-3, len(t))
    turned = np.stack(
        (
            np.sin(angle) * np.cos(heading),
            np.sin(angle) * np.sin(heading),
            np.cos(angle) * np.sin(heading),
            np.cos(angle) * np.cos(heading),
        ),
        axis=1,
    )
    fields = [
        ("orientation", "<f8", 4),
        ("orientation_covariance", "<f8", 9),
        ("gyro", "<f8", 3),
        ("gyro_covariance", "<f8", 9),
        ("accel", "<f8", 3),
        ("accel_covariance", "<f8", 9),
    ]
    out = rows(fields, "imu_link", stamp)
    out["orientation"] = turned
    out["gyro"] = np.round(rate / gyro_bit) * gyro_bit
    out["accel"] = np.round(force / accel_bit) * accel_bit
    for name, value in (("orientation", 1e-6), ("gyro", 4e-6), ("accel", 4e-4)):
        out[f"{name}_covariance"][:, [0, 4, 8]] = value
    return Stream(log_time, out.view(np.uint8).reshape(len(out), -1))


def pressure_stream(rng: np.random.Generator, seconds: float) -> Stream:
    """Static pressure at a fixed height."""
    import numpy as np

    stamp, log_time = stamps(rng, seconds, 50)
    out = rows([("pressure", "<f8"), ("variance", "<f8")], "baro_link", stamp)
    out["pressure"] = 95_000.0 + np.round(rng.normal(0.0, 3.0, len(out)), 2)
    out["variance"] = 9.0
    return Stream(log_time, out.view(np.uint8).reshape(len(out), -1))


def fix_stream(rng: np.random.Generator, seconds: float) -> Stream:
    """Fixes scattered around one place."""
    import numpy as np

    stamp, log_time = stamps(rng, seconds, 10)
    # "gnss" and its NUL leave three bytes before the next double: status, a pad, and service
    out = np.zeros(
        len(stamp),
        np.dtype(
            [
                *header("gnss")[:-1],
                ("frame", "S5"),
                ("status", "i1"),
                ("service", "<u2"),
                ("pad", "u1", 4),
                ("position", "<f8", 3),
                ("covariance", "<f8", 9),
                ("covariance_type", "u1"),
            ]
        ),
    )
    out["encapsulation"] = (0, 1, 0, 0)
    out["sec"], out["nanosec"] = stamp // 10**9, stamp % 10**9
    out["frame_length"], out["frame"] = 5, b"gnss"
    out["service"] = 1
    out["position"] = rng.normal((47.3769, 8.5417, 455.0), (1e-5, 1e-5, 1.0), (len(out), 3))
    out["covariance"][:, [0, 4, 8]] = (1.0, 1.0, 4.0)
    out["covariance_type"] = 2
    return Stream(log_time, out.view(np.uint8).reshape(len(out), -1))


def streams(minutes: float) -> dict[str, Stream]:
    """The three topics; the same values for the same length."""
    import numpy as np

    rng = np.random.default_rng(SEED)
    seconds = 60.0 * minutes
    makers = (imu_stream, pressure_stream, fix_stream)
    return {topic: make(rng, seconds) for topic, make in zip(TOPICS, makers, strict=True)}


def schema(name: str) -> str:
    """Definition of a standard ROS 2 type."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE).generate_msgdef(name, ros_version=2)[0]


def make(path: Path, compression: str, minutes: float, fast: bool) -> None:
    """Write the log, by mcap's own writer or by ours."""
    parts = streams(minutes)
    part = path.with_suffix(".part")
    (write_fast if fast else _make_stock)(part, compression, parts)
    part.replace(path)


def _make_stock(path: Path, compression: str, parts: dict[str, Stream]) -> None:
    import numpy as np
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as stream:
        writer = Writer(stream, CHUNK_SIZE, CompressionType[compression.upper()])
        writer.start("ros2", "one_hour.py")
        channels = [
            writer.register_channel(
                topic, "cdr", writer.register_schema(name, "ros2msg", schema(name).encode())
            )
            for topic, name in TOPICS.items()
        ]
        times = np.concatenate([p.log_time for p in parts.values()])
        which = np.repeat(np.arange(len(parts)), [len(p.log_time) for p in parts.values()])
        order = np.argsort(times, kind="stable")
        # each stream is in order of time, so its messages are simply taken one after the other
        data = [p.payload for p in parts.values()]
        taken = [0] * len(parts)
        for k, at in zip(which[order].tolist(), times[order].tolist(), strict=True):
            i = taken[k]
            writer.add_message(channels[k], at, data[k][i].tobytes(), at, i)
            taken[k] = i + 1
        writer.finish()


def write_fast(path: Path, compression: str, parts: dict[str, Stream]) -> None:
    """Write the streams by our own writer."""
    import numpy as np

    from sinstool.io.readers.batch import RawBatch
    from sinstool.io.writers.mcap import McapWriter

    with path.open("wb") as stream:
        writer = McapWriter(stream, "ros2", "one_hour.py", compression)
        channels = [
            writer.add_channel(
                topic, "cdr", writer.add_schema(name, "ros2msg", schema(name).encode()), {}
            )
            for topic, name in TOPICS.items()
        ]
        first = min(int(p.log_time[0]) for p in parts.values())
        last = max(int(p.log_time[-1]) for p in parts.values())
        for begin in range(first, last + 1, 30 * 10**9):
            batch = []
            for channel, p in zip(channels, parts.values(), strict=True):
                i, j = np.searchsorted(p.log_time, (begin, begin + 30 * 10**9))
                batch.append(
                    RawBatch.from_rows(channel, p.payload[i:j], p.log_time[i:j], np.arange(i, j))
                )
            writer.write(batch)
        writer.finish()


# -- the methods, each run in a process of its own -----------------------------------------


class Stopwatch:
    """Adds up wall and CPU time of its `with` blocks."""

    def __init__(self) -> None:
        self.wall = self.cpu = 0.0

    def __enter__(self) -> None:
        self._began = time.perf_counter(), time.process_time()

    def __exit__(self, *_: object) -> None:
        self.wall += time.perf_counter() - self._began[0]
        self.cpu += time.process_time() - self._began[1]


def _imu_blocks(path: Path) -> Iterator[tuple[Any, ...]]:
    from sinstool.io.readers import open_log
    from sinstool.io.readers.streams import Losses, read_columns

    axes = ("x", "y", "z", "w")
    columns = {
        "sec": ["header.stamp.sec"],
        "nanosec": ["header.stamp.nanosec"],
        "gyro": [f"angular_velocity.{a}" for a in axes[:3]],
        "accel": [f"linear_acceleration.{a}" for a in axes[:3]],
        "orientation": [f"orientation.{a}" for a in axes],
    }
    with open_log(path) as log:
        for log_time, v in read_columns(log, log.channels_of("/imu/data"), columns, Losses()):
            stamp = v["sec"].astype("i8") * 10**9 + v["nanosec"]
            yield stamp, log_time, v["gyro"], v["accel"], v["orientation"]


def read_whole(path: Path, watch: Stopwatch) -> int:
    """Every IMU column of the hour in one array."""
    import numpy as np

    from sinstool.io.readers import open_log

    next(_imu_blocks(path))
    with watch:
        with open_log(path) as log:
            (channel,) = log.channels_of("/imu/data")
            count = log.counts[channel.id]
        widths = ((), (), (3,), (3,), (4,))
        kinds = ("i8", "i8", "f8", "f8", "f8")
        whole = [np.empty((count, *w), k) for w, k in zip(widths, kinds, strict=True)]
        filled = 0
        for block in _imu_blocks(path):
            end = filled + len(block[0])
            for column, part in zip(whole, block, strict=True):
                column[filled:end] = part
            filled = end
    return filled


def read_blocks(path: Path, watch: Stopwatch) -> int:
    """The same columns block by block, as a program that streams has them."""
    next(_imu_blocks(path))
    with watch:
        return sum(len(block[0]) for block in _imu_blocks(path))


def mcap_iteration(path: Path, watch: Stopwatch) -> int:
    """All messages undecoded, as `mcap` gives them by default."""
    from mcap.reader import make_reader

    count = 0
    with path.open("rb") as stream, watch:
        for _ in make_reader(stream).iter_messages():
            count += 1
    return count


def rosbags_deserialise(path: Path, watch: Stopwatch) -> int:
    """Imu messages as the objects of `rosbags`."""
    from rosbags.highlevel import AnyReader

    count = 0
    with AnyReader([path]) as reader:
        expected = [c for c in reader.connections if c.topic == "/imu/data"]
        with watch:
            for connection, _, data in reader.messages(connections=expected):
                reader.deserialize(data, connection.msgtype)
                count += 1
    return count


def mcap_writer(path: Path, watch: Stopwatch) -> int:
    """As many messages as `process` adds (an Imu and a QuaternionStamped a sample), by `mcap`.

    The payloads are there before the watch starts, a minute of them at a time.
    """
    from mcap.writer import CompressionType, Writer

    compression = CompressionType.LZ4 if "lz4" in path.name else CompressionType.ZSTD
    count = 0
    with tempfile.TemporaryFile(dir=path.parent) as stream:
        writer = Writer(stream, CHUNK_SIZE, compression)
        writer.start("ros2", "one_hour.py")
        first, second = (
            writer.register_channel(
                topic, "cdr", writer.register_schema(name, "ros2msg", schema(name).encode())
            )
            for topic, name in (("/imu", IMU), ("/attitude", QUATERNION))
        )
        for imu, attitude, log_time in _payloads(path):
            with watch:
                for a, b, at in zip(imu, attitude, log_time, strict=True):
                    writer.add_message(first, at, a, at, count)
                    writer.add_message(second, at, b, at, count)
                    count += 1
        with watch:
            writer.finish()
            stream.flush()
            os.fsync(stream.fileno())
    return 2 * count


def _payloads(path: Path) -> Iterator[tuple[list[bytes], list[bytes], list[int]]]:
    """Imu payloads of the log, and with the same header and orientation QuaternionStamped."""
    from sinstool.io.readers import open_log

    with open_log(path) as log:
        for batch in log.batches([c.id for c in log.channels_of("/imu/data")]):
            data = batch.buffer.data
            places = zip(batch.offset.tolist(), batch.length.tolist(), strict=True)
            imu = [bytes(data[at : at + length]) for at, length in places]
            yield imu, [payload[:60] for payload in imu], batch.log_time.tolist()


Method = Callable[[Path, Stopwatch], int]
OURS: dict[str, Method] = {
    "sinstool: IMU columns, one array each": read_whole,
    "sinstool: IMU columns, in blocks": read_blocks,
}
PROCESS: dict[str, tuple[str, ...]] = {
    "sinstool process (whole command)": (),
    "sinstool process --mode attitude (whole command)": ("--mode", "attitude"),
}
BASE = "mcap: iterate over all, undecoded"
STOCK: dict[str, Method] = {
    BASE: mcap_iteration,
    "rosbags: deserialise the IMU topic": rosbags_deserialise,
    "mcap: write as many as process adds": mcap_writer,
}


@dataclass(frozen=True)
class Result:
    """What one run of a method took."""

    wall: float
    cpu: float
    peak_mb: float
    messages: int


def run_method(name: str, log: Path) -> Result:
    """One run of a method, in a new process; the time is that of its work, without start-up."""
    text, _, _, peak = run_child([sys.executable, __file__, "--method", name, "--log", str(log)])
    said = json.loads(text)
    return Result(said["wall"], said["cpu"], peak, said["messages"])


def run_process(log: Path, options: tuple[str, ...]) -> Result:
    """`sinstool process`, start-up and all."""
    output = log.with_suffix(".out.mcap")
    output.unlink(missing_ok=True)
    arguments = ["process", str(log), "-o", str(output), "--json", "-q", *options]
    try:
        text, wall, cpu, peak = run_child([*PROGRAM, *arguments])
        return Result(wall, cpu, peak, 2 * json.loads(text)["output"]["attitudes"])
    finally:
        output.unlink(missing_ok=True)


def compare(log: Path, runs: int, stock_runs: int) -> None:
    """Run everything round by round and print the table."""
    results: dict[str, list[Result]] = {}
    for number in range(-1, max(runs, stock_runs)):  # round -1 compiles and fills the caches
        for name in OURS:
            if number < runs:
                results.setdefault(name, []).append(run_method(name, log))
        for name, options in PROCESS.items():
            if number < runs:
                results.setdefault(name, []).append(run_process(log, options))
        for name in STOCK:
            if 0 <= number < stock_runs:
                results.setdefault(name, []).append(run_method(name, log))
    for name in (*OURS, *PROCESS):
        del results[name][0]
    middle = {name: _median(runs_of) for name, runs_of in results.items()}
    size = log.stat().st_size / 1e6
    print(f"\n{log.name}: {size:.0f} MB, {middle[BASE].messages} messages; medians of")
    print(f"{runs} runs (sinstool) and {stock_runs} (stock); load {os.getloadavg()[0]:.1f},")
    print(f"{os.cpu_count()} cores. Times of all but `process` are without interpreter start.\n")
    base = middle[BASE]
    print("| method | messages | wall s | CPU s | peak MB | wall vs mcap | CPU vs mcap |")
    print("|---|---|---|---|---|---|---|")
    for name, r in middle.items():
        ratios = f"{_ratio(base.wall, r.wall)} | {_ratio(base.cpu, r.cpu)}"
        print(
            f"| {name} | {r.messages} | {r.wall:.2f} | {r.cpu:.2f} | {r.peak_mb:.0f} | {ratios} |",
            flush=True,
        )


def _median(runs: list[Result]) -> Result:
    return Result(
        statistics.median(r.wall for r in runs),
        statistics.median(r.cpu for r in runs),
        max(r.peak_mb for r in runs),
        runs[0].messages,
    )


def _ratio(base: float, value: float) -> str:
    return f"{base / value:.1f}x faster" if value <= base else f"{value / base:.1f}x slower"


# -- the command ---------------------------------------------------------------------------


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--dir", type=Path, help="keep the logs here (default: a temporary folder)")
    parser.add_argument("--minutes", type=float, default=60.0, help="length of the log")
    parser.add_argument("--runs", type=int, default=3, help="runs of sinstool, after one warm-up")
    parser.add_argument("--stock-runs", type=int, default=1, help="runs of the stock ways")
    parser.add_argument("--compression", nargs="+", default=["zstd", "lz4"])
    parser.add_argument("--fast-make", action="store_true", help="make the log by our own writer")
    parser.add_argument("--method", help=argparse.SUPPRESS)
    parser.add_argument("--make", help=argparse.SUPPRESS)
    parser.add_argument("--log", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.make:
        make(args.log, args.make, args.minutes, args.fast_make)
    elif args.method:
        watch = Stopwatch()
        count = {**OURS, **STOCK}[args.method](args.log, watch)
        print(json.dumps({"wall": watch.wall, "cpu": watch.cpu, "messages": count}))
    else:
        with folder_for_logs(args.dir) as folder:
            _compare_all(folder, args)


def _compare_all(folder: Path, args: argparse.Namespace) -> None:
    for compression in args.compression:
        writer = "fast" if args.fast_make else "stock"
        log = folder / f"imu_{args.minutes:g}min_{writer}_{compression}.mcap"
        if not log.exists():
            print(f"making {log} ...", file=sys.stderr)
            arguments = ["--make", compression, "--minutes", str(args.minutes)]
            arguments += ["--fast-make"] if args.fast_make else []
            run_child([sys.executable, __file__, *arguments, "--log", str(log)])
        compare(log, args.runs, args.stock_runs)


if __name__ == "__main__":
    main()
