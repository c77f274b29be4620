"""Velocities derived from a receiver's positions, and the lag of its own velocities.

A filter uses positions as they are: velocities derived from them would count them twice. But an
attitude in motion is found from changes of velocity, and a receiver may give none: velocities from
positions are good enough for a start, and for nothing else.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.chi_square import MEDIAN_SQUARE
from sinstool.core.earth import horizontal_metres
from sinstool.core.monotone_cubic import integral
from sinstool.core.order_statistics import median
from sinstool.core.parts import kernel
from sinstool.core.rotation import wrapped
from sinstool.core.streams import DerivedEpochs, GnssEpochs, concatenate
from sinstool.core.timeline import SECOND, longest_part
from sinstool.methods.ins_gnss.latency import NOT_OBSERVABLE, Latency, correlate

# A parabola is fitted to the fixes within so many seconds before and after; within the shortest of
# these times that gives velocity to this sigma, m/s, as accelerations that a parabola does not
# follow have an effect that grows with the square of the time.
SHORTEST_S, LONGEST_S = 1.0, 4.0
TARGET = 0.15
LEAST = 5
LEAST_SIGMA = 0.02
# A fix is an outlier if it is off the line between its neighbours by this many times the usual
# distance, and by more than a turn or braking explains, m/s^2.
OUTLYING, MOST_TURN, OUTLIER_ROUNDS = 15.0, 20.0, 5
LEAST_FIXES = 40
# Beside an inertial navigation only its errors count: m/s^2 of a wrong attitude, and the change of
# speed by a turn while fixes are this much older than assumed, s; not across longer gaps, s.
LEANT, LATE_S, LONGEST_GAP_S = 5.0, 0.25, 5.0
# Where the residuals of a parabola are larger than noise, its slope is off by so many times the
# excess over half its length: by a bend that it does not follow, or, beside an IMU whose motion is
# smoothed in the same way, by noise alone.
BENT, NOISY = 4.0, 1.0
# A sigma of so many times the usual one belongs to a fix with an error that lasts.
WORSE = 3.0
# A lag of this many sigmas is not observable unless it lowers the sum of squares by this, in units
# of the noise: repetitive motion leads to a lag of an interval, which lowers it by up to 35.
LAG_SIGMAS, LEAST_CONTRAST = 5.0, 50.0
# A short and a long time, s, over which the noise of velocities is compared; the fixes must hold so
# many of the long ones.
BOUND_S, LEAST_LONG = (2.0, 20.0), 4.0
# Fixes at a time: a row of each takes half a kilobyte
BLOCK = 2**14


def with_velocities(
    gnss: GnssEpochs, sigma_m: float, wander: float | None = None, ends: bool = False
) -> DerivedEpochs:
    """Epochs with velocities derived from their positions.

    Parameters
    ----------
    gnss : GnssEpochs
        By time.
    sigma_m : float
        Noise of a position from one fix to the next, m.
    wander : float, optional
        Change of a slowly varying error of positions within a second, m. With it the sigmas are
        those for an alignment that follows the motion as `derived_s` says, and takes the noise of
        velocities for white: velocities within half a window are from the same fixes, and count as
        one.
    ends : bool
        The first and last fixes, too, where windows about them hold too few.

    Returns
    -------
    DerivedEpochs
        Those with enough fixes around them. The sigmas of velocities follow from `sigma_m`, and
        from the excess of residuals over it, which counts as a third derivative: four times their
        rms over half the window's length (once with `wander`); with `ends` four times as much at
        the ends of one. Beside fixes without height the vertical velocity is that between the
        others, as uncertain as it is large elsewhere.
    """
    # One that is far off would spoil the velocities of all around it
    rows = gnss.rows(gnss.has_position & ~worse_than_usual(gnss))
    rows = rows.rows(~outlying(rows))
    n = len(rows)
    flat = ~np.isfinite(rows.height)
    if n - np.count_nonzero(flat) < LEAST:
        return DerivedEpochs(**vars(rows), derived_s=np.zeros(n)).rows(slice(0, 0))
    t = (rows.time_ns - rows.time_ns[0]) / SECOND
    heights = _with_all(t, rows.height)
    height = float(median(rows.height[~flat]))
    longitude = np.unwrap(rows.longitude)
    north, east = horizontal_metres(
        rows.latitude - rows.latitude[0], longitude - longitude[0], rows.latitude[0], height
    )
    position = np.stack([north, east, heights[0] - heights], axis=1)
    half = half_width(t, sigma_m)
    velocity, sigma, good = np.empty((n, 3)), np.empty((n, 3)), np.empty(n, np.bool_)
    over = np.empty(n)
    short = 0.5 * (LEAST - 1) * float(median(np.diff(t)))
    middle = np.clip(t, short, max(t[-1] - short, short)) if ends and short > 0.5 * half else t
    for begin in range(0, n, BLOCK):
        here = np.arange(begin, min(begin + BLOCK, n))
        velocity[here], sigma[here], over[here], good[here] = _slopes(
            t, position, middle, here, half, sigma_m, BENT if wander is None else NOISY
        )
    if wander is not None:
        sigma = np.sqrt(sigma**2 + _shared(t, half, sigma_m, wander))
    counts = np.append(0, np.cumsum(flat))
    first, after = np.searchsorted(t, t - half), np.searchsorted(t, t + half, "right")
    beside = counts[after] > counts[first]
    whole = good & ~beside
    if beside.any():
        good &= ~beside | whole.any()
        climb = float(np.sqrt(np.mean(velocity[whole, 2] ** 2))) if whole.any() else np.inf
        sigma[beside, 2] = np.hypot(sigma[beside, 2], climb)
    columns = {**vars(rows), "velocity_n": velocity, "sigma_velocity_n": sigma}
    return DerivedEpochs(**columns, derived_s=over).rows(good)


def worse_than_usual(gnss: GnssEpochs) -> BoolArray:
    """Positions that the receiver states to be far worse than most of the log, shape (n,)."""
    sigma = gnss.sigma_position_n
    stated = np.isfinite(sigma).all(axis=1)
    if not stated.any():
        return np.zeros(len(gnss), dtype=np.bool_)
    usual = median(sigma[stated], axis=0)
    return np.asarray(stated & (sigma > WORSE * usual).any(axis=1))


def outlying(gnss: GnssEpochs) -> BoolArray:
    """Positions far off the line between their neighbours, shape (n,), whatever a filter expects.

    Without a gate, a fix that is a thousand sigmas away would ruin a filter. Fixes of a vehicle
    that turns or brakes are off the line too, but no further than it can accelerate. Of several in
    a row the farthest is the outlier, and the others are its neighbours.
    """
    rows = np.flatnonzero(gnss.has_position)
    bad = np.zeros(len(gnss), dtype=np.bool_)
    if len(rows) < LEAST_FIXES:
        return bad
    seconds, place = track_of(gnss.rows(rows))
    bad[rows] = _off_their_neighbours(seconds, place, stated_sigma(gnss.rows(rows)), MOST_TURN, 0.0)
    return bad


def outlying_innovations(time_ns: IntArray, innovation: FloatArray, stated_m: float) -> BoolArray:
    """Fixes whose innovations are far off those of their neighbours, shape (n,).

    Between fixes an inertial navigation tells a turn from a bad fix, so that less shows than by the
    positions alone. Its own errors hardly change from one fix to the next.

    Parameters
    ----------
    time_ns : ndarray of int64, shape (n,)
    innovation : ndarray, shape (n, 3)
        Of positions, NED, m, by a filter that hardly follows them; NaN where there is none.
    stated_m : float
        Usual stated sigma of a horizontal axis, m.
    """
    rows = np.flatnonzero(np.isfinite(innovation).all(axis=1))
    bad = np.zeros(len(time_ns), dtype=np.bool_)
    if len(rows) < LEAST_FIXES:
        return bad
    seconds = (time_ns[rows] - time_ns[0]) * 1e-9
    far = _off_their_neighbours(seconds, innovation[rows], stated_m, LEANT, LATE_S * MOST_TURN)
    steps = np.diff(seconds, prepend=-np.inf, append=np.inf)
    bad[rows] = far & (np.maximum(steps[:-1], steps[1:]) < LONGEST_GAP_S)
    return bad


def _off_their_neighbours(
    seconds: FloatArray, place: FloatArray, stated_m: float, turn: float, late: float
) -> BoolArray:
    """Places, (n, 3), m, off the line between those before and after by more than is possible.

    Parameters
    ----------
    turn, late : float
        Accelerations, m/s^2, and changes of speed, m/s, that move a place off that line.
    """
    bad = np.zeros(len(seconds), dtype=np.bool_)
    # Outliers one after the other leave one at a time
    for _ in range(OUTLIER_ROUNDS):
        at = np.flatnonzero(~bad)
        if len(at) < LEAST_FIXES:
            break
        steps = np.diff(seconds[at])
        before, after = steps[:-1], steps[1:]
        here = place[at]
        part = (before / (before + after))[:, None]
        off = np.linalg.norm(here[1:-1] - (1.0 - part) * here[:-2] - part * here[2:], axis=1)
        around = np.concatenate([[0.0], off, [0.0]])
        usual = OUTLYING * max(float(median(off)), stated_m)
        limit = usual + 0.5 * turn * before * after + late * np.minimum(before, after)
        peak = (off >= around[:-2]) & (off >= around[2:]) & (off > limit)
        if not peak.any():
            break
        bad[at[1:-1][peak]] = True
    return bad


def track_of(gnss: GnssEpochs) -> tuple[FloatArray, FloatArray]:
    """Seconds, shape (n,), and places, shape (n, 3): north, east, m, from the first, and height.

    Metres are counted along the way, as integrals of velocities are: where a vehicle goes far, and
    near the poles even a few kilometres, those from the first place turn away from north.
    """
    seconds = (gnss.time_ns - gnss.time_ns[0]) * 1e-9
    height = _with_all(seconds, gnss.height)
    steps = horizontal_metres(
        np.diff(gnss.latitude),
        wrapped(np.diff(gnss.longitude)),
        0.5 * (gnss.latitude[1:] + gnss.latitude[:-1]),
        0.5 * (height[1:] + height[:-1]),
    )
    north, east = (np.append(0.0, np.cumsum(step)) for step in steps)
    return seconds, np.stack([north, east, height], axis=1)


def _with_all(seconds: FloatArray, height: FloatArray) -> FloatArray:
    """Heights, those that are missing from the ones around them, shape (n,); 0 if all are."""
    known = np.isfinite(height)
    return (
        np.interp(seconds, seconds[known], height[known]) if known.any() else np.zeros(len(height))
    )


def stated_sigma(gnss: GnssEpochs) -> float:
    """Usual stated sigma of a horizontal axis of positions, m; 0 if none is stated."""
    sigma = gnss.sigma_position_n[:, :2]
    return float(median(sigma[np.isfinite(sigma)])) if np.isfinite(sigma).any() else 0.0


def _slopes(
    t: np.ndarray,
    position: np.ndarray,
    middle: np.ndarray,
    here: np.ndarray,
    half: float,
    sigma_m: float,
    excess: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Slopes of the parabolas at some of the fixes, their sigmas, `derived_s`, and which are good.

    Parameters
    ----------
    middle : ndarray, shape (n,)
        Times about which the windows of all fixes lie.
    excess : float
        By how much the excess of the residuals counts, over half the window.
    """
    size = len(here)
    moments, right = np.zeros((size, 5)), np.zeros((size, 3, 3))
    squares, ends = np.zeros((size, 3)), np.zeros((size, 2))
    _sums(t, position, middle, int(here[0]), half, moments, right, squares, ends)
    count = moments[:, 0]
    normal = moments[:, np.arange(3)[:, None] + np.arange(3)[None, :]]
    spread = moments[:, 2] > 0.25 * half**2 * LEAST / 3.0
    sure = normal + 1e-12 * np.eye(3)
    condition = _size(sure) * _size(np.linalg.inv(sure))
    good = (count >= LEAST) & spread & (condition < 1e8)
    normal[~good] = np.eye(3)
    inverse = np.linalg.inv(normal)
    fitted = inverse @ right
    left = squares - np.einsum("kpi,kpi->ki", fitted, right)
    # Twice what noise leaves is still noise
    bent = np.maximum(left - 2.0 * sigma_m**2 * np.maximum(count - 3.0, 1.0)[:, None], 0.0)
    bend = excess * np.sqrt(bent / np.maximum(count, 1.0)[:, None])
    reached = np.abs(ends).max(axis=1)
    bend /= np.where(reached > 0.0, reached, 1.0)[:, None]
    aside = middle[here] != t[here]
    # Of a third derivative the slope misses the more, the nearer to an end of the window
    long, off = 0.5 * (ends[aside, 1] - ends[aside, 0]), 0.5 * (ends[aside, 1] + ends[aside, 0])
    more = np.maximum(1.0, 5.0 * (off / np.maximum(long, 1e-9)) ** 2 - 1.0)
    bend[aside] *= (more * reached[aside] / np.maximum(long, 1e-9))[:, None]
    sigma = np.hypot(sigma_m * np.sqrt(np.abs(inverse[:, 1, 1]))[:, None], bend)
    # A third derivative adds to the slope what it does with fixes at all times of this window
    over = np.sqrt(moments[:, 4] / (0.6 * np.where(good, moments[:, 2], 1.0)))
    return fitted[:, 1], np.maximum(sigma, LEAST_SIGMA), over, good


