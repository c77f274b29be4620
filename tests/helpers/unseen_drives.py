"""Drives and flights by another program's simulation, their sensors' errors, faults, and logs.

Trajectories are splines, of which `pyins.sim` gives the exact increments. Nothing here uses the
product: what it makes is data that the product has never seen.
"""

from dataclasses import dataclass, replace

import numpy as np
from mcap.writer import Writer
from pyins import earth
from pyins.sim import generate_imu
from scipy.signal import butter, oaconvolve, sosfiltfilt
from scipy.spatial.transform import Rotation

from tests.helpers.imulogs import IMU, T0, header, imu_messages, serialised, store
from tests.helpers.optimal_filter import (
    SIZE,
    Fixes,
    Navigation,
    SensorErrors,
    gravity,
    metres,
    moved,
)

DEG, HOUR = np.pi / 180.0, 3600.0
MGAL = 1e-5
RATE = 200.0
PLACE = (48.7, 9.2, 60.0)  # deg, deg, m
LEVER = np.array([0.6, 0.3, -1.35])
FIX_SIGMA = 0.05


def sensor_errors(walk, bias, accel_walk, accel_bias_mgal, scale_ppm, hours):
    """From deg/sqrt(h), deg/h and m/s/sqrt(h)."""
    return SensorErrors(
        walk * DEG / np.sqrt(HOUR),
        accel_walk / np.sqrt(HOUR),
        bias * DEG / HOUR,
        accel_bias_mgal * MGAL,
        scale_ppm * 1e-6,
        scale_ppm * 1e-6,
        hours * HOUR,
    )


GRADES = {
    "tactical": sensor_errors(0.003, 0.027, 0.03, 15.0, 300.0, 4.0),
    "industrial": sensor_errors(0.1, 25.0, 0.1, 200.0, 1000.0, 1.0),
}
# A cheap sensor that somebody calibrated
CONSUMER = sensor_errors(0.4, 150.0, 0.15, 1500.0, 3000.0, 0.5)
# What nobody calibrated, as phones have it
PHONE = sensor_errors(0.4, 360.0, 0.12, 20000.0, 5000.0, 100.0)
# Sigmas of a filter's first tilt and heading, deg, and velocity, m/s
FIRST = {"tactical": (0.01, 0.2, 0.02), "industrial": (0.05, 2.0, 0.02)}


@dataclass(frozen=True)
class Motion:
    """The truth at the samples, and the increments of a perfect IMU (frd) that end at each.

    Attributes
    ----------
    seconds, latitude, longitude, height : ndarray, shape (n,)
        s, rad, rad, m.
    velocity_n, c_nb : ndarray, shape (n, 3), (n, 3, 3)
    gyro, accel : ndarray, shape (n, 3)
        rad, m/s; those of the first sample are the second's.
    """

    seconds: np.ndarray
    latitude: np.ndarray
    longitude: np.ndarray
    height: np.ndarray
    velocity_n: np.ndarray
    c_nb: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray

    def errors_of(self, seconds, latitude, longitude, height, velocity_n, c_nb):
        """Truth less a navigation at any times, shape (m, 9): m, m/s, and psi in rad."""
        k = np.clip(np.searchsorted(self.seconds, seconds - 1e-6), 1, len(self.seconds) - 1)
        # Between samples the motion is all but straight
        back = ((self.seconds[k] - seconds) / (self.seconds[k] - self.seconds[k - 1]))[:, None]
        back[np.abs(back) < 1e-3] = 0.0

        def at(column):
            rows = column.reshape(len(column), -1)
            return (rows[k] - back * (rows[k] - rows[k - 1])).reshape(-1, *column.shape[1:])

        step = np.swapaxes(self.c_nb[k], 1, 2) @ self.c_nb[k - 1]
        turn = Rotation.from_rotvec(back * Rotation.from_matrix(step).as_rotvec()).as_matrix()
        place = (at(column) for column in (self.latitude, self.longitude, self.height))
        return np.hstack(
            [
                metres(*place, latitude, longitude, height),
                at(self.velocity_n) - velocity_n,
                Rotation.from_matrix(self.c_nb[k] @ turn @ np.swapaxes(c_nb, 1, 2)).as_rotvec(),
            ]
        )


