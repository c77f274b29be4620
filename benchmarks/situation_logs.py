"""Logs of situations in which a choice was made for the user, was wrong, and nothing was said.

Each function makes one log at random: the drive, its sensors, its receiver and their rates are by
the seed (`situation_parts.py`). With it come the options that a user would give, the truth, and
what the result must not lack.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.divergence_hunt import CHANGES, SENSORS
from benchmarks.situation_parts import (
    BARE,
    CALIBRATED,
    TURNS_ALONE,
    Instruments,
    Made,
    Random,
    barometer,
    cut,
    disturbance,
    finished,
    hand,
    moving,
    navigates,
    town,
    twists,
    uncalibrated,
    without_gnss,
)
from sinstool.api.process import Result
from sinstool.core.finding import Severity
from tests.helpers.imulogs import T0, imu_messages, write_log
from tests.helpers.unseen_drives import DEG, RATE, Motion, fix_messages, moved, within
from tests.helpers.unseen_errors import slower
from tests.pipelines.process.ins_gnss.test_doubtful_logs import knocked
from tests.survey.test_velocity import in_body, odometry, radians_as_degrees, turned

# From world and body axes of a log (ENU, FLU) to NED and FRD
WORLD = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLIP = np.array([1.0, -1.0, -1.0])


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
        Kinds of findings that name the cause, or the option that a refusal names.
    never : tuple of str
        Kinds of findings that would be false.
    """

    name: str
    before: str
    make: Callable[[Random, Path], Made]
    says: tuple[str, ...] = ()
    never: tuple[str, ...] = ()


# --- velocities that are none of a receiver ----------------------------------------------------


def wheels(random: Random, path: Path, **options: Any) -> Made:
    """Wheel odometry in body axes, with a wrong radius and noise."""
    seen, truth = Instruments.drawn(random), town(random)
    data, size = seen.recorded(random, truth, velocity=False), random.uniform(0.97, 1.03)
    more = odometry(truth, lambda v: size * in_body(v) * random.normal(1.0, 0.002))
    return finished(path, seen, data, more, **options)


def wheels_named(random: Random, path: Path) -> Made:
    made = wheels(random, path, velocity_topic="/wheels/odometry")
    return replace(made, wants=lambda result: "")


def wheels_dropped(random: Random, path: Path) -> Made:
    return wheels(random, path, velocity_topic="none")


def twist_in_odom(random: Random, path: Path) -> Made:
    """Velocities along the axes that the vehicle had where it was switched on, or any others."""
    seen, truth = Instruments.drawn(random), town(random)
    data = seen.recorded(random, truth, velocity=False)
    angle = random.uniform(20.0, 340.0)
    more = twists(truth, turned(truth.velocity_n, angle * DEG), "odom", "/odom/twist")
    return finished(path, seen, data, more, f"turned by {angle:.0f} deg")


def course_in_radians(random: Random, path: Path) -> Made:
    """Read as degrees by whoever made speed and course a vector."""
    seen, truth = Instruments.drawn(random), town(random)
    data = seen.recorded(random, truth)
    wrong = radians_as_degrees(data.fixes.velocity_n)
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
    sound = data = seen.recorded(random, truth, velocity)
    data = knocked(data, random.uniform(5.0, 40.0))  # the truth does not know of it
    data = replace(data, gyro=sound.gyro)
    f, until = data.fixes, random.uniform(10.0, 30.0)
    way = random.uniform(1.0, 3.0) * np.array([*_direction(random), 0.0])
    latitude, longitude, height = moved(
        f.latitude, f.longitude, f.height, np.maximum(until - f.seconds, 0.0)[:, None] * way
    )
    speed = f.velocity_n - (f.seconds < until)[:, None] * way
    fixes = replace(f, latitude=latitude, longitude=longitude, height=height, velocity_n=speed)
    return finished(
        path, seen, replace(data, fixes=fixes), what=f"wanders for {until:.0f} s", **options
    )


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
    warm = random.standard_normal(3) * min(SENSORS[seen.grade].gyro_bias, CHANGES[0])
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
    seen = Instruments.drawn(random, BARE)
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


def resting_hand(random: Random, path: Path, duration: float, spans: Sequence) -> Made:
    truth = hand(random, duration, spans)
    seen = Instruments.drawn(random, BARE)
    data = without_gnss(uncalibrated(random, seen.recorded(random, truth)))
    return finished(path, seen, data, wants=lambda result: "")


def rest_after_a_moment(random: Random, path: Path) -> Made:
    """Ten minutes, still but for the first seconds and the last."""
    return resting_hand(random, path, 600.0, [(-1.0, 2.5), (540.0, 700.0)])


def rest_at_the_end(random: Random, path: Path) -> Made:
    length = float(random.uniform(60.0, 240.0))
    return resting_hand(random, path, length + 30.0, [(-1.0, length)])


def rest_between(random: Random, path: Path) -> Made:
    """A car that is in motion first and last, and stands for ten seconds at least between."""
    while True:
        truth, begin = moving(random)
        if _stands(truth, begin) > 10.0:
            break
    seen = Instruments.drawn(random, BARE)
    data = cut(uncalibrated(random, seen.recorded(random, truth), 0.5 * TURNS_ALONE), begin)
    return finished(path, seen, without_gnss(data), wants=lambda result: "")


def _stands(truth: Motion, begin: float) -> float:
    """The longest stop after a time, s."""
    stands = (np.linalg.norm(truth.velocity_n, axis=1) < 1e-6) & (truth.seconds > begin)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], stands.astype(int), [0]])))
    return float(max(np.diff(edges)[::2], default=0)) / RATE