def _size(matrices: np.ndarray) -> np.ndarray:
    """Norm of Frobenius of each."""
    return np.asarray(np.sqrt(np.einsum("kij,kij->k", matrices, matrices)))


@kernel()
def _sums(
    t: FloatArray,
    position: FloatArray,
    middle: FloatArray,
    first: int,
    half: float,
    moments: FloatArray,
    right: FloatArray,
    squares: FloatArray,
    ends: FloatArray,
) -> None:
    """Sums over the fixes about each, for parabolas through them.

    Parameters
    ----------
    middle : ndarray, shape (n,)
        The middle of the window of each, s.
    first : int
        The fix of row 0.
    half : float
        How far before and after, s.
    moments : ndarray, shape (k, 5)
        Zeros; set to the sums of the powers of their times from that of the fix.
    right : ndarray, shape (k, 3, 3)
        Zeros; set to those of power by way.
    squares : ndarray, shape (k, 3)
        Zeros; set to those of the squares of the ways.
    ends : ndarray, shape (k, 2)
        Zeros; set to the first and last of their times from that of the fix.
    """
    for i in range(len(ends)):
        own = first + i
        about = middle[own]
        begin = own
        while begin > 0 and about - t[begin - 1] <= half:
            begin -= 1
        for j in range(begin, len(t)):
            if t[j] - about > half:
                break
            away = t[j] - t[own]
            power = 1.0
            for p in range(5):
                moments[i, p] += power
                if p < 3:
                    for axis in range(3):
                        right[i, p, axis] += power * (position[j, axis] - position[own, axis])
                power *= away
            for axis in range(3):
                squares[i, axis] += (position[j, axis] - position[own, axis]) ** 2
            ends[i, 0] = min(ends[i, 0], away)
            ends[i, 1] = max(ends[i, 1], away)


