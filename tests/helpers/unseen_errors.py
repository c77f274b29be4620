"""Errors of sensors, clocks and receivers beyond noise, bias and scale, for unseen drives.

A record (`unseen_drives.record`) is made worse in ways that real instruments have and that the
product's own simulation does not make: axes that are not square, biases that follow the specific
force or the temperature, vibration, 16 bits, stamps by receipt, clocks that drift, fixes that
wander or say nothing of their noise. Nothing here uses the product.
"""

from dataclasses import replace

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from tests.helpers.optimal_filter import moved
from tests.helpers.unseen_drives import DEG, RATE, Motion, Record, band_noise, within

GRAVITY = 9.81

# --- the IMU -----------------------------------------------------------------------------------


def turned(truth: Motion, mount: Rotation) -> Motion:
    """The motion of an IMU that is mounted another way.

    Parameters
    ----------
    mount : Rotation
        Takes the IMU's axes to those of `truth`.
    """
    c = mount.as_matrix()
    return replace(truth, c_nb=truth.c_nb @ c, gyro=truth.gyro @ c, accel=truth.accel @ c)


def crossed(data: Record, seed: int, size: float) -> Record:
    """Axes of gyros and accelerometers that are off by a random part (1 sigma) of each other."""
    random = np.random.default_rng([seed, 21])
    off = size * random.standard_normal((2, 3, 3)) * ~np.eye(3, dtype=bool)
    return replace(
        data, gyro=data.gyro + data.gyro @ off[0], accel=data.accel + data.accel @ off[1]
    )


def g_sensitive(data: Record, seed: int, size: float) -> Record:
    """Gyro biases that follow the specific force, rad/s for each g (1 sigma of an element)."""
    random = np.random.default_rng([seed, 22])
    matrix = size * random.standard_normal((3, 3)) / GRAVITY
    return replace(data, gyro=data.gyro + data.accel @ matrix.T)


def warming(data: Record, seed: int, gyro: float, accel: float, time: float) -> Record:
    """Biases that decay after turn-on, rad/s and m/s^2 (1 sigma) within `time` seconds."""
    random = np.random.default_rng([seed, 23])
    left = np.exp(-data.seconds / time)[:, None] / RATE
    first = random.standard_normal((2, 3)) * np.array([[gyro], [accel]])
    return replace(data, gyro=data.gyro + left * first[0], accel=data.accel + left * first[1])


def shaken(data: Record, seed: int, accel: float, gyro: float) -> Record:
    """Vibration of an engine: a band of noise and a tone, m/s^2 and rad/s in root mean square."""
    random = np.random.default_rng([seed, 24])
    t = data.seconds
    tone = 2.0 * np.pi * (random.uniform(25.0, 90.0) * t[:, None] + random.random((1, 3)))
    both = [
        size * (band_noise(random, t, 20.0, 95.0) + np.sin(tone)) / RATE for size in (accel, gyro)
    ]
    return replace(data, accel=data.accel + both[0], gyro=data.gyro + both[1])


def quantised(data: Record, gyro: float, accel: float) -> Record:
    """Rates in steps, rad/s and m/s^2, and clipped at 16 bits."""

    def steps(values, size):
        return np.clip(np.round(values * RATE / size), -32768, 32767) * size / RATE

    return replace(data, gyro=steps(data.gyro, gyro), accel=steps(data.accel, accel))


def with_lost(data: Record, seed: int, share: float) -> Record:
    """Single samples that were lost."""
    random = np.random.default_rng([seed, 25])
    there = random.random(len(data.seconds)) >= share
    names = ("seconds", "gyro", "accel")
    return replace(data, **{name: getattr(data, name)[there] for name in names})


def slower(data: Record, every: int) -> Record:
    """A lower rate: each sample the mean over so many."""
    n = len(data.seconds) // every * every
    sums = {name: getattr(data, name)[:n].reshape(-1, every, 3).sum(axis=1) / every
            for name in ("gyro", "accel")}  # fmt: skip
    return replace(data, seconds=data.seconds[every - 1 : n : every], **sums)


def received(data: Record, seed: int, size: float) -> Record:
    """Stamps of receipt: late by an exponential time of so many seconds, in order.

    Its median is taken off, as a constant delay would be the receiver's latency.
    """
    random = np.random.default_rng([seed, 26])
    late = data.seconds + random.exponential(size, len(data.seconds)) - np.log(2.0) * size
    late = np.maximum.accumulate(late)
    # Those that arrive together are a microsecond apart
    row = np.arange(len(late))
    first = np.maximum.accumulate(np.where(np.diff(late, prepend=-1.0) > 0.0, row, 0))
    return replace(data, seconds=late + 1e-6 * (row - first))


def drifting_clock(data: Record, rate: float) -> tuple[Motion, Record]:
    """The IMU's clock is too fast by so much; the receiver's is right. Truth by the IMU's clock."""
    truth = replace(data.truth, seconds=data.truth.seconds * (1.0 + rate))
    return truth, replace(data, seconds=data.seconds * (1.0 + rate))


