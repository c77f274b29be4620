"""Run whole commands on damaged logs, files and arguments, and look at what they leave.

    python benchmarks/fuzz_commands.py --count 5000 --seed 1

Logs are damaged as `fuzz_readers.py` damages them and given to every command that reads logs;
configurations, noise files and calibrations are damaged and given to commands on a sound log; and
commands on a sound log get options and values at random. Each run is the whole program, from its
arguments to its exit status, in a process of its own that begins as a copy of one where everything
is imported and compiled. It must exit with 0, 1, 2 or 3; say in one line why it failed, without a
traceback or control characters; leave no file behind when it failed, and no temporary file ever;
print one JSON object with `--json`; not change its input; and every MCAP that it wrote must be
whole: checksums, statistics, schemas, attachments and metadata, by the `mcap` package. At most
10 s of CPU and 700 MB. What fails is kept in --keep, and `--first N --count 1` runs one again.
Needs the extra `test`.
"""

from __future__ import annotations

import io
import json
import os
import random
import re
import resource
import shlex
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader

from benchmarks.common import parser
from benchmarks.fuzz_inputs import FORMATS, TEXTS, make_files, make_input, make_logs
from benchmarks.fuzz_texts import WORDS

KINDS = (*FORMATS, *TEXTS, "arguments")
MESSAGES = 300
SECONDS = 10
PATIENCE = 120.0
MEGABYTES = 700
START = "--latitude 48 --longitude 9 --height 400 --align fixed --initial-attitude 0,0,0"
EVERYTHING = "--emit imu,attitude,euler,odometry,pose,fix,tf"
# {} is the damaged file, LOG and RIG are sound logs
RUNS = {
    "log": (
        "info {}", "info {} --report page.html", "align {}", "allan {} -o noise.toml",
        "compare-coning {} --csv tables", "export {} -o rows.csv", "process {} -o out.mcap",
        "process {} -o out.mcap --mode attitude", "process {} -o out.mcap --only-results",
        "process {} -o out.mcap --mode attitude --compression lz4 --report page.html",
        f"process {{}} -o out.mcap --mode ins {START} {EVERYTHING}",
    ),
    "config": (
        "process LOG -o out.mcap --config {}", "process LOG --config {} --print-config",
        "info LOG --config {}", "align LOG --config {}", "compare-coning LOG --config {}",
        "calibrate-hse --config {} --plan", "calibrate-hse RIG --config {} -o hse.json",
    ),
    "noise": (
        "process LOG -o out.mcap --imu-noise {}", "align LOG --imu-noise {}",
        f"process LOG -o out.mcap --mode ins {START} --imu-noise {{}}",
    ),
    "calibration": (
        "process RIG -o out.mcap --config RIG.toml --hse {}",
        "process RIG -o out.mcap --config RIG.toml --hse {} --force",
    ),
}  # fmt: skip
# Run once on sound inputs before the first fork, so that no child compiles or imports them
WARMING = (
    "info LOG --report info.html", "align LOG", "allan STATIC -o noise.toml",
    "compare-coning LOG --csv tables", "process LOG -o out.mcap --report page.html",
    f"process LOG -o ins.mcap --mode ins {START} {EVERYTHING}", "export ins.mcap -o rows.csv",
    "process RIG -o rig.mcap --config RIG.toml --hse HSE",
    "calibrate-hse RIG --config RIG.toml -o hse.json",
    "simulate coning -o coning.mcap --duration 2", "conventions",
)  # fmt: skip
# Other machines and processes are not what is tried here.
NOT_TRIED = {"--scheduler", "--jobs", "--tls-ca", "--tls-cert", "--tls-key", "--monte-carlo"}
PLAUSIBLE = ("0", "1", "-1", "0.5", "2", "10", "1,2,3", "0,0,0", "/imu", "auto", "none", "x", "1:2",
             "2023-11-14T22:13:20Z", "1700000000000000000")  # fmt: skip
SAMPLES = Path(__file__).resolve().parents[1] / "sample_data" / "hse"
FORBIDDEN = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


