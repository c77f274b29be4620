"""Read damaged logs and files, very many, and look for what must not be.

    python benchmarks/fuzz_readers.py --count 100000 --seed 1 --jobs 2

Logs of each format (MCAP; ROS 1 bag; ROS 2 .db3 and folder) are damaged by flipped bits, cuts,
splices, hostile sizes, and by changes behind compression and checksums, in definitions, metadata
and attachments too; half are opened with salvage. IMU topics are decoded; of every tenth input all
is done that `info` does. Configurations, noise files and calibrations are damaged word by word;
one that is accepted must say the same when it is written and read again. Each input must be read,
or refused by an error of sinstool's own, in less than 5 s of CPU and 500 MB (peak of the whole
process, libraries included). A tenth is read with bounds checks in compiled loops and with the
threads that a command has. Inputs are read in processes of their own, so that a crash is seen
and attributed; what fails is kept in --keep, and `--replay KIND:NUMBER` reads one again. Needs
the extra `test`.
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import os
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, NamedTuple

SECONDS = 5.0
PATIENCE = 60.0
WARMING = 150
MEGABYTES = 500
BATCH = 5000
FINE = ("read", "refused")


def read_everything(path: Path, salvage: bool, info: bool) -> int:
    """Read all of a log: raw, its IMU topics as streams; with `info` all else as `info` does.

    Returns the number of messages. Fails where a batch points outside its buffer.
    """
    import numpy as np

    from sinstool.config import InputOptions, ProcessConfig
    from sinstool.io.readers import open_log
    from sinstool.io.readers.message_types import PRESSURE_TYPE
    from sinstool.io.readers.streams import ImuUnits, Losses, read_imu, read_pressure
    from sinstool.io.readers.topics import imu_candidates, topics_of_type
    from sinstool.pipelines.info.run import inspect

    count = 0
    with open_log(path, salvage) as log:
        for batch in log.batches():
            count += len(batch)
            ends = batch.offset + batch.length
            assert (batch.offset >= 0).all() and (batch.length >= 0).all()
            assert (ends <= len(batch.buffer)).all(), "a message beyond its buffer"
            assert len(batch.channel) == len(batch.log_time) == len(batch.sequence)
            assert np.isin(batch.channel, list(log.channels)).all(), "a message of no channel"
        for topic in imu_candidates(log):
            for block in read_imu(log, topic.channels, ImuUnits(), Losses(), path=topic.path):
                assert np.isfinite(block.gyro).all() and np.isfinite(block.accel).all()
        if not info:
            return count
        for channels in topics_of_type(log, PRESSURE_TYPE).values():
            for _ in read_pressure(log, channels, Losses()):
                pass
    inspect(path, ProcessConfig(input=InputOptions(salvage=salvage)))
    return count


def read_text_file(path: Path, kind: str) -> None:
    """Read a file that people write; what is accepted is written and read again."""
    import tomllib

    from sinstool.config import ProcessConfig
    from sinstool.config.load import build, dump_toml, load_toml
    from sinstool.config.noise import read_noise
    from sinstool.core.small_file import read_text
    from sinstool.pipelines.calibrate_hse import calibration_file

    if kind == "noise":
        read_noise(path)
    elif kind == "calibration":
        calibration = calibration_file.loads(read_text(path))
        assert calibration_file.loads(calibration_file.dumps(calibration)) == calibration
    else:
        config = build(ProcessConfig, load_toml(path), str(path))
        assert build(ProcessConfig, tomllib.loads(dump_toml(config))) == config


def try_input(path: Path, kind: str, salvage: bool, info: bool = True) -> tuple[str, str]:
    """Read an input; the outcome (``read``, ``refused`` or a failure), and for a failure how."""
    from benchmarks.fuzz_inputs import FORMATS
    from sinstool.core.errors import SinstoolError

    try:
        with warnings.catch_warnings():
            # Whoever runs a command would see them, and not know what to do.
            warnings.simplefilter("error")
            if kind in FORMATS:
                read_everything(path, salvage, info)
            else:
                read_text_file(path, kind)
    except SinstoolError as exc:
        if "\n" in str(exc).strip():
            return "told in several lines", str(exc)
        return "refused", ""
    except BaseException as exc:
        return f"{type(exc).__name__}", traceback.format_exc()
    return "read", ""


def _work(
    logs: Path, kind: str, seed: int, numbers: range, threads: bool, report: Any, place: Path
) -> None:
    """Read inputs one after the other, telling the parent before and after each."""
    from benchmarks.fuzz_inputs import make_input
    from sinstool.core.threads import single_threaded

    stack = contextlib.ExitStack()
    if not threads:
        stack.enter_context(single_threaded())

    # Imports and compiled loops first: they take longer than an input may
    for base in sorted((logs / kind).iterdir()):
        try_input(base, kind, True)
    for number in range(WARMING):
        folder = place / "warming"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        made = make_input(logs, kind, -1, number, folder)
        try_input(made.path, kind, made.salvage)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for number in numbers:
        folder = place / "input"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        made = make_input(logs, kind, seed, number, folder)
        begun = time.process_time()
        report.send((number, "started", "", begun))
        outcome, details = try_input(made.path, kind, made.salvage, info=number % 10 == 0)
        seconds = time.process_time() - begun
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10
        if outcome in FINE and peak > MEGABYTES:
            outcome, details = "memory", f"{peak} MB"
        report.send((number, outcome, details, (peak, seconds)))
        if outcome == "memory":
            return


class Worker:
    """A process that reads inputs, and what it says of them."""

    def __init__(self, logs: Path, kind: str, seed: int, place: Path) -> None:
        self.arguments = (logs, kind, seed)
        self.place = place
        self.tried_again = -1
        place.mkdir()

    def start(self, numbers: range, checked: bool) -> None:
        """Begin with a range of inputs, with bounds checks or without."""
        self.left = numbers
        self.checked = checked
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe(duplex=False)
        # What compiled code knows of bounds, it knows from when it was compiled.
        os.environ["NUMBA_BOUNDSCHECK"] = "1" if checked else "0"
        os.environ.pop("NUMBA_CACHE_DIR", None)
        if checked:
            os.environ["NUMBA_CACHE_DIR"] = str(self.place.parent / "checked")
        self.process = context.Process(
            target=_work, args=(*self.arguments, numbers, checked, theirs, self.place), daemon=True
        )
        self.process.start()
        theirs.close()
        self.since: float | None = None
        self.current = numbers.start

    def listen(self) -> Result | None:
        """What came of an input, once the process says so or cannot any more."""
        try:
            number, outcome, details, value = self.pipe.recv()
        except (EOFError, OSError):
            self.process.join()
            return self._ended(f"crash, status {self.process.exitcode}", "")
        if outcome == "started":
            self.current, self.since, self.begun = number, value, time.monotonic()
            return None
        self.since = None
        self.left = range(number + 1, self.left.stop)
        if outcome == "memory" and self.left:
            self._again()
        return Result(number, outcome, details, *value, self.checked)

    def overdue(self) -> Result | None:
        """An input that takes too long, given up."""
        if self.since is None:
            return None
        # What else the machine does is no fault of ours; an input that waits for ever, twice, is.
        used = _cpu_seconds(self.process.pid) - self.since
        if used < SECONDS:
            if time.monotonic() - self.begun < PATIENCE:
                return None
            if self.tried_again != self.current:
                self.tried_again = self.current
                self.left = range(self.current, self.left.stop)
                self._again()
                return None
        return self._ended("time", f"{used:.1f} s of CPU")

    def _ended(self, outcome: str, details: str) -> Result:
        result = Result(self.current, outcome, details, 0, 0.0, self.checked)
        self.left = range(self.current + 1, self.left.stop)
        self.process.kill()
        self.process.join()
        if self.left:
            self._again()
        return result

    def _again(self) -> None:
        self.process.kill()
        self.process.join()
        self.start(self.left, self.checked)


def _cpu_seconds(pid: int | None) -> float:
    """CPU time of a process; of none where the system does not say."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Result(NamedTuple):
    """What came of an input."""

    number: int
    outcome: str
    details: str
    peak: int
    """MB, of its process so far."""
    seconds: float
    """CPU time."""
    checked: bool


