"""Logs of situations in which a choice was made for the user, was wrong, and nothing was said.

Each function makes one log at random: the drive, its sensors, its receiver and their rates are by
the seed. Trajectories and errors are another program's (`tests/helpers/unseen_drives.py`). What it
returns are the options that a user would give, the truth, and what the result has to say.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.divergence_hunt import SENSORS
from sinstool.api.process import Result
from sinstool.core.finding import Severity
from tests.helpers.imulogs import Message, T0, header, imu_messages, serialised, store, write_log
from tests.helpers.unseen_drives import (
    DEG,
    LEVER,
    RATE,
    Motion,
    Record,
    band_noise,
    drive,
    fix_messages,
    moved,
    motion_of,
    record,
    smoothed,
    within,
    write,
)
from tests.helpers.unseen_errors import slower

Random = np.random.Generator
TURNS_ALONE = 4.4 * DEG  # rad/s, of a gyro that nobody calibrated
# From world and body axes of a log (ENU, FLU) to NED and FRD
WORLD = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLIP = np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class Made:
    """A log, and how it is processed.

    Attributes
    ----------
    what : str
        All that was random about it.
    truth : Motion
    options : dict
        Of `sinstool.process`.
    wants : callable
        What a result lacks, in a few words; '' if nothing.
    """

    path: Path
    what: str
    truth: Motion
    options: dict[str, Any] = field(default_factory=dict)
    wants: Callable[[Result], str] = lambda result: ""


@dataclass(frozen=True)
class Situation:
    """A row of the table.

    Attributes
    ----------
    before : str
        What became of it once.
    make : callable
        The log, by a seed, in a folder.
    says : tuple of str
        Kinds of findings that name the cause.
    never : tuple of str
        Kinds of findings that would be false.
    """

    name: str
    before: str
    make: Callable[[Random, Path], Made]
    says: tuple[str, ...] = ()
    never: tuple[str, ...] = ()


# --- parts of logs -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Instruments:
    """Sensors and a receiver, at random."""

    grade: str
    every: int
    rate: float
    sigma: float
    sigma_v: float

    @classmethod
    def drawn(cls, random: Random) -> Instruments:
        return cls(
            str(random.choice(list(SENSORS))),
            int(random.choice([1, 2, 4])),
            float(random.choice([1.0, 2.0, 5.0, 10.0])),
            float(10.0 ** random.uniform(-1.7, 0.4)),
            float(10.0 ** random.uniform(-1.5, -0.5)),
        )

    def recorded(self, random: Random, truth: Motion, velocity: bool = True) -> Record:
        """At the simulation's rate."""
        sigma_v = self.sigma_v if velocity else None
        seed = int(random.integers(1 << 30))
        return record(
            truth, SENSORS[self.grade], seed, gnss_rate=self.rate, sigma=self.sigma, sigma_v=sigma_v
        )

    def __str__(self) -> str:
        return f"{self.grade} {RATE / self.every:.0f} Hz, fixes {self.rate:g} Hz {self.sigma:.2g} m"


KNOWN = {"gyro_kind": "mean-rate", "lever_arm": tuple(LEVER.tolist())}


def navigates(result: Result) -> str:
    """Whether it makes use of the fixes."""
    mode = result.plan.mode
    return "" if mode.value == "ins-gnss" else f"mode {mode.value}, {mode.reason}"


def town(random: Random, rest: float | None = None, shortest: float = 120.0) -> Motion:
    """A drive of some minutes."""
    rest = float(random.choice([5.0, 20.0, 60.0])) if rest is None else rest
    duration = rest + float(random.uniform(shortest, shortest + 200.0))
    return drive(int(random.integers(1 << 30)), duration, rest)


def finished(
    path: Path, seen: Instruments, data: Record, more: Sequence = (), what: str = "",
    wants: Callable[[Result], str] = navigates, **options: Any,
) -> Made:  # fmt: skip
    """The log of a record, at the rate of its Imu."""
    log = write(path / "log.mcap", slower(data, seen.every), more)
    text = f"{seen}, {data.truth.seconds[-1]:.0f} s" + (f", {what}" if what else "")
    return Made(log, text, data.truth, {**KNOWN, **options}, wants)


