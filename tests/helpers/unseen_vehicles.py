"""Vehicles that are neither cars nor aircraft of the usual kind, by another program's simulation.

Motorcycles lean, trains turn slowly, tractors reverse, gliders circle in a wind, helicopters fly
sideways: each breaks an assumption that holds for cars and airliners. As in `unseen_drives`,
nothing here uses the product.
"""

import numpy as np

from tests.helpers.unseen_drives import (
    DEG,
    RATE,
    Motion,
    band_noise,
    banked,
    motion_of,
    random_levels,
    running_integral,
    smoothed,
    stop_and_go,
)

GRAVITY = 9.81


def motorcycle(seed: int, duration: float = 600.0) -> Motion:
    """It leans into its turns; the IMU lies 0.6 m above the road and swings with the lean."""
    random = np.random.default_rng([seed, 11])
    t = np.arange(0.0, duration, 1.0 / RATE)
    speed = smoothed(stop_and_go(random, t, 30.0), 2.0)
    sideways = smoothed(random_levels(random, t, (3.0, 10.0), 6.0), 2.0)
    turning = sideways * speed / np.maximum(speed, 9.0) ** 2
    heading = running_integral(turning, 2.0 * np.pi * random.random())
    lean = np.arctan(speed * turning / GRAVITY)
    swing = 0.6 * np.gradient(np.sin(lean), t)
    velocity = np.stack(
        [
            speed * np.cos(heading) - swing * np.sin(heading),
            speed * np.sin(heading) + swing * np.cos(heading),
            -0.6 * np.gradient(np.cos(lean), t),
        ],
        axis=1,
    )
    shaking = np.minimum(speed / 15.0, 1.0)[:, None]
    velocity += shaking * (np.array([0.01, 0.01, 0.02]) * band_noise(random, t, 1.5, 9.0))
    dive = -0.01 * np.gradient(speed, t)
    angles = np.stack([lean, dive, heading], axis=1)
    angles += shaking * (0.3 * DEG * band_noise(random, t, 1.5, 9.0))
    return motion_of(t, velocity, angles)


def train(seed: int, duration: float = 600.0) -> Motion:
    """Up to 45 m/s, long bends on canted track, half a minute at stations; slow to change."""
    random = np.random.default_rng([seed, 12])
    t = np.arange(0.0, duration, 1.0 / RATE)
    times, speeds = [0.0, 40.0], [0.0, 0.0]
    while times[-1] < duration:
        after = 0.0 if speeds[-1] > 0.0 and random.random() < 0.4 else random.uniform(15.0, 45.0)
        times.append(times[-1] + abs(after - speeds[-1]) / random.uniform(0.3, 0.8))
        times.append(times[-1] + random.uniform(25.0, 90.0))
        speeds += [after, after]
    speed = smoothed(np.interp(t, times, speeds), 4.0)
    bend = smoothed(random_levels(random, t, (20.0, 60.0), 1.0 / 500.0), 8.0)
    turning = bend * np.minimum(speed, 30.0)
    heading = running_integral(turning, 2.0 * np.pi * random.random())
    slope = 0.008 * smoothed(random_levels(random, t, (30.0, 90.0), 1.0), 20.0)
    velocity = np.stack([speed * np.cos(heading), speed * np.sin(heading), -speed * slope], axis=1)
    rolls = np.minimum(speed / 20.0, 1.0)[:, None]
    velocity += rolls * (np.array([0.003, 0.008, 0.006]) * band_noise(random, t, 0.7, 6.0))
    cant = np.clip(np.arctan(speed * turning / GRAVITY), -0.1, 0.1)
    angles = np.stack([cant, np.arctan(slope), heading], axis=1)
    angles += rolls * (DEG * np.array([0.2, 0.05, 0.03]) * band_noise(random, t, 0.5, 4.0))
    return motion_of(t, velocity, angles)


def tractor(seed: int, duration: float = 600.0) -> Motion:
    """Rows up and down a rough field at walking pace; it turns at their ends or reverses."""
    random = np.random.default_rng([seed, 13])
    t = np.arange(0.0, duration, 1.0 / RATE)
    times, speeds, rates = [0.0, 20.0], [0.0, 0.0], [0.0, 0.0]
    pace = random.uniform(1.0, 3.5)
    while times[-1] < duration:
        for seconds, speed, rate in _row(random, pace):
            times += [times[-1] + 2.0, times[-1] + 2.0 + seconds]
            speeds += [speed, speed]
            rates += [rate, rate]
    speed = smoothed(np.interp(t, times, speeds), 2.0)
    turning = smoothed(np.interp(t, times, rates), 2.0) * np.minimum(np.abs(speed) / 0.5, 1.0)
    heading = running_integral(turning, 2.0 * np.pi * random.random())
    velocity = np.stack([speed * np.cos(heading), speed * np.sin(heading), 0.0 * t], axis=1)
    moves = np.minimum(np.abs(speed), 1.0)[:, None]
    velocity += moves * (np.array([0.02, 0.03, 0.03]) * band_noise(random, t, 0.3, 4.0))
    angles = np.stack([0.0 * t, 0.0 * t, heading], axis=1)
    angles += moves * (DEG * np.array([2.0, 1.5, 0.3]) * band_noise(random, t, 0.3, 4.0))
    return motion_of(t, velocity, angles)


