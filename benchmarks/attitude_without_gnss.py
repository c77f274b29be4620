"""Roll and pitch without GNSS: the smoother beside integration alone, VQF and imufusion.

Simulated cars, drones, ships and hands, each with sensors of three grades: white noise, biases at
turn-on and wandering, scale factors and misalignment. Everything begins with the tilt and the gyro
bias of the first rest, where there is one, and with the true heading. Three motions are traps: they
are so smooth that they look like a rest. Of the kinds called "any" every size is drawn by the seed.

python benchmarks/attitude_without_gnss.py
python benchmarks/attitude_without_gnss.py --seeds 2 --kinds car ship --grades mems
python benchmarks/attitude_without_gnss.py --seeds 10 --first-seed 20 --kinds "any car" "any ship"
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from benchmarks.attitude_motions import KINDS, trajectory
from benchmarks.attitudes import imufusion, rms_deg, shares, vqf
from benchmarks.common import DEG_H, FloatArray, nees, numbers, parser, print_table
from sinstool.core.earth import earth_rate_n
from sinstool.core.rotation import (
    conjugate,
    from_euler,
    log,
    multiply,
    rotate,
    tilt_and_heading,
    to_euler,
)
from sinstool.core.streams import Imu, Solution, concatenate
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.attitude_smoother.epochs import Epochs, EpochStage
from sinstool.methods.attitude_smoother.model import sensor_model
from sinstool.methods.attitude_smoother.motion import Motion, find_motion
from sinstool.methods.attitude_smoother.rest import confirmed, with_rest
from sinstool.methods.attitude_smoother.smoother import smooth
from sinstool.methods.attitude_smoother.steady import with_steady
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.sensor_errors import SIMULATED_GRADES, Grade
from sinstool.methods.strapdown.attitude import AttitudeRun, AttitudeSettings
from sinstool.simulation.sensors import with_errors
from sinstool.simulation.truth import Trajectory

GRADES: tuple[Grade, ...] = ("mems", "tactical", "navigation")
# Beside a simulated grade's noise and biases: gyro bias at turn-on (rad/s), its wandering (rad/s),
# scale and misalignment of gyros and of accelerometers.
SENSORS = {
    grade: replace(
        SIMULATED_GRADES[grade],
        gyro_bias=bias,
        gyro_instability=wandering,
        bias_time_s=300.0,
        gyro_scale=matrix,
        gyro_misalignment=matrix,
        accel_scale=matrix,
        accel_misalignment=matrix,
    )
    for grade, bias, wandering, matrix in (
        ("mems", 3e-3, 5.0 * DEG_H, 2e-3),
        ("tactical", 1.0 * DEG_H, 0.3 * DEG_H, 3e-4),
        ("navigation", 0.01 * DEG_H, 0.002 * DEG_H, 1e-5),
    )
}
REST_S = 5.0  # at the beginning, that gives tilt and bias
GRAVITY_SHOWN_S = 1.0  # where there is none
LARGEST_SCATTER = 0.3  # m/s^2
LARGEST_TURN = 1e-5  # rad, by the truth: what sways, as a buoy does, does not show its bias


# Beyond these the verdict counts a tilt over that of integration, and a squared error over its
# covariance.
WORSE, FAR_OFF = 1.1, 2.0


@dataclass(frozen=True)
class Score:
    """Errors of an attitude, deg; squared errors over covariances of tilt, and shares.

    Attributes
    ----------
    tilt, largest, heading : float
        Root mean square and largest error of tilt, and standard deviation of heading's: what it
        is in the mean is given by the start.
    nees : float or None
        Of tilt, over its two degrees of freedom.
    within : ndarray, shape (3,), or None
        Shares of the axes' errors within 1, 2 and 2.5 sigma.
    """

    tilt: float
    largest: float
    heading: float
    nees: float | None = None
    within: FloatArray | None = None


def score(flight: Trajectory, q_nb: FloatArray, covariance: FloatArray | None = None) -> Score:
    """Errors of an attitude at the instants of the truth."""
    tilt, heading = tilt_and_heading(multiply(flight.imu.q_nb, conjugate(q_nb)))
    size = np.linalg.norm(tilt, axis=1)
    plain = (
        rms_deg(size),
        float(size.max() / DEGREE),
        float(np.unwrap(heading).std() / DEGREE),
    )
    if covariance is None:
        return Score(*plain)
    level = covariance[:, :2, :2]
    over = np.abs(tilt) / np.sqrt(np.einsum("nii->ni", level))
    within = np.array(shares(over, (1.0, 2.0, 2.5)))
    return Score(*plain, float(np.mean(nees(tilt, level))), within)


@dataclass(frozen=True)
class Begin:
    """First attitude and gyro bias, as a log shows them."""

    q_nb: FloatArray
    gyro_bias: FloatArray
    rested: bool
    walk: float | None


def begin(flight: Trajectory, gyro: FloatArray, accel: FloatArray) -> Begin:
    """Tilt and bias of the first seconds where they are at rest, else a rough tilt."""
    still = round(REST_S / float(np.mean(flight.imu.interval)))
    turned = multiply(flight.imu.q_nb[:still], conjugate(flight.imu.q_nb[0]))
    rested = bool(
        np.all(accel[:still].std(axis=0) < LARGEST_SCATTER)
        and np.all(np.abs(flight.velocity_n[:still]) < 0.5)
        and np.all(np.linalg.norm(log(turned), axis=1) < LARGEST_TURN)
    )
    count = still if rested else round(GRAVITY_SHOWN_S / float(np.mean(flight.imu.interval)))
    x, y, z = -accel[:count].mean(axis=0)
    heading = to_euler(flight.imu.q_nb[0])[2]
    q = from_euler(np.array([np.arctan2(y, z), np.arctan2(-x, np.hypot(y, z)), heading]))
    if not rested:
        return Begin(q, np.zeros(3), False, None)
    earth = rotate(conjugate(q), earth_rate_n(float(flight.latitude[0])))
    walk = gyro[:still].std(axis=0).mean() * np.sqrt(float(np.mean(flight.imu.interval)))
    return Begin(q, gyro[:still].mean(axis=0) - earth, True, float(walk))


def integrated(
    flight: Trajectory, gyro: FloatArray, accel: FloatArray, start: Begin
) -> list[Solution]:
    """Attitude by integration alone."""
    interval = float(np.mean(flight.imu.interval))
    settings = AttitudeSettings(
        algorithm=algorithm("previous-1"),
        gyro_kind="mean-rate",
        nominal_ns=interval * SECOND,
        max_gap_ns=60_000_000,
        gyro_bias=start.gyro_bias,
        omega_ie_n=np.asarray(earth_rate_n(float(flight.latitude[0]))),
    )
    run = AttitudeRun(start.q_nb, settings)
    return list(run.run([Imu(flight.time_ns, flight.time_ns, gyro, accel)]))


def smoothed(
    flight: Trajectory, alone: list[Solution], start: Begin, grade: Grade
) -> tuple[Solution, Motion, Epochs]:
    """The same attitude, smoothed; the motion it was taken for, and the epochs."""
    earth = np.asarray(earth_rate_n(float(flight.latitude[0])))
    stage = EpochStage(60_000_000, np.full(3, np.inf), omega_in_n=earth)
    for solution in alone:
        stage.push(solution)
    sensors = sensor_model(
        grade, walk_at_rest=start.walk, bias_known=start.rested, earth_removed=True
    )
    marked = with_rest(stage.finish())
    epochs = confirmed(marked, sensors)
    motion = find_motion(epochs, sensors)
    epochs = with_steady(epochs, marked.rest, motion.model, sensors)
    correction = smooth(epochs, motion.model, sensors)
    return concatenate([correction.apply(solution) for solution in alone]), motion, epochs


def others(imu: Imu) -> Iterator[tuple[str, FloatArray]]:
    """VQF, its offline variant and imufusion as they come; q_nb with a heading of their own."""
    yield "offline VQF", vqf(imu, True).q_nb
    yield "VQF", vqf(imu, False).q_nb
    yield "imufusion", imufusion(imu).q_nb


# Each grade flies the same ways
flown = lru_cache(maxsize=10)(trajectory)


@dataclass(frozen=True, eq=False)
class Cell:
    """One seed of a motion and a grade: the smoothed attitude and that of integration alone."""

    name: str
    smoothed: Score
    alone: Score

    @property
    def ratio(self) -> float:
        """Tilt of the smoothed attitude over that of integration."""
        return self.smoothed.tilt / self.alone.tilt


def rows(
    kind: str, grade: Grade, args: argparse.Namespace, cells: list[Cell]
) -> Iterator[tuple[str, ...]]:
    """Rows of the table: each method over all seeds; adds the cells."""
    found: dict[str, list[Score]] = {}
    notes: list[str] = []
    for seed in range(args.first_seed, args.first_seed + args.seeds):
        flight = flown(kind, seed, args.minutes or None)
        imu = with_errors(flight.imu, SENSORS[grade], seed + 1000)
        gyro, accel = imu.gyro_mean_rate, imu.mean_specific_force
        start = begin(flight, gyro, accel)
        alone = integrated(flight, gyro, accel, start)
        after, motion, epochs = smoothed(flight, alone, start, grade)
        margin = "" if motion.margin is None else f" {motion.margin:.1f}"
        notes.append(
            f"{motion.model.name} {motion.model.density:.2g}{margin} r{epochs.rest.mean():.2f}"
        )
        one = score(flight, after.q_nb, after.covariance_attitude_n)
        found.setdefault("smoother", []).append(one)
        plain = score(flight, concatenate(alone).q_nb)
        found.setdefault("integration", []).append(plain)
        if args.others:
            for name, q in others(Imu(flight.time_ns, flight.time_ns, gyro, accel)):
                found.setdefault(name, []).append(score(flight, q))
        cells.append(Cell(f"{kind} {grade} {seed}", one, plain))
        if args.each:
            each = numbers([one.tilt, plain.tilt, one.heading, plain.heading, one.nees], ".4f")
            print(f"    {cells[-1].name}: {each} {notes[-1]}", flush=True)
    for name, scores in found.items():
        ours = name in ("smoother", "integration")
        yield (
            kind,
            grade,
            name,
            f"{np.sqrt(np.mean([s.tilt**2 for s in scores])):.4f}",
            f"{np.mean([s.largest for s in scores]):.3f}",
            f"{np.sqrt(np.mean([s.heading**2 for s in scores])):.3f}" if ours else "",
            numbers([s.nees for s in scores], ".2f") if name == "smoother" else "",
            numbers(np.mean([s.within for s in scores], axis=0), ".3f")
            if name == "smoother"
            else "",
            "; ".join(notes) if name == "smoother" else "",
        )


HEAD = (
    "motion", "sensors", "attitude by", "tilt RMS deg", "largest", "heading std",
    "NEES of tilt, each seed", "within 1, 2, 2.5 sigma", "class, density, margin, rest",
)  # fmt: skip


def verdict(cells: list[Cell]) -> None:
    """Print how many cells are worse than integration, and how many beyond their sigmas."""
    worse = [one for one in cells if one.ratio > WORSE]
    unsure = [one for one in cells if (one.smoothed.nees or 0.0) > FAR_OFF]
    print(
        f"\n{len(cells)} cells: {len(worse)} worse than integration by more than"
        f" {WORSE - 1.0:.0%}, {len(unsure)} with a NEES above {FAR_OFF:g}"
    )
    for one in sorted({*worse, *unsure}, key=lambda one: one.name):
        print(
            f"    {one.name}: {one.smoothed.tilt:.4f} deg, integration {one.alone.tilt:.4f},"
            f" NEES {one.smoothed.nees:.2f}"
        )


def main() -> None:
    options = parser(__doc__, seeds=4, first_seed=0, minutes=0.0)
    options.add_argument(
        "--kinds",
        nargs="+",
        choices=KINDS,
        default=[kind for kind in KINDS if not kind.startswith("any ")],
    )
    options.add_argument("--grades", nargs="+", choices=GRADES, default=list(GRADES))
    options.add_argument("--alone", dest="others", action="store_false", help="no other packages")
    options.add_argument("--each", action="store_true", help="a line for each seed")
    args = options.parse_args()
    cells: list[Cell] = []
    print_table(
        HEAD,
        (
            row
            for kind in args.kinds
            for grade in args.grades
            for row in rows(kind, grade, args, cells)
        ),
    )
    verdict(cells)


if __name__ == "__main__":
    main()
