"""Effect of constant errors of gyros, of scale factor and misalignment, on a smoothed attitude."""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.timeline import SECOND
from sinstool.methods.attitude_smoother import state
from sinstool.methods.attitude_smoother.epochs import GYRO, JB, Epochs
from sinstool.methods.attitude_smoother.model import SensorModel


def turned_wrongly(turn: FloatArray, sensors: SensorModel) -> FloatArray:
    """Variance of the angle for gyros with constant scale factors and misalignments, rad^2.

    Of turns as :func:`felt` gives them.
    """
    sigma = np.full((3, 3), sensors.gyro_misalignment)
    sigma[np.diag_indices(3)] = sensors.gyro_scale
    return np.asarray(np.einsum("nij,ij->n", turn**2, sigma**2))


def felt(epochs: Epochs, smoothed: FloatArray, axis: int) -> FloatArray:
    """Turn about a navigation axis for a unit error of each scale factor and misalignment, rad.

    Element i, j: the error with which the i-th gyro measures rates about the j-th axis, since the
    start, shape (n + 1, 3, 3). It adds up over the log, and cancels where the body turns back.
    Gravity shows none of that about the vertical.
    """
    rows = epochs.values
    turned = rows[:, JB : JB + 9].reshape(-1, 3, 3)
    about = np.einsum("ni,nij->nj", smoothed[:-1, 3 * axis : 3 * axis + 3], turned)
    about[epochs.gap] = 0.0
    out = np.zeros((len(rows) + 1, 3, 3))
    np.cumsum(about[:, :, None] * _rates(epochs, smoothed)[:, None, :], axis=0, out=out[1:])
    return out


def _rates(epochs: Epochs, smoothed: FloatArray) -> FloatArray:
    return epochs.values[:, GYRO : GYRO + 3] - smoothed[:-1, state.B : state.B + 3]


def lag(
    epochs: Epochs, smoothed: FloatArray, attitude: FloatArray, sensors: SensorModel
) -> FloatArray:
    """Variance of tilt of a body that spins, by scale factors and misalignments of gyros, rad^2.

    Each pass lags by the excess angle of the gyros until gravity has corrected it, which takes the
    variance of tilt over process noise. The lags of the passes forwards and backwards cancel,
    except to second order: their square.
    """
    seconds = np.diff(epochs.time_ns) / SECOND
    square = np.einsum("ni,ni->n", *2 * [_rates(epochs, smoothed)]) * seconds
    noise = sensors.angle_random_walk**2 + sensors.rate_error**2 * square[~epochs.gap].mean()
    level = float(np.median(attitude[:, [0, 1], [0, 1]]))
    memory = 0.5 * min(level / noise, seconds.sum()) * SECOND
    limits = epochs.time_ns
    begin, end = (np.searchsorted(limits, limits + by) for by in (-memory, memory))
    begin, end = np.minimum([begin, end], len(limits) - 1)
    lags = [
        turned_wrongly(turn[end] - turn[begin], sensors)
        for turn in (felt(epochs, smoothed, axis) for axis in (0, 1))
    ]
    return np.asarray(np.maximum(*lags) ** 2)
