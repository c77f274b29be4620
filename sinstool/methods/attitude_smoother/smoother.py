"""Forwards and backwards over the epochs of a log, and the attitudes that come of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.quaternion_kernels import increment_quaternion, product, to_unit
from sinstool.core.rotation import conjugate, from_dcm, log, multiply
from sinstool.core.streams import Solution
from sinstool.methods.attitude_smoother import kernels, state
from sinstool.methods.attitude_smoother.epochs import Epochs
from sinstool.methods.attitude_smoother.model import GRAVITY, MotionModel, SensorModel
from sinstool.methods.attitude_smoother.start import first_state, parameters

# Epochs that are filtered again and smoothed at once.
SEGMENT = 500
# Where the bias of the gyros is as uncertain as LARGE_BIAS, rad/s, or the first tilt turns out as
# far off as FAR, rad, what is linear about the filter's own states is wrong for good. So the
# smoother is run again about what it found (an iterated smoother, a Gauss-Newton step a pass) until
# a pass changes no tilt by CLOSE, rad; without a bias the first passes believe in motion that
# shakes more, lest they hold on to where they began.
LARGE_BIAS = 0.01
FAR, CLOSE = 0.05, 1e-3
PASSES = 20
WIDER = (4.0, 3.0, 2.0, 1.5)


@dataclass(frozen=True)
class Correction:
    """What is to be done to an integrated attitude, at the limits of epochs.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (n + 1,)
    q : ndarray, shape (n + 1, 4)
        The rotation in navigation axes: the attitude is `q` times the integrated one.
    turn : ndarray, shape (n, 3)
        Rotation vector from each to the next, rad.
    gyro_bias : ndarray, shape (n + 1, 3)
        Beyond what was taken off before, rad/s.
    covariance_n : ndarray, shape (n + 1, 3, 3)
        Of the small rotation in NED that takes the attitude to the true one, rad^2; that of
        heading since the start.
    gyro_bias_sigma : ndarray, shape (n + 1, 3)
        rad/s.
    """

    time_ns: np.ndarray
    q: FloatArray
    turn: FloatArray
    gyro_bias: FloatArray
    covariance_n: FloatArray
    gyro_bias_sigma: FloatArray

    def apply(self, solution: Solution) -> Solution:
        """A solution with its attitude and its rates corrected, and with a covariance."""
        at = np.clip(
            np.searchsorted(self.time_ns, solution.time_ns, "left") - 1, 0, len(self.turn) - 1
        )
        begin, end = self.time_ns[at], self.time_ns[at + 1]
        share = (solution.time_ns - begin) / np.maximum(end - begin, 1)
        q = np.empty_like(solution.q_nb)
        _turned(self.q, self.turn, at, share, solution.q_nb, q)
        weight = share[:, None]
        bias = self.gyro_bias[at] + weight * (self.gyro_bias[at + 1] - self.gyro_bias[at])
        weight = weight[:, None]
        low, high = self.covariance_n[at], self.covariance_n[at + 1]
        return replace(
            solution,
            q_nb=q,
            omega_ib_b=solution.omega_ib_b - bias,
            covariance_attitude_n=low + weight * (high - low),
        )


def smooth(
    epochs: Epochs, motion: MotionModel, sensors: SensorModel, heading: float = 0.0
) -> Correction:
    """Smooth over a whole log.

    Parameters
    ----------
    epochs : Epochs
        At least one; with rest marked.
    motion : MotionModel
    sensors : SensorModel
    heading : float, optional
        Standard deviation of the first heading, rad; 0: what is said of heading is its change.

    Returns
    -------
    Correction
    """
    covariance = np.empty((len(epochs) + 1, state.KEPT))
    smoothed = np.empty((0, state.STATE))
    wider = WIDER if sensors.bias > LARGE_BIAS else ()
    for k in range(PASSES):
        before = smoothed
        model = motion.with_density(motion.density * wider[k]) if k < len(wider) else motion
        smoothed = _pass(epochs, model, sensors, before, covariance)
        first = before if k else first_state(epochs, motion, sensors)[0][None]
        if k >= len(wider) and _moved(first, smoothed[: len(first)]) < (CLOSE if k else FAR):
            break
    q = from_dcm(smoothed[:, :9].reshape(-1, 3, 3))
    attitude = covariance[:, :9].reshape(-1, 3, 3).copy()
    # An accelerometer's bias cannot be told from a tilt.
    attitude[:, [0, 1], [0, 1]] += (sensors.accel_bias / GRAVITY) ** 2
    attitude[:, 2, 2] += heading**2
    return Correction(
        epochs.time_ns,
        q,
        log(multiply(q[1:], conjugate(q[:-1]))),
        smoothed[:, state.B : state.B + 3].copy(),
        attitude,
        np.sqrt(covariance[:, 9:]),
    )


def _moved(before: FloatArray, after: FloatArray) -> float:
    """Largest change of the tilt between two passes, rad."""
    up = [a[:, :9].reshape(-1, 3, 3)[:, 2] for a in (before, after)]
    return float(np.sqrt(np.max(np.sum((up[1] - up[0]) ** 2, axis=1))))


def _pass(
    epochs: Epochs,
    motion: MotionModel,
    sensors: SensorModel,
    near: FloatArray,
    covariance: FloatArray,
) -> FloatArray:
    """Forwards and backwards once; the smoothed states, shape (n + 1, STATE).

    Parameters
    ----------
    near : ndarray, shape (n + 1, STATE) or (0, STATE)
        States of a pass before, to be linear about; none: the filter's own.
    covariance : ndarray, shape (n + 1, KEPT)
        Gets those of attitude and bias.
    """
    n, count, rows = motion.states, len(epochs), epochs.values
    par = parameters(motion, sensors, epochs.omega_in_n)
    held = -(-count // SEGMENT)
    states = np.empty((held, state.STATE + state.ERRORS))
    covariances = np.empty((held, n, n))
    smoothed = np.empty((count + 1, state.STATE))
    x, p = first_state(epochs, motion, sensors)
    dx = np.zeros(state.ERRORS)
    scratch = np.empty((3, 3))
    if len(near):
        state.less(x, near[0], n, dx, scratch)
        x = near[0].copy()
    kernels.forward(rows, 0, count, par, n, x, p, SEGMENT, states, covariances, near, dx)
    state.keep(p, covariance[count])
    smoothed[count] = x
    state.inject(smoothed[count], dx, n, scratch)
    for k in range(held - 1, -1, -1):
        begin, end = SEGMENT * k, min(SEGMENT * (k + 1), count)
        start, off = states[k, : state.STATE].copy(), states[k, state.STATE :].copy()
        kernels.backward(
            rows, begin, end, par, n, start, covariances[k], x, p, smoothed, covariance,
            near, off, dx,
        )  # fmt: skip
    return smoothed


@numba.njit(cache=True, nogil=True)
def _turned(
    q: FloatArray,
    turn: FloatArray,
    at: np.ndarray,
    share: FloatArray,
    q_nb: FloatArray,
    out: FloatArray,
) -> None:
    """Corrections between the limits of epochs times integrated attitudes."""
    for i in range(len(out)):
        k, s = at[i], share[i]
        w, x, y, z = increment_quaternion(s * turn[k, 0], s * turn[k, 1], s * turn[k, 2], 0)
        w, x, y, z = product(w, x, y, z, q[k, 0], q[k, 1], q[k, 2], q[k, 3])
        w, x, y, z = product(w, x, y, z, q_nb[i, 0], q_nb[i, 1], q_nb[i, 2], q_nb[i, 3])
        w, x, y, z = to_unit(w, x, y, z)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = w, x, y, z
