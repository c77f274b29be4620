"""Heading from a magnetometer: which part of its field is the Earth's.

Indoors and near vehicles most of what a magnetometer measures is disturbed for a while. The Earth's
field has one size and one dip; epochs with others are left out. The field of magnetised iron in the
body turns with it, and is removed where the body turned enough to show it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.rotation import rotate, to_dcm, wrapped
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.attitude_smoother.earth_field import EarthField
from sinstool.methods.attitude_smoother.epochs import Epochs
from sinstool.methods.attitude_smoother.field import EpochField
from sinstool.methods.attitude_smoother.hard_iron import HardIron, find_hard_iron
from sinstool.methods.attitude_smoother.heading_update import (
    AZIMUTH,
    FIELD,
    FIELD_GATE,
    FIELD_GATE_SIGMAS,
    FIELD_VARIANCE,
    FIELD_WIDTH,
)
from sinstool.methods.attitude_smoother.model import EPOCH_S

Refusal = Literal["", "short", "size", "disturbed", "scatter", "steep", "reversed"]

# Length of a piece, s: within it heading drifts by less than a hard iron turns it.
PIECE_S = 30.0
# A hard iron is estimated from at most this many epochs, about an hour; more show it no better.
MOST_EPOCHS = 20_000
# The Earth's field is at most 67 uT and at least 22; sensors are off by some per cent, T.
SMALLEST, LARGEST = 15e-6, 100e-6
# The Earth's field is the median of this share of the epochs, the densest.
DENSEST = 0.4
# Epochs whose size or dip differs by more are disturbed, and so are those close to a run of them.
SIZE_WITHIN, DIP_WITHIN = 0.1, 8.0 * DEGREE
RUN, MARGIN = 2, 5  # epochs
# Share of a normal distribution within a sigma
ONE_SIGMA = 0.683
# The field is refused if a smaller share, or number of epochs, is trusted, if headings scatter by
# more, or the field is steeper. Even of a field in axes that are not those of the IMU some 30 % lie
# around the densest value.
LEAST_TRUSTED, LEAST_EPOCHS = 1.0 / 3.0, 50
MOST_SCATTER, STEEPEST = 10.0 * DEGREE, 80.0 * DEGREE
# A linear drift of the gyros over this time does not count as scatter, s.
DRIFT_S = 180.0
# Least sigma of a heading, rad, and the time over which its errors are correlated, s.
LEAST_SIGMA, CORRELATED_S = 4.0 * DEGREE, 3.0
# The first heading is the median of this many trusted epochs; its sigma, rad.
FIRST, FIRST_SIGMA = 50, 0.3
# The field in a room may differ by this from that of the place. If it differs by more, it has
# another source, or the tilt is wrong and so is the dip.
SIZE_OF_PLACE, DIP_OF_PLACE = 0.3, 12.0 * DEGREE
# One sigma of the offset that is left, as a share of the field's size: where it was estimated, as
# the gradient of the field in a room looks like it, and where the log cannot show it.
LEFT, UNSEEN_IRON = 0.02, 0.3


@dataclass(frozen=True)
class North:
    """Headings of the field, for the second pass of the smoother.

    Attributes
    ----------
    rows : ndarray, shape (n, FIELD_WIDTH)
        See :mod:`~sinstool.methods.attitude_smoother.heading_update`.
    start : float
        Angle about the vertical by which the first attitude is to be turned, rad.
    variance : float
        Of the error that all headings have in common, rad^2.
    """

    rows: FloatArray
    start: float
    variance: float

    @property
    def start_sigma(self) -> float:
        """Standard deviation of the first heading, before the others are used, rad."""
        return FIRST_SIGMA


@dataclass(frozen=True)
class Compass:
    """Field, hard iron and headings by a magnetometer over a log.

    Attributes
    ----------
    refused : str
        '' where it is used; else ``short`` (too few epochs), ``size`` (not the Earth's field),
        ``disturbed`` (too few are trusted), ``scatter`` (the headings do not agree with the
        gyros), ``steep`` (the horizontal field is too small) or ``reversed`` (it points up where
        that of the place points down, or down for up).
    north : North or None
        None where it is refused.
    hard_iron : HardIron or None
        None where there were no data to estimate it from.
    size, dip : float
        Of the field taken for the Earth's, T and rad (down positive).
    trusted : float
        Share of the epochs with a field that are trusted.
    scatter : float
        Of headings about those of the gyros, rad.
    of_place : bool
        Size and dip are about those of the place, or the place is not known.
    """

    refused: Refusal
    north: North | None = None
    hard_iron: HardIron | None = None
    size: float = 0.0
    dip: float = 0.0
    trusted: float = 0.0
    scatter: float = 0.0
    of_place: bool = True

    @property
    def verified(self) -> bool:
        """Whether the log confirms the heading against north."""
        seen = self.hard_iron is not None and self.hard_iron.seen
        return self.north is not None and seen and self.of_place


def find_north(
    epochs: Epochs,
    measured: EpochField,
    correction: FloatArray,
    azimuth: float = 0.0,
    expected: EarthField | None = None,
) -> Compass:
    """Headings of the field, from an attitude that was smoothed without it.

    Parameters
    ----------
    epochs : Epochs
        Of the log.
    measured : EpochField
        Over the same epochs.
    correction : ndarray, shape (n, 4)
        Of the integrated attitude at the start of the epochs: quaternions in navigation axes.
    azimuth : float, optional
        Of the horizontal field, rad, from the north to which headings refer, towards east.
    expected : EarthField, optional
        Of the place, where that is known.
    """
    used = np.flatnonzero(measured.count > 0.0)
    if len(used) < LEAST_EPOCHS:
        return Compass("short")
    turn = correction[used]
    level = rotate(turn, measured.field[used])
    attitude = to_dcm(turn) @ measured.attitude[used]
    seconds = (epochs.time_ns[used] - epochs.time_ns[0]) / SECOND
    stretch = np.cumsum(epochs.gap)[used]
    some = slice(None, None, len(used) // MOST_EPOCHS + 1)
    iron = find_hard_iron(level[some], attitude[some], _pieces(seconds, stretch, PIECE_S)[some])
    field = measured.field[used]
    if iron.applied:
        level = level - attitude @ iron.offset
        field = field - measured.attitude[used] @ iron.offset
    sizes = np.linalg.norm(level, axis=1)
    dips = np.arctan2(level[:, 2], np.hypot(level[:, 0], level[:, 1]))
    size, dip = _densest(sizes), _densest(dips)
    good = (np.abs(sizes - size) < SIZE_WITHIN * size) & (np.abs(dips - dip) < DIP_WITHIN)
    good &= ~_near_runs(~good, used)
    heading = np.asarray(wrapped(azimuth - np.arctan2(level[:, 1], level[:, 0])))
    trusted = float(good.mean())
    compass = Compass("", None, iron, size, dip, trusted)
    if not SMALLEST < size < LARGEST:
        return replace(compass, refused="size")
    if abs(dip) > STEEPEST:
        return replace(compass, refused="steep")
    if trusted < LEAST_TRUSTED or np.count_nonzero(good) < LEAST_EPOCHS:
        return replace(compass, refused="disturbed")
    scatter = _scatter(heading[good], seconds[good], _pieces(seconds, stretch, DRIFT_S)[good])
    of_place = expected is None or (
        abs(size / expected.size - 1.0) < SIZE_OF_PLACE and abs(dip - expected.dip) < DIP_OF_PLACE
    )
    compass = replace(compass, scatter=scatter, of_place=of_place)
    if expected is not None and abs(expected.dip) > DIP_OF_PLACE > abs(dip + expected.dip):
        return replace(compass, refused="reversed")
    if scatter > MOST_SCATTER:
        return replace(compass, refused="scatter")
    apart = max(float(np.median(np.diff(seconds))), EPOCH_S)
    sigma = max(LEAST_SIGMA, scatter)
    rows = np.zeros((len(epochs), FIELD_WIDTH))
    rows[used, FIELD : FIELD + 3] = field
    rows[:, AZIMUTH] = azimuth
    rows[:, FIELD_GATE] = sigma**2
    rows[used[good], FIELD_VARIANCE] = sigma**2 * max(2.0 * CORRELATED_S / apart, 1.0)
    first = heading[good][:FIRST]
    middle = np.angle(np.exp(1j * first).mean())
    start = float(middle + np.median(wrapped(first - middle)))
    unseen = UNSEEN_IRON * size
    left = np.hypot(LEFT * size, iron.sigma if iron.seen and of_place else unseen)
    # What bends the field up or down bends it sideways as well
    bent = 0.0 if expected is None or not of_place else size * (dip - expected.dip)
    variance = (left**2 + bent**2) / (size * np.cos(dip)) ** 2
    return replace(compass, north=North(rows, start, float(variance)))


def heading_off(north: North, correction: FloatArray) -> float:
    """Median difference of headings of the field from those of an attitude, rad.

    Parameters
    ----------
    correction : ndarray, shape (n, 4)
        As it was smoothed with the headings: see :func:`find_north`.
    """
    used = north.rows[:, FIELD_VARIANCE] > 0.0
    level = rotate(correction[used], north.rows[used, FIELD : FIELD + 3])
    off = wrapped(north.rows[used, AZIMUTH] - np.arctan2(level[:, 1], level[:, 0]))
    return float(np.median(np.abs(off)))


def _pieces(seconds: FloatArray, stretch: np.ndarray, length: float) -> np.ndarray:
    """Number of the piece of this length, s, in which each epoch is; gaps begin a new piece."""
    begins = np.concatenate(([True], np.diff(stretch) > 0))
    since = seconds - np.maximum.accumulate(np.where(begins, seconds, 0.0))
    number = np.floor(since / length)
    return np.cumsum(begins | (np.diff(number, prepend=0.0) != 0.0))


def _densest(values: FloatArray) -> float:
    """Median of the `DENSEST` share of the values, those in the narrowest interval."""
    ordered = np.sort(values)
    count = max(round(DENSEST * len(ordered)), 1)
    width = ordered[count - 1 :] - ordered[: len(ordered) - count + 1]
    first = int(np.argmin(width))
    return float(np.median(ordered[first : first + count]))


def _near_runs(bad: np.ndarray, number: np.ndarray) -> np.ndarray:
    """Whether epochs are in a run of bad ones, or within a second of one."""
    wide = np.zeros(number[-1] + 1, np.bool_)
    wide[number] = bad
    run = np.convolve(wide, np.ones(RUN), "valid") == RUN
    near = np.convolve(run, np.ones(RUN + 2 * MARGIN)) > 0.0
    return near[MARGIN:][: len(wide)][number]


def _scatter(heading: FloatArray, seconds: FloatArray, piece: np.ndarray) -> float:
    """Scatter of trusted headings about a linear drift in each piece, rad."""
    off = []
    for one in np.split(np.arange(len(piece)), np.flatnonzero(np.diff(piece)) + 1):
        angle = np.unwrap(heading[one])
        time = seconds[one] - seconds[one].mean()
        slope = time @ (angle - angle.mean()) / max(time @ time, 1e-9) if len(one) > FIRST else 0.0
        angle = angle - slope * time
        off.append(np.abs(angle - np.median(angle)))
    size = np.concatenate(off)
    most = FIELD_GATE_SIGMAS * np.quantile(size, ONE_SIGMA)
    return float(np.sqrt(np.mean(np.minimum(size, most) ** 2)))
