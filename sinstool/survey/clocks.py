"""Whether the receiver and the Imu stamp by one clock, by the times at which both were recorded."""

from __future__ import annotations

import numpy as np

from sinstool.core.finding import Finding
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.survey.course import RECEIVER_CLOCK
from sinstool.survey.imu import Survey

# No message is recorded before it is stamped, but for what two clocks of one machine differ by;
# receivers and networks deliver some seconds late.
AHEAD_S, BEHIND_S = 1.0, 5.0
# Messages, of the quickest, that say what the delay of a topic is at least.
QUICK = 0.05
LEAST = 3


def clocks_apart(survey: Survey, gnss: GnssEpochs | None, topic: str) -> list[Finding]:
    """Find stamps of a receiver that are not on the Imu's clock.

    Both topics are recorded by one recorder, so that the times of its log, less the stamps, are
    the same for both but for the delay of their delivery.

    Parameters
    ----------
    gnss : GnssEpochs or None
        By time.
    topic : str
        Of the fixes.
    """
    if gnss is None or len(gnss) < LEAST or survey.time_source != "stamp":
        return []
    low, high = survey.clock_offset_s
    delay = float(np.quantile((gnss.log_time_ns - gnss.time_ns) / SECOND, QUICK))
    if low - AHEAD_S <= delay <= high + BEHIND_S:
        return []
    ahead = low - delay
    shown = f"{abs(ahead):.1f} s {'ahead of' if ahead > 0.0 else 'behind'}"
    # No message is recorded before it is sent, but a slow link may deliver it late
    unless = "" if ahead > 0.0 else ", unless they were recorded so late"
    return [
        Finding(
            RECEIVER_CLOCK,
            f"the stamps of {topic} are {shown} those of the Imu, by the times at which messages"
            " were recorded: two clocks",
            answer=f"add --gnss-clock-offset {ahead:.1f}{unless}",
            topic=topic,
            numbers={"ahead_s": ahead},
        )
    ]
