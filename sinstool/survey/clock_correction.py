"""Clocks of a log that were set while it was recorded: found, and undone.

Where the recorder's clock ran back, or leapt as the stamps of one topic show and those of another
do not, times of recording before that are moved to the clock as it was set, and so are the stamps
of all topics that stepped with it. Then stamps that step by themselves are: those of a sensor, or
of another computer than the recorder.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from sinstool.core.arrays import IntArray
from sinstool.core.earth import horizontal_metres
from sinstool.core.errors import UnsupportedLogError
from sinstool.core.finding import Finding, Severity
from sinstool.core.order_statistics import median
from sinstool.core.rotation import wrapped
from sinstool.core.streams import Gnss, Stream, concatenate
from sinstool.core.timeline import SECOND
from sinstool.core.units import STANDARD_GRAVITY
from sinstool.io.messages.decode import Decoder
from sinstool.io.readers.clock_steps import ChannelClocks, ClockSteps
from sinstool.io.readers.log import Log
from sinstool.io.readers.message_types import (
    FIX_TYPES,
    HEIGHT_TYPES,
    IMU_TYPE,
    JOINT_TYPE,
    MAGNETIC_TYPE,
    PRESSURE_TYPE,
    VELOCITY_TYPES,
)
from sinstool.io.readers.streams import Losses, header, read_fixes, stamp
from sinstool.io.readers.topics import OWN_PREFIXES, ImuTopic
from sinstool.io.readers.truth import PATHS
from sinstool.survey.clock_steps import (
    ALIKE,
    LEAST_NS,
    MANY,
    SURE,
    Level,
    Step,
    delay_level,
    even_level,
    leaps,
    move,
    recorder_steps,
    same_pace,
    stamp_steps,
    whole_size,
)

TYPES = {
    *FIX_TYPES,
    *HEIGHT_TYPES,
    IMU_TYPE,
    JOINT_TYPE,
    MAGNETIC_TYPE,
    PRESSURE_TYPE,
    *VELOCITY_TYPES,
    *PATHS,
}
KIND = "clock-step"
# Delays of two topics that are no more apart are by one clock.
SAME_CLOCK_NS = SECOND
NO_STEPS = ChannelClocks()
# Fixes whose velocity is compared, before and behind: those of so many seconds, or so many.
BESIDE_S, LEAST_BESIDE = 1.5, 3
# What a vehicle may accelerate by meanwhile without showing it before or after, m/s^2.
CHANGING = 0.5 * STANDARD_GRAVITY
S = TypeVar("S", bound=Stream)


@dataclass
class TopicTimes:
    """Times of a topic's messages, in the order of the file; steps are taken off as they are found.

    Attributes
    ----------
    stamp_ns : ndarray, shape (n,)
        Log times where messages have no stamp.
    place : ndarray, shape (n,)
        Number of each among all messages.
    channel, number : ndarray, shape (n,)
        Its channel, and its number among the messages of that, whole or not.
    """

    topic: str
    stamp_ns: IntArray
    log_ns: IntArray
    place: IntArray
    channel: IntArray
    number: IntArray

    def row(self, place: int) -> int:
        """Its first message that is not before a place."""
        return int(np.searchsorted(self.place, place))


def may_have_stepped(parts: Sequence[tuple[IntArray, IntArray]]) -> bool:
    """Whether times of an IMU's samples are not those of one clock.

    Parameters
    ----------
    parts : sequence of (time_ns, log_time_ns)
        In the order of the file.
    """
    for column in zip(*parts, strict=True):
        if not _leaps_somewhere(column):
            continue
        times = np.concatenate(column)
        steps = np.diff(times)
        if len(steps) and int(steps.min()) < -LEAST_NS:
            return True
        levels = (even_level(times, row) for row in leaps(times).tolist())
        if any(level is not None and level.sure for level in levels):
            return True
    return False


def _leaps_somewhere(parts: Sequence[IntArray]) -> bool:
    """Whether any interval is long or negative enough for a step."""
    last: IntArray | None = None
    for times in parts:
        steps = np.diff(times) if last is None else np.diff(times, prepend=last)
        if len(steps) and max(int(steps.max()), -int(steps.min())) > LEAST_NS:
            return True
        last = times[-1:] if len(times) else last
    return False


def remove_clock_steps(log: Log, topic: ImuTopic) -> tuple[Finding, ...]:
    """Look for steps of clocks, and have the log read without them.

    Parameters
    ----------
    log : Log
        Its columns are read without the steps from now on.
    topic : ImuTopic
        Whose samples are the beat by which steps are found.

    Returns
    -------
    tuple of Finding
        One for each step.
    """
    topics = _read(log, topic)
    imu = topics.pop(topic.topic, None)
    if imu is None:
        return ()
    others = tuple(topics.values())
    found: list[tuple[Step, str, str, Severity]] = []
    steps = (*recorder_steps(imu.log_ns), *forward_steps(log, imu, others))
    for step in sorted(steps, key=lambda one: one.row):
        right, moved = _undone_with(log, step, imu, others)
        what = (
            f"the stamps of {', '.join(moved)}" if moved else "times of recording, but no stamps,"
        )
        severity = Severity.WARNING if moved else Severity.NOTE
        found.append((right, "the clock of the recording computer", what, severity))
    for step, *_ in found:
        edge = int(imu.log_ns[step.row - 1] + imu.log_ns[step.row]) // 2
        log.recorder = log.recorder.with_step(edge, step.size_ns, step.from_there)
    for step in stamp_steps(imu.stamp_ns, imu.log_ns):
        _undo(log, imu, step, step.row, None)
        found.append((step, f"the clock that stamps {imu.topic}", "stamps", Severity.WARNING))
    found.sort(key=lambda one: one[0].row)
    return tuple(
        _finding(step, imu.stamp_ns, imu.topic, whose, what, severity)
        for step, whose, what, severity in found
    )


def own_steps(stream: S, topic: str) -> tuple[S, list[Finding]]:
    """A stream without steps of the clock that stamps it alone.

    Parameters
    ----------
    stream : Stream
        In the order of the file, its log times without steps.
    """
    steps = stamp_steps(stream.time_ns, stream.log_time_ns)
    if not steps:
        return stream, []
    time_ns = stream.time_ns.copy()
    for step in steps:
        move(time_ns, step, step.row)
    whose = f"the clock that stamps {topic}"
    findings = [_finding(step, time_ns, topic, whose) for step in steps]
    return replace(stream, time_ns=time_ns), findings


def _finding(
    step: Step,
    time_ns: IntArray,
    topic: str,
    whose: str,
    what: str = "stamps",
    severity: Severity = Severity.WARNING,
) -> Finding:
    """A finding about a step of a clock, by times without it, and what of it was moved."""
    how = f"{'back' if step.size_ns < 0 else 'forward'} by {abs(step.size_ns) / SECOND:.6g} s"
    at = (int(time_ns[step.row]) - int(time_ns[0])) / SECOND
    side = "from there on" if step.from_there else "before that"
    return Finding(
        KIND,
        f"{whose} was set {how} at {at:.1f} s: {what} {side} are moved by as much",
        severity,
        topic=topic,
        start_ns=int(time_ns[step.row]),
        numbers={"step_s": step.size_ns / SECOND},
    )


def _read(log: Log, topic: ImuTopic) -> dict[str, TopicTimes]:
    """Times of all topics that may be used, by topic."""
    prefixes = {channel.id: f"{topic.path}." if topic.path else "" for channel in topic.channels}
    for number, channel in log.channels.items():
        if channel.type in TYPES and not channel.topic.startswith(OWN_PREFIXES):
            prefixes.setdefault(number, "")
    decoders: dict[int, Decoder | None] = {}
    for number, prefix in prefixes.items():
        try:
            definition = log.channels[number].definition(log.path)
        except UnsupportedLogError:
            continue  # whoever needs it says so
        stamped = definition.has(f"{prefix}header.stamp.sec")
        decoders[number] = Decoder(definition, header(prefix)) if stamped else None
    parts: dict[str, list[tuple[IntArray, ...]]] = {}
    met, count = dict.fromkeys(decoders, 0), 0
    for batch in log.batches(list(decoders)):
        for number in np.unique(batch.channel).tolist():
            rows = np.flatnonzero(batch.channel == number)
            one, decoder = batch.rows(rows), decoders[number]
            clocks = log.clocks.get(number, NO_STEPS)
            numbers = met[number] + np.arange(len(rows))
            log_ns = one.log_time + clocks.log.moves(numbers)
            stamp_ns, valid = log_ns, np.ones(len(rows), np.bool_)
            if decoder is not None:
                decoded = decoder.decode(one.buffer, one.offset, one.length)
                stamp_ns = stamp(decoded.values) + clocks.stamp.moves(numbers)
                valid = decoded.valid
            columns = (stamp_ns, log_ns, count + rows, np.full(len(rows), number), numbers)
            mine = parts.setdefault(log.channels[number].topic, [])
            mine.append(tuple(column[valid] for column in columns))
            met[number] += len(rows)
        count += len(batch)
    return {name: _in_order(name, many) for name, many in parts.items()}


def _in_order(topic: str, parts: Sequence[tuple[IntArray, ...]]) -> TopicTimes:
    """Times of a topic's messages by their place; several channels may take turns."""
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    times = TopicTimes(topic, *columns)
    order = np.argsort(times.place, kind="stable")
    return TopicTimes(topic, *(column[order] for column in columns))