@dataclass(frozen=True)
class Record:
    """What a log holds, and the truth beside it.

    Attributes
    ----------
    seconds, gyro, accel : ndarray, shape (n,), (n, 3), (n, 3)
        Samples: increments, frd.
    fixes : Fixes
        At the times of their stamps.
    lever : ndarray, shape (3,)
        The antenna's place, frd, m.
    """

    truth: Motion
    errors: SensorErrors
    seconds: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray
    fixes: Fixes
    lever: np.ndarray


# --- trajectories ------------------------------------------------------------------------------


def drive(seed, duration=3600.0, rest=120.0, rough=1.0):
    """A car: up to 25 m/s, a sixth of the time at rest, turns, hills and a rough road.

    Parameters
    ----------
    duration, rest : float
        In all, and at rest at the start, s.
    rough : float
        How much the road shakes it; 0 for a floor.
    """
    random = np.random.default_rng([seed, 1])
    t = np.arange(0.0, duration, 1.0 / RATE)
    speed = smoothed(stop_and_go(random, t, rest), 2.0)
    sideways = smoothed(random_levels(random, t, (4.0, 12.0), 2.5), 2.0)
    turning = sideways * speed / np.maximum(speed, 7.0) ** 2
    heading = running_integral(turning, 2.0 * np.pi * random.random())
    way = running_integral(speed)
    slope = np.zeros_like(t)
    for length in (300.0, 700.0, 1500.0, 4000.0):
        phase = 2.0 * np.pi * random.random()
        slope += 0.012 * np.cos(2.0 * np.pi * way / length + phase)
    level = speed / np.sqrt(1.0 + slope**2)
    forward = np.gradient(speed, t)
    shaking = rough * np.minimum(speed / 15.0, 1.0)[:, None]
    velocity = np.stack([level * np.cos(heading), level * np.sin(heading), -level * slope], axis=1)
    velocity += shaking * (np.array([0.006, 0.006, 0.015]) * band_noise(random, t, 1.5, 9.0))
    angles = np.stack(
        [0.004 * turning * speed, np.arctan(slope) + 0.004 * forward, heading], axis=1
    )
    angles += shaking * (DEG * np.array([0.2, 0.15, 0.05]) * band_noise(random, t, 1.5, 9.0))
    return motion_of(t, velocity, angles)


def flight(seed, duration=600.0, turbulent=False):
    """An aircraft at 60 m/s in banked turns, in the air from the start on."""
    random = np.random.default_rng([seed, 2])
    t = np.arange(0.0, duration, 1.0 / RATE)
    speed = 60.0 + smoothed(random_levels(random, t, (20.0, 60.0), 4.0), 15.0)
    bank = smoothed(random_levels(random, t, (10.0, 40.0), 25.0 * DEG), 8.0)
    climb = smoothed(random_levels(random, t, (30.0, 60.0), 2.0), 15.0)
    velocity, angles = banked(random, t, speed, bank, climb)
    if turbulent:
        velocity += 0.7 * band_noise(random, t, 0.1, 1.0) + 0.05 * band_noise(random, t, 1.0, 8.0)
        angles += DEG * (band_noise(random, t, 0.1, 1.0) + 0.2 * band_noise(random, t, 1.0, 8.0))
    return motion_of(t, velocity, angles)


def straight_flight(seed, straight=250.0, duration=420.0):
    """An aircraft at 60 m/s that flies straight and level for some time, and then turns."""
    random = np.random.default_rng([seed, 12])
    t = np.arange(0.0, duration, 1.0 / RATE)
    bank = smoothed(random_levels(random, t, (10.0, 40.0), 25.0 * DEG), 8.0)
    bank *= np.clip((t - straight) / 10.0, 0.0, 1.0)
    return motion_of(t, *banked(random, t, np.full_like(t, 60.0), bank, np.zeros_like(t)))


def banked(random, t, speed, bank, climb):
    """Velocity through the air, and angles, of an aircraft in coordinated turns."""
    heading = running_integral(9.81 * np.tan(bank) / speed, 2.0 * np.pi * random.random())
    velocity = np.stack([speed * np.cos(heading), speed * np.sin(heading), -climb], axis=1)
    return velocity, np.stack([bank, 0.05 + climb / speed, heading], axis=1)