def half_width(seconds: np.ndarray, sigma_m: float) -> float:
    """Half of the window, s: of N fixes over T, velocity is good to sigma sqrt(12/N)/T."""
    usual = float(median(np.diff(seconds)))
    half = 0.5 * np.cbrt(12.0 * sigma_m**2 * usual / TARGET**2)
    return float(max(np.clip(half, SHORTEST_S, LONGEST_S), 0.5 * LEAST * usual))


def _shared(seconds: np.ndarray, half: float, sigma_m: float, wander: float) -> float:
    """What neighbouring velocities have in common, as a variance of white noise of each, m^2/s^2.

    Of the noise of positions all but their own part of it; and the mean of what a slowly varying
    error changes by within half a window.
    """
    many = max(half / float(median(np.diff(seconds))), 1.0)
    noise = 12.0 * sigma_m**2 / ((2.0 * many + 1.0) * (2.0 * half) ** 2)
    return (many - 1.0) * noise + many * wander**2 / half


def velocity_lag(gnss: GnssEpochs) -> Latency:
    """Delay of a receiver's velocities relative to its positions.

    Some receivers difference positions, or average the Doppler shift over the interval that ends at
    the fix: their velocity is that of half an interval before. The delay is found from the fixes
    alone, by shifting positions against the integral of the velocities.

    Returns
    -------
    Latency
        Positive if velocities are late. Not observable if no lag explains the fixes about as well:
        steps of a walk, or swings, may look alike an interval later.
    """
    fixes = gnss.rows(gnss.has_position & gnss.has_velocity)
    fixes = fixes.rows(longest_part(fixes.time_ns))
    if len(fixes) < 20:
        return NOT_OBSERVABLE
    t = (fixes.time_ns - fixes.time_ns[0]) * 1e-9
    usual = float(median(np.diff(t)))
    span = min(2.0 * usual, 1.0)
    # Down is often known worse than it moves
    fine = np.arange(0.0, t[-1], min(0.02, 0.1 * usual))
    travelled = np.column_stack([integral(t, fixes.velocity_n[:, :2], fine), np.zeros_like(fine)])
    longitude = np.unwrap(fixes.longitude)
    north, east = horizontal_metres(
        fixes.latitude - fixes.latitude[0], longitude - longitude[0], fixes.latitude[0]
    )
    position = np.column_stack([north, east, np.full(len(fixes), np.nan)])
    times = fixes.time_ns[0] + np.round(fine * 1e9).astype(np.int64)
    late = correlate(times, travelled, fixes.time_ns, position, -span, span)
    if late.differs_from(0.0, 0.0, LAG_SIGMAS) and late.contrast < LEAST_CONTRAST:
        return NOT_OBSERVABLE
    return replace(late, latency_s=-late.latency_s)