def forward_steps(log: Log, imu: TopicTimes, others: Sequence[TopicTimes]) -> Iterator[Step]:
    """Leaps of the recorder's clock that some stamps took part in, and others did not.

    Where all of them did the recorder may as well have stood still; then fixes tell whether the
    vehicle went on meanwhile.
    """
    for row in leaps(imu.log_ns).tolist():
        leap, delay = even_level(imu.log_ns, row), delay_level(imu.stamp_ns, imu.log_ns, row)
        if leap is None or delay is None or leap.rise < LEAST_NS or not leap.sure:
            continue
        if not same_pace(imu.stamp_ns, imu.log_ns, row):
            continue
        size, place = leap.rise, int(imu.place[row])
        together = _is(delay, 0.0, size)
        if not together and not _is(delay, size, size):
            continue
        expected = (size, 0.0) if together else (0.0, size)
        apart = any(_delays_rise(other, other.row(place), expected, size) for other in others)
        if apart or (together and _stood_still(log, others, place, size)):
            yield Step(row, round(size))


def _delays_rise(other: TopicTimes, row: int, expected: tuple[float, float], size: float) -> bool:
    """Whether delays of a topic, and its stamps, rise by so much each before a row."""
    late = delay_level(other.stamp_ns, other.log_ns, row)
    even = even_level(other.stamp_ns, row)
    if late is None or even is None:
        return False
    if expected[0] and not same_pace(other.stamp_ns, other.log_ns, row):
        return False
    return _is(late, expected[0], size) and _is(even, expected[1], size)


