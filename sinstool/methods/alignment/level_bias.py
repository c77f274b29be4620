"""Gyro bias of a vehicle that stays about level: its mean rate less that of its course.

Rough, but without any attitude: a first estimate for gyros whose bias makes every alignment fail.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.streams import Imu
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE, STANDARD_GRAVITY
from sinstool.methods.alignment.inflight_types import GnssFixes

# Fixes faster than this show the course, if they are so for as long as this, s: bad fixes, and the
# first that a velocity is derived from, seem fast for a moment.
MOVING_M_S, MOVING_S = 2.0, 3.0
# Longest and shortest time from the start that is used, s.
MOST_S = 120.0
LEAST_S = 15.0
# Least sigma of a bias found so, rad/s.
LEVEL_SIGMA = 0.1 * DEGREE
# Turns are means over so long, s.
TURN_S = 1.0
# Correlation time of the difference between course and heading, s; if that difference exceeds this,
# rad (1 sigma), the vehicle does not go where it points.
SWAY_S = 10.0
ANY_WAY = 0.5


@dataclass(frozen=True)
class LevelBias:
    """Gyro bias of a vehicle that goes where it points.

    Attributes
    ----------
    bias : ndarray, shape (3,)
        rad/s.
    sigma : float
        Of its part about the vertical, rad/s; at least `LEVEL_SIGMA`.
    up : ndarray, shape (3,)
        Unit vector along the mean specific force.
    leaning : float
        By how much its part across the vertical may be off, if the vehicle leans in turns, rad/s.
    """

    bias: FloatArray
    sigma: float
    up: FloatArray
    leaning: float = 0.0

    @property
    def sigma_any(self) -> float:
        """Of its part about any axis, rad/s."""
        return float(np.hypot(self.sigma, self.leaning))


def level_bias(imu: Imu, fixes: GnssFixes, begin_ns: int) -> LevelBias | None:
    """Gyro bias of a vehicle that stays about level and goes where it points.

    In the mean it turns as its course does, about the vertical that the accelerometer shows. In a
    coordinated turn of rate w at speed v an aircraft banks by arctan(v w / g), and that axis with
    it: the bias may be off by w less its part along that axis, and by its part across, which is up
    in turns to either side. What leans less feels the acceleration v w the more.

    Parameters
    ----------
    imu : Imu
        Rates.
    fixes : GnssFixes
        With velocity; those faster than a walk say where the vehicle goes.
    begin_ns : int
        Of the alignment; `MOST_S` from there are used.

    Returns
    -------
    LevelBias or None
        As uncertain as the course is far from where the gyros point; None where the course is not
        known for long enough, or the vehicle goes in any direction.
    """
    speed = np.linalg.norm(fixes.velocity_n[:, :2], axis=1)
    end_ns = begin_ns + round(MOST_S * SECOND)
    fast = _for_long(speed > MOVING_M_S, fixes.time_ns) & (fixes.time_ns >= begin_ns)
    fast &= fixes.time_ns <= min(end_ns, imu.time_ns[-1])
    time_ns, velocity = fixes.time_ns[fast], fixes.velocity_n[fast]
    if not len(time_ns) or time_ns[-1] - time_ns[0] < LEAST_S * SECOND:
        return None
    rows = (imu.time_ns >= time_ns[0]) & (imu.time_ns <= time_ns[-1])
    there = imu.time_ns[rows]
    if not len(there) or there[-1] - there[0] < LEAST_S * SECOND:
        return None
    gyro, force = imu.gyro[rows], imu.accel[rows].mean(axis=0)
    up = force / np.linalg.norm(force)
    since = (there - time_ns[0]) / SECOND
    turned = np.concatenate([[0.0], np.cumsum(-(gyro @ up)[1:] * np.diff(since))])
    seconds = (time_ns - time_ns[0]) / SECOND
    # Of the course alone a whole turn may be lost where the vehicle is slow for a while
    course = np.arctan2(velocity[:, 1], velocity[:, 0]) - np.interp(seconds, since, turned)
    course = np.unwrap(course)
    slope, start = np.polyfit(seconds, course, 1)
    off = float(np.std(course - start - slope * seconds))
    if off > ANY_WAY:
        return None
    across = gyro.mean(axis=0) - (gyro.mean(axis=0) @ up) * up
    # A straight line's slope is so uncertain where what is off lasts for `SWAY_S`
    sigma = off * np.sqrt(12.0 * SWAY_S / seconds[-1]) / seconds[-1]
    rate = abs(slope + turned[-1] / since[-1])
    leans = np.arctan(rate * float(speed[fast].mean()) / STANDARD_GRAVITY)
    sigma = float(np.linalg.norm([LEVEL_SIGMA, sigma, rate * (1.0 - np.cos(leans))]))
    speeds = np.interp(since, seconds, speed[fast])
    leaning = _leaning(since, turned + slope * since, speeds, imu.accel[rows], up)
    return LevelBias(across + slope * up, sigma, up, leaning)


def _leaning(
    since: FloatArray, turned: FloatArray, speed: FloatArray, force: FloatArray, up: FloatArray
) -> float:
    """Mean rate across the axis that leans with a vehicle in turns, rad/s.

    Parameters
    ----------
    since : ndarray, shape (n,)
        Times of samples, s.
    turned : ndarray, shape (n,)
        Angle about the vertical, rad.
    speed : ndarray, shape (n,)
        m/s.
    force : ndarray, shape (n, 3)
        m/s^2.
    up : ndarray, shape (3,)
    """
    # Once each, as nothing is measured in a gap
    edges = np.unique(np.searchsorted(since, np.arange(0.0, since[-1], TURN_S)))
    rate = np.diff(turned[edges]) / np.diff(since[edges])
    turning = rate * speed[edges[:-1]]
    means = np.add.reduceat(force, edges[:-1]) / np.diff(edges, append=len(force))[:-1, None]
    sideways = means - (means @ up)[:, None] * up
    square = float(turning @ turning)
    felt = min(float(np.linalg.norm(turning @ sideways)) / square, 1.0) if square > 0.0 else 1.0
    leans = np.arctan((1.0 - felt) * turning / STANDARD_GRAVITY)
    return abs(float(np.mean(rate * np.sin(leans))))


def _for_long(fast: BoolArray, time_ns: IntArray) -> BoolArray:
    """Those that are fast, for `MOVING_S` or longer."""
    edges = np.diff(fast.astype(np.int8), prepend=0, append=0)
    begin, end = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
    long = time_ns[end - 1] - time_ns[begin] >= MOVING_S * SECOND
    kept = np.zeros(len(fast) + 1, np.int8)
    kept[begin[long]] += 1
    kept[end[long]] -= 1
    return np.cumsum(kept[:-1]) > 0
