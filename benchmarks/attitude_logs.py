"""Attitude without GNSS on recorded logs, beside the public best, held against their references.

`process --mode attitude` from log to log, smoothed and inertial, and on the same samples VQF, its
offline variant (package vqf) and imufusion, all without a magnetometer; then with one, and with
iron added to it (`broad_magnetometer.py`). Inclination is the angle
between the verticals of estimate and reference, as a root mean square over the rows that a
reference marks as movement, or all that it can answer for; heading is what is left of its error
when its median is removed. Errors over sigma are those of tilt, over what the output says.

The logs are not part of the project; see `--data`. References of vehicles are their receivers' or
autopilots' own, and not the truth: what is constant between the two sensors' axes is fitted.

python benchmarks/attitude_logs.py --data ../shared/data
python benchmarks/attitude_logs.py --data ../shared/data --only broad --lag 0.004
"""

from __future__ import annotations

import csv
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from benchmarks.broad_magnetometer import print_tables
from benchmarks.common import FloatArray, numbers, parser, print_table
from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.core.rotation import conjugate, from_dcm, log, multiply, rotate
from sinstool.core.streams import Imu, concatenate
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.io.readers.frames import SWAP_ENU_NED, q_nb_from_log, turn_body
from sinstool.io.readers.open import open_log
from sinstool.io.readers.streams import Losses, read_columns
from sinstool.io.readers.truth import at_times
from sinstool.pipelines.process.run import process
from sinstool.survey.source import imu_blocks, prepare

DOWN = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Reference:
    """A log whose attitude something else knows.

    Attributes
    ----------
    settle_s : float
        Until the reference is sound.
    axes : {'flu', 'frd'}
        Of the log's Imu.
    world : {'flu', 'frd'}
        Of the reference: FLU in a world with z up, or FRD in NED.
    mounted : bool
        Whether both have the same axes; else what is constant between them is fitted.
    """

    name: str
    path: str
    reference: str
    settle_s: float = 0.0
    axes: str = "flu"
    world: str = "flu"
    mounted: bool = True


VEHICLES = (
    Reference("EuRoC V1_01, drone", "euroc/euroc_V1_01_easy", ".ref_corrected.csv", mounted=False),
    Reference(
        "car, short turns",
        "vehicle_gnss/yk_urban_short_turn_loop_nominal_002",
        ".ref_att.csv",
        60.0,
        world="frd",
        mounted=False,
    ),
    Reference(
        "car, stop and go",
        "vehicle_gnss/yk_urban_stop_go_large_mount_001",
        ".ref_att.csv",
        210.0,
        world="frd",
        mounted=False,
    ),
    Reference(
        "PX4 2016, multicopter",
        "px4/px4_sample_2016_auavx21",
        ".ref_onboard_att.csv",
        axes="frd",
        world="frd",
        mounted=False,
    ),
    Reference(
        "PX4 FMUv6C in flight, 6 s",
        "px4/px4_fmuv6c_inflight_6s",
        ".ref_onboard_att.csv",
        axes="frd",
        world="frd",
        mounted=False,
    ),
)


@dataclass(frozen=True)
class Attitudes:
    """Attitude at instants: q_nb, and its covariance in NED where there is one."""

    time_ns: np.ndarray
    q_nb: FloatArray
    covariance_n: FloatArray | None = None


@dataclass(frozen=True)
class Score:
    """Errors of an attitude, deg: of inclination, of heading, over sigma."""

    inclination: float
    largest: float
    heading: float
    over_sigma: float | None
    within: float | None  # share of the errors within 2.5 sigma


def read_reference(path: Path, world: str, settle_s: float) -> tuple[np.ndarray, FloatArray]:
    """Times and q_nb of the rows that count."""
    with path.open(newline="", encoding="utf-8") as stream:
        rows = [r for r in csv.DictReader(line for line in stream if line[0] != "#") if r["qw"]]
    times = np.array([int(Decimal(r["time_s"]) * SECOND) for r in rows])
    q = np.array([[float(r[c]) for c in ("qw", "qx", "qy", "qz")] for r in rows])
    good = np.isfinite(q).all(axis=1) & (times >= times[0] + settle_s * SECOND)
    if "movement" in rows[0]:
        good &= np.array([float(r["movement"]) > 0.0 for r in rows])
    if settle_s:
        good &= np.abs(q[:, 0]) < 1.0  # no attitude yet
    return times[good], q_nb_from_log(q[good], world)


