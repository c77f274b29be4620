"""Logs of sensors with errors that no filter has a state for, on motions of another program.

Biases that end as a sensor warms up or follow the specific force, outputs that are quantised and
clipped, vibration, any mount, stamps with jitter or of receipt, samples that are lost, repeated or
late, and gaps. As in `unseen_drives`, nothing here uses the product; all sizes are drawn at random.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mcap.writer import Writer
from scipy.spatial.transform import Rotation

from tests.helpers.imulogs import IMU, T0, G, store
from tests.helpers.unseen_drives import DEG, HOUR, RATE, Motion, imu_rows

DEG_H, DEG_SQRT_H = DEG / HOUR, DEG / 60.0
Random = np.random.Generator
COLUMNS = "stamps", "received", "gyro", "accel"
FLIP = np.array([1.0, -1.0, -1.0])
MOST_BIAS = 0.5  # m/s^2
FINE = 10  # specific forces that vibrate, for each interval of the trajectory


@dataclass(frozen=True)
class Sensors:
    """Errors of a grade, one sigma of one axis: rad/sqrt(s), rad/s, m/s/sqrt(s), m/s^2, 1.

    Attributes
    ----------
    matrix : float
        Scale factors and cross-axis errors.
    by_force : float
        Gyro bias by specific force, rad/s for each m/s^2.
    warms : float
        Gyro bias that ends as the sensor warms up, rad/s; that of the accelerometer is in
        proportion.
    """

    walk: float
    bias: float
    accel_walk: float
    accel_bias: float
    matrix: float
    by_force: float
    warms: float


GRADES = {
    "consumer": Sensors(0.6 * DEG_SQRT_H, DEG, 2.5e-3, 0.25, 0.01, 0.1 * DEG / G, 0.3 * DEG),
    "mems": Sensors(0.2 * DEG_SQRT_H, 0.2 * DEG, 1.5e-3, 0.05, 3e-3, 0.01 * DEG / G, 0.03 * DEG),
    "industrial": Sensors(
        0.1 * DEG_SQRT_H, 25 * DEG_H, 1e-3, 0.02, 1e-3, 5 * DEG_H / G, 10 * DEG_H
    ),
    "tactical": Sensors(0.03 * DEG_SQRT_H, DEG_H, 5e-4, 0.01, 3e-4, DEG_H / G, 0.5 * DEG_H),
    "navigation": Sensors(
        2e-3 * DEG_SQRT_H, 0.01 * DEG_H, 5e-5, 5e-4, 1e-5, 2e-3 * DEG_H / G, 5e-3 * DEG_H
    ),
}


@dataclass(frozen=True)
class Log:
    """Samples in the order of the file.

    Attributes
    ----------
    stamps, received : ndarray of int64, shape (n,)
        ns since the trajectory began.
    gyro, accel : ndarray, shape (n, 3)
        In FRD, rad/s and m/s^2.
    truth : ndarray, shape (m, 3, 3)
        Attitude of the sensor at the samples of the trajectory.
    late_ns : int
        By which stamps are late in the mean: no log shows that.
    """

    stamps: np.ndarray
    received: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray
    truth: np.ndarray
    late_ns: int = 0

    def rows(self, rows: np.ndarray) -> Log:
        columns = {name: getattr(self, name)[rows] for name in COLUMNS}
        return replace(self, **columns)


def log_uniform(random: Random, low: float, high: float) -> float:
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def mounted(random: Random, moving: Motion) -> tuple[str, np.ndarray, np.ndarray, np.ndarray]:
    """How the sensor is mounted; its rate, specific force and attitude at the trajectory's rate."""
    text, mount = "", np.eye(3)
    if random.random() < 0.6:
        angles = random.choice([0.0, 90.0, 180.0, 270.0], 3)
        mount = Rotation.from_euler("ZYX", angles, degrees=True).as_matrix()
        text = "mounted " + "/".join(f"{angle:.0f}" for angle in angles)
    if random.random() < 0.5:
        mount = mount @ Rotation.from_rotvec(random.normal(0.0, 5.0 * DEG, 3)).as_matrix()
    return text, moving.gyro @ mount * RATE, moving.accel @ mount * RATE, moving.c_nb @ mount


