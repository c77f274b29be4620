"""The clocks of IMU and receiver against each other, as each alone may seem right.

Their clocks are compared by the times at which both were recorded, and by their turns.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from sinstool.config import InputOptions
from sinstool.core.errors import DataError
from sinstool.core.finding import Finding, Severity
from sinstool.core.order_statistics import quantile
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.survey.aiding import AidingData
from sinstool.survey.course import course_findings
from sinstool.survey.gnss import CONTRADICTS
from sinstool.survey.imu import Survey
from sinstool.survey.receiver_ahead import (
    LEAST_S,
    RECEIVER_CLOCK,
    receiver_ahead,
    turns_apart,
    two_clocks,
)

# No message is recorded before it is stamped, apart from small differences of two clocks of one
# machine; receivers and networks deliver up to some seconds late.
AHEAD_S, BEHIND_S = 1.0, 5.0
# The least delay of a topic is this quantile of its delays, of so many messages at least.
QUICK = 0.05
LEAST = 3


def against_gnss(
    path: Path, options: InputOptions, survey: Survey, aiding: AidingData
) -> list[Finding]:
    """Compare the clocks of both, and the turns of the gyro with those of the course.

    Parameters
    ----------
    path : Path
        Of the log.

    Raises
    ------
    DataError
        GNSS shows that the IMU's data are in another unit.
    """
    findings = clocks_apart(survey, aiding.gnss, aiding.fix_topic, options)
    if any(f.kind == CONTRADICTS for f in aiding.findings):
        return findings  # by a velocity that the fixes deny nothing is judged
    for finding in course_findings(survey.windows, aiding.gnss, options, survey.topic):
        if finding.severity == Severity.FAILED:
            raise DataError(path, finding.text, finding.answer)
        findings.append(finding)
    ahead = receiver_ahead(survey.windows, aiding.gnss)
    if ahead is None:
        return findings
    recorded = [f for f in findings if f.kind == RECEIVER_CLOCK]
    if any(abs(f.numbers["ahead_s"] - ahead) < LEAST_S for f in recorded):
        return findings
    # A log that was converted may say nothing true of when its messages were recorded
    findings = [f for f in findings if f.kind != RECEIVER_CLOCK]
    return [*findings, turns_apart(ahead, options, survey.topic)] if ahead else findings


def clocks_apart(
    survey: Survey, gnss: GnssEpochs | None, topic: str, options: InputOptions
) -> list[Finding]:
    """Find stamps of a receiver that are not on the IMU's clock.

    Both topics are recorded by one recorder, so log time less stamp is the same for both, apart
    from the delay of delivery.

    Parameters
    ----------
    gnss : GnssEpochs or None
        By time.
    topic : str
        Of the fixes.
    options : InputOptions
        Their clock offset has been subtracted from the stamps.
    """
    if gnss is None or len(gnss) < LEAST or survey.time_source != "stamp":
        return []
    low, high = survey.clock_offset_s
    delay = float(quantile((gnss.log_time_ns - gnss.time_ns) / SECOND, QUICK))
    if low - AHEAD_S <= delay <= high + BEHIND_S:
        return []
    ahead = low - delay
    shown = f"{abs(ahead):.1f} s {'ahead of' if ahead > 0.0 else 'behind'}"
    # No message is recorded before it is sent, but a slow link may deliver it late
    unless = "" if ahead > 0.0 else ", unless they were recorded that late"
    text = (
        f"the stamps of {topic} are {shown} those of the IMU, judging by the times of recording:"
        " two clocks"
    )
    finding = two_clocks(text, ahead, options, topic)
    return [replace(finding, answer=finding.answer + unless)]
