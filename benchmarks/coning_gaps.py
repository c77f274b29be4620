"""`compare-coning` on logs of one length with ever more gaps.

    python benchmarks/coning_gaps.py

makes logs of 20 minutes at 400 Hz, from which 0.1 s are missing at even intervals, and prints
processor time and peak memory of the command on each, and the ratio to that without a gap.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.commands import PROGRAM, folder_for_logs, run_child
from benchmarks.one_hour import RATE, Stream, streams, write_fast

MISSING_S = 0.1


def make(path: Path, minutes: float, gaps: int) -> None:
    """A log of :func:`benchmarks.one_hour.streams` with gaps in its IMU."""
    import numpy as np

    parts = streams(minutes)
    imu = parts["/imu/data"]
    keep = np.ones(len(imu.log_time), np.bool_)
    for begin in np.linspace(0, len(keep), gaps + 2)[1:-1].astype(int).tolist():
        keep[begin : begin + round(MISSING_S * RATE)] = False
    parts["/imu/data"] = Stream(imu.log_time[keep], imu.payload[keep])
    write_fast(path, "zstd", parts)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--gaps", type=int, nargs="+", default=[0, 100, 600])
    parser.add_argument("--dir", type=Path, help="keep the logs here")
    options = parser.parse_args()
    print("| gaps | CPU s | ratio | peak MB |\n|---|---|---|---|")
    least = None
    with folder_for_logs(options.dir) as folder:
        for number, gaps in enumerate([options.gaps[0], *options.gaps]):
            log = folder / f"gaps_{gaps}.mcap"
            if not log.exists():
                make(log, options.minutes, gaps)
            _, _, cpu, peak = run_child([*PROGRAM, "compare-coning", str(log), "--json", "-q"])
            if number == 0:  # the first may compile
                continue
            least = least or cpu
            print(f"| {gaps} | {cpu:.1f} | {cpu / least:.2f} | {peak:.0f} |", flush=True)


if __name__ == "__main__":
    main()
