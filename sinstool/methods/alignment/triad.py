"""Attitude from two integrated vectors: to the middle of the time so far, and to its end.

Kept for comparison: two vectors hold little of what the fixes know, and where the force
returns to its old direction they are nearly parallel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sinstool.core.rotation import skew
from sinstool.methods.alignment.accumulation import InertialRows
from sinstool.methods.alignment.pairs import cross_columns, velocity_gains
from sinstool.methods.alignment.wahba import solve_triad
from sinstool.methods.sensor_errors import SensorGrade

FloatArray = NDArray[np.float64]


def middles(time_s: FloatArray, ends: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows nearest to half way from row 0 to each end."""
    half = 0.5 * (time_s[0] + time_s[ends])
    right = np.clip(np.searchsorted(time_s, half), 1, len(time_s) - 1)
    return right - (half - time_s[right - 1] < time_s[right] - half)


def triad_attitude(
    rows: InertialRows, beta: FloatArray, ends: NDArray[np.int64]
) -> tuple[FloatArray, NDArray[np.int64]]:
    """``C_ib0^i`` from the integrals from row 0 to the middle and to the end.

    Parameters
    ----------
    rows : InertialRows
        At the antenna.
    beta : ndarray, shape (n, 3)
    ends : ndarray of int64, shape (k,)
        Rows at least 2.

    Returns
    -------
    dcm : ndarray, shape (k, 3, 3)
        NaN where the two are parallel.
    middle : ndarray of int64, shape (k,)
    """
    middle = middles(rows.time_s, ends)
    dcm = solve_triad(
        beta[middle] - beta[0],
        beta[ends] - beta[0],
        rows.alpha[middle] - rows.alpha[0],
        rows.alpha[ends] - rows.alpha[0],
    )
    return dcm, middle


def triad_covariance(
    rows: InertialRows,
    sigma: FloatArray,
    middle: NDArray[np.int64],
    ends: NDArray[np.int64],
    at: NDArray[np.int64],
    grade: SensorGrade,
    kappa: float,
) -> FloatArray:
    """Covariance of :func:`triad_attitude` in ``ib0``.

    Parameters
    ----------
    sigma : ndarray, shape (n,)
        Velocity noise of the fixes.
    middle, ends, at : ndarray of int64, shape (k,)
        Rows of both vectors, and at which the attitude is wanted.
    grade, kappa
        As for :func:`~sinstool.methods.alignment.covariance.attitude_covariance`.

    Returns
    -------
    ndarray, shape (k, 3, 3)
        rad^2.

    Notes
    -----
    An error ``e1`` of the first vector tilts by ``v1 x e1 / |v1|^2``; about ``v1`` the second
    decides, by its part along ``v1 x v2``. All errors are taken through these two maps.
    """
    v1 = rows.alpha[middle] - rows.alpha[0]
    v2 = rows.alpha[ends] - rows.alpha[0]
    length = np.linalg.norm(v1, axis=-1)
    u = v1 / length[:, None]
    normal = np.cross(u, v2)
    across = np.maximum(np.linalg.norm(normal, axis=-1), 1e-9 * np.linalg.norm(v2, axis=-1))
    normal = normal / across[:, None]
    about = u[:, :, None] * normal[:, None, :] / across[:, None, None]
    tilt = skew(u) / length[:, None, None]
    first = tilt + about @ skew(v2) @ tilt
    second = about
    both = first + second

    def square(m: FloatArray) -> FloatArray:
        return np.asarray(m @ np.swapaxes(m, -1, -2))

    variance = sigma * sigma
    covariance = (
        variance[middle][:, None, None] * square(first)
        + variance[ends][:, None, None] * square(second)
        + variance[0] * square(both)
    )
    gains = velocity_gains(rows)
    gains = gains - gains[:1]
    # What alpha gains, beta lacks.
    shift = -(first[:, None] @ gains[middle] + second[:, None] @ gains[ends])
    chain = np.zeros_like(shift)
    for attitude, which in ((rows.gyro_bias_attitude, 2), (rows.gyro_scale_attitude, 3)):
        # Gyro errors lessen alpha, and count from row 0, not from where the frame was frozen.
        base = first @ cross_columns(v1, attitude[:1]) + second @ cross_columns(v2, attitude[:1])
        shift[:, which] = -shift[:, which] - base
        chain[:, which] = attitude[at] - attitude[0]
    sigmas = (grade.accel_bias, grade.accel_scale, grade.gyro_bias, grade.gyro_scale)
    for i, s in enumerate(sigmas):
        covariance = covariance + kappa * s**2 * square(shift[:, i] + chain[:, i])
    walk = grade.angle_random_walk**2 * (rows.time_s[ends] - rows.time_s[0])
    return np.asarray(covariance + walk[:, None, None] * np.eye(3))
