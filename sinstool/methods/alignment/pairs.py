"""Pairs of vectors ``beta = C_ib0^i alpha`` from the two integrated sides.

The forms differ only here: ``win`` takes differences over a sliding window, ``int`` from the
first fix, ``diff`` and ``diffc`` differentiate velocity. ``cen`` takes out the mean and ``pos``
(twice integrated) a straight line. Nothing is normalised: a long vector is known better.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import ArrayLike, BoolArray, FloatArray, IntArray
from sinstool.core.order_statistics import median
from sinstool.core.parts import kernel
from sinstool.core.quaternion_kernels import cross, put
from sinstool.core.rotation import to_dcm
from sinstool.core.streams import take_rows
from sinstool.methods.alignment.accumulation import InertialRows
from sinstool.methods.alignment.reference import acceleration_reference


@dataclass(frozen=True)
class Pairs:
    """Pairs, one for each fix at which it is complete.

    Attributes
    ----------
    alpha, beta : ndarray, shape (n, 3)
        In ``ib0`` and in ``i``.
    weight : ndarray, shape (n,)
        0 where there is no pair.
    newer, older : ndarray of int64, shape (n,)
        Rows whose velocity noise enters with ``+scale`` and ``-scale``.
    scale : ndarray, shape (n,)
    gains : ndarray, shape (n, 4, 3, 3)
        What alpha gains per accelerometer bias and scale, and loses per gyro bias and scale.
    """

    alpha: FloatArray
    beta: FloatArray
    weight: FloatArray
    newer: IntArray
    older: IntArray
    scale: FloatArray
    gains: FloatArray

    def __len__(self) -> int:
        return len(self.alpha)

    def rows(self, which: slice | BoolArray) -> Pairs:
        """Pairs by slice or mask; `newer` and `older` stay as they are."""
        return take_rows(self, which)


def velocity_gains(rows: InertialRows) -> FloatArray:
    """Sensitivity of alpha to the four errors of `Pairs.gains`, shape (n, 4, 3, 3)."""
    return np.stack(
        [
            rows.gyro_bias_attitude,
            rows.accel_scale_velocity,
            rows.gyro_bias_velocity,
            rows.gyro_scale_velocity,
        ],
        axis=1,
    )


def window_rows(time_s: FloatArray, window_s: float) -> int:
    """Fixes in a window, at least 1."""
    if len(time_s) < 2:
        return 1
    return max(1, round(window_s / float(median(np.diff(time_s)))))


def integrated_pairs(
    kind: str,
    rows: InertialRows,
    beta: FloatArray,
    level: FloatArray,
    length: int,
    sigma_usual: float,
    calm_until: IntArray | None = None,
) -> Pairs:
    """Pairs ``win`` and ``int``.

    Parameters
    ----------
    kind : {'win', 'int'}
    rows : InertialRows
        At the antenna.
    beta : ndarray, shape (n, 3)
    level : ndarray, shape (n,)
        Velocity noise around each fix, m/s. It should vary little over a window, as the noise of
        a fix nearly cancels between windows of equal weight.
    length : int
        Fixes in a window.
    sigma_usual : float
        Noise for which a pair has weight 1.
    calm_until : ndarray of int64, shape (n,), optional
        Count of samples that were not calm up to each fix; a pair over any gets no weight.

    Returns
    -------
    Pairs
        One for each row.
    """
    newer = np.arange(len(rows))
    back = newer - length if kind == "win" else np.zeros_like(newer)
    older = np.maximum(back, 0)
    gains = velocity_gains(rows)
    exists = (back >= 0) & (newer > older)
    if calm_until is not None:
        exists &= calm_until[newer] == calm_until[older]
    variance = level[newer] ** 2 + level[older] ** 2
    return Pairs(
        rows.alpha[newer] - rows.alpha[older],
        beta[newer] - beta[older],
        np.where(exists, 2.0 * sigma_usual**2 / variance, 0.0),
        newer,
        older,
        np.ones(len(newer)),
        gains[newer] - gains[older],
    )


def differentiated_pairs(
    central: bool,
    rows: InertialRows,
    position: tuple[FloatArray, FloatArray, FloatArray],
    velocity_n: FloatArray,
    level: FloatArray,
    sigma_usual: float,
    calm_until: IntArray | None = None,
    lever_arm_b: ArrayLike = (0.0, 0.0, 0.0),
) -> Pairs:
    """Pairs ``diff`` and ``diffc``: specific force against differentiated velocity.

    Parameters
    ----------
    rows : InertialRows
    position : tuple of ndarray
        Latitude, longitude, height, each of shape (n,).
    velocity_n : ndarray, shape (n, 3)
    level, sigma_usual, calm_until
        As for :func:`integrated_pairs`.
    lever_arm_b : array_like, shape (3,)
        From the IMU to the antenna, whose acceleration against it is differentiated alike, FRD, m.

    Returns
    -------
    Pairs
        One for each row.

    Notes
    -----
    A backward difference lags by half its interval, eq. (10) of Qu et al.: half a fix interval
    of a jerk or of a turn goes into the answer in full.
    """
    count = len(rows)
    force_i, at, newer, older = acceleration_reference(
        rows.time_s, *position, velocity_n, central=central
    )
    alpha, beta = np.zeros((count, 3)), np.zeros((count, 3))
    weight, scale = np.zeros(count), np.zeros(count)
    back = np.zeros(count, dtype=np.int64)
    gains = np.zeros((count, 4, 3, 3))
    c = to_dcm(rows.q[at])
    force = np.einsum("nij,nj->ni", c, rows.force_b[at])
    alpha[newer], beta[newer], back[newer] = force, force_i, older
    scale[newer] = 1.0 / (rows.time_s[newer] - rows.time_s[older])
    swings = rows.swing @ np.asarray(lever_arm_b, dtype=np.float64)
    alpha[newer] += scale[newer, None] * (swings[newer] - swings[older])
    weight[newer] = 2.0 * sigma_usual**2 / (level[newer] ** 2 + level[older] ** 2)
    if calm_until is not None:
        weight[newer] *= calm_until[newer] == calm_until[older]
    gains[newer, 0] = c
    gains[newer, 1] = c * rows.force_b[at][:, None, :]
    gains[newer, 2] = cross_columns(force, rows.gyro_bias_attitude[at])
    gains[newer, 3] = cross_columns(force, rows.gyro_scale_attitude[at])
    return Pairs(alpha, beta, weight, np.arange(count), back, scale, gains)


def centred_pairs(rows: InertialRows, beta: FloatArray, weight: FloatArray, line: bool) -> Pairs:
    """Pairs ``cen`` (integrals less their weighted mean) and ``pos`` (less a straight line).

    Parameters
    ----------
    rows : InertialRows
        At the antenna.
    beta : ndarray, shape (n, 3)
        Integrated once, or twice for ``pos``.
    weight : ndarray, shape (n,)
    line : bool
        ``pos``: `xi` and twice integrated gains, and a line is taken out.

    Returns
    -------
    Pairs
        One for each row; `older` is -1, as each pair holds the noise of its own fix alone.
    """
    count = len(rows)
    alpha = rows.xi if line else rows.alpha
    gains = velocity_gains(rows)
    if line:
        step = np.diff(rows.time_s)[:, None, None, None]
        once = np.zeros_like(gains)
        np.cumsum(0.5 * step * (gains[1:] + gains[:-1]), axis=0, out=once[1:])
        gains = once
    everything = np.concatenate([alpha, beta, gains.reshape(count, 36)], axis=1)
    everything = everything - everything[:1]
    basis = np.ones((count, 1))
    if line and count > 1:
        time = rows.time_s - rows.time_s.mean()
        basis = np.stack([np.ones(count), time / np.abs(time).max()], axis=1)
    root = np.sqrt(weight)[:, None]
    # Of an orthonormal base the fit is a product.
    q, r = np.linalg.qr(root * basis)
    everything -= basis @ np.linalg.solve(r, q.T @ (root * everything))
    return Pairs(
        everything[:, :3],
        everything[:, 3:6],
        weight,
        np.arange(count),
        np.full(count, -1),
        np.ones(count),
        everything[:, 6:].reshape(count, 4, 3, 3),
    )


def cross_columns(vectors: FloatArray, matrices: FloatArray) -> FloatArray:
    """``[v x] M`` for stacks, shapes (n, 3) and (n, 3, 3)."""
    return np.swapaxes(np.cross(vectors[..., None, :], np.swapaxes(matrices, -1, -2)), -1, -2)


@dataclass(frozen=True)
class PairSums:
    """Sums over pairs; every field may have leading axes.

    Attributes
    ----------
    profile : ndarray, shape (..., 3, 3)
        ``B = sum w beta alpha^T``.
    second : ndarray, shape (..., 3, 3)
        ``M = sum w alpha alpha^T``.
    noise : ndarray, shape (..., 3, 3)
        ``sum sigma_k^2 d_k d_k^T`` over fixes, with ``d_k = sum_j c_jk w_j alpha_j``.
    errors : ndarray, shape (..., 4, 3, 3)
        ``sum w [alpha x] gains``.
    count : ndarray, shape (...)
        Pairs with weight.
    """

    profile: FloatArray
    second: FloatArray
    noise: FloatArray
    errors: FloatArray
    count: FloatArray


def total_sums(pairs: Pairs, end_s: FloatArray, sigma: FloatArray, fade_s: float) -> PairSums:
    """Sums over all pairs.

    Parameters
    ----------
    pairs : Pairs
        Indices into the rows at hand.
    end_s : ndarray, shape (n,)
        When each pair is complete.
    sigma : ndarray, shape (rows,)
        Noise of the fixes.
    fade_s : float
        Time constant with which weight fades; may be infinite.
    """
    weight = pairs.weight * np.exp((end_s - end_s[-1]) / fade_s)
    weighted = weight[:, None] * pairs.alpha
    touched = np.zeros((len(sigma), 3))
    np.add.at(touched, pairs.newer, pairs.scale[:, None] * weighted)
    two = pairs.older >= 0
    np.add.at(touched, pairs.older[two], -(pairs.scale[:, None] * weighted)[two])
    touched *= sigma[:, None]
    return PairSums(
        pairs.beta.T @ weighted,
        pairs.alpha.T @ weighted,
        touched.T @ touched,
        np.einsum("ngij->gij", cross_columns(weighted[:, None], pairs.gains)),
        np.asarray(np.count_nonzero(pairs.weight), dtype=np.float64),
    )


def running_sums(pairs: Pairs, end_s: FloatArray, sigma: FloatArray, fade_s: float) -> PairSums:
    """Sums after each pair, each from those before it; parameters as of :func:`total_sums`."""
    count = len(pairs)
    weighted = pairs.weight[:, None] * pairs.alpha
    terms = np.empty((count, 55))
    terms[:, :9] = (pairs.beta[:, :, None] * weighted[:, None, :]).reshape(count, 9)
    terms[:, 9:18] = (pairs.alpha[:, :, None] * weighted[:, None, :]).reshape(count, 9)
    terms[:, 18:54] = cross_columns(weighted[:, None], pairs.gains).reshape(count, 36)
    terms[:, _COUNT] = pairs.weight > 0.0
    out = np.empty((count, _FADING))
    _run_kernel(
        terms, pairs.scale[:, None] * weighted, pairs.newer, pairs.older, end_s,
        sigma * sigma, 1.0 / fade_s, np.zeros(64), np.zeros((len(sigma), 4)), out,
    )  # fmt: skip
    noise = out[:, [55, 56, 57, 56, 58, 59, 57, 59, 60]]
    return _pair_sums(out, noise, out[:, _COUNT])


def _pair_sums(out: FloatArray, noise: FloatArray, count: FloatArray) -> PairSums:
    return PairSums(
        out[:, :9].reshape(-1, 3, 3),
        out[:, 9:18].reshape(-1, 3, 3),
        noise.reshape(-1, 3, 3),
        out[:, 18:54].reshape(-1, 4, 3, 3),
        count,
    )


# Columns of the sums from pair to pair: profile, second and errors, their count, the noise (6);
# then of the state the logarithm of all fading so far, the last time, and whether there was one.
_COUNT, _NOISE, _FADING, _LAST, _BEGUN = 54, 55, 61, 62, 63


@kernel()
def _run_kernel(terms, parts, newer, older, end, variance, rate, state, touched, out):  # type: ignore[no-untyped-def]
    """Sums from pair to pair.

    `touched` holds for each fix its part d_k and the fading that it includes.
    """
    for j in range(terms.shape[0]):
        if state[_BEGUN] == 0.0:
            state[_BEGUN] = 1.0
            state[_LAST] = end[j]
        fading = (end[j] - state[_LAST]) * rate
        state[_LAST] = end[j]
        state[_FADING] -= fading
        decay = np.exp(-fading)
        for i in range(_COUNT):
            state[i] = state[i] * decay + terms[j, i]
        state[_COUNT] += terms[j, _COUNT]
        for i in range(_NOISE, _FADING):
            state[i] *= decay * decay
        if terms[j, _COUNT] > 0.0:
            for side in range(2):
                fix = newer[j] if side == 0 else older[j]
                sign = 1.0 if side == 0 else -1.0
                late = np.exp(state[_FADING] - touched[fix, 3])
                x, y, z = touched[fix, 0] * late, touched[fix, 1] * late, touched[fix, 2] * late
                nx, ny, nz = x + sign * parts[j, 0], y + sign * parts[j, 1], z + sign * parts[j, 2]
                put(touched, fix, nx, ny, nz)
                touched[fix, 3] = state[_FADING]
                v = variance[fix]
                state[_NOISE] += v * (nx * nx - x * x)
                state[_NOISE + 1] += v * (nx * ny - x * y)
                state[_NOISE + 2] += v * (nx * nz - x * z)
                state[_NOISE + 3] += v * (ny * ny - y * y)
                state[_NOISE + 4] += v * (ny * nz - y * z)
                state[_NOISE + 5] += v * (nz * nz - z * z)
        for i in range(_FADING):
            out[j, i] = state[i]


def running_centred_sums(
    rows: InertialRows, beta: FloatArray, sigma: FloatArray, fade_s: float, sigma_usual: float
) -> PairSums:
    """Sums after each fix over the pairs ``cen``; updates means and centred products.

    Parameters
    ----------
    rows : InertialRows
        At the antenna.
    beta : ndarray, shape (n, 3)
    sigma : ndarray, shape (n,)
        Noise of the fixes, by which they are weighted.
    fade_s : float
        Time constant of fading; may be infinite.
    sigma_usual : float
        Velocity noise for which a pair has weight 1, m/s.
    """
    count = len(rows)
    values = np.concatenate([rows.alpha, beta, velocity_gains(rows).reshape(count, 36)], axis=1)
    weight = (sigma_usual / sigma) ** 2
    out = np.empty((count, 64))
    _centre_kernel(
        values, rows.time_s, weight, (weight * sigma) ** 2, 1.0 / fade_s, np.zeros(_CENTRED), out
    )
    return _pair_sums(out, out[:, 54:63], out[:, 63])


# Weight, means (42), products of what is left (54); weight of the noise, its mean (3) and
# products (9); number, last time, whether there was one.
_CENTRED = 113


@kernel(allocates=True)
def _centre_kernel(values, end, weight, noise, rate, state, out):  # type: ignore[no-untyped-def]
    """Sums of products less their means, updated so that nothing large cancels."""
    left = np.zeros(42)
    for k in range(values.shape[0]):
        if state[112] == 0.0:
            state[112] = 1.0
            state[111] = end[k]
        decay = np.exp(-(end[k] - state[111]) * rate)
        state[111] = end[k]
        state[110] += 1.0
        state[0] = state[0] * decay + weight[k]
        share = weight[k] / state[0]
        for i in range(42):
            left[i] = values[k, i] - state[1 + i]
            state[1 + i] += share * left[i]
        new = weight[k] * (1.0 - share)
        for i in range(3):
            for j in range(3):
                at = 43 + 3 * i + j
                state[at] = state[at] * decay + new * left[3 + i] * left[j]
                state[at + 9] = state[at + 9] * decay + new * left[i] * left[j]
        for g in range(4):
            for j in range(3):
                at = 61 + 9 * g + j
                h = 6 + 9 * g + j
                x, y, z = cross(left[0], left[1], left[2], left[h], left[h + 3], left[h + 6])
                state[at] = state[at] * decay + new * x
                state[at + 3] = state[at + 3] * decay + new * y
                state[at + 6] = state[at + 6] * decay + new * z
        # The same for the noise, whose weights fade twice as fast, about its own mean.
        state[97] = state[97] * decay * decay + noise[k]
        share = noise[k] / state[97]
        for i in range(3):
            left[i] = values[k, i] - state[98 + i]
            state[98 + i] += share * left[i]
        new = noise[k] * (1.0 - share)
        for i in range(3):
            for j in range(3):
                at = 101 + 3 * i + j
                state[at] = state[at] * decay * decay + new * left[i] * left[j]
                between = (state[98 + i] - state[1 + i]) * (state[98 + j] - state[1 + j])
                out[k, 54 + 3 * i + j] = state[at] + state[97] * between
        for i in range(54):
            out[k, i] = state[43 + i]
        out[k, 63] = state[110]
