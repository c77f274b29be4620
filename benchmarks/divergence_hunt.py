"""Hunting for navigation that is lost and does not say so: `process --mode ins-gnss` at random.

Each seed makes a trajectory by another program (`pyins.sim`: a drive, a smooth or a turbulent
flight), sensors of a random grade, a receiver of a random rate, noise and latency, with faults
(gaps of the IMU, outages, outliers, a receiver that hangs, one that claims too much) and
with settings that are wrong (grade, lever arm, latency, share of lasting noise), or with --right
none of them. The log goes through the whole command. A *miss* is a log whose solution ends beyond
10 of its own sigmas and beyond 100 m from the truth with exit status 0.

Printed are the worst by error over sigma, at the end and anywhere, and by the root mean squares of
tilt and heading over theirs, with all that was random about them; --only makes and shows one seed
again. With --keep each outcome is added to a file of JSON lines as soon as it is known, and those
that the file has already are not made again. With --others it hunts among boats, walks and
multicopters instead, or among the kinds that follow it: motorcycles, trains, tractors, gliders,
helicopters. With --errors logs also have some of those of tests/helpers/unseen_errors.py: axes that
are not square, biases that follow specific force or temperature, vibration, 16 bits, lost samples,
stamps by receipt, clocks that drift, any mounting, fixes that wander or say nothing of their noise.
With --options each log gets one more of the options of `wrong_options.py`, most of which are wrong.
With --midway logs begin somewhere in the motion, their fixes a few seconds before the samples or
after.

python benchmarks/divergence_hunt.py --logs 500 --jobs 2
python benchmarks/divergence_hunt.py --logs 500 --jobs 2 --keep hunt.jsonl
python benchmarks/divergence_hunt.py --only 17
python benchmarks/divergence_hunt.py --right --logs 100
python benchmarks/divergence_hunt.py --errors --right --logs 100
python benchmarks/divergence_hunt.py --errors --right --options --logs 100
python benchmarks/divergence_hunt.py --errors --right --midway --logs 100
python benchmarks/divergence_hunt.py --others motorcycle train tractor glider helicopter --logs 100
"""

from __future__ import annotations

import json
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.common import over_seeds, parser, print_table
from benchmarks.trusted_navigation import process
from benchmarks.wrong_options import with_gnss
from sinstool.core.units import DEGREE
from sinstool.methods.sensor_errors import IMU_GRADES
from tests.helpers.unseen_drives import (
    GRADES,
    LEVER,
    PHONE,
    Motion,
    Record,
    boat,
    drive,
    flight,
    frozen,
    multicopter,
    record,
    sensor_errors,
    walk,
    with_outliers,
    without_fixes,
    without_samples,
    write,
)
from tests.helpers.unseen_errors import (
    any_mount,
    crossed,
    drifting_clock,
    g_sensitive,
    quantised,
    received,
    shaken,
    slower,
    streets,
    turned,
    unsteady_stamps,
    wandering,
    warming,
    with_lost,
)
from tests.helpers.unseen_vehicles import VEHICLES

# Calibrated sensors, and chips that nobody calibrated, with what their data sheets say: zero rates
# of .1 to 1 deg/s and 20 to 40 mg, which change little in an hour, .5 to 1.5 % of scale and, with
# --errors, as much across.
CHIPS = {
    "phone's chip": PHONE,
    "drone's chip": sensor_errors(0.5, 900.0, 0.15, 30000.0, 10000.0, 100.0),
    "hobbyist's chip": sensor_errors(0.3, 3600.0, 0.25, 40000.0, 15000.0, 100.0),
}
# rad/s and m/s^2, by which biases follow temperature and specific force at most (1 sigma)
CHANGES = 0.1 * DEGREE, 0.05
SENSORS = {**GRADES, "MEMS": sensor_errors(0.4, 150.0, 0.15, 1500.0, 3000.0, 0.5), **CHIPS}
USUAL_OTHERS = ("boat", "walk", "multicopter")
OTHERS = {"boat": boat, "walk": walk, "multicopter": multicopter, **VEHICLES}
FAR_M, FAR_SIGMAS = 100.0, 10.0
WORST = 10