def _row(random: np.random.Generator, pace: float) -> list[tuple[float, float, float]]:
    """Seconds, speed and rate of turn of a row and of what follows at its end."""
    seconds = random.uniform(30.0, 80.0)
    side = float(random.choice([-1.0, 1.0]))
    row = [(seconds, pace, 0.0)]
    if random.random() < 0.3:
        return [*row, (random.uniform(4.0, 12.0), -0.7 * pace, 0.0), (5.0, 0.0, 0.0)]
    return [*row, (10.0, 0.7 * pace, side * np.pi / 12.0)]


def robot(seed: int, duration: float = 240.0) -> Motion:
    """A mower on its tracks: 0.4 to 1 m/s, stops, turns on the spot, and often goes backwards."""
    random = np.random.default_rng([seed, 16])
    t = np.arange(0.0, duration, 1.0 / RATE)
    pace = random.uniform(0.4, 1.0)
    times, speeds, rates = [0.0, 15.0], [0.0, 0.0], [0.0, 0.0]
    while times[-1] < duration:
        ahead = (random.uniform(5.0, 20.0), float(random.choice([1.0, 1.0, -1.0])) * pace, 0.0)
        round_ = (random.uniform(2.0, 6.0), 0.0, random.uniform(-0.6, 0.6))
        for seconds, speed, rate in (ahead, round_):
            times += [times[-1] + 0.6, times[-1] + 0.6 + seconds]
            speeds += [speed, speed]
            rates += [rate, rate]
    speed = smoothed(np.interp(t, times, speeds), 0.6)
    heading = running_integral(
        smoothed(np.interp(t, times, rates), 0.6), 2.0 * np.pi * random.random()
    )
    velocity = np.stack([speed * np.cos(heading), speed * np.sin(heading), 0.0 * t], axis=1)
    moves = np.minimum(np.abs(speed) / 0.5, 1.0)[:, None]
    velocity += moves * (np.array([0.01, 0.01, 0.02]) * band_noise(random, t, 1.0, 8.0))
    angles = np.stack([0.0 * t, 0.0 * t, heading], axis=1)
    angles += moves * (DEG * np.array([1.0, 1.0, 0.2]) * band_noise(random, t, 1.0, 6.0))
    return motion_of(t, velocity, angles)


def glider(seed: int, duration: float = 600.0) -> Motion:
    """Minutes of circling in a wind, glides between, in the air from the start on."""
    random = np.random.default_rng([seed, 14])
    t = np.arange(0.0, duration, 1.0 / RATE)
    ends, banks = [0.0], []
    while ends[-1] < duration:
        circling = len(banks) % 2 == 0
        ends.append(ends[-1] + random.uniform(60.0, 180.0))
        side = random.choice([-1.0, 1.0])
        banks.append(side * random.uniform(28.0, 42.0) * DEG if circling else 0.0)
    bank = smoothed(np.array(banks)[np.searchsorted(ends, t, side="right") - 1], 6.0)
    speed = 27.0 + smoothed(random_levels(random, t, (10.0, 40.0), 5.0), 10.0)
    climb = np.where(np.abs(bank) > 0.3, 1.5, -1.2)
    velocity, angles = banked(random, t, speed, bank, smoothed(climb, 10.0))
    velocity[:, :2] += random.uniform(-8.0, 8.0, 2)
    velocity += 0.4 * band_noise(random, t, 0.1, 1.0)
    angles += DEG * np.array([2.0, 1.0, 1.0]) * band_noise(random, t, 0.1, 1.0)
    return motion_of(t, velocity, angles)


def helicopter(seed: int, duration: float = 600.0) -> Motion:
    """It hovers, turns on the spot and flies in any direction of its body, and shakes."""
    random = np.random.default_rng([seed, 15])
    t = np.arange(0.0, duration, 1.0 / RATE)
    steps = [random_levels(random, t, (10.0, 45.0), most) for most in (25.0, 25.0, 3.0)]
    velocity = np.stack([smoothed(column, 12.0) for column in steps], axis=1)
    turning = smoothed(random_levels(random, t, (5.0, 30.0), 0.4), 4.0)
    heading = running_integral(turning, 2.0 * np.pi * random.random())
    force = np.gradient(velocity, t, axis=0) / GRAVITY
    c, s = np.cos(heading), np.sin(heading)
    ahead, right = force[:, 0] * c + force[:, 1] * s, force[:, 1] * c - force[:, 0] * s
    angles = np.stack([np.arctan(right), -np.arctan(ahead), heading], axis=1)
    velocity += 0.3 * band_noise(random, t, 0.1, 0.8) + 0.03 * band_noise(random, t, 4.0, 20.0)
    angles += DEG * (
        1.0 * band_noise(random, t, 0.1, 1.0) + 0.15 * band_noise(random, t, 4.0, 20.0)
    )
    return motion_of(t, velocity, angles)


VEHICLES = {f.__name__: f for f in (motorcycle, train, tractor, glider, helicopter, robot)}
