"""Stamps that may be of receipt: whether they jitter, and even times in their place."""

from __future__ import annotations

from dataclasses import replace

from sinstool.config import InputOptions
from sinstool.core.timeline import GAP_INTERVALS, SECOND
from sinstool.io.readers.log import Log
from sinstool.io.readers.streams import ImuUnits
from sinstool.io.readers.topics import ImuTopic
from sinstool.survey.even_stamps import SAME, EvenStamps, even_stamps
from sinstool.survey.imu import CONFLICTING, Survey
from sinstool.survey.samples import SampleCache, samples_again

# Stamps that vary by more of an interval may be of receipt, which is worth to know where it turns
# samples by more than noise does.
JITTER = 0.05
# Intervals that vary by more say nothing of lost samples, either.
UNEVEN = 0.2
# Or samples are so many times further apart in the mean than most of them.
BATCHES = 2.0
# Share of samples with another's stamp, but other values, from which on it is worth to read the log
# again and keep them.
REPEATED = 1e-3
# Two counts are about the same if neither is so many times the other.
ABOUT = 2.0


def say_only_order(found: Survey, options: InputOptions) -> bool:
    """Whether stamps say so little of times that samples which repeat one are none to leave out."""
    repeated = found.order.differing_duplicates / found.count
    if options.imu_rate is not None or jitters(found, options):
        return repeated > REPEATED
    return repeated > CONFLICTING


def fill_the_rate(found: Survey, options: InputOptions) -> bool:
    """Whether those that repeat a stamp are about as many as the rate given says are missing."""
    if options.imu_rate is None:
        return False
    missing = options.imu_rate * found.duration_s - found.count
    repeated = found.order.differing_duplicates
    return missing / ABOUT <= repeated <= missing * ABOUT


def even_where_late(
    log: Log,
    topic: ImuTopic,
    units: ImuUnits,
    samples: SampleCache,
    options: InputOptions,
    found: Survey,
) -> Survey:
    """A survey with even times where stamps are of receipt."""
    if not jitters(found, options):
        return found
    again = samples_again(log, topic, units, found, samples, found.first_ns)
    increments = options.sample_kind == "increment"
    slight = not (sampled_unevenly(found) or _in_batches(found))
    even = even_stamps(again, increments, options.imu_stamps == "even", slight)
    if even is None or even.most_ns < SAME * even.usual_ns:
        return found  # a gap makes the mean interval longer, but no stamp uneven
    return _evened(found, even, options)


def jitters(found: Survey, options: InputOptions) -> bool:
    """Whether stamps jitter by so much that they may be of receipt."""
    if options.imu_stamps == "kept":
        return False
    if options.imu_stamps == "even" or _spread_beyond(found, JITTER):
        return True
    return _in_batches(found)


def _in_batches(found: Survey) -> bool:
    """Whether samples come in batches of ten and more: nine of ten intervals are equally short."""
    return found.last_ns - found.first_ns > BATCHES * found.count * found.interval_ns


def sampled_unevenly(survey: Survey) -> bool:
    """Whether intervals differ by so much that a long one is no sign of a lost sample."""
    return _spread_beyond(survey, UNEVEN)


def _spread_beyond(survey: Survey, share: float) -> bool:
    """Whether stamps as they are vary by more than this share of an interval."""
    return survey.even is None and survey.interval_spread_ns > share * survey.interval_ns


def _evened(found: Survey, even: EvenStamps, options: InputOptions) -> Survey:
    """A survey whose times are even ones."""
    longest = GAP_INTERVALS * even.usual_ns
    if options.max_gap is not None:
        longest = options.max_gap * SECOND
    gaps = tuple(gap for gap in even.gaps if gap[1] * SECOND > longest)
    return replace(
        found,
        last_ns=max(found.last_ns, even.last_ns),
        interval_ns=even.usual_ns,
        max_gap_ns=int(longest),
        bursty=False,
        gaps=gaps,
        gap_count=len(gaps),
        gap_total_s=sum(length for _, length in gaps),
        missed=len(even.gaps) - len(gaps),
        even=even,
    )
