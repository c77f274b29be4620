"""What constant errors of gyros, of scale and axes, do to a smoothed attitude."""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.timeline import SECOND
from sinstool.methods.attitude_smoother import state
from sinstool.methods.attitude_smoother.epochs import GYRO, JB, Epochs
from sinstool.methods.attitude_smoother.model import SensorModel


def turned_wrongly(turn: FloatArray, sensors: SensorModel) -> FloatArray:
    """Variance of angles for gyros whose scale and axes are constantly off, rad^2; see `felt`."""
    sigma = np.full((3, 3), sensors.gyro_misalignment)
    sigma[np.diag_indices(3)] = sensors.gyro_scale
    return np.asarray(np.einsum("nij,ij->n", turn**2, sigma**2))


def felt(epochs: Epochs, smoothed: FloatArray, axis: int) -> FloatArray:
    """What the i-th gyro feels of the j-th axis about a navigation axis, since the start, rad.

    It adds up over the log, and goes again where the body turns back. Gravity shows none of it
    about the vertical. Shape (n, 3, 3), at the limits of the epochs.
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
    """Variance of tilt for gyros whose scale and axes are off, of a body that spins, rad^2.

    Each pass lags by what the gyros turn too far until gravity has corrected it, to which it takes
    variance over process noise. The lags forwards and backwards cancel, but for what is not linear:
    their square.
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
