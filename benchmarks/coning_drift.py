"""Drift of every coning algorithm in classical coning, by the closed form, as a table or a figure.

python benchmarks/coning_drift.py
python benchmarks/coning_drift.py --half-angle-deg 0.1 --frequencies 30
python benchmarks/coning_drift.py --rate 200 --gyro-kind rate
python benchmarks/coning_drift.py --figure docs/coning_drift.svg

`coning_tables.py` has what needs simulated runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.common import line, parser
from sinstool.methods.coning.algorithm import ConingAlgorithm, GyroKind
from sinstool.methods.coning.increments import DEFAULT_POINTS
from sinstool.methods.coning.registry import algorithm, names
from tests.helpers.coning_response import coning_drift, coning_rate, coning_samples, drift_from_phi

DEG_PER_H = np.degrees(1.0) * 3600.0  # deg/h of 1 rad/s
FREQUENCIES = (5.0, 10.0, 20.0, 30.0, 50.0, 75.0, 100.0)
SP = "singular-perturbation"
PAPER = {"epsilon": 2e-4, "beta_gain": 0.001}
FED = {
    "increment": "true increments",
    "mean-rate": "true mean rates",
    "rate": "point rates (interpolated through six points unless a row says otherwise)",
}


@dataclass(frozen=True)
class Table:
    """Numbers with a title; printed as Markdown."""

    title: str
    columns: tuple[str, ...]
    rows: dict[str, tuple[float, ...]]
    form: str = ".4g"
    corner: str = "algorithm"

    def __str__(self) -> str:
        head = [self.corner, *self.columns]
        lines = [f"{self.title}\n", line(head), "|---" * len(head) + "|"]
        for label, values in self.rows.items():
            lines.append(line([label, *(format(value, self.form) for value in values)]))
        return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class Row:
    """An algorithm and what it is fed.

    `kind` is what the samples are. Point rates that are `taken_for_means` are multiplied by the
    interval and called increments. Only one sample of `every` is there; increments are sums.
    """

    algorithm: ConingAlgorithm
    kind: GyroKind
    taken_for_means: bool = False
    every: int = 1
    points: int = DEFAULT_POINTS

    def drift(self, half_angle: float, frequency: float, interval: float) -> float:
        """Drift in rad/s."""
        interval *= self.every
        if not self.taken_for_means:
            return coning_drift(
                self.algorithm, half_angle, frequency, interval, self.kind, points=self.points
            )
        before, size = self.algorithm.before, self.algorithm.samples
        rate = coning_samples(half_angle, frequency, interval, before + size, self.kind)
        dt = np.full(len(rate), interval)
        phi = self.algorithm.rotation_vectors(rate * interval, dt, before, 1)[0]
        return drift_from_phi(phi, size * interval, frequency)


def drift_rows(kind: GyroKind, rate: float) -> dict[str, Row]:
    """Every algorithm on samples of one kind, and what else is of interest there."""
    interval = 1.0 / rate
    shown = [name for name in names() if name != "savage-4"]  # another name of optimal-4
    if kind != "rate":
        rows = {name: Row(algorithm(name), kind) for name in shown}
        rows["picard-3"] = Row(algorithm("picard-3"), kind)
        rows["quatfiter-3"] = Row(algorithm("quatfiter-3"), kind)
        rows[f"uncompensated, {rate / 4:g} Hz"] = Row(algorithm("uncompensated"), kind, every=4)
        return rows
    rows = {
        "rectangle rule": Row(algorithm("uncompensated"), kind, taken_for_means=True),
        "rate x T, optimal-4": Row(algorithm("optimal-4"), kind, taken_for_means=True),
    }
    for points in (2, 4, 8):
        label = f"optimal-4, {points}-point interpolation"
        rows[label] = Row(algorithm("optimal-4"), kind, points=points)
    for variant in ("printed", "truncated", "exact", "bvp"):
        rows[f"{SP}, paper, {variant}"] = Row(algorithm(SP, variant=variant, **PAPER), kind)
    rows[f"{SP}, n = 1"] = Row(algorithm(SP, epsilon=2e-4, beta_gain=1.0), kind)
    wide = algorithm(SP, variant="printed", epsilon=0.032, beta_gain=0.001)
    rows[f"{SP}, epsilon = 0.032 s, printed"] = Row(wide, kind)
    sixth = algorithm(SP, variant="truncated", epsilon=interval / 6, beta_gain=2.0)
    rows[f"{SP}, epsilon = T/6, n = 2"] = Row(sixth, kind)
    return rows | {name: Row(algorithm(name), kind) for name in shown}


def drift_table(
    half_angle: float, rate: float, kind: GyroKind, frequencies: Sequence[float]
) -> Table:
    """Drift in deg/h: one row an algorithm, one column a frequency."""
    rows = {"true coning rate": tuple(DEG_PER_H * coning_rate(half_angle, f) for f in frequencies)}
    for label, row in drift_rows(kind, rate).items():
        rows[label] = tuple(DEG_PER_H * row.drift(half_angle, f, 1.0 / rate) for f in frequencies)
    return Table(
        f"Drift in deg/h, half angle {np.degrees(half_angle):g} deg, {rate:g} Hz, {FED[kind]}",
        tuple(f"{f:g} Hz" for f in frequencies),
        rows,
    )


# name, what it is fed, label
CURVES = (
    ("uncompensated", "mean-rate", ""),
    ("previous-1", "mean-rate", ""),
    ("optimal-2", "mean-rate", ""),
    ("quatfiter-4", "mean-rate", ""),
    ("optimal-4", "mean-rate", ""),
    ("previous-3", "mean-rate", "previous-3 (default)"),
    (SP, "rate", "singular-perturbation (best),\npoint rates"),
    ("lookahead-12", "mean-rate", ""),
)


def draw(half_angle: float, rate: float, path: str) -> None:
    import matplotlib

    matplotlib.use("svg")
    import matplotlib.pyplot as plt

    # Fixed salt and no date: the same command makes the same file.
    matplotlib.rcParams["svg.hashsalt"] = "sinstool"
    frequencies = np.geomspace(2.0, 0.45 * rate, 120)
    figure, axes = plt.subplots(figsize=(8.6, 4.4), layout="constrained")
    for name, kind, label in CURVES:
        row = Row(algorithm(name), kind)
        values = [DEG_PER_H * abs(row.drift(half_angle, f, 1.0 / rate)) for f in frequencies]
        # optimal-2 lies on previous-1: both show
        style = (0, (4, 4)) if name == "optimal-2" else "-"
        axes.loglog(frequencies, values, label=label or name, lw=1.6, ls=style)
    axes.set(
        xlabel="coning frequency, Hz",
        ylabel="drift, deg/h",
        ylim=(1e-7, 1e5),
        title=f"Drift in classical coning, half angle {np.degrees(half_angle):g} deg,"
        f" {rate:g} Hz gyro",
    )
    axes.grid(True, which="major", alpha=0.3)
    ticks = [f for f in (2, 5, 10, 20, 50, 100, 200, 500, 1000) if f <= frequencies[-1]]
    axes.set_xticks(ticks, labels=[str(f) for f in ticks])
    axes.xaxis.set_minor_formatter("")
    figure.legend(fontsize=8, loc="outside right upper")
    figure.savefig(path, metadata={"Date": None})


def main() -> None:
    options = parser(__doc__, half_angle_deg=1.0)
    options.add_argument("--rate", type=float, default=400.0, help="gyro samples a second, Hz")
    options.add_argument("--frequencies", type=float, nargs="+", default=FREQUENCIES, metavar="HZ")
    options.add_argument(
        "--gyro-kind",
        choices=("rate", "mean-rate", "increment"),
        nargs="+",
        default=("mean-rate", "rate"),
        help="what the samples are; one table each",
    )
    options.add_argument("--figure", metavar="PATH", help="write the figure here instead")
    args = options.parse_args()
    half_angle = np.radians(args.half_angle_deg)
    if args.figure:
        draw(half_angle, args.rate, args.figure)
        return
    for kind in args.gyro_kind:
        print(drift_table(half_angle, args.rate, kind, args.frequencies))


if __name__ == "__main__":
    main()
