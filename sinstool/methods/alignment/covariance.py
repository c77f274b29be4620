"""How well an attitude from vector pairs is known, and how well it could be.

Velocity noise enters differences of integrated vectors twice, so that it is propagated fix by
fix (a sandwich), not pair by pair; the sensors' own errors are considered without being
estimated. Linearised error analysis after Qu et al., eqs. (6)-(11), and Markley & Mortari
2000 for the information matrix.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from sinstool.methods.alignment.pairs import Pairs
from sinstool.methods.alignment.sums import PairSums
from sinstool.methods.sensor_errors import SensorGrade

FloatArray = NDArray[np.float64]

# Of parallel vectors, information about their axis and the noise there are both zero, and their
# ratio nothing: this much of the whole is added to each, and the axis counts as unknown.
_NO_INFORMATION = 1e-10


def _complement(m: FloatArray) -> FloatArray:
    """``tr(M) I - M``."""
    return np.asarray(np.trace(m, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - m)


def attitude_covariance(
    sums: PairSums,
    gyro_bias_attitude: FloatArray,
    gyro_scale_attitude: FloatArray,
    elapsed_s: FloatArray,
    grade: SensorGrade,
    kappa: float,
) -> FloatArray:
    """Covariance of an attitude found from pairs, in ``ib0``.

    Parameters
    ----------
    sums : PairSums
        With any leading axes.
    gyro_bias_attitude, gyro_scale_attitude : ndarray, shape (..., 3, 3)
        Of the rows at the time at which the attitude is wanted, on the base that the gains of
        the pairs have.
    elapsed_s : ndarray, shape (...)
        Over which pairs were gathered.
    grade : SensorGrade
    kappa : float
        Factor on the variances of biases and scale factors.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        rad^2. Where all vectors are parallel the variance about them is huge but finite.

    Notes
    -----
    ``J^-1 [sum sigma^2 (|d|^2 I - d d^T)] J^-1`` plus for each sensor error the square of
    ``J^-1 sum [alpha x] gain`` (and of what it turned the chain by the time wanted). The
    angle random walk counts with all its variance over the time about each axis: pairs take out
    some of it about the axes they know well, and let more gather about the one they know least.
    """
    information = _complement(sums.second)
    size = np.trace(information, axis1=-2, axis2=-1)[..., None, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = np.linalg.inv(information / size + _NO_INFORMATION * np.eye(3)) / size
        noise = _complement(sums.noise)
        all_noise = np.trace(noise, axis1=-2, axis2=-1)[..., None, None]
        noise = noise + _NO_INFORMATION * all_noise * np.eye(3)
        covariance = inverse @ noise @ inverse
        shift = inverse[..., None, :, :] @ sums.errors
    parts = (
        (shift[..., 0, :, :], grade.accel_bias),
        (shift[..., 1, :, :], grade.accel_scale),
        (shift[..., 2, :, :] + gyro_bias_attitude, grade.gyro_bias),
        (shift[..., 3, :, :] + gyro_scale_attitude, grade.gyro_scale),
    )
    for gain, sigma in parts:
        covariance = covariance + kappa * sigma**2 * gain @ np.swapaxes(gain, -1, -2)
    walk = grade.angle_random_walk**2 * np.asarray(elapsed_s)
    return np.asarray(covariance + walk[..., None, None] * np.eye(3))


def geometry(second: FloatArray) -> FloatArray:
    """Geometry ratio ``sqrt((s2 + s3) / (s1 + s2))`` of ``sum alpha alpha^T``, 0 to 1."""
    s = np.maximum(np.linalg.eigvalsh(second), 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.sqrt((s[..., 1] + s[..., 0]) / (s[..., 2] + s[..., 1])))


def worst_sigma(covariance: FloatArray) -> FloatArray:
    """Sigma about the worst axis, rad; infinite where rounding is all there is."""
    return _root(np.asarray(np.linalg.eigvalsh(covariance)[..., -1], dtype=np.float64))


def axis_sigma(covariance: FloatArray) -> FloatArray:
    """Sigma about each axis, shape (..., 3), rad; infinite where rounding is all there is."""
    return _root(np.diagonal(covariance, axis1=-2, axis2=-1))


def _root(variance: FloatArray) -> FloatArray:
    positive = variance > 0.0
    return np.where(positive, np.sqrt(np.where(positive, variance, 1.0)), np.inf)


def drifting_noise(
    pairs: Pairs, time_s: FloatArray, sigma: float, drift: float, drift_s: float
) -> FloatArray:
    """Noise term of pairs from positions: white, and slowly varying errors of the fixes.

    Parameters
    ----------
    pairs : Pairs
        Centred, of shape (n,).
    time_s : ndarray, shape (n,)
    sigma : float
        White, m.
    drift, drift_s : float
        First-order Gauss-Markov: sigma, m, and correlation time, s.

    Returns
    -------
    ndarray, shape (3, 3)
        ``D^T R D``, to be used as `PairSums.noise`.
    """
    d = pairs.weight[:, None] * pairs.alpha
    correlated = _correlate(d, np.exp(-np.diff(time_s, prepend=time_s[:1]) / drift_s))
    return np.asarray(sigma**2 * d.T @ d + drift**2 * d.T @ correlated)


@numba.njit(cache=True, nogil=True)
def _correlate(d, decay):  # type: ignore[no-untyped-def]
    """Sum over j of ``exp(-|t_k - t_j| / tau) d_j``, by one pass each way."""
    count = d.shape[0]
    out = np.zeros_like(d)
    for i in range(d.shape[1]):
        carry = 0.0
        for k in range(count):
            carry = carry * decay[k] + d[k, i]
            out[k, i] += carry
        carry = 0.0
        for k in range(count - 2, -1, -1):
            carry = (carry + d[k + 1, i]) * decay[k + 1]
            out[k, i] += carry
    return out
