"""What each constraint of a land vehicle is worth on simulated drives, and whether sigmas hold.

Each seed makes a drive of ten minutes with outages of a minute: a mount that is a few degrees off
and that nobody states, an axle behind or ahead of the IMU, slow slip and sideslip, an engine that
shakes at rest, wheels that read wrongly, late, and slip. `process` is told nothing of it, but that
samples are rates at their stamps. Printed
are the largest horizontal errors of the outages (root mean square and median), normalised squares
of errors of attitude and position over all of the drive, which belong near 1, and the
mount's errors over their sigmas. Attitude is that of the case, and beside it that of the axes in
which gyros that are misaligned feel turns: how these lie in the case, no log of a level vehicle
tells.

python benchmarks/land_vehicle_drives.py --seeds 20
python benchmarks/land_vehicle_drives.py --grade mems --seeds 4 --smooth
python benchmarks/land_vehicle_drives.py --grade tactical --seeds 10 --told
python benchmarks/land_vehicle_drives.py --others --seeds 6
python benchmarks/land_vehicle_drives.py --wheels --seeds 4

With --others no cars, by another program's simulation: boats in waves, walks with an IMU in hand,
multicopters and aircraft, with outages of forty seconds. What is printed is how many were taken for
land vehicles or for resting, and horizontal errors with `--vehicle none` and `auto`. With --wheels
cars whose wheels read 3 % too high, are stamped late, or slip on one side: findings, and how far
positions drift in outages without the wheels and with them. With --told the filter knows the noise
of the simulated sensors: what remains is due to constraints and fixes. With --speed, updates that
the filter's loop takes in a second with and without constraints.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from click.testing import CliRunner
from mcap.reader import make_reader

from benchmarks.common import best, over_seeds, parser, print_table
from sinstool.cli.main import cli
from sinstool.core.earth import horizontal_metres
from sinstool.core.rotation import conjugate, from_euler, log, multiply, rotate
from sinstool.io.readers import open_log
from sinstool.methods.ins_gnss.constraints import STEP_NS, Constraints, LandVehicle
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.sensor_errors import SIMULATED_GRADES
from sinstool.pipelines.process.errors_against_truth import Errors, read_references
from sinstool.pipelines.process.ins_gnss import filter_settings
from sinstool.pipelines.process.ins_gnss import run as ins_gnss
from sinstool.pipelines.process.ins_gnss.vehicle import FirstPass
from tests.helpers.filter_logs import nees, run
from tests.helpers.imulogs import T0
from tests.helpers.unseen_drives import (
    GRADES as UNSEEN_GRADES,
)
from tests.helpers.unseen_drives import (
    LEVER,
    boat,
    flight,
    multicopter,
    record,
    walk,
    without_fixes,
    write,
)
from tests.methods.ins_gnss.flown import Flown

OTHERS_IMU = UNSEEN_GRADES["industrial"]

FAULTS = {
    "reads 3 % too high": ("odometry", "--wheel-scale", "3"),
    "stamped 0.2 s late": ("twist", "--wheel-latency", "0.2"),
    "left wheel slips": ("joint", "--wheel-slip", "5", "--wheel-slipping", "left"),
}
ROWS = ("none", "rest", "axle", "axle, wheels", "rest, axle", "all")
GRADES = ("consumer", "mems", "tactical", "navigation")
DURATION, OUTAGE, EVERY, SETTLED = 600.0, 60.0, 150.0, 90.0


@dataclass
class Scores:
    """Of the runs of a row."""

    metres: list[float] = field(default_factory=list)
    drift: list[float] = field(default_factory=list)  # the same from the error at the begin on
    attitude: list[float] = field(default_factory=list)
    turning: list[float] = field(default_factory=list)  # of the axes in which turns are felt
    position: list[float] = field(default_factory=list)
    mount: list[float] = field(default_factory=list)
    told: list[str] = field(default_factory=list)


@contextmanager
def only(row: str) -> Iterator[None]:
    """A filter that uses some constraints of those found."""
    whole = ins_gnss.first_pass

    def some(*args: Any) -> FirstPass:
        found = whole(*args)
        held = found.vehicle.constraints
        if held is None or row == "all":
            return found
        nothing = np.zeros_like(held.rests)
        unknown = np.full(len(nothing), np.nan)
        if "wheels" not in row:
            held = replace(held, wheel_speed=unknown)
        if "rest" not in row:
            held = replace(held, rests=nothing)
        if "axle" not in row:
            held = replace(held, vehicle=None)
        return replace(found, vehicle=replace(found.vehicle, constraints=held))

    ins_gnss.first_pass = some
    try:
        yield
    finally:
        ins_gnss.first_pass = whole


@contextmanager
def told(grade: str) -> Iterator[dict[str, Any]]:
    """Options of a filter that knows the noise of simulated sensors."""
    usual = filter_settings.imu_noise_of
    filter_settings.imu_noise_of = lambda *_: SIMULATED_GRADES[grade]
    try:
        yield {"navigation": {"imu_grade": grade}, "filter": {"virtual_noise": "off"}}
    finally:
        filter_settings.imu_noise_of = usual


def drive(folder: Path, seed: int, grade: str) -> tuple[Path, np.ndarray]:
    """A log, and the mount, rad."""
    random = np.random.default_rng([seed, 19])
    mount = random.uniform(-5.0, 5.0, 3)
    scale, latency = random.uniform(-3.0, 3.0), random.choice([0.0, 0.1, 0.2])
    path = simulated(
        folder, seed, grade, mount,
        "--axle-lever", f"{random.uniform(-0.5, 2.0):.2f}",
        "--sideslip", f"{random.uniform(0.001, 0.004):.4f}",
        "--slip", f"{random.uniform(0.02, 0.08):.3f}",
        "--wheels", str(random.choice(["odometry", "twist", "joint"])),
        "--wheel-scale", f"{scale:.2f}", "--wheel-latency", f"{latency:g}", "--wheel-slip", "1",
    )  # fmt: skip
    return path, np.deg2rad(mount)


def simulated(folder: Path, seed: int, grade: str, mount: np.ndarray, *words: str) -> Path:
    """Log of a drive with outages and an engine that shakes at rest; the mount in degrees."""
    options = [
        "simulate", "drive", "-o", str(folder / "drive.mcap"), "--duration", str(DURATION),
        "--grade", grade, "--seed", str(seed), "--gnss-model", "coloured",
        "--outages", f"{OUTAGE:g},{EVERY:g}",
        "--mount", ",".join(f"{a:.4f}" for a in mount), "--idle", "0.3,0.01", *words,
    ]  # fmt: skip
    ran = CliRunner().invoke(cli, options)
    assert ran.exit_code == 0, ran.output
    return folder / "drive.mcap"


def one(job: tuple[int, str, bool, bool, tuple[str, ...]]) -> dict[str, Scores]:
    """All rows of a seed."""
    seed, grade, smooth, known, rows = job
    out = {}
    with tempfile.TemporaryDirectory() as folder:
        path, mount = drive(Path(folder), seed, grade)
        for row in rows:
            with only(row), told(grade) if known else nullcontext({}) as options:
                options.setdefault("filter", {})["smooth"] = smooth
                # Else sigmas admit that samples are of half a sample before, which these are not
                options["input"] = {"gyro_kind": "rate"}
                chosen, solution = run(path, **options)
            out[row] = scored(path, chosen, solution, mount)
    return out


def axes_of_turns(path: Path) -> np.ndarray:
    """Rotation from the case to the axes in which gyros feel a car's turns, rad, FRD.

    Misaligned gyros feel a turn about z about another axis, and level the attitude by it.
    """
    with path.open("rb") as stream:
        (record,) = make_reader(stream).iter_metadata()
    text = record.metadata.get("gyro_matrix_ppm")
    if text is None:
        return np.zeros(3)
    flip = np.diag([1.0, -1.0, -1.0])
    m = flip @ (1e-6 * np.array([float(x) for x in text.split(",")]).reshape(3, 3)) @ flip
    return np.array([-m[1, 2], m[0, 2], 0.0])


def scored(path: Path, chosen: dict[str, Any], solution: Any, mount: np.ndarray) -> Scores:
    """Errors of a run against the truth."""
    with open_log(path) as opened:
        truth = read_references(opened, ("/truth/imu", "/truth/fix"), "flu")
    seconds = (solution.time_ns - int(chosen["imu"]["first_ns"])) * 1e-9
    rows = solution.rows(np.flatnonzero(seconds > SETTLED)[::20])
    seconds = (rows.time_ns - int(chosen["imu"]["first_ns"])) * 1e-9
    held = Errors(truth)
    score, turned = Scores(), axes_of_turns(path)
    for kind in ("attitude", "position"):
        error = held.push(kind, rows)
        covariance = getattr(rows, f"covariance_{kind}_n")
        getattr(score, kind).append(nees(error, covariance)[0])
        if kind == "attitude":
            error = error + rotate(rows.q_nb, turned)
            score.turning.append(nees(error, covariance)[0])
        if kind == "position":
            north_east = error[:, :2]
    phase = seconds % EVERY
    for k in range(1, int(DURATION / EVERY)):
        during = (seconds >= k * EVERY) & (phase < OUTAGE)
        during &= seconds < (k + 1) * EVERY
        held_off = north_east[during]
        score.metres.append(float(np.nanmax(np.hypot(*held_off.T))))
        score.drift.append(float(np.nanmax(np.hypot(*(held_off - held_off[0]).T))))
    land = chosen["filter"]["vehicle"]["land"]
    if land is not None:
        found = from_euler(np.deg2rad(land["mount_deg"]))
        off = log(multiply(from_euler(mount), conjugate(found)))
        score.mount += (off[1:] / np.deg2rad(land["mount_sigma_deg"])).tolist()
    score.told += [f["kind"] for f in chosen["findings"]]
    return score


def other(job: tuple[str, int]) -> tuple[bool, float, list[float], list[float]]:
    """What is no car: whether it was taken for one, seconds at rest, errors none and auto."""
    name, seed = job
    make = {"boat": boat, "walk": walk, "multicopter": multicopter, "aircraft": flight}[name]
    truth = make(seed, 400.0)
    data = record(truth, OTHERS_IMU, seed, gnss_rate=5.0, sigma=0.3, sigma_v=0.05)
    spans = [(begin, begin + 40.0) for begin in np.arange(100.0, 350.0, 100.0)]
    errors: list[list[float]] = []
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder) / "log.mcap", without_fixes(data, spans))
        for vehicle in ("none", "auto"):
            config = {"vehicle": vehicle}
            arm = tuple(LEVER.tolist())
            chosen, solution = run(
                path, filter=config, gnss={"lever_arm": arm}, input={"gyro_kind": "mean-rate"}
            )
            seconds = (solution.time_ns - T0) * 1e-9
            k = np.clip(np.searchsorted(truth.seconds, seconds - 1e-6), 0, len(truth.seconds) - 1)
            north, east = horizontal_metres(
                solution.position[:, 0] - truth.latitude[k],
                solution.position[:, 1] - truth.longitude[k],
                truth.latitude[k],
            )
            level = np.hypot(north, east)
            errors.append(
                [float(level[(seconds >= a) & (seconds < b)].max()) for a, b in spans]
                + [float(np.sqrt(np.mean(level[seconds > 60.0] ** 2)))]
            )
    used = chosen["filter"]["vehicle"]
    return used["kind"] == "land", used["rest_s"], errors[0], errors[1]


def others(seeds: int, jobs: int) -> None:
    """Table of what is no car."""
    table = []
    for name in ("boat", "walk", "multicopter", "aircraft"):
        answers = over_seeds(other, [(name, seed) for seed in range(seeds)], jobs)
        sizes = []
        for which in (2, 3):
            outages = np.array([answer[which][:-1] for answer in answers])
            whole = np.array([answer[which][-1] for answer in answers])
            sizes += [f"{np.sqrt(np.mean(outages**2)):.2f}", f"{np.sqrt(np.mean(whole**2)):.3f}"]
        land = sum(answer[0] for answer in answers)
        rest = np.mean([answer[1] for answer in answers])
        table.append([name, f"{land} of {seeds}", f"{rest:.0f}", *sizes])
    head = (
        "", "taken for land vehicles", "at rest s", "none: outages m", "whole m",
        "auto: outages m", "whole m",
    )  # fmt: skip
    print_table(head, table)


def faulty(job: tuple[str, int]) -> tuple[Scores, Scores]:
    """Wheels with a fault: a drive without them, and with."""
    name, seed = job
    mount = np.random.default_rng([seed, 19]).uniform(-5.0, 5.0, 3)
    kind, *fault = FAULTS[name]
    words = ["--axle-lever", "1.2", "--sideslip", "0.002", "--slip", "0.05", "--wheels", kind]
    with tempfile.TemporaryDirectory() as folder:
        path = simulated(Path(folder), seed, "mems", mount, *words, *fault)
        without = run(path, input={"wheels": "none"})
        used = run(path)
        first, second = (scored(path, *ran, np.deg2rad(mount)) for ran in (without, used))
    return first, second


def wheels(seeds: int, jobs: int) -> None:
    """Table of wheels with faults."""
    table = []
    for name in FAULTS:
        answers = over_seeds(faulty, [(name, seed) for seed in range(seeds)], jobs)
        drift = [np.concatenate([pair[which].drift for pair in answers]) for which in (0, 1)]
        told = [kind for _, used in answers for kind in used.told if kind.startswith("wheel")]
        table.append(
            [
                name,
                ", ".join(f"{kind} {told.count(kind)}" for kind in sorted(set(told))),
                *(f"{np.sqrt(np.mean(d**2)):.2f}" for d in drift),
                f"{np.count_nonzero(drift[1] > 1.1 * drift[0] + 0.5)} of {len(drift[0])}",
            ]
        )
    head = ("wheels", "findings, times", "drift without m rms", "with", "outages worse by wheels")
    print_table(head, table, f"{seeds} drives each")


def speed() -> None:
    """Updates a second of the filter's loop."""
    flown = Flown(duration=600.0)
    updates, steps = len(flown.increments.interval), 6020
    begin = int(flown.increments.time_ns[0]) - STEP_NS
    every = np.ones(steps, bool)
    vehicle = LandVehicle(np.eye(3), 1.0, 0.1, 0.1)
    held = Constraints(begin, ~every, ~every, every, np.full(steps, 30.0), vehicle)
    stands = Constraints(begin, every, every, ~every, np.full(steps, np.nan), vehicle)
    cases = (("none", None), ("axle and wheels", held), ("rest", stands))
    table = []
    for name, constraints in cases:
        row: list[object] = [name]
        for store in (False, True):

            def go(constraints: Constraints | None = constraints, store: bool = store) -> None:
                filter_ = InsGnssFilter(
                    flown.start,
                    flown.using("markov-27"),
                    with_baro=False,
                    store=store,
                    constraints=constraints,
                )
                filter_.push(flown.increments, flown.gnss)

            row.append(f"{updates / best(go, 4, time.process_time):.0f}")
        table.append(row)
    print_table(("constraints", "updates/s, filter", "updates/s, storing for a smoother"), table)