def boat(seed, duration=600.0):
    """A boat in waves and a current: at anchor for a minute, then under way with leeway."""
    random = np.random.default_rng([seed, 3])
    t = np.arange(0.0, duration, 1.0 / RATE)
    under_way = np.clip((t - 60.0) / 30.0, 0.0, 1.0)
    speed = under_way * (5.0 + smoothed(random_levels(random, t, (30.0, 90.0), 2.0), 20.0))
    turning = under_way * smoothed(random_levels(random, t, (15.0, 45.0), 0.06), 8.0)
    heading = running_integral(turning, 2.0 * np.pi * random.random())
    leeway = under_way * (0.3 + 0.5 * random.random()) * np.sign(random.standard_normal())
    current = random.uniform(-0.6, 0.6, 2) * under_way[:, None]
    velocity = np.stack(
        [
            speed * np.cos(heading) - leeway * np.sin(heading) + current[:, 0],
            speed * np.sin(heading) + leeway * np.cos(heading) + current[:, 1],
            np.zeros_like(t),
        ],
        axis=1,
    )
    velocity += np.array([0.15, 0.15, 0.3]) * band_noise(random, t, 0.1, 0.4)
    angles = np.stack([np.zeros_like(t), np.zeros_like(t), heading], axis=1)
    angles += DEG * np.array([4.0, 2.0, 1.0]) * band_noise(random, t, 0.1, 0.4)
    return motion_of(t, velocity, angles)


def walk(seed, duration=600.0):
    """A hand-held IMU on a walk: steps, pauses, and looking about."""
    random = np.random.default_rng([seed, 4])
    t = np.arange(0.0, duration, 1.0 / RATE)
    speed = smoothed(np.where(random_levels(random, t, (10.0, 40.0), 1.0) > -0.1, 1.4, 0.0), 2.0)
    way = running_integral(
        smoothed(random_levels(random, t, (5.0, 20.0), 0.5), 3.0), 6.3 * random.random()
    )
    look = way + smoothed(random_levels(random, t, (4.0, 15.0), 2.0), 3.0)
    velocity = np.stack([speed * np.cos(way), speed * np.sin(way), np.zeros_like(t)], axis=1)
    steps = speed[:, None] / 1.4
    velocity += np.array([0.15, 0.15, 0.25]) * steps * band_noise(random, t, 1.5, 2.5)
    velocity += 0.03 * band_noise(random, t, 0.5, 3.0)
    angles = np.stack([np.zeros_like(t), np.full_like(t, 0.3), look], axis=1)
    angles += DEG * 4.0 * band_noise(random, t, 0.2, 3.0)
    return motion_of(t, velocity, angles)


def multicopter(seed, duration=600.0):
    """It leans to where it goes, in any direction of its body, and hovers."""
    random = np.random.default_rng([seed, 5])
    t = np.arange(0.0, duration, 1.0 / RATE)
    velocity = np.stack(
        [smoothed(random_levels(random, t, (5.0, 20.0), most), 4.0) for most in (8.0, 8.0, 2.0)],
        axis=1,
    )
    velocity += 0.1 * band_noise(random, t, 0.2, 2.0)
    turning = smoothed(random_levels(random, t, (5.0, 20.0), 0.5), 3.0)
    heading = running_integral(turning, 6.3 * random.random())
    force = np.gradient(velocity, t, axis=0) / 9.81
    c, s = np.cos(heading), np.sin(heading)
    ahead, right = force[:, 0] * c + force[:, 1] * s, force[:, 1] * c - force[:, 0] * s
    angles = np.stack([np.arctan(right), -np.arctan(ahead), heading], axis=1)
    angles += DEG * 0.5 * band_noise(random, t, 0.5, 8.0)
    return motion_of(t, velocity, angles)


def cruise(duration=300.0, heading=0.7):
    """An aircraft that flies straight on at 60 m/s, with nothing that changes."""
    t = np.arange(0.0, duration, 1.0 / RATE)
    velocity = np.tile([60.0 * np.cos(heading), 60.0 * np.sin(heading), 0.0], (len(t), 1))
    return motion_of(t, velocity, np.tile([0.0, 0.05, heading], (len(t), 1)))


def smoothed(values, width):
    """Mean over a window of so many seconds; what is constant for longer stays so exactly."""
    window = np.hanning(round(width * RATE) + 2)[1:-1]
    size = len(window)
    before, after = (size - 1) // 2, size // 2
    around = np.pad(values, (before, after), mode="edge")
    out = oaconvolve(around, window / window.sum(), mode="valid")
    # Windows without a step in them, which sums by Fourier transforms would leave with rounding
    steps = np.concatenate([[0], np.cumsum(np.diff(around) != 0.0)])
    constant = steps[: len(values)] == steps[size - 1 :]
    out[constant] = values[constant]
    return out


