"""The INS/GNSS filters over many simulated flights: errors, and whether they know them.

python benchmarks/ins_gnss_monte_carlo.py                      # all three tables
python benchmarks/ins_gnss_monte_carlo.py --tables spiral --runs 8 --processes 1

`spiral`: a slow climb in wide circles for an hour with a navigation grade IMU, fixes every second
but for five gaps of a minute, a wandering barometer. `manoeuvres`: half an hour of turns, climbs
and dives with a MEMS. `faults`: the spiral with a fix, a sensor or a receiver that goes wrong, by
what is done against divergence. Where an independent simulation of the same filters had a
number, it stands in brackets.

Errors are those at whole seconds, after the fix, gaps left out; the ends of gaps are a second
before the next fix. In the column "all updates" is all time between.
NEES/n is the normalised square of the errors of all n states, which is 1 for a filter that knows
its errors; NIS/6 that of the innovations.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Any

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
    over_seeds,
    parser,
    print_table,
    rms,
    rows_of,
    standard_error,
    state_errors,
)
from sinstool.core import earth
from sinstool.core.streams import GnssEpochs
from sinstool.core.units import DEGREE
from sinstool.methods.height.network import HeightNetwork, gravity_gradient
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.results import FilterBlock, UpdateColumns
from sinstool.methods.ins_gnss.settings import (
    BaroModel,
    DivergenceControl,
    GnssModel,
    Settings,
    Start,
)
from sinstool.methods.ins_gnss.states import ACCEL_SCALE, filter_kind
from sinstool.methods.sensor_errors import SensorGrade
from sinstool.methods.strapdown.velocity import Increments
from sinstool.simulation.flight import manoeuvring_flight, spiral_climb
from sinstool.simulation.sensors import barometer, markov
from sinstool.simulation.truth import Trajectory
from tests.helpers.filter_start import start

GNSS = GnssModel()
BLOCK = 60  # s that are filtered at a time

# Sensors, barometer and start of the two flights
SPIRAL_IMU = SensorGrade(
    angle_random_walk=0.005 * DEG_SQRT_H,
    velocity_random_walk=10.0 * UG,
    gyro_bias=0.05 * DEG_H,
    accel_bias=50.0 * UG,
    accel_scale=50e-6,
)
SPIRAL_BARO = BaroModel(10.0, 500.0, 0.0)
SPIRAL_ATTITUDE = np.array([30.0, 30.0, 180.0]) * ARCSEC
MEMS_IMU = SensorGrade(
    angle_random_walk=0.3 * DEG_SQRT_H,
    velocity_random_walk=150.0 * UG,
    gyro_bias=5.0 * DEG_H,
    accel_bias=2000.0 * UG,
    accel_scale=1e-4,
)
MEMS_BARO = BaroModel(3.0, 300.0, 0.2)
# of a receiver less noisy than that of the spiral: which one the numbers in brackets are of is
# not known
MEMS_GNSS = GNSS.scaled(0.42, 0.45)
MEMS_ATTITUDE = np.array([0.2, 0.2, 1.0]) * DEGREE
GAPS = ((600.0, 660.0), (1200.0, 1260.0), (1800.0, 1860.0), (2400.0, 2460.0), (3000.0, 3060.0))


@dataclass(frozen=True)
class Scene:
    """A flight, its sensors, and what goes wrong."""

    flight: Trajectory
    imu: SensorGrade
    baro: BaroModel
    baro_every: int
    attitude: np.ndarray
    receiver: GnssModel = GNSS
    gaps: tuple[tuple[float, float], ...] = ()
    bias_step: tuple[float, float, float] | None = None  # time, gyro rad/s, accelerometer m/s^2
    # from, to, factor of white noise of positions, and of velocities
    noise_times: tuple[float, float, float, float] | None = None
    jump: tuple[float, float, float] | None = None  # from, to, m north


@dataclass(frozen=True)
class Data:
    """One run's samples and the true values of all that a filter estimates."""

    start: Start
    increments: Increments
    gnss: GnssEpochs
    baro_time_ns: np.ndarray
    baro_height: np.ndarray
    gyro_bias: np.ndarray  # (n, 3) at the updates
    accel_bias: np.ndarray
    accel_scale: np.ndarray  # (3,)
    baro_error: np.ndarray  # (n,) at the updates
    gnss_errors: np.ndarray  # (seconds, 6)


