"""How far the rate of quiet times may be from the bias of the gyros.

What does not shake, sway or turn in them shows the bias. How they differ from one another shows how
well.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from math import exp, sqrt

import numpy as np

from sinstool.core.order_statistics import median
from sinstool.methods.attitude_smoother.epochs import (
    ACCEL,
    AT_REST,
    GYRO,
    MOVING,
    OWN_RATE,
    RATE_DOUBT,
    REST,
    SWAY_RATE,
    TURN_DOUBT,
)
from sinstool.methods.attitude_smoother.model import LARGE_BIAS, SensorModel
from sinstool.methods.sensor_errors import CALIBRATED, UNCALIBRATED

# The shortest time that looks like rest, epochs.
WINDOW = 10  # epochs
# One sigma of the rate of a bend that is taken for straight travel where the bias is unknown,
# rad/s.
SLOW_TURN = 3e-3
# Quiet times no more epochs apart may be those of one slow turn, as of a ship that drifts.
ONE_TURN = 150
ROLLS = 2e-3  # rad/s, on each axis
# Rate of a long turn of an aircraft, one sigma, rad/s.
TURN = 0.03
# A lower probability of a turn is none.
LEAST = 0.01
# A median of distances, times OF_MEDIAN, is a standard deviation; it is of so many pieces or more.
OF_MEDIAN, LEAST_PIECES = 1.4826, 4


def note_doubt(rows: np.ndarray, looked: np.ndarray, sensors: SensorModel) -> None:
    """Set the doubt of the rate in quiet and steady times: the variance between such times.

    Slow sway and slow turns last as long as these times do, so that each is one sample of the bias
    only. A single one may be a long bend, if nothing else shows the bias.

    Parameters
    ----------
    looked : ndarray of bool, shape (n,)
        Which epochs looked like rest. Without a rest, those that are still quiet may only agree
        because the others, which do not, were refuted.
    """
    rows[:, RATE_DOUBT] = rows[:, TURN_DOUBT] = 0.0
    found = runs((rows[:, REST] > MOVING) & (rows[:, REST] < AT_REST))
    if not found:
        return
    differ = float(_means(rows, found).var(axis=0, ddof=1).mean()) if len(found) > 1 else 0.0
    if sensors.bias > LARGE_BIAS:
        quiet = np.concatenate([rows[begin:end] for begin, end in found])
        again = 0 if _in_one_turn(rows, found) else len(found) - 1
        for begin, end in found:
            doubt = _turn_doubt(quiet, sensors, again, differ)
            rows[begin:end, TURN_DOUBT] = doubt * len(quiet)
    if not (rows[:, REST] == AT_REST).any():
        differ = max(differ, _spread(rows, looked, found))
    for begin, end in found:
        rows[begin:end, RATE_DOUBT] = differ * (end - begin)


def _means(rows: np.ndarray, parts: Iterable[tuple[int, int]]) -> np.ndarray:
    """Mean rates of parts of a log, shape (n, 3)."""
    return np.array([rows[begin:end, GYRO : GYRO + 3].mean(axis=0) for begin, end in parts])


def _spread(rows: np.ndarray, looked: np.ndarray, quiet: list[tuple[int, int]]) -> float:
    """Variance of the rate in all that looked like rest, about that of what is still quiet.

    Over pieces as long as what is quiet, by a median: bends that are refuted do not count where
    most of the time is straight.
    """
    long = int(median([end - begin for begin, end in quiet]))
    wide = max(WINDOW, min(long, int(np.count_nonzero(looked)) // LEAST_PIECES))
    pieces = []
    for begin, end in runs(looked):
        edges = np.linspace(begin, end, max(1, (end - begin) // wide) + 1).astype(int)
        pieces += list(pairwise(edges.tolist()))
    if len(pieces) < LEAST_PIECES:
        return 0.0
    kept = np.concatenate([rows[begin:end, GYRO : GYRO + 3] for begin, end in quiet])
    # By their length, as one bend of a smooth road may be in many pieces
    off = np.repeat(np.abs(_means(rows, pieces) - kept.mean(axis=0)), np.diff(pieces)[:, 0], axis=0)
    own = np.mean([noise_of_mean(rows[begin:end]).mean() / (end - begin) for begin, end in pieces])
    return max(0.0, float(np.mean((OF_MEDIAN * median(off, axis=0)) ** 2)) - float(own))


def _in_one_turn(rows: np.ndarray, found: list[tuple[int, int]]) -> bool:
    """Whether all of these times may lie in one slow turn: there is one, or they are lulls afloat.

    What floats rolls between its lulls, and they follow one another.
    """
    between = [(before[1], after[0]) for before, after in pairwise(found)]
    if not between:
        return True
    if any(end - begin > ONE_TURN for begin, end in between):
        return False
    quiet, rolls = (np.concatenate([rows[a:b] for a, b in spans]) for spans in (found, between))
    up = quiet[:, ACCEL : ACCEL + 3].mean(axis=0)
    up /= max(float(np.linalg.norm(up)), 1e-9)
    rate = rolls[:, GYRO : GYRO + 3] - quiet[:, GYRO : GYRO + 3].mean(axis=0)
    across = rate - np.outer(rate @ up, up)
    return float(np.mean(across**2)) > ROLLS**2


def _turn_doubt(quiet: np.ndarray, sensors: SensorModel, again: int, differ: float) -> float:
    """Variance of a turn about the vertical in the only quiet times that show the bias, rad^2/s^2.

    The larger the rate, the more probable that it is a turn's; then all of the rate is the turn.
    Turns seldom have a rate again, to within a variance by which these times differ.
    """
    up = quiet[:, ACCEL : ACCEL + 3].mean(axis=0)
    measured = quiet[:, GYRO : GYRO + 3].mean(axis=0) - np.asarray(sensors.bias_mean)
    rate = float(measured @ up) / max(float(np.linalg.norm(up)), 1e-9)
    turn, *biases = (
        exp(-0.5 * (rate / sigma) ** 2) / sigma for sigma in (TURN, CALIBRATED, UNCALIBRATED)
    )
    if not again:
        return SLOW_TURN**2 + turn / (turn + 0.5 * sum(biases)) * rate**2
    turn *= min(1.0, sqrt(differ + sensors.zero_rate**2) / TURN) ** again
    share = turn / max(turn + 0.5 * sum(biases), 1e-300)
    return share * rate**2 if share > LEAST else 0.0


def noise_of_mean(rows: np.ndarray) -> np.ndarray:
    """Variance of an axis' mean rate by noise, of epochs that look like rest.

    Vibration cancels in the means by more than white noise of its size does.
    """
    return np.minimum(rows[:, OWN_RATE], rows[:, SWAY_RATE])


def runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """Begin and end of each stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return [(int(a), int(b)) for a, b in pairwise(edges.tolist())][::2]