def _stood_still(log: Log, others: Sequence[TopicTimes], place: int, size: float) -> bool:
    """Whether the fixes before a place and behind are nearer to each other than a vehicle goes.

    Between its velocities before and after a vehicle is off their mean by its change of mind, as
    of half a g there and back. It must be off by more with the leap, and by less without it.
    """
    for other in others:
        channels = tuple(log.channels_of(other.topic, *FIX_TYPES))
        if not channels:
            continue
        row, count = other.row(place), 0
        rows = []
        for block in read_fixes(log, channels, Losses()):
            # Of those that fit their definition, as the times are
            near = slice(max(row - MANY - count, 0), max(row + MANY - count, 0))
            rows.append(block.rows(near))
            count += len(block)
        if row == 0 or row >= count - 1:
            return False
        fixes = concatenate(rows)
        here = min(row, MANY)
        # A fix may have been on its way when the clock was set
        here += int(np.argmax(np.diff(fixes.time_ns[here - 1 : here + 2])))
        return _too_near(fixes, here, size / SECOND)
    return False


def _too_near(fixes: Gnss, row: int, leap_s: float) -> bool:
    """Whether two fixes are too near for the time between their stamps, and not without a leap."""
    seconds = (fixes.time_ns - fixes.time_ns[row]) / SECOND
    here = fixes.latitude[row], fixes.longitude[row]
    north, east = horizontal_metres(
        fixes.latitude - here[0], wrapped(fixes.longitude - here[1]), here[0]
    )
    way = north + 1j * east
    took, gone = -float(seconds[row - 1]), way[row] - way[row - 1]
    first = min(int(np.searchsorted(seconds, -took - BESIDE_S)), row - LEAST_BESIDE)
    end = max(int(np.searchsorted(seconds, BESIDE_S, "right")), row + LEAST_BESIDE)
    if first < 0 or end > len(way) or not fixes.has_fix[first:end].all():
        return False
    if (np.diff(seconds[first:end]) <= 0.0).any():
        return False
    speed, variance = 0.0, 0.0
    sigma = float(np.sqrt(np.abs(fixes.covariance_n[first:end, :2, :2]).max()))
    for side in (slice(first, row), slice(row, end)):
        fit, off = np.polyfit(seconds[side], way[side], 1, full=True)[:2]
        sigma = max(sigma, float(np.sqrt(np.abs(off).sum() / (len(way[side]) - 2))))
        speed += 0.5 * fit[0]
        variance += 0.25 / float(np.sum((seconds[side] - seconds[side].mean()) ** 2))

    def beyond(time_s: float) -> float:
        noise = SURE * sigma * (2.0 + variance * time_s**2) ** 0.5
        return float(abs(gone - speed * time_s) - noise - 0.25 * CHANGING * time_s**2)

    return beyond(took - leap_s) < 0.0 < beyond(took)