def in_gaps(scene: Scene, seconds: np.ndarray) -> np.ndarray:
    """Which instants lie in a gap of GNSS."""
    out = np.zeros(len(seconds), dtype=bool)
    for begin, end in scene.gaps:
        out |= (seconds >= begin) & (seconds < end)
    return out


def simulate(scene: Scene, seed: int) -> Data:
    """Samples of one run."""
    random = np.random.default_rng(seed)
    flight, imu, noise = scene.flight, scene.flight.imu, scene.imu
    n = len(imu.time_ns)
    dt = float(imu.interval[1])
    gyro_bias = np.tile(noise.gyro_bias * random.standard_normal(3), (n, 1))
    accel_bias = np.tile(noise.accel_bias * random.standard_normal(3), (n, 1))
    scale = noise.accel_scale * random.standard_normal(3)
    white_gyro = noise.angle_random_walk / np.sqrt(dt) * random.standard_normal((n, 3))
    white_accel = noise.velocity_random_walk / np.sqrt(dt) * random.standard_normal((n, 3))
    receiver = scene.receiver
    elapsed = (imu.time_ns - imu.time_ns[0]) * 1e-9
    if scene.bias_step is not None:
        when, gyro_step, accel_step = scene.bias_step
        gyro_bias[elapsed > when] += gyro_step
        accel_bias[elapsed > when] += accel_step
    increments = compensated(
        imu.time_ns,
        imu.gyro_mean_rate + gyro_bias + white_gyro,
        imu.mean_specific_force * (1.0 + scale) + accel_bias + white_accel,
        imu.interval[0],
    )

    rate = round(1.0 / dt)
    at = np.arange(rate, n, rate)
    seconds = len(at)
    slow = np.hstack(
        [
            np.asarray(receiver.position_markov)
            * markov(seconds, 1.0, receiver.position_time, random, 3),
            np.asarray(receiver.velocity_markov)
            * markov(seconds, 1.0, receiver.velocity_time, random, 3),
        ]
    )
    white = np.array([*receiver.position_white, *receiver.velocity_white]) * random.standard_normal(
        (seconds, 6)
    )
    after = elapsed[at]
    if scene.noise_times is not None:
        begin, end, *factors = scene.noise_times
        white[(after >= begin) & (after < end)] *= np.repeat(factors, 3)
    error = slow + white
    if scene.jump is not None:
        begin, end, size = scene.jump
        error[(after >= begin) & (after < end), 0] += size
    meridian, transverse = earth.radii_of_curvature(flight.latitude[at])
    h = flight.height[at]
    nothing = np.full((seconds, 3), np.nan)
    fixes = GnssEpochs(
        imu.time_ns[at],
        imu.time_ns[at],
        flight.latitude[at] + error[:, 0] / (meridian + h),
        flight.longitude[at] + error[:, 1] / ((transverse + h) * np.cos(flight.latitude[at])),
        h - error[:, 2],
        flight.velocity_n[at] + error[:, 3:],
        nothing,
        nothing,
    )
    received = ~in_gaps(scene, after)

    every = np.arange(scene.baro_every, n, scene.baro_every)
    seed_baro = int(random.integers(1 << 31))
    _, wander = barometer(
        imu.time_ns,
        flight.height,
        sigma=scene.baro.sigma,
        correlation_time=scene.baro.correlation_time,
        seed=seed_baro,
    )
    heights = flight.height + wander
    heights = heights[every] + scene.baro.white * random.standard_normal(len(every))

    first = random.standard_normal(9)
    state = off_by(flight, 5.0 * first[:3], 0.1 * first[3:6], scene.attitude * first[6:])
    return Data(
        start(*state, 5.0, 0.1, scene.attitude),
        increments,
        fixes.rows(received),
        imu.time_ns[every],
        heights,
        gyro_bias[1:],
        accel_bias[1:],
        scale,
        wander[1:],
        slow,
    )