def stop_and_go(random, t, rest):
    """Straight lines between speeds that are held for a while, m/s."""
    times, speeds = [0.0, rest], [0.0, 0.0]
    while times[-1] < t[-1]:
        halt = speeds[-1] > 0.0 and random.random() < 0.27
        after = 0.0 if halt else random.uniform(4.0, 25.0)
        times.append(times[-1] + abs(after - speeds[-1]) / random.uniform(1.0, 2.5))
        times.append(times[-1] + (random.uniform(8.0, 35.0) if halt else random.uniform(8.0, 45.0)))
        speeds += [after, after]
    return np.interp(t, times, speeds)


def random_levels(random, t, lengths, most):
    """Levels that are held for a while, half of them 0."""
    ends, levels = [0.0], []
    while ends[-1] < t[-1]:
        ends.append(ends[-1] + random.uniform(*lengths))
        levels.append(random.uniform(-most, most) * (random.random() < 0.5))
    return np.array(levels)[np.searchsorted(ends, t, side="right") - 1]


def band_noise(random, t, low, high):
    """Three columns of noise of a band, Hz, each of size 1."""
    sections = butter(2, [low, high], "bandpass", fs=RATE, output="sos")
    noise = sosfiltfilt(sections, random.standard_normal((len(t), 3)), axis=0)
    return noise / noise.std(axis=0)


def running_integral(rate, first=0.0):
    """By trapezia."""
    return first + np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))]) / RATE


def motion_of(t, velocity, angles):
    """Exact increments of the spline through velocities and roll, pitch, heading (rad)."""
    path, imu = generate_imu(t, PLACE, angles / DEG, velocity, "increment")
    values, increments = path.to_numpy(), imu.to_numpy()
    c_nb = Rotation.from_euler("ZYX", angles[:, ::-1]).as_matrix()
    latitude, longitude, height = values[:, 0] * DEG, values[:, 1] * DEG, values[:, 2]
    # Gravity there is of first order in height: at 60 m that is wrong by 6e-7 m/s^2
    excess = earth.gravity(values[:, 0], height) - gravity(latitude, height)
    accel = increments[:, 3:] + c_nb[:, 2] * (excess / RATE)[:, None]
    return Motion(t, latitude, longitude, height, values[:, 3:6], c_nb, increments[:, :3], accel)


# --- measurements ------------------------------------------------------------------------------

PERFECT = SensorErrors(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, HOUR)


def record(
    truth, errors, seed, *, gnss_rate=1.0, sigma=FIX_SIGMA, sigma_v=None, latency=0.0, lever=LEVER
):
    """Samples and fixes with errors.

    Parameters
    ----------
    errors : SensorErrors
    sigma, sigma_v : float
        Of fixes, m and m/s; no velocity without `sigma_v`.
    latency : float
        Seconds by which fixes are older than their stamps.
    """
    random = np.random.default_rng([seed, 3])
    axes = errors.misalignment * np.random.default_rng([seed, 5]).standard_normal((2, 3, 3))
    axes[:, np.eye(3, dtype=bool)] = 0.0
    n, step = len(truth.seconds), 1.0 / RATE
    state = gauss_markov(random, n, step, errors)
    white = random.standard_normal((2, n, 3)) * np.sqrt(step)
    gyro = truth.gyro * (1.0 + state[:, 6:9]) + truth.gyro @ axes[0].T + state[:, :3] * step
    accel = truth.accel * (1.0 + state[:, 9:]) + truth.accel @ axes[1].T + state[:, 3:6] * step
    lag = round(latency * RATE)
    at = np.arange(max(round(RATE / gnss_rate), lag), n, round(RATE / gnss_rate))
    k = at - lag
    noise = random.standard_normal((2, len(k), 3))
    arm = truth.c_nb[k] @ lever
    fixed = moved(truth.latitude[k], truth.longitude[k], truth.height[k], arm + sigma * noise[0])
    velocity = np.full((len(k), 3), np.nan)
    if sigma_v is not None:
        rate = 0.5 * RATE * (truth.gyro[k] + truth.gyro[np.minimum(k + 1, n - 1)])
        swing = np.einsum("kij,kj->ki", truth.c_nb[k], np.cross(rate, lever))
        velocity = truth.velocity_n[k] + swing + sigma_v * noise[1]
    return Record(
        truth,
        errors,
        truth.seconds,
        gyro + errors.angle_random_walk * white[0],
        accel + errors.velocity_random_walk * white[1],
        Fixes(truth.seconds[at], *fixed, sigma, velocity, sigma_v or 0.1),
        lever,
    )


