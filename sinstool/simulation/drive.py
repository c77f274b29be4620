"""A drive on roads with exact sensors: rest at first, then stops, turns and hills."""

from __future__ import annotations

import numpy as np

from sinstool.core import rotation
from sinstool.core.arrays import FloatArray
from sinstool.simulation.car import Car, Jet, drift, ferry, ferry_levels, move_by_lever, product
from sinstool.simulation.flight import add_sinusoids
from sinstool.simulation.travel import COLUMNS, Levels, Motion, travel
from sinstool.simulation.truth import Trajectory, sample_times, turned

_CRUISE = 14.0  # m/s, at which the suspension's motion has its full size
_CORNER = 5.0
_LEAN = np.deg2rad(0.5)  # of the body in a curve, outward, per m/s^2
# Longest time from one stop to the next, and the rest after the ferry's arrival, s
_LEG, _BOARDING = 95.0, 5.0
# Added to the seed for the slip, so that the roads stay the same
_SLIP_SEED = 3000


def road_drive(
    duration_s: float,
    rate_hz: float,
    *,
    latitude: float = np.deg2rad(48.1),
    longitude: float = np.deg2rad(11.6),
    height: float = 560.0,
    heading: float = 0.7,
    still_s: float = 60.0,
    seed: int = 0,
    start_ns: int = 0,
    car: Car | None = None,
) -> Trajectory:
    """Stand, then drive through a town on hills.

    Parameters
    ----------
    duration_s : float
        Duration of the log, s, the rest at the start included.
    rate_hz : float
        Samples per second.
    latitude, longitude : float, optional
        Start, rad.
    height : float, optional
        Ellipsoidal height of the start, m.
    heading : float, optional
        At the start, rad.
    still_s : float, optional
        Rest before the drive, s.
    seed : int, optional
        Seed of the roads and of the suspension.
    start_ns : int, optional
        First instant.
    car : Car, optional
        How the car slides and where the IMU is in it; by default the IMU itself follows the road.

    Returns
    -------
    Trajectory
        Trajectory of the IMU, in its own axes. Speeds along the car's axis are up to 17 m/s; turns,
        at 5 m/s, are 68 to 190 degrees each; stops last 5 to 20 s, at exactly zero speed; slopes
        are up to 5 degrees. On its suspension the body pitches and rolls by 0.2 degrees and heaves
        by some millimetres at 2 to 4 Hz, in proportion to speed, and it leans outward in turns.
    """
    times = sample_times(rate_hz, duration_s, start_ns)
    car = Car() if car is None else car
    slip = drift(car, np.random.default_rng(seed + _SLIP_SEED))
    motion = _roads(duration_s, still_s, np.random.default_rng(seed), car, slip)
    trajectory = travel(motion, times, latitude, longitude, height, heading)
    return turned(trajectory, rotation.from_euler(car.mount)) if any(car.mount) else trajectory


def _itinerary(
    duration_s: float, still_s: float, random: np.random.Generator, car: Car
) -> tuple[Levels, Levels, Levels]:
    """Speed, m/s, rate of turn, rad/s, and slope, rad, of the road over time."""
    speeds: list[tuple[float, float, float]] = []
    turns: list[tuple[float, float, float]] = []
    slopes: list[tuple[float, float, float]] = []
    t, moving = still_s, False
    boarding = np.inf if car.ferry is None else car.ferry[0]
    while t < duration_s:
        if car.ferry is not None and t + _LEG > boarding:
            # stands still from before the ferry leaves until after it has arrived
            if moving:
                speeds.append((t, 7.0, 0.0))
                t, moving = t + 7.0, False
            t, boarding = max(t, sum(car.ferry)) + _BOARDING, np.inf
        if not moving:
            speeds.append((t, 9.0, float(random.uniform(11.0, 17.0))))
            t += 9.0
        moving = True
        slopes.append((t, 12.0, float(np.deg2rad(random.uniform(-5.0, 5.0)))))
        t += float(random.uniform(12.0, 40.0))
        if random.random() < 0.6:
            rate = float(random.choice([-1.0, 1.0]) * random.uniform(0.2, 0.35))
            hold = float(random.uniform(np.deg2rad(45.0), np.deg2rad(150.0))) / abs(rate)
            speeds.append((t, 6.0, _CORNER))
            turns += [(t + 6.0, 2.0, rate), (t + 8.0 + hold, 2.0, 0.0)]
            t += 10.0 + hold
            speeds.append((t, 7.0, float(random.uniform(11.0, 17.0))))
            t += 7.0
        else:
            speeds.append((t, 7.0, 0.0))
            t += 7.0 + float(random.uniform(5.0, 20.0))
            moving = False
    return Levels(0.0, speeds), Levels(0.0, turns), Levels(0.01, slopes)


