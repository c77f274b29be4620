"""Detection of rest: two seconds in which the means of epochs stay constant.

Steady travel and wide turns look alike; the filter denies those by what led there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sinstool.core.units import DEGREE
from sinstool.methods.attitude_smoother.epochs import (
    ACCEL,
    ACCEL_VARIANCE,
    COUNT,
    GYRO,
    GYRO_VARIANCE,
    REST,
    Epochs,
)

WINDOW = 10  # epochs
AT_ONCE = 4096  # windows
# What the means of epochs scatter by at rest, beside their own noise, and single samples.
GYRO_SCATTER, ACCEL_SCATTER = 0.12 * DEGREE, 0.03  # rad/s, m/s^2
GYRO_NOISE, ACCEL_NOISE = 1.3 * DEGREE, 0.5
# No gyro's bias is as large, rad/s.
LARGEST_BIAS = 0.2
# Rests of one log show one bias, rad/s, and one size of gravity, m/s^2: steady turns show others.
SAME_BIAS, SAME_FORCE = 0.02, 0.15


def with_rest(
    epochs: Epochs,
    moves: Callable[[int, int], bool] | None = None,
    spans: Iterable[tuple[int, int]] = (),
) -> Epochs:
    """The epochs, with those at rest marked.

    Parameters
    ----------
    epochs : Epochs
    moves : callable, optional
        Whether something else, as GNSS, shows motion between two times (ns).
    spans : iterable of (int, int), optional
        Times (ns) between which something else shows rest: where an engine idles the means of
        epochs scatter by more than their noise explains.

    Returns
    -------
    Epochs
    """
    values = epochs.values.copy()
    values[:, REST] = 0.0
    still = _still(epochs)
    for start_ns, end_ns in spans:
        still |= (epochs.time_ns[:-1] >= start_ns) & (epochs.time_ns[1:] <= end_ns) & ~epochs.gap
    for begin, end in _runs(still):
        if moves is not None and moves(int(epochs.time_ns[begin]), int(epochs.time_ns[end])):
            still[begin:end] = False
    still &= _agreeing(values, still)
    values[still, REST] = 1.0
    return replace(epochs, values=values)


def _still(epochs: Epochs) -> np.ndarray:
    """Epochs of windows in which nothing seems to move."""
    rows, gap = epochs.values, epochs.gap
    still = np.zeros(len(rows), np.bool_)
    for begin, end in _runs(~gap):
        # so many windows at a time, as each of their epochs is in memory once for every window
        for first in range(begin, end - WINDOW + 1, AT_ONCE):
            last = min(first + AT_ONCE + WINDOW - 1, end)
            quiet = _quiet(rows[first:last])
            still[first:last] |= np.convolve(quiet, np.ones(WINDOW)) > 0.0
    return still


def _quiet(part: np.ndarray) -> np.ndarray:
    """Whether nothing seems to move in each window, shape (n - WINDOW + 1,)."""
    count = np.maximum(part[:, COUNT], 1.0)[:, None]
    quiet = np.ones(len(part) - WINDOW + 1, np.bool_)
    for mean, square, least, most in (
        (GYRO, GYRO_VARIANCE, GYRO_SCATTER, GYRO_NOISE),
        (ACCEL, ACCEL_VARIANCE, ACCEL_SCATTER, ACCEL_NOISE),
    ):
        variance = _window_mean(part[:, square : square + 3])
        own = _window_mean(part[:, square : square + 3] / count)
        scatter = sliding_window_view(part[:, mean : mean + 3], WINDOW, axis=0).var(axis=-1)
        quiet &= (scatter < least**2 + own).all(axis=1)
        quiet &= (variance < most**2).all(axis=1)
    rate = _window_mean(part[:, GYRO : GYRO + 3])
    quiet &= np.linalg.norm(rate, axis=1) < LARGEST_BIAS
    return quiet


def _window_mean(columns: np.ndarray) -> np.ndarray:
    return np.asarray(sliding_window_view(columns, WINDOW, axis=0).mean(axis=-1))


def _agreeing(rows: np.ndarray, still: np.ndarray) -> np.ndarray:
    """Epochs whose rate and specific force are about those of most of the rests."""
    if not still.any():
        return still
    rate = rows[:, GYRO : GYRO + 3] - np.median(rows[still, GYRO : GYRO + 3], axis=0)
    force = np.linalg.norm(rows[:, ACCEL : ACCEL + 3], axis=1)
    own = np.linalg.norm(np.sqrt(rows[:, GYRO_VARIANCE : GYRO_VARIANCE + 3]), axis=1)
    near = np.linalg.norm(rate, axis=1) < SAME_BIAS + own
    return np.asarray(near & (np.abs(force - np.median(force[still])) < SAME_FORCE))


def _runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """Begin and end of each stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return [(int(a), int(b)) for a, b in pairwise(edges.tolist())][::2]
