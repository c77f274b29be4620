"""Accuracy of an attitude from vector pairs, estimated and attainable.

Velocity noise enters differences of integrated vectors twice, so that it is propagated fix by
fix (a sandwich), not pair by pair; the sensors' own errors are considered without being
estimated. Linearised error analysis after Qu et al., eqs. (6)-(11), and Markley & Mortari
2000 for the information matrix.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.parts import njit
from sinstool.core.rotation import skew
from sinstool.methods.alignment.accumulation import InertialRows
from sinstool.methods.alignment.pairs import Pairs, PairSums, cross_columns, velocity_gains
from sinstool.methods.alignment.wahba import solve_triad
from sinstool.methods.sensor_errors import SensorGrade

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
    """Covariance of an attitude estimated from pairs of vectors, in ``ib0``.

    Parameters
    ----------
    sums : PairSums
        With any leading axes.
    gyro_bias_attitude, gyro_scale_attitude : ndarray, shape (..., 3, 3)
        Of the rows at the time at which the attitude is wanted, on the base that the gains of
        the pairs have.
    elapsed_s : ndarray, shape (...)
        Over which pairs were gathered.
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
    inverse = _inverse_information(sums)
    with np.errstate(divide="ignore", invalid="ignore"):
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


def _inverse_information(sums: PairSums) -> FloatArray:
    information = _complement(sums.second)
    size = np.trace(information, axis1=-2, axis2=-1)[..., None, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        unit = np.linalg.inv(information / size + _NO_INFORMATION * np.eye(3))
        return np.asarray(unit / size)


def residuals_of_sensors(
    sums: PairSums, pairs: Pairs, grade: SensorGrade, kappa: float
) -> FloatArray:
    """Squared residuals that sensor errors leave, which the solver cannot turn away.

    Parameters
    ----------
    sums : PairSums
        Of these pairs, without leading axes.
    pairs : Pairs
        Of shape (n,).
    grade, kappa
        As for :func:`attitude_covariance`.

    Returns
    -------
    ndarray, shape (n,)
        Expected square of each residual, all three axes together, (m/s)^2 or m^2.

    Notes
    -----
    An error changes each alpha by its gain and the attitude by ``phi = J^-1 sum w [alpha x] gain``;
    ``gain + [alpha x] phi`` is left. Over a minute and more the errors of a tactical gyro leave
    far more than the noise of fixes does, where pairs go back to the start or to a mean.
    """
    turned = _inverse_information(sums) @ sums.errors
    square = np.zeros(len(pairs))
    sigmas = (grade.accel_bias, grade.accel_scale, grade.gyro_bias, grade.gyro_scale)
    for i, sigma in enumerate(sigmas):
        left = pairs.gains[:, i] + cross_columns(pairs.alpha, turned[i])
        square += kappa * sigma**2 * np.sum(left * left, axis=(1, 2))
    return square


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


@njit(cache=True, nogil=True)
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


def middles(time_s: FloatArray, ends: IntArray) -> IntArray:
    """Rows nearest to half way from row 0 to each end."""
    half = 0.5 * (time_s[0] + time_s[ends])
    right = np.clip(np.searchsorted(time_s, half), 1, len(time_s) - 1)
    return right - (half - time_s[right - 1] < time_s[right] - half)


def triad_attitude(
    rows: InertialRows, beta: FloatArray, ends: IntArray
) -> tuple[FloatArray, IntArray]:
    """``C_ib0^i`` from the integrals from row 0 to the middle and to the end.

    Kept for comparison: two vectors hold little of what the fixes know, and where the force
    returns to its old direction they are nearly parallel.

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
    middle: IntArray,
    ends: IntArray,
    at: IntArray,
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
