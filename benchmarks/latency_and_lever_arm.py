"""Latency and lever arm that `process --mode ins-gnss` finds, beside the truth, many times.

Flights at 60 m/s in banked turns, smooth and in rough air, and drives, by another program
(`pyins.sim`), with tactical sensors and fixes of 5 cm, every second log with velocities of 5 cm/s.
The latency is for the program to find; the lever arm that it gets is off by 10 cm (1 sigma, each
axis), as one that was measured by hand. Errors over sigmas are of latencies where the log shows
them, used or not. Then each log is run once more with the true latency and arm given, which must
give no warning of either: --whole of them by the whole command.

python benchmarks/latency_and_lever_arm.py
python benchmarks/latency_and_lever_arm.py --motion drive --rate 1 --latency 0.1 --seeds 3
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
from click.testing import CliRunner

from benchmarks.common import parser, print_table
from sinstool.cli.main import cli
from sinstool.core.errors import AlignmentError
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from tests.helpers.filter_logs import start_of
from tests.helpers.unseen_drives import GRADES, LEVER, Motion, drive, flight, record, write

MOTIONS = ("smooth", "turbulent", "drive")
SIGMA_V, ARM_ERROR, REST = 0.05, 0.1, 30.0
KIND = {"gyro_kind": "mean-rate"}
OF_OFFSETS = {"latency", "lever-arm", "velocity-lag"}


@dataclass
class Row:
    """Sums over the logs of a motion, rate and latency."""

    errors: list[float] = field(default_factory=list)  # s, where the log shows the latency
    ratios: list[float] = field(default_factory=list)
    used: list[float] = field(default_factory=list)  # errors over sigmas of those used
    refused: int = 0
    warned: list[str] = field(default_factory=list)
    runs: int = 0

    def cells(self) -> list[str]:
        """Of the table."""
        error, ratio = 1e3 * np.array(self.errors), np.array(self.ratios)
        if not len(error):
            return [f"0 of {self.runs}", *["-"] * 5, "; ".join(self.warned)]
        return [
            f"{len(self.used)} of {self.runs}",
            f"{len(error)}",
            f"{error.mean():+.2f}",
            f"{np.sqrt(np.mean(error**2)):.2f}",
            f"{np.sqrt(np.mean(ratio**2)):.2f}",
            f"{np.abs(ratio).max():.1f}",
            "; ".join([*self.warned, *([f"{self.refused} refused"] if self.refused else [])]),
        ]


@lru_cache(maxsize=2)
def motion_of(kind: str, seed: int, duration: float) -> Motion:
    if kind == "drive":
        return drive(seed, duration, REST)
    return flight(seed, duration, turbulent=kind == "turbulent")


def warnings(start: FilterStart, latency: float) -> Iterator[str]:
    """What it would say of latency and antenna, told the truth."""
    offsets = start.offsets
    if offsets is not None and offsets.latency_contradicts(latency):
        yield f"latency {offsets}"
    if offsets is not None and offsets.arm_contradicts:
        yield f"arm {np.round(offsets.arm_off_b, 2)} +- {np.round(offsets.arm_off_sigma_b, 2)}"
    if start.lag != 0.0:
        yield f"velocity lag {1e3 * start.lag:.0f} ms"


def warnings_of_command(log: Path, latency: float) -> Iterator[str]:
    """The same, by what `sinstool process` prints."""
    arm = ",".join(f"{x:g}" for x in LEVER)
    options = ["--mode", "ins-gnss", "--gyro-kind", "mean-rate", "--gnss-latency", f"{latency:g}"]
    out = log.with_suffix(".out.mcap")
    words = ["process", log, "-o", out, "--json", "--only-results", *options, "--lever-arm", arm]
    result = CliRunner().invoke(cli, [str(word) for word in words])
    out.unlink(missing_ok=True)
    if result.exit_code not in (0, 3):
        yield f"status {result.exit_code}"
        return
    findings = json.loads(result.stdout)["findings"]
    yield from (f["text"] for f in findings if f["kind"] in OF_OFFSETS)


def add(row: Row, log: Path, arm: np.ndarray, latency: float, whole: bool) -> None:
    """A log's answers."""
    row.runs += 1
    try:
        start = start_of(log, input=KIND, gnss={"lever_arm": tuple(arm.tolist())})
    except AlignmentError:
        row.refused += 1
        return
    offsets = start.offsets
    if offsets is not None and offsets.observable:
        row.errors.append(offsets.latency_s - latency)
        row.ratios.append(row.errors[-1] / offsets.sigma_s)
        used = start.settings.gnss_latency
        if used != 0.0:
            row.used.append((used - latency) / offsets.sigma_s)
            if abs(row.used[-1]) > 3.0:
                row.warned.append(f"USED {1e3 * used:.1f} ms, {row.used[-1]:.1f} sigmas off")
    if start.latency_status == "not settled":
        row.warned.append("not settled")
    if whole:
        row.warned += warnings_of_command(log, latency)
        return
    truth = {"lever_arm": tuple(LEVER.tolist()), "gnss_latency": latency}
    row.warned += warnings(start_of(log, input=KIND, gnss=truth), latency)


def main() -> None:
    options = parser(__doc__, seeds=10, first=1, duration=300.0, whole=1)
    options.add_argument("--motion", nargs="+", choices=MOTIONS, default=MOTIONS)
    options.add_argument("--rate", nargs="+", type=float, default=[1.0, 4.0, 10.0])
    options.add_argument("--latency", nargs="+", type=float, default=[0.0, 0.05, 0.1, 0.2])
    args = options.parse_args()
    total = Row()

    def rows(folder: Path) -> Iterator[list[str]]:
        for kind in args.motion:
            table = {(rate, late): Row() for rate in args.rate for late in args.latency}
            for seed in range(args.first, args.first + args.seeds):
                truth = motion_of(kind, seed, args.duration)
                for number, ((rate, late), row) in enumerate(table.items()):
                    draw = 1000 * seed + number
                    sigma_v = SIGMA_V if (seed + number) % 2 else None
                    data = record(
                        truth,
                        GRADES["tactical"],
                        draw,
                        gnss_rate=rate,
                        sigma_v=sigma_v,
                        latency=late,
                    )
                    arm = LEVER + ARM_ERROR * np.random.default_rng(draw).standard_normal(3)
                    log = write(folder / "log.mcap", data)
                    add(row, log, arm, late, seed < args.first + args.whole)
                    log.unlink()
            for (rate, late), row in table.items():
                for name in ("errors", "ratios", "used", "warned"):
                    getattr(total, name).extend(getattr(row, name))
                total.runs, total.refused = total.runs + row.runs, total.refused + row.refused
                yield [kind, f"{rate:g}", f"{1e3 * late:g}", *row.cells()]
        yield ["all", "", "", *total.cells()]

    head = ["motion", "Hz", "latency ms", "used", "shown", "bias ms", "rms ms", "error / sigma",
            "worst", "warnings, told the truth"]  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        print_table(head, rows(Path(folder)))


if __name__ == "__main__":
    main()
