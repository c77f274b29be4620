"""Responses and noise of the network that damps the vertical channel, in closed form.

All three roots of F are -1/tau, so with N = F + I/tau, N^3 = 0 and
exp(F t) = exp(-t/tau) (I + N t + N^2 t^2 / 2): every response below is exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_continuous_lyapunov

from sinstool.methods.height.network import HeightNetwork

FloatArray = NDArray[np.float64]
Input = Literal["baro", "acceleration"]


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


class NetworkTheory(HeightNetwork):
    """The network as a continuous system of the state (h, v, A)."""

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
