"""Latency of fixes by a whole log, where its first minutes do not show it well enough.

Over a whole log it may also change, as the receiver may have a clock of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.methods.ins_gnss.clock_rate import STEADY, USUAL_RATE, ClockRate
from sinstool.methods.ins_gnss.fix_velocity import track_of
from sinstool.methods.ins_gnss.receiver_offsets import ReceiverOffsets, estimate_offsets, settle
from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.timing import FIRST_NS, LEAST_S, USED

# A log this many times as long as its first part improves on the latency of that part. A shorter
# one is used too if that part hints at a rate of the receiver's clock.
LONGER = 1.5
# An hour of driving shows a latency as well as it is ever known, and it does not stay the same for
# much longer.
LONGEST_NS = 3600 * SECOND
# A latency matters if its uncertainty, with that of the clock's rate, makes positions at usual
# speed uncertain by this share of the noise of a fix.
MATTERS = 0.15
# The rate of a clock is estimated at most so often; if it changes the latency by more than FAR_S,
# in the first quarter of the log first, then in its first half: errors of a filter are not linear
# in those of its fixes.
ROUNDS, SHARES, FAR_S = 6, (0.25, 0.5, 1.0), 0.1


@dataclass(frozen=True)
class WholeLogLatency:
    """Latency by a whole log.

    Attributes
    ----------
    latency_s : float
        The latency to use, s: with a clock of another rate, that in the middle of the log.
    offsets : ReceiverOffsets
        The estimate about it, with its sigma and the lever arm.
    clock : ClockRate
        Of the receiver: its stamps are to be corrected by this rate.
    """

    latency_s: float
    offsets: ReceiverOffsets
    clock: ClockRate = STEADY

    def used_by(self, start: FilterStart) -> FilterStart:
        """A start with this latency."""
        shown, offsets = start.offsets, self.offsets
        if shown is not None and shown.gyros is not None and shown.gyros.shown:
            offsets = replace(offsets, gyros=shown.gyros)
        at_start_s = self.latency_s + self.clock.latency_at(start.time_ns)
        return replace(
            start.with_latency(self.latency_s, at_start_s),
            gnss=self.clock.corrected(start.gnss),
            clock=start.clock.plus(self.clock),
            offsets=offsets,
            latency_status="found",
        )


def latency_of_whole_log(
    start: FilterStart, config: ProcessConfig, joined: Sequence[Increments]
) -> WholeLogLatency | None:
    """Latency by the whole log.

    Parameters
    ----------
    start : FilterStart
        With the estimate by the first part of the log.
    joined : sequence of Increments
        Of the whole log from the start on, up to a long gap.

    Returns
    -------
    WholeLogLatency or None
        None if the latency is given, if the first part shows it well enough, or if the estimate
        does not converge.
    """
    shown, arm_b = start.offsets, np.asarray(start.settings.lever_arm_b)
    if start.latency_status == "given" or shown is None or not joined:
        return None
    begin_ns, end_ns = int(joined[0].time_ns[0]), int(joined[-1].time_ns[-1])
    if end_ns - begin_ns < LONGER * FIRST_NS and not shown.clock.worth_repeating:
        return None
    # Root mean square, over the log, of the change of latency by a usual rate of clocks
    changes = USUAL_RATE * (end_ns - begin_ns) / SECOND / np.sqrt(12.0)
    unknown = float(np.hypot(shown.sigma_s, changes))
    if unknown * _usual_speed(start.used) < MATTERS * start.fix_sigma_m:
        return None
    span_ns = min(end_ns - begin_ns, LONGEST_NS)
    stated_b = config.gnss.lever_arm
    assumed_b = stated_b or np.zeros(3)

    @cache  # both searches below begin with the same estimate
    def about(
        latency: float, clock: ClockRate, gated: bool, share: float
    ) -> ReceiverOffsets | None:
        parts = [p for p in joined if p.time_ns[0] < begin_ns + share * span_ns]
        settings = start.settings if gated else start.settings.ungated
        settings = replace(settings, gnss_latency=latency)
        fixes = clock.corrected(start.used if gated else start.believable)
        return estimate_offsets(
            start.start, settings, parts, fixes, assumed_b, stated_b is not None
        )

    first = start.settings.gnss_latency
    clock = _clock_rate(lambda so_far, share: about(first, so_far, False, share))
    if clock.rate != 0.0:
        # It may be that of a part; the latency is to be that in the middle of the whole
        clock = replace(clock, middle_ns=begin_ns + span_ns // 2)
    used, found, agrees = settle(
        lambda latency, _arm_b, gated: about(latency, clock, gated, 1.0), first
    )
    if found is None or not agrees or (found.sigma_s > shown.sigma_s and clock.rate == 0.0):
        return None
    if start.arm_status != "given":
        found = found.used_at(arm_b)
    if clock.rate == 0.0 and not found.latency.differs_from(0.0, LEAST_S, USED):
        used = 0.0
    return WholeLogLatency(used, found, clock)


def _clock_rate(about: Callable[[ClockRate, float], ReceiverOffsets | None]) -> ClockRate:
    """Rate of the receiver's clock, iterated until stamps corrected by it show none.

    Parameters
    ----------
    about : callable
        Takes the rate so far, and the share of the log to use; returns the estimate with stamps
        corrected by that rate.

    Returns
    -------
    ClockRate
        `STEADY` if the log shows none.
    """
    shown = about(STEADY, 1.0)
    if shown is None or not shown.clock.worth_repeating:
        return STEADY
    clock = STEADY
    far = abs(shown.clock.rate) * shown.clock.span_s > FAR_S
    for share in SHARES if far else SHARES[-1:]:
        for _ in range(ROUNDS):
            shown = about(clock, share)
            if shown is None:
                return STEADY
            # The last one is within its sigma, which is that of the sum
            clock = clock.plus(shown.clock)
            if not shown.clock.worth_repeating:
                break
    return clock if clock.significant else STEADY


def _usual_speed(gnss: GnssEpochs) -> float:
    """Root mean square of the speed between the first fixes of each second, m/s."""
    seconds, place = track_of(gnss.rows(np.flatnonzero(gnss.has_position)))
    if len(seconds) < 2:
        return 0.0
    first = np.unique(np.floor(seconds), return_index=True)[1]
    if len(first) < 2:
        return 0.0
    way = np.linalg.norm(np.diff(place[first], axis=0), axis=1)
    return float(np.sqrt(np.mean(np.square(way / np.diff(seconds[first])))))