def _worse(answers: list[dict[str, Scores]], row: str) -> str:
    """Outages in which wheels add to the drift, by more than a tenth and half a metre.

    The error of the last fix, metres that no wheel can take away, is there with and without.
    """
    off = np.concatenate([answer[row].drift for answer in answers])
    without = np.concatenate([answer["rest, axle"].drift for answer in answers])
    return f"{np.count_nonzero(off > 1.1 * without + 0.5)} of {len(off)}"


def main() -> None:
    options = parser(__doc__, seeds=20, first=0, jobs=2)
    options.add_argument("--grade", nargs="+", choices=GRADES, default=GRADES)
    options.add_argument("--rows", nargs="+", choices=ROWS, default=ROWS)
    options.add_argument("--smooth", action="store_true")
    options.add_argument("--told", action="store_true", help="the noise of the sensors is known")
    options.add_argument("--others", action="store_true", help="what is no car")
    options.add_argument("--wheels", action="store_true", help="with faults")
    options.add_argument("--speed", action="store_true", help="of the filter's loop")
    args = options.parse_args()
    if args.others:
        others(args.seeds, args.jobs)
        return
    if args.wheels:
        wheels(args.seeds, args.jobs)
        return
    if args.speed:
        speed()
        return
    for grade in args.grade:
        jobs = [
            (seed, grade, args.smooth, args.told, tuple(args.rows))
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
                        for kind in ("attitude", "turning", "position")
                    ),
                    f"{np.sqrt(np.mean(mount**2)):.2f}" if len(mount) else "",
                    f"{np.abs(mount).max():.1f}" if len(mount) else "",
                    _worse(answers, row) if row == "all" and "rest, axle" in args.rows else "",
                ]
            )
        head = (
            "constraints", "outage rms m", "median", "NEES attitude", "of turns", "position",
            "mount /sigma", "most", "outages worse by wheels",
        )  # fmt: skip
        title = f"{grade}, {args.seeds} drives, {'smoother' if args.smooth else 'filter'}"
        title += ", sensors known" if args.told else ""
        print_table(head, table, title)


if __name__ == "__main__":
    main()
