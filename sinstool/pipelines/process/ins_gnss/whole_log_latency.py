"""Latency of fixes by all of a log, where its first minutes leave more open than matters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.arrays import FloatArray
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.methods.ins_gnss.fix_velocity import outlying, track_of
from sinstool.methods.ins_gnss.receiver_offsets import ReceiverOffsets, estimate_offsets, settle
from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.timing import FIRST_NS, LEAST_S, USED

# A log so many times as long as its first part says more of the latency than that did.
LONGER = 1.5
# No receiver's latency is known to less than an hour of driving shows; nor does it stay the same
# for much longer.
LONGEST_NS = 3600 * SECOND
# Beside the noise of a fix, a latency matters if its sigma is worth so much at usual speed.
MATTERS = 0.1


@dataclass(frozen=True)
class WholeLogLatency:
    """A latency, s, and what is known of it and of the lever arm beside it."""

    latency_s: float
    offsets: ReceiverOffsets

    def used_by(self, start: FilterStart) -> FilterStart:
        """A start with this latency.

        Its position is that of a fix, which was valid earlier or later than it was taken to be.
        """
        begun, settings = start.start, start.settings
        off = begun.nav[3:6] * (self.latency_s - settings.gnss_latency)
        covariance = begun.covariance_position_n + np.outer(off, off)
        return replace(
            start,
            settings=replace(settings, gnss_latency=self.latency_s),
            start=replace(begun, covariance_position_n=covariance),
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
    if end_ns - begin_ns < LONGER * FIRST_NS:
        return None
    if shown.sigma_s * _usual_speed(start.used) < MATTERS * start.fix_sigma_m:
        return None
    parts = [p for p in joined if p.time_ns[0] < begin_ns + LONGEST_NS]
    stated_b = config.gnss.lever_arm
    assumed_b, control = stated_b or np.zeros(3), start.settings.control
    everything = start.used.rows(~outlying(start.used))

    def about(latency: float, _arm_b: FloatArray | None, gated: bool) -> ReceiverOffsets | None:
        gate = control if gated else replace(control, gate_probability=1.0)
        settings = replace(start.settings, gnss_latency=latency, control=gate)
        fixes = start.used if gated else everything
        return estimate_offsets(
            start.start, settings, parts, fixes, assumed_b, stated_b is not None
        )

    used, found, agrees = settle(about, start.settings.gnss_latency)
    if found is None or not agrees or found.sigma_s > shown.sigma_s:
        return None
    if start.arm_status != "given":
        found = found.used_at(arm_b)
    if not found.latency.differs_from(0.0, LEAST_S, USED):
        used = 0.0
    return WholeLogLatency(used, found)


def _usual_speed(gnss: GnssEpochs) -> float:
    """Root mean square of speed from fix to fix, of those a second or more apart, m/s."""
    seconds, place = track_of(gnss.rows(np.flatnonzero(gnss.has_position)))
    if len(seconds) < 2:
        return 0.0
    of = np.unique(np.floor(seconds), return_index=True)[1]
    way = np.linalg.norm(np.diff(place[of], axis=0), axis=1)
    return float(np.sqrt(np.mean(np.square(way / np.diff(seconds[of]))))) if len(of) > 1 else 0.0
