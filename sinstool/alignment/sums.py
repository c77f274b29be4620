"""Sums over pairs: all that attitude and covariance need of them.

Once over all pairs at hand, or running from pair to pair with a state that does not grow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from sinstool.alignment.accumulation import InertialRows
from sinstool.alignment.pairs import Pairs, cross_columns, integrated_pairs, velocity_gains

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


def fade_weights(end_s: FloatArray, fade_s: float) -> FloatArray:
    """``exp(-age / fade_s)`` against the last of the given times."""
    return np.exp((end_s - end_s[-1]) / fade_s)


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
    weight = pairs.weight * fade_weights(end_s, fade_s)
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


class RunningPairs:
    """Sums over pairs, kept from row to row; blocks may end anywhere.

    Parameters
    ----------
    fade_s : float

    Attributes
    ----------
    state : ndarray, shape (64,)
        Sums so far (profile, second, errors, count: 55), noise (6), the logarithm of all
        fading so far, the last time, and whether there was one.
    touched : ndarray, shape (h, 4)
        For rows that a later pair may touch: their part d_k and the fading it includes.
    """

    def __init__(self, fade_s: float) -> None:
        self._fade = fade_s
        self.state = np.zeros(64)
        self.touched = np.zeros((0, 4))

    def push(self, pairs: Pairs, end_s: FloatArray, sigma: FloatArray, keep: slice) -> PairSums:
        """Add pairs.

        Parameters
        ----------
        pairs : Pairs
            With indices into the rows kept before, followed by the new rows.
        end_s : ndarray, shape (n,)
        sigma : ndarray, shape (kept + new,)
        keep : slice
            Rows of these that later pairs may touch.

        Returns
        -------
        PairSums
            After each pair.
        """
        count = len(pairs)
        weighted = pairs.weight[:, None] * pairs.alpha
        terms = np.empty((count, 55))
        terms[:, :9] = (pairs.beta[:, :, None] * weighted[:, None, :]).reshape(count, 9)
        terms[:, 9:18] = (pairs.alpha[:, :, None] * weighted[:, None, :]).reshape(count, 9)
        terms[:, 18:54] = cross_columns(weighted[:, None], pairs.gains).reshape(count, 36)
        terms[:, 54] = pairs.weight > 0.0
        touched = np.zeros((len(sigma), 4))
        touched[: len(self.touched)] = self.touched
        out = np.empty((count, 61))
        _run_kernel(
            terms, pairs.scale[:, None] * weighted, pairs.newer, pairs.older, end_s,
            sigma * sigma, 1.0 / self._fade, self.state, touched, out,
        )  # fmt: skip
        self.touched = touched[keep].copy()
        noise = out[:, [55, 56, 57, 56, 58, 59, 57, 59, 60]].reshape(count, 3, 3)
        return PairSums(
            out[:, :9].reshape(count, 3, 3),
            out[:, 9:18].reshape(count, 3, 3),
            noise,
            out[:, 18:54].reshape(count, 4, 3, 3),
            out[:, 54],
        )


@numba.njit(cache=True, nogil=True)
def _run_kernel(terms, parts, newer, older, end, variance, rate, state, touched, out):  # type: ignore[no-untyped-def]
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


class PairAccumulator:
    """From rows of the two sides to sums of pairs; blocks of rows may end anywhere.

    Parameters
    ----------
    kind : {'win', 'int', 'cen'}
    length : int
        Fixes in a window; for ``win``.
    fade_s : float
        Time constant of fading; may be infinite.
    sigma_usual : float
        Velocity noise for which a pair has weight 1, m/s.

    Attributes
    ----------
    state : dict of str to ndarray
        All that is carried: rows kept for later pairs, and sums.

    Notes
    -----
    ``cen`` needs no rows: the mean is taken out of the sums at the end, after the first row
    was subtracted from all.
    """

    def __init__(
        self, kind: str, length: int, fade_s: float = np.inf, sigma_usual: float = 0.1
    ) -> None:
        if kind not in ("win", "int", "cen"):
            raise ValueError(f"Expected `kind` to be 'win', 'int' or 'cen', got {kind!r}.")
        self._kind, self._length, self._usual = kind, length, sigma_usual
        self._fade = fade_s
        self._pairs = RunningPairs(fade_s)
        self._rows: InertialRows | None = None
        self._beta = np.empty((0, 3))
        self._sigma = np.empty(0)
        self._calm = np.empty(0, dtype=np.int64)
        self._centred = np.zeros(_CENTRED + 2)
        self._zero = np.zeros(42)
        self._seen = 0

    def push(
        self,
        rows: InertialRows,
        beta: FloatArray,
        sigma: FloatArray,
        calm_until: NDArray[np.int64] | None = None,
    ) -> PairSums:
        """Sums after each of the next rows.

        Parameters
        ----------
        rows : InertialRows
            At the antenna.
        beta : ndarray, shape (n, 3)
        sigma : ndarray, shape (n,)
        calm_until : ndarray of int64, shape (n,), optional
            As for :func:`~sinstool.alignment.pairs.integrated_pairs`; not for ``cen``.

        Returns
        -------
        PairSums
            With n leading entries.
        """
        if self._kind == "cen":
            return self._centre(rows, beta, sigma)
        calm = np.zeros(len(rows), dtype=np.int64) if calm_until is None else calm_until
        history = len(self._beta)
        if self._rows is not None:
            rows = rows.append_to(self._rows)
        beta = np.concatenate([self._beta, beta])
        sigma = np.concatenate([self._sigma, sigma])
        calm = np.concatenate([self._calm, calm])
        pairs = integrated_pairs(
            self._kind, rows, beta, sigma, self._length, self._usual, calm, history
        )
        if self._kind == "win":
            keep = slice(max(len(rows) - self._length, 0), len(rows))
        else:
            keep = slice(0, 1)
        sums = self._pairs.push(pairs, rows.time_s[history:], sigma, keep)
        self._rows, self._beta, self._sigma = rows.rows(keep), beta[keep], sigma[keep]
        self._calm = calm[keep]
        return sums

    @property
    def state(self) -> dict[str, FloatArray]:
        """All that is carried from block to block."""
        return {
            "sums": self._pairs.state,
            "touched": self._pairs.touched,
            "beta": self._beta,
            "alpha": np.empty((0, 3)) if self._rows is None else self._rows.alpha,
            "centred": self._centred,
        }

    def _centre(self, rows: InertialRows, beta: FloatArray, sigma: FloatArray) -> PairSums:
        count = len(rows)
        values = np.concatenate([rows.alpha, beta, velocity_gains(rows).reshape(count, 36)], axis=1)
        if self._centred[-1] == 0.0 and count:
            self._zero = values[0].copy()
        values = values - self._zero
        alpha, ref, gains = values[:, :3], values[:, 3:6], values[:, 6:]
        w = (self._usual / sigma) ** 2
        noise = (w * sigma) ** 2
        # Weighted sums of: 1, alpha, beta, gains, and products; then those of the noise.
        terms = np.empty((count, _CENTRED))
        terms[:, 0] = w
        terms[:, 1:43] = w[:, None] * values
        terms[:, 43:52] = (w[:, None, None] * ref[:, :, None] * alpha[:, None, :]).reshape(count, 9)
        square = (alpha[:, :, None] * alpha[:, None, :]).reshape(count, 9)
        terms[:, 52:61] = w[:, None] * square
        weighted = (w[:, None] * alpha)[:, None]
        terms[:, 61:97] = cross_columns(weighted, gains.reshape(count, 4, 3, 3)).reshape(count, 36)
        terms[:, 97] = noise
        terms[:, 98:101] = noise[:, None] * alpha
        terms[:, 101:110] = noise[:, None] * square
        out = np.empty((count, _CENTRED))
        _fade_kernel(terms, rows.time_s, 1.0 / self._fade, 97, self._centred, out)
        numbers = self._seen + np.arange(1.0, count + 1.0)
        self._seen += count
        total = out[:, 0]
        mean = out[:, 1:43] / total[:, None]
        mean_a, mean_b = mean[:, :3], mean[:, 3:6]
        outer = mean_a[:, :, None] * mean_a[:, None, :]
        size = total[:, None, None]
        cross_noise = out[:, 98:101][:, :, None] * mean_a[:, None, :]
        centred_gains = mean[:, 6:].reshape(count, 4, 3, 3)
        errors = cross_columns((total[:, None] * mean_a)[:, None], centred_gains)
        return PairSums(
            out[:, 43:52].reshape(count, 3, 3) - size * mean_b[:, :, None] * mean_a[:, None, :],
            out[:, 52:61].reshape(count, 3, 3) - size * outer,
            out[:, 101:110].reshape(count, 3, 3)
            - cross_noise
            - np.swapaxes(cross_noise, -1, -2)
            + out[:, 97][:, None, None] * outer,
            out[:, 61:97].reshape(count, 4, 3, 3) - errors,
            numbers,
        )


_CENTRED = 110


@numba.njit(cache=True, nogil=True)
def _fade_kernel(terms, end, rate, twice, state, out):  # type: ignore[no-untyped-def]
    """Running sums that fade; columns from `twice` on are squares and fade twice as fast."""
    width = terms.shape[1]
    for j in range(terms.shape[0]):
        if state[width + 1] == 0.0:
            state[width + 1] = 1.0
            state[width] = end[j]
        decay = np.exp(-(end[j] - state[width]) * rate)
        state[width] = end[j]
        for i in range(width):
            if i >= twice:
                state[i] = state[i] * decay * decay + terms[j, i]
            else:
                state[i] = state[i] * decay + terms[j, i]
            out[j, i] = state[i]
