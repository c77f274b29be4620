"""Sums over pairs: all that attitude and covariance need of them.

Once over all pairs at hand, or running from pair to pair.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from sinstool.methods.alignment.accumulation import InertialRows
from sinstool.methods.alignment.pairs import Pairs, cross_columns, velocity_gains

FloatArray = NDArray[np.float64]


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

    Returns
    -------
    PairSums
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
    terms[:, 54] = pairs.weight > 0.0
    out = np.empty((count, 61))
    _run_kernel(
        terms, pairs.scale[:, None] * weighted, pairs.newer, pairs.older, end_s,
        sigma * sigma, 1.0 / fade_s, np.zeros(64), np.zeros((len(sigma), 4)), out,
    )  # fmt: skip
    noise = out[:, [55, 56, 57, 56, 58, 59, 57, 59, 60]]
    return _pair_sums(out, noise, out[:, 54])


def _pair_sums(out: FloatArray, noise: FloatArray, count: FloatArray) -> PairSums:
    return PairSums(
        out[:, :9].reshape(-1, 3, 3),
        out[:, 9:18].reshape(-1, 3, 3),
        noise.reshape(-1, 3, 3),
        out[:, 18:54].reshape(-1, 4, 3, 3),
        count,
    )


@numba.njit(cache=True, nogil=True)
def _run_kernel(terms, parts, newer, older, end, variance, rate, state, touched, out):  # type: ignore[no-untyped-def]
    """Sums from pair to pair.

    `state` holds the sums so far (profile, second, errors, count: 55), the noise (6), the logarithm
    of all fading so far, the last time, and whether there was one; `touched` for each fix its part
    d_k and the fading that it includes.
    """
    for j in range(terms.shape[0]):
        if state[63] == 0.0:
            state[63] = 1.0
            state[62] = end[j]
        fading = (end[j] - state[62]) * rate
        state[62] = end[j]
        state[61] -= fading
        decay = np.exp(-fading)
        for i in range(54):
            state[i] = state[i] * decay + terms[j, i]
        state[54] += terms[j, 54]
        for i in range(55, 61):
            state[i] *= decay * decay
        if terms[j, 54] > 0.0:
            for side in range(2):
                row = newer[j] if side == 0 else older[j]
                sign = 1.0 if side == 0 else -1.0
                late = np.exp(state[61] - touched[row, 3])
                x = touched[row, 0] * late
                y = touched[row, 1] * late
                z = touched[row, 2] * late
                nx = x + sign * parts[j, 0]
                ny = y + sign * parts[j, 1]
                nz = z + sign * parts[j, 2]
                touched[row, 0] = nx
                touched[row, 1] = ny
                touched[row, 2] = nz
                touched[row, 3] = state[61]
                v = variance[row]
                state[55] += v * (nx * nx - x * x)
                state[56] += v * (nx * ny - x * y)
                state[57] += v * (nx * nz - x * z)
                state[58] += v * (ny * ny - y * y)
                state[59] += v * (ny * nz - y * z)
                state[60] += v * (nz * nz - z * z)
        for i in range(61):
            out[j, i] = state[i]


def running_centred_sums(
    rows: InertialRows, beta: FloatArray, sigma: FloatArray, fade_s: float, sigma_usual: float
) -> PairSums:
    """Sums after each fix over the pairs ``cen``: means and what is left of products are updated.

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


@numba.njit(cache=True, nogil=True)
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
                x = left[1] * left[h + 6] - left[2] * left[h + 3]
                y = left[2] * left[h] - left[0] * left[h + 6]
                z = left[0] * left[h + 3] - left[1] * left[h]
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
