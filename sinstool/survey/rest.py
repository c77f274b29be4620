"""Rest according to the IMU, and whether GNSS contradicts it.

An IMU that shows nothing may rest or move steadily; GNSS tells the two apart, unless the receiver
has only begun to work and its fixes wander. A vehicle that moves goes on until the IMU feels it
stop: fixes that come to rest by themselves never moved.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sinstool.core.earth import horizontal_metres
from sinstool.core.finding import Finding
from sinstool.core.order_statistics import median
from sinstool.core.rotation import wrapped
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.methods.alignment.still import ACCEL_STEP, WINDOW_NS, StillSpan, Windows, span_of

# What moves faster than this by GNSS, or further by fixes alone, is not at rest, however still the
# IMU seems; nor beyond this many sigmas that the receiver states, or the assumed one, m.
MOVING_M_S = 1.0
MOVING_M = 30.0
SIGMAS = 4.0
UNKNOWN_SIGMA_M = 5.0  # of a fix without its own sigma
# What creeps: its velocity, of so many sigmas at least, stays even to this share from the span's
# beginning to its end, and its fixes go as far, and further than this, m.
CREEP_M_S, CREEP_SIGMAS, EVEN, CREEP_M = 0.15, 3.0, 0.3, 5.0
# Where the rest ends, it changes by more than this share.
STOPS = 0.5
# A span at the start or end of the log without epochs takes this many beside it, if the nearest is
# not further in time than this, s.
BESIDE, BESIDE_S = 10, 60.0
# Rests shorter than this do not show a bias, s.
REST_S = 2.0
# A lull with a much smaller rate denies a rest that is not so many times as long.
FAR_LONGER = 5.0
# Gyro biases change by less than this within a log, rad/s: chips by 0.03 deg/s for each kelvin.
BIAS_CHANGE = 0.0175
# Fixes this far apart show a speed, s.
APART_S = 5.0
# A rest continues after a knock of at most KNOCK_S that changed velocity, m/s, attitude, rad, and
# specific force, m/s^2, by no more than this, and moved the vehicle by no more than KNOCK_M, m: one
# that goes straight on from one rest to the next changes nothing else.
KNOCK_S, KNOCK_M_S, KNOCK_RAD, KNOCK_FORCE, KNOCK_M = 30.0, 0.5, 0.05, 0.15, 1.0
# Fixes at rest further than UNSETTLED_M, m, from where the vehicle stands, and further than noise
# takes one of them with the probability CHANCE, show that the receiver had not settled; then fixes
# further than noise takes them, and until a few seconds later, are left out. The second half of the
# rest shows where the vehicle stands, if it has LEAST_FIXES, of which at most the share MOST_FAR
# may be far.
UNSETTLED_M, CHANCE = 10.0, 0.01
LEAST_FIXES = 10
MOST_FAR = 0.1
# Rest at the beginning in which an engine shakes the IMU, s: its first fix comes within
# FIRST_FIX_S, fixes need MOVED_OFF_S to show that a motion has begun, and it lasts for
# LEAST_SHAKEN_S or longer. Means of ALIKE windows agree to SHAKEN_RATE, rad/s, and SHAKEN_FORCE,
# m/s^2, beside their noise. A vehicle that stands has velocities below STANDING_M_S and fixes,
# which wander by more than their sigmas, within STANDING_M of the others.
FIRST_FIX_S, MOVED_OFF_S, LEAST_SHAKEN_S = 5.0, 4.0, 10.0
ALIKE, SHAKEN_RATE, SHAKEN_FORCE = 4, 0.005, 0.15
STANDING_M_S, STANDING_M = 0.3, 3.0


def rest_end(lead_in: StillSpan, spans: tuple[StillSpan, ...], windows: Windows) -> int:
    """End of the rest at the beginning of a log, including knocks during it, ns.

    Parameters
    ----------
    spans : tuple of StillSpan
        In order.
    """
    end = lead_in
    seconds = np.diff(windows.start_ns, append=windows.start_ns[-1:]) / SECOND
    for span in spans:
        if span.start_ns < end.end_ns:
            continue
        between = (windows.start_ns >= end.end_ns) & (windows.start_ns < span.start_ns)
        step = seconds[between, None]
        gains = step * (windows.accel[between] - lead_in.accel)
        gained = gains.sum(axis=0)
        turned = (step * (windows.gyro[between] - lead_in.gyro)).sum(axis=0)
        if (
            step.sum() > KNOCK_S
            or np.linalg.norm(gained) > KNOCK_M_S
            or np.linalg.norm(turned) > KNOCK_RAD
            or np.linalg.norm(span.accel - lead_in.accel) > KNOCK_FORCE
            or _farthest(gains, step) > KNOCK_M
        ):
            break
        end = span
    return end.end_ns


def rests_across(
    spans: Iterable[StillSpan], begin_ns: int, end_ns: int, gyro_bias: np.ndarray
) -> bool:
    """Whether a vehicle rests on both sides of a gap, and has the same tilt there.

    Parameters
    ----------
    spans : iterable of StillSpan
        All of the log: some may be steady turns.
    gyro_bias : ndarray, shape (3,)
        rad/s, body axes.
    """
    # A span ends with the last whole window before the one in which samples end
    near, length = 3 * WINDOW_NS, (end_ns - begin_ns) / SECOND
    still = [s for s in spans if length * np.linalg.norm(s.gyro - gyro_bias) < KNOCK_RAD]
    before = [s for s in still if s.start_ns < begin_ns and s.end_ns > begin_ns - near]
    after = [s for s in still if s.end_ns > end_ns and s.start_ns < end_ns + near]
    return any(
        float(np.linalg.norm(one.accel - other.accel)) < ACCEL_STEP
        for one in before
        for other in after
    )


def _farthest(gains: np.ndarray, step: np.ndarray) -> float:
    """Distance that a vehicle goes between two rests, by the velocity gained in each window, m.

    What it seems to have gained when it rests again, it did not: an error that is taken to have
    grown evenly.
    """
    velocity = np.cumsum(gains, axis=0)
    if len(velocity):
        velocity -= velocity[-1] * np.cumsum(step, axis=0) / step.sum()
    away = np.linalg.norm(np.cumsum(velocity * step, axis=0), axis=1)
    return float(away.max(initial=0.0))


def shaken_rest(windows: Windows, gnss: GnssEpochs, first_ns: int) -> StillSpan | None:
    """The rest at the beginning of a log in which an engine shakes the IMU; None without one.

    The fixes stay in place, and so do the means of the IMU beside vibration. Neither is enough
    alone: fixes do not show how a vehicle rocks, and slow motion looks like rest to the IMU.

    Parameters
    ----------
    first_ns : int
        Time of the first sample.
    """
    fixes = gnss.rows(gnss.has_position & (gnss.time_ns >= first_ns))
    if len(fixes) < LEAST_FIXES or fixes.time_ns[0] > first_ns + FIRST_FIX_S * SECOND:
        return None
    stands = _stand(fixes)
    if not stands:
        return None
    # Fixes are few, and take some time to show that a vehicle has moved off
    last_ns = int(fixes.time_ns[stands - 1]) - round(MOVED_OFF_S * SECOND)
    end = int(np.searchsorted(windows.start_ns + WINDOW_NS, last_ns))
    end = _stay(windows, end)
    if not end or windows.start_ns[end - 1] - first_ns < LEAST_SHAKEN_S * SECOND:
        return None
    return span_of(windows, 0, end)


def _stand(fixes: GnssEpochs) -> int:
    """How many of the first fixes agree with the mean of those before them and show no speed."""
    north, east = _metres(fixes, slice(None))
    before = np.arange(1, len(fixes))
    off = np.zeros(len(fixes))
    off[1:] = np.hypot(
        north[1:] - np.cumsum(north)[:-1] / before, east[1:] - np.cumsum(east)[:-1] / before
    )
    sigma = np.nan_to_num(fixes.sigma_position_n[:, :2].max(axis=1), nan=UNKNOWN_SIGMA_M)
    moved = off > np.maximum(SIGMAS * np.minimum(sigma, UNKNOWN_SIGMA_M), STANDING_M)
    speed = np.hypot(fixes.velocity_n[:, 0], fixes.velocity_n[:, 1])
    noise = np.nan_to_num(fixes.sigma_velocity_n[:, :2].max(axis=1), nan=0.0)
    moved |= fixes.has_velocity & (speed > np.clip(SIGMAS * noise, STANDING_M_S, MOVING_M_S))
    count = int(np.argmax(moved)) if moved.any() else len(fixes)
    halves = (slice(0, count // 2), slice(count // 2, count))
    way = [median(values[halves[1]]) - median(values[halves[0]]) for values in (north, east)]
    # A vehicle that creeps stays within the noise of the next fix for long
    return count if count >= LEAST_FIXES and np.hypot(*way) < STANDING_M else 0


def _stay(windows: Windows, end: int) -> int:
    """How many of the first windows, up to `end`, have the mean of those before them."""
    rows = slice(0, end - end % ALIKE)
    count = windows.count[rows].reshape(-1, ALIKE).sum(axis=1)
    if len(count) < 2 or (np.diff(windows.start_ns[:end]) != WINDOW_NS).any():
        return 0
    stays = np.ones(len(count), np.bool_)
    # What is slower than vibration is motion: a multicopter may hover at one place
    for mean, fast, step in (
        (windows.gyro, windows.gyro_fast, SHAKEN_RATE),
        (windows.accel, windows.accel_fast, SHAKEN_FORCE),
    ):
        alike = mean[rows].reshape(-1, ALIKE, 3).mean(axis=1)
        noise = np.sqrt(np.nanmean(fast[rows].reshape(-1, ALIKE) ** 2, axis=1) / count)
        usual = np.cumsum(alike, axis=0)[:-1] / np.arange(1, len(alike))[:, None]
        off = np.linalg.norm(alike[1:] - usual, axis=1)
        stays[1:] &= off < step + SIGMAS * noise[1:] * np.sqrt(1.0 + 1.0 / np.arange(1, len(alike)))
    return ALIKE * int(len(stays) if stays.all() else np.argmin(stays))


def moving_at(gnss: GnssEpochs | None, start_ns: int, end_ns: int) -> float | None:
    """Speed that GNSS shows in a span of time, m/s; None where it shows no sure motion.

    Parameters
    ----------
    gnss : GnssEpochs or None
        Without epochs in the span, those before and after show motion by their distance; at the
        start and end of the log those on one side by their speed, if they are near in time.
    """
    if gnss is None:
        return None
    begin, end = np.searchsorted(gnss.time_ns, [start_ns, end_ns + 1])
    if end - begin < 2:
        between = begin > 0 and end < len(gnss)
        if not between and not _near(gnss, start_ns, end_ns):
            return None
        more = 1 if between else BESIDE
        begin, end = max(begin - more, 0), end + more
    inside = gnss.rows(slice(begin, end))
    fast = inside.rows(inside.has_velocity)
    if len(fast):
        least = max(MOVING_M_S, SIGMAS * _usual(fast.sigma_velocity_n, 0.0))
        if _usual_speed(fast) <= least:
            return creeping(inside)
        return float(median(np.linalg.norm(fast.velocity_n[:, :2], axis=1)))
    fixed = inside.rows(inside.has_position)
    if len(fixed) < 2:
        return None
    time = (fixed.time_ns - fixed.time_ns[0]) / SECOND
    ahead = np.searchsorted(time, np.minimum(time + APART_S, time[-1]))
    begin = np.flatnonzero(ahead > np.arange(len(time)))
    north, east = _metres(fixed, begin)
    step = time[ahead[begin]] - time[begin]
    far = _metres(fixed, ahead[begin])
    way = np.stack([far[0] - north, far[1] - east])
    speed = float(np.linalg.norm(median(way / step, axis=1)))
    noise = SIGMAS * _usual(fixed.sigma_position_n, UNKNOWN_SIGMA_M)
    if speed * float(time[-1]) > max(MOVING_M, noise) and speed > MOVING_M_S:
        return speed
    # What moves in a circle returns to its start, but not within seconds
    apart = float(median(np.linalg.norm(way, axis=0)))
    return apart / APART_S if apart > max(MOVING_M, 2.0 * noise) else None


def creeping(gnss: GnssEpochs) -> float | None:
    """Speed of what creeps on at an even speed, m/s; None where epochs do not show that.

    Velocities of a receiver that settles, or wanders, end by themselves, or its fixes do not go
    where they point.
    """
    both = gnss.rows(gnss.has_velocity & gnss.has_position)
    if len(both) < LEAST_FIXES:
        return None
    seconds = (both.time_ns - both.time_ns[0]) / SECOND
    pieces = _pieces(both)
    if len(pieces) < 2:
        return None
    speeds = np.linalg.norm(pieces, axis=1)
    usual = float(median(speeds))
    least = max(CREEP_M_S, CREEP_SIGMAS * _usual(both.sigma_velocity_n, 0.0))
    if not usual > least or np.abs(speeds - usual).max() > EVEN * usual:
        return None
    step = np.diff(seconds, prepend=0.0)[:, None]
    gone = np.cumsum(both.velocity_n[:, :2] * step, axis=0)
    fixed = np.column_stack(_metres(both, slice(None)))
    gone, fixed = gone - gone.mean(axis=0), fixed - fixed.mean(axis=0)
    way = float(np.ptp(gone, axis=0).max())
    if way < max(CREEP_M, SIGMAS * _usual(both.sigma_position_n, UNKNOWN_SIGMA_M)):
        return None
    share = float(np.sum(gone * fixed) / np.sum(gone * gone))
    left = float(np.sum((fixed - share * gone) ** 2) / np.sum(fixed * fixed))
    return usual if abs(share - 1.0) < EVEN and left < EVEN**2 else None


def crept(gnss: GnssEpochs, start_ns: int, end_ns: int) -> float | None:
    """Speed of what creeps until its apparent rest ends, m/s; None where epochs do not show that.

    Its velocity changes with the jolt that ends the rest. That of a receiver that has not settled
    goes on, and ends where no IMU feels it.
    """
    times, end_ns = gnss.time_ns, end_ns - SECOND  # it may brake gently at first
    speed = creeping(gnss.rows((times >= start_ns) & (times <= end_ns)))
    if speed is None:
        return None
    apart_ns = round(APART_S * SECOND)
    velocities = [
        gnss.velocity_n[(times > at) & (times <= at + apart_ns) & gnss.has_velocity, :2]
        for at in (end_ns - apart_ns, end_ns)
    ]
    if not all(len(part) for part in velocities):
        return None
    before, after = (median(part, axis=0) for part in velocities)
    return speed if np.linalg.norm(after - before) > STOPS * speed else None


def _usual_speed(gnss: GnssEpochs) -> float:
    """Median horizontal speed of the medians of velocity over `APART_S`, m/s.

    They have less noise than single velocities, and wild ones are not in them; that of a vehicle in
    a circle keeps its speed.
    """
    return float(median(np.linalg.norm(_pieces(gnss), axis=1)))


def _pieces(gnss: GnssEpochs) -> np.ndarray:
    """Medians of horizontal velocity over `APART_S`, m/s, shape (n, 2)."""
    piece = (gnss.time_ns - gnss.time_ns[0]) // round(APART_S * SECOND)
    pieces = np.split(gnss.velocity_n[:, :2], np.flatnonzero(np.diff(piece)) + 1)
    return np.array([median(part, axis=0) for part in pieces])


def _near(gnss: GnssEpochs, start_ns: int, end_ns: int) -> bool:
    """Whether the last epoch before a span, or the first after it, is near in time."""
    apart = max(start_ns - int(gnss.time_ns[-1]), int(gnss.time_ns[0]) - end_ns)
    return apart <= BESIDE_S * SECOND


def longest_rest(spans: Iterable[StillSpan], gnss: GnssEpochs | None) -> StillSpan | None:
    """The longest rest, of `REST_S` at least, at which GNSS does not move; None without one.

    Steady turns look like rest, too, but of two rates so different only one is the gyros' bias:
    the smaller. So do lulls of a slow motion, which are no rests unless epochs cover them.
    """
    long = [span for span in spans if span.duration_s >= REST_S]
    # The longest first, as testing a span for motion takes time
    for span in sorted(long, key=lambda span: -span.duration_s):
        covered = _covered(span, gnss)
        if span.lull and not covered:
            continue
        if moving_at(gnss, span.start_ns, span.end_ns) is None:
            less = calmer(long, span)
            found = longest_rest(less, gnss)
            denied = any(one.lull and one.duration_s * FAR_LONGER > span.duration_s for one in less)
            if found is not None or covered or not denied:
                return found or span
    return None


def _covered(span: StillSpan, gnss: GnssEpochs | None) -> bool:
    """Whether GNSS has epochs in a span that show rest or motion."""
    if gnss is None:
        return False
    begin, end = np.searchsorted(gnss.time_ns, [span.start_ns, span.end_ns + 1])
    return bool(end - begin >= 2)


def calmer(spans: Iterable[StillSpan], than: StillSpan) -> list[StillSpan]:
    """Spans of `REST_S` at least whose rate is smaller by more than a bias changes within a log."""
    rate = float(np.linalg.norm(than.gyro))
    most = min(rate - BIAS_CHANGE, 0.5 * rate)
    return [
        span for span in spans if span.duration_s >= REST_S and np.linalg.norm(span.gyro) < most
    ]


def settled(gnss: GnssEpochs, start_ns: int, end_ns: int) -> tuple[GnssEpochs, list[Finding]]:
    """GNSS without the fixes from before the receiver settled.

    Parameters
    ----------
    start_ns, end_ns : int
        Of the rest at the beginning, in which GNSS shows no motion.
    """
    resting = (gnss.time_ns >= start_ns) & (gnss.time_ns <= end_ns)
    late = resting & gnss.has_position & (gnss.time_ns >= (start_ns + end_ns) // 2)
    if np.count_nonzero(late) < LEAST_FIXES:
        return gnss, []
    north, east = _metres(gnss, slice(None))
    off = np.hypot(north - median(north[late]), east - median(east[late]))
    sigma = np.nan_to_num(gnss.sigma_position_n[:, :2].max(axis=1), nan=UNKNOWN_SIGMA_M)
    # The distance of the farthest of so many by chance, of two axes with the same sigma
    beyond = max(SIGMAS, np.sqrt(2.0 * np.log(np.count_nonzero(resting) / CHANCE)))
    usual = float(np.sqrt(median(off[late] ** 2) / (2.0 * np.log(2.0))))
    noise = beyond * np.maximum(usual, sigma)
    far = off > np.maximum(UNSETTLED_M, noise)
    wrong = resting & ~late & far
    # A receiver that is wrong until the end has not settled at all
    if not wrong.any() or np.mean(far[late]) > MOST_FAR:
        return gnss, []
    # It comes slowly near what it keeps to later
    wrong |= resting & ~late & (off > noise)
    last = gnss.time_ns[np.flatnonzero(wrong)[-1]] + round(APART_S * SECOND)
    # Nor had it before the first sample
    wrong = gnss.time_ns <= last
    text = (
        f"{np.count_nonzero(wrong)} fixes up to {(last - start_ns) / SECOND:.1f} s, as far as"
        f" {np.nanmax(off[wrong]):.0f} m from where the vehicle rests, are left out: the receiver"
        " had not settled"
    )
    return gnss.rows(~wrong), [
        Finding("unsettled-fixes", text, start_ns=start_ns, end_ns=int(last))
    ]


def _metres(gnss: GnssEpochs, rows: slice | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """North and east of the first fix, m."""
    first = int(np.argmax(gnss.has_position))
    return horizontal_metres(
        gnss.latitude[rows] - gnss.latitude[first],
        wrapped(gnss.longitude[rows] - gnss.longitude[first]),
        gnss.latitude[first],
    )


def _usual(sigma_n: np.ndarray, unknown: float) -> float:
    """Median horizontal standard deviation."""
    level = sigma_n[:, :2].max(axis=1)
    stated = np.isfinite(level)
    return float(median(level[stated])) if stated.any() else unknown
