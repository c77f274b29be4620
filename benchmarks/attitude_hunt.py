"""Hunting for roll and pitch that are wrong and do not say so: `process` on logs without GNSS.

Each seed makes a trajectory by another program (`pyins.sim`: a drive, a flight, a boat, a walk, a
multicopter, a motorcycle, a train, a tractor, a glider, a helicopter) and a log of 20 s to 10 min
of it, by sensors of a random grade, mounted any way up. Beside noise and constant errors these may
have biases that change while they warm up or follow the specific force, quantised and clipped
outputs, vibration of 20 to 150 Hz, low rates, stamps with jitter or of receipt in bursts, samples
that are lost, repeated or late, and gaps. The log goes through the whole command, without options,
or with --options with one of `wrong_options.py` for each log, most of which are wrong.

The attitude written is held against the truth at its stamps, less what they are late in the mean,
ten times a second, and by the covariance written with it. A *miss* is a log whose tilt is off by
more than 0.5 deg and 3 of its own sigmas (root mean squares) with exit status 0 and no finding that
says so.

A table has all that was random about each seed; --only makes and shows one seed again.

python benchmarks/attitude_hunt.py --logs 200 --jobs 2
python benchmarks/attitude_hunt.py --only 17
python benchmarks/attitude_hunt.py --options --logs 200
python benchmarks/attitude_hunt.py --kinds train glider --logs 100 --quiet
"""

from __future__ import annotations

import json
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from click.testing import CliRunner
from scipy.spatial.transform import Rotation, Slerp

from benchmarks.common import FloatArray, over_seeds, parser, print_table
from benchmarks.trusted_navigation import BODY, WORLD
from benchmarks.wrong_options import without_gnss
from sinstool.cli.main import cli
from sinstool.core.units import DEGREE
from sinstool.io.readers import open_log
from sinstool.io.readers.streams import Losses, read_columns
from tests.helpers.imulogs import T0
from tests.helpers.unseen_drives import RATE, Motion, boat, drive, flight, multicopter, walk
from tests.helpers.unseen_sensors import GRADES, Log, log_uniform, measured, recorded, written
from tests.helpers.unseen_vehicles import VEHICLES

KINDS = {
    "drive": partial(drive, rest=10.0),
    "flight": flight,
    "turbulent": partial(flight, turbulent=True),
    "boat": boat,
    "walk": walk,
    "multicopter": multicopter,
    **VEHICLES,
}
FAR_DEG, FAR_SIGMAS = 0.5, 3.0
# Findings that say that roll and pitch may be further off than their sigmas
SAYING = {
    "bursts",
    "gyro-at-stop",
    "long-turns",
    "motion-denied",
    "other-rate",
    "saturation",
    "time-source",
    "unsure-motion",
}
WORST = 10


@dataclass(frozen=True)
class Outcome:
    """What became of one log: tilt RMS in deg and of its own sigma, heading since the start."""

    seed: int
    what: str
    status: int
    tilt_deg: float = np.nan
    sigmas: float = np.nan
    heading_sigmas: float = np.nan
    findings: tuple[str, ...] = ()
    note: str = ""

    @property
    def says(self) -> bool:
        return self.status != 0 or bool(SAYING & set(self.findings))

    @property
    def missed(self) -> bool:
        far = self.sigmas > FAR_SIGMAS or not np.isfinite(self.sigmas)
        return not self.says and self.tilt_deg > FAR_DEG and far

    def row(self) -> list[object]:
        numbers = [f"{x:.3g}" for x in (self.tilt_deg, self.sigmas, self.heading_sigmas)]
        found = " ".join(self.findings)
        return [self.seed, self.what, self.status, *numbers, found, self.note]


def judged(out: Path, log: Log, seconds: FloatArray) -> tuple[float, float, float]:
    """Errors of what was written: tilt in deg and of its sigma, heading since the start of its."""
    paths = {
        "q": [f"orientation.{axis}" for axis in "xyzw"],
        "p": ["orientation_covariance"],
        "sec": ["header.stamp.sec"],
        "nanosec": ["header.stamp.nanosec"],
    }
    parts = []
    with open_log(out) as opened:
        channels = opened.channels_of("/sinstool/imu")
        for _, values in read_columns(opened, channels, paths, Losses(), widths={"p": 9}):
            parts.append({name: np.asarray(values[name]).copy() for name in paths})
    columns = {name: np.concatenate([part[name] for part in parts]) for name in paths}
    stamp = columns["sec"].astype(np.int64) * 10**9 + columns["nanosec"].astype(np.int64) - T0
    at = np.clip((stamp - log.late_ns) * 1e-9, seconds[0], seconds[-1])
    every = np.unique(np.searchsorted(at, np.arange(at[0], at[-1] - 0.05, 0.1)))
    c_nb = WORLD @ Rotation.from_quat(columns["q"][every]).as_matrix() @ BODY
    truth = Slerp(seconds, Rotation.from_matrix(log.truth))(at[every]).as_matrix()
    # heading is free: the truth is turned to that of the first attitude
    off = truth @ np.swapaxes(c_nb, 1, 2)
    psi = np.unwrap(np.arctan2(off[:, 1, 0] - off[:, 0, 1], off[:, 0, 0] + off[:, 1, 1]))
    heading = psi - psi[0]
    level = Rotation.from_euler("z", -psi[:, None]).as_matrix() @ truth @ np.swapaxes(c_nb, 1, 2)
    tilt = Rotation.from_matrix(level).as_rotvec()[:, :2]
    p = WORLD @ columns["p"].reshape(-1, 3, 3)[every] @ WORLD.T
    known = p[:, 0, 0] > 0.0
    size = float(np.sqrt(np.mean(np.sum(tilt**2, axis=1))) / DEGREE)
    if not known.any():
        return size, np.nan, np.nan
    square = np.einsum("ni,ni->n", tilt, np.linalg.solve(p[:, :2, :2], tilt[..., None])[..., 0])
    ratio = float(np.sqrt(np.mean(square) / 2.0))
    return size, ratio, float(np.sqrt(np.mean(heading**2 / p[:, 2, 2])))


