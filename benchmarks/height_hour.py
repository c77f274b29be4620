"""An hour of the spiral climb with height damping: Monte Carlo beside published figures.

python benchmarks/height_hour.py
python benchmarks/height_hour.py --runs 8 --duration 1200

The experiment of the height-damping paper (section 1 of [1]_): 128 Hz, circles of 10 km at 2
degrees of bank, 20 m up a turn. The sensors, which the paper does not print, are a choice: gyro
0.05 deg/h and 0.005 deg/sqrt(h), accelerometer 50 ug, 50 ppm and 10 ug/sqrt(Hz), start 5 m, 0.1
m/s, 30 arcsec, 3 arcmin; barometer 10 m over 500 s at 50 Hz. "Published" are the figures of an
independent simulation of 30 runs; "theory" is the stationary solution of the network's equations.

References
----------
.. [1] Zhang J., Ren S., Tan M., "A study of altitude damping in INS/GNSS integrated navigation
   system", J. Air Force Engineering University 4(6), 2003, 37-39 (in Chinese).
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks.common import DEG_H, DEG_SQRT_H, DEGREE, UG, parser, print_table
from sinstool.core.rotation import exp, multiply
from sinstool.core.streams import Imu
from sinstool.methods.coning.registry import algorithm
from sinstool.methods.height import layout
from sinstool.methods.height.network import HeightNetwork, gravity_gradient
from sinstool.methods.height.reference import HeightReference
from sinstool.methods.sensor_errors import SensorGrade
from sinstool.methods.strapdown.free_inertial import InsRun, InsSettings
from sinstool.methods.strapdown.navigation import initial_state
from sinstool.simulation.flight import spiral_climb
from sinstool.simulation.sensors import barometer, with_errors
from sinstool.simulation.truth import Trajectory
from tests.helpers.height_network import NetworkTheory

RATE = 128.0
BARO_RATE = 50.0
SIGMA_BARO, BARO_TIME = 10.0, 500.0
SENSORS = SensorGrade(
    angle_random_walk=0.005 * DEG_SQRT_H,
    gyro_bias=0.05 * DEG_H,
    velocity_random_walk=10.0 * UG,
    accel_bias=50.0 * UG,
    accel_scale=50e-6,
)
START = (5.0, 0.1, 30.0 / 3600.0 * DEGREE, 3.0 / 60.0 * DEGREE)
SETTLED = 60.0  # s, left out of the figures

# tau, K4: RMS of height, of height less the barometer's error, and of vertical velocity.
PUBLISHED = {
    (2.4, 0.5): (9.62, 0.427, 0.335),
    (2.4, 0.0): (9.63, 0.423, 0.354),
    (10.0, 0.0): (9.66, 0.867, 0.171),
    (30.0, 0.0): (9.74, 1.50, 0.097),
    (100.0, 0.0): (10.0, 2.80, 0.054),
}


def start_state(flight: Trajectory, random: np.random.Generator | None) -> np.ndarray:
    """The true state at the start, with errors where there is a generator."""
    position = np.array([flight.latitude[0], flight.longitude[0], flight.height[0]])
    velocity, q_nb = flight.velocity_n[0].copy(), flight.imu.q_nb[0]
    if random is not None:
        metres, speed, level, heading = START
        position += random.standard_normal(3) * metres / np.array([6.36e6, 5.28e6, 1.0])
        velocity += random.standard_normal(3) * speed
        tilt = random.standard_normal(3) * np.array([level, level, heading])
        q_nb = multiply(exp(tilt), q_nb)
    return initial_state(*position.tolist(), velocity, q_nb)


def fly(
    flight: Trajectory,
    network: HeightNetwork | None,
    heights: tuple[np.ndarray, np.ndarray] | None,
    state: np.ndarray,
    imu: Imu,
) -> tuple[np.ndarray, np.ndarray]:
    """Errors of height (m) and of vertical velocity (m/s) at every sample."""
    parameters = reference = None
    if network is not None and heights is not None:
        parameters = layout.new_parameters(network, "navigation")
        none = np.zeros(len(heights[0]), np.int64)
        reference = HeightReference("baro", "", heights[0], heights[1], none, 0.0, None)
    settings = InsSettings(
        algorithm=algorithm("previous-3"),
        gyro_kind="mean-rate",
        nominal_ns=1e9 / RATE,
        max_gap_ns=10**9,
        parameters=parameters,
        reference=reference,
    )
    parts = list(InsRun(state, settings).run([imu]))
    height = np.concatenate([p.position[:, 2] for p in parts if p.position is not None])
    down = np.concatenate([p.velocity_n[:, 2] for p in parts if p.velocity_n is not None])
    return height - flight.height, flight.velocity_n[:, 2] - down


def samples(flight: Trajectory, grade: SensorGrade | None, seed: int) -> Imu:
    """What the sensors give."""
    truth = flight.imu if grade is None else with_errors(flight.imu, grade, seed)
    return Imu(truth.time_ns, truth.time_ns, truth.gyro_mean_rate, truth.mean_specific_force)


def baro(flight: Trajectory, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, heights, and the barometer's errors."""
    count = int((flight.time_ns[-1] - flight.time_ns[0]) * 1e-9 * BARO_RATE) + 1
    times = flight.time_ns[0] + np.round(np.arange(count) * 1e9 / BARO_RATE).astype(np.int64)
    seconds = (times - flight.time_ns[0]) * 1e-9
    true = np.interp(seconds, (flight.time_ns - flight.time_ns[0]) * 1e-9, flight.height)
    measured, error = barometer(
        times, true, sigma=SIGMA_BARO, correlation_time=BARO_TIME, seed=seed
    )
    return times, measured, error


