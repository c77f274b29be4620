"""The third-order network that damps the vertical channel: gains, responses, noise.

The vertical channel of an inertial system is unstable: gravity falls off with height, so a
height error feeds itself. A barometric height h_B holds it:

    e  = h + K4 v - h_B
    h' = v - K1 e
    v' = f_U - a_U - gamma(h) - K2 e - A                                              (1)
    A' = K3 e

with the upward specific force f_U, Coriolis and centripetal terms a_U and gravity gamma. The
integral A takes up what the accelerometer has too much. The gains put all three roots at
-1/tau, so with N = F + I/tau, N^3 = 0 and exp(F t) = exp(-t/tau) (I + N t + N^2 t^2 / 2):
every response below is exact.

K4 > 0 trades overshoot and noise for a height that lags by K4 v in a climb; K4 = 0 is the
conventional loop; K4 = -T cancels, in a steady climb, a barometer that lags by T.

References
----------
.. [1] Zhang J., Ren S., Tan M., "A study of altitude damping in INS/GNSS integrated navigation
   system", J. Air Force Engineering University 4(6), 2003, 37-39 (in Chinese).
.. [2] W. S. Widnall, P. K. Sinha, "Optimizing the gains of the baro-inertial vertical channel",
   J. Guidance and Control 3(2), 1980, 172-178.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_continuous_lyapunov

from sinstool.core.earth import normal_gravity
from sinstool.core.errors import ConfigurationError

FloatArray = NDArray[np.float64]

Grade = Literal["mems", "tactical", "navigation"]
Input = Literal["baro", "acceleration"]
Output = Literal["height", "velocity", "correction"]

RECOMMENDED_TAU: dict[str, float] = {"mems": 5.0, "tactical": 30.0, "navigation": 100.0}
"""Time constant in s for each grade of IMU."""

PAPER_TAU = 2.4
"""s; section 1 of [1]_ of the module."""

PAPER_K4 = 0.5
"""s; section 1 of [1]_ of the module."""

SENSIBLE_TAU = (0.5, 300.0)
"""Shorter, the barometer's noise is the solution; longer, gravity's gradient (w2 tau^2) shows."""

_OUTPUTS: tuple[Output, ...] = ("height", "velocity", "correction")


def gravity_gradient(latitude: float, height: float = 0.0) -> float:
    """How gravity falls off with height, ``w2 = -d gamma / dh``.

    Parameters
    ----------
    latitude : float
        Geodetic, rad.
    height : float, optional
        Ellipsoidal, m.

    Returns
    -------
    float
        1/s^2, about 3.086e-6; twice the square of the Schuler frequency.
    """
    # normal_gravity is quadratic in the height: a central difference is exact.
    step = 1000.0
    above, below = normal_gravity(latitude, np.array([height + step, height - step]))
    return float(below - above) / (2.0 * step)


@dataclass(frozen=True)
class HeightNetwork:
    """A damping network with all three roots at ``-1/tau``.

    Parameters
    ----------
    tau : float
        Time constant, s.
    k4 : float, optional
        Weight of the vertical velocity in the difference to the barometer, s; its magnitude
        must be less than tau.
    w2 : float, optional
        Gravity's gradient, :func:`gravity_gradient`, 1/s^2.

    Raises
    ------
    ConfigurationError
        If tau is not positive and finite or K4 is not within (-tau, tau).
    """

    tau: float
    k4: float = 0.0
    w2: float = 3.0858e-6

    def __post_init__(self) -> None:
        if not (np.isfinite(self.tau) and self.tau > 0.0):
            raise ConfigurationError(
                f"tau is {self.tau:g} s", "a time constant is positive; 5 to 100 s are usual"
            )
        if not abs(self.k4) < self.tau:
            raise ConfigurationError(
                f"K4 less the baro lag is {self.k4:g} s with tau {self.tau:g} s",
                "it must be smaller than tau in magnitude",
            )
        if not self.w2 * self.k4 * self.k4 < 1.0:
            raise ConfigurationError(
                f"K4 is {self.k4:g} s", "w2 K4^2 must be less than one, or there are no gains"
            )

    @property
    def advice(self) -> tuple[str, ...]:
        """What somebody who chose these values should know; empty for sensible ones."""
        low, high = SENSIBLE_TAU
        said = []
        if self.tau < low:
            said.append(
                f"tau {self.tau:g} s is less than {low:g} s: vertical velocity will be the "
                "barometer's noise"
            )
        if self.tau > high:
            said.append(
                f"tau {self.tau:g} s is more than {high:g} s: accelerometer errors and gravity's "
                "gradient will show in the height"
            )
        if self.k4 > 0.0:
            said.append(f"K4 {self.k4:g} s: the height lags by {self.k4:g} s in climbs")
        return tuple(said)

    @property
    def gains(self) -> tuple[float, float, float]:
        """K1 (1/s), K2 (1/s^2), K3 (1/s^3); eq. (3) of [1]_ of the module.

        The paper prints the Earth rate where the Schuler frequency belongs; with the Earth
        rate the three roots spread by -17 to +35 % at tau = 100 s.
        """
        t, k4, w2 = self.tau, self.k4, self.w2
        d = (1.0 - w2 * k4 * k4) * t**3
        k1 = (3.0 * t * t - 3.0 * k4 * t + k4 * k4 - w2 * k4 * t**3) / d
        k2 = (3.0 * t - k4 + w2 * (t**3 - 3.0 * k4 * t * t)) / d
        return k1, k2, 1.0 / t**3

    @property
    def matrix(self) -> FloatArray:
        """F of the state (h, v, A), shape (3, 3)."""
        k1, k2, k3 = self.gains
        return np.array(
            [
                [-k1, 1.0 - k1 * self.k4, 0.0],
                [-k2 + self.w2, -k2 * self.k4, -1.0],
                [k3, k3 * self.k4, 0.0],
            ]
        )

    @property
    def printed_matrix(self) -> FloatArray:
        """Eq. (2) of [1]_ of the module to the letter, shape (3, 3): unstable.

        It has +K2 for -K2 in the second row and K3 K3 for K3 K4 in the third. Kept to show
        that the misprints are misprints; nothing uses it.
        """
        k1, k2, k3 = self.gains
        return np.array(
            [
                [-k1, 1.0 - k1 * self.k4, 0.0],
                [k2 + self.w2, -k2 * self.k4, -1.0],
                [k3, k3 * k3, 0.0],
            ]
        )

    def input_vector(self, source: Input) -> FloatArray:
        """How an input drives (h, v, A), shape (3,).

        Parameters
        ----------
        source : {"baro", "acceleration"}
            Error of the barometric height, m, or of the upward acceleration, m/s^2.
        """
        if source == "acceleration":
            return np.array([0.0, 1.0, 0.0])
        k1, k2, k3 = self.gains
        return np.array([k1, k2, -k3])

    def transfer(self, source: Input, output: Output) -> tuple[FloatArray, FloatArray]:
        """Transfer function from an input's error to a state's error.

        Parameters
        ----------
        source : {"baro", "acceleration"}
        output : {"height", "velocity", "correction"}

        Returns
        -------
        numerator : ndarray, shape (3,)
            Coefficients of s^2, s, 1.
        denominator : ndarray, shape (4,)
            ``(s + 1/tau)^3``.
        """
        k1, k2, k3 = self.gains
        numerators: dict[tuple[str, str], list[float]] = {
            ("baro", "height"): [k1, k2, k3],
            ("baro", "velocity"): [k2, k3 + self.w2 * k1, 0.0],
            ("baro", "correction"): [-k3, 0.0, k3 * self.w2],
            ("acceleration", "height"): [0.0, 1.0 - k1 * self.k4, 0.0],
            ("acceleration", "velocity"): [1.0, k1, 0.0],
            ("acceleration", "correction"): [0.0, k3 * self.k4, k3],
        }
        a = 1.0 / self.tau
        return np.array(numerators[source, output]), np.array([1.0, 3 * a, 3 * a * a, a**3])

    def transition(self, time: ArrayLike) -> FloatArray:
        """``exp(F t)``, in closed form as ``F + I/tau`` is nilpotent.

        Parameters
        ----------
        time : array_like, shape (...)
            s.

        Returns
        -------
        ndarray, shape (..., 3, 3)
        """
        t = np.asarray(time, dtype=np.float64)[..., None, None]
        n = self.matrix + np.eye(3) / self.tau
        return np.asarray(np.exp(-t / self.tau) * (np.eye(3) + n * t + (n @ n) * (0.5 * t * t)))

    def impulse_response(self, source: Input, time: ArrayLike) -> FloatArray:
        """(h, v, A) after an impulse of area 1, e.g. a velocity error of 1 m/s; shape (..., 3)."""
        return np.asarray(self.transition(time) @ self.input_vector(source))

    def step_response(self, source: Input, time: ArrayLike) -> FloatArray:
        """(h, v, A) after a step: a barometer wrong by 1 m, or a bias of 1 m/s^2.

        Parameters
        ----------
        source : {"baro", "acceleration"}
        time : array_like, shape (...)
            Since the step, s.

        Returns
        -------
        ndarray, shape (..., 3)
        """
        change = self.transition(time) - np.eye(3)
        driven = change @ self.input_vector(source)
        return np.asarray(np.linalg.solve(self.matrix, driven[..., None])[..., 0])

    def ramp_response(self, source: Input, time: ArrayLike) -> FloatArray:
        """(h, v, A) while an input's error grows by 1 per second; shape (..., 3)."""
        t = np.asarray(time, dtype=np.float64)
        f = self.matrix
        b = self.input_vector(source)
        driven = self.step_response(source, t) - t[..., None] * b
        return np.asarray(np.linalg.solve(f, driven[..., None])[..., 0])

    def climb_error(self, time: ArrayLike, speed: float, baro_lag: float = 0.0) -> FloatArray:
        """Error of (h, v, A) after the climb speed stepped from 0 to ``speed``.

        Parameters
        ----------
        time : array_like, shape (...)
            Since the climb began, s.
        speed : float
            m/s, upward.
        baro_lag : float, optional
            First-order lag of the barometer, s.

        Returns
        -------
        ndarray, shape (..., 3)
            The height's tends to ``-(K4 + lag) speed``.
        """
        t = np.asarray(time, dtype=np.float64)
        error = -self.k4 * speed * self.step_response("baro", t)
        if baro_lag <= 0.0:
            return error
        # the lag's own step response convolved with the network's: one more root, -1/lag
        a = -1.0 / baro_lag
        shifted = self.matrix - a * np.eye(3)
        b = self.input_vector("baro")
        decay = np.exp(a * t)[..., None, None] * np.eye(3)
        transient = (self.transition(t) - decay) @ np.linalg.solve(shifted, b)
        return np.asarray(error - baro_lag * speed * (self.step_response("baro", t) - transient))

    def sigmas(
        self,
        baro_white: float = 0.0,
        baro_wander: float = 0.0,
        accel_white: float = 0.0,
        accel_bias_wander: float = 0.0,
    ) -> Sigmas:
        """Stationary standard deviations, gravity's gradient left out (w2 tau^2 << 1).

        Parameters
        ----------
        baro_white : float, optional
            Power density of the barometer's white noise, m^2 s; sigma^2 T for samples.
        baro_wander : float, optional
            Power density of the rate of the barometer's slow error, m^2/s; a Markov process has
            2 sigma^2 / correlation time, where that is much longer than tau.
        accel_white : float, optional
            Power density of the accelerometer's white noise, m^2/s^3.
        accel_bias_wander : float, optional
            Power density of the rate of its bias, m^2/s^5.

        Returns
        -------
        Sigmas
            Densities are two-sided. :meth:`sigmas_with_gravity` for long time constants.
        """
        t, x = self.tau, self.k4 / self.tau
        n, q, qa, qb = baro_white, baro_wander, accel_white, accel_bias_wander
        x2, x3, x4 = x * x, x**3, x**4
        path = (1.0 - x) ** 6
        height = (
            n * (33 - 54 * x + 44 * x2 - 18 * x3 + 3 * x4) / (16 * t)
            + q * t * (3 - 2 * x + 12 * x2 - 6 * x3 + x4) / 16
            + qa * t**3 * path / 16
            + 3 * qb * t**5 * path / 16
        )
        velocity = (
            n * (28 - 18 * x + 3 * x2) / (16 * t**3)
            + q * (12 - 6 * x + x2) / (16 * t)
            + qa * t * (12 - 18 * x + 15 * x2 - 6 * x3 + x4) / 16
            + qb * t**3 * (28 - 54 * x + 45 * x2 - 18 * x3 + 3 * x4) / 16
        )
        correction = (
            3 * n / (16 * t**5)
            + q / (16 * t**3)
            + qa * (3 + x2) / (16 * t)
            + qb * t * (33 - 16 * x + 3 * x2) / 16
        )
        return Sigmas(float(np.sqrt(height)), float(np.sqrt(velocity)), float(np.sqrt(correction)))

    def sigmas_with_gravity(
        self,
        baro_white: float = 0.0,
        baro_wander: float = 0.0,
        accel_white: float = 0.0,
        accel_bias_wander: float = 0.0,
    ) -> Sigmas:
        """Stationary standard deviations by the Lyapunov equation, gravity's gradient included.

        The closed forms of :meth:`sigmas` are within 1 % up to tau = 30 s. At 100 s, a slow
        barometer moves A by 9 % more and the velocity by 3 % more than they say.

        Parameters
        ----------
        baro_white, baro_wander, accel_white, accel_bias_wander : float, optional
            As in :meth:`sigmas`.

        Returns
        -------
        Sigmas
        """
        # In h less the slow error b of the barometer and A less w2 b, the gravity that is
        # missing there, b drives the network by its rate alone.
        scale = np.array([1.0, self.tau, self.tau**2])  # all three of one size
        white = scale * self.input_vector("baro")
        wander = scale * np.array([-1.0, 0.0, -self.w2])
        force = scale * np.array([0.0, 1.0, 0.0])
        bias = scale * np.array([0.0, 0.0, -1.0])
        noise = (
            baro_white * np.outer(white, white)
            + baro_wander * np.outer(wander, wander)
            + accel_white * np.outer(force, force)
            + accel_bias_wander * np.outer(bias, bias)
        )
        f = scale[:, None] * self.matrix / scale
        root = np.sqrt(np.diag(solve_continuous_lyapunov(f, -noise))) / scale
        return Sigmas(*(float(x) for x in root))


