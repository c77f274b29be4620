"""What smoothing is worth: a climbing spiral of an hour with outages of GNSS, many times.

Root mean squares of filter and smoother over all runs from two minutes on, outages left out, at the
seconds, with their standard error as runs differ; the largest error within the five outages of a
minute (mean over the outages); and whether the covariances are true: sigma as the covariance
says, which is the RMS of very many runs, and the error of position and velocity, normalised by its
covariance and squared, by 6, which should be 1. Within an hour barometer and heading have few
independent errors: RMS of height and heading differ much from run to run. Beside them the figures
of an independent simulation of 8 runs, whose standard errors are 1.7 times those of 24.

python benchmarks/smoother_monte_carlo.py
python benchmarks/smoother_monte_carlo.py --runs 2 --minutes 20 --filters baro-24
"""

from __future__ import annotations

import argparse
import resource
import time
from dataclasses import dataclass, field

import numpy as np

from sinstool.core import earth
from sinstool.core.rotation import conjugate, exp, log, multiply
from sinstool.core.streams import GnssEpochs
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.stage import ConingStage
from sinstool.methods.height.network import HeightNetwork
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.noise import BaroModel, GnssModel, ImuNoise
from sinstool.methods.ins_gnss.settings import DivergenceControl, Settings, start
from sinstool.methods.ins_gnss.smoother import Smoother
from sinstool.methods.strapdown.velocity import Increments, IncrementStage
from sinstool.simulation.barometer import barometer
from sinstool.simulation.flight import spiral_climb
from sinstool.simulation.gnss import MODELS, GnssFaults, Receiver, gnss_samples, true_moments
from sinstool.simulation.sensors import SensorGrade, with_errors
from sinstool.simulation.trajectory import Trajectory

DEG_PER_H = np.deg2rad(1.0) / 3600.0
ARC_SECOND = np.deg2rad(1.0) / 3600.0
UG = 9.80665e-6
SENSORS = SensorGrade(
    0.005 * np.deg2rad(1.0) / 60.0, 0.05 * DEG_PER_H, 10.0 * UG, 50.0 * UG, accel_scale=50e-6
)
NOISE = ImuNoise(
    SENSORS.angle_random_walk,
    SENSORS.velocity_random_walk,
    SENSORS.gyro_bias,
    SENSORS.accel_bias,
    accel_scale=SENSORS.accel_scale,
)
SIGMAS = (5.0, 0.1, 30.0 * ARC_SECOND, 180.0 * ARC_SECOND)  # position, velocity, level, heading
OUTAGE = 60.0
OUTAGES = (600.0, 1200.0, 1800.0, 2400.0, 3000.0)
SETTLED = 120.0

# filter -> north/east, U, V_U, heading '' in the filter and smoothed; in outages N, E, U
EXPECTED = {
    "network-26": (
        (4.96, 4.79, 5.27, 0.121, 108.0),
        (3.82, 3.59, 4.96, 0.102, 62.0),
        (3.6, 3.8, 8.4),
    ),
    "network-26a": (
        (4.96, 4.79, 5.18, 0.031, 108.0),
        (3.82, 3.59, 3.60, 0.016, 62.0),
        (3.6, 3.8, 3.7),
    ),
    "baro-24": ((4.96, 4.79, 5.01, 0.024, 108.0), (3.82, 3.59, 2.38, 0.005, 62.0), (3.6, 3.8, 2.1)),
}


@dataclass
class Errors:
    """Errors of many runs, rows (north, east, up, v_north, v_east, v_up, psi N E D)."""

    filter: list[np.ndarray] = field(default_factory=list)
    smooth: list[np.ndarray] = field(default_factory=list)
    outage_filter: list[np.ndarray] = field(default_factory=list)
    outage_smooth: list[np.ndarray] = field(default_factory=list)
    variance_filter: list[np.ndarray] = field(default_factory=list)
    variance_smooth: list[np.ndarray] = field(default_factory=list)
    nees_filter: list[float] = field(default_factory=list)
    nees_smooth: list[float] = field(default_factory=list)
    filter_s: float = 0.0
    smooth_s: float = 0.0


