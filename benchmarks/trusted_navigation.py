"""INS/GNSS on drives that the program has never seen, beside an optimal filter and smoother.

An hour's drive by another program (`pyins.sim`): 200 Hz, fixes of 5 cm white noise once a second,
no velocity, sensors with Gauss-Markov biases and scale factors, and axes that are misaligned as
data sheets say (--aligned: they are not). `optimal` is the dense filter of
tests/helpers/optimal_filter.py, which gets the exact noise, of 21 states and of 12 more where axes
are misaligned; `told` is `sinstool process` with the same noise by its options; `automatic` gets no
more than the antenna's place.

Errors with GNSS are root mean squares from --settle on, ten a second, over all draws; beside the
heading its error over its sigma. Outages of a minute are of a second run: of a filter the error at
their ends, of a smoother the largest in each, and the horizontal error over its sigma there.

python benchmarks/trusted_navigation.py
python benchmarks/trusted_navigation.py --grade industrial --draws 1 --duration 1200
python benchmarks/trusted_navigation.py --rows told --with "--virtual-noise off"
"""

from __future__ import annotations

import json
import shlex
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from benchmarks.common import numbers, parser, print_table
from sinstool.cli.main import cli
from sinstool.core.units import DEGREE, STANDARD_GRAVITY
from sinstool.io.readers import open_log
from sinstool.io.readers.streams import Losses, read_columns
from tests.helpers.imulogs import T0
from tests.helpers.optimal_filter import SensorErrors, navigate, smooth
from tests.helpers.unseen_drives import (
    FIRST,
    GRADES,
    LEVER,
    Motion,
    Record,
    drive,
    first_state,
    record,
    within,
    without_fixes,
    write,
)

OUTAGE, PERIOD, FIRST_OUTAGE = 60.0, 150.0, 300.0
STEP_NS = 100_000_000  # of instants that are scored
# The program's grade that is nearest, for what no option sets
NEAREST = {"tactical": "navigation", "industrial": "industrial"}
# Of data sheets, rad: 10 arcsec of fibre gyros like these `tactical` ones; industrial 0.01 to
# 0.05 deg (Epson M-G370, ADIS16495)
MISALIGNMENT = {"tactical": 5e-5, "industrial": 2e-4}
Spans = Sequence[tuple[float, float]]
# From world and body axes of a log (ENU, FLU) to NED and FRD
WORLD = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
BODY = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class Answer:
    """What a method says, ten times a second.

    Attributes
    ----------
    seconds : ndarray, shape (m,)
    error, sigma : ndarray, shape (m, 9)
        Position (m), velocity (m/s) and attitude (rad), north, east, down.
    """

    seconds: np.ndarray
    error: np.ndarray
    sigma: np.ndarray


@dataclass
class Score:
    """Sums over draws."""

    with_gnss: list[np.ndarray] = field(default_factory=list)  # (m, 9) errors
    ratios: list[np.ndarray] = field(default_factory=list)  # (m, 9) errors over sigmas
    outages: list[np.ndarray] = field(default_factory=list)  # (outages, 3): horizontal, ratio, down
    notes: list[str] = field(default_factory=list)

    def cells(self) -> list[str]:
        """Of the table."""
        if not self.with_gnss:
            return ["-"] * 7 + self.notes
        error, ratio = np.concatenate(self.with_gnss), np.concatenate(self.ratios)
        level = np.sqrt(np.mean(np.sum(error[:, :2] ** 2, axis=1)))
        heading, off = rms(error[:, 8]) / DEGREE, rms(ratio[:, 8])
        parts = [rms(ratio[:, part]) for part in (slice(0, 3), slice(3, 6), slice(6, 8))]
        out = [rms(column) for column in np.concatenate(self.outages).T] if self.outages else []
        return [
            f"{100.0 * level:.3g}",
            f"{heading:.3g} ({off:.2g})",
            *([f"{out[0]:.3g} ({out[1]:.2g})", f"{out[2]:.3g}"] if out else ["-", "-"]),
            numbers([*parts, off], ".2f"),
            "; ".join(self.notes),
        ]


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def spans_within(duration: float) -> Spans:
    """The outages of a drive."""
    begins = np.arange(FIRST_OUTAGE, duration - OUTAGE - 5.0, PERIOD)
    return [(float(begin), float(begin) + OUTAGE) for begin in begins]


