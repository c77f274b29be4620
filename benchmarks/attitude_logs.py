"""Attitude without GNSS on recorded logs, beside the public best, held against their references.

`process --mode attitude` from log to log, smoothed and inertial, and on the same samples VQF, its
offline variant (package vqf) and imufusion, all without a magnetometer. Inclination is the angle
between the verticals of estimate and reference, as a root mean square over the rows that a
reference marks as movement, or all that it can answer for; heading is what is left of its error
when its median is removed. Errors over sigma are those of tilt, over what the output says.

Then with the magnetometers of the trials with an optical reference, as they are and with a constant
field in body axes added, as iron beside the sensor adds it: root mean square of the whole angle,
the reference's north as it is.

The logs are not part of the project; see `--data`. References of vehicles are their receivers' or
autopilots' own, and not the truth: what is constant between the two sensors' axes is fitted. Cars
with GNSS are held against this tool's own INS/GNSS too, smoothed, whose tilt GNSS velocities show;
so are the references of their receivers.

python benchmarks/attitude_logs.py --data ../shared/data
python benchmarks/attitude_logs.py --data ../shared/data --only broad --lag 0.004
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.attitudes import (
    Attitudes,
    Errors,
    errors,
    imufusion,
    read_reference,
    rms_deg,
    shares,
    vqf,
)
from benchmarks.common import FloatArray, numbers, parser, print_table
from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.core.rotation import conjugate, from_dcm, multiply, rotate
from sinstool.core.streams import Imu, concatenate
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.io.readers.frames import enu_to_ned_covariance, q_nb_from_log
from sinstool.io.readers.open import open_log
from sinstool.io.readers.streams import Losses, read_columns, read_field
from sinstool.pipelines.process import compass
from sinstool.pipelines.process.result import ProcessResult
from sinstool.pipelines.process.run import process
from sinstool.pipelines.process.summary import MagnetometerUsed
from sinstool.survey.magnetometer import choose_magnetometer, read_magnetometer
from sinstool.survey.source import imu_blocks, prepare

DOWN = np.array([0.0, 0.0, 1.0])
IRON = (15.0, 10.0, -8.0)  # uT, FRD
THINNED = 10  # samples of INS/GNSS, of which each is held against one


@dataclass(frozen=True)
class Reference:
    """A log whose attitude something else knows.

    Attributes
    ----------
    settle_s : float
        Until the reference is sound.
    axes : {'flu', 'frd'}
        Of the log's IMU.
    world : {'flu', 'frd'}
        Of the reference: FLU in a world with z up, or FRD in NED.
    mounted : bool
        Whether both have the same axes; else what is constant between them is fitted.
    gnss : bool
        Whether the log has fixes too. A log without another reference has an empty one.
    """

    name: str
    path: str
    reference: str
    settle_s: float = 0.0
    axes: str = "flu"
    world: str = "flu"
    mounted: bool = True
    gnss: bool = False


CONSUMER = Reference("car, consumer IMU", "rtk_drive/rtk_drive_mems_100hz", "", gnss=True)
VEHICLES = (
    Reference("EuRoC V1_01, drone", "euroc/euroc_V1_01_easy", ".ref_corrected.csv", mounted=False),
    Reference(
        "car, short turns",
        "vehicle_gnss/yk_urban_short_turn_loop_nominal_002",
        ".ref_att.csv",
        60.0,
        world="frd",
        mounted=False,
        gnss=True,
    ),
    Reference(
        "car, stop and go",
        "vehicle_gnss/yk_urban_stop_go_large_mount_001",
        ".ref_att.csv",
        210.0,
        world="frd",
        mounted=False,
        gnss=True,
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


def samples(path: Path, config: ProcessConfig) -> Imu:
    """All samples of the log's IMU, by time, FRD."""
    with open_log(path) as log:
        source = prepare(log, config)
        return concatenate(list(imu_blocks(source, source.survey.first_ns)))


