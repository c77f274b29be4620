"""The kind of motion in a log: the bound that makes its accelerations more likely."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from math import exp, log, sqrt

import numpy as np

from sinstool.core.threads import executor
from sinstool.methods.attitude_smoother.epochs import Epochs, merged
from sinstool.methods.attitude_smoother.filter_step import DIVERGED
from sinstool.methods.attitude_smoother.model import (
    EPOCH_S,
    FOLLOWER,
    HAND,
    VEHICLE,
    MotionModel,
    MotionName,
    SensorModel,
)
from sinstool.methods.attitude_smoother.start import filtered
from sinstool.methods.sensor_errors import MISSED

# The motion is a vehicle's where its log likelihood exceeds that of a hand by MARGIN, nat per
# moving epoch, or by SECOND_MARGIN per moving second, as on a smooth road only slow accelerations
# tell the two apart. Between 0.6 and 1.4 times that the choice is not sure. Recorded hands reach
# 0.1 and 1.6 at most, drones that hover in a room 1 and 5, cars and ships 3, or 16, and more, but
# gentle cars with MEMS sensors no more than 0.04, or 2.6. In doubt the vehicle is chosen: on a hand
# its model is wrong by tenths of a degree, with wide sigmas; on a car a hand's is wrong by a
# degree, several of its sigmas.
MARGIN, SECOND_MARGIN = 0.4, 1.76
UNSURE = 0.4
# The margins hold for calibrated gyros, see `SensorModel`.
CALIBRATED_RATE_ERROR = SensorModel().rate_error
# Limit of the margin, nat: beyond it the filter of the other model diverged.
LARGEST_MARGIN = 1000.0
# A motion shorter than SHORT_S, several cycles of a hand's motion, does not show that its position
# is bounded, and counts as a vehicle's. From SHORTEST_S on it counts as a hand's if a vehicle's log
# likelihood exceeds that of a hand by less than SHORT_MARGIN, nat per moving epoch.
SHORTEST_S, SHORT_S, SHORT_MARGIN = 15.0, 60.0, 0.1
# A hand does not move faster than this, m/s.
HAND_SPEED = 4.0
# The moving epochs that are examined: ten minutes, in this many stretches of two minutes.
STRETCHES = 5
STRETCH = 600
# The density of a hand's acceleration is the largest of the most likely ones for the lengths of
# epochs in HAND_LONGER; that of a vehicle is VEHICLE_FACTOR times the largest, as manoeuvres are
# not white, and their slowest part sets the error of tilt (turns of an aircraft last half a
# minute). m/s^2/sqrt(Hz)
HAND_RANGE = (0.5, 4.0)
LEAST_VEHICLE, VEHICLE_FACTOR = 4.0, 2.5
SECOND = 5  # epochs
LONGER: tuple[int, ...] = (1, SECOND, 20, 100)
HAND_LONGER = LONGER[:3]
# A vehicle's velocity is taken to follow its heading if that is more likely by this, nat, over
# epochs of 4 s: shorter ones show vibration rather than the path.
FOLLOWS_MARGIN, FOLLOWS_EPOCHS = 3.0, 20
# That a gyro is saturated must be more likely by this, nat.
STOPS_MARGIN = 5.0
# The search runs on a grid of the logarithm of the density with this spacing, in steps of this many
# points at first, and of fewer where it begins at the result for longer epochs.
GRID, FIRST_STEP, NEAR_STEP = 0.2, 4, 2
SEARCHED = (log(0.005), log(50.0))


@dataclass(frozen=True)
class Motion:
    """The kind of motion.

    Attributes
    ----------
    model : MotionModel
    margin : float or None
        Log likelihood of a vehicle less that of a hand, nat per moving epoch; or, if larger, that
        per moving second, scaled to the same limit. None where the two were not compared.
    short : bool
        The motion is too short to show that its position is bounded. It is then taken for a
        vehicle's, which assumes less, unless a vehicle is hardly likelier than a hand.
    chosen : bool
        By the user. The margin then says whether the log contradicts a hand that was chosen.
    """

    model: MotionModel
    margin: float | None
    short: bool = False
    chosen: bool = False

    @property
    def sure(self) -> bool:
        """Whether the margin is far from where the choice turns."""
        if self.chosen or self.margin is None or self._not_by_hand:
            return True
        return not self.short and self.margin < (1.0 - UNSURE) * MARGIN

    @property
    def denied(self) -> bool:
        """Whether the log shows that a hand, which was chosen, is a vehicle."""
        return self.chosen and self.model.name == "hand" and self._not_by_hand

    @property
    def _not_by_hand(self) -> bool:
        return self.margin is not None and self.margin > (1.0 + UNSURE) * MARGIN


def find_motion(
    epochs: Epochs,
    sensors: SensorModel,
    name: MotionName | None = None,
    speed: float | None = None,
) -> Motion:
    """Find the kind of motion, and the density of its accelerations.

    Parameters
    ----------
    epochs : Epochs
        With rest marked.
    sensors : SensorModel
    name : {'hand', 'vehicle'}, optional
        Kind of motion, where the user chose it. A hand is compared with a vehicle all the same, as
        its model assumes more.
    speed : float, optional
        Speed that GNSS shows, m/s: the model must allow for velocities of that size.

    Returns
    -------
    Motion
    """
    # Scale factors of uncalibrated gyros are constant: their errors cancel in a turn to and fro
    sensors = replace(sensors, rate_error=min(sensors.rate_error, CALIBRATED_RATE_ERROR))
    parts, chosen = stretches(epochs), name is not None
    moving = sum(int(np.count_nonzero(~part.rest & ~part.gap)) for part in parts)
    least = max(LEAST_VEHICLE, (speed or 0.0) * sqrt(2.0 * VEHICLE.c1))
    if not moving:
        assumed = VEHICLE.with_density(least) if name == "vehicle" else HAND
        return Motion(assumed, None if chosen else 0.0, chosen=chosen)
    if name is None and speed is not None and speed > HAND_SPEED:
        name = "vehicle"
    margin, short, search = None, False, _Search(parts, sensors)
    models = [VEHICLE] if name == "vehicle" else [HAND, VEHICLE]
    with executor(2, "sinstool-motion") as pool:
        list(pool.map(search.best, models, [1] * len(models)))
    if name != "vehicle":
        margin = max(search.margin(1), search.margin(SECOND) * MARGIN / SECOND_MARGIN)
    if margin is not None and name is None:
        enough = SHORTEST_S if margin < SHORT_MARGIN else SHORT_S
        short = moving * EPOCH_S < enough
        name = "vehicle" if short or margin > MARGIN else "hand"
    if name == "hand":
        density = max(search.best(HAND, length)[0] for length in HAND_LONGER)
        density = min(max(density, HAND_RANGE[0]), HAND_RANGE[1])
        doubtful = moving * EPOCH_S < SHORT_S and margin is not None and margin > -SHORT_MARGIN
        return Motion(HAND.with_density(density), margin, doubtful, chosen)
    model, lengths = VEHICLE, LONGER
    follows = search.best(FOLLOWER, FOLLOWS_EPOCHS)[1]
    if follows > search.best(VEHICLE, FOLLOWS_EPOCHS)[1] + FOLLOWS_MARGIN:
        model, lengths = FOLLOWER, LONGER[1:]
        least = max(LEAST_VEHICLE, (speed or 0.0) * sqrt(2.0 * FOLLOWER.c1))
    density = max(search.best(model, length)[0] for length in lengths)
    return Motion(model.with_density(max(VEHICLE_FACTOR * density, least)), margin, short, chosen)


def likeliest_stop_rate(
    epochs: Epochs, sensors: SensorModel, largest: float, surely: bool
) -> float:
    """Most likely rate that saturated gyros miss, rad/s, by what gravity shows afterwards.

    A motor that turns at its largest speed looks the same to a gyro, but then the attitude agrees
    with gravity, and the answer is 0.

    Parameters
    ----------
    epochs : Epochs
        With rest, and the time at the stops, marked.
    sensors : SensorModel
    largest : float
        The rate at which they saturate, rad/s.
    surely : bool
        They are known to be saturated: the answer is not 0.
    """
    likely = {}
    for share in (0.0, *MISSED):
        search = _Search(stretches(epochs), replace(sensors, stop_rate=share * largest))
        likely[share] = max(search.best(model, 1)[1] for model in (HAND, VEHICLE))
    best = max(MISSED, key=lambda share: likely[share])
    return best * largest if surely or likely[best] > likely[0.0] + STOPS_MARGIN else 0.0


class _Search:
    """Most likely density of each model and length of epochs, computed once."""

    def __init__(self, parts: list[Epochs], sensors: SensorModel) -> None:
        self._parts = {length: [merged(part, length) for part in parts] for length in LONGER}
        self._sensors = sensors
        self._cache: dict[tuple[MotionModel, int], tuple[float, float]] = {}

    def best(self, model: MotionModel, length: int) -> tuple[float, float]:
        """Density under which the motion is most likely, and its log likelihood there."""
        key = model, length
        if key not in self._cache:
            # Over longer epochs the search is quicker, and its result is close to that over short
            # ones
            near = self.best(model, SECOND)[0] if length == 1 else None
            self._cache[key] = most_likely_density(self._parts[length], model, self._sensors, near)
        return self._cache[key]

    def margin(self, length: int) -> float:
        """Log likelihood of a vehicle less that of a hand, nat per moving epoch."""
        parts = self._parts[length]
        moving = sum(int(np.count_nonzero(~part.rest & ~part.gap)) for part in parts)
        more = (self.best(VEHICLE, length)[1] - self.best(HAND, length)[1]) / max(moving, 1)
        return min(max(more, -LARGEST_MARGIN), LARGEST_MARGIN)


def stretches(epochs: Epochs) -> list[Epochs]:
    """Parts of a log with some minutes of motion each, spread over all of it."""
    moving = np.flatnonzero(~epochs.rest & ~epochs.gap)
    if len(moving) <= STRETCHES * STRETCH:
        return [epochs] if len(epochs) else []
    starts = np.linspace(0, len(moving) - STRETCH, STRETCHES).astype(int)
    return [
        replace(epochs, time_ns=epochs.time_ns[a : b + 2], values=epochs.values[a : b + 1])
        for a, b in ((moving[k], moving[k + STRETCH - 1]) for k in starts)
    ]


def most_likely_density(
    parts: list[Epochs], model: MotionModel, sensors: SensorModel, near: float | None = None
) -> tuple[float, float]:
    """Density under which the motion is most likely, and its log likelihood there.

    Parameters
    ----------
    near : float, optional
        Where to begin: a result of this function for other epochs.
    """

    @cache
    def likelihood(number: int) -> float:
        at = log(HAND.density) + GRID * number
        if not SEARCHED[0] <= at <= SEARCHED[1]:
            return DIVERGED
        total = 0.0
        for part in parts:
            total = max(total + filtered(part, model.with_density(exp(at)), sensors), DIVERGED)
        return total

    best, step = 0, FIRST_STEP
    if near is not None:
        number = round(log(near / HAND.density) / GRID)
        if likelihood(number) > DIVERGED:
            best, step = number, NEAR_STEP
    directions = [-1, 1]
    while step:
        for direction in directions:
            if likelihood(best + direction * step) > likelihood(best):
                best += direction * step
                # the other direction leads back to a lower likelihood
                directions = [direction]
                break
        else:
            step //= 2
            directions = [-1, 1]
    return exp(log(HAND.density) + GRID * best), likelihood(best)
