"""Heading-sensitive error of 36 logs: sinstool beside the stock ways of reading them.

Makes turntable logs of ten minutes at 500 Hz (Imu and JointState, 20, 40 and 60 deg/s), times
`sinstool calibrate-hse` on 36 of them as a user starts it, its computing alone, and, on one log,
`mcap` and `rosbags` reading the same messages, scaled to 36:

    python benchmarks/hse_logs.py --dir /tmp/hse_logs

Only as many logs as `--distinct` says differ; the others are further names of the same files, so
that they are read from memory by both sides.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.commands import PROGRAM, folder_for_logs, sinstool

RATES = ("20", "40", "60")


def make(folder: Path, distinct: int, count: int, seconds: float) -> tuple[list[Path], Path]:
    """The logs, of which `distinct` are files of their own, and the rig."""
    rig = folder / "rig.toml"
    files = []
    for k in range(distinct):
        path = folder / f"distinct_{k}.mcap"
        files.append(path)
        if path.exists():
            continue
        print(f"making {path} ...", file=sys.stderr)
        side = (-1) ** (k // len(RATES))
        words = {
            "--rates": RATES[k % len(RATES)],
            "--plateau": seconds + 4.0,
            "--heading": 40.0 if side > 0 else 220.0,
            "--tilt-east": 8e-3 * side,
            "--seed": k,
            "--arw": 5e-4,
            "--gyro-bias": 0.003,
            "--vrw": 10.0,
            "--accel-bias": 50.0,
            "--encoder-lsb": 0.18,
        }
        options = [word for pair in words.items() for word in pair]
        command = ("simulate", "hse-rig", "-o", path, "--no-truth", *options)
        sinstool(*command, "--rig-out", rig, "--overwrite")
    names = []
    for k in range(count):
        name = folder / f"log_{k:02d}.mcap"
        name.unlink(missing_ok=True)
        name.hardlink_to(files[k % distinct])
        names.append(name)
    return names, rig


def end_to_end(logs: list[Path], rig: Path) -> tuple[float, float, dict[str, Any]]:
    """Wall and CPU time of the command, interpreter and all, and what it found."""
    output = logs[0].with_name("hse.json")
    arguments = [*PROGRAM, "calibrate-hse", *map(str, logs), "--config", str(rig)]
    before, began = os.times(), time.perf_counter()
    done = subprocess.run(
        [*arguments, "-o", str(output), "--overwrite", "--json", "-q"],
        capture_output=True,
        text=True,
    )
    wall, after = time.perf_counter() - began, os.times()
    if done.returncode not in (0, 3):
        raise SystemExit(done.stderr)
    cpu = after.children_user + after.children_system
    cpu -= before.children_user + before.children_system
    return wall, cpu, json.loads(done.stdout)["calibration"]


def computing(files: list[Path], count: int, rig_file: Path) -> tuple[float, float, float]:
    """Wall and CPU seconds for finding the turns of `count` logs from memory; wall of the rest."""
    from sinstool.cli.options import effective_config
    from sinstool.io.readers import open_log
    from sinstool.methods.hse.fit import fit
    from sinstool.methods.hse.status import judge
    from sinstool.pipelines.calibrate_hse.run import (
        align_runs,
        fit_options,
        rig_of,
        segment_rules,
    )
    from sinstool.survey.rig import find_turns, read_rig_log

    config = effective_config(rig_file, {})
    rig, rules = rig_of(config), segment_rules(config.calibration)
    samples = []
    for path in files:
        with open_log(path, False) as log:
            samples.append(read_rig_log(log, rig, config.input))
    find_turns(samples[0], rig, rules)  # compiles
    began, cpu = time.perf_counter(), time.process_time()
    turns = [find_turns(samples[k % len(files)], rig, rules, f"{k}") for k in range(count)]
    turned, cpu = time.perf_counter(), time.process_time() - cpu
    judge(fit(align_runs(turns, rig, config.calibration), fit_options(config.calibration)))
    return turned - began, cpu, time.perf_counter() - turned


def stock(path: Path) -> tuple[int, float, float]:
    """Messages of a log, seconds to iterate over them with mcap, and to deserialise them too."""
    from mcap.reader import make_reader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    iterating, both = 0.0, 0.0
    for deserialise in (False, True):
        count = 0
        began = time.perf_counter()
        with path.open("rb") as stream:
            for schema, _, message in make_reader(stream).iter_messages():
                if deserialise:
                    store.deserialize_cdr(message.data, schema.name)
                count += 1
        took = time.perf_counter() - began
        iterating, both = (iterating, took) if deserialise else (took, both)
    return count, iterating, both


def compare(folder: Path, args: argparse.Namespace) -> None:
    logs, rig = make(folder, args.distinct, args.logs, args.seconds)
    files = [folder / f"distinct_{k}.mcap" for k in range(args.distinct)]
    end_to_end(logs[: args.distinct], rig)  # compiles, and brings the files into memory
    runs = [end_to_end(logs, rig) for _ in range(args.runs)]
    wall, cpu, calibration = min(runs, key=lambda one: one[0])
    turning, turning_cpu, fitting = computing(files, args.logs, rig)
    timed = [stock(path) for path in files[: args.stock_logs]]
    count = sum(one[0] for one in timed) // len(timed)
    iterating, both = (sum(one[k] for one in timed) / len(timed) * args.logs for k in (1, 2))
    size = sum(path.stat().st_size for path in files) / len(files) / 1e6
    print(
        f"{args.logs} logs of {args.seconds:g} s, each {count} messages, {size:.0f} MB;"
        f" {args.distinct} distinct files, the others are further names of them."
    )
    print(
        f"Stock ways measured on {len(timed)} log(s) and scaled to {args.logs}; ours on all, best"
        f" of {args.runs}. Load {os.getloadavg()[0]:.1f}, {os.cpu_count()} cores."
    )
    seconds = 180.0 * 3600.0 / math.pi
    sigma = calibration["sigma_lambda2_rad"]
    by = "" if sigma is None else f' +- {sigma * seconds:.2f}"'
    print(
        f'lambda2 {calibration["lambda2_arcsec"]:.2f}"{by} by {calibration["method"]}, axial'
        f' {calibration["axial"]["lambda2_rad"] * seconds:.3f}" (simulated: -4.2")\n'
    )
    print("| what | wall s | CPU s | ours is faster by (wall) |")
    print("|---|---|---|---|")
    print(f"| sinstool calibrate-hse, whole command | {wall:.1f} | {cpu:.1f} | |")
    print(f"| of it, computing: turns of all logs | {turning:.2f} | {turning_cpu:.2f} | |")
    print(f"| of it, computing: alignment and fit | {fitting:.3f} | | |")
    print(f"| mcap: iterate, undecoded | {iterating:.0f} | | {iterating / wall:.0f} x |")
    print(f"| mcap and rosbags: iterate, deserialise | {both:.0f} | | {both / wall:.0f} x |")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--dir", type=Path, help="keep the logs here (default: a temporary folder)")
    parser.add_argument("--logs", type=int, default=36)
    parser.add_argument("--distinct", type=int, default=6, help="logs that differ")
    parser.add_argument("--seconds", type=float, default=600.0, help="length of a log")
    parser.add_argument("--runs", type=int, default=2, help="of the whole command")
    parser.add_argument("--stock-logs", type=int, default=1, help="logs read the stock ways")
    args = parser.parse_args()
    with folder_for_logs(args.dir) as folder:
        compare(folder, args)


if __name__ == "__main__":
    main()