def hunted(seed: int, kinds: Sequence[str], options: bool = False) -> Outcome:
    """One log through the command, without options, or with one that need not suit it."""
    random = np.random.default_rng([seed, 91])
    kind, grade = str(random.choice(list(kinds))), str(random.choice(list(GRADES)))
    duration = log_uniform(random, 20.0, 600.0)
    begin = float(random.uniform(20.0, 150.0)) if random.random() < 0.5 else 0.0
    whole = KINDS[kind](int(random.integers(1 << 30)), begin + duration)
    names = ("seconds", "latitude", "longitude", "height", "velocity_n", "c_nb", "gyro", "accel")
    first = round(begin * RATE)
    moving = Motion(*(getattr(whole, name)[first:] for name in names))
    texts, log = measured(random, moving, grade)
    more, log = recorded(random, log)
    option = without_gnss(np.random.default_rng([seed, 92])) if options else []
    parts = [f"{kind} {begin:.0f}+{duration:.0f} s", grade, *texts, *more, " ".join(option)]
    what = "; ".join(filter(None, parts))
    with tempfile.TemporaryDirectory() as folder:
        path = written(Path(folder) / f"{seed}.mcap", log)
        out = path.with_suffix(".out.mcap")
        words = ["process", str(path), "-o", str(out), "--json", "-q", "--only-results",
                 "--compression", "lz4", "--emit", "imu", *option]  # fmt: skip
        ran = CliRunner().invoke(cli, words, standalone_mode=False)
        status = ran.return_value if isinstance(ran.return_value, int) else ran.exit_code
        if not out.exists():
            return Outcome(seed, what, status, note=(ran.stderr or repr(ran.exception))[:160])
        said = json.loads(ran.stdout)
        numbers = judged(out, log, moving.seconds)
    smoothing = said["smoothing"]
    note = "inertial"
    if smoothing is not None:
        margin, sigma = smoothing["motion_margin_nat"] or 0.0, smoothing["tilt_sigma_deg"] or np.nan
        note = (
            f"{smoothing['motion']} {margin:.2g}, {smoothing['rest_s']:.0f} s at rest,"
            f" sigma {sigma:.2g} deg"
        )
    note += f", {said['plan']['imu_grade']['value']}, {said['alignment']['method']}"
    kinds_found = tuple(dict.fromkeys(one["kind"] for one in said["findings"]))
    return Outcome(seed, what, status, *numbers, kinds_found, note)


def main() -> None:
    options = parser(__doc__, logs=200, first=1, jobs=2)
    options.add_argument("--only", type=int, help="this seed alone")
    options.add_argument("--options", action="store_true", help="one option for each log")
    options.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    options.add_argument("--quiet", action="store_true", help="no table of all seeds")
    args = options.parse_args()
    seeds = range(args.first, args.first + args.logs) if args.only is None else [args.only]
    outcomes = over_seeds(partial(hunted, kinds=args.kinds, options=args.options), seeds, args.jobs)
    head = ["seed", "what", "status", "tilt deg", "sigmas", "heading sigmas", "findings", ""]
    if not args.quiet:
        print_table(head, (one.row() for one in outcomes))
    status = Counter(one.status for one in outcomes)
    solved = [one for one in outcomes if np.isfinite(one.tilt_deg)]
    print(
        f"\n{len(outcomes)} logs: status"
        f" {', '.join(f'{key}: {status[key]}' for key in sorted(status))};"
        f" {len(solved)} solutions; missed {sum(one.missed for one in outcomes)}"
    )
    if not solved:
        return
    for far in (2.0, 4.0):
        beyond = [one for one in solved if one.sigmas > far]
        silent = [one for one in beyond if not one.says]
        print(
            f"tilt beyond {far:g} sigmas: {len(beyond)} logs ({len(beyond) / len(solved):.1%}),"
            f" {len(silent)} of them with status 0 and no finding that says so"
        )
    tilts = np.array([one.tilt_deg for one in solved])
    ratios = np.array([one.sigmas for one in solved])
    turned = np.array([one.heading_sigmas for one in solved])
    print(
        f"tilt: median {np.median(tilts):.2g} deg, 95 % {np.percentile(tilts, 95.0):.2g} deg;"
        f" over sigma: median {np.nanmedian(ratios):.2g};"
        f" heading since the start: median {np.nanmedian(turned):.2g} of its sigma,"
        f" {np.mean(turned > 2.0):.1%} beyond 2, {np.mean(turned > 4.0):.1%} beyond 4"
    )
    for one in outcomes:
        if one not in solved:
            print(f"no solution: {one.row()}")
    worst = sorted(solved, key=lambda one: (one.missed, not one.says, one.sigmas), reverse=True)
    print_table(head, (one.row() for one in worst[:WORST]), f"\nthe worst {WORST}, misses first")


if __name__ == "__main__":
    main()