@dataclass(frozen=True)
class Sigmas:
    """Standard deviations of the network's errors.

    Attributes
    ----------
    height : float
        m, against the barometer's slow error, which every sensible network follows.
    velocity : float
        m/s.
    correction : float
        m/s^2, of A against the accelerometer's bias.
    """

    height: float
    velocity: float
    correction: float


def recommended(
    grade: Grade, w2: float = 3.0858e-6, k4: float = 0.0, baro_lag: float = 0.0
) -> HeightNetwork:
    """Network for a grade of IMU: tau 5 s for MEMS, 30 s tactical, 100 s navigation.

    Parameters
    ----------
    grade : {"mems", "tactical", "navigation"}
    w2 : float, optional
        Gravity's gradient, 1/s^2.
    k4 : float, optional
        s.
    baro_lag : float, optional
        Known first-order lag of the barometer, s: taken off K4.

    Returns
    -------
    HeightNetwork
    """
    return HeightNetwork(RECOMMENDED_TAU[grade], k4 - baro_lag, w2)


def paper(w2: float = 3.0858e-6) -> HeightNetwork:
    """Network of section 1 of [1]_ of the module: tau = 2.4 s, K4 = 0.5 s."""
    return HeightNetwork(PAPER_TAU, PAPER_K4, w2)