def measured(random: Random, moving: Motion, grade: str) -> tuple[list[str], Log]:
    """What the sensors give."""
    of, texts = GRADES[grade], []
    text, gyro, accel, truth = mounted(random, moving)
    texts.append(text)
    many, n = int(random.choice([1, 1, 2, 4, 8])), len(gyro)
    point = random.random() < 0.2
    texts.append(f"{RATE / many:.0f} Hz" + ", of instants" * point)
    by_force = of.by_force * random.standard_normal((3, 3)) * (random.random() < 0.4)
    matrices = np.eye(3) + of.matrix * random.standard_normal((2, 3, 3))
    t = moving.seconds
    gyro = gyro @ matrices[0] + accel @ by_force + of.bias * random.standard_normal(3)
    bias = np.clip(of.accel_bias * random.standard_normal(3), -MOST_BIAS, MOST_BIAS)
    accel = accel @ matrices[1] + bias
    if by_force.any():
        texts.append("g-sensitive")
    if random.random() < 0.3:
        within = log_uniform(random, 5.0, 300.0)
        cold = np.exp(-(t - t[0]) / within)[:, None] * random.standard_normal((2, 3))[:, None]
        gyro, accel = gyro + of.warms * cold[0], accel + 0.5 * of.accel_bias * cold[1]
        texts.append(f"warms up in {within:.0f} s")
    wide = int(random.choice([2, 4, 16])) if grade in ("consumer", "mems") else 16
    stop = DEG * float(random.choice([250.0, 500.0, 2000.0]))
    if random.random() < 0.25:
        size, hertz = log_uniform(random, 1.0, 20.0), log_uniform(random, 20.0, 150.0)
        accel, turned = shaken(random, t, accel, size, hertz, wide * G)
        gyro = gyro + turned
        texts.append(f"shakes by {size:.1f} m/s^2 at {hertz:.0f} Hz")
    gyro, accel = np.clip(gyro, -stop, stop), np.clip(accel, -wide * G, wide * G)
    texts.append(f"{stop / DEG:.0f} deg/s, {wide} g")
    kept = n // many * many
    if point:
        gyro, accel = gyro[many - 1 : kept : many], accel[many - 1 : kept : many]
    else:
        gyro, accel = (column[:kept].reshape(-1, many, 3).mean(axis=1) for column in (gyro, accel))
    step = np.sqrt(RATE / many)
    gyro = gyro + of.walk * step * random.standard_normal(gyro.shape)
    accel = accel + of.accel_walk * step * random.standard_normal(accel.shape)
    if grade in ("consumer", "mems") and random.random() < 0.7:
        gyro, accel = (
            np.round(column / least) * least
            for column, least in ((gyro, 2000.0 * DEG / 2**15), (accel, 16.0 * G / 2**15))
        )
        texts.append("quantised")
    times = np.round(t[many - 1 : kept : many] * 1e9).astype(np.int64)
    return texts, Log(times, times, gyro, accel, truth)


def shaken(
    random: Random,
    t: np.ndarray,
    accel: np.ndarray,
    size: float,
    hertz: float,
    stop: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Specific force with vibration, as its mean within the stops, and the rate of vibration."""
    wander = 1.0 + 0.02 * np.sin(0.3 * t + random.uniform(0.0, 6.3))
    phase = 2.0 * np.pi * hertz * np.cumsum(wander) / RATE
    fine = phase[:, None] - 2.0 * np.pi * hertz / RATE * np.arange(FINE)[::-1] / FINE
    axes = random.standard_normal((2, 3, 1))
    out = np.empty_like(accel)
    for k in range(3):
        moved = size * axes[0, k] * np.sin(fine + 6.3 * random.random())
        out[:, k] = np.clip(accel[:, k, None] + moved, -stop, stop).mean(axis=1)
    turned = 0.005 * size * axes[1, :, 0] * np.sin(fine + 1.0).mean(axis=1)[:, None]
    return out, turned


def recorded(random: Random, log: Log) -> tuple[list[str], Log]:
    """Faults of the clock, the bus and the recorder."""
    texts, n = [], len(log.stamps)
    interval = float(np.median(np.diff(log.stamps)))
    stamps = log.stamps
    how = random.choice(["", "jitter", "bursts"], p=[0.55, 0.3, 0.15])
    if how == "jitter":
        share = log_uniform(random, 0.01, 0.4)
        late = np.abs(random.normal(0.0, share * interval, n))
        stamps = stamps + np.round(late).astype(np.int64)
        texts.append(f"stamps jitter by {share * interval / 1e6:.2g} ms")
    elif how == "bursts":
        many = int(random.integers(2, 12))
        last = np.minimum((np.arange(n) // many + 1) * many, n) - 1
        stamps = log.stamps[last] + (np.arange(n) % many) * 200_000
        texts.append(f"received in bursts of {many}")
    late_ns = round(float(np.mean(stamps - log.stamps)))
    log = replace(log, stamps=stamps, received=stamps, late_ns=late_ns)
    keep = np.ones(n, bool)
    if random.random() < 0.25:
        share = log_uniform(random, 1e-3, 0.1)
        keep &= random.random(n) >= share
        texts.append(f"{share:.1%} lost")
    if random.random() < 0.3:
        for _ in range(int(random.integers(1, 4))):
            length = log_uniform(random, 0.1, 30.0)
            begin = random.uniform(0.0, 1.0) * (n * interval * 1e-9)
            at = (log.stamps - log.stamps[0]) * 1e-9
            keep &= (at < begin) | (at > begin + length)
            texts.append(f"gap {begin:.0f}+{length:.1f} s")
    rows = np.flatnonzero(keep)
    if random.random() < 0.1:
        rows = np.sort(np.append(rows, random.choice(rows, max(len(rows) // 50, 1))))
        texts.append("repeats")
    if random.random() < 0.1:
        order = rows + np.where(random.random(len(rows)) < 0.01, random.uniform(1, 5), 0.0)
        texts.append("late samples")
        received = np.sort(log.received[rows])
        log = log.rows(rows[np.argsort(order, kind="stable")])
        return texts, replace(log, received=received)
    return texts, log.rows(rows)


def written(path: Path, log: Log) -> Path:
    """An MCAP of IMU in FLU."""
    rows = imu_rows(T0 + log.stamps, log.gyro * FLIP, log.accel * FLIP)
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        text = store().generate_msgdef(IMU, ros_version=2)[0].encode()
        number = writer.register_channel(
            "/imu", "cdr", writer.register_schema(IMU, "ros2msg", text)
        )
        for time, payload in zip((T0 + log.received).tolist(), rows, strict=True):
            writer.add_message(number, time, payload.tobytes(), time)
        writer.finish()
    return path
