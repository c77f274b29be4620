"""GNSS of a log: the receiver and the velocity to use, checked against each other.

Every message is either used or counted, and units that cannot be right are refused with the option
that answers them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

import numpy as np

from sinstool.config import InputOptions
from sinstool.core.arrays import BoolArray, IntArray
from sinstool.core.choices import log_choice
from sinstool.core.english import counted, counted_clause
from sinstool.core.finding import Finding, Severity
from sinstool.core.streams import Gnss, Stream, Velocity
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.io.readers.log import Channel, Log
from sinstool.io.readers.message_types import GPS_FIX_TYPES, VELOCITY_TYPES
from sinstool.io.readers.streams import Losses, frame_id, read_fixes, read_velocity
from sinstool.io.readers.topics import NONE, fix_topics, optional_topics
from sinstool.survey.aiding import AidingData, in_order, only, until
from sinstool.survey.epochs import join, partners
from sinstool.survey.even_fixes import at_even_times
from sinstool.survey.fix_units import check_degrees, check_range, with_rounding
from sinstool.survey.flat_fixes import without_flat, without_held
from sinstool.survey.interpolated import interpolated, on_lines
from sinstool.survey.stuck import sent_again, stale_velocities, stuck_fixes, stuck_velocities
from sinstool.survey.velocity import Agreement, agreement, odd_frame, usual_noise

S = TypeVar("S", bound=Stream)

# Of the seconds of the receiver that has the most: one with fewer is no choice.
NEARLY_ALL = 0.8
# Beyond what any vehicle with an IMU on Earth does, though not beyond what damaged bytes say.
FASTEST_M_S = 2e4
# The kinds of finding about a velocity that is none over ground: left out, or used as configured.
LEFT_OUT, CONTRADICTS = "velocity-left-out", "velocity-contradicts"


def read_gnss(
    log: Log, options: InputOptions, log_time: bool, until_ns: int | None = None
) -> AidingData:
    """Position and velocity of a log, joined by epoch.

    Parameters
    ----------
    log_time : bool
        The run uses the recorder's times instead of stamps.
    until_ns : int, optional
        What comes later is not read; by default all of the log is.

    Raises
    ------
    TopicError, DataError
    """
    receivers = [
        _fixes(log, options, topic, channels, log_time, until_ns)
        for topic, channels in fix_topics(log, options.gnss_topic).items()
    ]
    velocity_topic = options.velocity_topic
    if velocity_topic is None and options.gnss_topic == NONE:
        velocity_topic = NONE  # who wants no GNSS wants none of the receiver
    kinds = (*VELOCITY_TYPES, *GPS_FIX_TYPES)
    speeds = optional_topics(log, "--velocity-topic", velocity_topic, *kinds)
    receiver, findings = _best_receiver(receivers, tuple(speeds))
    fixes = receiver.stream
    if fixes is not None:
        check_range(log, receiver.topic, fixes)
        # a filter that starts at a damaged one would have to believe it
        what = ("fix is not on Earth; left out", "fixes are not on Earth; left out")
        fixes, more = only(fixes, fixes.on_earth, receiver.topic, "not-on-earth", what)
        findings += more
    candidates = [
        _velocities(
            log, options, topic, channels, replace(receiver, stream=fixes), log_time, until_ns
        )
        for topic, channels in speeds.items()
    ]
    if fixes is not None and options.gnss_unit is None:
        read = next((c.stream for c in candidates if c.stream is not None), None)
        check_degrees(log, receiver.topic, fixes, read)
    named = options.velocity_topic is not None
    chosen, more = _believed_velocity(candidates, receiver.topic, named)
    findings += more
    velocity = chosen.stream
    for use, one, number, name in (
        ("gnss topic", receiver.topic, len(receivers), options.gnss_topic),
        ("velocity topic", chosen.topic, len(speeds), options.velocity_topic),
    ):
        if one and name is None:
            why = "the only one of its type" if number == 1 else "the best of its type"
            log_choice(use, f"{one}, {why}")
    if fixes is not None and velocity is not None:
        velocity, more = without_flat(fixes, velocity, chosen.topic)
        findings += more
    if fixes is not None:
        fixes, velocity, more = without_held(fixes, velocity, receiver.topic)
        findings += more
        fixes, velocity, more = _without_stuck(fixes, velocity, receiver.topic)
        findings += more
    if fixes is not None and velocity is not None and not named:
        moved = "though the fixes move on; left out"
        what = (
            f"velocity repeats an earlier one, or is zero, {moved}",
            f"velocities repeat an earlier one, or are zero, {moved}",
        )
        stale = stale_velocities(fixes, velocity)
        velocity, more = only(velocity, ~stale, chosen.topic, "stale-velocity", what)
        findings += more
    if options.gnss_stamps != "kept" and until_ns is None:
        topics = receiver.topic, chosen.topic
        fixes, velocity, more = at_even_times(
            fixes, velocity, topics, options.gnss_stamps == "even"
        )
        findings += more
    used = ((fixes, receiver.topic), (velocity, chosen.topic))
    for topic in dict.fromkeys(t for rows, t in used if rows is not None):
        findings += _compared_with_itself(log, topic)
    return AidingData(join(fixes, velocity), receiver.topic, chosen.topic, tuple(findings))


def _compared_with_itself(log: Log, topic: str) -> list[Finding]:
    """A reference that is also the receiver whose output is used."""
    if topic not in log.references:
        return []
    text = (
        f"{topic}, which --truth names, is also the GNSS that is used: errors against it do not"
        " show how good a result is that is made from it"
    )
    answer = "compare with a reference that is not used, or leave it out with --gnss-topic none"
    return [Finding("truth-used", text, answer=answer, topic=topic)]


NO_EVIDENCE = Agreement()
NEVER = np.zeros(0, np.int64)


@dataclass(frozen=True)
class _Read(Generic[S]):
    """A topic that may be used: its messages, None where it has none that are any good.

    `agreement` and `frame` are of velocities: how they fit the fixes, and what is odd about the
    names of their frames. `no_fix_ns` and `again_ns` are of fixes: when the receiver had none, and
    when it sent one again.
    """

    topic: str = ""
    stream: S | None = None
    findings: tuple[Finding, ...] = ()
    agreement: Agreement = NO_EVIDENCE
    frame: str = ""
    no_fix_ns: IntArray = field(default_factory=lambda: NEVER)
    again_ns: IntArray = field(default_factory=lambda: NEVER)


def _fixes(
    log: Log,
    options: InputOptions,
    topic: str,
    channels: tuple[Channel, ...],
    log_time: bool,
    until_ns: int | None,
) -> _Read[Gnss]:
    """Valid fixes of a topic."""
    blocks = until(_stamped(read_fixes(log, channels, Losses()), options), until_ns)
    fixes, findings = in_order(blocks, log_time, topic)
    no_fix_ns = again_ns = NEVER
    if fixes is not None:
        no_fix_ns = fixes.time_ns[~fixes.has_fix]
        what = ("message holds no fix", "messages hold no fix")
        fixes, more = only(fixes, fixes.has_fix, topic, "no-fix", what, Severity.NOTE)
        findings += more
        if fixes is None:
            text = f"topic {topic} holds no valid fix"
            findings.append(Finding("no-fixes", text, topic=topic))
    if fixes is not None and not np.isfinite(fixes.height).any():
        text = (
            f"topic {topic}: no fix has a height: that of an INS/GNSS solution begins at 0 m with a"
            " sigma of a kilometre, and only its changes mean something"
        )
        findings.append(Finding("no-heights", text, topic=topic))
    if fixes is not None and options.gnss_unit == "rad":
        degrees = {"latitude": fixes.latitude / DEGREE, "longitude": fixes.longitude / DEGREE}
        fixes = replace(fixes, **degrees)
    if fixes is not None:
        fixes, more = with_rounding(fixes, topic)
        findings += more
        again, times = sent_again(fixes)
        again_ns = fixes.time_ns[again]
        text = (
            f"fixes are earlier ones with new stamps, as the driver sends each {times:.2g} times;"
            " one of each is used"
        )
        fixes, more = only(fixes, ~again, topic, "sent-again", (text, text), Severity.NOTE)
        findings += more
    if fixes is not None:
        between, times = interpolated(fixes)
        again_ns = np.append(again_ns, fixes.time_ns[between])
        text = (
            f"fixes lie on straight lines between every {times:.0f}th, which no measurements do:"
            " they were interpolated, and only those at the ends are used"
        )
        fixes, more = only(fixes, ~between, topic, "interpolated-fixes", (text, text))
        findings += more
    return _Read(topic, fixes, tuple(findings), no_fix_ns=no_fix_ns, again_ns=again_ns)


def _stamped(blocks: Iterable[S], options: InputOptions) -> Iterator[S]:
    """Blocks with the receiver's stamps on the IMU's clock."""
    ahead_ns = round(options.gnss_clock_offset * SECOND)
    for block in blocks:
        yield replace(block, time_ns=block.time_ns - ahead_ns) if ahead_ns else block


def _best_receiver(
    receivers: list[_Read[Gnss]], velocity_topics: tuple[str, ...]
) -> tuple[_Read[Gnss], list[Finding]]:
    """The receiver of several with fixes nearly all the time and the smallest claimed noise.

    Those that claim about the same are told apart by a velocity topic beside theirs, then by rate.
    """
    seconds = {
        r.topic: 0 if r.stream is None else len(set((r.stream.time_ns // SECOND).tolist()))
        for r in receivers
    }
    enough = NEARLY_ALL * max(seconds.values(), default=0)

    def merit(r: _Read[Gnss]) -> tuple[bool, int, bool, int]:
        if r.stream is None:
            return False, 0, False, 0
        beside = r.topic.rsplit("/", 1)[0] + "/"
        sibling = any(topic.startswith(beside) for topic in velocity_topics)
        noise = round(2.0 * np.log2(usual_noise(r.stream)))
        return seconds[r.topic] >= enough, -noise, sibling, len(r.stream)

    best = max(receivers, key=merit, default=_Read[Gnss]())
    findings = list(best.findings)
    if len(receivers) > 1:
        shown = ", ".join(
            f"{r.topic} ({counted(0 if r.stream is None else len(r.stream), 'fix')}"
            + ("" if r.stream is None else f", about {usual_noise(r.stream):.2g} m")
            + ")"
            for r in receivers
        )
        findings.append(
            Finding(
                "several-receivers",
                f"several topics hold fixes: {shown}; {best.topic} is used",
                answer="--gnss-topic chooses another",
                topic=best.topic,
            )
        )
    return best, findings


def _velocities(
    log: Log,
    options: InputOptions,
    topic: str,
    channels: tuple[Channel, ...],
    receiver: _Read[Gnss],
    log_time: bool,
    until_ns: int | None,
) -> _Read[Velocity]:
    """Velocities of a topic, held against the fixes."""
    fixes = receiver.stream
    blocks = until(_stamped(read_velocity(log, channels, Losses()), options), until_ns)
    velocity, findings = in_order(blocks, log_time, topic)
    if velocity is not None:
        beyond = f"not finite or beyond {FASTEST_M_S:.0f} m/s; left out"
        what = (f"velocity is {beyond}", f"velocities are {beyond}")
        good = _of_vehicles(velocity.velocity_n)
        velocity, more = only(velocity, good, topic, "no-vehicle-velocity", what)
        findings += more
    if fixes is not None and velocity is not None:
        velocity, more = _with_a_fix(velocity, receiver, topic)
        findings += more
    fits = NO_EVIDENCE
    if fixes is not None and velocity is not None:
        # While a receiver hangs its fixes deny any velocity
        stuck = stuck_fixes(fixes)
        moving = velocity.rows(~stuck_velocities(fixes, stuck, velocity))
        fits = agreement(fixes.rows(~stuck), moving)
    odometry = channels[0].type == VELOCITY_TYPES[2]
    child = frame_id(log, channels, field="child_frame_id") if odometry else None
    frame = odd_frame(frame_id(log, channels), child)
    return _Read(topic, velocity, tuple(findings), fits, frame)


def _believed_velocity(
    candidates: list[_Read[Velocity]], fix_topic: str, named: bool
) -> tuple[_Read[Velocity], list[Finding]]:
    """The velocity to use, and findings about those left out.

    Fixes decide; where they show too little, names of frames do. One that the user names is used.
    """
    findings: list[Finding] = []
    usable = []
    for read in candidates:
        fits = read.agreement
        if read.stream is None or not (fits.contradicts or (fits.misfit is None and read.frame)):
            usable.append(read)
            continue
        reasons = [read.frame, fits.likeness]
        if fits.misfit is not None:
            reasons = [
                f"its integral differs from the fixes of {fix_topic} by {fits.misfit:.0%} of the"
                " distance",
                *reasons,
            ]
        text = f"topic {read.topic} holds no velocity over ground in east, north, up: "
        text += "; ".join(reason for reason in reasons if reason)
        numbers = {} if fits.misfit is None else {"misfit": fits.misfit}
        kind, end = LEFT_OUT, "left out"
        answer = f"--velocity-topic {read.topic} uses it anyway"
        if named:
            usable.append(read)
            kind, end = CONTRADICTS, "used, as configured"
            answer = "--velocity-topic none leaves it out"
        findings.append(
            Finding(kind, f"{text}; {end}", answer=answer, topic=read.topic, numbers=numbers)
        )
    beside = fix_topic.rsplit("/", 1)[0] + "/"

    def merit(read: _Read[Velocity]) -> tuple[bool, bool, float]:
        misfit = read.agreement.misfit
        sibling = read.topic.startswith(beside)
        return read.stream is not None, sibling, -np.inf if misfit is None else -misfit

    best = max(usable, key=merit, default=_Read[Velocity]())
    if len(usable) > 1:
        topics = ", ".join(read.topic for read in usable)
        text = f"several topics hold a velocity: {topics}; {best.topic} is used"
        answer = "--velocity-topic chooses another"
        findings.append(Finding("several-velocities", text, answer=answer, topic=best.topic))
    return best, [*best.findings, *findings]


def _with_a_fix(
    velocity: Velocity, receiver: _Read[Gnss], topic: str
) -> tuple[Velocity | None, list[Finding]]:
    """Velocities but for those of epochs at which their receiver measured nothing.

    Without a fix drivers go on sending a velocity, of zero or of before, that claims any accuracy.
    """
    repeats = np.append(False, (velocity.velocity_n[1:] == velocity.velocity_n[:-1]).all(axis=1))
    repeats |= on_lines(velocity.time_ns, velocity.velocity_n[:, :2])
    none = _stamped_at(velocity, receiver.no_fix_ns)
    again = _stamped_at(velocity, receiver.again_ns) & repeats & ~none
    stamped = "stamped as messages that hold no fix; left out"
    what = (f"velocity is {stamped}", f"velocities are {stamped}")
    kept, findings = only(velocity, ~none, topic, "no-fix-velocity", what, Severity.NOTE)
    if kept is not None:
        kept, _ = only(kept, ~again[~none], topic, "", ("", ""))  # told of their fixes
    return kept, findings


def _stamped_at(velocity: Velocity, times_ns: IntArray) -> BoolArray:
    """Velocities of the epochs at some times, shape (m,)."""
    at = np.zeros(len(velocity), np.bool_)
    if len(times_ns):
        partner, together = partners(times_ns, velocity.time_ns)
        at[partner[together]] = True
    return at


def _of_vehicles(velocity_n: np.ndarray) -> np.ndarray:
    """Plausible velocities of a vehicle, including those without a vertical part."""
    level = (np.abs(velocity_n[:, :2]) < FASTEST_M_S).all(axis=1)
    return np.asarray(level & ~(np.abs(velocity_n[:, 2]) >= FASTEST_M_S))


def _without_stuck(
    fixes: Gnss, velocity: Velocity | None, topic: str
) -> tuple[Gnss, Velocity | None, list[Finding]]:
    """Remove fixes that a frozen receiver repeats."""
    stuck = stuck_fixes(fixes)
    count = int(np.count_nonzero(stuck))
    if not count:
        return fixes, velocity, []
    if velocity is not None:
        velocity = velocity.rows(~stuck_velocities(fixes, stuck, velocity))
    at = np.flatnonzero(stuck)
    seconds = (fixes.time_ns[at] - fixes.time_ns[at - 1]).sum() * 1e-9
    repeat = counted_clause(count, "fix", "repeats", "repeat")
    text = (
        f"topic {topic}: the receiver hangs for {seconds:.1f} s in all, as {repeat} an earlier one,"
        " although the next ones are far away; left out"
    )
    numbers = {"messages": count, "seconds": float(seconds)}
    finding = Finding(
        "stuck-fixes",
        text,
        topic=topic,
        start_ns=int(fixes.time_ns[at[0]]),
        end_ns=int(fixes.time_ns[at[-1]]),
        numbers=numbers,
    )
    return fixes.rows(~stuck), velocity, [finding]