def increments(time_ns, gyro, accel, step: float) -> Increments:
    """Compensated increments of mean rates."""
    stage = IncrementStage(
        lambda: ConingStage(algorithm("previous-1"), "mean-rate", nominal_interval=step)
    )
    parts = [stage.push(gyro, accel, time_ns), stage.finish()]
    return Increments(
        *(np.concatenate([getattr(p, c) for p in parts]) for c in Increments.__dataclass_fields__)
    )


def epochs(samples) -> GnssEpochs:
    """Fixes of the simulation, which say nothing of their noise."""
    nothing = np.full_like(samples.velocity_n, np.nan)
    return GnssEpochs(
        samples.time_ns,
        samples.time_ns,
        samples.latitude,
        samples.longitude,
        samples.height,
        samples.velocity_n,
        nothing,
        nothing,
    )


def begin(flight: Trajectory, random: np.random.Generator):
    """A start that is off as its covariance says."""
    p, v, level, heading = SIGMAS
    meridian, transverse = earth.radii_of_curvature(flight.latitude[0])
    dp, dv = p * random.standard_normal(3), v * random.standard_normal(3)
    psi = np.array([level, level, heading]) * random.standard_normal(3)
    h = flight.height[0]
    return start(
        flight.latitude[0] + dp[0] / (meridian + h),
        flight.longitude[0] + dp[1] / ((transverse + h) * np.cos(flight.latitude[0])),
        h - dp[2],
        flight.velocity_n[0] + dv,
        multiply(exp(-psi), flight.imu.q_nb[0]),
        p,
        v,
        np.array([level, level, heading]),
    )


def errors(flight: Trajectory, rows, nav) -> np.ndarray:
    """Navigation less truth, shape (n, 9); psi of attitude."""
    meridian, transverse = earth.radii_of_curvature(flight.latitude[rows])
    h = flight.height[rows]
    return np.column_stack(
        [
            (nav[:, 0] - flight.latitude[rows]) * (meridian + h),
            (nav[:, 1] - flight.longitude[rows]) * (transverse + h) * np.cos(flight.latitude[rows]),
            h - nav[:, 2],
            nav[:, 3:6] - flight.velocity_n[rows],
            log(multiply(flight.imu.q_nb[rows], conjugate(nav[:, 6:10]))),
        ]
    )


def run(flight: Trajectory, truth, name: str, seed: int, into: Errors, args) -> None:
    random = np.random.default_rng([seed, 7])
    imu = with_errors(flight.imu, SENSORS, seed)
    step = 1.0 / args.rate
    incs = increments(flight.time_ns, imu.gyro_mean_rate, imu.mean_specific_force, step)
    faults = GnssFaults(outages=tuple((t, t + OUTAGE) for t in OUTAGES))
    receiver = Receiver(1.0, 0.0, errors=MODELS["coloured"], faults=faults)
    gnss = epochs(gnss_samples(flight, receiver, seed, truth))
    every = round(args.rate / args.baro_rate)
    baro_ns = flight.time_ns[every::every]
    baro, _ = barometer(baro_ns, flight.height[every::every], seed=seed)
    settings = Settings(
        filter=name,
        imu=NOISE,
        gnss=GnssModel(),
        baro=BaroModel(),
        network=HeightNetwork(args.tau, args.k4) if name != "baro-24" else None,
        grade="navigation",
        control=DivergenceControl(virtual_noise=args.virtual_noise),
    )
    tic = time.perf_counter()
    ran = InsGnssFilter(begin(flight, random), settings, with_baro=True, output=True, store=True)
    with Smoother(ran.kind, args.memory << 20) as smoother:
        block = ran.push(incs, gnss, None, baro_ns, baro)
        into.filter_s += time.perf_counter() - tic
        stored = block.stored
        plus = np.array(stored.covariance_after[:, :9, :9])
        tic = time.perf_counter()
        smoother.push(block)
        smoothed = smoother.epochs()
        for _ in smoother.blocks(smoothed):
            pass
        into.smooth_s += time.perf_counter() - tic
        seconds = (stored.time_ns - flight.time_ns[0]) * 1e-9
        rows = stored.update + 1
        before = errors(flight, rows, stored.nav)
        after = errors(flight, rows, smoothed.nav)
        late = seconds > SETTLED
        for t in OUTAGES:
            late &= (seconds < t) | (seconds > t + OUTAGE)
        into.filter.append(before[late])
        into.smooth.append(after[late])
        for t in OUTAGES:
            inside = (seconds >= t) & (seconds <= t + OUTAGE)
            if np.any(inside):
                into.outage_filter.append(np.abs(before[inside]).max(axis=0))
                into.outage_smooth.append(np.abs(after[inside]).max(axis=0))
        for found, variance, p, e in (
            (into.nees_filter, into.variance_filter, plus, before),
            (into.nees_smooth, into.variance_smooth, smoothed.covariance[:, :9, :9], after),
        ):
            variance.append(np.diagonal(p[late], axis1=1, axis2=2))
            x = np.linalg.solve(p[late][:, :6, :6], e[late, :6, None])[:, :, 0]
            found.append(float(np.mean(np.sum(x * e[late, :6], axis=1)) / 6.0))
    if args.verbose:
        print(f"  {name} seed {seed}: {ran.summary.restarts} restarts", flush=True)


