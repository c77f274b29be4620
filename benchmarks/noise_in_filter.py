"""What a noise file is worth in the INS/GNSS filter: outages and sigmas with it and with a grade.

For each of three sensors `sinstool allan` measures a rest of some hours. Then drives that the
program has never seen (`pyins.sim`), by the same sensor, go through `process --mode ins-gnss`:
`grade` finds a grade for itself, `noise file` gets the file. Nothing vibrates. A minute without
fixes each: errors at its end, and over their sigma; with GNSS errors over sigmas, whose square is
the NEES of one component: 1 is right, more is too sure.

python benchmarks/noise_in_filter.py
python benchmarks/noise_in_filter.py --draws 1 --duration 900 --rest 3600
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from benchmarks.commands import sinstool
from benchmarks.common import parser, print_table
from benchmarks.trusted_navigation import Score, add, add_outages, process, spans_within
from sinstool.core.streams import Imu
from sinstool.core.units import STANDARD_GRAVITY
from sinstool.simulation.log import write_simulated
from sinstool.simulation.recorded import recorded_topics
from sinstool.simulation.sensors import markov
from tests.helpers.imulogs import T0
from tests.helpers.optimal_filter import SensorErrors
from tests.helpers.unseen_drives import RATE, drive, record, sensor_errors, write

SENSORS = {
    "tactical": sensor_errors(0.02, 0.3, 0.03, 30.0, 300.0, 1.0),
    "industrial": sensor_errors(0.1, 10.0, 0.06, 200.0, 1000.0, 1.0),
    "mems": sensor_errors(0.4, 60.0, 0.15, 1000.0, 2000.0, 0.5),
}
HEAD = ("", "60 s without fixes: hor m (/ sigma)", "ver m", "hor cm", "heading deg (/ sigma)",
        "errors / sigma: position, velocity, tilt, heading", "")  # fmt: skip


def rest_log(path: Path, errors: SensorErrors, seconds: float, seed: int) -> Path:
    """A log of the sensor lying still."""
    random = np.random.default_rng([seed, 7])
    count = round(seconds * RATE)
    time_ns = T0 + np.round(np.arange(count) * 1e9 / RATE).astype(np.int64)
    columns = []
    for white, bias in (
        (errors.angle_random_walk, errors.gyro_bias),
        (errors.velocity_random_walk, errors.accel_bias),
    ):
        drift = bias * markov(count, 1.0 / RATE, errors.time, random, 3)
        columns.append(drift + white * np.sqrt(RATE) * random.standard_normal((count, 3)))
    rates, forces = columns
    scale = errors.accel_scale * markov(count, 1.0 / RATE, errors.time, random)[:, 0]
    forces[:, 2] -= STANDARD_GRAVITY * (1.0 + scale)
    write_simulated(
        path, recorded_topics(Imu(time_ns, time_ns, rates, forces)), {"scenario": "rest"}
    )
    return path


def rows(name: str, args, folder: Path):
    """A row for the grade, and one for the file."""
    errors = SENSORS[name]
    rest, noise = folder / f"{name}-rest.mcap", folder / f"{name}.toml"
    sinstool("allan", rest_log(rest, errors, args.rest, args.seed), "-o", noise, "-q")
    rest.unlink()
    cases = {"grade": [], "noise file": ["--imu-noise", str(noise)]}
    scores = {case: Score() for case in cases}
    spans = spans_within(args.duration)
    withheld = [word for b, e in spans for word in ("--withhold-gnss", f"{b:g}:{e:g}")]
    for seed in range(args.seed, args.seed + args.draws):
        truth = drive(seed, args.duration)
        log = write(folder / f"{name}.mcap", record(truth, errors, seed))
        for case, options in cases.items():
            whole, _, first = process(log, truth, options)
            cut, _, note = process(log, truth, [*options, *withheld])
            if whole is not None:
                add(scores[case], whole, args.settle)
            if cut is not None:
                add_outages(scores[case], cut, spans, False)
            scores[case].notes += filter(None, (first, note))
        log.unlink()
    for case, score in scores.items():
        if not score.with_gnss or not score.outages:
            yield f"{name}, {case}", *("-",) * 5, "; ".join(score.notes)
            continue
        horizontal, heading, outage, vertical, ratios, notes = score.cells()
        yield f"{name}, {case}", outage, vertical, horizontal, heading, ratios, notes


def main() -> None:
    """Print the table."""
    options = parser(__doc__, draws=3, duration=1500.0, seed=1, settle=300.0, rest=10800.0)
    options.add_argument("--sensors", nargs="+", choices=list(SENSORS), default=list(SENSORS))
    args = options.parse_args()
    outages = args.draws * len(spans_within(args.duration))
    title = (
        f"{args.draws} drives of {args.duration:g} s, {outages} outages; {args.rest:g} s of rest"
    )
    with tempfile.TemporaryDirectory() as folder:
        made = (row for name in args.sensors for row in rows(name, args, Path(folder)))
        print_table(HEAD, made, title)


if __name__ == "__main__":
    main()