# --- the optimal filter ---------------------------------------------------------------------


def optimal(data: Record, grade: str, seed: int) -> Iterator[Answer]:
    """Filtered, then smoothed."""
    start = first_state(data.truth, data.errors, seed, FIRST[grade])
    ran = navigate(data.seconds, data.gyro, data.accel, data.fixes, start, data.errors, data.lever)
    for at in (ran.after, smooth(ran)):
        error = data.truth.errors_of(
            at.seconds, at.latitude, at.longitude, at.height, at.velocity_n, at.c_nb
        )
        yield Answer(
            at.seconds, error, np.sqrt(np.diagonal(at.covariance, axis1=1, axis2=2)[:, :9])
        )


# --- the program ------------------------------------------------------------------------------


def sensors(grade: str, aligned: bool) -> SensorErrors:
    """Errors of a grade's sensors; misaligned ones as data sheets say."""
    return replace(GRADES[grade], misalignment=0.0 if aligned else MISALIGNMENT[grade])


def same_noise(errors: SensorErrors, grade: str) -> list[str]:
    """Options that say what the optimal filter gets, as far as there are any."""
    values = {
        "--imu-grade": NEAREST[grade],
        "--arw": errors.angle_random_walk * 60.0 / DEGREE,
        "--vrw": errors.velocity_random_walk / (1e-6 * STANDARD_GRAVITY),
        "--sigma-bg": errors.gyro_bias * 3600.0 / DEGREE,
        "--sigma-ba": errors.accel_bias,
        "--sigma-sf": errors.accel_scale,
        "--sigma-misalignment": 1e3 * errors.misalignment,
        "--bias-time": errors.time,
        "--gnss-latency": 0,
        "--gnss-lasting": 0,
    }
    return [str(word) for pair in values.items() for word in pair]


def process(log: Path, truth: Motion, options: Sequence[str]) -> tuple[Answer | None, int, str]:
    """Run the command; what it wrote against the truth, its status, and the end in a few words."""
    out = log.with_suffix(".out.mcap")
    lever = ",".join(str(x) for x in LEVER)
    words = ["process", str(log), "-o", str(out), "--json", "-q", "--overwrite", "--only-results",
             "--compression", "lz4", "--emit", "odometry,fix", "--mode", "ins-gnss",
             "--gyro-kind", "mean-rate", "--lever-arm", lever, *options]  # fmt: skip
    ran = CliRunner().invoke(cli, words, standalone_mode=False)
    status = ran.return_value if isinstance(ran.return_value, int) else ran.exit_code
    if not out.exists():
        text = (ran.stderr or str(ran.exception)).strip()[:120]
        return None, status, f"status {status}: {text}"
    try:
        answer = read_back(out, truth)
    finally:
        out.unlink()
    result = json.loads(ran.stdout)["filter"]
    gated, restarts = result["epochs_gated"], result["restarts"]
    lost = f"{gated} rejected, {restarts} restarts" if gated or restarts else ""
    note = ", ".join(filter(None, [f"status {status}" * bool(status), lost]))
    return answer, status, note


