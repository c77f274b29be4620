"""`sinstool process --mode ins-gnss --smooth` on an hour of data: time and memory, start to end.

Beside it `mcap` iterates over all messages of the same log, undecoded.

The log is simulated once and kept where --keep says, so that a second run is warm.

python benchmarks/ins_gnss_hour.py
python benchmarks/ins_gnss_hour.py --scenario spiral-climb --repeat 5
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

from benchmarks.commands import PROGRAM, run_child, sinstool

TARGET_S = 10.0
STOCK = """
import sys
from mcap.reader import make_reader
with open(sys.argv[1], "rb") as stream:
    print(sum(1 for _ in make_reader(stream).iter_messages()))
"""


def measured(log: Path, out: Path, options: list[str]) -> tuple[float, float, float, dict]:
    """Wall and CPU seconds, MB at most, and the summary of a run."""
    command = [*PROGRAM, "process", str(log), "-o", str(out), "--mode", "ins-gnss", "--overwrite",
               "--json", "-q", "--gyro-unit", "rad/s", *options]  # fmt: skip
    text, wall, cpu, peak = run_child(command)
    return wall, cpu, peak, json.loads(text)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--scenario", default="drive", choices=["drive", "spiral-climb", "manoeuvring-flight"]
    )
    parser.add_argument("--duration", type=float, default=3600.0, help="s")
    parser.add_argument("--rate", type=float, default=128.0, help="Hz")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--keep", type=Path, help="the log, made if it is not there")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        log = args.keep or Path(folder) / "hour.mcap"
        if not log.exists():
            grade = "navigation" if args.scenario == "spiral-climb" else "mems"
            options = ("--duration", args.duration, "--rate", args.rate, "--grade", grade)
            options += ("--no-truth",)  # which a recorded log has not either
            sinstool("simulate", args.scenario, "-o", log, *options, "--seed", 4)
        out = Path(folder) / "out.mcap"
        print(f"{args.scenario}, {args.duration:.0f} s at {args.rate:g} Hz, {args.repeat} runs;")
        print("the first run of all may compile. Target: 10 s of wall time, smoothed, warm.\n")
        columns = ("wall s", "least", "CPU s", "MB", "faster than data", "samples per CPU s",
                   "CPU of mcap")  # fmt: skip
        print(f"{'':20s}" + "".join(f"{c:>{max(8, len(c) + 1)}s}" for c in columns))
        # A flight that never rests does not show what its gyros are worth
        common = ["--imu-grade", "navigation"] if args.scenario == "spiral-climb" else []
        stock = []
        for name, more in (("filter", []), ("filter and smoother", ["--smooth"])):
            options, runs = [*common, *more], []
            for _ in range(args.repeat):
                runs.append(measured(log, out, options))
                stock.append(run_child([sys.executable, "-c", STOCK, str(log)])[2])
            walls = sorted(r[0] for r in runs)
            wall, cpu = walls[len(walls) // 2], sorted(r[1] for r in runs)[len(runs) // 2]
            most = max(r[2] for r in runs)
            print(
                f"{name:20s}{wall:8.2f}{walls[0]:8.2f}{cpu:8.2f}{most:8.0f}"
                f"{args.duration / wall:17.0f}{args.duration * args.rate / cpu:18.0f}"
                f"{cpu / sorted(stock)[len(stock) // 2]:12.2f}"
            )
        summary = runs[-1][3]
        print(
            f"\n{summary['imu']['n']} samples, {summary['filter']['epochs_used']} fixes,"
            f" {out.stat().st_size / 1e6:.0f} MB written; filter {summary['filter']['filter']}"
        )
        if walls[0] > TARGET_S:
            print("slower than the target on this machine now")


if __name__ == "__main__":
    main()