def samples(path: Path, config: ProcessConfig) -> Imu:
    """All samples of the log's Imu, by time, FRD."""
    with open_log(path) as log_:
        source = prepare(log_, config)
        return concatenate(list(imu_blocks(source, source.survey.first_ns)))


def ours(path: Path, config: ProcessConfig) -> Attitudes:
    """`process` from log to log."""
    columns = {
        "sec": ["header.stamp.sec"],
        "nanosec": ["header.stamp.nanosec"],
        "q": [f"orientation.{axis}" for axis in "wxyz"],
        "covariance": ["orientation_covariance"],
    }
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "out.mcap"
        process(path, output, config)
        with open_log(output) as log_:
            channels = log_.channels_of("/sinstool/imu")
            read = read_columns(log_, channels, columns, Losses(), widths={"covariance": 9})
            blocks = [values for _, values in read]
    of = {name: np.concatenate([block[name] for block in blocks]) for name in columns}
    time_ns = of["sec"].astype(np.int64) * SECOND + of["nanosec"].astype(np.int64)
    covariance = of["covariance"].reshape(-1, 3, 3)
    if config.output.world == "enu":
        covariance = SWAP_ENU_NED @ covariance @ SWAP_ENU_NED
    q = q_nb_from_log(of["q"], config.input.body_axes)
    return Attitudes(time_ns, q, covariance if covariance.any() else None)


def vqf(imu: Imu, offline: bool) -> Attitudes:
    """VQF without a magnetometer, on samples at their mean interval."""
    from vqf import VQF, offlineVQF

    interval = float(np.median(np.diff(imu.time_ns))) / SECOND
    gyro = np.ascontiguousarray(turn_body(imu.gyro, "flu"))
    accel = np.ascontiguousarray(turn_body(imu.accel, "flu"))
    if offline:
        q = offlineVQF(gyro, accel, None, interval)["quat6D"]
    else:
        q = VQF(interval).updateBatch(gyro, accel)["quat6D"]
    return Attitudes(imu.time_ns, q_nb_from_log(q, "flu"))


def imufusion(imu: Imu) -> Attitudes:
    """imufusion as its documentation sets it up, without a magnetometer."""
    import imufusion as fusion

    interval = float(np.median(np.diff(imu.time_ns))) / SECOND
    ahrs = fusion.Ahrs()
    ahrs.set_sample_period(interval)
    gyro = turn_body(imu.gyro, "flu") / DEGREE
    accel = turn_body(imu.accel, "flu") / 9.80665
    q = np.empty((len(imu), 4))
    for k in range(len(imu)):
        ahrs.update_no_magnetometer(gyro[k], accel[k])
        q[k] = ahrs.get_quaternion()
    return Attitudes(imu.time_ns, q_nb_from_log(q, "flu"))


def score(
    found: Attitudes, times: np.ndarray, true: FloatArray, lag_s: float, mounted: bool
) -> Score:
    """Errors of an attitude against a reference whose stamps are early by a lag."""
    at = times + round(lag_s * SECOND)
    inside = (at >= found.time_ns[0]) & (at <= found.time_ns[-1])
    at, true = at[inside], true[inside]
    q = at_times(found.time_ns, found.q_nb, at)
    if not mounted:
        true = multiply(true, fitted_mount(q, true))
    error = multiply(true, conjugate(q))
    heading = 2.0 * np.arctan2(error[:, 3], error[:, 0])
    middle = np.angle(np.mean(np.exp(1j * heading)))
    off = np.angle(np.exp(1j * (heading - middle)))
    off -= np.median(off)
    # What is left of an error when its turn about the vertical is taken out lies level.
    zero = np.zeros(len(error))
    turn = np.stack([np.cos(heading / 2), zero, zero, np.sin(heading / 2)], axis=1)
    tilt = log(multiply(conjugate(turn), error))[:, :2]
    inclination = np.linalg.norm(tilt, axis=1)
    over = within = None
    if found.covariance_n is not None:
        row = np.clip(np.searchsorted(found.time_ns, at), 0, len(found.time_ns) - 1)
        sigma = np.sqrt(np.einsum("nii->ni", found.covariance_n[row])[:, :2])
        over = float(np.sqrt(np.mean((tilt / sigma) ** 2)))
        within = float(np.mean(np.abs(tilt) < 2.5 * sigma))
    return Score(
        float(np.sqrt(np.mean(inclination**2)) / DEGREE),
        float(inclination.max() / DEGREE),
        float(np.sqrt(np.mean(off**2)) / DEGREE),
        over,
        within,
    )


