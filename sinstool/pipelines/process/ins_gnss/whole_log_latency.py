"""Latency of fixes by all of a log, where its first minutes leave more open than matters.

In the course of a log it may change, too, where the receiver has a clock of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.methods.ins_gnss.clock_rate import STEADY, USUAL_RATE, ClockRate
from sinstool.methods.ins_gnss.fix_velocity import outlying, track_of
from sinstool.methods.ins_gnss.receiver_offsets import ReceiverOffsets, estimate_offsets, settle
from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.timing import FIRST_NS, LEAST_S, USED

# A log so many times as long as its first part says more of the latency than that did. A shorter
# one is asked again if that part hints that the latency changes.
LONGER = 1.5
# No receiver's latency is known to less than an hour of driving shows; nor does it stay the same
# for much longer.
LONGEST_NS = 3600 * SECOND
# Beside the noise of a fix, a latency matters if what is not known of it, with the rate of a clock,
# is worth so much at usual speed.
MATTERS = 0.15
# The rate of a clock is sought so often, in each of such shares of a log if it changes latency by
# more than so much, s: errors of a filter are not linear in those of its fixes.
ROUNDS, SHARES, FAR_S = 6, (0.25, 0.5, 1.0), 0.1


@dataclass(frozen=True)
class WholeLogLatency:
    """A latency, s, and what is known of it and of the lever arm beside it.

    Attributes
    ----------
    clock : ClockRate
        Of the receiver, by which its stamps are to be put right.
    """

    latency_s: float
    offsets: ReceiverOffsets
    clock: ClockRate = STEADY

    def used_by(self, start: FilterStart) -> FilterStart:
        """A start with this latency.

        Its position is that of a fix, which was valid earlier or later than it was taken to be.
        """
        begun, settings = start.start, start.settings
        latency = self.latency_s + self.clock.latency_at(start.time_ns)
        off = begun.nav[3:6] * (latency - settings.gnss_latency)
        covariance = begun.covariance_position_n + np.outer(off, off)
        return replace(
            start,
            settings=replace(settings, gnss_latency=self.latency_s),
            start=replace(begun, covariance_position_n=covariance),
            gnss=self.clock.put_right(start.gnss),
            clock=start.clock.plus(self.clock),
            offsets=self.offsets,
            latency_status="found",
        )


def latency_of_whole_log(
    start: FilterStart, config: ProcessConfig, joined: Sequence[Increments]
) -> WholeLogLatency | None:
    """The latency by all of a log; None where its first part leaves nothing open that matters.

    Parameters
    ----------
    joined : sequence of Increments
        Of the whole log from the start on, up to a long gap.
    """
    shown, arm_b = start.offsets, np.asarray(start.settings.lever_arm_b)
    if start.latency_status == "given" or shown is None or not joined:
        return None
    begin_ns, end_ns = int(joined[0].time_ns[0]), int(joined[-1].time_ns[-1])
    if end_ns - begin_ns < LONGER * FIRST_NS and not shown.clock.hinted:
        return None
    # A clock that runs evenly is off by so much, as a root mean square, about the middle
    changes = USUAL_RATE * (end_ns - begin_ns) / SECOND / np.sqrt(12.0)
    unknown = float(np.hypot(shown.sigma_s, changes))
    if unknown * _usual_speed(start.used) < MATTERS * start.fix_sigma_m:
        return None
    span_ns = min(end_ns - begin_ns, LONGEST_NS)
    stated_b = config.gnss.lever_arm
    assumed_b, control = stated_b or np.zeros(3), start.settings.control
    far = outlying(start.used)

    def about(
        latency: float, clock: ClockRate, gated: bool, share: float = 1.0
    ) -> ReceiverOffsets | None:
        parts = [p for p in joined if p.time_ns[0] < begin_ns + share * span_ns]
        gate = control if gated else replace(control, gate_probability=1.0)
        settings = replace(start.settings, gnss_latency=latency, control=gate)
        fixes = clock.put_right(start.used if gated else start.used.rows(~far))
        return estimate_offsets(
            start.start, settings, parts, fixes, assumed_b, stated_b is not None
        )

    first = start.settings.gnss_latency
    clock = _clock(lambda so_far, share: about(first, so_far, False, share))
    used, found, agrees = settle(lambda latency, _arm_b, gated: about(latency, clock, gated), first)
    if found is None or not agrees or (found.sigma_s > shown.sigma_s and clock.rate == 0.0):
        return None
    if start.arm_status != "given":
        found = found.used_at(arm_b)
    if clock.rate == 0.0 and not found.latency.differs_from(0.0, LEAST_S, USED):
        used = 0.0
    return WholeLogLatency(used, found, clock)


def _clock(about: Callable[[ClockRate, float], ReceiverOffsets | None]) -> ClockRate:
    """The rate of the receiver's clock with which none is left, at first in a part of the log.

    Parameters
    ----------
    about : callable
        Takes what is known of the clock, and the share of the log that is to be looked at.
    """
    shown = about(STEADY, 1.0)
    if shown is None or not shown.clock.hinted:
        return STEADY
    clock = STEADY
    far = abs(shown.clock.rate) * shown.clock.span_s > FAR_S
    for share in SHARES if far else SHARES[-1:]:
        for _ in range(ROUNDS):
            shown = about(clock, share)
            if shown is None:
                return STEADY
            # The last is no more than chance may make, but says how well the sum is known
            clock = clock.plus(shown.clock)
            if not shown.clock.hinted:
                break
    return clock if clock.shown else STEADY


def _usual_speed(gnss: GnssEpochs) -> float:
    """Root mean square of speed from fix to fix, of those a second or more apart, m/s."""
    seconds, place = track_of(gnss.rows(np.flatnonzero(gnss.has_position)))
    if len(seconds) < 2:
        return 0.0
    of = np.unique(np.floor(seconds), return_index=True)[1]
    way = np.linalg.norm(np.diff(place[of], axis=0), axis=1)
    return float(np.sqrt(np.mean(np.square(way / np.diff(seconds[of]))))) if len(of) > 1 else 0.0