def _is(level: Level, rise: float, size: float) -> bool:
    """Whether times rise by so much: all of a size, or nothing of it."""
    return abs(level.rise - rise) < ALIKE * size and SURE * level.noise < size


def _undone_with(
    log: Log, step: Step, imu: TopicTimes, others: Sequence[TopicTimes]
) -> tuple[Step, list[str]]:
    """Undo a step of the recorder's clock; as it is then known, and topics that stepped with it."""
    place, size = int(imu.place[step.row]), step.size_ns
    level, even = delay_level(imu.stamp_ns, imu.log_ns, step.row), even_level(imu.log_ns, step.row)
    assert level is not None and even is not None  # as of all steps
    stepped = {imu.topic: _steps_with(level, size)}
    # Stamps are steadier than times of recording
    if stepped[imu.topic]:
        size = whole_size(imu.stamp_ns, step.row, float(size), even.noise)
    else:
        size = round(level.rise)
    levels = {imu.topic: level}
    for one in others:
        at = one.row(place)
        late = delay_level(one.stamp_ns, one.log_ns, at) if 0 < at < len(one.place) else None
        if late is not None:
            levels[one.topic] = late
            stepped[one.topic] = _steps_with(late, size)
        else:
            # Too few to tell: as the IMU, if it has the same clock
            apart = float(median(one.log_ns - one.stamp_ns)) - level.before
            stepped[one.topic] = stepped[imu.topic] and abs(apart) < SAME_CLOCK_NS
    # What has another clock says when the recorder's was right; else it was set to be
    alone = [late.unlikely for topic, late in levels.items() if not stepped[topic]]
    before, behind = (sum(side) for side in zip(*alone, strict=True)) if alone else (0.0, 0.0)
    right = Step(step.row, size, before < behind)
    for one in (imu, *others):
        row = one.row(place)
        stamped = None
        if stepped[one.topic]:
            stamped = _first_stamped(one, row, levels.get(one.topic), size)
        _undo(log, one, right, stamped, row)
    return right, [topic for topic, with_it in stepped.items() if with_it]


def _steps_with(level: Level, size: float) -> bool:
    """Whether stamps step with times of recording, by what these are later than they are."""
    return abs(level.rise) < abs(level.rise - size)


def _first_stamped(one: TopicTimes, row: int, level: Level | None, size: int) -> int:
    """The first message behind a step of the recorder's clock that was stamped behind it, too.

    Others were on their way: it was set between their stamps and their recording.
    """
    if level is not None:
        late = one.log_ns[row : row + MANY] - one.stamp_ns[row : row + MANY] - level.before
        row += int(np.argmin(np.abs(late - size) < np.abs(late)))
    return row


def _undo(log: Log, times: TopicTimes, step: Step, stamped: int | None, logged: int | None) -> None:
    """Undo a step at the rows of stamps and of log times, here and where the log is read."""
    for time_ns, row in ((times.stamp_ns, stamped), (times.log_ns, logged)):
        if row is not None:
            move(time_ns, step, row)
    for channel in np.unique(times.channel).tolist():

        def undone(so_far: ClockSteps, row: int | None, number: int = channel) -> ClockSteps:
            if row is None:
                return so_far
            before = times.number[:row][times.channel[:row] == number]
            first = int(before[-1]) + 1 if len(before) else 0
            return so_far.with_step(first, step.size_ns, step.from_there)

        clocks = log.clocks.get(channel, NO_STEPS)
        log.clocks[channel] = ChannelClocks(
            undone(clocks.stamp, stamped), undone(clocks.log, logged)
        )
