"""Corrections of an integrated attitude, as the smoother finds them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import kernel
from sinstool.core.quaternion_kernels import increment_quaternion, product, to_unit
from sinstool.core.rotation import conjugate, exp, log, multiply
from sinstool.core.streams import Solution
from sinstool.methods.attitude_smoother.epochs import COUNT, DURATION, GYRO, JB, W2, Epochs


@dataclass(frozen=True)
class Correction:
    """Correction of an integrated attitude, at the limits of epochs.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (n + 1,)
    q : ndarray, shape (n + 1, 4)
        The rotation in navigation axes: the attitude is `q` times the integrated one.
    turn : ndarray, shape (n, 3)
        Rotation vector from each to the next, rad.
    gyro_bias : ndarray, shape (n + 1, 3)
        Beyond the bias that the integration removed, rad/s.
    covariance_n : ndarray, shape (n + 1, 3, 3)
        Of the small rotation in NED that takes the attitude to the true one, rad^2; that of
        heading since the start.
    gyro_bias_sigma : ndarray, shape (n + 1, 3)
        rad/s.
    accel_bias_sigma : float
        Standard deviation of the accelerometer biases, by axis, that the covariance of tilt
        includes, m/s^2.
    accel_bias : ndarray, shape (3,), or None
        Of a vehicle's, m/s^2; that of a hand's is not estimated.
    diverged : bool
        The filter diverged: the attitude is the integrated one, of which nothing is known.
    """

    time_ns: np.ndarray
    q: FloatArray
    turn: FloatArray
    gyro_bias: FloatArray
    covariance_n: FloatArray
    gyro_bias_sigma: FloatArray
    accel_bias_sigma: float
    accel_bias: FloatArray | None
    diverged: bool

    def apply(self, solution: Solution) -> Solution:
        """A solution with its attitude and its rates corrected, and with a covariance."""
        n = len(solution)
        first = int(np.searchsorted(self.time_ns, solution.time_ns[0], "left")) - 1 if n else 0
        q, rate, covariance = np.empty((n, 4)), np.empty((n, 3)), np.empty((n, 3, 3))
        _corrected(
            self.time_ns,
            self.q,
            self.turn,
            self.gyro_bias,
            self.covariance_n,
            min(max(first, 0), len(self.turn) - 1),
            solution.time_ns,
            solution.q_nb,
            solution.omega_ib_b,
            q,
            rate,
            covariance,
        )
        return replace(solution, q_nb=q, omega_ib_b=rate, covariance_attitude_n=covariance)

    def at(self, time_ns: np.ndarray) -> Correction:
        """The same at other limits of epochs.

        Parameters
        ----------
        time_ns : ndarray of int64, shape (n + 1,)
            Within the same time.
        """
        limits = self.time_ns
        k = np.clip(np.searchsorted(limits, time_ns, "left") - 1, 0, len(self.turn) - 1)
        s = ((time_ns - limits[k]) / np.maximum(limits[k + 1] - limits[k], 1))[:, None]
        q = multiply(exp(s * self.turn[k]), self.q[k])
        end = k + (s[:, 0] > 0.0)
        return replace(
            self,
            time_ns=time_ns,
            q=q,
            turn=log(multiply(q[1:], conjugate(q[:-1]))),
            gyro_bias=(1.0 - s) * self.gyro_bias[k] + s * self.gyro_bias[k + 1],
            covariance_n=self.covariance_n[end],
            gyro_bias_sigma=self.gyro_bias_sigma[end],
        )

    def of_samples(self, epochs: Epochs) -> Correction:
        """The same, less certain by what a sample may be: a mean until its stamp, or a rate at it.

        The two attitudes are half a sample apart, and either is as likely.

        Parameters
        ----------
        epochs : Epochs
            All that the log has.
        """
        rows = epochs.values
        count, seconds = np.maximum(rows[:, COUNT], 1.0), rows[:, DURATION]
        turned = rows[:, JB : JB + 9].reshape(-1, 3, 3) / seconds[:, None, None]
        steady = np.einsum("nij,nj->ni", turned, rows[:, GYRO : GYRO + 3])
        shaken = np.maximum(rows[:, W2] / seconds - np.einsum("ni,ni->n", steady, steady), 0.0)
        square = steady[:, :, None] * steady[:, None, :] + shaken[:, None, None] / 3.0 * np.eye(3)
        square *= (0.5 * (0.5 * seconds / count) ** 2)[:, None, None]
        square[epochs.gap] = 0.0
        first = np.searchsorted(epochs.time_ns[:-1], self.time_ns[:-1])
        many = np.diff(first, append=len(rows))
        covariance = self.covariance_n.copy()
        covariance[1:] += np.add.reduceat(square, first) / many[:, None, None]
        return replace(self, covariance_n=covariance)


@kernel()
def _corrected(
    limits: np.ndarray,
    q: FloatArray,
    turn: FloatArray,
    bias: FloatArray,
    covariance_n: FloatArray,
    k: int,
    time_ns: np.ndarray,
    q_nb: FloatArray,
    omega: FloatArray,
    q_out: FloatArray,
    omega_out: FloatArray,
    covariance_out: FloatArray,
) -> None:
    """Corrections between the limits of epochs, from about the epoch `k` on.

    A sample is in the epoch at whose end it is, or before it; what lies outside of all of them
    belongs to the first or the last.
    """
    for i in range(len(q_out)):
        while k < len(turn) - 1 and time_ns[i] > limits[k + 1]:
            k += 1
        while k > 0 and time_ns[i] <= limits[k]:
            k -= 1
        s = (time_ns[i] - limits[k]) / max(limits[k + 1] - limits[k], 1)
        w, x, y, z = increment_quaternion(s * turn[k, 0], s * turn[k, 1], s * turn[k, 2], 0)
        w, x, y, z = product(w, x, y, z, q[k, 0], q[k, 1], q[k, 2], q[k, 3])
        w, x, y, z = product(w, x, y, z, q_nb[i, 0], q_nb[i, 1], q_nb[i, 2], q_nb[i, 3])
        w, x, y, z = to_unit(w, x, y, z)
        q_out[i, 0], q_out[i, 1], q_out[i, 2], q_out[i, 3] = w, x, y, z
        for a in range(3):
            omega_out[i, a] = omega[i, a] - ((1.0 - s) * bias[k, a] + s * bias[k + 1, a])
            for b in range(3):
                # the value at the end of the epoch throughout: repeated numbers compress well
                covariance_out[i, a, b] = covariance_n[k + 1, a, b]