@dataclass
class Score:
    """Of one filter over one run."""

    errors: np.ndarray  # (seconds, 9) position, velocity, attitude every second
    nees: np.ndarray
    nees_position: np.ndarray
    nis: np.ndarray
    gap_ends: np.ndarray  # (gaps, 9)
    v_up_between: np.ndarray  # (many,) of vertical velocity at updates of any phase
    variances: np.ndarray  # (seconds, 9) as the covariance has them
    restarts: int = 0
    spent: float = 0.0


def run_in_blocks(run: InsGnssFilter, data: Data, size: int) -> Iterator[tuple[int, FilterBlock]]:
    """Feed a filter so many updates at a time; the first update of each block, and the block."""
    fix = baro = 0
    for k in range(0, len(data.increments.interval), size):
        part = rows_of(data.increments, slice(k, k + size))
        last = part.time_ns[-1]
        next_fix = int(np.searchsorted(data.gnss.time_ns, last, side="right"))
        next_baro = int(np.searchsorted(data.baro_time_ns, last, side="right"))
        heights = slice(baro, next_baro)
        yield (
            k,
            run.push(
                part,
                data.gnss.rows(slice(fix, next_fix)),
                None,
                data.baro_time_ns[heights],
                data.baro_height[heights],
            ),
        )
        fix, baro = next_fix, next_baro


def navigation(updates: UpdateColumns) -> np.ndarray:
    """Position, velocity and attitude, as :func:`state_errors` takes them."""
    u = updates
    return np.column_stack([u.latitude, u.longitude, u.height, u.velocity_n, u.q_nb])


