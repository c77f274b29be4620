"""Many logs through `sinstool process`: one worker, two, and two of a Dask cluster.

    python benchmarks/many_logs.py

simulates 40 drives of ten minutes at 400 Hz with GNSS (or fewer: ``--logs``, ``--seconds``) into a
temporary folder, processes them as a user would, with ``-j 1``, ``-j 2`` and ``--scheduler``, and
prints the wall times from the start of the command to its end, their ratios, and whether all
outputs are the same bytes. Outputs of a run are removed before the next one begins, so that disks
have the same to do; ``--mode attitude`` is a shorter way through the same logs. Two workers should
take 1/1.8 of the time of one, or less, where there are two idle cores.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from benchmarks.commands import PROGRAM, sinstool
from tests.campaign.clusters import cluster

TARGET = 1.8


def simulate(folder: Path, count: int, seconds: float) -> None:
    """The logs, each with sensor errors of its own."""
    options = ("--monte-carlo", count, "--duration", seconds, "--rate", 400, "--grade", "mems")
    sinstool("simulate", "drive", "-o", folder, "--no-truth", *options)


def timed(logs: Path, out: Path, mode: str, who: list[str]) -> tuple[float, dict[str, str]]:
    """Wall time of the command, and the hashes of what it wrote."""
    command = [*PROGRAM, "process", str(logs), "-o", str(out), "-q", "--mode", mode, *who]
    os.sync()
    begin = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True)
    wall = time.perf_counter() - begin
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(command)} ended with {done.returncode}\n{done.stderr}")
    hashes = {}
    for path in sorted(out.iterdir()):
        if path.name != "index.html":  # which says how long the run took
            with path.open("rb") as stream:
                hashes[path.name] = hashlib.file_digest(stream, "sha256").hexdigest()
        path.unlink()
    return wall, hashes


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--logs", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=600.0, help="length of a log")
    parser.add_argument("--mode", choices=["auto", "attitude"], default="auto")
    parser.add_argument("--dir", type=Path, help="instead of the system's temporary folder")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.dir) as name, ExitStack() as stack:
        folder = Path(name)
        logs = folder / "logs"
        begin = time.perf_counter()
        simulate(logs, options.logs, options.seconds)
        size = sum(p.stat().st_size for p in logs.iterdir())
        print(
            f"{options.logs} logs of {options.seconds:g} s at 400 Hz, {size / 1e6:.0f} MB,"
            f" simulated in {time.perf_counter() - begin:.1f} s; {len(os.sched_getaffinity(0))}"
            " cores"
        )
        # Compiles what is not in numba's cache, and reads the logs into memory, for all alike.
        timed(logs, folder / "warm", options.mode, ["-j", "2"])
        runs = {"1 worker": ["-j", "1"], "2 workers": ["-j", "2"]}
        results = {k: timed(logs, folder / "out", options.mode, who) for k, who in runs.items()}
        address = stack.enter_context(cluster(folder, 2))
        dask = ["--scheduler", address]
        results["2 Dask workers"] = timed(logs, folder / "out", options.mode, dask)
    alone, expected = results["1 worker"]
    for what, (wall, hashes) in results.items():
        same = "the same bytes" if hashes == expected else "OTHER BYTES"
        print(
            f"{what:>15}: {wall:7.1f} s, {wall / options.logs:6.2f} s a log,"
            f" {alone / wall:5.2f} times one worker; {len(hashes)} outputs, {same}"
        )
    ratio = alone / results["2 workers"][0]
    print(f"two workers: {ratio:.2f}, wanted {TARGET}: {'PASS' if ratio >= TARGET else 'short'}")


if __name__ == "__main__":
    main()
