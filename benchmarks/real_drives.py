"""Filter and smoother on recorded drives, scored against fixes that they did not see.

Nothing here is the truth: positions are scored against the receiver's own fixes, withheld in
outages; attitude against the receiver's own, less the constant mount between the two, which the
receiver does not know either. The logs are not part of the project; see `--data`.

python benchmarks/real_drives.py --data ../shared/data
python benchmarks/real_drives.py --data ../shared/data --only rtk
"""

from __future__ import annotations

import argparse
import csv
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.common import compensated, rows_of
from sinstool.config import ProcessConfig
from sinstool.config.load import build
from sinstool.core.rotation import conjugate, exp, log, multiply, normalise
from sinstool.core.streams import GnssEpochs, Imu, Solution, concatenate
from sinstool.io.readers.open import open_log
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.fix_velocity import split_position_velocity, velocity_lag
from sinstool.methods.ins_gnss.latency import Latency, correlate, inertial_velocity
from sinstool.methods.ins_gnss.results import FilterBlock, UpdateColumns
from sinstool.methods.ins_gnss.settings import GnssModel, Settings, Start
from sinstool.methods.ins_gnss.smoothed_epochs import SmoothedEpochs
from sinstool.methods.ins_gnss.smoother import Smoother
from sinstool.methods.ins_gnss.start import start_at
from sinstool.methods.ins_gnss.withheld import Withheld
from sinstool.methods.sensor_errors import IMU_GRADES
from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.process.ins_gnss.initial_state import StartFixes, find_start
from sinstool.survey.source import Source, prepare, rate_blocks

# What receivers of these kinds do: RTK in a street, and a car's receiver with corrections.
RTK = GnssModel(
    (0.05, 0.05, 0.05), (0.03, 0.03, 0.05), 30.0, (0.1, 0.1, 0.15), (0.03, 0.03, 0.03), 10.0
)
ROAD = GnssModel((0.4, 0.4, 0.6), (1.0, 1.0, 1.5), 60.0, (0.1, 0.1, 0.15), (0.1, 0.1, 0.1), 20.0)
DRONE = GnssModel(
    (0.3, 0.3, 0.5), (1.0, 1.0, 1.5), 60.0, (0.1, 0.1, 0.15), (0.05, 0.05, 0.05), 20.0
)


TURN_S = 10.0


@dataclass(frozen=True)
class Drive:
    """A log and what is known of it."""

    path: str
    axes: str
    model: GnssModel
    reference: str = ""
    own_sigma: bool = True  # believe the fixes' own
    settle_s: float = 60.0  # until the receiver's own attitude is sound


DRIVES = {
    "turn": Drive(
        "vehicle_gnss/yk_urban_short_turn_loop_nominal_002.mcap",
        "flu",
        ROAD,
        "vehicle_gnss/yk_urban_short_turn_loop_nominal_002.ref_att.csv",
    ),
    "stop-go": Drive(
        "vehicle_gnss/yk_urban_stop_go_large_mount_001.mcap",
        "flu",
        ROAD,
        "vehicle_gnss/yk_urban_stop_go_large_mount_001.ref_att.csv",
        settle_s=210.0,
    ),
    # Fixes that claim 1 cm, while 1 ms of an uncertain clock is 1.5 cm of way
    "rtk": Drive("rtk_drive/rtk_drive_mems_100hz.mcap", "flu", RTK, own_sigma=False),
    "px4": Drive(
        "px4/px4_fmuv6c_inflight_6s.mcap",
        "frd",
        DRONE,
        "px4/px4_fmuv6c_inflight_6s.ref_onboard_att.csv",
    ),
}


@dataclass(frozen=True)
class Log:
    source: Source
    config: ProcessConfig
    imu: Imu
    increments: Increments
    gnss: GnssEpochs