def without_gnss(data: Record) -> Record:
    return replace(data, fixes=data.fixes.rows(slice(0, 0)))


def uncalibrated(random: Random, data: Record, size: float = TURNS_ALONE) -> Record:
    """Gyros with a bias of a size, rad/s, in any direction."""
    bias = random.standard_normal(3)
    return replace(data, gyro=data.gyro + bias * (size / np.linalg.norm(bias)) / RATE)


def cut(data: Record, begin: float) -> Record:
    """A log that begins so many seconds later."""
    late, fixes = data.seconds >= begin, data.fixes.rows(data.fixes.seconds >= begin)
    samples = {name: getattr(data, name)[late] for name in ("seconds", "gyro", "accel")}
    return replace(data, fixes=fixes, **samples)


def moving(random: Random, begins: float = 15.0) -> tuple[Motion, float]:
    """A drive, and from when on it moves faster than 5 m/s."""
    truth = town(random, rest=0.0)
    fast = np.linalg.norm(truth.velocity_n, axis=1) > 5.0
    return truth, float(truth.seconds[np.argmax(fast & (truth.seconds > begins))])


def odometry(
    data: Record, velocity_log: np.ndarray, frame: str, child: str | None, topic: str
) -> list[tuple]:
    """Velocities along the axes of the log at 20 Hz, as Odometry, or as a TwistStamped."""
    types = store().types
    vector, point = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Point"]
    still = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    name = "geometry_msgs/msg/TwistStamped" if child is None else "nav_msgs/msg/Odometry"
    out = []
    for k in range(0, len(data.truth.seconds), 10):
        stamp = T0 + round(data.truth.seconds[k] * 1e9) + 1000
        twist = types["geometry_msgs/msg/Twist"](
            vector(*velocity_log[k].tolist()), vector(0.0, 0.0, 0.0)
        )
        if child is None:
            message = types[name](header=header(stamp, frame), twist=twist)
        else:
            pose = types["geometry_msgs/msg/Pose"](point(0.0, 0.0, 0.0), still)
            message = types[name](
                header=header(stamp, frame),
                child_frame_id=child,
                pose=types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
                twist=types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
            )
        out.append((stamp, topic, name, serialised(message, name, 2)))
    return out


def level_speed(truth: Motion) -> np.ndarray:
    return np.hypot(*truth.velocity_n.T[:2])


def turned(truth: Motion, angle: float) -> np.ndarray:
    """Velocities along the axes of a frame that begins with the vehicle's axes, turned."""
    v = truth.velocity_n
    course = np.arctan2(v[:, 0], v[:, 1]) - angle
    speed = level_speed(truth)
    return np.stack([speed * np.cos(course), speed * np.sin(course), -v[:, 2]], axis=1)


# --- velocities that are none of a receiver ----------------------------------------------------


def wheels(random: Random, path: Path, **options: Any) -> Made:
    """Wheel odometry in body axes, with a wrong radius and noise."""
    seen, truth = Instruments.drawn(random), town(random)
    data = seen.recorded(random, truth, velocity=False)
    speed = random.uniform(0.97, 1.03) * level_speed(truth)
    ahead = np.stack([speed, 0.0 * speed, 0.0 * speed], axis=1)
    ahead[:, 0] += 0.03 * random.standard_normal(len(speed)) * (speed > 0.0)
    more = odometry(data, ahead, "odom", "base_link", "/wheels/odometry")
    return finished(path, seen, data, more, **options)


def wheels_named(random: Random, path: Path) -> Made:
    return wheels(random, path, velocity_topic="/wheels/odometry")


def wheels_dropped(random: Random, path: Path) -> Made:
    return wheels(random, path, velocity_topic="none")


def twist_in_odom(random: Random, path: Path) -> Made:
    seen, truth = Instruments.drawn(random), town(random)
    data = seen.recorded(random, truth, velocity=False)
    angle = random.uniform(20.0, 340.0)
    more = odometry(data, turned(truth, angle * DEG), "odom", None, "/odom/twist")
    return finished(path, seen, data, more, f"turned by {angle:.0f} deg")


