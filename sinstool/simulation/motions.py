"""Two-frequency coning, broadband vibration and random manoeuvres, exact at any sampling rate.

The attitude is ``q_nb = q_nm exp(phi(t))`` with every component of the rotation vector a sum of
sinusoids, so that it, its derivative and the body's rate are known at any instant,

    omega = phi' - (1 - cos a)/a**2 phi x phi' + (a - sin a)/a**3 phi x (phi x phi'),   a = |phi|,

(the right Jacobian of [1]_, eq. 143). Nothing is tied to the instants of the samples: content
above half the sampling rate aliases as it does in a real log, differently for point rates and
for increments. Increments and mean specific forces are Gauss-Legendre quadratures of the exact
values, with as many nodes as keep the error below 1e-14 of the largest value for everything up
to four times the highest frequency (where products of the sinusoids are).

References
----------
.. [1] J. Sola, J. Deray, D. Atchuthan, "A micro Lie theory for state estimation in robotics",
   arXiv:1812.01537, 2018.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import lgamma, log

import numpy as np

from sinstool.core import rotation
from sinstool.core.arrays import ArrayLike, FloatArray, IntArray
from sinstool.simulation.truth import STANDARD_GRAVITY_N, ImuTruth, check_times

_QUADRATURE_ERROR = 1e-14
_HARMONICS = 4.0
_MOST_NODES = 1000  # a hundred turns of the highest frequency in one interval
_ROWS = 4096  # at a time: the tables of sines stay small
_MOST_DURATIONS = 8
_BROADBAND_LINES, _MANOEUVRE_LINES = 200, 12  # sinusoids, of a manoeuvre in each axis


@dataclass(frozen=True)
class Sinusoids:
    """Rotation vector as a sum of sinusoids.

    Attributes
    ----------
    frequency : ndarray, shape (m,)
        Hz.
    sine, cosine : ndarray, shape (m, 3)
        Amplitudes of ``sin(2 pi f t)`` and ``cos(2 pi f t)``, rad.
    """

    frequency: FloatArray
    sine: FloatArray
    cosine: FloatArray

    def basis(
        self, elapsed_ns: IntArray, back: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Sines and cosines of every frequency.

        Parameters
        ----------
        elapsed_ns : ndarray of int64, shape (n,)
            Since the start.
        back : ndarray, shape (n,), optional
            Seconds to go back from there.

        Returns
        -------
        sine, cosine : ndarray, shape (n, m)
        """
        # less whole turns, without the digits that a large product would lose
        seconds, rest = np.divmod(elapsed_ns, 1_000_000_000)
        turns = np.mod(np.outer(seconds, self.frequency), 1.0)
        late = rest * 1e-9 if back is None else rest * 1e-9 - back
        turns += np.outer(late, self.frequency)
        turns *= 2.0 * np.pi
        return np.sin(turns), np.cos(turns)

    def value(self, s: FloatArray, c: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rotation vectors, rad, and their derivatives, rad/s, from :meth:`basis`."""
        w = 2.0 * np.pi * self.frequency[:, np.newaxis]
        return s @ self.sine + c @ self.cosine, c @ (w * self.sine) - s @ (w * self.cosine)

    def delayed(self, seconds: float) -> Sinusoids:
        """These sinusoids, delayed."""
        phase = 2.0 * np.pi * self.frequency[:, np.newaxis] * seconds
        s, c = np.sin(phase), np.cos(phase)
        return Sinusoids(
            self.frequency, c * self.sine + s * self.cosine, c * self.cosine - s * self.sine
        )


def two_frequency(half_angles: tuple[float, float], frequencies: tuple[float, float]) -> Sinusoids:
    """Two conings about the body's z axis at once.

    Parameters
    ----------
    half_angles : tuple of 2 float
        rad.
    frequencies : tuple of 2 float
        Hz; negative turns the other way round.

    Notes
    -----
    ``phi = sum of a_i [sin 2 pi f_i t, cos 2 pi f_i t, 0]``. An update of N samples folds the
    difference of the two frequencies: if that is a multiple of the update rate, the products
    of the two become constant and are taken for coning.
    """
    first, second = half_angles
    return Sinusoids(
        np.array(frequencies, dtype=np.float64),
        np.array([[first, 0.0, 0.0], [second, 0.0, 0.0]]),
        np.array([[0.0, first, 0.0], [0.0, second, 0.0]]),
    )


def broadband(
    angle_rms: float, band: tuple[float, float] = (20.0, 150.0), *, seed: int = 0
) -> Sinusoids:
    """Vibration with coning at every frequency of a band.

    Parameters
    ----------
    angle_rms : float
        Of each of the body's x and y axis, rad.
    band : tuple of 2 float, optional
        Hz.
    seed : int, optional
        Of the phases.

    Returns
    -------
    Sinusoids
        Equally spaced over the band, of equal rate: amplitudes fall as 1/f. y is a quarter of a
        turn behind x at every frequency, each at a random phase, so that all of the motion cones
        about z the same way round.

    Raises
    ------
    ValueError
        If the band is empty.
    """
    low, high = _limits(band)
    lines = _BROADBAND_LINES
    frequency = low + (high - low) * (np.arange(lines) + 0.5) / lines
    amplitude = 1.0 / frequency
    amplitude *= angle_rms / np.sqrt(0.5 * np.sum(amplitude**2))
    phase = 2.0 * np.pi * np.random.default_rng(seed).random(lines)
    a, b = amplitude * np.cos(phase), amplitude * np.sin(phase)
    zero = np.zeros(lines)
    # x = A sin(Wt + p), y = A cos(Wt + p)
    return Sinusoids(frequency, np.stack([a, -b, zero], -1), np.stack([b, a, zero], -1))


def random_manoeuvre(rate_rms: float, band: tuple[float, float], *, seed: int = 0) -> Sinusoids:
    """Random rotation about all three axes.

    Parameters
    ----------
    rate_rms : float
        Of the length of the rotation vector's derivative, rad/s.
    band : tuple of 2 float
        Hz, of the rotation vector; the body's rate has products of these.
    seed : int, optional
        Of frequencies, amplitudes and phases.

    Raises
    ------
    ValueError
        If the band is empty.
    """
    low, high = _limits(band)
    lines = _MANOEUVRE_LINES
    random = np.random.default_rng(seed)
    frequency = random.uniform(low, high, 3 * lines)
    rate = random.normal(size=(2, 3 * lines))
    rate *= rate_rms / np.sqrt(0.5 * np.sum(rate**2))
    axes = np.repeat(np.eye(3), lines, axis=0)
    sine, cosine = (r / (2.0 * np.pi * frequency) for r in rate)
    return Sinusoids(frequency, sine[:, np.newaxis] * axes, cosine[:, np.newaxis] * axes)


def _limits(band: tuple[float, float]) -> tuple[float, float]:
    """Ends of a band, in which there are frequencies."""
    low, high = band
    if not 0.0 < low < high:
        raise ValueError(f"No frequency lies in the band {band}.")
    return low, high


def sample(
    motion: Sinusoids,
    time_ns: ArrayLike,
    *,
    q_nm: ArrayLike = (1.0, 0.0, 0.0, 0.0),
    gravity_n: ArrayLike = STANDARD_GRAVITY_N,
    nodes: int | None = None,
) -> ImuTruth:
    """Samples of a rotation about a fixed point, with NED not rotating.

    Parameters
    ----------
    motion : Sinusoids
        Its phases are those at the first instant.
    time_ns : array_like of int64, shape (n,)
        Instants, increasing, two at least.
    q_nm : array_like, shape (4,), optional
        Attitude about which the body moves.
    gravity_n : array_like, shape (3,), optional
        m/s^2; standard gravity by default.
    nodes : int, optional
        Of the quadrature over each interval; by default as many as the highest frequency
        needs.

    Raises
    ------
    ValueError
        If a shape is wrong, time does not increase, or an interval is of too many turns.
    """
    times, interval = check_times(time_ns)
    origin = rotation.normalise(q_nm)
    gravity = np.asarray(gravity_n, dtype=np.float64)
    if origin.shape != (4,) or gravity.shape != (3,):
        raise ValueError(f"Expected shapes (4,) and (3,), got {origin.shape} and {gravity.shape}.")
    if nodes is None:
        highest = float(np.max(np.abs(motion.frequency)))
        nodes = quadrature_nodes(2.0 * np.pi * highest * _HARMONICS * float(np.max(interval)))
        if nodes > _MOST_NODES:
            raise ValueError(f"{highest} Hz turns too often in {np.max(interval)} s.")
    at, weights = np.polynomial.legendre.leggauss(nodes)
    elapsed = times - times[0]
    n = len(times)
    rate, mean_rate = np.empty((n, 3)), np.zeros((n, 3))
    force, mean_force = np.empty((n, 3)), np.zeros((n, 3))
    q = np.empty((n, 4))
    for begin in range(0, n, _ROWS):
        block = slice(begin, begin + _ROWS)
        s, c = motion.basis(elapsed[block])
        q[block], rate[block], force[block] = _state(*motion.value(s, c), origin, gravity)
        for place, weight in zip(at, 0.5 * weights, strict=True):
            phi = _earlier(motion, elapsed[block], interval[block], 0.5 * (1.0 - place), s, c)
            _, one, pull = _state(*phi, origin, gravity)
            mean_rate[block] += weight * one
            mean_force[block] += weight * pull
    return ImuTruth(
        time_ns=times,
        interval=interval,
        gyro_rate=rate,
        gyro_mean_rate=mean_rate,
        gyro_increment=mean_rate * interval[:, np.newaxis],
        specific_force=force,
        mean_specific_force=mean_force,
        q_nb=q,
    )


def quadrature_nodes(turn: float) -> int:
    """Nodes of Gauss and Legendre that integrate a sinusoid to rounding.

    Parameters
    ----------
    turn : float
        What the sinusoid turns over the interval, rad.

    Returns
    -------
    int
        The least n with ``2**(2n+1) n!**4 / ((2n+1) (2n)!**3) (turn/2)**(2n) < 1e-14``, the
        bound of the error over an interval of length 2, and 4 at least.
    """
    n = 4
    while (
        (2 * n + 1) * log(2.0)
        + 4.0 * lgamma(n + 1)
        - log(2 * n + 1)
        - 3.0 * lgamma(2 * n + 1)
        + 2 * n * log(max(0.5 * turn, 1e-9))
    ) > log(_QUADRATURE_ERROR):
        n += 1
    return n


def _earlier(
    motion: Sinusoids,
    elapsed_ns: IntArray,
    interval: FloatArray,
    share: float,
    s: FloatArray,
    c: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Rotation vectors and derivatives a share of each interval ago; `s`, `c` are now's."""
    durations, which = np.unique(interval, return_inverse=True)
    if len(durations) > _MOST_DURATIONS:
        return motion.value(*motion.basis(elapsed_ns, share * interval))
    # Few durations, as in any regular log: other amplitudes instead of other sines.
    if len(durations) == 1:
        return motion.delayed(share * durations[0]).value(s, c)
    phi, derivative = np.empty((2, len(interval), 3))
    for i, duration in enumerate(durations):
        rows = which == i
        phi[rows], derivative[rows] = motion.delayed(share * duration).value(s[rows], c[rows])
    return phi, derivative


def _state(
    phi: FloatArray, derivative: FloatArray, origin: FloatArray, gravity_n: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Attitude, body rate and specific force."""
    square = np.sum(phi * phi, axis=-1, keepdims=True)
    angle = np.sqrt(square)
    once = np.cross(phi, derivative)
    first = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    rate = derivative - first * once + _cubic(square, angle) * np.cross(phi, once)
    q_nb = rotation.multiply(origin, rotation.exp(phi))
    return q_nb, rate, rotation.rotate(rotation.conjugate(q_nb), -gravity_n)


def _cubic(square: FloatArray, angle: FloatArray) -> FloatArray:
    """``(a - sin a) / a**3`` without cancellation."""
    small = square < 0.25
    series = np.zeros_like(square)
    for denominator in (-6227020800.0, 39916800.0, -362880.0, 5040.0, -120.0, 6.0):
        series = series * square + 1.0 / denominator
    safe = np.where(small, 1.0, angle)
    return np.where(small, series, (safe - np.sin(safe)) / safe**3)