@dataclass(frozen=True)
class Outcome:
    """What became of one log.

    Attributes
    ----------
    what : str
        All that was random about it.
    status : int
        Exit status.
    end_m, end_sigmas : float
        Horizontal error at the end, m and of its own sigma; NaN without a solution.
    most_m, most_sigmas : float
        The same where it is the most of its sigma, beyond `FAR_M` if it ever is.
    tilt_deg, tilt_sigmas, heading_deg, heading_sigmas : float
        Root mean squares of all of the log, deg and of their own sigmas.
    """

    seed: int
    what: str
    status: int
    end_m: float = np.nan
    end_sigmas: float = np.nan
    most_m: float = np.nan
    most_sigmas: float = np.nan
    note: str = ""
    tilt_deg: float = np.nan
    tilt_sigmas: float = np.nan
    heading_deg: float = np.nan
    heading_sigmas: float = np.nan

    @property
    def turned_sigmas(self) -> float:
        """The larger of tilt and heading over their sigmas."""
        return max(self.tilt_sigmas, self.heading_sigmas)

    @property
    def missed(self) -> bool:
        """Lost at the end, and not said."""
        return self.status == 0 and self.end_m > FAR_M and self.end_sigmas > FAR_SIGMAS

    @property
    def missed_anywhere(self) -> bool:
        """Lost at any time, and not said."""
        return self.status == 0 and self.most_m > FAR_M and self.most_sigmas > FAR_SIGMAS


def trajectory(random: np.random.Generator, others: Sequence[str]) -> tuple[str, Motion]:
    """A random one, of 4 to 10 minutes."""
    duration, seed = float(random.integers(240, 600)), int(random.integers(1 << 30))
    if others:
        name = str(random.choice(list(others)))
        return f"{name} {duration:.0f} s", OTHERS[name](seed, duration)
    kind = random.choice(["drive", "flight", "turbulent"], p=[0.6, 0.2, 0.2])
    if kind == "drive":
        rest = float(random.choice([5.0, 30.0, 120.0]))
        return f"drive {duration:.0f} s, {rest:g} s at rest", drive(seed, duration, rest)
    return f"{kind} {duration:.0f} s", flight(seed, duration, kind == "turbulent")


def receiver(random: np.random.Generator) -> tuple[str, dict]:
    """Its rate, noise and latency."""
    rate = float(random.choice([1.0, 2.0, 5.0, 10.0]))
    sigma = float(10.0 ** random.uniform(-1.7, 0.5))
    sigma_v = float(10.0 ** random.uniform(-1.5, -0.5)) if random.random() < 0.5 else None
    latency = float(random.choice([0.0, 0.05, 0.1, 0.2], p=[0.6, 0.15, 0.15, 0.1]))
    speed = "no velocity" if sigma_v is None else f"velocity {sigma_v:.2g} m/s"
    text = f"fixes {rate:g} Hz, {sigma:.2g} m, {speed}"
    text += f", {latency:g} s late" if latency else ""
    return text, {"gnss_rate": rate, "sigma": sigma, "sigma_v": sigma_v, "latency": latency}


def faulty(random: np.random.Generator, data: Record) -> tuple[list[str], Record]:
    """A record with none, one or several faults, none of them in its last minute."""
    last, texts = float(data.seconds[-1]), []
    if random.random() < 0.3:
        length = float(10.0 ** random.uniform(0.0, 2.1))
        begin = random.uniform(60.0, max(70.0, last - 60.0 - length))
        data = without_samples(data, begin, length)
        texts.append(f"IMU gap {begin:.0f}+{length:.1f} s")
    if random.random() < 0.3:
        length = random.uniform(10.0, 120.0)
        begin = random.uniform(60.0, max(70.0, last - 60.0 - length))
        data = without_fixes(data, [(begin, begin + length)])
        texts.append(f"outage {begin:.0f}+{length:.0f} s")
    if random.random() < 0.3:
        share, size = random.uniform(0.002, 0.05), float(10.0 ** random.uniform(1.0, 2.7))
        data = with_outliers(data, int(random.integers(1 << 30)), share, size)
        texts.append(f"{share:.1%} outliers of {size:.0f} m")
    if random.random() < 0.15:
        length = random.uniform(5.0, 60.0)
        begin = random.uniform(60.0, max(70.0, last - 60.0 - length))
        data = frozen(data, begin, length)
        texts.append(f"hangs {begin:.0f}+{length:.0f} s")
    if random.random() < 0.2:
        factor = float(10.0 ** random.uniform(-1.0, 1.0))
        data = replace(data, fixes=replace(data.fixes, sigma=factor * data.fixes.sigma))
        texts.append(f"claims {factor:.2g} of its noise")
    return texts, data