def row(label: str, values, wanted=None) -> None:
    text = f"{label:22s}" + "".join(f"{v:9.3f}" for v in values)
    if wanted is not None:
        text += "   expected" + "".join(f"{w:8.3f}" for w in wanted)
    print(text)


def table(name: str, found: Errors) -> None:
    def figures(parts, power=2):
        rms = np.sqrt(np.mean(np.concatenate(parts) ** power, axis=0))
        return rms[0], rms[1], rms[2], rms[5], rms[8] / ARC_SECOND

    def scatter(parts):
        squares = np.array([np.mean(e**2, axis=0) for e in parts])
        spread = squares.std(axis=0, ddof=1) if len(parts) > 1 else np.full(9, np.nan)
        error = spread / np.sqrt(len(parts)) / (2.0 * np.sqrt(squares.mean(axis=0)))
        return error[0], error[1], error[2], error[5], error[8] / ARC_SECOND

    before, after, outage = EXPECTED[name]
    print(f"\n{name}" + " " * (22 - len(name)) + "    N m      E m      U m   V_U m/s   heading ''")
    row("filter", figures(found.filter), before)
    row("  standard error", scatter(found.filter))
    row("  its sigma", figures(found.variance_filter, 1))
    row("smoother", figures(found.smooth), after)
    row("  standard error", scatter(found.smooth))
    row("  its sigma", figures(found.variance_smooth, 1))
    if found.outage_filter:
        row("in outages, filter", np.mean(found.outage_filter, axis=0)[:3])
        row("in outages, smoother", np.mean(found.outage_smooth, axis=0)[:3], outage)
    row("NEES/6 filter, smooth", (np.mean(found.nees_filter), np.mean(found.nees_smooth)))
    print(f"filter {found.filter_s:.2f} s, smoother {found.smooth_s:.2f} s, all runs together")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=8)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=128.0)
    parser.add_argument("--baro-rate", type=float, default=8.0)
    parser.add_argument("--tau", type=float, default=2.4)
    parser.add_argument("--k4", type=float, default=0.5)
    parser.add_argument("--filters", nargs="+", default=list(EXPECTED))
    parser.add_argument("--virtual-noise", action="store_true")
    parser.add_argument("--memory", type=int, default=256, help="MB before files are used")
    parser.add_argument("--verbose", action="store_true")
    args = parser.parse_args()
    flight = spiral_climb(60.0 * args.minutes, args.rate)
    truth = true_moments(flight, Receiver(1.0, 0.0))
    for name in args.filters:
        found = Errors()
        for seed in range(args.runs):
            run(flight, truth, name, seed, found, args)
        table(name, found)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(f"\npeak memory of the process {peak:.0f} MB, truth and sensors included")


if __name__ == "__main__":
    main()
