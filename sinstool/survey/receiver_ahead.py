"""Stamps of a receiver that are seconds off those of the IMU, by the turns of both.

A vehicle that follows its nose has a course over ground that differs from the angle which the gyro
turned about the vertical by a constant, for a while, but only at the right times. The scatter of
that difference is circular, so a vehicle may turn by any angle between two fixes.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sinstool.config import InputOptions
from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.earth import horizontal_metres
from sinstool.core.finding import Finding
from sinstool.core.order_statistics import SIGMA_PER_MAD
from sinstool.core.rotation import wrapped
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.methods.alignment.still import Windows
from sinstool.survey.course import Turns

RECEIVER_CLOCK = "receiver-clock"
# An offset that would be smaller than this, s, is none.
LEAST_OFFSET_S = 0.05
# Offsets of at most so many s are tried, in steps of so many. Less than LATENCY_S is a latency,
# and less than LEAST_S may be the time by which the course of a hull follows its nose.
FARTHEST_S, FINE_S, LATENCY_S, LEAST_S = 60.0, 0.5, 1.0, 3.0
# Courses are taken over the first of these steps, s, in most of which the vehicle moves.
STEPS_S = (2.0, 4.0)
# It moves at more than this, m/s, and by more than so many times the noise of a fix.
SLOWEST, TIMES_NOISE = 0.1, 5.0
# The difference of course and gyro may be another one after this, s.
SAME_S = 20.0
# Fewest courses of such a time, and of the log.
LEAST_TOGETHER, LEAST_COURSES = 3, 20
# Biases of the gyro about the vertical that are tried, rad/s: up to three times this, and none.
BIAS = 0.01
# The courses follow the gyro if their circular variance about it is below this, and an offset is
# clear if the variance as stamped is so many times as large, and so are that of all offsets
# elsewhere and that of the courses alone. Elsewhere is further off than this, s.
FOLLOWS, BETTER, CLEARLY, ELSEWHERE_S = 0.1, 1.7, 3.0, 7.0
# A few turns that have nothing to do with the gyro's fit some of them at one offset or another, but
# hardly so much better than elsewhere. Where it is less, each of so many parts of the log, in which
# the course turns equally far, must fit best at the same offset by itself, to so many s. It has so
# many courses at least.
BEYOND_CHANCE, PARTS, ALIKE_S, LEAST_OF_PART = 25.0, 3, 1.5, 5


def two_clocks(text: str, ahead: float, options: InputOptions, topic: str) -> Finding:
    """A finding about a receiver whose clock is ahead by some seconds, with the option for it."""
    offset = options.gnss_clock_offset + ahead  # the stamps had the one given taken off
    answer = f"give --gnss-clock-offset {offset:.1f}"
    if abs(offset) < LEAST_OFFSET_S:
        answer = "leave --gnss-clock-offset out"
    return Finding(RECEIVER_CLOCK, text, answer=answer, topic=topic, numbers={"ahead_s": ahead})


def turns_apart(ahead: float, options: InputOptions, topic: str) -> Finding:
    """A finding about a receiver whose clock is ahead by some seconds, as turns show.

    Parameters
    ----------
    options : InputOptions
        Their clock offset has been subtracted from the stamps.
    topic : str
        Of the IMU.
    """
    shown = f"{abs(ahead):.1f} s {'ahead of' if ahead > 0.0 else 'behind'}"
    text = (
        "the course over ground turns with the gyro only if the stamps of the fixes are"
        f" {shown} those of the IMU: two clocks"
    )
    return two_clocks(text, ahead, options, topic)


def receiver_ahead(windows: Windows, gnss: GnssEpochs | None) -> float | None:
    """How far a receiver's stamps are ahead of the IMU's, by the turns of both, s.

    Returns
    -------
    float or None
        To a fraction of a second; 0 if the turns clearly fit as stamped; None if no offset explains
        them clearly better than all others.
    """
    turns = Turns.of(windows)
    if gnss is None or turns is None or len(gnss) < LEAST_COURSES:
        return None
    times, course = _courses(gnss)
    if len(times) < LEAST_COURSES:
        return None
    offsets = FINE_S * np.arange(-round(FARTHEST_S / FINE_S), round(FARTHEST_S / FINE_S) + 1)
    anywhere = np.array([_variance(turns, times, course, offset) for offset in offsets])
    best = float(offsets[np.argmin(anywhere)])
    # The same courses about the best and as stamped: single ones may be false
    about = best + ELSEWHERE_S * np.arange(-1, 2)
    same = np.all([turns.spans(times - round(x * SECOND)) for x in (0.0, *about)], axis=0)
    times, course = times[same], course[same]
    if len(times) < LEAST_COURSES:
        return None
    before, least, after = (_variance(turns, times, course, offset) for offset in about)
    alone = _variance(None, times, course, 0.0)
    elsewhere = anywhere[np.abs(offsets - best) > ELSEWHERE_S].min()
    other = min(alone, before, after, elsewhere)
    if not least < FOLLOWS or other < CLEARLY * least:
        return None
    parts = () if other > BEYOND_CHANCE * least else _parts(turns, times, course, offsets)
    if any(abs(part - best) > ALIKE_S for part in parts):
        return None
    if abs(best) < LEAST_S:
        return 0.0
    near = offsets[np.abs(offsets) < LATENCY_S]
    if min(_variance(turns, times, course, offset) for offset in near) < BETTER * least:
        return None
    beside = best + FINE_S * np.arange(-1, 2)
    return best + _vertex([_variance(turns, times, course, offset) for offset in beside])


def _parts(
    turns: Turns, times: IntArray, course: FloatArray, offsets: np.ndarray
) -> Iterator[float]:
    """Offset at which each part of the log fits best, s; infinite where it has too few courses."""
    turned = np.cumsum(np.abs(wrapped(np.diff(course, prepend=course[0]))))
    edges = np.searchsorted(turned, turned[-1] * np.arange(1, PARTS) / PARTS)
    for rows in np.split(np.arange(len(times)), edges):
        part = times[rows], course[rows]
        if len(rows) < LEAST_OF_PART:
            yield np.inf
            continue
        fits = [_variance(turns, *part, offset, LEAST_OF_PART) for offset in offsets]
        yield float(offsets[np.argmin(fits)])


def _variance(
    turns: Turns | None,
    times: IntArray,
    course: FloatArray,
    offset: float,
    least: int = LEAST_COURSES,
) -> float:
    """Circular variance of courses about the gyro's angle, or about a constant without turns.

    Parameters
    ----------
    least : int
        Fewest courses.

    Returns
    -------
    float
        0 if they follow it, 1 if they do not; infinite if too few of them lie within its time.
    """
    since_ns, gap = times - times[0], np.zeros(len(times), np.int64)
    follows = np.exp(1j * course)[None, :]
    if turns is not None:
        at_ns = times - round(offset * SECOND)
        inside = np.flatnonzero(turns.spans(at_ns))
        if 2 * len(inside) < len(times):
            return np.inf
        since_ns, at_ns = since_ns[inside], at_ns[inside]
        gap = turns.gaps[np.searchsorted(turns.ends_ns, at_ns)]
        one = np.exp(1j * BIAS / SECOND * since_ns)
        two = one * one
        turned = np.stack([np.ones(len(one)), one, two, two * one])
        rest = np.exp(1j * (course[inside] - turns.at(at_ns)))
        follows = rest * np.concatenate([turned, turned[1:].conj()])
    part = since_ns // round(SAME_S * SECOND)
    first = np.flatnonzero(np.diff(part, prepend=-1) | np.diff(gap, prepend=-1))
    count = np.diff(first, append=len(part))
    enough = count >= LEAST_TOGETHER
    if count[enough].sum() < least:
        return np.inf
    # The mean of n unit vectors of any directions is about 1/n of all of them long at least
    length = np.abs(np.add.reduceat(follows, first, axis=1))[:, enough]
    together = float((length - 1.0).sum(axis=1).max())
    return 1.0 - together / float((count[enough] - 1).sum())


def _courses(gnss: GnssEpochs) -> tuple[IntArray, FloatArray]:
    """Times and courses over ground where the vehicle moves, over the shortest step that shows it.

    The noise of fixes is that of their second differences, which is no less if the vehicle turns;
    whether it is white does not matter, as false courses do not follow a gyro.
    """
    by_velocity = bool(gnss.has_velocity.any())
    rows = gnss.rows(np.flatnonzero(gnss.has_velocity if by_velocity else gnss.has_position))
    best = (np.zeros(0, np.int64), np.zeros(0))
    if len(rows) < LEAST_COURSES:
        return best
    if by_velocity:
        values = rows.velocity_n[:, :2]
    else:
        north, east = horizontal_metres(
            rows.latitude - rows.latitude[0],
            wrapped(rows.longitude - rows.longitude[0]),
            rows.latitude,
        )
        values = np.stack([north, east], axis=1)
    noise = float(np.median(np.abs(np.diff(values, 2, axis=0)))) * SIGMA_PER_MAD / np.sqrt(6.0)
    for step in STEPS_S:
        first = np.unique(rows.time_ns // round(step * SECOND), return_index=True)[1]
        times, move = rows.time_ns[first], values[first]
        least = np.full(len(first), SLOWEST)
        if not by_velocity:
            lasted = np.diff(times)
            times, move = times[:-1] + lasted // 2, np.diff(move, axis=0)
            near = lasted <= 2.0 * step * SECOND
            times, move = times[near], move[near]
            least = SLOWEST * lasted[near] / SECOND
        size = np.hypot(move[:, 0], move[:, 1])
        moves = size > np.maximum(least, TIMES_NOISE * noise)
        found = (times[moves], np.arctan2(move[moves, 1], move[moves, 0]))
        if len(found[0]) > len(best[0]):
            best = found
        if 2 * np.count_nonzero(moves) > len(moves):
            break
    return best


def _vertex(values: list[float]) -> float:
    """Where a parabola through three values has its vertex, from the middle one, s."""
    before, middle, after = values
    bend = before - 2.0 * middle + after
    return 0.5 * FINE_S * (before - after) / bend if bend > 0.0 else 0.0