def course_in_radians(random: Random, path: Path) -> Made:
    """Read as degrees by whoever made speed and course a vector."""
    seen, truth = Instruments.drawn(random), town(random)
    data = seen.recorded(random, truth)
    v = data.fixes.velocity_n
    course = np.arctan2(v[:, 1], v[:, 0]) % (2.0 * np.pi) * DEG
    speed = np.hypot(v[:, 0], v[:, 1])
    wrong = np.stack([speed * np.cos(course), speed * np.sin(course), v[:, 2]], axis=1)
    return finished(path, seen, replace(data, fixes=replace(data.fixes, velocity_n=wrong)))


def no_velocity(random: Random, path: Path) -> Made:
    seen, truth = Instruments.drawn(random), town(random)
    return finished(path, seen, seen.recorded(random, truth, velocity=False))


def two_receivers(random: Random, path: Path) -> Made:
    seen, truth = Instruments.drawn(random), town(random)
    good = seen.recorded(random, truth, velocity=bool(random.random() < 0.5))
    worse = replace(seen, sigma=10.0 * seen.sigma, rate=float(random.choice([1.0, 5.0])))
    poor = worse.recorded(random, truth, velocity=bool(random.random() < 0.5))
    names = random.permutation(["/a", "/b"]).tolist()
    more = [*fix_messages(good.fixes, names[0]), *fix_messages(poor.fixes, names[1])]

    def wants(result: Result) -> str:
        used = f"{names[0]}/fix is used"
        said = any(used in finding.text for finding in result.findings)
        return navigates(result) or ("" if said else "the worse receiver")

    return finished(path, seen, without_gnss(good), more, wants=wants)


# --- parked ------------------------------------------------------------------------------------


def unsettled(
    random: Random, path: Path, seen: Instruments, velocity: bool, **options: Any
) -> Made:
    """A receiver that comes nearer in its first seconds, a knock, and minutes at rest."""
    truth = town(random, rest=float(random.uniform(120.0, 200.0)))
    data = seen.recorded(random, truth, velocity)
    at = random.uniform(5.0, 40.0)
    during = (data.seconds > at) & (data.seconds < at + 0.8)
    wave = np.sin(2.0 * np.pi * (data.seconds[during] - at) / 0.4)[:, None] / RATE
    gyro, accel = data.gyro.copy(), data.accel.copy()
    gyro[during] += 0.05 * wave
    accel[during] += 1.5 * wave
    f, until = data.fixes, random.uniform(10.0, 30.0)
    way = random.uniform(1.0, 3.0) * np.array([*_direction(random), 0.0])
    latitude, longitude, height = moved(
        f.latitude, f.longitude, f.height, np.maximum(until - f.seconds, 0.0)[:, None] * way
    )
    speed = f.velocity_n - (f.seconds < until)[:, None] * way
    fixes = replace(f, latitude=latitude, longitude=longitude, height=height, velocity_n=speed)
    data = replace(data, gyro=gyro, accel=accel, fixes=fixes)
    return finished(path, seen, data, what=f"wanders for {until:.0f} s", **options)


def _direction(random: Random) -> tuple[float, float]:
    angle = random.uniform(0.0, 2.0 * np.pi)
    return float(np.cos(angle)), float(np.sin(angle))


def wandering_receiver(random: Random, path: Path) -> Made:
    return unsettled(random, path, Instruments.drawn(random), bool(random.random() < 0.5))


def wandering_receiver_cut(random: Random, path: Path) -> Made:
    return unsettled(
        random, path, Instruments.drawn(random), bool(random.random() < 0.5), start=8.0
    )


def warming_up(random: Random, path: Path) -> Made:
    """Parked for minutes with velocities of a receiver, while the gyro warms up."""
    seen, truth = Instruments.drawn(random), town(random, rest=float(random.uniform(120.0, 240.0)))
    data = seen.recorded(random, truth)
    warm = random.standard_normal(3) * SENSORS[seen.grade].gyro_bias
    warm = warm * np.exp(-data.seconds[:, None] / random.uniform(30.0, 120.0))
    return finished(path, seen, replace(data, gyro=data.gyro + warm / RATE))