def begun(random: np.random.Generator, data: Record) -> tuple[str, Record]:
    """A record from somewhere in the motion on."""
    samples, fixes = random.uniform(30.0, 120.0), random.uniform(-10.0, 10.0)
    data = without_fixes(without_samples(data, -1.0, samples + 1.0), [(0.0, samples + fixes)])
    return f"begun at {samples:.1f} s, fixes {fixes:+.1f} s", data


def mounted(random: np.random.Generator, truth: Motion) -> tuple[list[str], Motion, np.ndarray]:
    """An IMU that is mounted any way, and the antenna's place in its axes."""
    if random.random() < 0.6:
        return [], truth, LEVER
    mount = any_mount(random)
    angles = mount.as_euler("ZYX", degrees=True)[::-1]
    text = "mounted " + ",".join(f"{angle:.0f}" for angle in angles)
    return [text], turned(truth, mount), mount.inv().apply(LEVER)


def worse(random: np.random.Generator, data: Record, seed: int) -> tuple[list[str], Motion, Record]:
    """A record with some of the errors of other instruments, of the size that its grade allows."""
    texts, errors = [], data.errors

    def drawn(share: float, text: str) -> bool:
        yes = bool(random.random() < share)
        texts.extend([text] * yes)
        return yes

    size = float(10.0 ** random.uniform(-0.5, 0.5))
    if errors in CHIPS.values():
        texts.append(f"axes {1e6 * errors.gyro_scale:.0f} ppm across")
        data = crossed(data, seed, errors.gyro_scale)
    elif drawn(0.3, f"axes {1e6 * size * errors.gyro_scale:.0f} ppm across"):
        data = crossed(data, seed, size * errors.gyro_scale)
    # Of a chip that nobody calibrated most of its bias has other reasons
    gyro, accel = min(errors.gyro_bias, CHANGES[0]), min(errors.accel_bias, CHANGES[1])
    if drawn(0.25, f"{size * gyro / DEGREE * 3600:.2g} deg/h/g"):
        data = g_sensitive(data, seed, size * gyro)
    time = random.uniform(60.0, 600.0)
    warms = f"warms up by {size * gyro / DEGREE * 3600:.2g} deg/h, {size * accel:.2g} m/s^2"
    if drawn(0.25, f"{warms} in {time:.0f} s"):
        data = warming(data, seed, size * gyro, size * accel, time)
    if drawn(0.25, f"shakes by {size:.2g} m/s^2"):
        data = shaken(data, seed, size, 0.02 * size)
    if random.random() < 0.3:
        every = int(random.choice([2, 4, 8]))
        texts.append(f"{200 // every} Hz")
        data = slower(data, every)
    if errors.gyro_scale > 5e-4 and drawn(0.4, "16 bits"):
        data = quantised(data, 1000.0 * DEGREE / 32768, 8.0 * 9.81 / 32768)
    if drawn(0.15, "0.5 % of samples lost"):
        data = with_lost(data, seed, 0.005)
    late = float(10.0 ** random.uniform(-3.5, -2.3))
    if drawn(0.2, f"stamped by receipt, {1e3 * late:.1f} ms"):
        data = received(data, seed, late)
    ratio, lasts = float(10.0 ** random.uniform(-0.5, 0.7)), random.uniform(20.0, 200.0)
    if drawn(0.3, f"fixes wander {ratio:.2g} of their noise in {lasts:.0f} s"):
        data = wandering(data, seed, ratio * data.fixes.sigma, lasts)
    off, honest = float(10.0 ** random.uniform(0.0, 1.5)), bool(random.random() < 0.5)
    if drawn(0.2, f"between houses {off:.0f} m off{', as said' * honest}"):
        data = streets(data, seed, off, honest)
    if drawn(0.15, f"fixes stamped by receipt, {10 * late:.2g} s"):
        data = unsteady_stamps(data, seed, 10 * late)
    if drawn(0.15, "fixes without covariance"):
        data = replace(data, fixes=replace(data.fixes, sigma=0.0))
    truth, rate = data.truth, 1e-6 * random.choice([-1, 1]) * random.uniform(5.0, 50.0)
    if drawn(0.15, f"clock fast by {1e6 * rate:.0f} ppm"):
        truth, data = drifting_clock(data, rate)
    return texts, truth, data


