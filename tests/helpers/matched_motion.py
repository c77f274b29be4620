"""Motion and sensors drawn from the attitude smoother's own model."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.signal import lfilter

from sinstool.core.earth import SEMI_MAJOR_AXIS
from sinstool.core.rotation import conjugate, exp, multiply, rotate, tilt_and_heading
from sinstool.core.streams import Solution
from sinstool.core.timeline import SECOND
from sinstool.methods.attitude_smoother.epochs import EpochStage, turns_of_way
from sinstool.methods.attitude_smoother.model import EPOCH_S, GRAVITY
from sinstool.methods.strapdown.attitude import AttitudePropagator

MAX_GAP_NS = 60_000_000
NO_STOPS = np.full(3, np.inf)


@dataclass
class Drawn:
    """A log and its truth at every sample.

    Attributes
    ----------
    solution : Solution
        Integrated attitude and the measurements.
    q_nb : ndarray, shape (n, 4)
        True.
    bias : ndarray, shape (n, 3)
        True, beyond what was taken off, rad/s.
    accel_bias : ndarray, shape (3,)
        True, m/s^2.
    velocity, position : ndarray, shape (n, 3)
        True, about the motion's mean, m/s and m.
    """

    solution: Solution
    q_nb: np.ndarray
    bias: np.ndarray
    accel_bias: np.ndarray
    velocity: np.ndarray
    position: np.ndarray


def drawn(motion, sensors, seconds, seed, *, turning=0.3, rate_hz=50, rests=()):
    """A log whose every error and motion is of the smoother's model.

    Parameters
    ----------
    turning : float
        Root mean square rate of each axis, rad/s; it changes within 3 s.
    rests : sequence of tuple of 2 float
        Begin and end, s, of rest: nothing moves and nothing turns.
    """
    random = np.random.default_rng(seed)
    dt = 1.0 / rate_hz
    per = round(EPOCH_S * rate_hz)
    count = round(seconds / EPOCH_S)
    n = count * per
    resting = np.zeros(count, bool)
    for begin, end in rests:
        resting[round(begin / EPOCH_S) : round(end / EPOCH_S)] = True
    still = np.repeat(resting, per)
    decay = np.exp(-dt / 3.0)
    rate = random.standard_normal((n, 3)) * turning * np.sqrt(1.0 - decay**2)
    rate[0] = turning * random.standard_normal(3)
    rate = lfilter([1.0], [1.0, -decay], rate, axis=0)
    rate[still] = 0.0
    tilt = random.normal(0.0, 0.15, 3) * [1.0, 1.0, 0.0]
    q_first = exp(tilt)
    q = turned(q_first, rate, dt)
    v = np.sqrt(motion.first_velocity_variance) * random.standard_normal(3)
    p = np.sqrt(motion.position_variance) * random.standard_normal(3)
    shaken = motion.density / np.sqrt(EPOCH_S) * random.standard_normal((count, 3))
    turn = rotate(q[:-1], rate)[:, 2:].reshape(count, per).sum(axis=1, keepdims=True) * dt
    turn = turns_of_way(turn)[:, 0] * motion.follows
    acceleration, velocity, position = moved(motion, v, p, shaken, turn, resting)
    excess = sensors.gravity * random.standard_normal() + sensors.gravity_walk * np.sqrt(
        EPOCH_S
    ) * np.cumsum(random.standard_normal(count))
    felt = acceleration - np.stack([0.0 * excess, 0.0 * excess, GRAVITY + excess], axis=1)
    middle = multiply(q[:-1], exp(0.5 * rate * dt))
    felt = np.repeat(felt, per, axis=0)
    felt += sensors.velocity_walk / np.sqrt(dt) * random.standard_normal((n, 3))
    force = rotate(conjugate(middle), felt)
    bias = sensors.bias * random.standard_normal(3) + sensors.bias_walk * np.sqrt(dt) * np.cumsum(
        random.standard_normal((n, 3)), axis=0
    )
    accel_bias = sensors.accel_bias * random.standard_normal(3)
    force += accel_bias
    spread = sensors.angle_random_walk**2 + sensors.rate_error**2 * np.sum(
        rate**2, axis=1, keepdims=True
    )
    # of NED, as the body goes over the Earth
    over = np.repeat(velocity[:-1] / SEMI_MAJOR_AXIS * (motion.c0 == 0.0), per, axis=0)
    earth = np.stack([over[:, 1], -over[:, 0], np.zeros(n)], axis=1)
    gyro = (
        rate
        + rotate(conjugate(middle), earth)
        + bias
        + np.sqrt(spread / dt) * random.standard_normal((n, 3))
    )
    integrated = turned(q_first, gyro, dt)
    solution = solution_of(dt, integrated, gyro, force)
    at = np.arange(n + 1) // per
    bias = np.concatenate([bias[:1], bias])
    return Drawn(solution, q, bias, accel_bias, velocity[at], position[at])


def moved(motion, v, p, shaken, turn, resting):
    """Acceleration, shape (n, 3), held through each epoch; velocity and position, (n + 1, 3).

    In numbers, as arrays of three take most of the time of a draw.

    Parameters
    ----------
    v, p : ndarray, shape (3,)
        At first.
    shaken : ndarray, shape (n, 3)
        Acceleration by noise.
    turn : ndarray, shape (n,)
        By which the velocity turns with the body, rad.
    resting : ndarray of bool, shape (n,)
    """
    c0, c1, t = float(motion.c0), float(motion.c1), EPOCH_S
    vx, vy, vz = v.tolist()
    px, py, pz = p.tolist()
    rows = [(0.0, 0.0, 0.0, vx, vy, vz, px, py, pz)]
    steps = zip(shaken.tolist(), np.cos(turn).tolist(), np.sin(turn).tolist(), resting, strict=True)
    for (ax, ay, az), c, s, rests in steps:
        if rests:
            vx = vy = vz = ax = ay = az = 0.0
        else:
            ax += (c * vx - s * vy - vx) / t - c1 * vx - c0 * px
            ay += (s * vx + c * vy - vy) / t - c1 * vy - c0 * py
            az -= c1 * vz + c0 * pz
        px += vx * t + 0.5 * ax * t * t
        py += vy * t + 0.5 * ay * t * t
        pz += vz * t + 0.5 * az * t * t
        vx += ax * t
        vy += ay * t
        vz += az * t
        rows.append((ax, ay, az, vx, vy, vz, px, py, pz))
    every = np.array(rows)
    return every[1:, :3], every[:, 3:6], every[:, 6:]


def turned(q_first, rate, dt):
    """Attitudes from a first one on, shape (n + 1, 4), by rates of n samples every `dt` s."""
    after = AttitudePropagator(q_first).push(rate * dt, np.full(len(rate), dt))
    return np.concatenate([q_first[None], after])


def solution_of(dt, q_nb, gyro, force):
    """A solution of samples every `dt` s; its attitude has one instant more, the first."""
    time_ns = np.arange(len(q_nb)) * round(dt * SECOND)
    first = np.zeros((1, 3))
    return Solution(
        time_ns, time_ns, q_nb, np.concatenate([first, gyro]), np.concatenate([first, force])
    )


def epochs_of(solution, blocks=()):
    """Epochs of a solution, pushed in blocks that end at rows."""
    stage = EpochStage(MAX_GAP_NS, NO_STOPS)
    limits = [0, *blocks, len(solution)]
    for begin, end in pairwise(limits):
        if end > begin:
            stage.push(solution.rows(slice(begin, end)))
    return stage.finish()


def tilt_error(q_true, q):
    """Errors of tilt, shape (n, 2), and of heading, rad."""
    return tilt_and_heading(multiply(q_true, conjugate(q)))