# --- stamps ------------------------------------------------------------------------------------


def jitter(random: Random, path: Path, **options: Any) -> Made:
    """Samples of 5, 10 and 20 ms, one after the other, at some 130 Hz."""
    seen, truth = replace(Instruments.drawn(random), every=1), town(random)
    data = seen.recorded(random, truth)
    shares = random.dirichlet([5.0, 10.0, 2.0])
    ticks = np.cumsum(random.choice([1, 2, 4], len(data.seconds), p=shares))
    ticks = ticks[ticks < len(data.seconds)]
    steps = np.diff(ticks, prepend=0)[:, None]
    gyro, accel = (
        np.diff(np.cumsum(values, axis=0)[ticks], axis=0, prepend=0.0) / steps
        for values in (data.gyro, data.accel)
    )
    uneven = replace(data, seconds=data.seconds[ticks], gyro=gyro, accel=accel)

    def wants(result: Result) -> str:
        gaps = result.summary.imu.gaps
        return navigates(result) or (f"{gaps} gaps" if gaps else "")

    what = f"{len(ticks) / truth.seconds[-1]:.0f} Hz"
    return finished(path, seen, uneven, what=what, wants=wants, **options)


def pauses(random: Random, path: Path) -> Made:
    """Pauses of 60 ms that the user says are none."""
    seen, truth = replace(Instruments.drawn(random), every=1), town(random)
    data = seen.recorded(random, truth)
    begins = np.sort(random.uniform(0.0, truth.seconds[-1], 40))
    there = ~within(data.seconds, [(b, b + 0.06) for b in begins])
    samples = {name: getattr(data, name)[there] for name in ("seconds", "gyro", "accel")}

    def wants(result: Result) -> str:
        gaps = result.summary.imu.gaps
        return navigates(result) or (f"{gaps} gaps" if gaps else "")

    return finished(path, seen, replace(data, **samples), wants=wants, max_gap=0.2)


# --- gyros that nobody calibrated --------------------------------------------------------------


def uncalibrated_car(random: Random, path: Path, given: bool = False) -> Made:
    truth, begin = moving(random)
    seen = Instruments.drawn(random)
    velocity = bool(random.random() < 0.5)
    data = cut(uncalibrated(random, seen.recorded(random, truth, velocity)), begin)
    options: dict[str, Any] = {}
    if given:
        first = slower(data, seen.every).seconds[0]
        attitude = Rotation.from_matrix(truth.c_nb[np.searchsorted(truth.seconds, first - 1e-6)])
        angles = attitude.as_euler("ZYX", degrees=True)[::-1]
        options = {"align": "fixed", "initial_attitude": tuple(angles.tolist())}
    what = "velocity" if velocity else "no velocity"
    return finished(path, seen, data, what=what, **options)


def uncalibrated_car_given(random: Random, path: Path) -> Made:
    return uncalibrated_car(random, path, given=True)


def hand(random: Random, duration: float, spans: Sequence[tuple[float, float]]) -> Motion:
    """Turned and moved about in the hand in some spans, lying still between."""
    t = np.arange(0.0, duration, 1.0 / RATE)
    lively = smoothed(within(t, spans).astype(float), 1.0)[:, None]
    first = np.array([*random.uniform(-0.5, 0.5, 2), random.uniform(-np.pi, np.pi)])
    turns = DEG * np.array([25.0, 20.0, 60.0]) * band_noise(random, t, 0.1, 1.0)
    return motion_of(t, lively * 0.2 * band_noise(random, t, 0.3, 2.0), first + lively * turns)


def resting_hand(random: Random, path: Path, duration: float, spans: Sequence) -> Made:
    truth = hand(random, duration, spans)
    seen = Instruments.drawn(random)
    data = without_gnss(uncalibrated(random, seen.recorded(random, truth)))
    return finished(path, seen, data, wants=lambda result: "")