def gauss_markov(random, n, step, errors):
    """Gyro bias, accelerometer bias and both scales, shape (n, 12), from their lasting spread."""
    keep = np.exp(-step / errors.time)
    drive = random.standard_normal((n, 12)) * errors.markov * np.sqrt(1.0 - keep**2)
    drive[0] = random.standard_normal(12) * errors.markov
    # What keep**n decays by within an hour is of order one: no loop is needed
    power = np.exp(-step / errors.time * np.arange(n))[:, None]
    return power * np.cumsum(drive / power, axis=0)


def first_state(truth, errors, seed, sigmas):
    """A start that is off by what its covariance says.

    Parameters
    ----------
    sigmas : (float, float, float)
        Of tilt and heading, deg, and velocity, m/s.
    """
    random = np.random.default_rng([seed, 4])
    tilt, heading, velocity = sigmas
    sigma = np.concatenate(
        [
            np.full(3, FIX_SIGMA),
            np.full(3, velocity),
            DEG * np.array([tilt, tilt, heading]),
            errors.spread,
        ]
    )
    error = np.where(np.arange(SIZE) < 9, random.standard_normal(SIZE) * sigma, 0.0)
    place = moved(truth.latitude[:1], truth.longitude[:1], truth.height[:1], -error[None, :3])
    return Navigation(
        truth.seconds[:1],
        *place,
        truth.velocity_n[:1] - error[3:6],
        Rotation.from_rotvec(-error[6:9]).as_matrix()[None] @ truth.c_nb[:1],
        np.zeros((1, SIZE - 9)),
        np.diag(sigma**2)[None],
    )


# --- faults ------------------------------------------------------------------------------------


def without_samples(data, begin, length):
    """A gap of the IMU; fixes go on."""
    there = (data.seconds <= begin) | (data.seconds > begin + length)
    samples = {name: getattr(data, name)[there] for name in ("seconds", "gyro", "accel")}
    return replace(data, **samples)


def without_fixes(data, spans):
    """Outages, as (begin, end) in seconds."""
    return replace(data, fixes=data.fixes.rows(~within(data.fixes.seconds, spans)))


def within(seconds, spans):
    """Which times lie in one of the spans."""
    inside = np.zeros(len(seconds), bool)
    for begin, end in spans:
        inside |= (seconds >= begin) & (seconds < end)
    return inside


def with_outliers(data, seed, share=0.01, size=35.0):
    """Some fixes off by so much in any direction, m."""
    random = np.random.default_rng([seed, 5])
    f = data.fixes
    away = random.standard_normal((len(f.seconds), 3))
    away *= size / np.linalg.norm(away, axis=1, keepdims=True)
    away *= (random.random(len(f.seconds)) < share)[:, None]
    latitude, longitude, height = moved(f.latitude, f.longitude, f.height, away)
    return replace(data, fixes=replace(f, latitude=latitude, longitude=longitude, height=height))


def frozen(data, begin, length):
    """A receiver that repeats one fix."""
    f = data.fixes
    k = np.arange(len(f.seconds))
    held = within(f.seconds, [(begin, begin + length)])
    if not held.any():  # within an outage
        return data
    k[held] = np.flatnonzero(held)[0]
    return replace(data, fixes=replace(f.rows(k), seconds=f.seconds))


def every(data, times):
    """A driver that sends the receiver's latest fix so many times."""
    k = np.arange(len(data.fixes.seconds))
    return replace(data, fixes=replace(data.fixes.rows(k - k % times), seconds=data.fixes.seconds))


# --- logs --------------------------------------------------------------------------------------


