"""Start-up: processor time of commands that have next to nothing to do.

    python benchmarks/start_up.py

runs `--help` and `process` on the two small logs of `sample_data`, by turns, after a first run of
each that compiles, and prints the median and the least processor time and the median wall time.
Beside them, what Python and NumPy take by themselves.
"""

from __future__ import annotations

import os
import statistics
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.commands import PROGRAM, run_child
from benchmarks.common import parser, print_table

LOGS = Path(__file__).resolve().parents[1] / "sample_data"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    options = parser(__doc__, runs=9).parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        out = ["-o", str(Path(folder, "out.mcap")), "--overwrite", "-q"]
        commands = {
            "`python -c pass`": [sys.executable, "-c", "pass"],
            "`python -c 'import numpy'`": [sys.executable, "-c", "import numpy"],
            "`sinstool --help`": [*PROGRAM, "--help"],
        } | {
            f"`sinstool process {name}`": [*PROGRAM, "process", str(LOGS / name), *out]
            for name in ("coning.mcap", "static.mcap")
        }
        taken: dict[str, list[tuple[float, float]]] = {name: [] for name in commands}
        for number in range(-1, options.runs):
            for name, command in commands.items():
                _, wall, cpu, _ = run_child(command)
                if number >= 0:
                    taken[name].append((cpu, wall))
    rows = []
    for name, runs in taken.items():
        cpus, walls = [run[0] for run in runs], [run[1] for run in runs]
        cells = (statistics.median(cpus), min(cpus), statistics.median(walls))
        rows.append((name, *(f"{seconds:.3f}" for seconds in cells)))
    print(f"{options.runs} runs of each; load {os.getloadavg()[0]:.1f}, {os.cpu_count()} cores\n")
    print_table(("command", "CPU s", "least", "wall s"), rows)


if __name__ == "__main__":
    main()