# --- attitudes and axes of the log -------------------------------------------------------------


def imu_only(
    random: Random,
    path: Path,
    order: Sequence[int] = (),
    frame: str = "imu_link",
    right: bool = False,
) -> Made:
    """A car that moves from the first sample on, of which the log has no more than the IMU.

    Parameters
    ----------
    order : sequence of int
        Of the numbers of its orientations; without it they are placeholders.
    frame : str
        The name of the IMU's.
    right : bool
        Its axes are Forward-Right-Down.
    """
    truth, begin = moving(random)
    seen = Instruments.drawn(random, CALIBRATED)
    data = slower(cut(seen.recorded(random, truth), begin), seen.every)
    at = np.searchsorted(truth.seconds, data.seconds - 1e-6)
    flip = RATE * (np.ones(3) if right else FLIP)
    q = Rotation.from_matrix(WORLD @ truth.c_nb[at] * FLIP).as_quat()
    told = {"q_xyzw": q[:, list(order)], "covariance": 0.0} if order else {}
    stamps = T0 + np.round(data.seconds * 1e9).astype(np.int64)
    messages = imu_messages(stamps, data.gyro * flip, data.accel * flip, frame=frame, **told)
    what = f"{seen.grade}, {truth.seconds[-1] - begin:.0f} s, order {list(order)}"
    log = write_log(path / "log.mcap", messages)
    return Made(log, what, truth, {"gyro_kind": "mean-rate"})


def another_order(random: Random, path: Path) -> Made:
    orders = [3, 0, 1, 2], [1, 2, 3, 0], [3, 2, 1, 0], [1, 0, 2, 3]
    return imu_only(random, path, orders[int(random.integers(4))])


def right_order(random: Random, path: Path) -> Made:
    return imu_only(random, path, (0, 1, 2, 3))


def forward_right_down(random: Random, path: Path) -> Made:
    return imu_only(random, path, right=True)


def named_forward_right_down(random: Random, path: Path) -> Made:
    """By the name of the frame alone, as the axes are others."""
    return imu_only(random, path, frame="base_link_frd")


def not_increments(random: Random, path: Path, **options: Any) -> Made:
    seen, truth = Instruments.drawn(random), town(random)
    made = finished(path, seen, seen.recorded(random, truth), gyro_kind="increment", **options)
    return replace(made, wants=lambda result: "")


def not_increments_insisted(random: Random, path: Path) -> Made:
    return not_increments(random, path, accel_unit="m/s^2")


# --- a barometer -------------------------------------------------------------------------------


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
    seen, truth = Instruments.drawn(random), town(random, rest=30.0, shortest=240.0)
    what, off, begin = disturbance(random, truth, 1e6)
    data = seen.recorded(random, truth)
    late = float(random.uniform(15.0, 50.0))
    if random.random() < 0.5:  # a filter that starts later than the log
        data, began = replace(data, fixes=data.fixes.rows(data.fixes.seconds > late)), 0.0
        options: dict[str, Any] = {"height_damping": "baro"}
    else:
        options, began = {"mode": "ins", "height_damping": "baro", "start": late}, late

    def wants(result: Result) -> str:
        jump = re.compile(r"height reference (?:jumped|is good again).* at ([\d.]+) s")
        found = [jump.search(finding.text) for finding in result.findings]
        times = [float(match[1]) for match in found if match]
        if not times:
            return "no jump is said"
        apart = min(abs(time + began - begin) for time in times)
        return "" if apart < 10.0 else f"said {apart:.0f} s off"

    what = f"{what}, begins at {late:.0f} s"
    return finished(path, seen, data, barometer(random, truth, off), what, wants, **options)


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
    Situation("a twist in a frame odom", "taken for GNSS velocity", twist_in_odom,
              ("velocity-left-out",)),
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
    Situation("at rest after 2.5 s of motion", "turns by 43 deg", rest_after_a_moment,
              (), ("no-rest",)),
    Situation("at rest at the end", "114 deg rms", rest_at_the_end, (), ("no-rest",)),
    Situation("at rest in between", "not used", rest_between, (), ("no-rest",)),
    Situation("quaternions in another order", "67 deg wrong, ok", another_order,
              ("orientation-tilt", "orientation-turns")),
    Situation("quaternions that are right", "-", right_order, (),
              ("orientation-tilt", "orientation-turns")),
    Situation("Forward-Right-Down, begun in motion", "roll -178 deg", forward_right_down,
              ("gravity-axis",)),
    Situation("a frame that is called frd", "no hint", named_forward_right_down,
              ("frame-axes",)),
    Situation("--gyro-kind increment on rates", "blames --accel-unit", not_increments,
              ("--gyro-kind",)),
    Situation("the same with --accel-unit m/s^2", "ok with sigma 5700 deg",
              not_increments_insisted, ("no-increments", "--gyro-kind")),
    Situation("a barometer that comes back", "-62 m to the end", held_height),
    Situation("the same beside GNSS", "-", filtered_height),
    Situation("clock of the warnings about height", "since the filter's start", clock_of_heights),
    Situation("a receiver that states too much noise", "no warning", too_cautious),
    Situation("a receiver that states too little", "97 % rejected, status 0", too_bold),
    Situation("sensors worse than --imu-grade", "97 % rejected, status 0", wrong_grade,
              ("imu-options",)),
)  # fmt: skip