@dataclass(frozen=True)
class Run:
    """A command, and what came of it."""

    arguments: list[str]
    status: int
    """Of its exit; negative for the signal that ended it."""
    out: str
    err: str
    seconds: float
    """CPU time."""
    megabytes: int


# -- arguments ------------------------------------------------------------------------------------


def _sound(word: str, place: Path) -> str:
    names = {"LOG": place / "logs/mcap/zstd.mcap", "HSE": place / "logs/calibration/hse.json",
             "RIG": SAMPLES / "a-020.mcap", "RIG.toml": SAMPLES / "rig-a.toml",
             "STATIC": SAMPLES.parent / "static.mcap"}  # fmt: skip
    return str(names.get(word, word))


def _of_file(kind: str, path: Path, salvage: bool, rng: random.Random, place: Path) -> list[str]:
    """A command that reads a damaged file."""
    text = rng.choice(RUNS["log" if kind in FORMATS else kind])
    arguments = [str(path) if w == "{}" else _sound(w, place) for w in text.split()]
    arguments += ["--salvage"] * salvage
    arguments += ["--json"] * (rng.random() < 0.4)
    return arguments + ["-v"] * (rng.random() < 0.2)


def _commands() -> dict[str, Any]:
    """All commands, those of `simulate` too, by their words."""
    from sinstool.cli.main import COMMANDS, cli

    found = {}
    for name in COMMANDS:
        command: Any = cli.get_command(None, name)  # type: ignore[arg-type]
        below = getattr(command, "commands", {})
        found |= {f"{name} {inner}": c for inner, c in below.items()} or {name: command}
    return found


def _value(option: Any, rng: random.Random, simulated: bool) -> str:
    choices = getattr(option.type, "choices", ())
    if choices and rng.random() < 0.6:
        return str(rng.choice(choices))
    if simulated or rng.random() < 0.5:  # a long simulation is what its user asked for
        return rng.choice(PLAUSIBLE[:8])
    word = rng.choice((*PLAUSIBLE, *WORDS)).replace("\x00", "")
    return word.replace("/", "_") if "path" in type(option.type).__name__.lower() else word


def _of_options(rng: random.Random, place: Path) -> list[str]:
    """A command on a sound log, with options and values at random."""
    every = _commands()
    name = rng.choice(sorted(every))
    arguments = name.split()
    simulated = arguments[0] == "simulate"
    if arguments[0] in ("conventions", "completion"):
        return arguments + rng.choice(([], ["zsh"], [rng.choice(WORDS).replace("\x00", "")]))
    written = {"process": "out.mcap", "export": "rows.csv", "allan": "noise.toml",
               "simulate": "made.mcap", "calibrate-hse": "hse.json"}  # fmt: skip
    if not simulated:
        arguments.append(_sound("RIG" if name == "calibrate-hse" else "LOG", place))
    if arguments[0] in written and rng.random() < 0.9:
        arguments += ["-o", written[arguments[0]]]
    if name == "calibrate-hse" and rng.random() < 0.8:
        arguments += ["--config", _sound("RIG.toml", place)]
    if simulated and "--duration" in {o for p in every[name].params for o in p.opts}:
        arguments += ["--duration", rng.choice(("1", "3", "0", "nan", "x"))]
    options = [p for p in every[name].params
               if p.opts[0].startswith("-") and not NOT_TRIED & set(p.opts)]  # fmt: skip
    for option in rng.sample(options, min(len(options), rng.choice((1, 1, 2, 3, 5)))):
        flag = rng.choice([*option.opts, *option.secondary_opts])
        if simulated and flag in ("--duration", "--rate", "--plateau", "--rates"):
            continue
        takes = not (getattr(option, "is_flag", False) or getattr(option, "count", False))
        arguments += [flag, *([_value(option, rng, simulated)] if takes else [])]
    if rng.random() < 0.1 and not simulated:
        del arguments[rng.randrange(1, len(arguments))]
    return arguments


def make_command(kind: str, seed: int, number: int, place: Path, folder: Path) -> list[str]:
    """The arguments of a run; a damaged file is made in `folder`, which is empty."""
    rng = random.Random(f"command {kind} {seed} {number}")
    if kind == "arguments":
        return _of_options(rng, place)
    made = make_input(place / "logs", kind, seed, number, folder)
    return _of_file(kind, made.path, made.salvage, rng, place)