def score(
    scene: Scene,
    data: Data,
    settings: Settings,
    *,
    knows_k4: bool = True,
    settle: float = 120.0,
    score_states: bool = True,
) -> Score:
    """Run a filter over a run's samples."""
    flight = scene.flight
    run = InsGnssFilter(data.start, settings, with_baro=True, store=score_states)
    if not knows_k4:
        run._model.k4 = 0.0
    rate = round(1.0 / float(data.increments.interval[0]))
    errors, normalised, nees_position, nis, ends, between = [], [], [], [], [], []
    variances = []
    begun = time.perf_counter()
    gap_rows = np.array([int((end - 1.0) * rate) - 1 for _, end in scene.gaps], dtype=np.int64)
    for k, block in run_in_blocks(run, data, BLOCK * rate):
        u = block.updates
        assert u is not None
        rows = np.arange(rate - 1, len(u), rate)
        nav = navigation(u)
        errors.append(state_errors(flight, k + rows + 1, nav[rows]))
        blocks = (u.covariance_position_n, u.covariance_velocity_n, u.covariance_attitude_n)
        variances.append(np.hstack([np.diagonal(b[rows], axis1=1, axis2=2) for b in blocks]))
        many = np.arange(3, len(u), 7)
        between.append(u.velocity_n[many, 2] - flight.velocity_n[k + many + 1, 2])
        inside = gap_rows[(gap_rows >= k) & (gap_rows < k + len(u))]
        ends.append(state_errors(flight, inside + 1, nav[inside - k]))
        nis.append((block.gnss.nis / block.gnss.rows)[block.gnss.used])
        if score_states:
            stored = block.stored
            assert stored is not None
            e = full_errors(scene, data, run, stored, rate)
            seconds = (stored.time_ns - flight.time_ns[0]) * 1e-9
            late = seconds > settle
            normalised.append(nees(e[late], stored.covariance_after[late]))
            nees_position.append(nees(e[late, :3], stored.covariance_after[late][:, :3, :3]))
    after = 1.0 + np.arange(sum(len(e) for e in errors))
    outside = (after > settle) & ~in_gaps(scene, after)
    return Score(
        np.concatenate(errors)[outside],
        np.concatenate(normalised or [np.empty(0)]),
        np.concatenate(nees_position or [np.empty(0)]),
        np.concatenate(nis)[int(settle) :],
        np.concatenate(ends),
        np.concatenate(between)[int(settle) * rate // 7 :],
        np.concatenate(variances)[outside],
        run.summary.restarts,
        time.perf_counter() - begun,
    )


def full_errors(scene, data, run, stored, rate) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Errors of all states of a filter at its stored rows, shape (m, n)."""
    at = stored.update
    second = np.clip((at + 1) // rate - 1, 0, len(data.gnss_errors) - 1)
    sensors = stored.sensors
    offset = run.summary.channel.offset
    accel_bias = data.accel_bias[at]
    if ACCEL_SCALE not in run.kind.states:
        # for a filter without scale factors, what they do is a bias
        accel_bias = accel_bias + data.accel_scale * scene.flight.imu.mean_specific_force[at + 1]
    everything = np.hstack(
        [
            state_errors(scene.flight, at + 1, stored.nav),
            sensors[:, 9:10],
            (data.baro_error[at] + offset - sensors[:, 10])[:, None],
            data.gyro_bias[at] - sensors[:, 0:3],
            data.accel_scale - sensors[:, 3:6],
            accel_bias - sensors[:, 6:9],
            -sensors[:, 11:26],
            data.gnss_errors[second],
        ]
    )
    return np.asarray(everything[:, run.kind.states] - stored.estimate)


# --- tables -------------------------------------------------------------------------------


def expected(scores: Sequence[Score]) -> np.ndarray:
    """What :func:`rms` would be of very many runs, if the covariance is true."""
    return np.sqrt(np.mean(np.concatenate([s.variances for s in scores]), axis=0))


def mean_of(scores: Sequence[Score], name: str) -> float:
    return float(np.mean(np.concatenate([getattr(s, name) for s in scores])))


def over_runs(
    work: Callable[[int], list[Score]], seeds: range, processes: int
) -> list[list[Score]]:
    """Scores by filter, of all runs."""
    return [list(scores) for scores in zip(*over_seeds(work, seeds, processes), strict=True)]


def _beside(values: Sequence[float], published: object, form: str) -> str:
    ours = numbers(values, form, "/")
    if published is None:
        return ours
    theirs = published if isinstance(published, tuple) else (published,)
    return f"{ours} ({numbers(theirs, form, '/')})"


@dataclass(frozen=True)
class Case:
    """A filter, and what an independent simulation had of it."""

    label: str
    settings: Settings
    position: tuple[float, ...] | None = None
    v_horizontal: tuple[float, ...] | None = None
    v_up: float | None = None
    attitude: tuple[float, ...] | None = None
    nees: float | None = None
    nis: float | None = None
    gap: tuple[float, ...] | None = None
    gap_v_up: float | None = None
    knows_k4: bool = True


def spiral_scene(duration: float, rate: float = 128.0, **faults: object) -> Scene:
    flight = spiral_climb(duration, rate)
    gaps = tuple(gap for gap in GAPS if gap[1] < duration)
    return Scene(
        flight,
        SPIRAL_IMU,
        SPIRAL_BARO,
        round(rate / 8.0),
        SPIRAL_ATTITUDE,
        GNSS,
        gaps,
        **faults,  # type: ignore[arg-type]
    )


def spiral_settings(scene: Scene, name: str, tau: float = 2.4, k4: float = 0.0) -> Settings:
    flight = scene.flight
    w2 = gravity_gradient(float(flight.latitude[0]), float(flight.height[0]))
    return Settings(
        filter=name,  # type: ignore[arg-type]
        imu=scene.imu,
        gnss=scene.receiver,
        baro=scene.baro,
        network=HeightNetwork(tau, k4, w2) if filter_kind(name).network else None,
        grade="navigation" if scene.imu is SPIRAL_IMU else "mems",
        control=DivergenceControl(virtual_noise=False, gate_probability=1.0),
    )


def spiral_cases(scene: Scene) -> list[Case]:
    def case(label: str, name: str, tau: float = 2.4, k4: float = 0.0, *published: Any) -> Case:
        return Case(label, spiral_settings(scene, name, tau, k4), *published)

    p, h, a, g = (4.89, 4.92), (0.039, 0.038), (9.0, 9.0, 130.0), (6.4, 6.9)
    white = ((5.48, 5.71, 7.93), (0.061, 0.060), 0.039, (12, 13, 166), 33.7, 0.71)
    return [
        case("15", "plain-15", 2.4, 0.0, *white, (8.8, 8.6, 9.4), 0.034),
        case("21", "markov-21", 2.4, 0.0, (*p, 7.00), h, 0.029, a, 0.997, 0.999, (*g, 8.9), 0.032),
        case("26, tau 2.4", "network-26", 2.4, 0.0,
             (*p, 5.48), h, 0.120, a, 1.044, 1.000, (*g, 6.1), 0.327),
        case("26, tau 2.4, K4 0.5", "network-26", 2.4, 0.5),
        case("26, tau 10", "network-26", 10.0, 0.0,
             (*p, 5.48), h, 0.096, a, 1.05, 1.00, (*g, 6.2), 0.165),
        case("26, tau 30", "network-26", 30.0, 0.0,
             (*p, 5.49), h, 0.067, a, 1.05, 1.00, (*g, 6.2), 0.098),
        case("26a, tau 2.4", "network-26a", 2.4, 0.0,
             (*p, 5.42), h, 0.030, a, 0.975, 0.999, (*g, 5.9), 0.030),
        case("24, baro as a measurement", "baro-24", 2.4, 0.0,
             (*p, 5.29), h, 0.022, a, 0.97, 0.999, (*g, 5.8), 0.021),
    ]  # fmt: skip


def manoeuvre_cases(scene: Scene) -> list[Case]:
    def case(label: str, name: str, tau: float = 2.4, k4: float = 0.0, *published: Any) -> Case:
        return Case(label, spiral_settings(scene, name, tau, k4), *published)

    p, a = (1.8, 2.0), (54.0, 54.0, 186.0)
    unaware = case("26, K4 0.5, not told", "network-26", 2.4, 0.5, (*p, 2.64), None, 0.099, a, 9.3)
    return [
        case("15", "plain-15", 2.4, 0.0, (*p, 4.44), None, 0.050, None, 12.5),
        case("24 without baro", "markov-24", 2.4, 0.0, (*p, 4.06), None, 0.032, a, 0.87),
        replace(unaware, knows_k4=False),
        case("26, K4 0.5", "network-26", 2.4, 0.5, (*p, 2.27), None, 0.081, a, 0.89),
        case("26, tau 2.4", "network-26", 2.4, 0.0, (*p, 2.27), None, 0.079, a, 0.89),
        case("26, tau 10", "network-26", 10.0, 0.0, (*p, 2.27), None, 0.048, a, 0.90),
        case("26a, tau 5", "network-26a", 5.0),
        case("24", "baro-24", 2.4, 0.0, (*p, 2.27), None, 0.023, a, 0.87),
    ]


HEAD = (
    "filter", "pos N/E/U m", "v N/E m/s", "v_U m/s", "v_U, all updates", "att N/E/D arcsec",
    "NEES/n", "NEES pos", "NIS/rows", "gap end N/E/U m", "gap end v_U",
)  # fmt: skip


def table(title: str, scene: Scene, cases: Sequence[Case], seeds: range, processes: int) -> None:
    def work(seed: int) -> list[Score]:
        data = simulate(scene, seed)
        return [score(scene, data, c.settings, knows_k4=c.knows_k4) for c in cases]

    begun = time.perf_counter()
    scores = over_runs(work, seeds, processes)
    duration = (scene.flight.time_ns[-1] - scene.flight.time_ns[0]) * 1e-9
    rows = []
    for case, its in zip(cases, scores, strict=True):
        errors = [s.errors for s in its]
        e = rms(errors)
        g = rms([s.gap_ends for s in its]) if scene.gaps else np.full(9, np.nan)
        rows.append(
            [
                case.label,
                _beside(e[:3], case.position, ".2f"),
                _beside(e[3:5], case.v_horizontal, ".3f"),
                _beside(e[5:6], case.v_up, ".3f"),
                f"{rms([s.v_up_between for s in its]):.3f}",
                _beside(e[6:] / ARCSEC, case.attitude, ".0f"),
                _beside([mean_of(its, "nees")], case.nees, ".3f"),
                f"{mean_of(its, 'nees_position'):.2f}",
                _beside([mean_of(its, "nis")], case.nis, ".3f"),
                _beside(g[:3], case.gap, ".1f"),
                _beside(g[5:6], case.gap_v_up, ".3f"),
            ]
        )
        for label, values in (
            ("standard error", standard_error(errors)),
            ("sigma by its covariance", expected(its)),
        ):
            cells = [
                numbers(values[:3], ".2f", "/"),
                numbers(values[3:5], ".3f", "/"),
                numbers(values[5:6], ".3f"),
                "",
                numbers(values[6:] / ARCSEC, ".1f", "/"),
            ]
            rows.append([f"  {label}", *cells, *[""] * 5])
    print()
    print_table(HEAD, rows, f"{title}: {len(seeds)} runs of {duration:.0f} s, from 120 s on")
    print(f"\n{time.perf_counter() - begun:.0f} s\n")


# --- faults -------------------------------------------------------------------------------

SETTLED = 1200.0  # s: faults begin here
NO_GATE = {"virtual_noise": False, "gate_probability": 1.0}
GATE = {"virtual_noise": False, "gate_noise_epochs": 0}
CONTROLS = {
    name: DivergenceControl(**options)  # type: ignore[arg-type]
    for name, options in {
        "none": NO_GATE,
        "Sage-Husa .99": {**NO_GATE, "adaptive": "sage-husa"},
        "innovation": {**NO_GATE, "adaptive": "innovation"},
        "epsilon .05": {**NO_GATE, "schmidt_epsilon": 0.05},
        "epsilon .3": {**NO_GATE, "schmidt_epsilon": 0.3},
        "virtual noise": {"gate_probability": 1.0},
        "gate only": {**GATE, "restart_after": 0},
        "gate, restart 20": {**GATE, "restart_after": 20},
        "all, restart 20": {"adaptive": "sage-husa", "schmidt_epsilon": 0.05, "restart_after": 20},
        "default but for what the gate measures": {"gate_noise_epochs": 0},
        "default": {},
    }.items()
}
FAULTS: dict[str, dict[str, object]] = {
    "nominal": {},
    "positions x 6 for 600 s": {"noise_times": (1200.0, 1800.0, 6.0, 1.0)},
    "GNSS noise x 6 for 600 s": {"noise_times": (1200.0, 1800.0, 6.0, 6.0)},
    "GNSS noise x 2 for 600 s": {"noise_times": (1200.0, 1800.0, 2.0, 2.0)},
    "gyro 0.5 deg/h, accelerometer 0.5 mg step": {"bias_step": (1200.0, 0.5 * DEG_H, 500.0 * UG)},
    "GNSS 100 m off for 30 s": {"jump": (1500.0, 1530.0, 100.0)},
}
# horizontal RMS (peak), m, of an independent simulation, which says "GNSS noise x 6"
FAULTS_PUBLISHED = {
    "nominal": ("7.66", "7.66", "7.66", "7.66", "7.70", "7.64", "7.66", "7.66", "7.64"),
    "positions x 6 for 600 s": (
        *("8.28(30)", "8.02(22)", "7.91(24)", "8.39", "9.18"),
        *("8.30", "9.58", "9.91", "7.93"),
    ),
    "gyro 0.5 deg/h, accelerometer 0.5 mg step": (
        *("15.7(36)", "32.9(71)", "34.0(71)", "15.2", "13.8"),
        *("8.0(24)", "790(3682)", "12.8(55)", "8.0(24)"),
    ),
    "GNSS 100 m off for 30 s": (
        *("13.6(92)", "8.8(36)", "8.7(36)", "13.7", "14.0"),
        *("14.0", "7.67(22)", "14.2(112)", "10.9(71)"),
    ),
}


def faults(seeds: range, processes: int, duration: float = 2700.0) -> None:
    """What each control does about each fault, in the filter 26a."""
    plain = replace(spiral_scene(duration), gaps=())
    base = spiral_settings(plain, "network-26a")
    settings = [replace(base, control=control) for control in CONTROLS.values()]

    def row(name: str, fault: dict[str, object]) -> list[str]:
        scene = replace(plain, **fault)  # type: ignore[arg-type]

        def work(seed: int) -> list[Score]:
            data = simulate(scene, seed)
            return [score(scene, data, s, settle=SETTLED, score_states=False) for s in settings]

        cells = []
        scores = over_runs(work, seeds, processes)
        for its, published in zip_longest(scores, FAULTS_PUBLISHED.get(name, ()), fillvalue=""):
            e = np.concatenate([s.errors for s in its])
            flat = np.hypot(e[:, 0], e[:, 1])
            again = sum(s.restarts for s in its) / len(its)
            cells.append(
                f"{rms(flat):.2f}({flat.max():.0f}) \\| {rms(e[:, 2]):.2f}"
                + (f", {again:.1f} restarts" if again else "")
                + (f" [{published}]" if published else "")
            )
        return [name, *cells]

    print(
        f"\nFaults, 26a: horizontal RMS (peak) | height RMS, m; {len(seeds)} runs, 1200 to 2700 s"
    )
    begun = time.perf_counter()
    rows = (row(name, fault) for name, fault in FAULTS.items())
    print_table(["fault", *CONTROLS], rows, "Brackets behind: an independent simulation.")
    print(f"\n{time.perf_counter() - begun:.0f} s")


def main() -> None:
    options = parser(__doc__, processes=2)
    names = ("spiral", "manoeuvres", "faults")
    options.add_argument("--tables", nargs="+", choices=names, default=names)
    options.add_argument("--runs", type=int, default=24, help="of the spiral; others have fewer")
    options.add_argument("--duration", type=float, default=3600.0, help="of the spiral, s")
    options.add_argument("--seed", type=int, default=0, help="of the first run")
    args = options.parse_args()

    def seeds(share: int) -> range:
        return range(args.seed, args.seed + max(args.runs // share, 1))

    if "spiral" in args.tables:
        scene = spiral_scene(args.duration)
        table("Spiral", scene, spiral_cases(scene), seeds(1), args.processes)
    if "manoeuvres" in args.tables:
        flight = manoeuvring_flight(min(1800.0, args.duration), 100.0)
        scene = Scene(flight, MEMS_IMU, MEMS_BARO, 10, MEMS_ATTITUDE, MEMS_GNSS, GAPS[:2])
        table("Manoeuvres", scene, manoeuvre_cases(scene), seeds(2), args.processes)
    if "faults" in args.tables:
        faults(seeds(3), args.processes)


if __name__ == "__main__":
    main()