@dataclass(frozen=True)
class Run:
    start: Start
    time_ns: int
    how: str
    block: FilterBlock
    epochs: SmoothedEpochs
    smooth: UpdateColumns
    seconds: float
    text: str

    @property
    def filter(self) -> UpdateColumns:
        assert self.block.updates is not None
        return self.block.updates


def read(folder: Path, drive: Drive) -> Log:
    options = {"input": {"body_axes": drive.axes}, "navigation": {"imu_grade": "mems"}}
    config = build(ProcessConfig, options)
    with open_log(folder / drive.path) as log_file:
        source = prepare(log_file, config)
        imu = concatenate(list(rate_blocks(source, config, source.survey.first_ns)))
    gnss = source.aiding.gnss
    assert gnss is not None
    if not drive.own_sigma:
        gnss = replace(gnss, sigma_position_n=np.full_like(gnss.sigma_position_n, np.nan))
    step = float(np.median(np.diff(imu.time_ns))) * 1e-9
    whole = compensated(imu.time_ns, imu.gyro, imu.accel, step, kind="rate")
    return Log(source, config, imu, whole, gnss)


def settings_of(drive: Drive, latency: float) -> Settings:
    return Settings(
        filter="markov-21", imu=IMU_GRADES["mems"], gnss=drive.model, gnss_latency=latency
    )


def later(increments: Increments, time_ns: int) -> Increments:
    return rows_of(increments, increments.time_ns > time_ns)


def run(
    data: Log,
    settings: Settings,
    withheld: np.ndarray | None = None,
    start: tuple[Start, int] | None = None,
) -> Run:
    hidden = np.zeros(len(data.gnss), bool) if withheld is None else withheld
    if start is None:
        usable = StartFixes.of(data.gnss.rows(~hidden), settings.gnss)
        found = find_start(data.source, data.config, settings, usable)
        first, time_ns, how = found.start, found.time_ns, found.how
    else:
        (first, time_ns), how = start, "given"
    tic = time.perf_counter()
    ran = InsGnssFilter(first, settings, with_baro=False, output=True, store=True)
    block = ran.push(later(data.increments, time_ns), data.gnss, hidden)
    with Smoother(ran.kind) as smoother:
        smoother.push(block)
        epochs = smoother.epochs()
        smooth = concatenate_updates(list(smoother.blocks(epochs)))
    result = ran.summary
    text = f"NIS/row {result.mean_nis:.2f}, {result.epochs_gated} gated, {result.restarts} restarts"
    return Run(first, time_ns, how, block, epochs, smooth, time.perf_counter() - tic, text)


def concatenate_updates(blocks: list[UpdateColumns]) -> UpdateColumns:
    return UpdateColumns(
        **{name: np.concatenate([getattr(b, name) for b in blocks]) for name in vars(blocks[0])}
    )


def find_latency(data: Log, drive: Drive) -> tuple[Latency, float]:
    """From a filter that does not know it; once more from one that does."""
    latency, tic = 0.0, time.perf_counter()
    for _ in range(2):
        answer = run(data, settings_of(drive, latency))
        at = answer.filter
        increments = later(data.increments, answer.time_ns)
        before = np.concatenate([answer.start.nav[None, 6:10], at.q_nb[:-1]])
        velocity = inertial_velocity(
            before,
            increments.velocity_increment,
            increments.interval,
            at.latitude,
            at.height,
            at.velocity_n,
        )
        result = correlate(at.time_ns, velocity, data.gnss.time_ns, data.gnss.velocity_n)
        latency = result.latency_s
    return result, time.perf_counter() - tic