# -- a run ----------------------------------------------------------------------------------------


def _be_command(arguments: Sequence[str], folder: Path) -> int:
    """What a process of the program does, in a copy of this one."""
    from sinstool.cli.main import main

    for number, name in ((0, os.devnull), (1, "stdout"), (2, "stderr")):
        flags = os.O_RDONLY if number == 0 else os.O_WRONLY | os.O_CREAT
        file = os.open(name if number == 0 else folder.parent / name, flags)
        os.dup2(file, number)
        os.close(file)
    sys.stdout = io.TextIOWrapper(io.FileIO(1, "w"), "utf-8")
    sys.stderr = io.TextIOWrapper(io.FileIO(2, "w"), "utf-8", "backslashreplace")
    os.chdir(folder)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS + 20, SECONDS + 25))
    sys.argv = ["sinstool", *arguments]
    status = 70
    try:
        main()
    except SystemExit as exc:
        status = exc.code if isinstance(exc.code, int) else int(exc.code is not None)
    except BaseException:
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    return status


def run(arguments: list[str], folder: Path) -> Run:
    """Run a command in a folder, where it may leave files; what it prints goes beside."""
    child = os.fork()
    if not child:
        status = 71
        with suppress(BaseException):
            status = _be_command(arguments, folder)
        os._exit(status)
    begun = time.monotonic()
    while True:
        done, code, usage = os.wait4(child, os.WNOHANG)
        if done:
            break
        if time.monotonic() - begun > PATIENCE:
            os.kill(child, signal.SIGKILL)
        time.sleep(0.002)
    texts = []
    for name in ("stdout", "stderr"):
        path = folder.parent / name
        texts.append(path.read_bytes().decode(errors="replace") if path.exists() else "")
        path.unlink(missing_ok=True)
    seconds = usage.ru_utime + usage.ru_stime
    return Run(arguments, os.waitstatus_to_exitcode(code), *texts, seconds, usage.ru_maxrss >> 10)


def whole(path: Path) -> str:
    """What is wrong with an MCAP, or nothing."""
    try:
        with path.open("rb") as stream:
            records = StreamReader(stream, validate_crcs=True).records
            streamed = sum(isinstance(record, Message) for record in records)
        with path.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            summary = reader.get_summary()
            read = sum(1 for _ in reader.iter_messages())
            attached = sum(1 for _ in reader.iter_attachments())
            metadata = sum(1 for _ in reader.iter_metadata())
    except Exception as exc:
        return f"{path.name} cannot be read: {type(exc).__name__} {exc}"
    if summary is None or summary.statistics is None:
        return f"{path.name} has no statistics"
    said = summary.statistics
    declared = said.message_count, said.attachment_count, said.metadata_count
    if (read, attached, metadata) != declared or streamed != read:
        return f"{path.name} holds {read, streamed, attached, metadata} and says {declared}"
    return ""


def faults(result: Run, folder: Path, before: set[Path]) -> list[str]:
    """What is wrong with a run and with what it left."""
    wrong = []
    if result.status not in (0, 1, 2, 3):
        wrong.append(f"status {result.status}")
    if "Traceback (most recent" in result.err:
        wrong.append("traceback")
    for name, text in (("stdout", result.out), ("stderr", result.err)):
        if forbidden := FORBIDDEN.search(text):
            wrong.append(f"{forbidden.group()!r} in {name}")
    after = set(folder.rglob("*"))
    failed = result.status in (1, 2)
    lines = result.err.splitlines()
    if failed and not (lines and lines[-1].startswith(("sinstool: ", "Usage:"))):
        wrong.append("no line says why it failed")
    if failed and after != before:
        wrong.append(f"failed and left {sorted(p.name for p in after - before)}")
    if hidden := [p.name for p in after - before if p.name.startswith(".")]:
        wrong.append(f"left {hidden}")
    other = {"--print-config", "--help", "--help-all", "-h", "--version"} & set(result.arguments)
    if "--json" in result.arguments and result.status in (0, 1, 3) and not other:
        try:
            assert isinstance(json.loads(result.out), dict)
        except (ValueError, AssertionError):
            wrong.append("stdout is no JSON object")
    if not failed:
        made = (p for p in after - before if p.suffix == ".mcap" and p.is_file())
        wrong += filter(None, map(whole, made))
    if result.seconds > SECONDS:
        wrong.append(f"{result.seconds:.1f} s of CPU")
    if result.megabytes > MEGABYTES:
        wrong.append(f"{result.megabytes} MB")
    return wrong


