"""Vertical motion in closed form, and sensors that are wrong in known ways."""

import numpy as np
from scipy.signal import lfilter

from sinstool.core.earth import normal_gravity
from sinstool.methods.height.network import gravity_gradient
from sinstool.methods.height.vertical import VerticalChannel

LATITUDE = np.radians(34.2368)
START = 388.0  # m
W2 = gravity_gradient(LATITUDE, START)
G = 9.80665

# Climb speeds of -20 to +10 m/s: start s, duration s, speed then.
CLIMBS = (
    (60.0, 8.0, 5.0),
    (200.0, 6.0, -8.0),
    (260.0, 12.0, 10.0),
    (420.0, 15.0, -20.0),
    (460.0, 12.0, 0.0),
    (520.0, 5.0, 7.0),
    (600.0, 5.0, 0.0),
)


def motion(t, climbs=(), start=START):
    """Height, velocity, acceleration; the speed goes over from one to the next smoothly."""
    h, v, a = np.full_like(t, start), np.zeros_like(t), np.zeros_like(t)
    before = 0.0
    for begin, duration, speed in climbs:
        s = np.clip((t - begin) / duration, 0.0, 1.0)
        change = speed - before
        angle = 2 * np.pi * s
        h += change * duration * (s * s / 2 + (np.cos(angle) - 1) / (4 * np.pi**2))
        h += change * np.maximum(t - begin - duration, 0.0)
        v += change * (s - np.sin(angle) / (2 * np.pi))
        a += change / duration * (1 - np.cos(angle)) * ((s > 0) & (s < 1))
        before = speed
    return h, v, a


def ns(t):
    return np.round(np.asarray(t) * 1e9).astype(np.int64)


def markov(rng, n, interval, sigma, time):
    r = np.exp(-interval / time)
    drive = sigma * np.sqrt(1 - r * r) * rng.standard_normal(n)
    drive[:1] = sigma * rng.standard_normal(1)
    return lfilter([1.0], [1.0, -r], drive)


def accelerometer(rng, t, grade):
    """Error of the upward acceleration: bias, white noise, and for MEMS the tilt's noise."""
    dt = t[1] - t[0]
    white = rng.standard_normal(len(t)) / np.sqrt(dt)
    if grade == "navigation":
        return 50e-6 * G * rng.standard_normal() + 10e-6 * G * white
    walk = np.cumsum(rng.standard_normal(len(t))) * np.sqrt(dt / 100.0) * 1e-3 * G
    tilt = markov(rng, len(t), dt, 0.02, 5.0)
    return 2e-3 * G * rng.standard_normal() + 150e-6 * G * white + walk + tilt


class Flight:
    """What a vertical channel is given, and the truth beside it."""

    def __init__(self, duration, climbs=(), imu_rate=100.0, baro_rate=50.0, baro_shift=0.0):
        self.t = np.arange(round(duration * imu_rate) + 1) / imu_rate
        self.h, self.v, self.a = motion(self.t, climbs)
        self.f_up = self.a + normal_gravity(LATITUDE, self.h)
        self.t_baro = np.arange(round(duration * baro_rate) + 1) / baro_rate + baro_shift
        self.h_baro = motion(self.t_baro, climbs)[0]

    def run(self, network, grade="mems", blocks=None, reason=None, arrival=None, **kwargs):
        """Push it all, or in blocks of so many IMU samples; return (columns, channel)."""
        kwargs = {"height": self.h[0], "v_up": self.v[0], **kwargs}
        channel = VerticalChannel(network, LATITUDE, grade, **kwargs)
        time, stamps = ns(self.t), ns(self.t_baro)
        late = None if arrival is None else ns(arrival)
        known = np.maximum.accumulate(stamps if late is None else np.maximum(late, stamps))
        parts = []
        size = blocks or len(time)
        done = 0
        for k in range(0, len(time), size):
            block = slice(k, k + size)
            end = int(np.searchsorted(known, time[block][-1], side="right"))
            if k + size >= len(time):
                end = len(known)
            baro = slice(done, end)
            done = end
            parts.append(
                channel.push(
                    time[block],
                    self.f_up[block],
                    stamps[baro],
                    self.h_baro[baro],
                    None if reason is None else reason[baro],
                    None if late is None else late[baro],
                )
            )
        names = ("height", "v_up", "correction", "valid")
        columns = {n: np.concatenate([getattr(p, n) for p in parts]) for n in names}
        return columns, channel