def velocity_noise_bound(gnss: GnssEpochs) -> float:
    """Largest white noise of velocities that is possible beside the receiver's own positions.

    Positions less the integral of the velocities wander, as the noise of the velocities adds up:
    their variance grows by the velocities' variance times interval and time. The white noise of the
    positions adds the same variance after a short and a long time.

    Returns
    -------
    float
        Of one horizontal axis, m/s; too large if the positions themselves wander. NaN if there are
        fewer than `LEAST_LONG` of the long times.
    """
    fixes = gnss.rows(gnss.has_position & gnss.has_velocity)
    if len(fixes) < LEAST:
        return np.nan
    t = (fixes.time_ns - fixes.time_ns[0]) / SECOND
    interval = float(median(np.diff(t)))
    longitude = np.unwrap(fixes.longitude)
    north, east = horizontal_metres(
        fixes.latitude - fixes.latitude[0], longitude - longitude[0], fixes.latitude[0]
    )
    off = np.stack([north, east], axis=1) - integral(t, fixes.velocity_n[:, :2], t)
    # An outage in between says nothing of the velocities
    piece = np.concatenate([[0], np.cumsum(np.diff(t) > 1.5 * interval)])
    spread, steps = [], []
    for seconds in BOUND_S:
        many = max(1, round(seconds / interval))
        whole = piece[many:] == piece[:-many]
        if np.count_nonzero(whole) * interval < LEAST_LONG * seconds:
            return np.nan
        square = np.square(off[many:] - off[:-many])[whole]
        spread.append(float(median(square)) / MEDIAN_SQUARE)
        steps.append(many)
    # By chance a variance of so many independent times may be this much too small
    chance = 1.0 + 2.0 * np.sqrt(2.0 * BOUND_S[1] / (len(off) * interval))
    grown = max(chance * spread[1] - spread[0], 0.0) / (steps[1] - steps[0])
    return float(np.sqrt(grown) / interval)