def _state(paths: Sequence[Path]) -> list[tuple[int, int]]:
    files = [f for p in paths for f in (sorted(p.rglob("*")) if p.is_dir() else [p])]
    return [(f.stat().st_size, f.stat().st_mtime_ns) for f in files]


def _warm(place: Path) -> None:
    """Import and compile what commands need, and make sure that a copy of this process can run."""
    from sinstool.cli.main import cli

    folder = place / "warming"
    folder.mkdir()
    here = Path.cwd()
    os.chdir(folder)
    keep = os.dup(1), os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    try:
        for text in WARMING:
            cli.main([_sound(w, place) for w in text.split()], standalone_mode=False)
    finally:
        os.dup2(keep[0], 1)
        os.dup2(keep[1], 2)
        os.chdir(here)
    assert threading.active_count() == 1, "a thread would not be in the copies"


def main(arguments: Sequence[str] | None = None) -> int:
    made = parser(__doc__, count=5000, seed=1, first=0)
    made.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    made.add_argument("--keep", type=Path, default=Path("fuzz_failures"))
    options = made.parse_args(arguments)
    os.environ |= {"OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    begun = time.monotonic()
    wrong = 0
    statuses: dict[str, Counter[int]] = {kind: Counter() for kind in options.kinds}
    peak, longest = 0, (0.0, "")
    with tempfile.TemporaryDirectory() as name:
        place = Path(name).resolve()
        make_logs(place / "logs", MESSAGES)
        make_files(place / "logs")
        _warm(place)
        sound = [Path(_sound(w, place)) for w in ("LOG", "RIG", "RIG.toml")]
        state = _state(sound)
        for number in range(options.first, options.first + options.count):
            kind = options.kinds[number % len(options.kinds)]
            folder = place / "a" / "b" / "run"  # names with .. stay in `place`
            shutil.rmtree(place / "a", ignore_errors=True)
            folder.mkdir(parents=True)
            command = make_command(kind, options.seed, number, place, folder)
            before = set(folder.rglob("*"))
            inputs = [*sound, *(p for p in before if p.is_file())]
            was = _state(inputs)
            result = run(command, folder)
            found = faults(result, folder, before)
            if any(not p.exists() for p in inputs) or _state(inputs) != was:
                found.append("the input is another")
                assert _state(sound) == state, command
            statuses[kind][result.status] += 1
            peak = max(peak, result.megabytes)
            longest = max(longest, (result.seconds, f"{kind} {number}: {command[0]}"))
            if found:
                wrong += 1
                _keep(options.keep / f"seed{options.seed}-{number}", folder, result, found)
                print(f"  {kind} {number}: {'; '.join(found)}", flush=True)
    for kind, counts in statuses.items():
        said = ", ".join(f"status {status} {n}" for status, n in sorted(counts.items()))
        print(f"{kind}: {counts.total()} commands: {said}")
    print(
        f"seed {options.seed}, {options.count} commands; failures {wrong}; peak {peak} MB; longest"
        f" {longest[0]:.2f} s of CPU ({longest[1]}); {time.monotonic() - begun:.0f} s"
    )
    return 1 if wrong else 0


def _keep(place: Path, folder: Path, result: Run, found: list[str]) -> None:
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(folder, place)
    texts = [shlex.join(result.arguments), "; ".join(found), result.err, result.out[-5000:]]
    (place / "why.txt").write_text("\n".join(texts), errors="replace")


if __name__ == "__main__":
    sys.exit(main())