def rest_after_a_moment(random: Random, path: Path) -> Made:
    """Ten minutes, still but for the first seconds and the last."""
    return resting_hand(random, path, 600.0, [(-1.0, 2.5), (540.0, 700.0)])


def rest_at_the_end(random: Random, path: Path) -> Made:
    length = float(random.uniform(60.0, 240.0))
    return resting_hand(random, path, length + 30.0, [(-1.0, length)])


def rest_between(random: Random, path: Path) -> Made:
    """A car that is in motion first and last, and stands for half a minute between."""
    truth, begin = moving(random)
    seen = Instruments.drawn(random)
    data = cut(uncalibrated(random, seen.recorded(random, truth), 0.5 * TURNS_ALONE), begin)
    return finished(path, seen, without_gnss(data), wants=lambda result: "")


# --- attitudes and axes of the log -------------------------------------------------------------


def imu_only(random: Random, path: Path, make: Callable[..., list[Message]]) -> Made:
    """A car that moves from the first sample on, of which the log has no more than the Imu."""
    truth, begin = moving(random)
    seen = Instruments.drawn(random)
    data = slower(cut(seen.recorded(random, truth), begin), seen.every)
    at = np.searchsorted(truth.seconds, data.seconds - 1e-6)
    q = Rotation.from_matrix(WORLD @ truth.c_nb[at] * FLIP).as_quat()
    stamps = T0 + np.round(data.seconds * 1e9).astype(np.int64)
    messages = make(stamps, data.gyro * RATE, data.accel * RATE, q)
    log = write_log(path / "log.mcap", messages)
    return Made(
        log, f"{seen}, {truth.seconds[-1] - begin:.0f} s", truth, {"gyro_kind": "mean-rate"}
    )


def another_order(random: Random, path: Path) -> Made:
    order = [[3, 0, 1, 2], [1, 2, 3, 0], [3, 2, 1, 0], [1, 0, 2, 3]][int(random.integers(4))]
    made = imu_only(
        random,
        path,
        lambda stamps, gyro, accel, q: imu_messages(
            stamps, gyro * FLIP, accel * FLIP, q_xyzw=q[:, order], covariance=0.0
        ),
    )
    return replace(made, what=f"{made.what}, order {order}")


def right_order(random: Random, path: Path) -> Made:
    return imu_only(
        random,
        path,
        lambda stamps, gyro, accel, q: imu_messages(
            stamps, gyro * FLIP, accel * FLIP, q_xyzw=q, covariance=0.0
        ),
    )


def forward_right_down(random: Random, path: Path, frame: str = "imu_link") -> Made:
    return imu_only(
        random, path, lambda stamps, gyro, accel, q: imu_messages(stamps, gyro, accel, frame=frame)
    )


def named_forward_right_down(random: Random, path: Path) -> Made:
    """By the name of the frame alone, as the axes are others."""
    return imu_only(
        random,
        path,
        lambda stamps, gyro, accel, q: imu_messages(
            stamps, gyro * FLIP, accel * FLIP, frame="base_link_frd"
        ),
    )


def not_increments(random: Random, path: Path, **options: Any) -> Made:
    seen, truth = Instruments.drawn(random), town(random)
    made = finished(path, seen, seen.recorded(random, truth), gyro_kind="increment", **options)
    return replace(made, wants=lambda result: "")


def not_increments_insisted(random: Random, path: Path) -> Made:
    return not_increments(random, path, accel_unit="m/s^2")


# --- a barometer -------------------------------------------------------------------------------


def barometer(random: Random, truth: Motion, off: np.ndarray) -> list[tuple]:
    """Messages at 10 Hz of a barometer that is off by so many metres at the samples."""
    name = "sensor_msgs/msg/FluidPressure"
    out = []
    for k in range(0, len(truth.seconds), round(RATE / 10.0)):
        stamp = T0 + round(truth.seconds[k] * 1e9) + 2000
        height = truth.height[k] + off[k] + 0.2 * random.standard_normal()
        pressure = 101325.0 * (1.0 - 2.25577e-5 * height) ** 5.25588
        message = store().types[name](
            header=header(stamp, "baro"), fluid_pressure=pressure, variance=0.0
        )
        out.append((stamp, "/baro", name, serialised(message, name, 2)))
    return out


