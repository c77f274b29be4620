"""Rests that may be an even turn: one shows in the gyros as a bias about the vertical alone.

A vehicle that creeps over a smooth floor is as quiet as one that rests. Where it turns, it turns
about the vertical, while the biases of three gyros lie in any direction: a rate that is nearly all
about the vertical, and larger than what the other two gyros show, is seldom a bias.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from math import sqrt

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.earth import EARTH_RATE
from sinstool.methods.attitude_smoother.epochs import (
    ACCEL,
    GYRO,
    MOVING,
    REST,
    TURN_DOUBT,
    Epochs,
)
from sinstool.methods.attitude_smoother.quiet_doubt import TURN, runs
from sinstool.methods.attitude_smoother.rest import LONG_WINDOW, LULL
from sinstool.methods.sensor_errors import (
    CALIBRATED,
    IMU_GRADES,
    LIKELY,
    LOW_COST,
    UNCALIBRATED,
    Grade,
)

# Of so many times that look like rest, one is an even turn; a lower probability than LEAST, after
# its rate is known, is none.
BEFOREHAND, LEAST = 0.01, 0.08


@dataclass(frozen=True)
class EvenTurn:
    """An apparent rest whose rate may be that of a turn.

    Attributes
    ----------
    rate : float
        About the vertical, where it is most in doubt, rad/s.
    sigma : float
        Of that rate as a bias, rad/s; 0: no rest is in doubt.
    start_ns, end_ns : int
    """

    rate: float
    sigma: float
    start_ns: int
    end_ns: int


NO_TURN = EvenTurn(0.0, 0.0, 0, 0)


def doubt_turns(
    epochs: Epochs,
    removed: FloatArray,
    grade: Grade,
    shown: Callable[[int, int], bool],
) -> EvenTurn:
    """Note at apparent rests the variance of their rates about the vertical, as biases.

    Where another rest shows that the biases are no larger than the grade has them, the turn is
    marked as motion.

    Parameters
    ----------
    epochs : Epochs
        With those marked that look like rest; changed in place are the columns `REST` and
        `TURN_DOUBT`.
    removed : ndarray, shape (3,)
        Bias that was taken off, rad/s.
    grade : {'consumer', 'mems', 'industrial', 'tactical', 'navigation'}
        By the noise of the gyros, or as stated: what their biases may be.
    shown : callable
        Whether something else, as GNSS, shows rest or motion between two times (ns).

    Returns
    -------
    EvenTurn
        The most doubtful one.
    """
    rows = epochs.values
    # Pieces of rests, as a turn may change, or follow a rest without a jolt
    pieces = [
        (rest[0] + first, rest[0] + last)
        for rest in runs(epochs.rest)
        for first, last in _pieces(rest[1] - rest[0])
    ]
    found = [_of_piece(epochs, begin, end, removed, grade, shown) for begin, end in pieces]
    bias = LIKELY * IMU_GRADES[grade].gyro_bias + EARTH_RATE
    small = any(
        abs(one.rate) < bias and not one.sigma and end - begin >= LULL
        for (begin, end), one in zip(pieces, found, strict=True)
    )
    limit = bias + LIKELY * IMU_GRADES[grade].gyro_instability if small else np.inf
    for (begin, end), one in zip(pieces, found, strict=True):
        if one.sigma and abs(one.rate) > limit:
            rows[begin:end, REST] = MOVING
    most = NO_TURN
    for begin, end in runs(epochs.rest):
        inside = [one for (a, b), one in zip(pieces, found, strict=True) if begin <= a < end]
        worst = max(inside, key=lambda one: one.sigma)
        rows[begin:end, TURN_DOUBT] = worst.sigma**2 * (end - begin)
        if worst.sigma > most.sigma:
            span = int(epochs.time_ns[begin]), int(epochs.time_ns[end])
            most = EvenTurn(worst.rate, worst.sigma, *span)
    return most


def _pieces(count: int) -> list[tuple[int, int]]:
    """First and last (exclusive) of about equal pieces of so many epochs."""
    edges = np.linspace(0, count, max(1, count // LONG_WINDOW) + 1).astype(int)
    return list(pairwise(edges.tolist()))


def _of_piece(
    epochs: Epochs,
    begin: int,
    end: int,
    removed: FloatArray,
    grade: Grade,
    shown: Callable[[int, int], bool],
) -> EvenTurn:
    """The doubt in a piece of an apparent rest."""
    start_ns, end_ns = int(epochs.time_ns[begin]), int(epochs.time_ns[end])
    rows = epochs.values[begin:end]
    up = rows[:, ACCEL : ACCEL + 3].mean(axis=0)
    up /= max(float(np.linalg.norm(up)), 1e-9)
    rate = rows[:, GYRO : GYRO + 3].mean(axis=0) + removed
    vertical = float(rate @ up)
    level = float(np.linalg.norm(rate - vertical * up))
    share = 0.0 if shown(start_ns, end_ns) else _turns(vertical, level, grade)
    return EvenTurn(vertical, sqrt(share) * abs(vertical), start_ns, end_ns)


def _turns(vertical: float, level: float, grade: Grade) -> float:
    """Probability of a turn, 0 where it is low, by the rates about the vertical and across it."""
    likely, square = _sizes(grade)
    of_turn = square + TURN**2
    across = likely * np.exp(-0.5 * level**2 / square) / square
    bias = np.sum(across * np.exp(-0.5 * vertical**2 / square) / np.sqrt(square))
    turn = np.sum(across * np.exp(-0.5 * vertical**2 / of_turn) / np.sqrt(of_turn))
    both = BEFOREHAND * turn + (1.0 - BEFOREHAND) * bias
    share = float(BEFOREHAND * turn / both) if both > 0.0 else 0.0
    return share if share >= LEAST else 0.0


def bias_density(rate: FloatArray, grade: Grade) -> float:
    """How likely gyros of a grade have a bias, rad/s, shape (3,): a density over the biases."""
    likely, square = _sizes(grade)
    return float(np.sum(likely * np.exp(-0.5 * (rate @ rate) / square) / square**1.5))


def _sizes(grade: Grade) -> tuple[FloatArray, FloatArray]:
    """Sizes that the biases of all axes may have, how likely each is, and their variances.

    That of the grade, or of a worse one: half as likely each, but as likely for chips, of which
    nothing says that they are calibrated. The Earth's rate may be among them.
    """
    stated = IMU_GRADES[grade].gyro_bias
    worse = (IMU_GRADES["industrial"].gyro_bias, CALIBRATED, UNCALIBRATED)
    square = np.array([stated, *(size for size in worse if size > stated)]) ** 2 + EARTH_RATE**2
    likely = (1.0 if grade in LOW_COST else 0.5) ** np.arange(len(square))
    return np.asarray(likely, dtype=np.float64), square
