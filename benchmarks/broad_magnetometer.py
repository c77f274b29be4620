"""Heading by a magnetometer on the recorded BROAD trials, beside VQF and offline VQF.

BROAD's metric: the root mean square of the whole angle between estimate and reference over the rows
that move, with the reference's north as it is. A constant field in body axes can be added to what
was measured, as iron beside the sensor would.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import vqf

from benchmarks.common import numbers, parser, print_table
from sinstool.config import ProcessConfig
from sinstool.core import rotation
from sinstool.core.arrays import FloatArray
from sinstool.core.streams import concatenate
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.io.readers import open_log
from sinstool.io.readers.frames import q_nb_from_log, turn_body
from sinstool.io.readers.streams import Losses, read_field
from sinstool.pipelines.plan import as_planned, make_plan
from sinstool.pipelines.process import compass
from sinstool.pipelines.process.attitude import AttitudeMode
from sinstool.pipelines.process.summary import AttitudeSmoothing
from sinstool.survey.magnetometer import read_magnetometer
from sinstool.survey.source import imu_blocks, prepare

TRIALS = "../shared/data/broad"
# The optical reference may lag the IMU's clock; published figures leave that in.
LAG_MS = 0
IRON = (15.0, -10.0, 8.0)  # uT, in the log's axes


@dataclass(frozen=True)
class Errors:
    """Root mean square errors over the rows that move, deg.

    Attributes
    ----------
    total, inclination, heading : float
        As they are.
    spread : float
        Of heading about its median.
    within : tuple of float
        Share of heading errors within 1, 2 and 3 of their sigma; NaN without a sigma.
    """

    total: float
    inclination: float
    heading: float
    spread: float
    within: tuple[float, float, float] = (np.nan, np.nan, np.nan)


def reference(path: Path, lag_ms: float = LAG_MS) -> tuple[np.ndarray, FloatArray]:
    """Times (ns) and attitudes of the rows of a trial that move."""
    times, rows = [], []
    for line in path.with_suffix(".ref.csv").read_text().splitlines():
        if line[0] in "#t":
            continue
        cells = line.split(",")
        if float(cells[8]) > 0.0:
            whole, part = cells[0].split(".")
            times.append(int(whole) * SECOND + int(part.ljust(9, "0")) + round(lag_ms * 1e6))
            rows.append([float(v) for v in cells[1:5]])
    return np.array(times), q_nb_from_log(np.array(rows), "flu")


def errors(
    time_ns: np.ndarray,
    q_nb: FloatArray,
    path: Path,
    lag_ms: float = LAG_MS,
    heading_sigma: FloatArray | None = None,
) -> Errors:
    """Errors of attitudes against a trial's reference."""
    times, true = reference(path, lag_ms)
    inside = (times > time_ns[0]) & (times <= time_ns[-1])
    times, true = times[inside], true[inside]
    after = np.searchsorted(time_ns, times)
    share = (times - time_ns[after - 1]) / (time_ns[after] - time_ns[after - 1])
    begin, end = q_nb[after - 1], q_nb[after]
    end = np.where(np.einsum("ij,ij->i", begin, end)[:, None] < 0.0, -end, end)
    q = rotation.normalise(begin + share[:, None] * (end - begin))
    off = rotation.multiply(true, rotation.conjugate(q))
    total = 2.0 * np.arctan2(np.linalg.norm(off[:, 1:], axis=1), np.abs(off[:, 0]))
    tilt = 2.0 * np.arcsin(np.minimum(np.hypot(off[:, 1], off[:, 2]), 1.0))
    heading = np.asarray(rotation.wrapped(2.0 * np.arctan2(off[:, 3], off[:, 0])))
    middle = np.angle(np.exp(1j * heading).mean())
    about = np.asarray(rotation.wrapped(heading - middle))
    about = about - np.median(about)
    within = [np.nan] * 3
    if heading_sigma is not None:
        sigmas = np.abs(heading) / heading_sigma[after]
        within = [float((sigmas < k).mean()) for k in (1.0, 2.0, 3.0)]
    rms = [float(np.sqrt(np.mean(v**2))) / DEGREE for v in (total, tilt, heading, about)]
    return Errors(*rms, within=(within[0], within[1], within[2]))