# --- the receiver ------------------------------------------------------------------------------


def displaced(data: Record, off: np.ndarray) -> Record:
    """Fixes off by so many metres, north, east, down; those that a hung receiver repeats alike."""
    f = data.fixes
    again = np.zeros(len(f.seconds), dtype=bool)
    again[1:] = (np.diff(f.latitude) == 0.0) & (np.diff(f.longitude) == 0.0)
    off = off[np.maximum.accumulate(np.where(again, 0, np.arange(len(off))))]
    latitude, longitude, height = moved(f.latitude, f.longitude, f.height, off)
    return replace(data, fixes=replace(f, latitude=latitude, longitude=longitude, height=height))


def wandering(data: Record, seed: int, size: float, time: float) -> Record:
    """Fixes with an error that lasts: m (1 sigma, 1.5 times in height), and its correlation, s."""
    return displaced(data, _slow(data, seed, time) * size * np.array([1.0, 1.0, 1.5]))


def drifting(data: Record, seed: int, size: float, time: float) -> Record:
    """Velocities with an error that lasts: m/s (1 sigma of an axis), and its correlation, s."""
    slow = size * _slow(data, seed, time, 34)
    return replace(data, fixes=replace(data.fixes, velocity_n=data.fixes.velocity_n + slow))


def _slow(data, seed, time, number=27):
    """Gauss-Markov, of size 1, at the fixes."""
    random = np.random.default_rng([seed, number])
    keep = np.exp(-np.median(np.diff(data.fixes.seconds)) / time)
    white = random.standard_normal((len(data.fixes.seconds), 3))
    white[1:] *= np.sqrt(1.0 - keep**2)
    return lfilter([1.0], [1.0, -keep], white, axis=0)


def smoothed_by_receiver(data: Record, seed: int, size: float, time: float) -> Record:
    """Fixes with an error, m (1 sigma), that two low passes in a row smooth over so many seconds.

    From one fix to the next it hardly changes; within a few times `time` it is another one.
    """
    random = np.random.default_rng([seed, 31])
    keep = np.exp(-np.median(np.diff(data.fixes.seconds)) / time)
    white = random.standard_normal((len(data.fixes.seconds) + 1000, 3))
    smooth = lfilter([1.0], [1.0, -2.0 * keep, keep**2], white, axis=0)[1000:]
    return displaced(data, size * smooth / smooth.std(axis=0))


def lowpassed_velocities(data: Record, seed: int, time: float) -> Record:
    """Velocities that the receiver passes through a low-pass of first order, noise and all."""
    truth, fixes = data.truth, data.fixes
    swing = np.gradient(truth.c_nb @ data.lever, truth.seconds, axis=0)
    velocity = truth.velocity_n + swing
    gain = -np.expm1(-1.0 / RATE / time)
    late = lfilter([gain], [1.0, gain - 1.0], velocity - velocity[0], axis=0) + velocity[0]
    keep = np.exp(-np.median(np.diff(fixes.seconds)) / time)
    white = np.random.default_rng([seed, 33]).standard_normal((len(fixes.seconds), 3))
    noise = lfilter([1.0 - keep], [1.0, -keep], fixes.sigma_v * white, axis=0)
    rows = np.searchsorted(truth.seconds, fixes.seconds - 0.5 / RATE)
    return replace(data, fixes=replace(fixes, velocity_n=late[rows] + noise))


def streets(data: Record, seed: int, size: float, honest: bool) -> Record:
    """Between houses, half a minute at a time: fixes off by metres that last for ten seconds.

    Parameters
    ----------
    honest : bool
        The receiver's sigmas say so.
    """
    random = np.random.default_rng([seed, 28])
    f, last = data.fixes, float(data.seconds[-1])
    begins = np.sort(random.uniform(60.0, max(70.0, last - 90.0), random.integers(2, 6)))
    inside = within(f.seconds, [(b, b + random.uniform(15.0, 60.0)) for b in begins])
    off = np.where(inside[:, None], size * _slow(data, seed + 1, 10.0), 0.0)
    sigma = np.where(inside & honest, np.hypot(f.sigma, size), f.sigma)
    data = displaced(data, off)
    return replace(data, fixes=replace(data.fixes, sigma=sigma))


def unsteady_stamps(data: Record, seed: int, size: float) -> Record:
    """Stamps of fixes by receipt: late by an exponential time of so many seconds."""
    random = np.random.default_rng([seed, 29])
    f = data.fixes
    late = f.seconds + np.minimum(random.exponential(size, len(f.seconds)), 5.0 * size)
    return replace(data, fixes=replace(f, seconds=np.maximum.accumulate(late)))


# --- together ----------------------------------------------------------------------------------


def any_mount(random: np.random.Generator) -> Rotation:
    """Upside down, on its side, turned by quarters, and a few degrees off."""
    quarters = Rotation.from_euler("zyx", 90.0 * random.integers(0, 4, 3), degrees=True)
    return quarters * Rotation.from_rotvec(3.0 * DEG * random.standard_normal(3))