def columns_of(log: Path, topic: str, paths: dict[str, list[str]], widths: dict[str, int]):
    """Seconds and columns of a topic, the first of each tenth of a second."""
    last = -1
    times = {"sec": ["header.stamp.sec"], "nanosec": ["header.stamp.nanosec"]}
    parts, seconds = [], []
    with open_log(log) as opened:
        channels = opened.channels_of(topic)
        for _, values in read_columns(opened, channels, times | paths, Losses(), widths=widths):
            stamp = values["sec"].astype(np.int64) * 10**9 + values["nanosec"].astype(np.int64) - T0
            rows = np.diff(stamp // STEP_NS, prepend=last) > 0
            last = stamp[-1] // STEP_NS
            seconds.append(stamp[rows] * 1e-9)
            parts.append({name: values[name][rows] for name in paths})
    return np.concatenate(seconds), {k: np.concatenate([p[k] for p in parts]) for k in paths}


def read_back(out: Path, truth: Motion) -> Answer:
    """The written odometry and fixes against the truth.

    A message has the velocity in the body's axes, and its covariance allows for how uncertain these
    are: the error is that in the body's axes, too, turned as the message's attitude has them.
    """
    place = {"place": ["latitude", "longitude", "altitude"]}
    seconds, fix = columns_of(out, "/sinstool/fix", place, {})
    paths = {
        "q": [f"pose.pose.orientation.{axis}" for axis in "xyzw"],
        "v": [f"twist.twist.linear.{axis}" for axis in "xyz"],
        "pose": ["pose.covariance"],
        "twist": ["twist.covariance"],
    }
    _, odometry = columns_of(out, "/sinstool/odometry", paths, {"pose": 36, "twist": 36})
    log_axes = Rotation.from_quat(odometry["q"]).as_matrix()
    c_nb = WORLD @ log_axes @ BODY
    velocity = np.einsum("kij,kj->ki", WORLD @ log_axes, odometry["v"])
    pose = odometry["pose"].reshape(-1, 6, 6)
    twist = log_axes @ odometry["twist"].reshape(-1, 6, 6)[:, :3, :3] @ log_axes.transpose(0, 2, 1)
    enu = [np.diagonal(p, axis1=1, axis2=2) for p in (pose[:, :3, :3], twist, pose[:, 3:, 3:])]
    sigma = np.sqrt(np.hstack([variance[:, [1, 0, 2]] for variance in enu]))
    latitude, longitude, height = fix["place"].T
    error = truth.errors_of(seconds, latitude * DEGREE, longitude * DEGREE, height, velocity, c_nb)
    turned = Rotation.from_rotvec(error[:, 6:9])
    error[:, 3:6] = turned.inv().apply(velocity + error[:, 3:6]) - velocity
    return Answer(seconds, error, sigma)


# --- scores -----------------------------------------------------------------------------------


def add(score: Score, answer: Answer, settle: float) -> None:
    """Errors of a run with all fixes."""
    late = answer.seconds >= settle
    score.with_gnss.append(answer.error[late])
    with np.errstate(divide="ignore", invalid="ignore"):
        score.ratios.append(answer.error[late] / answer.sigma[late])


def add_outages(score: Score, answer: Answer, spans: Spans, smoothed: bool) -> None:
    """Errors at the ends of outages, or the largest in them."""
    rows = []
    for span in spans:
        # The fix at its end is used already
        inside = np.flatnonzero(within(answer.seconds, [(span[0], span[1] - 0.01)]))
        error, sigma = answer.error[inside], answer.sigma[inside]
        level = np.hypot(error[:, 0], error[:, 1])
        worst = int(np.argmax(level)) if smoothed else -1
        down = np.abs(error[:, 2])
        of = np.hypot(sigma[worst, 0], sigma[worst, 1])
        rows.append([level[worst], level[worst] / of, down.max() if smoothed else down[-1]])
    score.outages.append(np.array(rows))


def run_draw(
    truth: Motion, grade: str, seed: int, cases: dict[str, list[str]], args, folder: Path
) -> Iterator[tuple[str, Callable[[Score], None]]]:
    """Each method's name, and what puts its answers into a score."""
    errors = sensors(grade, args.aligned)
    data = record(truth, errors, seed)
    spans = spans_within(args.duration)
    broken = without_fixes(data, spans)
    if "optimal" in args.rows:
        pairs = zip(optimal(data, grade, seed), optimal(broken, grade, seed), strict=True)
        for smoothed, (whole, cut) in enumerate(pairs):
            name = "optimal, smoothed" if smoothed else "optimal"
            yield name, adding(whole, cut, spans, bool(smoothed), args.settle)
    if not cases:
        return
    # By a clock of the receiver's own, of which the optimal filter knows
    stamps = data.fixes.seconds * (1.0 + 1e-6 * args.clock)
    stamped = replace(data, fixes=replace(data.fixes, seconds=stamps))
    log = write(folder / f"{grade}-{seed}.mcap", stamped)
    withheld = [word for b, e in spans for word in ("--withhold-gnss", f"{b:g}:{e:g}")]
    for name, options in cases.items():
        for smoothed in (False, True):
            more = [*options, "--smooth"] if smoothed else options
            begun = time.perf_counter()
            whole, _, note = process(log, truth, more)
            spent = time.perf_counter() - begun
            cut, _, other = process(log, truth, [*more, *withheld]) if spans else (None, 0, "")
            text = ", ".join(filter(None, [note, other and f"with outages {other}"]))
            if args.times:
                text += f" {spent:.1f} s"
            label = f"{name}, smoothed" if smoothed else name
            yield label, adding(whole, cut, spans, smoothed, args.settle, text)
    log.unlink()


def adding(
    whole: Answer | None, cut: Answer | None, spans: Spans, smoothed: bool, settle: float, note=""
) -> Callable[[Score], None]:
    def into(score: Score) -> None:
        if whole is not None:
            add(score, whole, settle)
        if cut is not None:
            add_outages(score, cut, spans, smoothed)
        if note:
            score.notes.append(note)

    return into


def table(grade: str, args) -> None:
    noise_options = same_noise(sensors(grade, args.aligned), grade)
    cases = {"told": noise_options, "automatic": []}
    cases = {name: options for name, options in cases.items() if name in args.rows}
    more: dict[str, list[str]] = {}
    for text in args.more:
        # Without rows of the program, beside the one that is told everything
        for name, words in list(cases.items()) or [("told", noise_options)]:
            more[f"{name}, {text}"] = [*words, *shlex.split(text)]
    cases |= more
    scores: dict[str, Score] = {}
    truth = drive(args.seed, args.duration)
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(args.seed, args.seed + args.draws):
            for name, into in run_draw(truth, grade, seed, cases, args, Path(folder)):
                into(scores.setdefault(name, Score()))
    count = args.draws * len(spans_within(args.duration))
    head = ["", "hor cm", "heading deg (/ sigma)", "60 s, hor m (/ sigma)", "ver m",
            "errors / sigma: position, velocity, tilt, heading", ""]  # fmt: skip
    title = f"\n{grade}: {args.draws} draws of {args.duration:g} s, {count} outages"
    print_table(head, ([name, *score.cells()] for name, score in scores.items()), title)


def main() -> None:
    options = parser(__doc__, draws=3, duration=3600.0, seed=1, settle=300.0)
    options.add_argument("--grade", nargs="+", choices=list(GRADES), default=list(GRADES))
    rows = ("optimal", "told", "automatic")
    options.add_argument("--rows", nargs="*", choices=rows, default=rows)
    options.add_argument(
        "--with",
        dest="more",
        action="append",
        default=[],
        metavar="OPTIONS",
        help="one more row for each of told and automatic, with these options; repeatable",
    )
    options.add_argument("--aligned", action="store_true", help="the axes of all sensors are right")
    options.add_argument(
        "--clock", type=float, default=0.0, help="by how much the receiver's is fast, ppm"
    )
    options.add_argument("--times", action="store_true", help="seconds of each run")
    args = options.parse_args()
    for grade in args.grade:
        table(grade, args)


if __name__ == "__main__":
    main()