def run(
    path: Path, iron: FloatArray, lag_ms: float = LAG_MS, config: ProcessConfig | None = None
) -> tuple[Errors, AttitudeSmoothing, list[Errors]]:
    """A trial: our errors and summary, and those of offline VQF and VQF.

    Parameters
    ----------
    iron : ndarray, shape (3,)
        Added to the field, FLU, T.
    lag_ms : float, optional
        Of the reference.
    """
    config = config or ProcessConfig()
    with open_log(path) as log:
        source = prepare(log, config)
        plan = make_plan(source, config)
        config = as_planned(config, plan.gyro_samples.value)

        def read(*args):
            measured, findings = read_magnetometer(*args)
            field = measured.field + turn_body(iron, "flu")
            return replace(measured, field=field), findings

        with patch.object(compass, "read_magnetometer", read):
            mode = AttitudeMode(source, config, plan)
        mode.find_out(None)
        solution = concatenate(list(mode.solutions(None)))
        summary = mode.conclude(solution, None).smoothing
        assert summary is not None and solution.covariance_attitude_n is not None
        sigma = np.sqrt(solution.covariance_attitude_n[:, 2, 2])
        ours = errors(solution.time_ns, solution.q_nb, path, lag_ms, sigma)
        imu = concatenate(list(imu_blocks(source, source.survey.first_ns)))
        blocks = read_field(log, plan.magnetic.channels, "frd", Losses())
        measured = concatenate(list(blocks))
    # VQF wants a field with every sample, as these logs have it
    mag = measured.field[np.searchsorted(measured.time_ns, imu.time_ns)] + iron
    gyro, accel = (np.ascontiguousarray(turn_body(v, "flu")) for v in (imu.gyro, imu.accel))
    interval = float(np.diff(imu.time_ns).mean()) / SECOND
    made = (
        vqf.offlineVQF(gyro, accel, mag, interval)["quat9D"],
        vqf.VQF(interval).updateBatch(gyro, accel, mag)["quat9D"],
    )
    others = [errors(imu.time_ns, q_nb_from_log(q, "flu"), path, lag_ms) for q in made]
    return ours, summary, others


def print_tables(trials: Path, lag_ms: float, only: str = "") -> None:
    """Print the table of all trials, without and with iron."""
    head = ["trial", "total", "offline VQF", "VQF", "heading", "spread", "within", "what was found"]
    for iron in (np.zeros(3), np.array(IRON) * 1e-6):
        totals = []

        def rows(iron=iron, totals=totals):
            for path in sorted(trials.glob(f"*_{only}*.mcap")):
                ours, summary, others = run(path, iron, lag_ms)
                m = summary.magnetometer
                totals.append([ours.total, *(e.total for e in others)])
                within = " ".join(f"{100 * v:.0f}" for v in ours.within)
                offset = [] if m.hard_iron_T is None else m.hard_iron_T
                iron_text = " ".join(f"{1e6 * v:.1f}" for v in offset)
                yield [
                    path.stem[6:36],
                    *(f"{v:.2f}" for v in totals[-1]),
                    f"{ours.heading:.2f}",
                    f"{ours.spread:.2f}",
                    within,
                    f"{m.refused or m.north}: trusted {m.trusted:.2f}, scatter {m.scatter_deg:.1f},"
                    f" {1e6 * m.field_T:.1f} uT, dip {m.dip_deg:.1f}, iron"
                    f" {iron_text} +- {1e6 * (m.hard_iron_sigma_T or 0):.1f} uT"
                    f" {'off' if m.hard_iron_removed else 'left'},"
                    f" sigma {m.heading_sigma_deg or 0:.2g}",
                ]

        print_table(head, rows(), f"Total error, deg; iron {iron * 1e6} uT")
        means, medians = (numbers(f(totals, axis=0), ".3f") for f in (np.mean, np.median))
        print(f"mean: {means}; median: {medians}\n")


def main() -> None:
    """Print the tables."""
    options = parser(__doc__, lag_ms=LAG_MS)
    options.add_argument("--trials", type=Path, default=Path(TRIALS))
    options.add_argument("--only", default="")
    chosen = options.parse_args()
    print_tables(chosen.trials, chosen.lag_ms, chosen.only)


if __name__ == "__main__":
    main()
