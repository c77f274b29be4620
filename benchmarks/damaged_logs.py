"""Damaged logs: what sinstool, mcap's two readers and rosbags get out of each, and at what cost.

Builds the logs of tests/io/readers/damaged.py (2000 messages each, less where the damage took
them) and reads each with every reader in a process of its own, one after the other. Prints the
messages obtained, with the class of the exception where one came out, and for sinstool
--salvage the time and the peak memory of the process. Status 1 where sinstool gives fewer
messages than another reader, an exception not of its own, takes 5 s or 500 MB.

    python benchmarks/damaged_logs.py
"""

from __future__ import annotations

import multiprocessing
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader

from benchmarks.common import parser
from sinstool.core.errors import SinstoolError
from sinstool.io.readers import open_log
from tests.io.readers.damaged import CASES

LIMIT_S = 20


def with_mcap(path: Path, count: list[int]) -> None:
    """By its index."""
    with path.open("rb") as stream:
        for _ in make_reader(stream).iter_messages():
            count[0] += 1


def with_stream(path: Path, count: list[int]) -> None:
    """Record by record."""
    with path.open("rb") as stream:
        for record in StreamReader(stream).records:
            count[0] += isinstance(record, Message)


def with_rosbags(path: Path, count: list[int]) -> None:
    """Bags and MCAP by AnyReader, undecoded."""
    with AnyReader([path]) as reader:
        for _ in reader.messages():
            count[0] += 1


def with_sinstool(path: Path, count: list[int], salvage: bool = False) -> None:
    """As columns, undecoded."""
    with open_log(path, salvage) as log:
        for batch in log.batches():
            count[0] += len(batch)


def with_salvage(path: Path, count: list[int]) -> None:
    """The same, passing over damage."""
    with_sinstool(path, count, salvage=True)


READERS: dict[str, Callable[[Path, list[int]], None]] = {
    "mcap": with_mcap,
    "mcap stream": with_stream,
    "rosbags": with_rosbags,
    "sinstool": with_sinstool,
    "--salvage": with_salvage,
}


def child(name: str, path: Path, pipe: Connection) -> None:
    """Read in this process, and tell how it went."""
    count = [0]
    error = ""
    # what was there before the fork is no cost of the log
    Path("/proc/self/clear_refs").write_text("5")
    begin = time.perf_counter()
    try:
        READERS[name](path, count)
    except SinstoolError:
        error = "ours"
    except Exception as exc:
        error = type(exc).__name__
    seconds = time.perf_counter() - begin
    status = Path("/proc/self/status").read_text()
    peak = next(int(line.split()[1]) / 1024 for line in status.split("\n") if "VmHWM" in line)
    pipe.send((count[0], error, seconds, peak))


def run(name: str, path: Path) -> tuple[int, str, float, float]:
    """Messages, error, seconds, MB."""
    here, there = multiprocessing.Pipe()
    process = multiprocessing.Process(target=child, args=(name, path, there))
    begin = time.perf_counter()
    process.start()
    # Held by the child alone, the pipe ends with it.
    there.close()
    result = (0, f"> {LIMIT_S} s", float(LIMIT_S), 0.0)
    if here.poll(LIMIT_S):
        try:
            result = here.recv()
        except EOFError:
            result = (0, "crash", time.perf_counter() - begin, 0.0)
    process.kill()
    process.join()
    return result


def main() -> int:
    """Print the table."""
    parser(__doc__).parse_args()
    multiprocessing.set_start_method("fork")
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    failed = 0
    head = "".join(f"{name:>26}" for name in READERS)
    print(f"{'log':<34}{head}{'s':>8}{'MB':>6}")
    for case in CASES:
        with tempfile.TemporaryDirectory() as folder:
            path = case.make(Path(folder))
            readings = {}
            for name in READERS:
                only_mcap = name.startswith("mcap")
                readings[name] = (
                    run(name, path)
                    if path.suffix == ".mcap" or not only_mcap
                    else (0, "-", 0.0, 0.0)
                )
        ours = readings["--salvage"]
        cells = "".join(f"{n} {error}".strip().rjust(26) for n, error, _, _ in readings.values())
        # A message without its channel is named, not given: nobody can say what it is.
        best = max(n for n, *_ in readings.values()) - ("unknown channel" in case.name)
        bad = ours[0] < best or ours[1] not in ("", "ours") or ours[2] >= 5 or ours[3] >= 500
        failed += bad
        mark = "  !" if bad else ""
        print(f"{case.name:<34}{cells}{ours[2]:>8.2f}{ours[3]:>6.0f}{mark}", flush=True)
    print(f"{len(CASES)} logs, {failed} where sinstool falls short")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
