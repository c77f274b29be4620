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
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from benchmarks.common import (
    ARCSEC,
    DEG_H,
    DEG_SQRT_H,
    UG,
    compensated,
    nees,
    numbers,
    off_by,
    parser,
    rms,
    standard_error,
    state_errors,
)
from sinstool.methods.height.network import HeightNetwork
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.settings import (
    BaroModel,
    DivergenceControl,
    GnssModel,
    Settings,
    Start,
)
from sinstool.methods.ins_gnss.smoother import Smoother, corrected_navigation
from sinstool.methods.sensor_errors import SensorGrade
from sinstool.simulation.flight import spiral_climb
from sinstool.simulation.gnss import MODELS, GnssFaults, Receiver, gnss_samples, true_moments
from sinstool.simulation.moments import Moments
from sinstool.simulation.sensors import barometer, with_errors
from sinstool.simulation.truth import Trajectory
from tests.helpers.filter_start import start
from tests.helpers.gnss import epochs

SENSORS = SensorGrade(
    angle_random_walk=0.005 * DEG_SQRT_H,
    gyro_bias=0.05 * DEG_H,
    velocity_random_walk=10.0 * UG,
    accel_bias=50.0 * UG,
    accel_scale=50e-6,
)
SIGMAS = (5.0, 0.1, 30.0 * ARCSEC, 180.0 * ARCSEC)  # position, velocity, level, heading
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


def begin(flight: Trajectory, random: np.random.Generator) -> Start:
    """A start that is off as its covariance says."""
    position, velocity, level, heading = SIGMAS
    attitude = np.array([level, level, heading])
    first, second = position * random.standard_normal(3), velocity * random.standard_normal(3)
    state = off_by(flight, first, second, attitude * random.standard_normal(3))
    return start(*state, position, velocity, attitude)


def run(
    flight: Trajectory,
    truth: Moments,
    name: str,
    seed: int,
    into: Errors,
    args: argparse.Namespace,
) -> None:
    random = np.random.default_rng([seed, 7])
    imu = with_errors(flight.imu, SENSORS, seed)
    increments = compensated(
        flight.time_ns, imu.gyro_mean_rate, imu.mean_specific_force, 1.0 / args.rate
    )
    faults = GnssFaults(outages=tuple((t, t + OUTAGE) for t in OUTAGES))
    receiver = Receiver(1.0, 0.0, errors=MODELS["coloured"], faults=faults)
    gnss = epochs(gnss_samples(flight, receiver, seed, truth))
    every = round(args.rate / args.baro_rate)
    baro_ns = flight.time_ns[every::every]
    baro, _ = barometer(baro_ns, flight.height[every::every], seed=seed)
    settings = Settings(
        filter=name,
        imu=SENSORS,
        gnss=GnssModel(),
        baro=BaroModel(),
        network=HeightNetwork(args.tau, args.k4) if name != "baro-24" else None,
        grade="navigation",
        control=DivergenceControl(virtual_noise=args.virtual_noise),
    )
    tic = time.perf_counter()
    ran = InsGnssFilter(begin(flight, random), settings, with_baro=True, output=True, store=True)
    with Smoother(ran.kind, args.memory << 20) as smoother:
        block = ran.push(increments, gnss, None, baro_ns, baro)
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
        before = state_errors(flight, rows, stored.nav)
        nav = corrected_navigation(stored.nav, stored.estimate + smoothed.error)
        after = state_errors(flight, rows, nav)
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
        for ratios, variance, p, e in (
            (into.nees_filter, into.variance_filter, plus, before),
            (into.nees_smooth, into.variance_smooth, smoothed.covariance[:, :9, :9], after),
        ):
            variance.append(np.diagonal(p[late], axis1=1, axis2=2))
            ratios.append(float(np.mean(nees(e[late, :6], p[late][:, :6, :6]))))
    if args.verbose:
        print(f"  {name} seed {seed}: {ran.summary.restarts} restarts", flush=True)


def row(label: str, values: Iterable[float], published: Iterable[float] | None = None) -> None:
    text = f"{label:22s}{numbers(values, '9.3f', '')}"
    print(text if published is None else f"{text}   expected{numbers(published, '8.3f', '')}")


def shown(values: np.ndarray) -> tuple[float, ...]:
    """Of nine errors those that are printed; heading in arc seconds."""
    return (*values[[0, 1, 2, 5]], values[8] / ARCSEC)


def table(name: str, errors: Errors) -> None:
    def sigma(variances: list[np.ndarray]) -> tuple[float, ...]:
        return shown(np.sqrt(np.mean(np.concatenate(variances), axis=0)))

    before, after, outage = EXPECTED[name]
    print(f"\n{name}" + " " * (22 - len(name)) + "    N m      E m      U m   V_U m/s   heading ''")
    row("filter", shown(rms(errors.filter)), before)
    row("  standard error", shown(standard_error(errors.filter)))
    row("  its sigma", sigma(errors.variance_filter))
    row("smoother", shown(rms(errors.smooth)), after)
    row("  standard error", shown(standard_error(errors.smooth)))
    row("  its sigma", sigma(errors.variance_smooth))
    if errors.outage_filter:
        row("in outages, filter", np.mean(errors.outage_filter, axis=0)[:3])
        row("in outages, smoother", np.mean(errors.outage_smooth, axis=0)[:3], outage)
    row("NEES/6 filter, smooth", (np.mean(errors.nees_filter), np.mean(errors.nees_smooth)))
    print(f"filter {errors.filter_s:.2f} s, smoother {errors.smooth_s:.2f} s, all runs together")


def main() -> None:
    options = parser(__doc__, runs=8, minutes=60.0, rate=128.0, baro_rate=8.0, tau=2.4, k4=0.5)
    options.add_argument("--filters", nargs="+", default=list(EXPECTED))
    options.add_argument("--virtual-noise", action="store_true")
    options.add_argument("--memory", type=int, default=256, help="MB before files are used")
    options.add_argument("--verbose", action="store_true")
    args = options.parse_args()
    flight = spiral_climb(60.0 * args.minutes, args.rate)
    truth = true_moments(flight, Receiver(1.0, 0.0))
    for name in args.filters:
        errors = Errors()
        for seed in range(args.runs):
            run(flight, truth, name, seed, errors, args)
        table(name, errors)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(f"\npeak memory of the process {peak:.0f} MB, truth and sensors included")


if __name__ == "__main__":
    main()
