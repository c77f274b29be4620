"""What the INS/GNSS filters cost, beside the feedback filter of python-ins on the same data.

python benchmarks/ins_gnss_speed.py
python benchmarks/ins_gnss_speed.py --seconds 600 --repeats 1

The slow climb in wide circles, 128 Hz, a fix a second, a barometer at 8 Hz. python-ins
(`pip install python-ins`) has no barometer and 15 states; its time step is 0.25 s, as our
substep. The errors are RMS against the truth from 120 s on, of navigation at whole seconds.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from ins_gnss_monte_carlo import (
    SPIRAL_ATTITUDE,
    SPIRAL_IMU,
    Data,
    Scene,
    simulate,
    spiral_scene,
    spiral_settings,
    state_errors,
)

from sinstool.core import rotation
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.strapdown.velocity import Increments

BLOCK = 4096


def ours(
    scene: Scene, data: Data, name: str, output: bool, store: bool
) -> Callable[[], np.ndarray | None]:
    settings = spiral_settings(scene, name)
    given = data.increments
    parts = [
        Increments(*(c[k : k + BLOCK] for c in vars(given).values()))
        for k in range(0, len(given.interval), BLOCK)
    ]

    def run() -> np.ndarray | None:
        found = InsGnssFilter(data.start, settings, with_baro=True, output=output, store=store)
        blocks = []
        fix = baro = 0
        for part in parts:
            last = part.time_ns[-1]
            next_fix = int(np.searchsorted(data.gnss.time_ns, last, side="right"))
            next_baro = int(np.searchsorted(data.baro_time_ns, last, side="right"))
            block = found.push(
                part,
                data.gnss.rows(slice(fix, next_fix)),
                None,
                data.baro_time_ns[baro:next_baro],
                data.baro_height[baro:next_baro],
            )
            fix, baro = next_fix, next_baro
            u = block.updates
            if u is not None:
                nav = np.column_stack([u.latitude, u.longitude, u.height, u.velocity_n, u.q_nb])
                blocks.append(nav)
        return np.concatenate(blocks) if output else None

    return run


def python_ins(scene: Scene, data: Data) -> Callable[[], np.ndarray]:
    """The feedback filter of python-ins, told the same of sensors and start."""
    import pandas as pd
    from pyins.filters import run_feedback_filter
    from pyins.inertial_sensor import EstimationModel
    from pyins.measurements import NedVelocity, Position

    nav, given, fixes = data.start.nav, data.increments, data.gnss
    roll_pitch_heading = np.rad2deg(rotation.to_euler(nav[6:]))
    names = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    pva = pd.Series(
        [*np.rad2deg(nav[:2]), nav[2], *nav[3:6], *roll_pitch_heading],
        index=names,
        name=scene.flight.time_ns[0] * 1e-9,
    )
    columns = ["dt", "theta_x", "theta_y", "theta_z", "dv_x", "dv_y", "dv_z"]
    table = np.column_stack([given.interval, given.rotation_vector, given.velocity_increment])
    increments = pd.DataFrame(table, pd.Index(given.time_ns * 1e-9, name="time"), columns)
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
            increments,
            gyro,
            accel,
            measurements=[Position(position, position_sd), NedVelocity(velocity, velocity_sd)],
            time_step=0.25,
        )
        found = result.trajectory
        out = np.empty((len(found), 10))
        out[:, :6] = found[names[:6]].to_numpy()
        out[:, :2] = np.deg2rad(out[:, :2])
        out[:, 6:] = rotation.from_euler(np.deg2rad(found[names[6:]].to_numpy()))
        return out[-len(given.interval) :]

    return run


def errors(scene: Scene, nav: np.ndarray) -> str:
    rate = round(1.0 / float(scene.flight.imu.interval[0]))
    rows = np.arange(min(120, len(nav) // rate // 2) * rate - 1, len(nav), rate)
    e = np.sqrt(np.mean(state_errors(scene.flight, rows + 1, nav[rows]) ** 2, axis=0))
    arc = np.rad2deg(e[6:]) * 3600.0
    return " | ".join(
        [
            "/".join(f"{x:.2f}" for x in e[:3]),
            "/".join(f"{x:.3f}" for x in e[3:6]),
            "/".join(f"{x:.0f}" for x in arc),
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--only-ours", action="store_true", help="leave python-ins out")
    told = parser.parse_args()
    scene = spiral_scene(told.seconds)
    data = simulate(scene, 1)
    updates = len(data.increments.interval)
    cases: list[tuple[str, Callable[[], np.ndarray | None]]] = []
    for name in ("network-26a", "network-26", "baro-24", "markov-21", "plain-15"):
        cases.append((f"{name}, no output", ours(scene, data, name, False, False)))
    cases.append(("network-26a, output", ours(scene, data, "network-26a", True, False)))
    cases.append(
        ("network-26a, output, for a smoother", ours(scene, data, "network-26a", True, True))
    )
    cases.append(("plain-15, output", ours(scene, data, "plain-15", True, False)))
    if not told.only_ours:
        try:
            cases.append(("python-ins, 15 states", python_ins(scene, data)))
        except ImportError:
            print("python-ins is not installed\n")
    print(f"{updates} updates of {told.seconds:.0f} s, CPU time, best of {told.repeats}\n")
    print("| filter | s | updates/s | pos N/E/D m | v N/E/D m/s | att N/E/D arcsec |")
    print("|---|---|---|---|---|---|")
    for label, run in cases:
        ours_is = not label.startswith("python-ins")
        if ours_is:
            run()  # compiled by then
        spent = []
        for _ in range(told.repeats if ours_is else 1):
            begun = time.process_time()
            nav = run()
            spent.append(time.process_time() - begun)
        best = min(spent)
        told_errors = "| |" if nav is None else errors(scene, nav)
        print(f"| {label} | {best:.3f} | {updates / best:.4g} | {told_errors} |", flush=True)


if __name__ == "__main__":
    main()