def ours(path: Path, config: ProcessConfig) -> tuple[Attitudes, ProcessResult]:
    """`process` from log to log."""
    columns = {
        "sec": ["header.stamp.sec"],
        "nanosec": ["header.stamp.nanosec"],
        "q": [f"orientation.{axis}" for axis in "wxyz"],
        "covariance": ["orientation_covariance"],
    }
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "out.mcap"
        result = process(path, output, config)
        with open_log(output) as log:
            channels = log.channels_of("/sinstool/imu")
            read = read_columns(log, channels, columns, Losses(), widths={"covariance": 9})
            blocks = [values for _, values in read]
    of = {name: np.concatenate([block[name] for block in blocks]) for name in columns}
    time_ns = of["sec"].astype(np.int64) * SECOND + of["nanosec"].astype(np.int64)
    covariance = of["covariance"].reshape(-1, 3, 3)
    if config.output.world == "enu":
        covariance = enu_to_ned_covariance(covariance)
    q = q_nb_from_log(of["q"], config.input.body_axes)
    return Attitudes(time_ns, q, covariance if covariance.any() else None), result


# --- without a magnetometer -------------------------------------------------------------------


def fitted_mount(found: Attitudes, true: Attitudes) -> FloatArray:
    """Rotation of the sensor's axes to the reference's that makes their verticals agree."""
    inside = (true.time_ns >= found.time_ns[0]) & (true.time_ns <= found.time_ns[-1])
    pair = (found.at(true.time_ns[inside]), true.q_nb[inside])
    ours_, theirs = (rotate(conjugate(q), np.broadcast_to(DOWN, (len(q), 3))) for q in pair)
    u, _, vt = np.linalg.svd(theirs.T @ ours_)
    matrix = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return np.asarray(from_dcm(matrix))


def configured(attitude: str, axes: str) -> ProcessConfig:
    """Attitude alone, of one kind."""
    return build(
        ProcessConfig,
        {
            "input": {"gnss_topic": "none", "velocity_topic": "none", "body_axes": axes},
            "navigation": {"mode": "attitude", "attitude": attitude, "magnetometer": "none"},
            "output": {"world": "enu" if axes == "flu" else "ned"},
        },
    )


def methods(path: Path, axes: str) -> Iterator[Callable[[], Attitudes]]:
    """All that are compared: smoothed, inertial, offline VQF, VQF, imufusion."""
    yield lambda: ours(path, configured("smoothed", axes))[0]
    yield lambda: ours(path, configured("inertial", axes))[0]
    imu = samples(path, configured("inertial", axes))
    yield lambda: vqf(imu, True)
    yield lambda: vqf(imu, False)
    yield lambda: imufusion(imu)


HEAD = (
    "log", "smoothed", "inertial", "offline VQF", "VQF", "imufusion",
    "heading: smoothed, offline VQF", "largest", "errors / sigma", "within 2.5 sigma",
)  # fmt: skip


def held_against(path: Path, reference: Reference, late_s: float) -> list[Errors]:
    """Errors of every method on a log."""
    return compared(path, reference, of_reference(path, reference, late_s))


def of_reference(path: Path, reference: Reference, late_s: float = 0.0) -> Attitudes:
    """What a reference says, from when it is sound."""
    file = path.with_name(path.name.removesuffix(".mcap") + reference.reference)
    return read_reference(file, reference.world, reference.settle_s, late_s)


def compared(path: Path, reference: Reference, true: Attitudes) -> list[Errors]:
    """Errors of every method on a log, the mount fitted where it has to be."""
    found = []
    for method in methods(path, reference.axes):
        one, theirs = method(), true
        if not reference.mounted:
            theirs = replace(true, q_nb=multiply(true.q_nb, fitted_mount(one, true)))
        found.append(errors(one, theirs))
    return found