def best_tau(
    output: Literal["height", "velocity"],
    *,
    baro_white: float = 0.0,
    baro_wander: float = 0.0,
    accel_white: float = 0.0,
    accel_bias_wander: float = 0.0,
) -> float:
    """Time constant for the least variance with K4 = 0, for any mixture of noises.

    Parameters
    ----------
    output : {"height", "velocity"}
    baro_white, baro_wander, accel_white, accel_bias_wander : float, optional
        As in :meth:`HeightNetwork.sigmas`.

    Returns
    -------
    float
        s. White noises alone give ``(7 N / q_a)^(1/4)`` for the velocity and
        ``(11 N / q_a)^(1/4)`` for the height; white baro and wandering bias
        ``(N / q_b)^(1/6)`` and ``(2.2 N / q_b)^(1/6)``; slow baro and white accelerometer
        ``(q / q_a)^(1/2)`` for the velocity.

    Raises
    ------
    ValueError
        If only one of the sensors is noisy: then there is no best.
    """
    if baro_white + baro_wander <= 0.0 or accel_white + accel_bias_wander <= 0.0:
        raise ValueError("Expected noise of both the barometer and the accelerometer.")
    n, q, qa, qb = baro_white, baro_wander, accel_white, accel_bias_wander
    # The variance is a sum of powers of tau; its derivative, times a power of tau, has one
    # positive root, as its coefficients change sign once.
    if output == "height":
        descending = {6: 15 * qb, 4: 3 * qa, 2: 3 * q, 0: -33 * n}
    else:
        descending = {6: 84 * qb, 4: 12 * qa, 2: -12 * q, 0: -84 * n}
    coefficients = np.array([descending.get(power, 0.0) for power in range(6, -1, -1)])
    # scaled so that roots of numbers that differ by 1e20 are found well
    guess = _scale(coefficients)
    roots = np.roots(coefficients * guess ** np.arange(6.0, -1.0, -1.0)) * guess
    real = roots[(abs(roots.imag) < 1e-6 * abs(roots)) & (roots.real > 0.0)].real
    if not len(real):
        raise ValueError("Expected noise that grows and noise that shrinks with tau.")
    return float(real.max())


def _scale(coefficients: FloatArray) -> float:
    """Size of the positive root of a polynomial whose coefficients change sign once."""
    powers = np.arange(len(coefficients) - 1.0, -1.0, -1.0)
    grid = np.logspace(-3.0, 5.0, 161)
    values = (coefficients * grid[:, None] ** powers).sum(axis=1)
    above = np.flatnonzero(values > 0.0)
    return float(grid[above[0]]) if len(above) else 1.0
