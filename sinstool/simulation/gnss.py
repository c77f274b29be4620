"""GNSS fixes of a simulated vehicle: coloured noise, latency, lever arm, faults."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sinstool.core import earth
from sinstool.core.arrays import ArrayLike, FloatArray, IntArray
from sinstool.core.rotation import wrapped
from sinstool.simulation.moments import Moments, moments
from sinstool.simulation.sensors import markov
from sinstool.simulation.truth import Trajectory

Triple = tuple[float, float, float]
Span = tuple[float, float]


@dataclass(frozen=True)
class GnssErrors:
    """Sizes of the errors: white noise plus a first-order Markov process.

    Attributes
    ----------
    position_white, position_markov : tuple of float
        Standard deviations of north, east and down, m.
    velocity_white, velocity_markov : tuple of float
        The same of velocity, m/s.
    position_time, velocity_time : float
        Correlation times of the Markov processes, s.
    """

    position_white: Triple = (0.0, 0.0, 0.0)
    position_markov: Triple = (0.0, 0.0, 0.0)
    position_time: float = 100.0
    velocity_white: Triple = (0.0, 0.0, 0.0)
    velocity_markov: Triple = (0.0, 0.0, 0.0)
    velocity_time: float = 100.0


MODELS = {
    "perfect": GnssErrors(),
    # White noise of velocity, and a wandering position: for alignment in flight.
    "launch": GnssErrors((1.0, 1.0, 1.0), (4.9, 4.9, 4.9), 60.0, (0.1, 0.1, 0.1)),
    # Coloured noise of both: for the filters that integrate INS and GNSS.
    "coloured": GnssErrors(
        (2.0, 2.0, 3.0), (5.0, 5.0, 8.0), 200.0, (0.05, 0.05, 0.08), (0.1, 0.1, 0.15), 60.0
    ),
}


@dataclass(frozen=True)
class Jump:
    """A step of the position for a time.

    Attributes
    ----------
    start, end : float
        Seconds after the trajectory's first instant.
    offset_n : tuple of float
        North, east, down, m.
    """

    start: float
    end: float
    offset_n: Triple


@dataclass(frozen=True)
class GnssFaults:
    """Faults. Spans are in seconds after the trajectory's first instant, [start, end).

    Attributes
    ----------
    outages : tuple of (start, end)
        Without fixes.
    jumps : tuple of Jump
        Steps of the position.
    outlier_fraction : float
        Probability that a fix is an outlier.
    outlier_position, outlier_velocity : float
        Errors of an outlier, in random directions, m and m/s.
    flat : tuple of (start, end)
        Fixes without height: height and vertical velocity are NaN.
    without_velocity : tuple of (start, end)
        Velocity is NaN.
    """

    outages: tuple[Span, ...] = ()
    jumps: tuple[Jump, ...] = ()
    outlier_fraction: float = 0.0
    outlier_position: float = 0.0
    outlier_velocity: float = 0.0
    flat: tuple[Span, ...] = ()
    without_velocity: tuple[Span, ...] = ()


@dataclass(frozen=True)
class GnssSamples:
    """Fixes, and the true motion behind them.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (m,)
        Stamps; a fix is valid ``latency`` before its stamp.
    latitude, longitude : ndarray, shape (m,)
        rad; longitude within (-pi, pi].
    height : ndarray, shape (m,)
        Ellipsoidal, m; NaN for fixes without it.
    velocity_n : ndarray, shape (m, 3)
        NED, m/s; NaN where missing.
    sigma_position, sigma_velocity : ndarray, shape (m, 3)
        As the receiver would state them: those of the error model, without faults; m, m/s.
    outlier : ndarray of bool, shape (m,)
        Whether the fix is an outlier.
    truth : Moments
        Motion of the antenna at the times at which the fixes are valid.
    """

    time_ns: IntArray
    latitude: FloatArray
    longitude: FloatArray
    height: FloatArray
    velocity_n: FloatArray
    sigma_position: FloatArray
    sigma_velocity: FloatArray
    outlier: np.ndarray
    truth: Moments

    def __len__(self) -> int:
        return len(self.time_ns)


@dataclass(frozen=True)
class Receiver:
    """A receiver and its antenna.

    Attributes
    ----------
    rate_hz : float
        Fixes per second.
    offset_s : float
        From the trajectory's first instant to the first stamp; stamps may lie between IMU samples.
    latency_s : float
        From the time at which a fix is valid to its stamp.
    lever_arm_b : tuple of float
        From the IMU to the antenna, FRD, m.
    errors : GnssErrors
        Noise.
    faults : GnssFaults
        Faults; none by default.
    """

    rate_hz: float = 10.0
    offset_s: float = 0.0
    latency_s: float = 0.0
    lever_arm_b: Triple = (0.0, 0.0, 0.0)
    errors: GnssErrors = field(default_factory=lambda: MODELS["launch"])
    faults: GnssFaults = field(default_factory=GnssFaults)


def gnss_samples(
    trajectory: Trajectory, receiver: Receiver, seed: int, truth: Moments | None = None
) -> GnssSamples:
    """Fixes of a receiver along a trajectory.

    Parameters
    ----------
    seed : int
        Seed of the random numbers. The noise does not depend on the faults: an outage or an outlier
        leaves the other fixes unchanged.
    truth : Moments, optional
        :func:`true_moments` of the same trajectory and receiver, which saves the interpolation for
        each of many seeds.

    Raises
    ------
    ValueError
        If the rate, the latency or the offset is impossible, or no fix lies within the trajectory.
    """
    motion = true_moments(trajectory, receiver) if truth is None else truth
    errors, faults = receiver.errors, receiver.faults
    noise, misfortune = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    m = len(motion.time_ns)
    step = 1.0 / receiver.rate_hz
    position = _noise(
        errors.position_white, errors.position_markov, errors.position_time, noise, m, step
    )
    velocity = _noise(
        errors.velocity_white, errors.velocity_markov, errors.velocity_time, noise, m, step
    )
    stamps = motion.time_ns + round(receiver.latency_s * 1e9)
    after = (stamps - trajectory.time_ns[0]) * 1e-9
    outlier = misfortune.random(m) < faults.outlier_fraction
    position[outlier] += faults.outlier_position * _directions(misfortune, m)[outlier]
    velocity[outlier] += faults.outlier_velocity * _directions(misfortune, m)[outlier]
    for jump in faults.jumps:
        position[_within(after, ((jump.start, jump.end),))] += jump.offset_n
    latitude, longitude = earth.displaced(
        motion.latitude, motion.longitude, motion.height, position[:, 0], position[:, 1]
    )
    height = motion.height - position[:, 2]
    velocity += motion.velocity_n
    flat = _within(after, faults.flat)
    height[flat] = np.nan
    velocity[flat, 2] = np.nan
    velocity[_within(after, faults.without_velocity)] = np.nan
    received = ~_within(after, faults.outages)
    rows = int(received.sum())
    return GnssSamples(
        stamps[received],
        latitude[received],
        wrapped(longitude)[received],
        height[received],
        velocity[received],
        np.tile(np.hypot(errors.position_white, errors.position_markov), (rows, 1)),
        np.tile(np.hypot(errors.velocity_white, errors.velocity_markov), (rows, 1)),
        outlier[received],
        Moments(**{name: values[received] for name, values in vars(motion).items()}),
    )


def true_moments(trajectory: Trajectory, receiver: Receiver) -> Moments:
    """Motion of the antenna when the fixes are valid, outages included.

    Raises
    ------
    ValueError
        If the rate, the latency or the offset is impossible, or no fix lies within the trajectory.
    """
    if not receiver.rate_hz > 0.0 or receiver.latency_s < 0.0 or receiver.offset_s < 0.0:
        raise ValueError("Expected a positive rate, and latency and offset of 0 or more.")
    first, last = (int(trajectory.time_ns[k]) for k in (0, -1))
    count = int(((last - first) * 1e-9 - receiver.offset_s) * receiver.rate_hz + 1e-6) + 1
    after = receiver.offset_s + np.arange(max(count, 0)) / receiver.rate_hz
    valid = first + np.round((after - receiver.latency_s) * 1e9).astype(np.int64)
    valid = valid[(valid >= first) & (valid <= last)]
    if not len(valid):
        raise ValueError("No fix lies within the trajectory.")
    return moments(trajectory, valid, receiver.lever_arm_b)


def _noise(
    white: Triple,
    wandering: Triple,
    correlation_time: float,
    random: np.random.Generator,
    n: int,
    step: float,
) -> FloatArray:
    """White plus wandering noise, shape (n, 3)."""
    out = np.asarray(white) * random.standard_normal((n, 3))
    return np.asarray(out + np.asarray(wandering) * markov(n, step, correlation_time, random, 3))


def _directions(random: np.random.Generator, n: int) -> FloatArray:
    """Unit vectors, uniformly distributed over all directions, shape (n, 3)."""
    drawn = random.standard_normal((n, 3))
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


def _within(after: ArrayLike, spans: tuple[Span, ...]) -> np.ndarray:
    """Times that lie in any of the spans."""
    t = np.asarray(after)
    inside = np.zeros(t.shape, dtype=bool)
    for start, end in spans:
        inside |= (t >= start) & (t < end)
    return inside
