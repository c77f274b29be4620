"""What happened to the vertical channel of a run, and which heights are not to be trusted."""

from __future__ import annotations

from collections import Counter

from sinstool.core.english import counted
from sinstool.core.finding import Finding, Severity
from sinstool.core.timeline import SECOND
from sinstool.methods.height.channel import VALID_COAST
from sinstool.methods.height.layout import ChannelSummary, Event
from sinstool.pipelines.process.height_beside_gnss import LARGE_M, SIGMAS

# Events of a kind that are told one by one.
SHOWN = 3
# A reference that is good again so soon after a gap of the IMU, s, was good all the time.
COAST_OF_GAP_S = 1.0
# Why samples of a height reference are left out.
WORDS = {
    "not_finite": "not finite",
    "out_of_range": "outside the range of air pressure",
    "stamp": "whose stamp repeats or goes back",
    "gate": "too far off",
}


def _without_coasts_of_gaps(events: list[Event]) -> tuple[list[Event], list[Event]]:
    """Events without coasts that gaps of the IMU cause, not the height reference, and their ends.

    They begin at the end of a gap and are over with the next sample of the reference.
    """
    gaps = [e.time for e in events if e.kind == "imu-gap"]
    kept: list[Event] = []
    ends: list[Event] = []
    for e in events:
        begun = e.time - e.duration
        if (
            e.kind == "re-engaged"
            and kept
            and kept[-1].kind == "coast"
            and e.duration < COAST_OF_GAP_S
            and any(0.0 <= begun - end < COAST_OF_GAP_S for end in gaps)
        ):
            kept.pop()
            ends.append(e)
        else:
            kept.append(e)
    return kept, ends


def last_good(event: Event, before: float) -> float:
    """When the reference was last good at an event, s, if it was so `before` at the one before."""
    if event.kind == "coast":
        return event.time - event.size
    return event.time - event.duration if event.kind == "frozen" else before


def height_warnings(
    channel: ChannelSummary, events: list[Event], begins_s: float = 0.0
) -> list[str]:
    """Warnings about the vertical channel, which began this long after the log."""
    notes = []
    rejected = {
        name: count
        for name, count in channel.samples.items()
        if count and name not in ("accepted", "waiting", "frozen")
    }
    if rejected:
        parts = ", ".join(f"{count} {WORDS.get(name, name)}" for name, count in rejected.items())
        notes.append(f"height reference: samples were left out: {parts}")
    texts = {
        "jump": "height reference jumped by {size:+.1f} m at {time:.1f} s; the jump is taken off",
        "returned": "height reference jumped back by {size:+.1f} m at {time:.1f} s, and the height"
        " with it",
        "coast": "no good height reference from {last:.1f} s on; coasting",
        "re-engaged": "height reference is good again at {time:.1f} s, after {duration:.1f} s; the"
        " height then differed from it by {size:+.1f} m",
        "frozen": "height reference did not change for {duration:.0f} s while the vehicle moved, at"
        " {time:.1f} s; those samples are not used",
        "invalid": "height is not valid from {time:.1f} s on: coasting for too long",
        "imu-gap": "the IMU has a gap of {size:.2f} s until {time:.1f} s; height is carried over"
        " it",
    }
    events, after_gaps = _without_coasts_of_gaps(events)
    seen: Counter[str] = Counter()
    last = 0.0  # when the reference was last good
    for e in events:
        seen[e.kind] += 1
        last = last_good(e, last)
        if e.kind in texts and seen[e.kind] <= SHOWN:
            since = e.time - last if e.kind == "re-engaged" else e.duration
            times = {"time": begins_s + e.time, "last": begins_s + last, "duration": since}
            notes.append(texts[e.kind].format(size=e.size, **times))
    if after_gaps:
        largest = max((e.size for e in after_gaps), key=abs)
        notes.append(
            f"after gaps of the IMU height differed from its reference by {largest:+.1f} m"
        )
    for kind, count in seen.items():
        if kind in texts and count > SHOWN:
            notes.append(f"... and {counted(count - SHOWN, 'more event')} of this kind ({kind})")
    if not channel.samples.get("accepted"):
        notes.append("no sample of the height reference could be used: height is undamped")
    return notes


def untrusted_heights(
    events: list[Event], first_ns: int, begins_s: float, seconds: float, sigma: float
) -> list[Finding]:
    """Stretches of a run without a filter in which its height was far off, as its end shows.

    Parameters
    ----------
    first_ns : int
        Time of the run's begin, from which events count.
    begins_s : float
        The same since the begin of the log, s.
    seconds : float
        Length of the run, s.
    sigma : float
        Of the reference, m; 0 if it is not known.
    """
    least = max(LARGE_M, SIGMAS * sigma)
    found: list[Finding] = []

    def lost(begin: float, end: float, why: str, off: float) -> None:
        to = "on" if end >= seconds else f"to {begins_s + end:.1f} s"
        found.append(
            Finding(
                "height",
                f"height from {begins_s + begin:.1f} s {to} is not to be trusted: {why}",
                severity=Severity.LOST,
                start_ns=first_ns + round(begin * SECOND),
                end_ns=first_ns + round(min(end, seconds) * SECOND),
                numbers={"off_m": off} if off else {},
            )
        )

    last, good, followed, off = 0.0, True, 0.0, 0.0
    for e in _without_coasts_of_gaps(events)[0]:
        last = last_good(e, last)
        if e.kind in ("coast", "frozen"):
            good, off = False, -e.size if e.kind == "frozen" else off
        elif e.kind == "returned" and abs(e.size) > least:
            lost(
                followed, e.time, f"it followed a reference that was {-e.size:+.0f} m off", -e.size
            )
        elif e.kind == "re-engaged":
            off = max(off, e.size, key=abs)
            if abs(off) > least:
                lost(last, e.time, f"without a reference it was {off:+.0f} m off in the end", off)
            followed = e.time
        elif e.kind == "jump" and not good and e.time - last > VALID_COAST:
            lost(last, seconds, "no reference shows how far off it is", 0.0)
        if e.kind in ("re-engaged", "jump", "engaged"):
            good, off = True, 0.0
    if not good and (abs(off) > least or seconds - last > VALID_COAST):
        lost(last, seconds, "no reference shows how far off it is", 0.0)
    return found