def disturbance(random: Random, truth: Motion, lasts: float) -> tuple[str, np.ndarray, float]:
    """Metres by which a barometer is off for some seconds, what it is, and its begin, s."""
    begin, rise = random.uniform(80.0, 100.0), random.uniform(0.05, 3.0)
    size = random.choice([-1.0, 1.0]) * random.uniform(30.0, 80.0)
    t = truth.seconds
    shape = np.clip((t - begin) / rise, 0.0, 1.0) - np.clip((t - begin - lasts) / rise, 0.0, 1.0)
    return f"{size:+.0f} m from {begin:.0f} s on for {lasts:.0f} s", size * shape, begin


def held_height(random: Random, path: Path) -> Made:
    """The barometer alone holds the height, and is off for a while."""
    lasts = float(random.uniform(5.0, 60.0))
    seen, truth = Instruments.drawn(random), town(random, shortest=240.0)
    what, off, begin = disturbance(random, truth, lasts)
    data = seen.recorded(random, truth)
    more = barometer(random, truth, off)

    def wants(result: Result) -> str:
        seconds = (result.solution.time_ns - T0) * 1e-9
        late = seconds > begin + lasts + 60.0
        assert result.solution.vertical is not None
        height = np.interp(seconds[late], truth.seconds, truth.height)
        far = float(np.abs(result.solution.vertical[late, 0] - height).max())
        return f"height {far:.0f} m off" if far > 10.0 else ""

    mode = str(random.choice(["attitude", "ins"]))
    return finished(
        path, seen, data, more, f"{what}, mode {mode}", wants, mode=mode, height_damping="baro"
    )


def filtered_height(random: Random, path: Path) -> Made:
    """The same in a filter, beside GNSS."""
    seen, truth = Instruments.drawn(random), town(random, shortest=240.0)
    what, off, _ = disturbance(random, truth, float(random.uniform(5.0, 60.0)))
    data = seen.recorded(random, truth)
    return finished(path, seen, data, barometer(random, truth, off), what)


def clock_of_heights(random: Random, path: Path) -> Made:
    """A jump for good, in a run that begins later than the log."""
    seen, truth = Instruments.drawn(random), town(random, shortest=240.0)
    what, off, begin = disturbance(random, truth, 1e6)
    data = seen.recorded(random, truth)

    def wants(result: Result) -> str:
        jump = re.compile(r"jumped by \S+ m at ([\d.]+) s")
        found = [jump.search(finding.text) for finding in result.findings]
        times = [float(match[1]) for match in found if match]
        if not times:
            return "no jump is said"
        late = min(abs(time - begin) for time in times)
        return "" if late < 10.0 else f"said {late:.0f} s off"

    mode = str(random.choice(["attitude", "ins"]))
    options = {"mode": mode, "height_damping": "baro", "start": float(random.uniform(10.0, 50.0))}
    more = barometer(random, truth, off)
    return finished(path, seen, data, more, f"{what}, mode {mode}", wants, **options)


# --- innovations -------------------------------------------------------------------------------


def claimed(random: Random, path: Path, factor: float, **options: Any) -> Made:
    """A receiver that states so many times its noise."""
    seen, truth = Instruments.drawn(random), town(random, shortest=240.0)
    data = seen.recorded(random, truth, velocity=bool(random.random() < 0.5))
    fixes = replace(data.fixes, sigma=factor * data.fixes.sigma)

    def wants(result: Result) -> str:
        used = result.summary.filter
        nis = np.nan if used is None else used.mean_nis
        said = "sigmas-off" in {finding.kind for finding in result.findings}
        fits = 0.05 < nis < 5.0
        return navigates(result) or ("" if fits or said else f"squared innovations {nis:.2g}")

    return finished(path, seen, replace(data, fixes=fixes), what=f"claims {factor:.2g}",
                    wants=wants, **options)  # fmt: skip


def too_cautious(random: Random, path: Path) -> Made:
    return claimed(random, path, float(random.uniform(5.0, 30.0)))


