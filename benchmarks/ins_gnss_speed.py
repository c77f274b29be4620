"""What the INS/GNSS filters cost, beside the feedback filter of python-ins on the same data.

python benchmarks/ins_gnss_speed.py
python benchmarks/ins_gnss_speed.py --seconds 600 --repeats 1

The slow climb in wide circles, 128 Hz, a fix a second, a barometer at 8 Hz. python-ins
(`pip install python-ins`) has no barometer and 15 states; its time step is 0.25 s, as our
substep. The errors are RMS against the truth from 120 s on, of navigation at whole seconds.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np

from benchmarks.common import ARCSEC, best, numbers, parser, print_table, rms, state_errors
from benchmarks.ins_gnss_monte_carlo import (
    SPIRAL_ATTITUDE,
    SPIRAL_IMU,
    Data,
    Scene,
    navigation,
    run_in_blocks,
    simulate,
    spiral_scene,
    spiral_settings,
)
from sinstool.core import rotation
from sinstool.methods.ins_gnss.filter import InsGnssFilter

BLOCK = 4096


def ours(
    scene: Scene, data: Data, name: str, output: bool, store: bool
) -> Callable[[], np.ndarray | None]:
    settings = spiral_settings(scene, name)

    def run() -> np.ndarray | None:
        engine = InsGnssFilter(data.start, settings, with_baro=True, output=output, store=store)
        blocks = [block.updates for _, block in run_in_blocks(engine, data, BLOCK)]
        return np.concatenate([navigation(u) for u in blocks if u is not None]) if output else None

    return run


def python_ins(scene: Scene, data: Data) -> Callable[[], np.ndarray]:
    """The feedback filter of python-ins, told the same of sensors and start."""
    import pandas as pd
    from pyins.filters import run_feedback_filter
    from pyins.inertial_sensor import EstimationModel
    from pyins.measurements import NedVelocity, Position

    nav, increments, fixes = data.start.nav, data.increments, data.gnss
    roll_pitch_heading = np.rad2deg(rotation.to_euler(nav[6:]))
    names = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    pva = pd.Series(
        [*np.rad2deg(nav[:2]), nav[2], *nav[3:6], *roll_pitch_heading],
        index=names,
        name=scene.flight.time_ns[0] * 1e-9,
    )
    columns = ["dt", "theta_x", "theta_y", "theta_z", "dv_x", "dv_y", "dv_z"]
    parts = (increments.interval, increments.rotation_vector, increments.velocity_increment)
    table = pd.DataFrame(
        np.column_stack(parts), pd.Index(increments.time_ns * 1e-9, name="time"), columns
    )
    when = pd.Index(fixes.time_ns * 1e-9, name="time")
    place = np.column_stack([np.rad2deg(fixes.latitude), np.rad2deg(fixes.longitude), fixes.height])
    position = pd.DataFrame(place, when, ["lat", "lon", "alt"])
    velocity = pd.DataFrame(fixes.velocity_n, when, ["VN", "VE", "VD"])
    model = scene.receiver
    position_sd = float(np.hypot(model.position_white[0], model.position_markov[0]))
    velocity_sd = float(np.hypot(model.velocity_white[0], model.velocity_markov[0]))
    gyro = EstimationModel(bias_sd=SPIRAL_IMU.gyro_bias, noise=SPIRAL_IMU.angle_random_walk)
    accel = EstimationModel(
        bias_sd=np.hypot(SPIRAL_IMU.accel_bias, 9.8 * SPIRAL_IMU.accel_scale),
        noise=SPIRAL_IMU.velocity_random_walk,
    )

    def run() -> np.ndarray:
        result = run_feedback_filter(
            pva,
            5.0,
            0.1,
            np.rad2deg(SPIRAL_ATTITUDE[0]),
            np.rad2deg(SPIRAL_ATTITUDE[2]),
            table,
            gyro,
            accel,
            measurements=[Position(position, position_sd), NedVelocity(velocity, velocity_sd)],
            time_step=0.25,
        )
        path = result.trajectory
        out = np.empty((len(path), 10))
        out[:, :6] = path[names[:6]].to_numpy()
        out[:, :2] = np.deg2rad(out[:, :2])
        out[:, 6:] = rotation.from_euler(np.deg2rad(path[names[6:]].to_numpy()))
        return out[-len(increments.interval) :]

    return run


def errors(scene: Scene, nav: np.ndarray) -> list[str]:
    rate = round(1.0 / float(scene.flight.imu.interval[0]))
    rows = np.arange(min(120, len(nav) // rate // 2) * rate - 1, len(nav), rate)
    e = rms(state_errors(scene.flight, rows + 1, nav[rows]))
    return [
        numbers(e[:3], ".2f", "/"),
        numbers(e[3:6], ".3f", "/"),
        numbers(e[6:] / ARCSEC, ".0f", "/"),
    ]


def main() -> None:
    options = parser(__doc__, seconds=3600.0, repeats=3)
    options.add_argument("--only-ours", action="store_true", help="leave python-ins out")
    args = options.parse_args()
    scene = spiral_scene(args.seconds)
    data = simulate(scene, 1)
    updates = len(data.increments.interval)
    cases: list[tuple[str, Callable[[], np.ndarray | None]]] = []
    for name in ("network-29a", "network-26", "baro-24", "markov-27", "plain-15"):
        cases.append((f"{name}, no output", ours(scene, data, name, False, False)))
    for name, more, store in (
        ("network-29a", "", False),
        ("network-29a", ", for a smoother", True),
        ("plain-15", "", False),
    ):
        cases.append((f"{name}, output{more}", ours(scene, data, name, True, store)))
    if not args.only_ours:
        try:
            cases.append(("python-ins, 15 states", python_ins(scene, data)))
        except ImportError:
            print("python-ins is not installed\n")

    def rows() -> Iterator[list[str]]:
        for label, run in cases:
            theirs = label.startswith("python-ins")
            if not theirs:
                run()  # compiled by then
            navs: list[np.ndarray | None] = []
            repeats = 1 if theirs else args.repeats
            seconds = best(
                lambda run=run, navs=navs: navs.append(run()), repeats, time.process_time
            )
            nav = navs[-1]
            cells = ["", "", ""] if nav is None else errors(scene, nav)
            yield [label, f"{seconds:.3f}", f"{updates / seconds:.4g}", *cells]

    head = ("filter", "s", "updates/s", "pos N/E/D m", "v N/E/D m/s", "att N/E/D arcsec")
    title = f"{updates} updates of {args.seconds:.0f} s, CPU time, best of {args.repeats}"
    print_table(head, rows(), title)


if __name__ == "__main__":
    main()