def fitted_mount(q: FloatArray, true: FloatArray) -> FloatArray:
    """Rotation of the sensor's axes to the reference's that makes their verticals agree."""
    ours_, theirs = (
        rotate(conjugate(one), np.broadcast_to(DOWN, (len(one), 3))) for one in (q, true)
    )
    u, _, vt = np.linalg.svd(theirs.T @ ours_)
    matrix = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return np.asarray(from_dcm(matrix))


def configured(attitude: str, axes: str) -> ProcessConfig:
    """Attitude alone, of one kind."""
    return build(
        ProcessConfig,
        {
            "input": {"gnss_topic": "none", "body_axes": axes},
            "navigation": {"mode": "attitude", "attitude": attitude, "magnetometer": "none"},
            "output": {"world": "enu" if axes == "flu" else "ned"},
        },
    )


def methods(path: Path, axes: str) -> Iterator[Callable[[], Attitudes]]:
    """All that are compared: smoothed, inertial, offline VQF, VQF, imufusion."""
    yield lambda: ours(path, configured("smoothed", axes))
    yield lambda: ours(path, configured("inertial", axes))
    imu = samples(path, configured("inertial", axes))
    yield lambda: vqf(imu, True)
    yield lambda: vqf(imu, False)
    yield lambda: imufusion(imu)


HEAD = (
    "log", "smoothed", "inertial", "offline VQF", "VQF", "imufusion",
    "heading: smoothed, offline VQF", "largest", "errors / sigma", "within 2.5 sigma",
)  # fmt: skip


def row(
    name: str, path: Path, reference: Reference, lag_s: float, scores: list[list[Score]]
) -> tuple[object, ...]:
    """A row of the table: inclination by every method, then of the smoothed attitude the rest."""
    file = path.with_name(path.name.removesuffix(".mcap") + reference.reference)
    times, true = read_reference(file, reference.world, reference.settle_s)
    all_ = [
        score(method(), times, true, lag_s, reference.mounted)
        for method in methods(path, reference.axes)
    ]
    scores.append(all_)
    best = all_[0]
    return (
        name,
        *(f"{one.inclination:.2f}" for one in all_),
        numbers((best.heading, all_[2].heading), ".2f"),
        f"{best.largest:.2f}",
        numbers((best.over_sigma,), ".2f"),
        numbers((best.within,), ".3f"),
    )


def broad(data: Path, lag_s: float) -> None:
    """The trials with an optical reference."""
    scores: list[list[Score]] = []
    trials = sorted((data / "broad").glob("*.mcap"))
    of = Reference("", "", ".ref.csv")
    print_table(
        HEAD,
        (row(path.stem, path, of, lag_s, scores) for path in trials),
        f"BROAD, inclination in deg, reference {1e3 * lag_s:g} ms late",
    )
    if not scores:
        return
    for k, name in enumerate(HEAD[1:6]):
        tilt = [one[k].inclination for one in scores]
        heading = [one[k].heading for one in scores]
        print(
            f"{name}: mean inclination {np.mean(tilt):.3f} deg, worst {max(tilt):.2f}; mean heading"
            f" {np.mean(heading):.2f} deg"
        )
    worse = max(one[0].inclination - one[2].inclination for one in scores)
    over = np.sqrt(np.mean([one[0].over_sigma ** 2 for one in scores]))  # type: ignore[operator]
    within = np.mean([one[0].within for one in scores])  # type: ignore[misc]
    print(f"smoothed less offline VQF: at most {worse:+.3f} deg on a trial")
    print(f"errors over sigma, rms over all trials: {over:.2f}; within 2.5 sigma: {within:.3f}\n")
    print_tables(data / "broad", 1e3 * lag_s)


def main() -> None:
    """Print the tables."""
    p = parser(__doc__, lag=0.0)
    p.add_argument("--data", type=Path, required=True)
    p.add_argument("--only", choices=("broad", "vehicles"))
    args = p.parse_args()
    if args.only != "vehicles":
        broad(args.data, args.lag)
    if args.only != "broad":
        rows = (
            row(one.name, args.data / f"{one.path}.mcap", one, 0.0, [])
            for one in VEHICLES
            if (args.data / f"{one.path}.mcap").exists()
        )
        print_table(HEAD, rows, "Vehicles, inclination in deg, the constant mount of each fitted")


if __name__ == "__main__":
    main()