def over_sigma(smoothed: Errors) -> tuple[float, float]:
    """Errors of tilt over their sigmas: root mean square, and share within 2.5."""
    over = smoothed.tilt_over_sigma()
    assert over is not None
    return float(np.sqrt(np.mean(over**2))), shares(over, (2.5,))[0]


def row(name: str, every: list[Errors]) -> tuple[str, ...]:
    """A row of the table: inclination by every method, then of the smoothed attitude the rest."""
    smoothed = every[0]
    heading = (rms_deg(every[k].heading_about_median) for k in (0, 2))
    size, within = over_sigma(smoothed)
    return (
        name,
        *(f"{rms_deg(one.inclination):.2f}" for one in every),
        numbers(heading, ".2f"),
        f"{smoothed.inclination.max() / DEGREE:.2f}",
        f"{size:.2f}",
        f"{within:.3f}",
    )


def broad(data: Path, late_s: float) -> None:
    """The trials with an optical reference."""
    found: list[list[Errors]] = []

    def rows() -> Iterator[tuple[str, ...]]:
        for path in sorted((data / "broad").glob("*.mcap")):
            found.append(held_against(path, Reference("", "", ".ref.csv"), late_s))
            yield row(path.stem, found[-1])

    title = f"BROAD, inclination in deg, reference {1e3 * late_s:g} ms late"
    print_table(HEAD, rows(), title)
    if not found:
        return
    tilt = np.array([[rms_deg(one.inclination) for one in every] for every in found])
    heading = np.array([[rms_deg(one.heading_about_median) for one in every] for every in found])
    for k, name in enumerate(HEAD[1:6]):
        print(
            f"{name}: mean inclination {tilt[:, k].mean():.3f} deg, worst {tilt[:, k].max():.2f};"
            f" mean heading {heading[:, k].mean():.2f} deg"
        )
    print(
        f"smoothed less offline VQF: at most {(tilt[:, 0] - tilt[:, 2]).max():+.3f} deg on a trial"
    )
    sizes, within = np.transpose([over_sigma(every[0]) for every in found])
    print(
        f"errors over sigma, rms over all trials: {np.sqrt(np.mean(sizes**2)):.2f}; within 2.5"
        f" sigma: {within.mean():.3f}\n"
    )


def vehicles(data: Path) -> None:
    """The logs whose reference is their own."""
    rows = (
        row(one.name, held_against(data / f"{one.path}.mcap", one, 0.0))
        for one in VEHICLES
        if (data / f"{one.path}.mcap").exists()
    )
    print_table(HEAD, rows, "Vehicles, inclination in deg, the constant mount of each fitted")


def by_gnss(data: Path) -> None:
    """Cars with GNSS, against this tool's own INS/GNSS."""
    notes = []

    def rows() -> Iterator[tuple[str, ...]]:
        for one in (*VEHICLES, CONSUMER):
            path = data / f"{one.path}.mcap"
            if not (one.gnss and path.exists()):
                continue
            config = {"input": {"body_axes": one.axes}, "filter": {"smooth": True}}
            navigation = {"navigation": {"mode": "ins-gnss"}}
            ins = ours(path, build(ProcessConfig, config | navigation))[0]
            true = Attitudes(ins.time_ns[::THINNED], ins.q_nb[::THINNED])
            if one.reference:
                theirs = of_reference(path, one)
                true = true.rows(true.time_ns >= theirs.time_ns[0])
                mounted = multiply(theirs.q_nb, fitted_mount(ins, theirs))
                apart = errors(ins, replace(theirs, q_nb=mounted))
                notes.append(f"{one.name}: {rms_deg(apart.inclination):.2f} deg")
            yield row(one.name, compared(path, replace(one, mounted=False), true))

    title = "Cars against INS/GNSS, smoothed, inclination in deg, the constant mount of each fitted"
    print_table(HEAD, rows(), title)
    if notes:
        print("receivers' own attitude against INS/GNSS: " + "; ".join(notes))


# --- with a magnetometer ----------------------------------------------------------------------


