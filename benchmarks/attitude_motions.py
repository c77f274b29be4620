"""Motions of a car, drone, ship, aircraft and hand, random by seed, with exact sensors; no program.

Velocity and Euler angles are written as functions of time that are smooth; their derivatives are
central differences, good to some 1e-6 of what shakes fastest.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.common import FloatArray, G
from sinstool.core.units import DEGREE
from sinstool.simulation.travel import COLUMNS, Levels, Motion, travel
from sinstool.simulation.truth import Trajectory, sample_times

RATE, SLOW_RATE = 100.0, 50.0  # Hz
_LATITUDE, _LONGITUDE, _HEIGHT = np.deg2rad(48.1), np.deg2rad(11.6), 560.0
_STEP = 2e-4  # s
_LEVEL_FLIGHT = 60.0  # m/s

Part = Callable[[FloatArray], FloatArray]
"""Seconds, shape (n,), into velocity NED and roll, pitch and yaw, shape (n, 6)."""
Random = np.random.Generator


def trajectory(kind: str, seed: int, minutes: float | None = None) -> Trajectory:
    """Samples and truth of a motion, at `RATE`, or at `SLOW_RATE` where no engine shakes it.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    seed : int
        Of the route, the manoeuvres and the vibration.
    minutes : float, optional
        By default as long as the kind usually is.
    """
    make, usual = KINDS[kind]
    seconds = 60.0 * (usual if minutes is None else minutes)
    random = np.random.default_rng([seed, list(KINDS).index(kind)])
    part = make(seconds, random)
    azimuth = float(random.uniform(-np.pi, np.pi))
    times = sample_times(SLOW_RATE if kind.startswith("any ") else RATE, seconds)
    return travel(_motion(part), times, _LATITUDE, _LONGITUDE, _HEIGHT, azimuth)


def _motion(part: Part) -> Motion:
    """With derivatives, as `travel` wants it."""

    def motion(t: FloatArray) -> FloatArray:
        out = np.empty((len(t), COLUMNS))
        near = part(t + _STEP) - part(t - _STEP)
        far = part(t + 2.0 * _STEP) - part(t - 2.0 * _STEP)
        slope = (8.0 * near - far) / (12.0 * _STEP)
        value = part(t)
        out[:, 0:3], out[:, 3:6] = value[:, :3], slope[:, :3]
        out[:, 6:9], out[:, 9:12] = value[:, 3:], slope[:, 3:]
        return out

    return motion


class Shake:
    """Six quantities that shake at random frequencies of a band.

    Parameters
    ----------
    sizes : sequence of float
        Root mean squares, each of one quantity.
    band : tuple of 2 float
        Hz.
    lines : int
        Of each quantity.
    """

    def __init__(
        self, random: Random, sizes: tuple[float, ...], band: tuple[float, float], lines: int = 8
    ) -> None:
        low, high = np.log(band)
        self._w = 2.0 * np.pi * np.exp(random.uniform(low, high, (len(sizes), lines)))
        self._phase = random.uniform(0.0, 2.0 * np.pi, self._w.shape)
        size = random.uniform(0.5, 1.5, self._w.shape)
        size *= np.asarray(sizes)[:, None] / np.sqrt(0.5 * np.sum(size**2, axis=1, keepdims=True))
        self._size = size

    def __call__(self, t: FloatArray) -> FloatArray:
        out = np.zeros((len(t), len(self._w)))
        for k, (w, phase, size) in enumerate(zip(self._w, self._phase, self._size, strict=True)):
            if size.any():
                out[:, k] = np.sin(np.outer(t, w) + phase) @ size
        return out


def _by_velocity(random: Random, acceleration: float, band: tuple[float, float]) -> Shake:
    """Velocities of a vibration with so much acceleration along each axis, m/s^2 RMS."""
    middle = 2.0 * np.pi * np.sqrt(band[0] * band[1])
    return Shake(random, (acceleration / middle,) * 3, band)


def _pulse(at: float, change: float, size: float) -> tuple[list[tuple[float, float, float]], float]:
    """Acceleration of a size that changes the velocity, and when it is over."""
    signed = np.copysign(size, change)
    hold = max(abs(change) / size - 1.0, 0.1)
    signed = change / (hold + 1.0)
    return [(at, 1.0, signed), (at + 1.0 + hold, 1.0, 0.0)], at + 2.0 + hold


def _car(stops: bool) -> Callable[[float, Random], Part]:
    def make(seconds: float, random: Random) -> Part:
        speed_now = 0.0 if stops else 15.0
        pulses: list[tuple[float, float, float]] = []
        turns: list[tuple[float, float, float]] = []
        slopes: list[tuple[float, float, float]] = []
        t = 20.0 if stops else 3.0

        def to(speed: float, size: float) -> None:
            nonlocal t, speed_now
            if abs(speed - speed_now) > 0.2:
                more, t = _pulse(t, speed - speed_now, size)
                pulses.extend(more)
                speed_now = speed

        while t < seconds:
            to(float(random.uniform(12.0, 28.0)), float(random.uniform(1.2, 2.5)))
            slopes.append((t, 8.0, float(np.deg2rad(random.uniform(-4.0, 4.0)))))
            t += float(random.uniform(9.0, 40.0))
            if random.random() < 0.7:
                to(float(random.uniform(6.0, 16.0)), float(random.uniform(1.0, 2.5)))
                side = float(random.choice([-1.0, 1.0]))
                rate = side * float(random.uniform(1.0, 3.0)) / speed_now
                hold = float(random.uniform(np.deg2rad(30.0), np.deg2rad(170.0))) / abs(rate)
                turns += [(t, 2.0, rate), (t + 2.0 + hold, 2.0, 0.0)]
                t += 4.0 + hold
            elif stops:
                to(0.0, float(random.uniform(1.5, 3.0)))
                t += float(random.uniform(5.0, 30.0))
        first = 0.0 if stops else 15.0
        pull, turn, slope = Levels(0.0, pulses), Levels(0.0, turns), Levels(0.01, slopes)
        body = Shake(random, (0.15 * DEGREE, 0.15 * DEGREE, 0.02 * DEGREE), (1.0, 4.0))
        ride = _by_velocity(random, 0.4, (1.0, 12.0))
        engine = _by_velocity(random, 0.15, (20.0, 45.0))

        def part(t: FloatArray) -> FloatArray:
            out = np.empty((len(t), 6))
            v, rate = first + pull.integral(t), turn.value(t)
            yaw, hill = turn.integral(t), slope.value(t)
            share = np.clip(v / 15.0, 0.0, 2.0)[:, None]
            along = v * np.cos(hill)
            out[:, 0], out[:, 1] = along * np.cos(yaw), along * np.sin(yaw)
            out[:, 2] = -v * np.sin(hill)
            out[:, :3] += share * ride(t) + (0.02 + share) * engine(t)
            shaken = share * body(t)
            # it leans outward, squats and dives
            out[:, 3] = shaken[:, 0] - 0.5 * DEGREE * v * rate
            out[:, 4] = shaken[:, 1] + hill + 0.4 * DEGREE * pull.value(t)
            out[:, 5] = shaken[:, 2] + yaw
            return out

        return part

    return make


def _drone(seconds: float, random: Random) -> Part:
    t, velocity = 12.0, np.zeros(3)
    pulses: list[list[tuple[float, float, float]]] = [[], [], []]
    turns: list[tuple[float, float, float]] = []
    heading = 0.0
    # off the ground, then from leg to leg, and down again
    while t < seconds - 25.0:
        target = np.append(
            random.uniform(2.0, 14.0) * _circle(random.uniform(-np.pi, np.pi)),
            random.uniform(-2.0, 2.0),
        )
        if random.random() < 0.25:
            target[:2] = 0.0
        over = t
        for axis in range(3):
            more, end = _pulse(t, target[axis] - velocity[axis], float(random.uniform(1.5, 4.0)))
            pulses[axis] += more
            over = max(over, end)
        velocity, t = target, over
        if random.random() < 0.6:
            change = float(random.uniform(-np.pi, np.pi))
            length = max(abs(change) / 0.8, 1.0)
            heading += change
            turns.append((t, length, heading))
            t += length
        t += float(random.uniform(1.0, 15.0))
    for axis in range(3):
        pulses[axis] += _pulse(t, -velocity[axis], 2.0)[0]
    pull = [Levels(0.0, one) for one in pulses]
    yaw = Levels(0.0, turns)
    flying = Levels(0.0, [(10.0, 2.0, 1.0), (t + 10.0, 2.0, 0.0)])
    gusts = Shake(random, (0.25, 0.25, 0.15), (0.03, 1.0), 12)
    body = Shake(random, (0.7 * DEGREE, 0.7 * DEGREE, 0.5 * DEGREE), (0.5, 6.0), 12)
    rotors = _by_velocity(random, 1.5, (25.0, 48.0))

    def part(t: FloatArray) -> FloatArray:
        out = np.empty((len(t), 6))
        up = flying.value(t)[:, None]
        v = np.stack([one.integral(t) for one in pull], axis=1)
        a = np.stack([one.value(t) for one in pull], axis=1)
        out[:, :3] = v + up * (gusts(t) + rotors(t))
        shaken, psi = up * body(t), yaw.value(t)
        # thrust along the body's z: tilt accelerates, and holds against drag
        north, east = a[:, 0] + 0.15 * v[:, 0], a[:, 1] + 0.15 * v[:, 1]
        ahead = north * np.cos(psi) + east * np.sin(psi)
        right = -north * np.sin(psi) + east * np.cos(psi)
        out[:, 3] = np.arctan(right / G) + shaken[:, 0] + 0.01
        out[:, 4] = -np.arctan(ahead / G) + shaken[:, 1] - 0.02
        out[:, 5] = psi + shaken[:, 2]
        return out

    return part


def _circle(angle: float) -> FloatArray:
    return np.array([np.cos(angle), np.sin(angle)])


def _afloat(
    speed: Levels,
    turn: Levels,
    rolling: Part,
    shaking: tuple[Part, Part],
    lean: float,
    arm: FloatArray,
) -> Part:
    """A ship that leans out of turns by `lean` rad a m/s^2, `arm` from where it rolls about."""

    def part(t: FloatArray) -> FloatArray:
        out = np.empty((len(t), 6))
        v, rate, yaw = speed.value(t), turn.value(t), turn.integral(t)
        out[:, 0], out[:, 1], out[:, 2] = v * np.cos(yaw), v * np.sin(yaw), 0.0
        out[:, :3] += shaking[0](t) + shaking[1](t)
        out[:, 3:] = rolling(t)
        out[:, 3] -= lean * v * rate
        out[:, 5] += yaw
        dt = 1e-3
        swing = (rolling(t + dt) - rolling(t - dt)) / (2.0 * dt)
        out[:, 2] += swing[:, 0] * arm[1] - swing[:, 1] * arm[0]
        side = -swing[:, 0] * arm[2]
        out[:, 0] -= side * np.sin(yaw)
        out[:, 1] += side * np.cos(yaw)
        return out

    return part


def _ship(waves: float) -> Callable[[float, Random], Part]:
    """A ship in waves of 8 to 12 s, with rolling of so many degrees RMS."""

    def make(seconds: float, random: Random) -> Part:
        turns: list[tuple[float, float, float]] = []
        speeds: list[tuple[float, float, float]] = []
        first = float(random.uniform(5.0, 10.0))
        t = float(random.uniform(30.0, 120.0))
        while t < seconds:
            if random.random() < 0.7:
                rate = float(random.choice([-1.0, 1.0]) * random.uniform(0.5, 1.8)) * DEGREE
                hold = float(random.uniform(30.0, 200.0)) * DEGREE / abs(rate)
                turns += [(t, 15.0, rate), (t + 15.0 + hold, 15.0, 0.0)]
                t += 30.0 + hold
            else:
                length = float(random.uniform(40.0, 90.0))
                speeds.append((t, length, float(random.uniform(3.0, 11.0))))
                t += length
            t += float(random.uniform(20.0, 200.0))
        turn, speed = Levels(0.0, turns), Levels(first, speeds)
        band = (1.0 / 12.0, 1.0 / 8.0)
        size = waves * DEGREE
        rolling = Shake(random, (size, 0.4 * size, 0.2 * size), band, 12)
        heaving = Shake(random, (0.12 * waves, 0.12 * waves, 0.15 * waves), band, 12)
        engine = _by_velocity(random, 0.03, (8.0, 40.0))
        arm = random.uniform(-6.0, 6.0, 3)

        return _afloat(speed, turn, rolling, (heaving, engine), 0.3, arm)

    return make


def _aircraft(seconds: float, random: Random) -> Part:
    """Steady straight flight and steady turns in smooth air, minutes of each."""
    turns: list[tuple[float, float, float]] = []
    speeds: list[tuple[float, float, float]] = []
    t = float(random.uniform(60.0, 120.0))
    while t < seconds:
        rate = float(random.choice([-1.0, 1.0]) * random.uniform(0.5, 3.0)) * DEGREE
        hold = float(random.uniform(40.0, 150.0))
        turns += [(t, 8.0, rate), (t + 8.0 + hold, 8.0, 0.0)]
        t += 16.0 + hold + float(random.uniform(30.0, 60.0))
        speeds.append((t, 20.0, float(random.uniform(45.0, 80.0))))
        t += 20.0 + float(random.uniform(60.0, 180.0))
    turn, speed = Levels(0.0, turns), Levels(_LEVEL_FLIGHT, speeds)
    air = Shake(random, (0.01 * DEGREE,) * 3, (0.1, 1.0))
    engine = _by_velocity(random, 0.2, (20.0, 45.0))

    def part(t: FloatArray) -> FloatArray:
        out = np.empty((len(t), 6))
        v, rate, yaw = speed.value(t), turn.value(t), turn.integral(t)
        out[:, 0], out[:, 1], out[:, 2] = v * np.cos(yaw), v * np.sin(yaw), 0.0
        out[:, :3] += engine(t)
        out[:, 3:] = air(t)
        out[:, 3] += np.arctan(v * rate / G)
        out[:, 4] += 3.0 * DEGREE * (_LEVEL_FLIGHT / v) ** 2
        out[:, 5] += yaw
        return out

    return part


def _smooth_road(seconds: float, random: Random) -> Part:
    """A motorway without unevenness: minutes at one speed, minutes of one bend."""
    turns: list[tuple[float, float, float]] = []
    pulses, t = _pulse(20.0, 25.0, 2.0)
    speed = 25.0
    while t < seconds:
        t += float(random.uniform(40.0, 90.0))
        rate = float(random.choice([-1.0, 1.0]) * random.uniform(0.5, 2.0)) * DEGREE
        hold = float(random.uniform(30.0, 60.0))
        turns += [(t, 5.0, rate), (t + 5.0 + hold, 5.0, 0.0)]
        t += 10.0 + hold + float(random.uniform(10.0, 60.0))
        target = float(random.uniform(20.0, 36.0))
        more, t = _pulse(t, target - speed, float(random.uniform(0.5, 1.5)))
        pulses += more
        speed = target
    turn, pull = Levels(0.0, turns), Levels(0.0, pulses)
    engine = _by_velocity(random, 0.1, (20.0, 45.0))

    def part(t: FloatArray) -> FloatArray:
        out = np.empty((len(t), 6))
        v, rate, yaw = pull.integral(t), turn.value(t), turn.integral(t)
        out[:, 0], out[:, 1], out[:, 2] = v * np.cos(yaw), v * np.sin(yaw), 0.0
        out[:, :3] += engine(t)
        out[:, 3] = -0.3 * DEGREE * v * rate
        out[:, 4] = 0.01 + 0.3 * DEGREE * pull.value(t)
        out[:, 5] = yaw
        return out

    return part


def _hand(seconds: float, random: Random) -> Part:
    """Turned and moved about by a hand, with rests."""
    changes: list[tuple[float, float, float]] = []
    t = 8.0
    while t < seconds - 6.0:
        length = float(random.uniform(20.0, 90.0))
        changes += [(t, 1.5, 1.0), (t + 1.5 + length, 1.5, 0.0)]
        t += 3.0 + length + float(random.uniform(3.0, 8.0))
    moving = Levels(0.0, changes)
    sway = Shake(random, (0.3, 0.3, 0.25), (0.2, 1.2), 12)
    tremor = Shake(random, (0.02,) * 3, (3.0, 9.0), 12)
    turning = Shake(random, (0.5, 0.35, 0.8), (0.05, 0.8), 12)
    shaking = Shake(random, (0.01,) * 3, (3.0, 9.0), 12)

    def part(t: FloatArray) -> FloatArray:
        out = np.empty((len(t), 6))
        size = moving.value(t)[:, None]
        out[:, :3] = size * (sway(t) + tremor(t))
        out[:, 3:] = size * (turning(t) + shaking(t))
        return out

    return part


# --- kinds of which every size is drawn -------------------------------------------------------


def _between(random: Random, low: float, high: float) -> float:
    """A size, as likely within every octave."""
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def _any_car(seconds: float, random: Random) -> Part:
    """Tractors to sports cars, on fields to motorways; it may stop, and may begin in motion."""
    fast, pull_size = _between(random, 3.0, 45.0), _between(random, 0.3, 5.0)
    across, ramp = _between(random, 0.2, 6.0), _between(random, 0.7, 6.0)
    stops, first = random.random() < 0.5, 0.0 if random.random() < 0.5 else fast
    speed_now, t = first, float(random.uniform(3.0, 30.0))
    pulses: list[tuple[float, float, float]] = []
    turns: list[tuple[float, float, float]] = []
    slopes: list[tuple[float, float, float]] = []
    while t < seconds:
        target = 0.0 if stops and random.random() < 0.3 else fast * float(random.uniform(0.3, 1.0))
        if abs(target - speed_now) > 0.2:
            more, t = _pulse(t, target - speed_now, pull_size * float(random.uniform(0.3, 1.0)))
            pulses += more
            speed_now = target
        if speed_now and random.random() < 0.7:
            rate = float(random.choice([-1.0, 1.0])) * min(
                across * float(random.uniform(0.2, 1.0)) / speed_now, 0.6
            )
            hold = float(random.uniform(0.2, 3.0)) / abs(rate)
            turns += [(t, ramp, rate), (t + ramp + hold, ramp, 0.0)]
            t += 2.0 * ramp + hold
        slopes.append((t, 4.0, float(np.deg2rad(random.uniform(-6.0, 6.0)))))
        t += 4.0 + _between(random, 2.0, 60.0)
    pull, turn, slope = Levels(0.0, pulses), Levels(0.0, turns), Levels(0.0, slopes)
    angle = _between(random, 0.01, 0.6) * DEGREE
    body = Shake(random, (angle, angle, 0.2 * angle), (0.7, 4.0))
    ride = _by_velocity(random, _between(random, 0.02, 1.5), (1.0, 12.0))
    idle = _by_velocity(random, _between(random, 1e-3, 0.2), (8.0, 20.0))

    def part(t: FloatArray) -> FloatArray:
        out = np.empty((len(t), 6))
        v, rate = first + pull.integral(t), turn.value(t)
        yaw, hill = turn.integral(t), slope.value(t)
        share = np.clip(v / 15.0, 0.0, 2.0)[:, None]
        along = v * np.cos(hill)
        out[:, 0], out[:, 1] = along * np.cos(yaw), along * np.sin(yaw)
        out[:, 2] = -v * np.sin(hill)
        out[:, :3] += share * ride(t) + idle(t)
        shaken = share * body(t)
        out[:, 3] = shaken[:, 0] - 0.4 * DEGREE * v * rate
        out[:, 4] = shaken[:, 1] + hill + 0.4 * DEGREE * pull.value(t)
        out[:, 5] = shaken[:, 2] + yaw
        return out

    return part


def _any_drone(seconds: float, random: Random) -> Part:
    """It hovers and goes from leg to leg, slowly or fast; it may be in the air at the start."""
    fast, pull_size = _between(random, 0.3, 25.0), _between(random, 0.3, 8.0)
    t, velocity = float(random.uniform(8.0, 20.0)), np.zeros(3)
    aloft = random.random() < 0.3
    pulses: list[list[tuple[float, float, float]]] = [[], [], []]
    turns: list[tuple[float, float, float]] = []
    heading = 0.0
    while t < seconds:
        target = np.append(
            fast * random.uniform(0.1, 1.0) * _circle(random.uniform(-np.pi, np.pi)),
            0.2 * fast * random.uniform(-1.0, 1.0),
        )
        if random.random() < 0.3:
            target[:] = 0.0
        over = t
        for axis in range(3):
            size = pull_size * float(random.uniform(0.3, 1.0))
            more, end = _pulse(t, target[axis] - velocity[axis], size)
            pulses[axis] += more
            over = max(over, end)
        velocity, t = target, over
        if random.random() < 0.6:
            change = float(random.uniform(-np.pi, np.pi))
            length = max(abs(change) / _between(random, 0.1, 2.0), 1.0)
            heading += change
            turns.append((t, length, heading))
            t += length
        t += _between(random, 1.0, 40.0)
    pull, yaw = [Levels(0.0, one) for one in pulses], Levels(0.0, turns)
    flying = Levels(1.0 if aloft else 0.0, [] if aloft else [(5.0, 2.0, 1.0)])
    gust, angle = _between(random, 0.02, 0.6), _between(random, 0.05, 2.0) * DEGREE
    gusts = Shake(random, (gust, gust, 0.6 * gust), (0.03, 1.0), 12)
    body = Shake(random, (angle, angle, 0.7 * angle), (0.5, 6.0), 12)
    rotors = _by_velocity(random, _between(random, 0.05, 3.0), (12.0, 22.0))
    lean, drag = random.uniform(-0.05, 0.05, 2), _between(random, 0.03, 0.4)

    def part(t: FloatArray) -> FloatArray:
        out = np.empty((len(t), 6))
        up = flying.value(t)[:, None]
        v = np.stack([one.integral(t) for one in pull], axis=1)
        a = np.stack([one.value(t) for one in pull], axis=1)
        out[:, :3] = v + up * (gusts(t) + rotors(t))
        shaken, psi = up * body(t), yaw.value(t)
        north, east = a[:, 0] + drag * v[:, 0], a[:, 1] + drag * v[:, 1]
        ahead = north * np.cos(psi) + east * np.sin(psi)
        right = -north * np.sin(psi) + east * np.cos(psi)
        out[:, 3] = np.arctan(right / G) + shaken[:, 0] + lean[0]
        out[:, 4] = -np.arctan(ahead / G) + shaken[:, 1] + lean[1]
        out[:, 5] = psi + shaken[:, 2]
        return out

    return part


def _any_ship(seconds: float, random: Random) -> Part:
    """From a buoy to a tanker: waves of 2 to 25 s, rolling of 0.005 to 12 deg."""
    first, fast = _between(random, 0.5, 15.0), _between(random, 1.0, 15.0)
    turning, ramp = _between(random, 0.2, 5.0) * DEGREE, _between(random, 3.0, 30.0)
    turns: list[tuple[float, float, float]] = []
    speeds: list[tuple[float, float, float]] = []
    t = _between(random, 5.0, 150.0)
    while t < seconds:
        if random.random() < 0.7:
            rate = float(random.choice([-1.0, 1.0]) * random.uniform(0.2, 1.0)) * turning
            hold = float(random.uniform(0.2, 4.0)) / abs(rate)
            turns += [(t, ramp, rate), (t + ramp + hold, ramp, 0.0)]
            t += 2.0 * ramp + hold
        else:
            length = _between(random, 10.0, 90.0)
            speeds.append((t, length, fast * float(random.uniform(0.1, 1.0))))
            t += length
        t += _between(random, 5.0, 200.0)
    turn, speed = Levels(0.0, turns), Levels(first, speeds)
    period, size = _between(random, 3.0, 20.0), _between(random, 0.005, 12.0) * DEGREE
    band = (0.8 / period, 1.3 / period)
    rolling = Shake(random, (size, random.uniform(0.1, 0.6) * size, 0.2 * size), band, 12)
    # water goes round by as much as the waves are steep
    heave = min(size, 0.15) * random.uniform(0.3, 1.5) * G * period / (2.0 * np.pi) / 2.0
    heaving = Shake(random, (0.7 * heave, 0.7 * heave, heave), band, 12)
    engine = _by_velocity(random, _between(random, 1e-3, 0.1), (8.0, 20.0))
    lean, arm = _between(random, 0.02, 0.6), random.uniform(-6.0, 6.0, 3)

    return _afloat(speed, turn, rolling, (heaving, engine), lean, arm)


def _any_aircraft(seconds: float, random: Random) -> Part:
    """From a glider to an airliner: turns of 2 to 60 deg of bank, smooth air or gusts."""
    first, ramp = _between(random, 20.0, 250.0), _between(random, 2.0, 12.0)
    turns: list[tuple[float, float, float]] = []
    speeds: list[tuple[float, float, float]] = []
    climbs: list[tuple[float, float, float]] = []
    t, v = _between(random, 5.0, 120.0), first
    while t < seconds:
        bank = float(random.choice([-1.0, 1.0])) * _between(random, 2.0, 60.0) * DEGREE
        rate = G * np.tan(bank) / v
        hold = _between(random, 5.0, 200.0)
        turns += [(t, ramp, rate), (t + ramp + hold, ramp, 0.0)]
        t += 2.0 * ramp + hold + _between(random, 3.0, 60.0)
        v = first * float(random.uniform(0.8, 1.3))
        speeds.append((t, 20.0, v))
        climbs.append((t, 15.0, float(random.uniform(-0.08, 0.08))))
        t += 20.0 + _between(random, 3.0, 180.0)
    turn, speed, climb = Levels(0.0, turns), Levels(first, speeds), Levels(0.0, climbs)
    size = _between(random, 0.003, 2.0) * DEGREE
    air = Shake(random, (size, 0.5 * size, 0.3 * size), (0.1, 1.0))
    gusts = Shake(random, (G * size,) * 3, (0.1, 1.0))
    engine = _by_velocity(random, _between(random, 0.01, 1.0), (10.0, 20.0))

    def part(t: FloatArray) -> FloatArray:
        out = np.empty((len(t), 6))
        v, rate, yaw, path = speed.value(t), turn.value(t), turn.integral(t), climb.value(t)
        out[:, 0], out[:, 1] = v * np.cos(path) * np.cos(yaw), v * np.cos(path) * np.sin(yaw)
        out[:, 2] = -v * np.sin(path)
        out[:, :3] += engine(t) + gusts(t)
        out[:, 3:] = air(t)
        out[:, 3] += np.arctan(v * rate / G)
        out[:, 4] += path + 3.0 * DEGREE * (first / v) ** 2
        out[:, 5] += yaw
        return out

    return part


def _any_hand(seconds: float, random: Random) -> Part:
    """Slow or fast, turned or moved; it may begin without a rest, and may never rest."""
    pauses, begins_still = random.random() < 0.7, random.random() < 0.6
    ramp = _between(random, 0.5, 8.0)
    changes: list[tuple[float, float, float]] = []
    t = 8.0 if begins_still else 0.5
    while t < seconds - 6.0 and (pauses or not changes):
        length = _between(random, 5.0, 120.0) if pauses else seconds
        changes += [(t, ramp, 1.0), (t + ramp + length, ramp, 0.0)]
        t += 2.0 * ramp + length + _between(random, 2.0, 30.0)
    moving = Levels(0.0 if begins_still else 0.3, changes)
    low = _between(random, 0.02, 0.5)
    slow, fast = (low, 5.0 * low), (2.0 * low, 10.0 * low)
    swing, angle = _between(random, 0.02, 0.5), _between(random, 0.1, 1.2)
    # no more than a hand can: 25 rad/s would be at the gyros' stops
    angle, swing = min(angle, 1.0 / low), min(swing, 0.5 / np.sqrt(low))
    sway = Shake(random, (swing, swing, 0.8 * swing), fast, 12)
    turning = Shake(random, (0.6 * angle, 0.4 * angle, angle), slow, 12)
    tremor = Shake(random, (0.1 * swing,) * 3, (3.0, 9.0), 12)
    shaking = Shake(random, (0.01 * angle,) * 3, (3.0, 9.0), 12)

    def part(t: FloatArray) -> FloatArray:
        out = np.empty((len(t), 6))
        size = moving.value(t)[:, None]
        out[:, :3] = size * (sway(t) + tremor(t))
        out[:, 3:] = size * (turning(t) + shaking(t))
        return out

    return part


KINDS: dict[str, tuple[Callable[[float, Random], Part], float]] = {
    "car": (_car(True), 20.0),
    "car, never stops": (_car(False), 20.0),
    "drone": (_drone, 15.0),
    "ship": (_ship(5.0), 30.0),
    "hand": (_hand, 5.0),
    "aircraft, smooth air": (_aircraft, 20.0),
    "car, smooth road": (_smooth_road, 20.0),
    "ship, calm": (_ship(0.03), 30.0),
    "any car": (_any_car, 10.0),
    "any drone": (_any_drone, 6.0),
    "any ship": (_any_ship, 15.0),
    "any aircraft": (_any_aircraft, 12.0),
    "any hand": (_any_hand, 4.0),
}
"""Kinds of motion: what makes them, and how many minutes they usually last."""
