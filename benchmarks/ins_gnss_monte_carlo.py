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

import argparse
import multiprocessing
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest

import numpy as np

from sinstool.core import earth, rotation
from sinstool.core.streams import GnssEpochs
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.coning.stage import ConingStage
from sinstool.methods.height.network import HeightNetwork, gravity_gradient
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.layout import P_K4
from sinstool.methods.ins_gnss.noise import BaroModel, GnssModel, ImuNoise
from sinstool.methods.ins_gnss.settings import DivergenceControl, Settings, Start, start
from sinstool.methods.ins_gnss.states import ACCEL_SCALE, filter_kind
from sinstool.methods.strapdown.velocity import Increments, IncrementStage
from sinstool.simulation.barometer import barometer
from sinstool.simulation.flight import manoeuvring_flight, spiral_climb
from sinstool.simulation.sensors import markov
from sinstool.simulation.trajectory import Trajectory

DEGREE = np.pi / 180.0
G = 9.80665
GNSS = GnssModel()
BLOCK = 60  # s that are filtered at a time

# Sensors, barometer and start of the two flights
SPIRAL_IMU = ImuNoise(
    0.005 * DEGREE / 60.0, 10e-6 * G, 0.05 * DEGREE / 3600.0, 50e-6 * G, accel_scale=50e-6
)
SPIRAL_BARO = BaroModel(10.0, 500.0, 0.0)
SPIRAL_ATTITUDE = np.array([30.0, 30.0, 180.0]) * DEGREE / 3600.0
MEMS_IMU = ImuNoise(
    0.3 * DEGREE / 60.0, 150e-6 * G, 5.0 * DEGREE / 3600.0, 2e-3 * G, accel_scale=1e-4
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
    imu: ImuNoise
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


def compensated(imu, gyro: np.ndarray, accel: np.ndarray) -> Increments:  # type: ignore[no-untyped-def]
    stage = IncrementStage(
        lambda: ConingStage(
            algorithm("previous-1"), "mean-rate", nominal_interval=float(imu.interval[0])
        )
    )
    parts = [stage.push(gyro, accel, imu.time_ns), stage.finish()]
    return Increments(
        *(np.concatenate([getattr(p, c) for p in parts]) for c in Increments.__dataclass_fields__)
    )


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
        imu,
        imu.gyro_mean_rate + gyro_bias + white_gyro,
        imu.mean_specific_force * (1.0 + scale) + accel_bias + white_accel,
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
    kept = np.ones(seconds, dtype=bool)
    for begin, end in scene.gaps:
        kept &= ~((after >= begin) & (after < end))

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
    position = 5.0 * first[:3]
    psi = scene.attitude * first[6:]
    lat, h0 = float(flight.latitude[0]), float(flight.height[0])
    m0, t0 = earth.radii_of_curvature(lat)
    begun = start(
        lat + position[0] / (m0 + h0),
        float(flight.longitude[0] + position[1] / ((t0 + h0) * np.cos(lat))),
        h0 - position[2],
        flight.velocity_n[0] + 0.1 * first[3:6],
        rotation.multiply(rotation.exp(-psi), imu.q_nb[0]),
        5.0,
        0.1,
        scene.attitude,
    )
    return Data(
        begun,
        increments,
        fixes.rows(kept),
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


def state_errors(flight: Trajectory, rows: np.ndarray, nav: np.ndarray) -> np.ndarray:
    """Navigation less truth, and psi, shape (m, 9)."""
    lat, h = flight.latitude[rows], flight.height[rows]
    meridian, transverse = earth.radii_of_curvature(lat)
    out = np.empty((len(rows), 9))
    out[:, 0] = (nav[:, 0] - lat) * (meridian + h)
    out[:, 1] = (nav[:, 1] - flight.longitude[rows]) * (transverse + h) * np.cos(lat)
    out[:, 2] = h - nav[:, 2]
    out[:, 3:6] = nav[:, 3:6] - flight.velocity_n[rows]
    out[:, 6:] = rotation.log(
        rotation.multiply(flight.imu.q_nb[rows], rotation.conjugate(nav[:, 6:]))
    )
    return out


def score(
    scene: Scene,
    data: Data,
    settings: Settings,
    *,
    told_of_k4: bool = True,
    settle: float = 120.0,
    score_states: bool = True,
) -> Score:
    """Run a filter over a run's samples."""
    flight = scene.flight
    given = data.increments
    run = InsGnssFilter(data.start, settings, with_baro=True, store=score_states)
    if not told_of_k4:
        run._model.parameters[P_K4] = 0.0
    rate = round(1.0 / float(given.interval[0]))
    size = BLOCK * rate
    errors, nees, nees_position, nis, ends, between = [], [], [], [], [], []
    variances = []
    begun = time.perf_counter()
    fix = baro = 0
    gap_rows = np.array([int((end - 1.0) * rate) - 1 for _, end in scene.gaps], dtype=np.int64)
    for k in range(0, len(given.interval), size):
        part = Increments(*(c[k : k + size] for c in vars(given).values()))
        last = part.time_ns[-1]
        next_fix = int(np.searchsorted(data.gnss.time_ns, last, side="right"))
        next_baro = int(np.searchsorted(data.baro_time_ns, last, side="right"))
        block = run.push(
            part,
            data.gnss.rows(slice(fix, next_fix)),
            None,
            data.baro_time_ns[baro:next_baro],
            data.baro_height[baro:next_baro],
        )
        fix, baro = next_fix, next_baro
        u = block.updates
        assert u is not None
        rows = np.arange(rate - 1, len(u), rate)
        columns = (u.latitude, u.longitude, u.height)
        nav = np.column_stack([*columns, u.velocity_n, u.q_nb])
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
            for error, p in zip(
                e[seconds > settle], stored.covariance_after[seconds > settle], strict=True
            ):
                nees.append(error @ np.linalg.solve(p, error) / len(error))
                nees_position.append(error[:3] @ np.linalg.solve(p[:3, :3], error[:3]) / 3.0)
    after = 1.0 + np.arange(sum(len(e) for e in errors))
    outside = after > settle
    for begin, end in scene.gaps:
        outside &= ~((after >= begin) & (after < end))
    return Score(
        np.concatenate(errors)[outside],
        np.array(nees),
        np.array(nees_position),
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
            data.gnss_errors[second],
        ]
    )
    return np.asarray(everything[:, run.kind.states] - stored.estimate)


# --- tables -------------------------------------------------------------------------------

_SCENE: Scene | None = None
_WORK: Callable[[int], list[Score]] | None = None
_FIRST = 0  # seed of the first run


def _one(seed: int) -> list[Score]:
    assert _WORK is not None
    return _WORK(seed)


def over_runs(work: Callable[[int], list[Score]], runs: int, processes: int) -> list[list[Score]]:
    """Scores by filter, of all runs; the truth is shared with the processes."""
    global _WORK
    _WORK = work
    if processes > 1:
        with multiprocessing.get_context("fork").Pool(processes) as pool:
            by_run = pool.map(_one, range(_FIRST, _FIRST + runs), chunksize=1)
    else:
        by_run = [_one(seed) for seed in range(_FIRST, _FIRST + runs)]
    return [list(scores) for scores in zip(*by_run, strict=True)]


def rms(scores: Sequence[Score]) -> np.ndarray:
    return np.sqrt(np.mean(np.concatenate([s.errors for s in scores]) ** 2, axis=0))


def standard_error(scores: Sequence[Score]) -> np.ndarray:
    """Of :func:`rms`, from how much runs differ."""
    squares = np.array([np.mean(s.errors**2, axis=0) for s in scores])
    if len(squares) < 2:
        return np.full(squares.shape[1], np.nan)
    spread = squares.std(axis=0, ddof=1) / np.sqrt(len(squares))
    return np.asarray(spread / (2.0 * np.sqrt(squares.mean(axis=0))))


def expected(scores: Sequence[Score]) -> np.ndarray:
    """What :func:`rms` would be of very many runs, if the covariance is true."""
    return np.sqrt(np.mean(np.concatenate([s.variances for s in scores]), axis=0))


def gap_rms(scores: Sequence[Score]) -> np.ndarray:
    return np.sqrt(np.mean(np.concatenate([s.gap_ends for s in scores]) ** 2, axis=0))


def mean_of(scores: Sequence[Score], name: str) -> float:
    return float(np.mean(np.concatenate([getattr(s, name) for s in scores])))


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _beside(values: Sequence[float], published: Sequence[float | None] | None, form: str) -> str:
    ours = "/".join(format(v, form) for v in values)
    if published is None:
        return ours
    theirs = "/".join("-" if v is None else format(v, form) for v in published)
    return f"{ours} ({theirs})"


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
    told_of_k4: bool = True
    more: dict[str, float] = field(default_factory=dict)


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
    def told(name: str, *network: float) -> Settings:
        return spiral_settings(scene, name, *network)

    h, a = (0.039, 0.038), (9.0, 9.0, 130.0)
    p = (4.89, 4.92)
    return [
        Case(
            "15",
            told("plain-15"),
            (5.48, 5.71, 7.93),
            (0.061, 0.060),
            0.039,
            (12, 13, 166),
            33.7,
            0.71,
            (8.8, 8.6, 9.4),
            0.034,
        ),
        Case(
            "21",
            told("markov-21"),
            (*p, 7.00),
            h,
            0.029,
            a,
            0.997,
            0.999,
            (6.4, 6.9, 8.9),
            0.032,
        ),
        Case(
            "26, tau 2.4",
            told("network-26"),
            (*p, 5.48),
            h,
            0.120,
            a,
            1.044,
            1.000,
            (6.4, 6.9, 6.1),
            0.327,
        ),
        Case("26, tau 2.4, K4 0.5", told("network-26", 2.4, 0.5)),
        Case(
            "26, tau 10",
            told("network-26", 10.0),
            (*p, 5.48),
            h,
            0.096,
            a,
            1.05,
            1.00,
            (6.4, 6.9, 6.2),
            0.165,
        ),
        Case(
            "26, tau 30",
            told("network-26", 30.0),
            (*p, 5.49),
            h,
            0.067,
            a,
            1.05,
            1.00,
            (6.4, 6.9, 6.2),
            0.098,
        ),
        Case(
            "26a, tau 2.4",
            told("network-26a"),
            (*p, 5.42),
            h,
            0.030,
            a,
            0.975,
            0.999,
            (6.4, 6.9, 5.9),
            0.030,
        ),
        Case(
            "24, baro as a measurement",
            told("baro-24"),
            (*p, 5.29),
            h,
            0.022,
            a,
            0.97,
            0.999,
            (6.4, 6.9, 5.8),
            0.021,
        ),
    ]


def manoeuvre_cases(scene: Scene) -> list[Case]:
    def told(name: str, *network: float) -> Settings:
        return spiral_settings(scene, name, *network)

    p, a = (1.8, 2.0), (54.0, 54.0, 186.0)
    nothing: dict[str, object] = {"gap": None}
    return [
        Case("15", told("plain-15"), (*p, 4.44), None, 0.050, None, 12.5, **nothing),  # type: ignore[arg-type]
        Case("24 without baro", told("markov-24"), (*p, 4.06), None, 0.032, a, 0.87),
        Case(
            "26, K4 0.5, not told",
            told("network-26", 2.4, 0.5),
            (*p, 2.64),
            None,
            0.099,
            a,
            9.3,
            told_of_k4=False,
        ),
        Case("26, K4 0.5", told("network-26", 2.4, 0.5), (*p, 2.27), None, 0.081, a, 0.89),
        Case("26, tau 2.4", told("network-26"), (*p, 2.27), None, 0.079, a, 0.89),
        Case("26, tau 10", told("network-26", 10.0), (*p, 2.27), None, 0.048, a, 0.90),
        Case("26a, tau 5", told("network-26a", 5.0)),
        Case("24", told("baro-24"), (*p, 2.27), None, 0.023, a, 0.87),
    ]


def table(title: str, scene: Scene, cases: Sequence[Case], runs: int, processes: int) -> None:
    def work(seed: int) -> list[Score]:
        data = simulate(scene, seed)
        return [score(scene, data, c.settings, told_of_k4=c.told_of_k4) for c in cases]

    begun = time.perf_counter()
    scores = over_runs(work, runs, processes)
    duration = (scene.flight.time_ns[-1] - scene.flight.time_ns[0]) * 1e-9
    print(f"\n{title}: {runs} runs of {duration:.0f} s, from 120 s on\n")
    head = (
        "filter",
        "pos N/E/U m",
        "v N/E m/s",
        "v_U m/s",
        "v_U, all updates",
        "att N/E/D arcsec",
        "NEES/n",
    )
    print(_row([*head, "NEES pos", "NIS/rows", "gap end N/E/U m", "gap end v_U"]))
    print("|---" * 11 + "|")
    for case, its in zip(cases, scores, strict=True):
        e = rms(its)
        g = gap_rms(its) if scene.gaps else np.full(9, np.nan)
        one = lambda v: None if v is None else (v,)  # noqa: E731
        print(
            _row(
                [
                    case.label,
                    _beside(e[:3], case.position, ".2f"),
                    _beside(e[3:5], case.v_horizontal, ".3f"),
                    _beside(e[5:6], one(case.v_up), ".3f"),
                    f"{np.sqrt(np.mean(np.concatenate([s.v_up_between for s in its]) ** 2)):.3f}",
                    _beside(e[6:] / DEGREE * 3600.0, case.attitude, ".0f"),
                    _beside([mean_of(its, "nees")], one(case.nees), ".3f"),
                    f"{mean_of(its, 'nees_position'):.2f}",
                    _beside([mean_of(its, "nis")], one(case.nis), ".3f"),
                    _beside(g[:3], case.gap, ".1f"),
                    _beside(g[5:6], one(case.gap_v_up), ".3f"),
                ]
            )
        )
        for label, values in (
            ("standard error", standard_error(its)),
            ("sigma by its covariance", expected(its)),
        ):
            groups = (
                _beside(values[:3], None, ".2f"),
                _beside(values[3:5], None, ".3f"),
                _beside(values[5:6], None, ".3f"),
                "",
                _beside(values[6:] / DEGREE * 3600.0, None, ".1f"),
            )
            print(_row([f"  {label}", *groups, *[""] * 5]), flush=True)
    print(f"\n{time.perf_counter() - begun:.0f} s\n")


# --- faults -------------------------------------------------------------------------------

FAULT_SPAN = (1200, 2700)
CONTROLS = {
    "none": DivergenceControl(virtual_noise=False, gate_probability=1.0),
    "Sage-Husa .99": DivergenceControl(
        virtual_noise=False, gate_probability=1.0, adaptive="sage-husa"
    ),
    "innovation": DivergenceControl(
        virtual_noise=False, gate_probability=1.0, adaptive="innovation"
    ),
    "epsilon .05": DivergenceControl(
        virtual_noise=False, gate_probability=1.0, schmidt_epsilon=0.05
    ),
    "epsilon .3": DivergenceControl(virtual_noise=False, gate_probability=1.0, schmidt_epsilon=0.3),
    "virtual noise": DivergenceControl(gate_probability=1.0),
    "gate only": DivergenceControl(virtual_noise=False, restart_after=0, gate_noise_epochs=0),
    "gate, restart 20": DivergenceControl(
        virtual_noise=False, restart_after=20, gate_noise_epochs=0
    ),
    "all, restart 20": DivergenceControl(
        adaptive="sage-husa", schmidt_epsilon=0.05, restart_after=20
    ),
    "default but for what the gate measures": DivergenceControl(gate_noise_epochs=0),
    "default": DivergenceControl(),
}
FAULTS: dict[str, dict[str, object]] = {
    "nominal": {},
    "positions x 6 for 600 s": {"noise_times": (1200.0, 1800.0, 6.0, 1.0)},
    "GNSS noise x 6 for 600 s": {"noise_times": (1200.0, 1800.0, 6.0, 6.0)},
    "GNSS noise x 2 for 600 s": {"noise_times": (1200.0, 1800.0, 2.0, 2.0)},
    "gyro 0.5 deg/h, accelerometer 0.5 mg step": {
        "bias_step": (1200.0, 0.5 * DEGREE / 3600.0, 0.5e-3 * G)
    },
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


def faults(runs: int, processes: int, duration: float = 2700.0) -> None:
    """What each control does about each fault, in the filter 26a."""
    plain = spiral_scene(duration)
    plain = replace(plain, gaps=())
    base = spiral_settings(plain, "network-26a")
    print(f"\nFaults, 26a: horizontal RMS (peak) | height RMS, m; {runs} runs, 1200 to 2700 s")
    print("Brackets behind: an independent simulation.\n")
    print(_row(["fault", *CONTROLS]))
    print("|---" * (len(CONTROLS) + 1) + "|")
    begun = time.perf_counter()
    for name, fault in FAULTS.items():
        scene = replace(plain, **fault)  # type: ignore[arg-type]

        def work(seed: int, scene: Scene = scene) -> list[Score]:
            data = simulate(scene, seed)
            return [
                score(
                    scene,
                    data,
                    replace(base, control=control),
                    settle=float(FAULT_SPAN[0]),
                    score_states=False,
                )
                for control in CONTROLS.values()
            ]

        cells = []
        scores = over_runs(work, runs, processes)
        for its, known in zip_longest(scores, FAULTS_PUBLISHED.get(name, ()), fillvalue=""):
            e = np.concatenate([s.errors for s in its])
            flat = np.hypot(e[:, 0], e[:, 1])
            again = sum(s.restarts for s in its) / len(its)
            cells.append(
                f"{np.sqrt(np.mean(flat**2)):.2f}({flat.max():.0f}) "
                f"\\| {np.sqrt(np.mean(e[:, 2] ** 2)):.2f}"
                + (f", {again:.1f} restarts" if again else "")
                + (f" [{known}]" if known else "")
            )
        print(_row([name, *cells]), flush=True)
    print(f"\n{time.perf_counter() - begun:.0f} s")


def main() -> None:
    global _FIRST
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    names = ("spiral", "manoeuvres", "faults")
    parser.add_argument("--tables", nargs="+", choices=names, default=names)
    parser.add_argument("--runs", type=int, default=24, help="of the spiral; others have fewer")
    parser.add_argument("--duration", type=float, default=3600.0, help="of the spiral, s")
    parser.add_argument("--seed", type=int, default=0, help="of the first run")
    parser.add_argument("--processes", type=int, default=2)
    told = parser.parse_args()
    _FIRST = told.seed
    if "spiral" in told.tables:
        scene = spiral_scene(told.duration)
        table("Spiral", scene, spiral_cases(scene), told.runs, told.processes)
    if "manoeuvres" in told.tables:
        flight = manoeuvring_flight(min(1800.0, told.duration), 100.0)
        scene = Scene(flight, MEMS_IMU, MEMS_BARO, 10, MEMS_ATTITUDE, MEMS_GNSS, GAPS[:2])
        table(
            "Manoeuvres",
            scene,
            manoeuvre_cases(scene),
            max(told.runs // 2, 1),
            told.processes,
        )
    if "faults" in told.tables:
        faults(max(told.runs // 3, 1), told.processes)


if __name__ == "__main__":
    main()