def fuzz(kind: str, seed: int, numbers: range, jobs: int, place: Path) -> Iterator[Result]:
    """Read many inputs of a format in so many processes; `place` has the logs in it."""
    size = max(1, min(BATCH, len(numbers) // 10))
    parts = [numbers[n : n + size] for n in range(0, len(numbers), size)]
    # Those with bounds checks first: they take longest to begin
    waiting = [(part, True) for part in parts[::10]]
    waiting += [(part, False) for k, part in enumerate(parts) if k % 10]
    workers = [Worker(place / "logs", kind, seed, place / f"{kind}-{j}") for j in range(jobs)]
    busy: dict[Any, Worker] = {}
    for worker in workers[: len(waiting)]:
        worker.start(*waiting.pop(0))
        busy[worker.pipe] = worker
    while busy:
        ready = wait(list(busy), 0.2)
        for pipe, worker in tuple(busy.items()):
            result = worker.listen() if pipe in ready else worker.overdue()
            if result is None and worker.pipe is not pipe:  # begun anew
                del busy[pipe]
                busy[worker.pipe] = worker
            if result is not None:
                yield result
                if not worker.left and waiting:
                    worker.process.join()
                    worker.start(*waiting.pop(0))
                del busy[pipe]
                if worker.left:
                    busy[worker.pipe] = worker


def _keep(folder: Path, logs: Path, kind: str, seed: int, result: Result) -> None:
    from benchmarks.fuzz_inputs import make_input

    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    made = make_input(logs, kind, seed, result.number, folder)
    why = f"salvage {made.salvage}, bounds checks {result.checked}: {result.outcome}"
    (folder / "why.txt").write_text(f"{why}\n{result.details}")


def main(arguments: Sequence[str] | None = None) -> int:
    from benchmarks.fuzz_inputs import FORMATS, TEXTS, make_files, make_input, make_logs

    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=int, default=100_000, help="of inputs, for each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    kinds = [*FORMATS, *TEXTS]
    parser.add_argument("--kinds", nargs="+", choices=kinds, default=kinds)
    parser.add_argument("--keep", type=Path, default=Path("fuzz_failures"))
    parser.add_argument("--replay", metavar="KIND:NUMBER", help="read one input, here")
    options = parser.parse_args(arguments)
    wrong = 0
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        make_logs(place / "logs")
        make_files(place / "logs")
        if options.replay:
            kind, number = options.replay.split(":")
            made = make_input(place / "logs", kind, options.seed, int(number), place)
            print(made)
            print(*try_input(made.path, kind, made.salvage), sep="\n")
            return 0
        for kind in options.kinds:
            begun = time.monotonic()
            numbers = range(options.first, options.first + options.count)
            outcomes: Counter[str] = Counter()
            peak = failures = checked = 0
            longest = 0.0
            for result in fuzz(kind, options.seed, numbers, options.jobs, place):
                outcomes[result.outcome] += 1
                peak = max(peak, result.peak)
                longest = max(longest, result.seconds)
                checked += result.checked
                if outcomes.total() % 10_000 == 0:
                    print(f"  {kind}: {outcomes.total()} inputs", file=sys.stderr, flush=True)
                if result.outcome not in FINE:
                    failures += 1
                    destination = options.keep / f"seed{options.seed}-{kind}-{result.number}"
                    _keep(destination, place / "logs", kind, options.seed, result)
                    last = result.details.strip().split("\n")[-1]
                    print(f"  {kind}:{result.number}: {result.outcome} {last}", flush=True)
            wrong += failures
            counted = ", ".join(f"{name} {n}" for name, n in sorted(outcomes.items()))
            print(
                f"{kind}: seed {options.seed}, {outcomes.total()} inputs ({checked} with bounds"
                f" checks): {counted}; failures {failures}; peak {peak} MB;"
                f" longest {longest:.2f} s of CPU; {time.monotonic() - begun:.0f} s",
                flush=True,
            )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
