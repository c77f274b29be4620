"""Turns that the gyros missed: at a rest, gravity is not where they carried it from another rest.

Gyros may hang for a second, saturate unnoticed, or have a wrong scale. A filter that trusts them
takes the next rest for a steady acceleration, as its vertical is off, and refutes it. But an
acceleration adds to gravity: a specific force that leans by an angle is larger than gravity by a
share of ``1 / cos(angle) - 1``. Where it is not, the body rests, and the gyros are wrong.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import acos, cos, sqrt

import numpy as np

from sinstool.core.arrays import BoolArray
from sinstool.methods.attitude_smoother.correction import Correction
from sinstool.methods.attitude_smoother.epochs import ACCEL, DV, GYRO, W2, Epochs
from sinstool.methods.attitude_smoother.model import EPOCH_S
from sinstool.methods.attitude_smoother.quiet_doubt import WINDOW, runs
from sinstool.methods.attitude_smoother.rest import EQUAL_BIAS, LULL

# An acceleration would have to add more than this to gravity, m/s^2, and less than this share of it
# is found, beside 0.03 m/s^2 by which gravity differs with the attitude of the accelerometers.
TELLING, SHARE = 0.1, 1.0 / 3.0
# A force that leans by more than this is no longer told from one by its size, rad.
MOST_LEANT = 1.2
# By this the bias of gyros is uncertain between two rests, rad/s.
UNSURE_BIAS = 5e-4


@dataclass(frozen=True)
class MissedTurn:
    """What the gyros missed between two rests.

    Attributes
    ----------
    angle : float
        Between gravity at the later rest and where they carried it from the earlier one, rad.
    start_ns, end_ns : int
        The end of the earlier rest, and the beginning of the later one.
    rate_error : float
        Error in proportion to the rate, one sigma of one axis, of which this is a random walk.
    """

    angle: float
    start_ns: int
    end_ns: int
    rate_error: float


def missed_turns(epochs: Epochs, looked: BoolArray) -> list[MissedTurn]:
    """Turns that the gyros missed before or after a rest that was refuted.

    Parameters
    ----------
    epochs : Epochs
        With those rests marked that a filter has confirmed.
    looked : ndarray of bool, shape (n,)
        Epochs that looked like rest before.

    Returns
    -------
    list of MissedTurn
        One for each rest of five seconds that was refuted though its specific force says that it is
        one.
    """
    found = runs(looked)
    rests = [(a, b) for a, b in found if b - a >= WINDOW and np.mean(epochs.at_rest[a:b]) > 0.5]
    missed = []
    for a, b in found:
        if b - a >= LULL and rests and not epochs.at_rest[a:b].any():
            near = min(rests, key=lambda rest: max(rest[0] - b, a - rest[1]))
            missed += _between(epochs, *sorted([near, (a, b)]))
    return missed


def widened(correction: Correction, missed: list[MissedTurn], compassed: bool) -> Correction:
    """A correction that is less certain by what the gyros missed, at some time between two rests.

    Gravity at the rests does not show when it was, nor what it did to heading, which a compass
    does.
    """
    time_ns, covariance = correction.time_ns, correction.covariance_n.copy()
    for one in missed:
        after, between = time_ns > one.start_ns, time_ns < one.end_ns
        covariance[after & between, :2, :2] += 0.25 * one.angle**2 * np.eye(2)
        covariance[after & between if compassed else after, 2, 2] += one.angle**2
    return replace(correction, covariance_n=covariance)


def _between(epochs: Epochs, early: tuple[int, int], late: tuple[int, int]) -> list[MissedTurn]:
    """What the gyros missed between two times of rest, each from one epoch to another."""
    if epochs.gap[early[0] : late[1]].any():
        return []
    one, other = (epochs.values[begin:end] for begin, end in (early, late))
    rates = [rows[:, GYRO : GYRO + 3].mean(axis=0) for rows in (one, other)]
    if np.linalg.norm(rates[1] - rates[0]) > EQUAL_BIAS:
        return []
    sizes = [np.linalg.norm(rows[:, ACCEL : ACCEL + 3].mean(axis=0)) for rows in (one, other)]
    forces = [rows[:, DV : DV + 3].sum(axis=0) for rows in (one, other)]
    cosine = forces[0] @ forces[1] / np.linalg.norm(forces[0]) / np.linalg.norm(forces[1])
    start_ns, end_ns = int(epochs.time_ns[early[1]]), int(epochs.time_ns[late[0]])
    seconds = (sum(late) - sum(early)) * 0.5 * EPOCH_S
    drift = (UNSURE_BIAS + float(np.linalg.norm(rates, axis=1).max())) * seconds
    angle = acos(min(max(float(cosine), -1.0), 1.0)) - drift
    turned = float(epochs.values[early[1] : late[0], W2].sum())
    if angle <= 0.0 or turned <= 0.0:
        return []
    excess = float(sizes[0]) * (1.0 / cos(min(angle, MOST_LEANT)) - 1.0)
    if excess < TELLING or abs(float(sizes[1] - sizes[0])) > SHARE * excess:
        return []
    return [MissedTurn(angle, start_ns, end_ns, angle / sqrt(2.0 * turned))]