def damped(
    flight: Trajectory, tau: float, k4: float, runs: range
) -> tuple[float, float, float, float, float]:
    """RMS of height, of the barometer, of their difference, of velocity; largest velocity."""
    w2 = gravity_gradient(float(flight.latitude[0]), float(flight.height[0]))
    seconds = (flight.time_ns - flight.time_ns[0]) * 1e-9
    late = seconds > SETTLED
    total, most = np.zeros(4), 0.0
    for run in runs:
        random = np.random.default_rng([7, run])
        times, measured, error = baro(flight, 1000 + run)
        dh, dv = fly(
            flight,
            HeightNetwork(tau, k4, w2),
            (times, measured),
            start_state(flight, random),
            samples(flight, SENSORS, 2000 + run),
        )
        off = np.interp(seconds, (times - times[0]) * 1e-9, error)
        square = [dh**2, off**2, (dh - off) ** 2, dv**2]
        total += [np.mean(x[late]) for x in square]
        most = max(most, float(np.abs(dv[late]).max()))
    rms = np.sqrt(total / len(runs))
    return float(rms[0]), float(rms[1]), float(rms[2]), float(rms[3]), most


def theory(flight: Trajectory, tau: float, k4: float) -> tuple[float, float]:
    """Stationary sigma of height less barometer, and of velocity."""
    w2 = gravity_gradient(float(flight.latitude[0]), float(flight.height[0]))
    sigma = NetworkTheory(tau, k4, w2).sigmas_with_gravity(
        baro_wander=2.0 * SIGMA_BARO**2 / BARO_TIME, accel_white=(10.0 * UG) ** 2
    )
    return sigma.height, sigma.velocity


def undamped(flight: Trajectory, runs: range) -> tuple[np.ndarray, np.ndarray]:
    """Size of the height error after 600 s and at the end of each run."""
    at = min(round(600.0 * RATE), len(flight.time_ns) - 1)
    errors = []
    for run in runs:
        random = np.random.default_rng([7, run])
        imu = samples(flight, SENSORS, 2000 + run)
        dh, _ = fly(flight, None, None, start_state(flight, random), imu)
        errors.append((abs(dh[at]), abs(dh[-1])))
    early, end = np.array(errors).T
    return early, end


def one_metre(flight: Trajectory) -> tuple[float, float]:
    """What 1 m at the start, and nothing else, becomes; and the linear theory of it."""
    state = start_state(flight, None)
    imu = samples(flight, None, 0)
    exact, _ = fly(flight, None, None, state, imu)
    state[2] += 1.0
    moved, _ = fly(flight, None, None, state, imu)
    seconds = float(flight.time_ns[-1] - flight.time_ns[0]) * 1e-9
    w2 = gravity_gradient(float(flight.latitude[0]), float(flight.height[0]))
    return float(moved[-1] - exact[-1]), float(np.cosh(np.sqrt(w2) * seconds))


def main() -> None:
    """Print the tables."""
    options = parser(__doc__, runs=30)
    options.add_argument("--duration", type=float, default=3600.0, help="s")
    args = options.parse_args()
    begin = time.perf_counter()
    flight = spiral_climb(args.duration, RATE)
    runs = range(args.runs)

    grown, linear = one_metre(flight)
    early, end = undamped(flight, runs)
    after = f"after {args.duration:.0f} s"
    rms = np.sqrt(np.mean(end**2)) / 1e3
    rows = (
        (f"1 m at the start, {after}, m", f"{grown:.1f}", f"{linear:.1f}",
         "10 000 (after an hour): not by 1 m alone"),
        ("error after 600 s, RMS, m", f"{np.sqrt(np.mean(early**2)):.0f}", "145", ""),
        (f"error {after}, RMS, km", f"{rms:.1f}", "63.0 (after an hour)", ""),
        ("median, km", f"{np.median(end) / 1e3:.1f}", "41.6 (after an hour)", "tens of km"),
        ("largest, km", f"{end.max() / 1e3:.1f}", "122 (after an hour)", ""),
    )  # fmt: skip
    print_table(("", "ours", "expected", "the paper"), rows, "1. Without damping")

    print(
        f"\n2. With damping: {args.runs} runs of {args.duration:.0f} s, from {SETTLED:.0f} s on\n"
    )

    def row(tau: float, k4: float, published: tuple[float, float, float]) -> list[str]:
        h, b, off, v, most = damped(flight, tau, k4, runs)
        height, velocity = theory(flight, tau, k4)
        return [
            *(f"{tau:g}, {k4:g}", f"{h:.2f}", f"{b:.2f}", f"{published[0]:.4g}", f"{off:.3f}"),
            *(f"{height:.3f}, {published[1]:.3f}", f"{v:.3f}"),
            *(f"{velocity:.3f}, {published[2]:.3f}", f"{most:.2f}"),
        ]

    title = "RMS: height, m; height less barometer, m; vertical velocity, m/s"
    head = ("tau, K4", "height", "barometer itself", "published", "h - b", "theory, published",
            "velocity", "theory, published", "largest")  # fmt: skip
    print_table(head, (row(*network, p) for network, p in PUBLISHED.items()), title)
    print(f"\n{time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
