"""Velocity increments over the updates of any coning algorithm.

What a mechanisation needs of an update is the integral of the specific force in the body axes
of its start,

    u = integral of C_b(start)b(t) f(t) dt,

which is the sum of the accelerometer's increments, the rotation compensation and the sculling.
An attitude integrated with the rate ``omega + e f`` differs from the one with ``omega`` by the
small turn ``e u`` in the axes of the start. So ``u`` is the derivative of the rotation with
respect to ``e``: the dual part of the dual quaternion of [1]_. With ``phi(e)`` what a coning
algorithm makes of the samples ``gyro + e accel``,

    u = J(phi) dphi/de,     J(phi) = I + (1 - cos a)/a**2 [phi x] + (a - sin a)/a**3 [phi x]**2.

Thus every coning algorithm and every kind of sample has a matching sculling correction, of the
same order and at the same instants. For ``previous-1`` it is
``1/12 (dtheta[k-1] x dv[k] + dv[k-1] x dtheta[k])``, for the optimal coefficients it is the dual of
[2]_, and for point rates it follows from their interpolation. `J` is the exact rotation
compensation. The derivative is a central difference, which is exact to rounding for algorithms that
are quadratic in the increments; the others add terms of third order only.

References
----------
.. [1] Y. Wu, X. Hu, D. Hu, T. Li, J. Lian, "Strapdown inertial navigation system algorithms based
   on dual quaternions", IEEE Trans. Aerospace and Electronic Systems 41(1), 2005, 110-132.
.. [2] M. B. Ignagni, "Duality of optimal strapdown sculling and coning compensation algorithms",
   Navigation 45(2), 1998, 85-95.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sin, sqrt

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray, IntArray
from sinstool.core.parts import kernel, part
from sinstool.core.quaternion_kernels import cross
from sinstool.methods.coning.stage import ConingStage, RotationVectors

# rad per m/s. Rounding of phi costs 1e-17/1e-4 m/s per update; terms of third order in the specific
# force cost a fraction of about (1e-4 dv)**2 of the non-commuting part.
_DUAL = 1e-4


@dataclass(frozen=True)
class Increments:
    """Compensated increments of consecutive updates.

    Attributes
    ----------
    sample : ndarray of int64, shape (n,)
        Number within the segment, from 0, of the sample at which each update ends.
    time_ns : ndarray of int64, shape (n,)
        Time of that sample.
    interval : ndarray, shape (n,)
        Duration of each update, s.
    rotation_vector : ndarray, shape (n, 3)
        Of the body against inertial space, in ``b``, rad.
    velocity_increment : ndarray, shape (n, 3)
        Integral of the specific force in the body axes of the update's start, m/s.
    followed_rate : ndarray, shape (n, 3), optional
        Of the body at each update's end, as a receiver follows it, rad/s: see
        :mod:`~sinstool.methods.strapdown.followed_rates`.
    lost : ndarray, shape (n, 6), optional
        Variances of rotation vector and velocity increment by samples that were lost or clipped,
        rad^2 and (m/s)^2: see :mod:`~sinstool.methods.strapdown.lost_samples` and
        :mod:`~sinstool.methods.strapdown.clipped_samples`.
    """

    sample: IntArray
    time_ns: IntArray
    interval: FloatArray
    rotation_vector: FloatArray
    velocity_increment: FloatArray
    followed_rate: FloatArray | None = None
    lost: FloatArray | None = None


class IncrementStage:
    """Compensated increments from the gyro and accelerometer samples of one segment.

    Parameters
    ----------
    coning_stage : callable
        Returns a new coning stage for the segment; called three times. Gyro and accelerometer
        samples are both of the kind that the stage takes.

    Notes
    -----
    The segment, and so the navigation, starts at the instant of the first sample. Where samples
    are integrals or means, the interval of the first one lies before that instant, and it serves
    as history only.
    """

    def __init__(self, coning_stage: Callable[[], ConingStage]) -> None:
        self._attitude = coning_stage()
        self._plus = coning_stage()
        self._minus = coning_stage()

    def push(self, gyro: ArrayLike, accel: ArrayLike, time_ns: ArrayLike) -> Increments:
        """Take the next samples of the segment.

        Parameters
        ----------
        gyro : array_like, shape (n, 3)
            Samples in the body frame: rad/s, or rad for increments.
        accel : array_like, shape (n, 3)
            Specific force of the same kind: m/s^2, or m/s.
        time_ns : array_like of int64, shape (n,)
            Their times, strictly increasing from block to block.

        Returns
        -------
        Increments
            Of the updates that are complete with their look-ahead; may be none.

        Raises
        ------
        ValueError
            If shapes do not fit or time does not increase.
        """
        rate = np.asarray(gyro, dtype=np.float64)
        dual = _DUAL * np.asarray(accel, dtype=np.float64)
        if rate.shape != dual.shape:
            raise ValueError(f"Expected `accel` to have shape {rate.shape}, got {dual.shape}.")
        return _increments(
            self._attitude.push(rate, time_ns),
            self._plus.push(rate + dual, time_ns),
            self._minus.push(rate - dual, time_ns),
        )

    def finish(self) -> Increments:
        """Increments from the samples left over at the end of the segment."""
        return _increments(self._attitude.finish(), self._plus.finish(), self._minus.finish())


def _increments(
    attitude: RotationVectors, plus: RotationVectors, minus: RotationVectors
) -> Increments:
    out = np.empty_like(attitude.rotation_vector)
    _dual_kernel(
        attitude.rotation_vector, plus.rotation_vector, minus.rotation_vector, 0.5 / _DUAL, out
    )
    return Increments(
        attitude.sample, attitude.time_ns, attitude.interval, attitude.rotation_vector, out
    )


@kernel()
def _dual_kernel(
    phi: FloatArray, plus: FloatArray, minus: FloatArray, scale: float, out: FloatArray
) -> None:
    for k in range(out.shape[0]):
        out[k, 0], out[k, 1], out[k, 2] = jacobian(
            phi[k, 0],
            phi[k, 1],
            phi[k, 2],
            scale * (plus[k, 0] - minus[k, 0]),
            scale * (plus[k, 1] - minus[k, 1]),
            scale * (plus[k, 2] - minus[k, 2]),
        )


@part()
def jacobian(
    px: float, py: float, pz: float, ux: float, uy: float, uz: float
) -> tuple[float, float, float]:
    """Integral of exp(s phi) u over s from 0 to 1."""
    square = px * px + py * py + pz * pz
    if square < 0.01:
        # what follows is below 1e-18
        b = 0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0 - square * (1.0 / 40320.0)))
        d = 1.0 / 6.0 - square * (1.0 / 120.0 - square * (1.0 / 5040.0 - square * (1.0 / 362880.0)))
    else:
        angle = sqrt(square)
        b = 2.0 * (sin(0.5 * angle) / angle) ** 2
        if square < 1.0:
            # (a - sin a) / a**3, whose difference would cancel
            d = 1.0 / 355687428096000.0
            d = 1.0 / 1307674368000.0 - square * d
            d = 1.0 / 6227020800.0 - square * d
            d = 1.0 / 39916800.0 - square * d
            d = 1.0 / 362880.0 - square * d
            d = 1.0 / 5040.0 - square * d
            d = 1.0 / 120.0 - square * d
            d = 1.0 / 6.0 - square * d
        else:
            d = (angle - sin(angle)) / (square * angle)
    cx, cy, cz = cross(px, py, pz, ux, uy, uz)
    ex, ey, ez = cross(px, py, pz, cx, cy, cz)
    return ux + b * cx + d * ex, uy + b * cy + d * ey, uz + b * cz + d * ez


@part()
def remove_bias(
    px: float,
    py: float,
    pz: float,
    ux: float,
    uy: float,
    uz: float,
    gx: float,
    gy: float,
    gz: float,
    ax: float,
    ay: float,
    az: float,
) -> tuple[float, float, float, float, float, float]:
    """Remove biases from increments that are already compensated for coning and sculling.

    Parameters
    ----------
    px, py, pz : float
        Rotation vector, rad.
    ux, uy, uz : float
        Velocity increment, m/s.
    gx, gy, gz : float
        Gyro bias times the interval, rad.
    ax, ay, az : float
        Accelerometer bias times the interval, m/s.

    Returns
    -------
    px, py, pz, ux, uy, uz : float
        As if the samples had been corrected first, to first order in the biases. Their effect on
        the coning and sculling corrections, a twelfth of bias times change of increment, is
        neglected.
    """
    ux -= ax + 0.5 * (py * az - pz * ay + gy * uz - gz * uy)
    uy -= ay + 0.5 * (pz * ax - px * az + gz * ux - gx * uz)
    uz -= az + 0.5 * (px * ay - py * ax + gx * uy - gy * ux)
    return px - gx, py - gy, pz - gz, ux, uy, uz
