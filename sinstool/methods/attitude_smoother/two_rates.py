"""Quiet times of a vehicle with two rates: a bend that is driven evenly, and travel straight on.

On a train or a ship an even bend is as quiet as straight travel, and may last for longer. One of
the two rates is the bias of the gyros, as biases do not change within seconds, and no rest says
which: the one that such gyros have more probably, or that comes again after the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray
from sinstool.core.order_statistics import median
from sinstool.core.running_median import running_median
from sinstool.methods.attitude_smoother.epochs import (
    ACCEL,
    AT_REST,
    GYRO,
    MOVING,
    REST,
    SWAY_RATE,
    Epochs,
)
from sinstool.methods.attitude_smoother.even_turn import NO_TURN, EvenTurn, bias_density
from sinstool.methods.attitude_smoother.model import SensorModel
from sinstool.methods.attitude_smoother.quiet_doubt import TURN, runs
from sinstool.methods.attitude_smoother.rest import LULL, TRANSPORT_RATE
from sinstool.methods.sensor_errors import Grade

# A bend turns about the vertical: across it, rates differ by no more than this share of that.
ACROSS = 0.3
# Rates differ if by so many sigmas; a bias that is less probable than LEAST is none.
SURELY = 3.0
LEAST = 0.01
WIDE = 2 * LULL + 1  # epochs of the running median, which keeps the edges of a bend


@dataclass(frozen=True)
class TwoRates:
    """What two rates in quiet times tell.

    Attributes
    ----------
    turning : ndarray of bool, shape (n,)
        Quiet epochs that are more probably a bend than the others.
    quiet : ndarray of bool, shape (n,)
        Those that show the bias.
    variance : float
        Of the turn about the vertical that these may be, rad^2/s^2.
    turn : EvenTurn
        It, for a finding; `NO_TURN` if it is improbable.
    """

    turning: BoolArray
    quiet: BoolArray
    variance: float
    turn: EvenTurn


def two_rates(
    epochs: Epochs, looked: BoolArray, sensors: SensorModel, removed: FloatArray, grade: Grade
) -> TwoRates | None:
    """Tell which of two rates in the quiet times of a vehicle that never rests is the bias.

    Parameters
    ----------
    epochs : Epochs
        As they were judged.
    looked : ndarray of bool, shape (n,)
        Which looked like rest before.
    sensors : SensorModel
    removed : ndarray, shape (3,)
        Bias that was taken off, rad/s.
    grade : {'consumer', 'mems', 'industrial', 'tactical', 'navigation'}
        By the noise of the gyros, or as stated: what their biases may be.

    Returns
    -------
    TwoRates or None
        None if there is one rate, or a rest.
    """
    rows = epochs.values
    kept = rows[:, REST] > MOVING
    if not kept.any() or (rows[:, REST] == AT_REST).any():
        return None
    gyro = slice(GYRO, GYRO + 3)
    up = rows[kept, ACCEL : ACCEL + 3].mean(axis=0)
    up /= max(float(np.linalg.norm(up)), 1e-9)
    rate = median(rows[kept, gyro], axis=0)
    sway = float(median(rows[looked, SWAY_RATE])) / LULL
    differ = SURELY * sqrt(2.0 * (sensors.zero_rate**2 + sway) + TRANSPORT_RATE**2)
    other = np.zeros(len(rows), np.bool_)
    for begin, end in runs(looked):
        off = running_median(rows[begin:end, gyro], min(WIDE, end - begin)) - rate
        turn = off @ up
        across = np.linalg.norm(off - turn[:, None] * up, axis=1)
        for a, b in runs((np.abs(turn) > differ) & (across < ACROSS * np.abs(turn))):
            other[begin + a : begin + b] = b - a >= LULL
    if not other.any():
        return None
    # Rates may differ from bend to bend: the one that gyros have most probably
    found = [(a, b, median(rows[a:b, gyro], axis=0)) for a, b in runs(other)]
    course = running_median((rows[:, gyro] - rate) @ up, min(WIDE, len(rows)))

    def odds(one: FloatArray) -> float:
        near = np.abs(course - float((one - rate) @ up)) < differ
        again = _occasions(near, looked) - 1
        return bias_density(one + removed, grade) * (TURN / differ) ** max(again, 0)

    of_found = [odds(one) for *_, one in found]
    best = found[int(np.argmax(of_found))][2]
    share = max(of_found) / max(max(of_found) + odds(rate), 1e-300)
    turning, quiet, shown, left = other, kept & ~other, rate, share
    if share > 0.5:
        quiet = np.zeros(len(rows), np.bool_)
        for begin, end, one in found:
            quiet[begin:end] = abs(float((one - best) @ up)) < differ
        turning, shown, left = looked & ~quiet, best, 1.0 - share
    if left < LEAST or not quiet.any():
        return TwoRates(turning, quiet, 0.0, NO_TURN)
    sigma = sqrt(left) * abs(float((best - rate) @ up))
    begin, end = max(runs(quiet), key=lambda run: run[1] - run[0])
    span = int(epochs.time_ns[begin]), int(epochs.time_ns[end])
    turn = EvenTurn(float((shown + removed) @ up), sigma, *span)
    return TwoRates(turning, quiet, sigma**2, turn)


def _occasions(near: BoolArray, looked: BoolArray) -> int:
    """How often quiet times show a rate, after times of another one.

    Straight travel always shows the bias, but two bends are seldom of one rate.
    """
    near = near.copy()
    for begin, end in runs(~near):
        near[begin:end] = end - begin < LULL
    return sum(int(looked[begin:end].sum()) >= LULL for begin, end in runs(near))