def too_bold(random: Random, path: Path) -> Made:
    return claimed(random, path, float(1.0 / random.uniform(10.0, 50.0)))


def wrong_grade(random: Random, path: Path) -> Made:
    """Sensors that are much worse than the grade that the user states; with a page."""
    seen = replace(Instruments.drawn(random), grade=str(random.choice(list(SENSORS)[2:])))
    truth = town(random, shortest=240.0)
    data = seen.recorded(random, truth, velocity=bool(random.random() < 0.5))
    page = path / "page.html"
    grade = str(random.choice(["navigation", "tactical"]))

    def wants(result: Result) -> str:
        lost = [f for f in result.findings if f.severity == Severity.LOST]
        if not lost:
            return ""
        first = re.search(r'class="warnings".*?<li>(.*?)</li>', page.read_text(), re.DOTALL)
        text = "" if first is None else unescape(re.sub("<[^>]+>", "", first[1]))
        return "" if any(f.text[:40] in text for f in lost) else "the page begins otherwise"

    return finished(
        path, seen, data, what=f"called {grade}", wants=wants, imu_grade=grade, report=str(page)
    )


SITUATIONS = (
    Situation("wheel odometry beside fixes", "22 m off at sigma 0.8 m, heading 82 deg, status 0",
              wheels),
    Situation("its topic named as the receiver's velocity", "as above", wheels_named,
              ("velocity-contradicts",)),
    Situation("--velocity-topic none", "no such option", wheels_dropped),
    Situation("a twist in a frame odom", "taken for GNSS velocity", twist_in_odom),
    Situation("course in radians read as degrees", "not noticed", course_in_radians,
              ("velocity-left-out",)),
    Situation("fixes without velocity", "attitude alone, heading 0", no_velocity),
    Situation("two receivers", "attitude alone, not said why", two_receivers,
              ("several-receivers",)),
    Situation("parked, and a receiver that wanders at first", "9.7 km off", wandering_receiver,
              ("unsettled-fixes",), ("moving-rest", "initial-heading")),
    Situation("the same with --start", "4.3 m off, initial heading 92 deg off",
              wandering_receiver_cut, ("unsettled-fixes",), ("moving-rest", "initial-heading")),
    Situation("parked for minutes", "initial heading 79 deg off is said of 0.14", warming_up,
              (), ("initial-heading",)),
    Situation("samples that jitter", "614 gaps, no alignment, 607 warnings", jitter),
    Situation("--max-gap", "without effect", pauses),
    Situation("uncalibrated gyro in a moving car", "refused with a wrong reason",
              uncalibrated_car),
    Situation("the same with its attitude given", "diverges, status 0", uncalibrated_car_given),
    Situation("at rest after 2.5 s of motion", "turns by 43 deg", rest_after_a_moment),
    Situation("at rest at the end", "114 deg rms", rest_at_the_end),
    Situation("at rest in between", "not used", rest_between),
    Situation("quaternions in another order", "67 deg wrong, ok", another_order,
              ("orientation-tilt", "orientation-turns")),
    Situation("quaternions that are right", "-", right_order, (),
              ("orientation-tilt", "orientation-turns")),
    Situation("Forward-Right-Down, begun in motion", "roll -178 deg", forward_right_down,
              ("gravity-axis",)),
    Situation("a frame that is called frd", "no hint", named_forward_right_down,
              ("frame-axes",)),
    Situation("--gyro-kind increment on rates", "blames --accel-unit", not_increments,
              ("no-increments",)),
    Situation("the same with --accel-unit m/s^2", "ok with sigma 5700 deg",
              not_increments_insisted, ("gravity-size",)),
    Situation("a barometer that comes back", "-62 m to the end", held_height),
    Situation("the same beside GNSS", "-", filtered_height),
    Situation("clock of the warnings about height", "since the filter's start", clock_of_heights),
    Situation("a receiver that states too much noise", "no warning", too_cautious),
    Situation("a receiver that states too little", "97 % rejected, status 0", too_bold),
    Situation("sensors worse than --imu-grade", "97 % rejected, status 0", wrong_grade),
)  # fmt: skip
