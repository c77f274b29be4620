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

# A vehicle must explain a moving epoch better by so much, in nat, or a moving second, where
# a smooth road shows no more than slow accelerations; between 0.6 and 1.4 times that the choice
# is not sure. Recorded hands come to 0.1 and 1.6 at most, drones that hover in a room to
# 1 and 5, cars and ships to 3, or 16, and more; gentle cars with MEMS sensors to no more than 0.04,
# or 2.6.
# Doubt goes to the vehicle: its model is tenths of a degree off on a hand and has wide sigmas, a
# hand's is a degree off on a car, by several of its sigmas.
MARGIN, SECOND_MARGIN = 0.4, 1.76
UNSURE = 0.4
# The margins are of gyros that are calibrated, see `SensorModel`.
CALIBRATED_RATE_ERROR = SensorModel().rate_error
# Limit of the margin, nat: beyond it the filter of the other model diverged.
LARGEST_MARGIN = 1000.0
# Some times that a hand goes round and about, s; so long a vehicle that is gentle may, too, and
# a vehicle must be so much the less likely, nat per moving epoch.
SHORTEST_S, SHORT_S, SHORT_MARGIN = 15.0, 60.0, 0.1
# Faster than this it is not a hand, m/s.
HAND_SPEED = 4.0
# Moving epochs that are looked at: ten minutes, in so many stretches.
STRETCHES = 5
STRETCH = 600
# The density of a hand is the most likely one over epochs of that length where it is the largest;
# that of a vehicle is so many times that (manoeuvres are not white, and their slowest part sets the
# tilt: turns of an aircraft last half a minute), m/s^2/sqrt(Hz).
HAND_RANGE = (0.5, 4.0)
LEAST_VEHICLE, VEHICLE_FACTOR = 4.0, 2.5
SECOND = 5  # epochs
LONGER: tuple[int, ...] = (1, SECOND, 20, 100)
HAND_LONGER = LONGER[:3]
# A vehicle goes where it points if that is so many times as likely (nat), over epochs of 4 s: in
# shorter ones its shaking says more than its way.
FOLLOWS_MARGIN, FOLLOWS_EPOCHS = 3.0, 20
# What a gyro may miss at its stop, in ranges; that it is at its stop must be so much the likelier,
# nat.
MISSED = (0.1, 0.2, 0.5, 1.0)
STOPS_MARGIN = 5.0
# The search is on a grid of the density's logarithm: so far from one to the next, and so many of
# them at a time to begin with; fewer where it begins at what was found over longer epochs.
GRID, FIRST_STEP, NEAR_STEP = 0.2, 4, 2
SEARCHED = (log(0.005), log(50.0))


@dataclass(frozen=True)
class Motion:
    """The kind of motion.

    Attributes
    ----------
    model : MotionModel
    margin : float or None
        Log likelihood of a vehicle less that of a hand, nat per moving epoch, or the same over
        moving seconds, scaled, if that is larger; None where the kind was chosen by other means.
    short : bool
        The motion is too short to show that its position is bounded: then it is a vehicle's, as
        that claims less, unless a vehicle is hardly likelier. That it is not may show all the same.
    chosen : bool
        By the user. The margin of a hand that was chosen says what the log thinks of it.
    """

    model: MotionModel
    margin: float | None
    short: bool = False
    chosen: bool = False

    @property
    def sure(self) -> bool:
        """Whether the margin is far from where the choice turns."""
        if self.chosen or self.margin is None or self._no_hand:
            return True
        return not self.short and self.margin < (1.0 - UNSURE) * MARGIN

    @property
    def denied(self) -> bool:
        """Whether the log shows that a hand, which was chosen, is a vehicle."""
        return self.chosen and self.model.name == "hand" and self._no_hand

    @property
    def _no_hand(self) -> bool:
        return self.margin is not None and self.margin > (1.0 + UNSURE) * MARGIN


def find_motion(
    epochs: Epochs,
    sensors: SensorModel,
    name: MotionName | None = None,
    speed: float | None = None,
) -> Motion:
    """The kind of motion, and the density of its accelerations.

    Parameters
    ----------
    epochs : Epochs
        With rest marked.
    sensors : SensorModel
    name : {'hand', 'vehicle'}, optional
        Kind of motion, where the user chose it. That of a hand claims more than that of a vehicle,
        and is held against it all the same.
    speed : float, optional
        Speed that GNSS shows, m/s: the model must allow for velocities of that size.

    Returns
    -------
    Motion
    """
    # Scale factors of gyros that are not calibrated last: what turns to and fro hardly shows them
    sensors = replace(sensors, rate_error=min(sensors.rate_error, CALIBRATED_RATE_ERROR))
    parts, chosen = _stretches(epochs), name is not None
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
    """What gyros miss at what are, or may be, their stops, as gravity shows it, rad/s.

    A motor that turns as fast as it can looks the same to a gyro, but gravity agrees with it.

    Parameters
    ----------
    epochs : Epochs
        With rest, and the time at the stops, marked.
    sensors : SensorModel
    largest : float
        The rate at which they stop, rad/s.
    surely : bool
        They are stops; else the answer may be 0.
    """
    likely = {}
    for share in (0.0, *MISSED):
        search = _Search(_stretches(epochs), replace(sensors, stop_rate=share * largest))
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
            # Over longer epochs it is found sooner, and it is not far from there
            near = self.best(model, SECOND)[0] if length == 1 else None
            self._cache[key] = _most_likely(self._parts[length], model, self._sensors, near)
        return self._cache[key]

    def margin(self, length: int) -> float:
        """Log likelihood of a vehicle less that of a hand, nat per moving epoch."""
        parts = self._parts[length]
        moving = sum(int(np.count_nonzero(~part.rest & ~part.gap)) for part in parts)
        more = (self.best(VEHICLE, length)[1] - self.best(HAND, length)[1]) / max(moving, 1)
        return min(max(more, -LARGEST_MARGIN), LARGEST_MARGIN)


def _stretches(epochs: Epochs) -> list[Epochs]:
    """Parts of a log with some minutes of motion each, spread over all of it."""
    moving = np.flatnonzero(~epochs.rest & ~epochs.gap)
    if len(moving) <= STRETCHES * STRETCH:
        return [epochs] if len(epochs) else []
    starts = np.linspace(0, len(moving) - STRETCH, STRETCHES).astype(int)
    return [
        replace(epochs, time_ns=epochs.time_ns[a : b + 2], values=epochs.values[a : b + 1])
        for a, b in ((moving[k], moving[k + STRETCH - 1]) for k in starts)
    ]


def _most_likely(
    parts: list[Epochs], model: MotionModel, sensors: SensorModel, near: float | None = None
) -> tuple[float, float]:
    """Density under which the motion is most likely, and its log likelihood there.

    Parameters
    ----------
    near : float, optional
        A density that it may be close to, of those that this gives.
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
