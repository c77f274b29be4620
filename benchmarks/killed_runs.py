"""Kill commands without warning while they write, and look at what they leave.

    python benchmarks/killed_runs.py --kills 200 --campaign-kills 50 --seed 1

Every kill is a new process of the whole command, ended with SIGKILL at a random moment between its
first temporary file and a little after its end. Half of the kills are of `process` with a report,
half of `simulate`; those of a campaign, `process` over several logs with two workers, end only
the process that was started, and what its workers still do is waited for. After each, every
target must hold the old file or the complete new one; after the next run of the command, nothing
may lie beside the targets that the run before has left, and no worker may live on. Exits with 1
where that does not hold.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.commands import PROGRAM, sinstool

OLD = b"what was there before"
LOGS = 4
# Workers of a campaign end when the log is done that they are at.
PATIENCE = 60.0


@dataclass(frozen=True)
class Command:
    """A command that writes files."""

    name: str
    arguments: tuple[str, ...]
    """``--overwrite`` among them."""
    targets: tuple[Path, ...]
    """All in one folder that holds nothing else."""
    changing: frozenset[str] = frozenset()
    """Names of files there that are written too, and say how long it took."""

    @property
    def folder(self) -> Path:
        return self.targets[0].parent

    def start(self) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [*PROGRAM, *self.arguments],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def strays(self) -> set[str]:
        """Names in the folder that are no targets."""
        names = {p.name for p in self.folder.iterdir()}
        return names - {p.name for p in self.targets} - self.changing


@dataclass
class Tally:
    """What was seen, and of it what must not be."""

    counts: Counter[str] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)


def commands(folder: Path, seconds: int) -> list[Command]:
    """`process` with a report, and `simulate`, on a log of so many seconds."""
    log, out, simulated = folder / "log.mcap", folder / "process", folder / "simulate"
    simulate = ("simulate", "static", "--duration", str(seconds), "-o")
    sinstool(*simulate, log)
    out.mkdir()
    simulated.mkdir()
    targets = (out / "out.mcap", out / "page.html")
    process = ("process", str(log), "--mode", "attitude", "-o", str(targets[0]))
    again = simulated / "static.mcap"
    return [
        Command("process", (*process, "--report", str(targets[1]), "--overwrite"), targets),
        Command("simulate", (*simulate, str(again), "--overwrite"), (again,)),
    ]


def campaign(folder: Path, seconds: int) -> Command:
    """`process` over logs of so many seconds, with two workers."""
    logs, out = folder / "logs", folder / "campaign"
    logs.mkdir()
    for k in range(LOGS):
        log = logs / f"{k}.mcap"
        sinstool("simulate", "static", "--duration", seconds, "--seed", k, "-o", log)
    out.mkdir()
    targets = tuple(out / f"{k}.mcap" for k in range(LOGS))
    paths = [str(logs / f"{k}.mcap") for k in range(LOGS)]
    return Command(
        "campaign",
        ("process", *paths, "--mode", "attitude", "-j", "2", "-o", str(out), "--overwrite"),
        targets,
        frozenset({"index.html", "summary.csv"}),
    )


def ended(run: subprocess.Popen[bytes]) -> bool:
    """Wait until no process is left that a run began; false where one does not end."""
    begun = time.monotonic()
    while time.monotonic() - begun < PATIENCE:
        try:
            os.killpg(run.pid, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.02)
    os.killpg(run.pid, signal.SIGKILL)
    return False


def digest(path: Path) -> str:
    """SHA-256 of a file; of nothing where there is none."""
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.exists() else "none"


def first_stray(run: subprocess.Popen[bytes], command: Command, before: set[str]) -> bool:
    """Wait until a run has a temporary file of its own; false where it ended without."""
    while run.poll() is None:
        if command.strays() - before:
            return True
        time.sleep(0.0005)
    return False


def kill_at_random(command: Command, kills: int, rng: random.Random) -> Tally:
    """Kill a command again and again, and look."""
    tally = Tally()
    # Twice: compiled loops are there the second time, and the same input gives the same bytes.
    for _ in range(2):
        run = command.start()
        writes = time.monotonic() if first_stray(run, command, set()) else None
        run.wait()
        assert run.returncode in (0, 3) and writes is not None, f"{command.name} does not run"
        lasts = time.monotonic() - writes
    complete = {path: digest(path) for path in command.targets}
    old = hashlib.sha256(OLD).hexdigest()
    left: set[str] = set()
    number = -1
    while tally.counts["killed"] < kills:
        number += 1
        for path in command.targets:
            # by turns: something there to be replaced, nothing there
            path.write_bytes(OLD) if number % 2 == 0 else path.unlink(missing_ok=True)
        run = command.start()
        written = first_stray(run, command, left)
        time.sleep(rng.uniform(0.0, 1.2 * lasts))
        run.send_signal(signal.SIGKILL)
        run.wait()
        if not ended(run):
            tally.faults.append(f"kill {number}: a worker lives on")
        tally.counts["killed" if run.returncode == -signal.SIGKILL else "ended before"] += 1
        if written and left & command.strays():
            tally.faults.append(f"kill {number}: strays of the run before are still there")
        left = command.strays()
        tally.counts["left a temporary file"] += bool(left)
        expected_old = old if number % 2 == 0 else "none"
        for path in command.targets:
            now = digest(path)
            if now == complete[path]:
                tally.counts["targets new"] += 1
            elif now == expected_old:
                tally.counts["targets old" if now != "none" else "targets absent"] += 1
            else:
                tally.faults.append(f"kill {number}: {path.name} is neither old nor complete")
    run = command.start()
    run.wait()
    if run.returncode not in (0, 3) or command.strays():
        tally.faults.append(f"after the last run there are {command.strays()}")
    if {path: digest(path) for path in command.targets} != complete:
        tally.faults.append("the last run wrote something else")
    return tally


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--kills", type=int, default=200, help="of process and simulate")
    parser.add_argument("--campaign-kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=int, default=300, help="length of the log")
    options = parser.parse_args(arguments)
    rng = random.Random(options.seed)
    faults: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        made = commands(Path(folder), options.seconds)
        planned = [(c, (options.kills + k) // len(made)) for k, c in enumerate(made)]
        if options.campaign_kills:
            planned.append((campaign(Path(folder), options.seconds // 5), options.campaign_kills))
        for command, kills in planned:
            tally = kill_at_random(command, kills, rng)
            faults += tally.faults
            counts = ", ".join(f"{name} {count}" for name, count in sorted(tally.counts.items()))
            print(f"{command.name}: {counts}; faults {len(tally.faults)}", flush=True)
    for fault in faults:
        print(fault)
    total = options.kills + options.campaign_kills
    print(f"seed {options.seed}: {total} kills, {len(faults)} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
