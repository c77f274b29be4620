"""Times of fixes that a receiver makes evenly, from stamps of their receipt.

A receiver measures at whole intervals of its own clock. Many drivers stamp a fix when its message
reaches the computer, some milliseconds late and never equally so: at 20 m/s each millisecond is
2 cm along the track. The delays do not add up, so even times run beside the stamps.

Not all stamps that vary are of receipt: a fused position may be one of just that time. Then the
fixes fit their stamps: between its neighbours a fix lies where its own stamp says. A regression
tells the two apart, where the vehicle moves enough; else it does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.earth import horizontal_metres
from sinstool.core.finding import Finding
from sinstool.core.order_statistics import MEDIAN_OVER_MEAN, SIGMA_PER_MAD, median, quantile
from sinstool.core.rotation import wrapped
from sinstool.core.streams import Gnss, Velocity
from sinstool.core.timeline import SECOND
from sinstool.survey.late_stamps import BELIEVED, HALF_WAY, right_stamps

# Fixes that show the phase of the stamps together.
PHASE_FIXES = 32
# Even times lie on a line, or, where the medians of parts of the stamps are off it by more than so
# many of their sigmas, on one with knots: a computer that sets its clock by a time server changes
# its rate over minutes. A part has so many fixes at least, and so many s.
DRIFTS, KNOT_FIXES, KNOT_S = 1.5, 64, 60.0
# After so many intervals without a fix a line begins anew; with fewer fixes it has no slope.
BROKEN, FEWEST = 20, 16
# Intervals are estimated by those that are within this share of a multiple of the usual one, of at
# most so many.
NEAR, MULTIPLE = 0.4, 5
# Length of the mean of the phases of stamps, of 1 at most, below which nothing is even about them.
EVEN = 0.5
# The promptest stamps: this share. None is earlier by more than this part of an interval.
PROMPT, EARLY = 0.02, 0.25
# Delays are skewed if the prompt half spreads by less than this part of the slow half.
SKEWED = 0.5
# Delays further from their median than so many sigmas are of a computer that was busy.
WAITED = 4.0
# Delays that vary by less, s (1 sigma), hardly matter.
LEAST_S = 0.001
# Residuals beyond so many times the usual one are of false fixes; a change from fix to fix by less
# than so many may be noise, which makes the regression give 0. Fewest changes that show something.
FALSE, MOVES, LEAST_MOVING = 6.0, 4.0, 40


@dataclass(frozen=True)
class EvenFixes:
    """Even times of the fixes of a log.

    Attributes
    ----------
    time_ns : ndarray of int64, shape (n,)
        Even time of each, in order.
    number : ndarray of int64, shape (n,)
        Of the interval that ends with each: those of neighbours differ by 1 where none is missing.
        -1 where a few fixes lie by themselves.
    interval_ns : float
    late_s : ndarray, shape (n,)
        Stamps less even times.
    """

    time_ns: IntArray
    number: IntArray
    interval_ns: float
    late_s: FloatArray

    @property
    def jitter_s(self) -> float:
        """Standard deviation of the delays."""
        return float(self.late_s.std())

    def are_of_receipt(self, values: FloatArray) -> bool:
        """Whether values belong to the even times, not to the stamps, and clearly so.

        Parameters
        ----------
        values : ndarray, shape (n, k)
            What changes steadily, as places or velocities of a vehicle do.
        """
        steps = np.diff(self.number)
        inner = np.flatnonzero((steps[1:] == 1) & (steps[:-1] == 1)) + 1
        late = _between(self.late_s, inner)
        residuals, expectations = [np.zeros(0)], [np.zeros(0)]
        for column in values.T:
            residual = _between(column, inner)
            change = 0.5 * (column[inner + 1] - column[inner - 1])
            size = np.abs(residual)
            known = np.isfinite(size) & np.isfinite(change)
            if not known.any():
                continue
            usual = median(size[known])
            rows = known & (size <= FALSE * usual) & (np.abs(change) > MOVES * usual)
            residuals.append(residual[rows])
            expectations.append(change[rows] / (self.interval_ns / SECOND) * late[rows])
        residual, expected = np.concatenate(residuals), np.concatenate(expectations)
        factor, sigma = right_stamps(residual, expected)
        return len(expected) >= LEAST_MOVING and factor + BELIEVED * sigma < HALF_WAY


def _between(values: FloatArray, inner: IntArray) -> FloatArray:
    """Some values less the mean of their neighbours."""
    return np.asarray(values[inner] - 0.5 * (values[inner + 1] + values[inner - 1]))


def places(fixes: Gnss) -> FloatArray:
    """Places of fixes about the first, NED, m, shape (n, 3)."""
    latitude = fixes.latitude - fixes.latitude[0]
    longitude = wrapped(fixes.longitude - fixes.longitude[0])
    north, east = horizontal_metres(latitude, longitude, fixes.latitude, fixes.height)
    return np.stack([north, east, fixes.height[0] - fixes.height], axis=1)


def even_times(time_ns: IntArray) -> EvenFixes | None:
    """Even times beside stamps, however late each of these is.

    Parameters
    ----------
    time_ns : ndarray of int64, shape (n,)
        In order.

    Returns
    -------
    EvenFixes or None
        None where there are few, where they are not even, or where stamps are even themselves.
    """
    if len(time_ns) < KNOT_FIXES:
        return None
    stamps: FloatArray = (time_ns - time_ns[0]).astype(np.float64)
    interval = _usual_interval(stamps)
    if interval is None:
        return None
    runs = np.split(np.arange(len(stamps)), np.flatnonzero(np.diff(stamps) > BROKEN * interval) + 1)
    middle, number = np.full(len(stamps), np.nan), np.full(len(stamps), -1)
    for rows in runs:
        if len(rows) >= FEWEST:
            found = _run(stamps[rows], interval)
            if found is None:
                return None
            middle[rows], number[rows] = found
    known = np.isfinite(middle)
    if not known.any():
        return None
    late = (stamps - middle)[known]
    offset = _offset(late)
    # Of short runs each is as late as others are in the mean
    even = np.where(known, middle, stamps - float(np.mean(late))) + offset
    times = time_ns[0] + np.rint(even).astype(np.int64)
    if np.any(np.diff(times) <= 0):
        return None
    interval = float(median(np.diff(times)[np.diff(number) == 1]))
    fixes = EvenFixes(times, number, interval, (stamps - even) / SECOND)
    return fixes if fixes.jitter_s > LEAST_S else None


def _offset(late: FloatArray) -> float:
    """What to add to times beside the middle of the delays.

    Delays that are skewed are those of messages, of which the promptest hardly waited. Others may
    be anything: their middle stays where it is, and is left to the latency.
    """
    prompt, usual, slow = (float(quantile(late, share)) for share in (PROMPT, 0.5, 1.0 - PROMPT))
    return prompt if usual - prompt < SKEWED * (slow - usual) else usual


def _usual_interval(stamps: FloatArray) -> float | None:
    """Interval from fix to fix, ns, where most are near a multiple of it."""
    steps = np.diff(stamps)
    interval = float(median(steps))
    for _ in range(3):
        if interval <= 0.0:
            return None
        multiple = np.clip(np.rint(steps / interval), 1.0, MULTIPLE)
        near = np.abs(steps - multiple * interval) < NEAR * interval
        if 2 * np.count_nonzero(near) < len(steps):
            return None
        interval = float(steps[near].sum() / multiple[near].sum())
    return interval


def _run(stamps: FloatArray, interval: float) -> tuple[FloatArray, IntArray] | None:
    """Even times beside the stamps of a run without a long gap, and numbers; None if not even."""
    edges = _edges(len(stamps), PHASE_FIXES)
    circle = np.exp(2j * np.pi * stamps / interval)
    mean = np.add.reduceat(circle, edges[:-1]) / np.diff(edges)
    if median(np.abs(mean)) < EVEN:
        return None
    phase = interval * np.unwrap(np.angle(mean)) / (2.0 * np.pi)
    usual = np.interp(stamps, _means(stamps, edges), phase)
    place = np.arange(len(stamps))
    number = np.rint((stamps - usual) / interval).astype(np.int64)
    # No two are of one time: what came later than the next was due is the one before
    number = place + np.minimum.accumulate((number - place)[::-1])[::-1]
    late, since = stamps - interval * number, stamps - stamps.mean()
    off = late - median(late)
    scatter = SIGMA_PER_MAD * median(np.abs(off))
    # What waited for seconds, in a stall of the computer, says nothing of the line
    kept = np.where(np.abs(off) < WAITED * scatter, off, 0.0)
    line = late - off + kept.mean() + since * float(since @ kept) / float(since @ since)
    edges = _edges(len(stamps), max(KNOT_FIXES, round(KNOT_S * SECOND / interval)))
    beside = late - line
    knots = np.array([median(beside[a:b]) for a, b in pairwise(edges.tolist())])
    if np.std(knots) > DRIFTS * MEDIAN_OVER_MEAN * scatter / np.sqrt(np.diff(edges).min()):
        line = line + np.interp(stamps, _means(stamps, edges), knots)
    else:
        line = line + median(beside)
    # None comes before it was measured: what seems to do so waited, and the next one was lost
    late = stamps - interval * number - line
    early = late < quantile(late, PROMPT) - EARLY * interval
    number = number - (early & (np.diff(number, prepend=number[0] - 2) > 1))
    even: FloatArray = interval * number + line
    return even, number


def _edges(count: int, width: int) -> IntArray:
    """Edges of about equal parts of at least half the width."""
    return np.linspace(0, count, max(1, round(count / width)) + 1, dtype=np.int64)


def _means(values: FloatArray, edges: IntArray) -> FloatArray:
    """Means of the parts of values between edges."""
    return np.asarray(np.add.reduceat(values, edges[:-1]) / np.diff(edges))


def at_even_times(
    fixes: Gnss | None, velocity: Velocity | None, topics: tuple[str, str], surely: bool
) -> tuple[Gnss | None, Velocity | None, list[Finding]]:
    """Fixes and velocities at even times, where their stamps are of receipt.

    Parameters
    ----------
    topics : tuple of str
        Of both.
    surely : bool
        The receiver is known to measure evenly.

    Returns
    -------
    fixes, velocity, findings
        As they were, and no finding, where nothing shows that stamps are of receipt.
    """
    findings: list[Finding] = []
    even = None if fixes is None else even_times(fixes.time_ns)
    if fixes is not None and even is not None and (surely or even.are_of_receipt(places(fixes))):
        findings.append(_finding(even, topics[0], "positions"))
        stamps, fixes = fixes.time_ns, replace(fixes, time_ns=even.time_ns)
        if velocity is not None and topics[0] == topics[1]:
            # Those of the same messages
            at = np.clip(np.searchsorted(stamps, velocity.time_ns), 0, len(stamps) - 1)
            times = velocity.time_ns - (stamps - even.time_ns)[at]
            if np.all(stamps[at] == velocity.time_ns):
                return fixes, replace(velocity, time_ns=times), findings
    if velocity is not None:
        even = even_times(velocity.time_ns)
        if even is not None and (surely or findings or even.are_of_receipt(velocity.velocity_n)):
            findings.append(_finding(even, topics[1], "velocities"))
            velocity = replace(velocity, time_ns=even.time_ns)
    return fixes, velocity, findings


def _finding(even: EvenFixes, topic: str, values: str) -> Finding:
    jitter = even.jitter_s
    return Finding(
        "uneven-fixes",
        f"topic {topic}: stamps differ by {1e3 * jitter:.2g} ms (1 sigma) from even times, like"
        f" stamps set on receipt: the {values} are taken as evenly spaced,"
        f" {even.interval_ns / SECOND:.4g} s apart",
        answer="if they were measured at their stamps, use --gnss-stamps kept",
        topic=topic,
        numbers={"jitter_s": jitter, "interval_s": even.interval_ns / SECOND},
    )