def outages(data: Log, settings: Settings, first: float, length: float, period: float):
    """Largest horizontal error of each outage, and errors over sigma, of filter and smoother."""
    t = (data.gnss.time_ns - data.gnss.time_ns[0]) * 1e-9
    begins = np.arange(first, t[-1] - length - 5.0, period)
    hidden = np.zeros(len(t), bool)
    for begin in begins:
        hidden |= (t >= begin) & (t < begin + length)
    answer = run(data, settings, hidden)
    valid = replace(data.gnss, time_ns=data.gnss.time_ns - round(settings.gnss_latency * 1e9))
    table = []
    for at in (answer.filter, answer.smooth):
        scored = Withheld(valid, hidden, settings.lever_arm_b)
        scored.push(solution(at))
        if at is answer.filter:
            scored.filtered(answer.block.gnss)
        else:
            scored.smoothed(answer.block.gnss, answer.epochs)
        score = scored.score()
        assert score is not None
        table.append(
            [
                (one.largest_horizontal_m, one.largest_in_sigmas, one.rms_in_sigmas)
                for one in score.outages
            ]
        )
    return answer, np.column_stack([begins, *table])


def solution(at: UpdateColumns) -> Solution:
    """What is scored of these outputs."""
    return Solution(
        at.time_ns,
        at.time_ns,
        at.q_nb,
        at.omega_ib_b,
        at.specific_force_b,
        np.stack([at.latitude, at.longitude, at.height], axis=1),
        at.velocity_n,
        covariance_position_n=at.covariance_position_n,
    )


def receiver_attitude(folder: Path, drive: Drive, at: UpdateColumns):
    """Stamps and attitudes of the receiver from when they are sound."""
    with (folder / drive.reference).open() as lines:
        rows = list(csv.reader(line for line in lines if not line.startswith("#")))
    times = [row[0].partition(".") for row in rows[1:]]
    t = np.array([int(s) * 10**9 + int(f.ljust(9, "0")[:9]) for s, _, f in times])
    q = np.array([[float(v) for v in row[1:5]] for row in rows[1:]])
    known = (np.abs(q[:, 1:]).max(axis=1) > 0.0) & (t <= at.time_ns[-1])
    known &= t >= at.time_ns[0] + round(drive.settle_s * 1e9)
    return t[known], q[known]


