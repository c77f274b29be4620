"""What an update of the mechanisation costs, and how far it is from the truth.

Ours, with and without height damping, beside the same arithmetic in C (compiled here), and beside
two published packages where they are installed (`pip install python-ins smsfusion`).

python benchmarks/mechanisation.py
python benchmarks/mechanisation.py --seconds 600 --repeats 3 --no-accuracy
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from benchmarks.common import best, compensated, parser, print_table
from sinstool.core import earth, rotation
from sinstool.core.quaternion_kernels import EXACT
from sinstool.methods.height import layout
from sinstool.methods.height.network import HeightNetwork, gravity_gradient, pole_matched_gains
from sinstool.methods.strapdown.free_inertial import navigate
from sinstool.methods.strapdown.navigation import SIZE, initial_state
from sinstool.methods.strapdown.velocity import Increments
from sinstool.simulation.flight import manoeuvring_flight, spiral_climb
from sinstool.simulation.truth import Trajectory

TAU = 30.0  # s, of the height damping
NS = 1e9
POLE_GRAVITY = 9.8321849378  # m/s^2, of WGS-84
NO_HEIGHTS = (np.empty(0), np.empty(0), np.empty(0), np.empty(0, np.int64))


def increments(flight: Trajectory, name: str = "previous-1") -> Increments:
    """Compensated increments of a flight, by one of the coning algorithms."""
    imu = flight.imu
    return compensated(
        imu.time_ns, imu.gyro_mean_rate, imu.mean_specific_force, imu.interval[0], name
    )


def start(flight: Trajectory) -> np.ndarray:
    return initial_state(
        float(flight.latitude[0]),
        float(flight.longitude[0]),
        float(flight.height[0]),
        flight.velocity_n[0],
        flight.imu.q_nb[0],
    )


def mechanise(
    state: np.ndarray,
    increments: Increments,
    out: np.ndarray,
    parameters: np.ndarray | None = None,
    heights: tuple[np.ndarray, ...] = NO_HEIGHTS,
) -> None:
    """What `process --mode ins` does with a block of increments."""
    damped = parameters is not None
    navigate(
        state, layout.new_state(), parameters if damped else np.zeros(layout.PARAMETERS),
        layout.new_events(len(heights[0])), damped, increments.rotation_vector,
        increments.velocity_increment, increments.interval, np.cumsum(increments.interval),
        *heights, 0, EXACT, False, out,
    )  # fmt: skip


def compiled() -> Callable[..., None]:
    """Compile the C loop; give it as a function of numpy arrays."""
    source = Path(__file__).with_name("mechanisation_plain.c")
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "plain.so"
        subprocess.run(
            ["cc", "-O3", "-shared", "-fPIC", "-o", str(library), str(source), "-lm"], check=True
        )
        function = ctypes.CDLL(str(library)).navigate
    double = np.ctypeslib.ndpointer(dtype=np.float64, flags="C_CONTIGUOUS")
    function.argtypes = [double] * 4 + [ctypes.c_long] * 2 + [double] * 3
    function.restype = None
    return function


def pyins_start(flight: Trajectory):
    import pandas as pd

    values = [
        *np.rad2deg([flight.latitude[0], flight.longitude[0]]),
        flight.height[0],
        *flight.velocity_n[0],
        *np.rad2deg(rotation.to_euler(flight.imu.q_nb[0])),
    ]
    names = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    return pd.Series(values, index=names)


def pyins_increments(flight: Trajectory):
    """What python-ins makes of the same exact increments."""
    import pandas as pd
    from pyins.strapdown import compute_increments_from_imu

    imu = flight.imu
    data = np.hstack([imu.gyro_increment, imu.mean_specific_force * imu.interval[:, None]])
    names = [f"{s}_{a}" for s in ("gyro", "accel") for a in "xyz"]
    index = pd.Index(flight.time_ns * 1e-9, name="time")
    return compute_increments_from_imu(pd.DataFrame(data, index, names), "increment")


def pyins_run(flight: Trajectory, increments) -> np.ndarray:
    """Latitude, longitude, height and velocity of python-ins, shape (n, 6)."""
    from pyins.strapdown import Integrator

    result = Integrator(pyins_start(flight)).integrate(increments)
    rows = result[["lat", "lon", "alt", "VN", "VE", "VD"]].to_numpy()[1:].copy()
    rows[:, :2] = np.deg2rad(rows[:, :2])
    return rows


def pyins_gravity(latitude: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Gravity as python-ins has it, linear in height without the ellipsoid's share."""
    sin2 = np.sin(latitude) ** 2
    e2 = earth.ECCENTRICITY_SQUARED
    f = (1.0 - e2) ** 0.5 * POLE_GRAVITY / earth.NORMAL_GRAVITY_EQUATOR - 1.0
    g = earth.NORMAL_GRAVITY_EQUATOR * (1.0 + f * sin2) / (1.0 - e2 * sin2) ** 0.5
    g *= 1.0 - 2.0 * height / earth.SEMI_MAJOR_AXIS
    return np.stack([np.zeros_like(g), np.zeros_like(g), g], axis=-1)