def write(path, data, more=()):
    """An MCAP of Imu (flu, mean rates over the intervals before the stamps) and NavSatFix.

    Velocities are TwistStamped in east, north, up, where the receiver gives them. The mean rates
    are what `--gyro-kind mean-rate` reads. Other messages are (stamp, topic, type, payload).
    """
    flip = np.array([1.0, -1.0, -1.0]) * RATE
    stamps = T0 + np.round(data.seconds * 1e9).astype(np.int64)
    rows = imu_rows(stamps, data.gyro * flip, data.accel * flip)
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        others = sorted([*fix_messages(data.fixes), *more], key=lambda one: one[0])
        number = {}
        for topic, name in {"/imu": IMU, **{m[1]: m[2] for m in others}}.items():
            text = store().generate_msgdef(name, ros_version=2)[0].encode()
            schema = writer.register_schema(name, "ros2msg", text)
            number[topic] = writer.register_channel(topic, "cdr", schema)
        next_other = 0
        for stamp, payload in zip(stamps.tolist(), rows, strict=True):
            while next_other < len(others) and others[next_other][0] < stamp:
                time, topic, _, message = others[next_other]
                writer.add_message(number[topic], time, message, time)
                next_other += 1
            writer.add_message(number["/imu"], stamp, payload.tobytes(), stamp)
        for time, topic, _, message in others[next_other:]:
            writer.add_message(number[topic], time, message, time)
        writer.finish()
    return path


def imu_rows(stamps, gyro, accel):
    """Messages as rows of bytes: one serialised message, its numbers replaced."""
    marks = np.array([1.5, 2.5, 3.5, 4.5, 5.5, 6.5])
    one = imu_messages([7 * 10**9 + 11], marks[None, :3], marks[None, 3:], q_xyzw=(0, 0, 0, 1))
    pattern = serialised(one[0].message, IMU, 2)
    rows = np.tile(np.frombuffer(pattern, np.uint8), (len(stamps), 1))
    places = [
        (np.array([7, 11], np.int32), np.stack(np.divmod(stamps, 10**9), axis=1).astype(np.int32)),
        (marks[:3], gyro),
        (marks[3:], accel),
    ]
    for mark, values in places:
        at = pattern.index(mark.tobytes())
        size = mark.nbytes
        rows[:, at : at + size] = np.ascontiguousarray(values).view(np.uint8).reshape(-1, size)
    return rows


def fix_messages(fixes, namespace=""):
    """Time, topic, type and payload of all fixes and velocities."""
    types = store().types
    fix, status = types["sensor_msgs/msg/NavSatFix"], types["sensor_msgs/msg/NavSatStatus"]
    sigma = np.broadcast_to(fixes.sigma, fixes.seconds.shape)
    twist = types["geometry_msgs/msg/TwistStamped"]
    vector = types["geometry_msgs/msg/Vector3"]
    out = []
    for k, seconds in enumerate(fixes.seconds):
        stamp = T0 + round(seconds * 1e9)
        message = fix(
            header=header(stamp, "gps"),
            status=status(status=2, service=1),
            latitude=float(fixes.latitude[k] / DEG),
            longitude=float(fixes.longitude[k] / DEG),
            altitude=float(fixes.height[k]),
            position_covariance=(sigma[k] ** 2 * np.eye(3)).reshape(-1),
            position_covariance_type=2 if sigma[k] else 0,
        )
        name = "sensor_msgs/msg/NavSatFix"
        out.append((stamp, f"{namespace}/fix", name, serialised(message, name, 2)))
        if np.isfinite(fixes.velocity_n[k]).all():
            north, east, down = fixes.velocity_n[k].tolist()
            message = twist(
                header=header(stamp, "gps"),
                twist=types["geometry_msgs/msg/Twist"](
                    linear=vector(east, north, -down), angular=vector(0.0, 0.0, 0.0)
                ),
            )
            name = "geometry_msgs/msg/TwistStamped"
            out.append((stamp, f"{namespace}/velocity", name, serialised(message, name, 2)))
    return out


def stated_velocities(fixes):
    """The same of velocities whose noise the receiver states."""
    types, name = store().types, "geometry_msgs/msg/TwistWithCovarianceStamped"
    vector, twist = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Twist"]
    covariance = np.diag([*3 * [fixes.sigma_v**2], 0.0, 0.0, 0.0]).reshape(-1)
    out = []
    for seconds, (north, east, down) in zip(fixes.seconds, fixes.velocity_n.tolist(), strict=True):
        stamp = T0 + round(seconds * 1e9)
        linear = twist(linear=vector(east, north, -down), angular=vector(0.0, 0.0, 0.0))
        stated = types["geometry_msgs/msg/TwistWithCovariance"](twist=linear, covariance=covariance)
        message = types[name](header=header(stamp, "gps"), twist=stated)
        out.append((stamp, "/velocity", name, serialised(message, name, 2)))
    return out
