"""How far the gyros' bias wanders, by the log itself: what gravity and the rests show of it.

Gyros that warm up, as cheap chips do, have a bias that moves by far more than their grade says.
Gravity then contradicts the attitudes of a slower bias, and the rate changes in a rest, and from
one rest to the next.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf, log, sqrt

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.timeline import SECOND as SECOND_NS
from sinstool.methods.attitude_smoother.epochs import (
    DURATION,
    GYRO,
    OWN_RATE,
    Epochs,
    merged,
)
from sinstool.methods.attitude_smoother.filter_step import DIVERGED
from sinstool.methods.attitude_smoother.model import MotionModel, SensorModel
from sinstool.methods.attitude_smoother.motion import SECOND, stretches
from sinstool.methods.attitude_smoother.quiet_doubt import runs
from sinstool.methods.attitude_smoother.rest import LULL
from sinstool.methods.attitude_smoother.start import filtered

# Walks that are tried, as multiples of that of the grade, which must be less likely by MARGIN, nat.
# The largest within MARGIN of the likeliest counts: gravity corrects a tilt within seconds, and a
# bias that goes one way for minutes does more to heading in that time than such a walk.
TIMES = (3.0, 10.0, 30.0, 100.0)
MARGIN = 4.0
# A bias that wanders because the sensor warms up goes one way for minutes, s: a rest shows the
# slope that its walk has over this time.
WARMS_S = 300.0
# Means over so many parts of a rest show its slope, and how far its rate is from a straight line.
PARTS = 8


@dataclass(frozen=True)
class _Rest:
    """A rest: when it is, s; its mean rate, rad/s, and slope, rad/s^2, of three axes; noise."""

    middle: float
    length: float
    rate: FloatArray
    slope: FloatArray
    slope_noise: float


def wandering(epochs: Epochs, motion: MotionModel, sensors: SensorModel) -> SensorModel:
    """The sensors, with the walk of the gyros' bias under which the log is likeliest.

    Parameters
    ----------
    epochs : Epochs
        With those rests marked that a filter has confirmed.
    motion : MotionModel
    sensors : SensorModel

    Returns
    -------
    SensorModel
        The same, unless a larger walk is likelier than that of their grade.
    """
    parts = [merged(part, SECOND) for part in stretches(epochs)]
    rests = [_rest(epochs, *run) for run in runs(epochs.at_rest) if run[1] - run[0] >= LULL]

    def likelihood(by: float) -> float:
        walk = by * sensors.bias_walk
        tried = replace(sensors, bias_walk=walk)
        total = sum(filtered(part, motion, tried) for part in parts)
        return total + _of_rests(rests, walk, sensors) if total > DIVERGED else -inf

    found = {by: likelihood(by) for by in (1.0, *TIMES)}
    least = max(found[1.0] + MARGIN, max(found.values()) - MARGIN)
    by = max((one for one in TIMES if found[one] > least), default=1.0)
    if by == 1.0:
        return sensors
    walk = by * sensors.bias_walk
    drift = max(sensors.bias_drift, walk / sqrt(WARMS_S))
    return replace(sensors, bias_walk=walk, bias_drift=drift)


def _rest(epochs: Epochs, begin: int, end: int) -> _Rest:
    """What a rest shows. Noise that is not white, and sway, bend a rate as much as they tilt it."""
    rows = epochs.values[begin:end]
    seconds = (epochs.time_ns[begin:end] - epochs.time_ns[0]) / SECOND_NS
    each = np.array_split(np.column_stack([seconds, rows[:, GYRO : GYRO + 3]]), PARTS)
    means = np.array([part.mean(axis=0) for part in each])
    middle = means.mean(axis=0)
    at, rates = means[:, 0] - middle[0], means[:, 1:] - middle[1:]
    slope = at @ rates / (at @ at)
    bent = float(np.sum((rates - np.outer(at, slope)) ** 2)) / (3.0 * (PARTS - 2.0))
    white = PARTS / len(rows) * float(np.mean(rows[:, OWN_RATE]))
    length = float(rows[:, DURATION].sum())
    return _Rest(float(middle[0]), length, middle[1:], slope, max(bent, white) / float(at @ at))


def _of_rests(rests: list[_Rest], walk: float, sensors: SensorModel) -> float:
    """Log likelihood of what the rests show under a walk of the bias, rad/s/sqrt(s).

    The walk of the grade bends the rate within a rest, as a line through a random walk has a
    variance of 6/5 of its square over the time; what is beyond that goes one way.
    """
    usual, further = sensors.bias_walk**2, walk**2 - sensors.bias_walk**2
    shown = [
        (one.slope, one.slope_noise + 1.2 * usual / one.length + further / WARMS_S) for one in rests
    ]
    shown += [
        (after.rate - before.rate, sensors.zero_rate**2 + walk**2 * (after.middle - before.middle))
        for before, after in pairwise(rests)
    ]
    return -0.5 * sum(float(a @ a) / variance + 3.0 * log(variance) for a, variance in shown)