def apart(flight: Trajectory, a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Largest distance of two runs, m: horizontal and vertical. Rows: lat, lon, height."""
    meridian, transverse = earth.radii_of_curvature(flight.latitude[1:])
    north = (a[:, 0] - b[:, 0]) * meridian
    east = np.remainder(a[:, 1] - b[:, 1] + np.pi, 2.0 * np.pi) - np.pi
    east = east * transverse * np.cos(a[:, 0])
    return float(np.hypot(north, east).max()), float(np.abs(a[:, 2] - b[:, 2]).max())


def truth_rows(flight: Trajectory) -> np.ndarray:
    return np.stack([flight.latitude, flight.longitude, flight.height], axis=-1)[1:]


def accuracy() -> None:
    flights = {
        "spiral climb, 3600 s at 128 Hz": spiral_climb(3600.0, 128.0),
        "manoeuvring, still air, 1800 s at 100 Hz": manoeuvring_flight(
            1800.0, 100.0, turbulence=0.0
        ),
        "manoeuvring, turbulence, 1800 s at 100 Hz": manoeuvring_flight(1800.0, 100.0),
    }
    rows = (row for title, flight in flights.items() for row in distances(title, flight))
    head = ("flight", "increments by", "horizontal m", "vertical m")
    print_table(head, rows, "Largest error against the truth with perfect sensors")
    print()


def distances(title: str, flight: Trajectory) -> Iterator[list[str]]:
    """Rows of the table for one flight."""

    def row(label: str, a: np.ndarray, b: np.ndarray) -> list[str]:
        return [title, label, *(f"{d:.2e}" for d in apart(flight, a, b))]

    truth = truth_rows(flight)
    ours = {}
    for name in ("previous-1", "quatfiter-4", "lookahead-12"):
        part = increments(flight, name)
        out = np.empty((len(part.sample), SIZE + 2))
        mechanise(start(flight), part, out)
        ours[name] = out
        full = truth.copy()
        full[part.sample - 1] = out[:, :3]
        yield row(name, full, truth)
    try:
        exact = pyins_increments(flight)
    except ImportError:
        yield [title, "python-ins: not installed", "", ""]
        return
    theirs = {
        "python-ins": pyins_run(flight, exact),
        "python-ins, our gravity": pyins_run(flight, with_our_gravity(flight, exact)),
    }
    for label, run in theirs.items():
        yield row(label, run, truth)
    for label, run in theirs.items():
        yield row(f"previous-1 less {label}", ours["previous-1"], run)


def with_our_gravity(flight: Trajectory, increments):
    """Velocity increments that make up for what python-ins leaves out of gravity."""
    middle = 0.5 * (flight.latitude[1:] + flight.latitude[:-1])
    height = 0.5 * (flight.height[1:] + flight.height[:-1])
    lack = earth.gravity_n(middle, height) - pyins_gravity(middle, height)
    added = rotation.rotate(rotation.conjugate(flight.imu.q_nb[:-1]), lack)
    corrected = increments.copy()
    corrected[["dv_x", "dv_y", "dv_z"]] += added * increments[["dt"]].to_numpy()
    return corrected


def speed(seconds: float, repeats: int) -> None:
    flight = spiral_climb(seconds, 128.0)
    part = increments(flight)
    phi, dv, dt = part.rotation_vector, part.velocity_increment, part.interval
    n = len(dt)
    out, plain = np.empty((n, SIZE + 2)), np.empty((n, SIZE))
    begin = start(flight)
    height = flight.height[part.sample].copy()
    costs: dict[str, float] = {}

    def timed(label: str, run: Callable[[], None], updates: int = n, times: int = repeats) -> None:
        costs[label] = best(run, times) / updates * NS

    c = compiled()
    nothing = np.zeros(3)
    mechanise(begin.copy(), part, out)
    timed("C -O3, undamped", lambda: c(begin.copy(), phi, dv, dt, n, 0, height, nothing, plain))
    timed("ours, undamped", lambda: mechanise(begin.copy(), part, out))
    apart_m = np.abs(out[:, :3] - plain[:, :3]).max(axis=0)
    print(f"ours and C differ by {apart_m} rad, rad, m at the most\n")

    every = 128
    w2 = gravity_gradient(float(flight.latitude[0]))
    gains = np.array(pole_matched_gains(every * float(dt[0]), TAU, 0.0, w2))
    parameters = layout.new_parameters(HeightNetwork(tau=TAU, w2=w2), "tactical")
    end = np.cumsum(dt)[every - 1 :: every]
    samples = height[every - 1 :: every].copy()
    heights = (end, end, samples, np.full(len(end), layout.ACCEPTED))

    def with_channel() -> None:
        mechanise(begin.copy(), part, out, parameters, heights)

    with_channel()
    timed(
        "C -O3, third-order loop, 1 Hz",
        lambda: c(begin.copy(), phi, dv, dt, n, every, height, gains, plain),
    )
    timed("ours, height channel with its shadow, 1 Hz", with_channel)
    lag = np.abs(out[:, 2] - height).max()
    print(f"with an exact barometer the height channel is within {lag:.1e} m of the truth\n")
    timed("IncrementStage, previous-1", lambda: increments(flight))
    timed("IncrementStage, lookahead-12", lambda: increments(flight, "lookahead-12"))
    others(flight, timed)

    base = costs["ours, undamped"]
    head = ("what", "ns per update", "against ours undamped")
    rows = ((label, f"{cost:.4g}", f"{cost / base:.3g}") for label, cost in costs.items())
    print_table(head, rows, f"{n} updates, best of {repeats}")
    print()


def others(flight: Trajectory, timed: Callable[..., None]) -> None:
    imu = flight.imu
    try:
        exact = pyins_increments(flight)
    except ImportError:
        print("python-ins is not installed")
    else:
        pyins_run(flight, exact.iloc[:99])
        timed("python-ins Integrator, one batch", lambda: pyins_run(flight, exact), len(exact), 3)
    try:
        from smsfusion import StrapdownINS
    except ImportError:
        print("smsfusion is not installed")
        return
    few = 5000
    x0 = np.concatenate([np.zeros(3), flight.velocity_n[0], imu.q_nb[0], np.zeros(6)])

    def run() -> None:
        ins = StrapdownINS(128.0, x0)
        for k in range(few):
            ins.update(imu.mean_specific_force[k], imu.gyro_mean_rate[k])

    timed("smsfusion StrapdownINS (flat Earth, Euler steps)", run, few, 2)


def main() -> None:
    options = parser(__doc__, repeats=25)
    options.add_argument("--seconds", type=float, default=160.0, help="of the flight at 128 Hz")
    options.add_argument("--no-accuracy", action="store_true", help="times only")
    args = options.parse_args()
    speed(args.seconds, args.repeats)
    if not args.no_accuracy:
        accuracy()


if __name__ == "__main__":
    main()
