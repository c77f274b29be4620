"""Flights with exact sensors: the slow climbing spiral, and one that manoeuvres.

References
----------
.. [1] P. D. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
   Systems", 2nd ed., 2013.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.simulation.travel import COLUMNS, Levels, Motion, travel
from sinstool.simulation.truth import Trajectory, sample_times

# North-west China, where gravity near 400 m is the 9.7955 m/s^2 that the spiral is made for.
_LATITUDE = np.deg2rad(34.25)
_LONGITUDE = np.deg2rad(108.9)
_HEIGHT = 388.0

_RADIUS = 10_000.0
_BANK = np.deg2rad(2.0)
_GRAVITY = 9.79549
SPIRAL_SPEED = float(np.sqrt(_GRAVITY * _RADIUS * np.tan(_BANK)))
"""Speed of the spiral, 58.486 m/s, for circles of 10 km radius at 2 degrees of bank."""

_CLIMB_PER_TURN = 20.0

# Vertical velocities of the manoeuvring flight, one after the other; m/s.
_CLIMBS = (5.0, -20.0, 10.0, -10.0)
_CLIMB_HEIGHT = 200.0


def spiral_climb(
    duration_s: float,
    rate_hz: float,
    *,
    latitude: float = _LATITUDE,
    longitude: float = _LONGITUDE,
    height: float = _HEIGHT,
    heading: float = 0.0,
    start_ns: int = 0,
) -> Trajectory:
    """Climb in wide circles to the right: 2 degrees of bank, level nose, 20 m per turn.

    Parameters
    ----------
    duration_s : float
        Duration, s.
    rate_hz : float
        Samples per second.
    latitude, longitude : float, optional
        Start, rad.
    height : float, optional
        Ellipsoidal height of the start, m.
    heading : float, optional
        At the start, rad.
    start_ns : int, optional
        First instant.
    """
    turn = SPIRAL_SPEED / _RADIUS
    climb = _CLIMB_PER_TURN * turn / (2.0 * np.pi)

    def motion(t: FloatArray) -> FloatArray:
        out = np.zeros((len(t), COLUMNS))
        yaw = turn * t
        north, east = SPIRAL_SPEED * np.cos(yaw), SPIRAL_SPEED * np.sin(yaw)
        out[:, 0], out[:, 1], out[:, 2] = north, east, -climb
        out[:, 3], out[:, 4] = -turn * east, turn * north
        out[:, 6], out[:, 8], out[:, 11] = _BANK, yaw, turn
        return out

    times = sample_times(rate_hz, duration_s, start_ns)
    return travel(motion, times, latitude, longitude, height, heading)


def manoeuvring_flight(
    duration_s: float,
    rate_hz: float,
    *,
    latitude: float = _LATITUDE,
    longitude: float = _LONGITUDE,
    height: float = 1500.0,
    heading: float = 0.0,
    turbulence: float = 1.0,
    seed: int = 0,
    start_ns: int = 0,
) -> Trajectory:
    """Fly straight, turn, climb and dive, at changing speed, in some turbulence.

    Parameters
    ----------
    duration_s : float
        Duration, s.
    rate_hz : float
        Samples per second.
    latitude, longitude : float, optional
        Start, rad.
    height : float, optional
        Ellipsoidal height of the start, m.
    heading : float, optional
        At the start, rad.
    turbulence : float, optional
        Factor on its angles; 0 for still air.
    seed : int, optional
        Seed of the manoeuvres and of the turbulence.
    start_ns : int, optional
        First instant.

    Returns
    -------
    Trajectory
        Turns are at 35 degrees of bank, 75 to 306 degrees each to either side, and coordinated as
        in level flight; vertical velocity is between -20 and +10 m/s, speed between 55 and 80 m/s.
        Turbulence turns the body by some tenths of a degree at 0.3 to 2.5 Hz.
    """
    times = sample_times(rate_hz, duration_s, start_ns)
    motion = _manoeuvres(duration_s, turbulence, np.random.default_rng(seed))
    return travel(motion, times, latitude, longitude, height, heading)


def _manoeuvres(duration_s: float, turbulence: float, random: np.random.Generator) -> Motion:
    rate_at_bank = _GRAVITY * np.tan(np.deg2rad(35.0))
    speed_now = 60.0
    turns: list[tuple[float, float, float]] = []
    speeds: list[tuple[float, float, float]] = []
    climbs: list[tuple[float, float, float]] = []
    t = level_at = 10.0
    for i in range(1_000_000):
        if t > duration_s:
            break
        if i % 2 == 0:
            side = 1.0 if random.random() < 0.5 else -1.0
            bank_time = float(random.uniform(3.0, 5.0))
            angle = float(random.uniform(np.deg2rad(60.0), np.deg2rad(270.0)))
            rate = side * rate_at_bank / speed_now
            hold = angle / abs(rate)
            turns += [(t, bank_time, rate), (t + bank_time + hold, bank_time, 0.0)]
            t += 2.0 * bank_time + hold + float(random.uniform(5.0, 15.0))
        elif i % 4 == 1:
            # The next turn begins in the climb, so that all angles change at once.
            t = max(t, level_at)
            level = _CLIMBS[i // 4 % len(_CLIMBS)]
            hold = _CLIMB_HEIGHT / abs(level)
            climbs += [(t, 8.0, level), (t + 8.0 + hold, 8.0, 0.0)]
            level_at = t + 16.0 + hold
            t += float(random.uniform(5.0, 15.0))
        else:
            speed_now = float(random.uniform(55.0, 80.0))
            speeds.append((t, 15.0, speed_now))
            t += 20.0
    turn, speed, climb = Levels(0.0, turns), Levels(60.0, speeds), Levels(0.0, climbs)
    frequency = random.uniform(0.3, 2.5, (3, 4))
    phase = random.uniform(0.0, 2.0 * np.pi, (3, 4))
    amplitude = turbulence * np.deg2rad(0.2) * random.uniform(0.5, 1.5, (3, 4))

    def motion(t: FloatArray) -> FloatArray:
        out = np.empty((len(t), COLUMNS))
        v, dv = speed.value(t), speed.slope(t)
        yaw, rate, bend = turn.integral(t), turn.value(t), turn.slope(t)
        up, dup = climb.value(t), climb.slope(t)
        c, s = np.cos(yaw), np.sin(yaw)
        out[:, 0], out[:, 1], out[:, 2] = v * c, v * s, -up
        out[:, 3] = dv * c - v * s * rate
        out[:, 4] = dv * s + v * c * rate
        out[:, 5] = -dup
        slope = v * rate / _GRAVITY
        out[:, 6] = np.arctan(slope)
        out[:, 9] = (dv * rate + v * bend) / _GRAVITY / (1.0 + slope * slope)
        out[:, 7] = np.arctan(up / v) + np.deg2rad(3.0)  # angle of attack
        out[:, 10] = (dup * v - up * dv) / (v * v + up * up)
        out[:, 8], out[:, 11] = yaw, rate
        add_sinusoids(out, t, frequency, phase, amplitude)
        return out

    return motion


def add_sinusoids(
    out: FloatArray, t: FloatArray, frequency: FloatArray, phase: FloatArray, amplitude: FloatArray
) -> None:
    """Add sinusoids to the angles of a motion.

    Parameters
    ----------
    out : ndarray, shape (n, COLUMNS)
        Changed in place.
    t : ndarray, shape (n,)
        s.
    frequency, phase, amplitude : ndarray, shape (k, m)
        Sinusoids of the first `k` of roll, pitch and yaw; Hz, rad, rad.
    """
    for axis in range(len(frequency)):
        for f, p, a in zip(frequency[axis], phase[axis], amplitude[axis], strict=True):
            w = 2.0 * np.pi * f
            out[:, 6 + axis] += a * np.sin(w * t + p)
            out[:, 9 + axis] += a * w * np.cos(w * t + p)
