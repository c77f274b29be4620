"""Drives, instruments and messages of which `situation_logs.py` makes logs, at random by a seed.

Trajectories and errors are another program's (`tests/helpers/unseen_drives.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.divergence_hunt import CHIPS, SENSORS
from sinstool.api.process import Result
from tests.helpers.imulogs import T0, header, serialised, store
from tests.helpers.unseen_drives import (
    DEG,
    LEVER,
    RATE,
    Motion,
    Record,
    band_noise,
    drive,
    motion_of,
    record,
    smoothed,
    within,
    write,
)
from tests.helpers.unseen_errors import slower

Random = np.random.Generator
CALIBRATED = tuple(grade for grade in SENSORS if grade not in CHIPS)
BARE = ("MEMS", *CHIPS)  # what may have a gyro like this one: better ones are calibrated
TURNS_ALONE = 4.4 * DEG  # rad/s


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
    def drawn(cls, random: Random, grades: Sequence[str] = tuple(SENSORS)) -> Instruments:
        return cls(
            str(random.choice(list(grades))),
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
    """The log of a record, at the rate of its IMU."""
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


def level_speed(truth: Motion) -> np.ndarray:
    return np.hypot(*truth.velocity_n.T[:2])


def hand(random: Random, duration: float, spans: Sequence[tuple[float, float]]) -> Motion:
    """Turned and moved about in the hand in some spans, lying still between."""
    t = np.arange(0.0, duration, 1.0 / RATE)
    lively = smoothed(within(t, spans).astype(float), 1.0)[:, None]
    first = np.array([*random.uniform(-0.5, 0.5, 2), random.uniform(-np.pi, np.pi)])
    turns = DEG * np.array([25.0, 20.0, 60.0]) * band_noise(random, t, 0.1, 1.0)
    return motion_of(t, lively * 0.2 * band_noise(random, t, 0.3, 2.0), first + lively * turns)


def twists(truth: Motion, velocity_n: np.ndarray, frame: str, topic: str) -> list[tuple]:
    """Messages of velocities at 20 Hz."""
    types, name = store().types, "geometry_msgs/msg/TwistStamped"
    vector, out = types["geometry_msgs/msg/Vector3"], []
    for k in range(0, len(truth.seconds), round(RATE / 20.0)):
        stamp = T0 + round(truth.seconds[k] * 1e9) + 1000
        north, east, down = velocity_n[k].tolist()
        twist = types["geometry_msgs/msg/Twist"](vector(east, north, -down), vector(0.0, 0.0, 0.0))
        message = types[name](header=header(stamp, frame), twist=twist)
        out.append((stamp, topic, name, serialised(message, name, 2)))
    return out


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
