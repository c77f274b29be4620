"""Drift of every coning algorithm in classical coning, by the closed form, as a table or a figure.

python benchmarks/coning_drift.py
python benchmarks/coning_drift.py --half-angle-deg 0.1 --rate 200 --gyro-kind rate
python benchmarks/coning_drift.py --figure docs/coning_drift.svg
"""

from __future__ import annotations

import argparse

import numpy as np

from sinstool.coning.registry import algorithm, names
from sinstool.coning.response import coning_drift, coning_rate

DEG_H = np.degrees(1.0) * 3600.0
FREQUENCIES = (5.0, 10.0, 20.0, 30.0, 50.0, 75.0, 100.0)


def drift_table(half_angle: float, rate: float, kind: str, frequencies: tuple[float, ...]):
    """Drift in deg/h: one row an algorithm, one column a frequency."""
    shown = [name for name in names() if name != "savage-4"]  # another name of optimal-4
    chosen = {name: algorithm(name) for name in shown}
    if kind == "rate":
        sp = "singular-perturbation"
        # epsilon = 0 and n = 0 leave phi = w2 T: the rectangle rule, without compensation
        chosen["rectangle rule"] = algorithm(sp, epsilon=0.0, beta_gain=0.0)
        for variant in ("exact", "bvp", "truncated", "printed"):
            chosen[f"{sp}, paper, {variant}"] = algorithm(sp, preset="paper", variant=variant)
    return {
        name: [DEG_H * coning_drift(one, half_angle, f, 1.0 / rate, kind) for f in frequencies]
        for name, one in chosen.items()
    }


def print_table(args: argparse.Namespace) -> None:
    half_angle = np.radians(args.half_angle_deg)
    truth = [DEG_H * coning_rate(half_angle, f) for f in FREQUENCIES]
    print(
        f"drift in deg/h, half angle {args.half_angle_deg} deg, {args.rate} Hz, gyro read as"
        f" {args.gyro_kind}\n"
    )
    print("| algorithm | " + " | ".join(f"{f:g} Hz" for f in FREQUENCIES) + " |")
    print("|---|" + "---|" * len(FREQUENCIES))
    print("| true coning rate | " + " | ".join(f"{v:.4g}" for v in truth) + " |")
    rows = drift_table(half_angle, args.rate, args.gyro_kind, FREQUENCIES)
    for name, values in rows.items():
        print(f"| {name} | " + " | ".join(f"{v:.4g}" for v in values) + " |")


def draw(args: argparse.Namespace) -> None:
    import matplotlib

    matplotlib.use("svg")
    import matplotlib.pyplot as plt

    # Fixed salt and no date: the same command makes the same file.
    matplotlib.rcParams["svg.hashsalt"] = "sinstool"
    half_angle = np.radians(args.half_angle_deg)
    frequencies = tuple(np.geomspace(2.0, 0.45 * args.rate, 80))
    rows = drift_table(half_angle, args.rate, args.gyro_kind, frequencies)
    wanted = ("uncompensated", "previous-1", "optimal-2", "optimal-4", "previous-3")
    figure, axes = plt.subplots(figsize=(7.2, 4.2), layout="constrained")
    for name in (*wanted, "singular-perturbation"):
        values = rows[name]
        label = name
        if name == "singular-perturbation":
            # It takes point rates; the others are shown on what an integrating gyro gives.
            values = drift_table(half_angle, args.rate, "rate", frequencies)[name]
            label = "singular-perturbation (best), point rates"
        # optimal-2 lies on previous-1: both show
        style = (0, (4, 4)) if name == "optimal-2" else "-"
        axes.loglog(frequencies, np.abs(values), label=label, lw=1.6, ls=style)
    axes.set(
        xlabel="coning frequency, Hz",
        ylabel="drift, deg/h",
        ylim=(1e-6, 1e5),
        title=f"Drift in classical coning, half angle {args.half_angle_deg:g} deg,"
        f" {args.rate:g} Hz gyro",
    )
    axes.grid(True, which="major", alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(args.figure, metadata={"Date": None})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--half-angle-deg", type=float, default=1.0)
    parser.add_argument("--rate", type=float, default=400.0, help="gyro samples a second, Hz")
    parser.add_argument(
        "--gyro-kind", choices=("rate", "mean-rate", "increment"), default="mean-rate"
    )
    parser.add_argument("--figure", help="write a figure here instead of the table")
    args = parser.parse_args()
    if args.figure:
        draw(args)
    else:
        print_table(args)


if __name__ == "__main__":
    main()