def attitude_against(t: np.ndarray, q: np.ndarray, at: UpdateColumns):
    """Angles to the receiver's attitude without the constant mount, deg; and the mount."""
    k = np.searchsorted(at.time_ns, t)
    mount = multiply(conjugate(q), at.q_nb[k])
    middle = mount[len(mount) // 2]
    for _ in range(5):
        apart = log(multiply(conjugate(middle), mount))
        near = np.linalg.norm(apart, axis=1) < np.deg2rad(10.0)
        middle = normalise(multiply(middle, exp(np.median(apart[near], axis=0))))
    off = log(multiply(multiply(q, middle), conjugate(at.q_nb[k])))
    return np.rad2deg(off), middle


def turned(imu: Imu, bias: np.ndarray, t: np.ndarray, later: np.ndarray) -> np.ndarray:
    """Rotations from instants to later ones, by the gyros alone."""
    interval = np.diff(imu.time_ns, prepend=imu.time_ns[0])[:, None] * 1e-9
    attitude = exp((imu.gyro - bias) * interval)
    for k in range(1, len(attitude)):
        attitude[k] = multiply(attitude[k - 1], attitude[k])
    last = len(attitude) - 1
    first, then = (np.minimum(np.searchsorted(imu.time_ns, at), last) for at in (t, later))
    return normalise(multiply(conjugate(attitude[first]), attitude[then]))


def against_gyros(
    data: Log, t: np.ndarray, q: np.ndarray, mount: np.ndarray, at: UpdateColumns
) -> tuple[np.ndarray, np.ndarray]:
    """Angles by which the receiver's and our turning is off the gyros' over TURN_S, deg.

    The gyros, less the filter's bias, err by a hundredth of a degree in that time: what is more is
    of the receiver, which is no truth.
    """
    later = np.searchsorted(t, t + round(TURN_S * 1e9))
    rows = np.nonzero(later < len(t))[0]
    later = later[rows]
    raw = np.searchsorted(data.imu.time_ns, at.time_ns)
    bias = np.median(data.imu.gyro[raw] - at.omega_ib_b, axis=0)
    gyros = turned(data.imu, bias, t[rows], t[later])
    theirs = multiply(conjugate(multiply(q[rows], mount)), multiply(q[later], mount))
    k, k_later = np.searchsorted(at.time_ns, t[rows]), np.searchsorted(at.time_ns, t[later])
    ours = multiply(conjugate(at.q_nb[k]), at.q_nb[k_later])
    sizes = (
        np.rad2deg(np.linalg.norm(log(multiply(conjugate(gyros), way)), axis=1))
        for way in (theirs, ours)
    )
    return tuple(sizes)


def report(folder: Path, name: str) -> None:
    drive = DRIVES[name]
    data = read(folder, drive)
    span = (data.imu.time_ns[-1] - data.imu.time_ns[0]) * 1e-9
    print(f"\n{name}: {len(data.imu)} samples, {span:.0f} s, {len(data.gnss)} epochs")
    if name == "px4":
        short(folder, drive, data)
        return
    lag = velocity_lag(data.gnss)
    if lag.status == "found" and abs(lag.latency_s) > 0.02:
        print(
            f"  velocities are stamped {1e3 * lag.latency_s:.0f} +- {1e3 * lag.sigma_s:.1f} ms"
            " later than positions: separated"
        )
        together, _ = find_latency(data, drive)
        print(f"  by velocities as stamped: {together}")
        data = replace(data, gnss=split_position_velocity(data.gnss, lag.latency_s))
    result, seconds = find_latency(data, drive)
    print(f"  {result}, {result.status}, in {seconds:.1f} s")
    latency = result.latency_s if result.status == "found" else 0.0
    settings = settings_of(drive, latency)
    answer = run(data, settings)
    print(f"  start: {answer.how}")
    print(f"  all fixes: {answer.text}; filter, smoother and output {answer.seconds:.1f} s")
    gnss = answer.block.gnss
    ratio = np.sqrt(np.nanmean((gnss.innovation / gnss.innovation_sigma)[gnss.used] ** 2, axis=0))
    print(f"  innovations over their sigma (N E D, v N E D): {np.round(ratio, 2)}")
    if drive.reference:
        t, q = receiver_attitude(folder, drive, answer.filter)
        for label, at in (("filter", answer.filter), ("smoother", answer.smooth)):
            off, mount = attitude_against(t, q, at)
            size = np.linalg.norm(off, axis=1)
            print(
                f"  attitude from the receiver's, {label:8s}: rms {np.sqrt(np.mean(size**2)):.2f},"
                f" 95 % {np.percentile(size, 95):.2f}, heading rms"
                f" {np.sqrt(np.mean(off[:, 2] ** 2)):.2f} deg"
            )
        theirs, ours = against_gyros(data, t, q, mount, answer.smooth)
        for label, size in (("receiver", theirs), ("smoother", ours)):
            print(
                f"  off the gyros' own turning over {TURN_S:.0f} s, {label}: rms"
                f" {np.sqrt(np.mean(size**2)):.2f}, 95 % {np.percentile(size, 95):.2f} deg"
            )
    plans = [(60.0, 120.0, 60.0)] if name == "turn" else [(60.0, 150.0, 150.0)]
    if name == "rtk":
        plans = [(15.0, 45.0, 40.0), (60.0, 150.0, 100.0)]
    for length, period, first in plans:
        answer, table = outages(data, settings, first, length, period)
        rms = np.sqrt(np.mean(table**2, axis=0))
        print(f"  outages of {length:.0f} s: {answer.text}")
        print("    from s   filter m  largest / sigma, all   smoother m  largest / sigma, all")
        for line in table:
            print(
                f"    {line[0]:6.0f} {line[1]:10.2f} {line[2]:16.2f} {line[3]:5.2f}"
                f" {line[4]:12.2f} {line[5]:16.2f} {line[6]:5.2f}"
            )
        print(
            f"    rms    {rms[1]:10.2f} {rms[2]:16.2f} {rms[3]:5.2f}"
            f" {rms[4]:12.2f} {rms[5]:16.2f} {rms[6]:5.2f}"
        )
        if name == "rtk" and length == 15.0:
            print("    published: 7.4 m filter, 7.2 with zero velocity, 0.46 looking back")
            phases(data, settings, length, period)


def phases(data: Log, settings: Settings, length: float, period: float) -> None:
    """The same outages beginning elsewhere: how much of the figures is where they happen to lie."""
    firsts = np.arange(30.0, 30.0 + period, 3.0)
    tables = [outages(data, settings, first, length, period)[1] for first in firsts]
    rms = np.array([np.sqrt(np.mean(table[:, [1, 4]] ** 2, axis=0)) for table in tables])
    every = np.concatenate(tables)
    print(
        f"    beginning at {firsts[0]:.0f}, {firsts[1]:.0f} ... {firsts[-1]:.0f} s, rms of"
        f" {len(every)} outages: filter {np.sqrt(np.mean(every[:, 1] ** 2)):.2f} m (each beginning"
        f" {rms[:, 0].min():.2f} to {rms[:, 0].max():.2f}), smoother"
        f" {np.sqrt(np.mean(every[:, 4] ** 2)):.2f} m ({rms[:, 1].min():.2f} to"
        f" {rms[:, 1].max():.2f}); beyond 3 sigma {100 * np.mean(every[:, 2] > 3):.0f} % and"
        f" {100 * np.mean(every[:, 5] > 3):.0f} %"
    )


def short(folder: Path, drive: Drive, data: Log) -> None:
    """Too short to align: started with the autopilot's attitude, as one whose log holds it."""
    with (folder / drive.reference).open() as lines:
        rows = [line.split(",") for line in lines if line[0].isdigit()]
    seconds = np.array([float(row[0]) for row in rows])
    q = np.array([[float(v) for v in row[1:5]] for row in rows])
    first = max(int(data.gnss.time_ns[0]), int(data.imu.time_ns[0]))
    k = int(np.searchsorted(data.imu.time_ns, first))
    time_ns = int(data.imu.time_ns[k])
    settings = settings_of(drive, 0.0)
    q_nb = q[int(np.argmin(np.abs(seconds - time_ns * 1e-9)))]
    began = start_at(
        time_ns,
        q_nb,
        np.deg2rad(3.0) ** 2 * np.eye(3),
        data.gnss,
        settings,
        gyro_bias_sigma=np.deg2rad(0.5),
    )
    answer = run(data, settings, None, (began, time_ns))
    print(f"  all fixes: {answer.text}")
    gnss = answer.block.gnss
    worst = np.nanmax(np.abs(gnss.innovation / gnss.innovation_sigma), axis=0)
    print(f"  largest innovations over their sigma: {np.round(worst, 1)}")
    for label, at in (("filter", answer.filter), ("smoother", answer.smooth)):
        rows_at = np.clip(
            np.searchsorted(at.time_ns, np.round(seconds * 1e9).astype(np.int64)), 0, len(at) - 1
        )
        use = (seconds * 1e9 >= at.time_ns[0]) & (seconds * 1e9 <= at.time_ns[-1])
        off = np.rad2deg(log(multiply(q[use], conjugate(at.q_nb[rows_at[use]]))))
        size = np.linalg.norm(off, axis=1)
        print(
            f"  attitude from the autopilot's, {label:8s}: rms {np.sqrt(np.mean(size**2)):.2f},"
            f" at the end {size[-1]:.2f} deg"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder with the logs")
    parser.add_argument("--only", nargs="+", choices=list(DRIVES), default=list(DRIVES))
    args = parser.parse_args()
    for name in args.only:
        if (args.data / DRIVES[name].path).exists():
            report(args.data, name)
        else:
            print(f"\n{name}: {args.data / DRIVES[name].path} is not there")


if __name__ == "__main__":
    main()