def _roads(
    duration_s: float, still_s: float, random: np.random.Generator, car: Car, slip: Jet
) -> Motion:
    """Motion of a car along a road that shakes it on its suspension."""
    speed, turn, slope = _itinerary(duration_s, still_s, random, car)
    frequency = random.uniform(2.0, 4.0, (4, 3))
    phase = random.uniform(0.0, 2.0 * np.pi, (4, 3))
    angle = np.deg2rad(0.12) * random.uniform(0.5, 1.5, (2, 3))
    bounce = car.suspension
    crossing = ferry_levels(car)

    def motion(t: FloatArray) -> FloatArray:
        out = np.zeros((len(t), COLUMNS))
        v, dv, ddv = speed.value(t), speed.slope(t), speed.curvature(t)
        yaw, rate, bend = turn.integral(t), turn.value(t), turn.slope(t)
        hill, dhill = slope.value(t), slope.slope(t)
        c, s = np.cos(yaw), np.sin(yaw)
        # The car goes along the road with speed v, of which cos(hill) is level
        level, climb = np.cos(hill), np.sin(hill)
        along, dalong = v * level, dv * level - v * climb * dhill
        out[:, 0], out[:, 1] = along * c, along * s
        out[:, 3] = dalong * c - along * s * rate
        out[:, 4] = dalong * s + along * c * rate
        size, dsize, ddsize = v / _CRUISE, dv / _CRUISE, ddv / _CRUISE
        out[:, 2], out[:, 5] = -v * climb, -dv * climb - v * level * dhill
        for f, p in zip(frequency[3], phase[3], strict=True):
            w = 2.0 * np.pi * f
            heave = bounce * 0.0015 * np.sin(w * t + p)
            dheave = bounce * 0.0015 * w * np.cos(w * t + p)
            out[:, 2] -= dsize * heave + size * dheave
            out[:, 5] -= ddsize * heave + 2.0 * dsize * dheave - size * w * w * heave
        shake = np.zeros_like(out)
        add_sinusoids(shake, t, frequency[:2], phase[:2], bounce * angle)
        for axis in (0, 1):
            out[:, 6 + axis] = size * shake[:, 6 + axis]
            out[:, 9 + axis] = dsize * shake[:, 6 + axis] + size * shake[:, 9 + axis]
        out[:, 6] -= bounce * _LEAN * v * rate
        out[:, 9] -= bounce * _LEAN * (dv * rate + v * bend)
        out[:, 7] += hill
        out[:, 10] += dhill
        out[:, 8], out[:, 11] = yaw, rate
        if car.slides:
            right, dright = slip(t, v, dv, rate, bend)
            out[:, 0] -= right * s
            out[:, 1] += right * c
            out[:, 3] -= dright * s + right * rate * c
            out[:, 4] += dright * c - right * rate * s
        wave = np.zeros(len(t)) if crossing is None else ferry(out, t, crossing)
        if car.axle_lever:
            w = 2.0 * np.pi * frequency[1]
            acceleration = -np.sin(np.outer(t, w) + phase[1]) @ (bounce * angle[1] * w * w)
            shaken = (shake[:, 7], shake[:, 10], acceleration)
            _, _, pitched = product((size, dsize, ddsize), shaken)
            move_by_lever(out, pitched + slope.curvature(t) + wave, bend, car.axle_lever)
        return out

    return motion