def settings(random: np.random.Generator, lever: np.ndarray = LEVER) -> list[str]:
    """Options, some of them wrong."""
    words: list[str] = []
    if random.random() < 0.3:
        arm = lever + random.standard_normal(3) * random.choice([0.5, 2.0])
        words += ["--lever-arm", ",".join(f"{x:.2f}" for x in arm)]
    if random.random() < 0.25:
        words += ["--imu-grade", str(random.choice(list(IMU_GRADES)))]
    if random.random() < 0.15:
        words += ["--gnss-latency", f"{random.choice([0.0, 0.1, 0.3]):g}"]
    if random.random() < 0.1:
        words += ["--gnss-lasting", f"{random.choice([0.1, 0.9]):g}"]
    if random.random() < 0.15:
        words += ["--filter", str(random.choice(["network-26a", "baro-24", "plain-15"]))]
    if random.random() < 0.3:
        words += ["--smooth"]
    return words


def harmless(words: list[str]) -> list[str]:
    """Those of random options that cannot be wrong."""
    smooth = [word for word in words if word == "--smooth"]
    k = words.index("--filter") if "--filter" in words else len(words)
    return [*words[k : k + 2], *smooth]


def hunted(
    seed: int,
    right: bool = False,
    others: Sequence[str] = (),
    errors: bool = False,
    options: bool = False,
    midway: bool = False,
) -> Outcome:
    """One log through the command, with random options, or without those that may be wrong."""
    random = np.random.default_rng([seed, 77])
    moving, truth = trajectory(random, others)
    grade = str(random.choice(list(SENSORS)))
    heard, fixes = receiver(random)
    instrument = np.random.default_rng([seed, 78])
    at, truth, lever = mounted(instrument, truth) if errors else ([], truth, LEVER)
    texts, data = faulty(random, record(truth, SENSORS[grade], seed, lever=lever, **fixes))
    words = settings(random, lever)
    words = harmless(words) if right else words
    if errors:
        more, truth, data = worse(instrument, data, seed)
        texts = [*texts, *at, *more]
        known = ["--lever-arm", ",".join(f"{x:.4f}" for x in lever)]
        words = words if "--lever-arm" in words else [*words, *known]
    if midway:
        text, data = begun(np.random.default_rng([seed, 80]), data)
        texts = [*texts, text]
    if options:
        words = [*words, *with_gnss(np.random.default_rng([seed, 79]), truth.c_nb[0])]
    what = "; ".join([moving, grade, heard, *texts, " ".join(words)])
    with tempfile.TemporaryDirectory() as folder:
        log = write(Path(folder) / f"{seed}.mcap", data)
        answer, status, note = process(log, truth, words)
    if answer is None:
        return Outcome(seed, what, status, note=note)
    level = np.hypot(answer.error[:, 0], answer.error[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        sigmas = level / np.hypot(answer.sigma[:, 0], answer.sigma[:, 1])
    far = np.where((level > FAR_M) | ~np.isfinite(level), sigmas, 0.0)
    worst = int(np.argmax(far)) if far.any() else int(np.nanargmax(sigmas))
    turn = answer.error[:, 6:] / DEGREE
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = answer.error[:, 6:] / answer.sigma[:, 6:]
    attitude = [
        float(np.sqrt(np.nanmean(np.square(values[:, axes]))))
        for axes in (slice(0, 2), slice(2, 3))
        for values in (turn, ratio)
    ]
    return Outcome(
        seed, what, status, *map(float, (level[-1], sigmas[-1], level[worst], sigmas[worst])), note,
        *attitude,
    )  # fmt: skip


def kept(work: Callable[[int], Outcome], file: Path, settings: dict, seed: int) -> Outcome:
    """One log's outcome, from the file if it has it with the same settings, else added to it."""
    if file.exists():
        for line in file.read_text().splitlines():
            known = json.loads(line)
            if known["settings"] == settings and known["outcome"]["seed"] == seed:
                return Outcome(**known["outcome"])
    outcome = work(seed)
    with file.open("a") as lines:
        lines.write(json.dumps({"settings": settings, "outcome": asdict(outcome)}) + "\n")
    return outcome


def main() -> None:
    options = parser(__doc__, logs=500, first=1, jobs=2)
    options.add_argument("--right", action="store_true", help="no options that are wrong")
    options.add_argument("--errors", action="store_true", help="of other instruments, too")
    options.add_argument("--options", action="store_true", help="one more option for each log")
    options.add_argument("--midway", action="store_true", help="logs begin in motion")
    options.add_argument("--only", type=int, help="this seed alone")
    options.add_argument("--others", nargs="*", choices=OTHERS, help="vehicles of other kinds")
    options.add_argument("--keep", type=Path, metavar="FILE", help="JSON lines to go on from")
    args = options.parse_args()
    others = () if args.others is None else args.others or USUAL_OTHERS
    seeds = range(args.first, args.first + args.logs) if args.only is None else [args.only]
    kinds = {"right": args.right, "others": [*others], "errors": args.errors}
    kinds |= {"options": args.options, "midway": args.midway}
    work: Callable[[int], Outcome] = partial(hunted, **kinds)
    if args.keep is not None:
        work = partial(kept, work, args.keep, kinds)
    outcomes = over_seeds(work, seeds, args.jobs)
    status = Counter(outcome.status for outcome in outcomes)
    solved = [outcome for outcome in outcomes if np.isfinite(outcome.end_m)]
    print(
        f"{len(outcomes)} logs: status"
        f" {', '.join(f'{key}: {status[key]}' for key in sorted(status))};"
        f" {len(solved)} solutions; beyond {FAR_M:g} m and {FAR_SIGMAS:g} sigmas with status 0:"
        f" {sum(o.missed for o in solved)} at the end, {sum(o.missed_anywhere for o in solved)}"
        " anywhere"
    )
    for outcome in outcomes:
        if outcome not in solved:
            print(f"no solution: {outcome.seed}: {outcome.what}: {outcome.note}")
    ends = np.array([outcome.end_m for outcome in solved])
    ratios = np.array([outcome.end_sigmas for outcome in solved])
    silent = np.array([0.0 if outcome.status else outcome.end_sigmas for outcome in solved])
    if len(solved):
        print(
            f"at the end: median {np.median(ends):.2g} m, 95 % {np.percentile(ends, 95.0):.2g} m;"
            f" {np.mean(ratios > 3.0):.1%} beyond 3 sigmas, {np.mean(ratios > 10.0):.1%} beyond 10;"
            f" {np.mean(silent > 3.0):.1%} and {np.mean(silent > 10.0):.1%} with status 0"
        )
        for name in ("tilt", "heading"):
            ratios = np.array([getattr(outcome, f"{name}_sigmas") for outcome in solved])
            silent = np.array([0.0 if o.status else getattr(o, f"{name}_sigmas") for o in solved])
            print(
                f"{name} over sigma: median {np.nanmedian(ratios):.2g}, {np.mean(ratios > 2.0):.1%}"
                f" beyond 2, {np.mean(ratios > 4.0):.1%} beyond 4; {np.mean(silent > 2.0):.1%} and"
                f" {np.mean(silent > 4.0):.1%} with status 0"
            )
    head = ["seed", "status", "end m", "sigmas", "worst m", "sigmas", "what", ""]
    for title, key in (("at the end", "end"), ("anywhere beyond 100 m", "most")):

        def rank(outcome: Outcome, key: str = key) -> tuple[bool, float]:
            missed = outcome.missed if key == "end" else outcome.missed_anywhere
            return missed, getattr(outcome, f"{key}_sigmas")

        worst = sorted(solved, key=rank, reverse=True)[:WORST]
        rows = (
            [o.seed, o.status, f"{o.end_m:.3g}", f"{o.end_sigmas:.3g}", f"{o.most_m:.3g}",
             f"{o.most_sigmas:.3g}", o.what, o.note]
            for o in worst
        )  # fmt: skip
        print_table(head, rows, f"\nthe worst {len(worst)} {title}")
    head = ["seed", "status", "tilt deg", "sigmas", "heading deg", "sigmas", "what", ""]
    worst = sorted(solved, key=lambda o: (not o.status, o.turned_sigmas), reverse=True)[:WORST]
    turned = (
        [o.seed, o.status, f"{o.tilt_deg:.2g}", f"{o.tilt_sigmas:.3g}", f"{o.heading_deg:.2g}",
         f"{o.heading_sigmas:.3g}", o.what, o.note]
        for o in worst
    )  # fmt: skip
    print_table(head, turned, f"\nthe worst {len(worst)} in attitude, those with status 0 first")


if __name__ == "__main__":
    main()