def split_position_velocity(gnss: GnssEpochs, velocity_lag_s: float) -> GnssEpochs:
    """Epochs whose positions and velocities have rows of their own, half a lag to either side.

    Parameters
    ----------
    velocity_lag_s : float
        See :func:`velocity_lag`; with 0 the epochs are unchanged.

    Returns
    -------
    GnssEpochs
        By time, all of them valid the same latency before their stamps.
    """
    if velocity_lag_s == 0.0:
        return gnss
    lag, half = round(velocity_lag_s * SECOND), round(0.5 * velocity_lag_s * SECOND)
    nothing, triple = np.full(len(gnss), np.nan), np.full((len(gnss), 3), np.nan)
    positions = replace(
        gnss, time_ns=gnss.time_ns + half, velocity_n=triple, sigma_velocity_n=triple
    )
    velocities = replace(
        gnss,
        time_ns=gnss.time_ns - lag + half,
        latitude=nothing,
        longitude=nothing,
        height=nothing,
        sigma_position_n=triple,
    )
    both = concatenate([positions.rows(gnss.has_position), velocities.rows(gnss.has_velocity)])
    return both.rows(np.argsort(both.time_ns, kind="stable"))


def message_times(gnss: GnssEpochs, velocity_lag_s: float) -> IntArray:
    """Stamps of the messages that epochs of :func:`split_position_velocity` come from, ns."""
    lag, half = round(velocity_lag_s * SECOND), round(0.5 * velocity_lag_s * SECOND)
    return np.asarray(gnss.time_ns - half + np.where(gnss.has_position, 0, lag))
