"""Pairs of vectors ``beta = C_ib0^i alpha`` out of the two integrated sides.

The forms differ only here: ``win`` takes differences over a sliding window, ``int`` from the
first fix, ``diff`` and ``diffc`` differentiate velocity. ``cen`` takes out the mean and ``pos``
(twice integrated) a straight line. Nothing is normalised: a long vector is known better.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sinstool.core.rotation import to_dcm
from sinstool.core.streams import take_rows
from sinstool.methods.alignment.accumulation import InertialRows
from sinstool.methods.alignment.reference import acceleration_reference

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


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
    newer: IndexArray
    older: IndexArray
    scale: FloatArray
    gains: FloatArray

    def __len__(self) -> int:
        return len(self.alpha)

    def rows(self, which: slice | NDArray[np.bool_]) -> Pairs:
        """Pairs by slice or mask; `newer` and `older` stay as they are."""
        return take_rows(self, which)


def velocity_gains(rows: InertialRows) -> FloatArray:
    """What alpha answers to the four errors, shape (n, 4, 3, 3), in the order of `Pairs.gains`."""
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
    return max(1, round(window_s / float(np.median(np.diff(time_s)))))


def integrated_pairs(
    kind: str,
    rows: InertialRows,
    beta: FloatArray,
    level: FloatArray,
    length: int,
    sigma_usual: float,
    calm_until: IndexArray | None = None,
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
    calm_until: IndexArray | None = None,
) -> Pairs:
    """Pairs ``diff`` and ``diffc``: specific force against differentiated velocity.

    Parameters
    ----------
    rows : InertialRows
        At the antenna; whose own acceleration against the IMU is left out.
    position : tuple of ndarray
        Latitude, longitude, height, each of shape (n,).
    velocity_n : ndarray, shape (n, 3)
    level, sigma_usual, calm_until
        As for :func:`integrated_pairs`.

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
    weight[newer] = 2.0 * sigma_usual**2 / (level[newer] ** 2 + level[older] ** 2)
    if calm_until is not None:
        weight[newer] *= calm_until[newer] == calm_until[older]
    gains[newer, 0] = c
    gains[newer, 1] = c * rows.force_b[at][:, None, :]
    gains[newer, 2] = cross_columns(force, rows.gyro_bias_attitude[at])
    gains[newer, 3] = cross_columns(force, rows.gyro_scale_attitude[at])
    return Pairs(alpha, beta, weight, np.arange(count), back, scale, gains)


def centred_pairs(
    rows: InertialRows,
    beta: FloatArray,
    weight: FloatArray,
    line: bool,
) -> Pairs:
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