def with_iron(iron: FloatArray) -> AbstractContextManager[object]:
    """Whatever `process` reads of a magnetometer has iron beside it."""

    def read(*args: Any) -> Any:
        measured, findings = read_magnetometer(*args)
        return measured and replace(measured, field=measured.field + iron), findings

    return patch.object(compass, "read_magnetometer", read)


def field(path: Path, imu: Imu) -> FloatArray:
    """The field at every sample, which these logs have, FRD."""
    with open_log(path) as log:
        source = prepare(log, ProcessConfig())
        topic = choose_magnetometer(log, None, source.imu_topic, source.body_frame)
        measured = concatenate(list(read_field(log, topic.channels, "flu", Losses())))
    return np.asarray(measured.field[np.searchsorted(measured.time_ns, imu.time_ns)])


def with_magnetometer(data: Path, late_s: float, iron: FloatArray) -> None:
    """The trials, as they are or with iron."""
    totals: list[list[float]] = []

    def rows() -> Iterator[tuple[str, ...]]:
        for path in sorted((data / "broad").glob("*.mcap")):
            with with_iron(iron):
                smoothed, result = ours(path, ProcessConfig())
            imu = samples(path, ProcessConfig())
            mag = field(path, imu) + iron
            found = (smoothed, vqf(imu, True, mag), vqf(imu, False, mag))
            true = read_reference(path.with_suffix(".ref.csv"), late_s=late_s)
            every = [errors(one, true) for one in found]
            totals.append([rms_deg(one.total) for one in every])
            best = every[0]
            assert best.sigma is not None and result.smoothing is not None
            heading = shares(best.heading / best.sigma[:, 2], (1.0, 2.0, 3.0))
            yield (
                path.stem[6:36],
                *(f"{v:.2f}" for v in totals[-1]),
                f"{rms_deg(best.heading):.2f}",
                f"{rms_deg(best.heading_about_median):.2f}",
                numbers((100.0 * v for v in heading), ".0f"),
                told(result.smoothing.magnetometer),
            )

    head = (
        "trial", "smoothed", "offline VQF", "VQF", "heading: smoothed", "median removed",
        "% within 1, 2, 3 sigma", "what was found",
    )  # fmt: skip
    added = numbers(1e6 * iron, "g")
    print_table(head, rows(), f"BROAD with its magnetometers, whole angle in deg; iron {added} uT")
    for what, of in (("mean", np.mean), ("median", np.median)):
        if totals:
            print(f"{what}: {numbers(of(totals, axis=0), '.2f')}")
    print()


def told(m: MagnetometerUsed | None) -> str:
    """What the summary says of a magnetometer, on one line."""
    if m is None:
        return ""
    iron = numbers((1e6 * v for v in m.hard_iron_T or ()), ".1f")
    return (
        f"{m.refused or m.north}: trusted {m.trusted:.2f}, scatter {m.scatter_deg:.1f},"
        f" {1e6 * m.field_T:.1f} uT, dip {m.dip_deg:.1f}, iron {iron} +-"
        f" {1e6 * (m.hard_iron_sigma_T or 0.0):.1f} uT {'off' if m.hard_iron_removed else 'left'},"
        f" sigma {m.heading_sigma_deg or 0.0:.2g}"
    )


def main() -> None:
    """Print the tables."""
    p = parser(__doc__, lag=0.0)
    p.add_argument("--data", type=Path, required=True)
    p.add_argument("--only", choices=("broad", "magnetometer", "vehicles"))
    args = p.parse_args()
    if args.only in (None, "broad"):
        broad(args.data, args.lag)
    if args.only in (None, "magnetometer"):
        for iron in (np.zeros(3), 1e-6 * np.array(IRON)):
            with_magnetometer(args.data, args.lag, iron)
    if args.only in (None, "vehicles"):
        vehicles(args.data)
        by_gnss(args.data)


if __name__ == "__main__":
    main()
