"""What each constraint of a land vehicle is worth on simulated drives, and whether sigmas hold.

Each seed makes a drive of ten minutes with outages of a minute: a mount that is a few degrees off
and that nobody states, an axle behind or ahead of the IMU, slow slip and sideslip, an engine that
shakes at rest, wheels that read wrongly, late, and slip. `process` is told nothing of it. Printed
are the largest horizontal errors of the outages (root mean square and median), normalised squares
of errors of attitude and position over all of the drive, which belong near 1, and the
mount's errors over their sigmas.

python benchmarks/land_vehicle_drives.py --seeds 20
python benchmarks/land_vehicle_drives.py --grade mems --seeds 4 --smooth
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from click.testing import CliRunner

from benchmarks.common import over_seeds, parser, print_table
from sinstool.cli.main import cli
from sinstool.core.rotation import conjugate, from_euler, log, multiply
from sinstool.io.readers import open_log
from sinstool.pipelines.process.errors_against_truth import Errors, read_references
from sinstool.pipelines.process.ins_gnss import run as ins_gnss
from sinstool.pipelines.process.ins_gnss.vehicle import VehicleFound
from tests.helpers.filter_logs import nees, run

ROWS = ("none", "rest", "lateral", "wheels", "all")
GRADES = ("mems", "tactical", "navigation")
DURATION, OUTAGE, EVERY, SETTLED = 600.0, 60.0, 150.0, 90.0


@dataclass
class Scores:
    """Of the runs of a row."""

    metres: list[float] = field(default_factory=list)
    attitude: list[float] = field(default_factory=list)
    position: list[float] = field(default_factory=list)
    mount: list[float] = field(default_factory=list)
    told: list[str] = field(default_factory=list)


@contextmanager
def only(row: str) -> Iterator[None]:
    """A filter that uses some constraints of those found."""
    whole = ins_gnss.find_vehicle

    def some(*args: Any) -> VehicleFound:
        found = whole(*args)
        held = found.constraints
        if held is None or row == "all":
            return found
        nothing = np.zeros_like(held.rests)
        unknown = np.full(len(nothing), np.nan)
        if row == "none":
            return replace(found, constraints=None)
        if row == "rest":
            held = replace(held, vehicle=None, wheel_speed=unknown)
        elif row == "lateral":
            held = replace(held, rests=nothing, wheel_speed=unknown)
        else:
            held = replace(held, rests=nothing)
        return replace(found, constraints=held)

    ins_gnss.find_vehicle = some
    try:
        yield
    finally:
        ins_gnss.find_vehicle = whole


def drive(folder: Path, seed: int, grade: str) -> tuple[Path, np.ndarray]:
    """A log, and the mount, rad."""
    random = np.random.default_rng([seed, 19])
    mount = random.uniform(-5.0, 5.0, 3)
    scale, latency = random.uniform(-3.0, 3.0), random.choice([0.0, 0.1, 0.2])
    words = [
        "simulate", "drive", "-o", str(folder / "drive.mcap"), "--duration", str(DURATION),
        "--grade", grade, "--seed", str(seed), "--gnss-model", "coloured",
        "--outages", f"{OUTAGE:g},{EVERY:g}",
        "--mount", ",".join(f"{a:.4f}" for a in mount),
        "--axle-lever", f"{random.uniform(-0.5, 2.0):.2f}",
        "--sideslip", f"{random.uniform(0.001, 0.004):.4f}",
        "--slip", f"{random.uniform(0.02, 0.08):.3f}", "--idle", "0.3,0.01",
        "--wheels", str(random.choice(["odometry", "twist", "joint"])),
        "--wheel-scale", f"{scale:.2f}", "--wheel-latency", f"{latency:g}", "--wheel-slip", "1",
    ]  # fmt: skip
    ran = CliRunner().invoke(cli, words)
    assert ran.exit_code == 0, ran.output
    return folder / "drive.mcap", np.deg2rad(mount)


def one(job: tuple[int, str, bool, tuple[str, ...]]) -> dict[str, Scores]:
    """All rows of a seed."""
    seed, grade, smooth, rows = job
    out = {}
    with tempfile.TemporaryDirectory() as folder:
        path, mount = drive(Path(folder), seed, grade)
        for row in rows:
            with only(row):
                chosen, solution = run(path, filter={"smooth": smooth})
            out[row] = scored(path, chosen, solution, mount)
    return out


def scored(path: Path, chosen: dict[str, Any], solution: Any, mount: np.ndarray) -> Scores:
    """Errors of a run against the truth."""
    with open_log(path) as opened:
        truth = read_references(opened, ("/truth/imu", "/truth/fix"), "flu")
    seconds = (solution.time_ns - int(chosen["imu"]["first_ns"])) * 1e-9
    rows = solution.rows(np.flatnonzero(seconds > SETTLED)[::20])
    seconds = (rows.time_ns - int(chosen["imu"]["first_ns"])) * 1e-9
    held = Errors(truth)
    score = Scores()
    for kind in ("attitude", "position"):
        error = held.push(kind, rows)
        mean, _ = nees(error, getattr(rows, f"covariance_{kind}_n"))
        getattr(score, kind).append(mean)
        if kind == "position":
            level = np.hypot(error[:, 0], error[:, 1])
    phase = seconds % EVERY
    for k in range(1, int(DURATION / EVERY)):
        during = (seconds >= k * EVERY) & (phase < OUTAGE)
        during &= seconds < (k + 1) * EVERY
        score.metres.append(float(np.nanmax(level[during])))
    land = chosen["filter"]["vehicle"]["land"]
    if land is not None:
        found = from_euler(np.deg2rad(land["mount_deg"]))
        off = log(multiply(from_euler(mount), conjugate(found)))
        score.mount += (off[1:] / np.deg2rad(land["mount_sigma_deg"])).tolist()
    score.told += [f["kind"] for f in chosen["findings"]]
    return score


def main() -> None:
    options = parser(__doc__, seeds=20, first=0, jobs=2)
    options.add_argument("--grade", nargs="+", choices=GRADES, default=GRADES)
    options.add_argument("--rows", nargs="+", choices=ROWS, default=ROWS)
    options.add_argument("--smooth", action="store_true")
    args = options.parse_args()
    for grade in args.grade:
        jobs = [
            (seed, grade, args.smooth, tuple(args.rows))
            for seed in range(args.first, args.first + args.seeds)
        ]
        answers = over_seeds(one, jobs, args.jobs)
        table = []
        for row in args.rows:
            scores = [answer[row] for answer in answers]
            metres = np.concatenate([s.metres for s in scores])
            mount = np.concatenate([s.mount for s in scores]) if scores else np.zeros(0)
            table.append(
                [
                    row,
                    f"{np.sqrt(np.mean(metres**2)):.2f}",
                    f"{np.median(metres):.2f}",
                    *(
                        f"{np.mean(np.concatenate([getattr(s, kind) for s in scores])):.2f}"
                        for kind in ("attitude", "position")
                    ),
                    f"{np.sqrt(np.mean(mount**2)):.2f}" if len(mount) else "",
                    f"{np.abs(mount).max():.1f}" if len(mount) else "",
                ]
            )
        head = (
            "constraints", "outage rms m", "median", "NEES attitude", "position",
            "mount /sigma", "most",
        )  # fmt: skip
        title = f"{grade}, {args.seeds} drives, {'smoother' if args.smooth else 'filter'}"
        print_table(head, table, title)


if __name__ == "__main__":
    main()
