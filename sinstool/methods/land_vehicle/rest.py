"""Rests of a vehicle, from its IMU and from a track that shows rest and motion.

No constant separates rest from motion for all vehicles: a car with a shaking engine shows more at a
traffic light than another one on the road. So the log's own track sets the thresholds, and if
standing and moving look alike, as in a boat, nothing counts as a rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray
from sinstool.core.chi_square import MEDIAN_SQUARE
from sinstool.methods.ins_gnss.constraints import REST_RATE, STEP_NS
from sinstool.methods.land_vehicle.track import LONGEST_NS, Means, Track, between, within

# Steps of a window over which rate and force are compared: 1 s.
WINDOW = 10
# Limits of standing and of moving by the track, m/s; a speed with a larger sigma, m/s, shows
# neither.
STANDS, MOVES, UNSURE = 0.1, 1.0, 0.3
# Least number of windows of standing, or of moving.
LEAST_WINDOWS = 20
# Where a track moves by so many times as fast as at half of the rests, it moves: what wanders there
# is the receiver. Beside such a place it moves where that is certain by so many sigmas.
CREEPS, CREEPS_SIGMAS = 5.0, 3.0
# A body that turns faster, rad/s, over this time, s, does not stand: ten sigmas of what a rest
# allows.
TURNS, TURNING_NS = 10.0 * REST_RATE, 1_000_000_000
# A rest is an even turn if the gyros show another rate about the vertical than at the nearest
# longer rest, and about other axes no more than this share of it. The bias of a chip that warms up
# changes slowly, and about all axes.
OTHER_RATE, OTHER_AXES = 3.0 * REST_RATE, 0.3
# The threshold is the geometric mean of these quantiles, of standing and of moving windows.
STANDING_QUANTILE, MOVING_QUANTILE = 0.9, 0.01
# Least ratio of these two quantiles with which there is a threshold.
LEAST_APART = 1.2
# Without standing windows the threshold is this share of the least motion; without moving ones,
# this factor on the usual rest.
ALONE_MOVING, ALONE_STANDING = 0.5, 2.0
# Largest thresholds on wheels, rad/s and m/s^2; a boat at anchor or a hand shows more at rest.
MOST = np.array([0.03, 0.5])
# An engine shakes the IMU where its means scatter by this share, at least, of the variance that
# they have at rest, within so many steps: before a vehicle is seen to move it may have ceased to.
SHAKES, SHAKEN_WITHIN = 0.25, 3
# A vehicle rocks before it rests, and pulls away so gently that the beginning does not show: steps
# that are cut off at the begin and end of a rest, the latter in addition to half the window.
CUT_BEGIN, CUT_END = 7, 7


@dataclass(frozen=True)
class Rests:
    """Times at which a vehicle stands.

    Attributes
    ----------
    at : ndarray of bool, shape (g,)
        For each step of the means.
    surely : ndarray of bool, shape (g,)
        Where the fixes show it, too.
    stands : ndarray of bool, shape (g,)
        Where the IMU is as quiet as at rest, and half a window on either side, whatever fixes and
        track show, as long as it is shaken as much as at rest.
    gyro, accel : float
        Thresholds on the scatter within a window, rad/s and m/s^2; 0 without a threshold.
    reason : str
        Where they come from, or why there are none.
    """

    at: BoolArray
    surely: BoolArray
    stands: BoolArray
    gyro: float
    accel: float
    reason: str


def noise_at_rest(means: Means, at: BoolArray) -> tuple[float, float]:
    """Noise that an IMU at rest shows from second to second, vibration included.

    Parameters
    ----------
    at : ndarray of bool, shape (g,)
        Steps at rest.

    Returns
    -------
    force, rate : float
        Power densities, (m/s^2)^2 s and (rad/s)^2 s, mean of the three axes. From medians of the
        change from one second to the next, so that people who get in do not count; 0 if rests are
        too short. The seconds are weighted by a Hann window (Harris 1978): a tone leaks through the
        side lobes of a plain mean, and adds nothing to a random walk.
    """
    ends = np.arange(0, len(means) - 2 * WINDOW + 1, WINDOW)
    whole = ends[~within(~at, 0, 2 * WINDOW - 1)[ends]]
    if len(whole) < LEAST_WINDOWS:
        return 0.0, 0.0
    taper = np.hanning(WINDOW + 2)[1:-1]
    taper /= taper.sum()
    step_s = STEP_NS * 1e-9
    rows = whole[:, None] + np.arange(WINDOW)
    densities = []
    for values in (means.force, means.rate):
        change = np.einsum("k,mki->mi", taper, values[rows + WINDOW] - values[rows])
        # Of the difference of two independent sums
        square = np.nanmedian(change**2, axis=0) / MEDIAN_SQUARE
        densities.append(float(np.mean(square)) * step_s / (2.0 * float(taper @ taper)))
    return densities[0], densities[1]


def find_rests(means: Means, track: Track) -> Rests:
    """Rests of a vehicle.

    Parameters
    ----------
    track : Track
        By a smoother without constraints.
    """
    nothing = np.zeros(len(means), bool)
    if len(means) < 2 * WINDOW or len(track.time_ns) < 2:
        return Rests(nothing, nothing, nothing, 0.0, 0.0, "the log is too short")
    spread = np.stack([_spread(means.rate), _spread(means.force)], axis=1)
    speed = between(track, track.speed, means.time_ns, LONGEST_NS)
    sigma = between(track, track.speed_sigma, means.time_ns, LONGEST_NS)
    shown = np.isfinite(speed) & (sigma < UNSURE) & np.isfinite(spread).all(axis=1)
    half = WINDOW // 2
    turns = between(track, _turning(track), means.time_ns, LONGEST_NS) > TURNS
    stands = shown & ~turns & ~within(~(shown & (speed < STANDS + sigma)), half, half)
    moves = shown & (speed - 2.0 * sigma > MOVES)
    thresholds, reason = _thresholds(spread, stands, moves)
    if not thresholds.any():
        return Rests(nothing, nothing, nothing, 0.0, 0.0, reason)
    with np.errstate(invalid="ignore"):
        quiet = (spread < np.where(thresholds > 0.0, np.minimum(thresholds, MOST), MOST)).all(
            axis=1
        )
    quiet &= np.isfinite(spread).all(axis=1) & ~turns
    stands = within(np.asarray(quiet), half, half)
    # The fixes may overrule the IMU: a smooth road
    quiet &= ~(shown & (speed > STANDS + 3.0 * sigma))
    rest = ~within(~quiet, CUT_BEGIN, half + CUT_END)
    # What the vehicle does behind the end of the log is unknown
    rest[max(len(rest) - CUT_END - half, 0) :] = False
    moved = _creep(rest & shown, speed, sigma)
    moved |= _turn_evenly(means, rest & ~moved)
    rest &= ~moved
    stands &= ~moved
    stands &= rest | _shakes(means, rest)
    gyro, accel = thresholds.tolist()
    return Rests(rest, rest & shown, stands, gyro, accel, reason)


def _creep(rest: BoolArray, speed: FloatArray, sigma: FloatArray) -> BoolArray:
    """Where a body moves so slowly and evenly that it feels like rest, as the jib of a crane.

    At rest a receiver wanders, so half of the rests show how fast a track is there.
    """
    if not rest.any():
        return rest
    usual = float(np.median(speed[rest]))
    with np.errstate(invalid="ignore"):
        surely = rest & (speed > min(CREEPS * usual, STANDS) + CREEPS_SIGMAS * sigma)
        likely = rest & (speed > usual + CREEPS_SIGMAS * sigma)
    part = np.cumsum(np.diff(likely.astype(np.int8), prepend=0) == 1)
    return np.asarray(likely & np.isin(part, part[surely]))


def _turn_evenly(means: Means, rest: BoolArray) -> BoolArray:
    """Which rests are even turns of a vehicle that stands, slower than a track shows them."""
    edges = np.diff(rest.astype(np.int8), prepend=0, append=0)
    begins, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
    turns = np.zeros(len(rest), bool)
    kept: list[tuple[float, FloatArray]] = []
    for k in np.argsort(begins - ends, kind="stable"):
        span = slice(begins[k], ends[k])
        rate, force = means.rate[span].mean(axis=0), means.force[span].mean(axis=0)
        middle = 0.5 * float(begins[k] + ends[k])
        if kept:
            off = rate - min(kept, key=lambda one: abs(one[0] - middle))[1]
            up = force / np.linalg.norm(force)
            about = abs(float(off @ up))
            across = float(np.linalg.norm(off - (off @ up) * up))
            if about > OTHER_RATE and across < OTHER_AXES * about:
                turns[span] = True
                continue
        kept.append((middle, rate))
    return turns


def _shakes(means: Means, rest: BoolArray) -> BoolArray:
    """Where the means scatter from step to step about as they do at rest.

    By second differences, which smooth motion does not change, over their mean squares at rest.
    """
    n = len(means)
    scatter = np.full((n, 6), np.nan)
    values = np.concatenate([means.rate, means.force], axis=1)
    scatter[1:-1] = np.diff(values, n=2, axis=0) ** 2
    usual = np.nanmedian(scatter[rest], axis=0) if rest.any() else np.zeros(6)
    if not np.all(usual > 0.0):
        return np.ones(n, bool)
    total = np.nan_to_num((MEDIAN_SQUARE * scatter / usual).mean(axis=1), nan=1.0)
    size = 2 * SHAKEN_WITHIN + 1
    padded = np.pad(total, SHAKEN_WITHIN, mode="edge")
    return np.asarray(np.convolve(padded, np.full(size, 1.0 / size), "valid") > SHAKES)


def _turning(track: Track) -> FloatArray:
    """By how much the attitude turns about each row, rad/s; what is slow and smooth is no bias."""
    time_ns, dcm = track.time_ns, track.dcm_nb
    before = np.maximum(np.searchsorted(time_ns, time_ns - TURNING_NS, "right") - 1, 0)
    after = np.minimum(np.searchsorted(time_ns, time_ns + TURNING_NS), len(time_ns) - 1)
    # A turn by an angle changes a matrix by a Frobenius norm of sqrt(8) times the sine of its half
    change = np.linalg.norm((dcm[after] - dcm[before]).reshape(-1, 9), axis=1) / np.sqrt(8.0)
    angle = 2.0 * np.arcsin(np.minimum(change, 1.0))
    return np.asarray(angle / ((time_ns[after] - time_ns[before]) * 1e-9))


def _spread(values: FloatArray) -> FloatArray:
    """Norm of the standard deviations within a window about each step; shape (g,)."""
    half = WINDOW // 2
    filled = np.nan_to_num(values - np.nanmedian(values, axis=0))
    out = np.full(len(values), np.nan)
    # Differences from a reference near the values, or a small spread would drown in rounding
    first = np.concatenate([np.zeros((1, 3)), np.cumsum(filled, axis=0)])
    second = np.concatenate([np.zeros((1, 3)), np.cumsum(filled**2, axis=0)])
    missing = np.concatenate([[0], np.cumsum(~np.isfinite(values).all(axis=1))])
    begin = np.arange(len(values) - WINDOW + 1)
    end = begin + WINDOW
    mean = (first[end] - first[begin]) / WINDOW
    variance = (second[end] - second[begin]) / WINDOW - mean**2
    spread = np.sqrt(np.maximum(variance, 0.0).sum(axis=1))
    spread[missing[end] > missing[begin]] = np.nan
    out[half : half + len(spread)] = spread
    return out


def _thresholds(spread: FloatArray, stands: BoolArray, moves: BoolArray) -> tuple[FloatArray, str]:
    """On both features, 0 where one tells nothing; and why."""
    standing, moving = np.count_nonzero(stands), np.count_nonzero(moves)
    if standing < LEAST_WINDOWS and moving < LEAST_WINDOWS:
        return np.zeros(2), "the fixes show neither rest nor motion"
    if standing < LEAST_WINDOWS:
        return (
            ALONE_MOVING * np.quantile(spread[moves], MOVING_QUANTILE, axis=0),
            "half of the smallest value in motion, as the fixes never stand still",
        )
    low = np.quantile(spread[stands], STANDING_QUANTILE, axis=0)
    if moving < LEAST_WINDOWS:
        return ALONE_STANDING * low, "twice the value at rest, as the fixes never move"
    high = np.quantile(spread[moves], MOVING_QUANTILE, axis=0)
    apart = high > LEAST_APART * low
    if not apart.any():
        return np.zeros(2), "standing and moving look alike to the IMU"
    reason = f"between {standing * STEP_NS * 1e-9:.0f} s of standing and"
    reason += f" {moving * STEP_NS * 1e-9:.0f} s of motion by the fixes"
    return np.where(apart, np.sqrt(low * high), 0.0), reason
