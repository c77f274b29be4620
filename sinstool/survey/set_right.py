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
from sinstool.core.finding import Finding
from sinstool.core.order_statistics import median
from sinstool.core.streams import Stream
from sinstool.core.timeline import SECOND
from sinstool.io.messages.decode import Decoder
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
from sinstool.io.readers.streams import header, stamp
from sinstool.io.readers.topics import OWN_PREFIXES, ImuTopic
from sinstool.io.readers.truth import PATHS
from sinstool.io.readers.undone import Undone
from sinstool.survey.clock_steps import (
    ALIKE,
    LEAST_NS,
    SURE,
    Level,
    Step,
    delay_level,
    even_level,
    leaps,
    recorder_steps,
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
NOTHING = Undone()
OWN = "the clock that stamps {} was set {{}}: stamps before that are moved by as much"
S = TypeVar("S", bound=Stream)


@dataclass
class _Times:
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


def may_have_stepped(time_ns: IntArray, log_ns: IntArray) -> bool:
    """Whether times of an Imu's samples, in the order of the file, are not those of one clock."""
    for times in (time_ns, log_ns):
        steps = np.diff(times)
        if len(steps) and int(steps.min()) < -LEAST_NS:
            return True
        levels = (even_level(times, row) for row in leaps(times).tolist())
        if any(level is not None and level.sure for level in levels):
            return True
    return False


def set_right(log: Log, topic: ImuTopic) -> tuple[Finding, ...]:
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
    found: list[tuple[int, int, str]] = []
    steps = (*recorder_steps(imu.log_ns), *_forward(imu, others))
    for step in sorted(steps, key=lambda one: one.row):
        size, moved = _undone_with(log, step, imu, others)
        text = "the clock of the recording computer was set"
        what = f"the stamps of {', '.join(moved)}" if moved else "no stamps, but times of recording"
        found.append((step.row, size, f"{text} {{}}: {what} before that are moved by as much"))
    if found:
        edges = [int(imu.log_ns[row - 1] + imu.log_ns[row]) // 2 for row, *_ in found]
        log.recorder = log.recorder.and_also(edges, [size for _, size, _ in found])
    for step in stamp_steps(imu.stamp_ns, imu.log_ns):
        _undo(log, imu, step.row, step.size_ns, 0)
        found.append((step.row, step.size_ns, OWN.format(imu.topic)))
    return tuple(
        step_finding(text, size, imu.stamp_ns, row, imu.topic) for row, size, text in sorted(found)
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
        time_ns[: step.row] += step.size_ns
    text = OWN.format(topic)
    findings = [step_finding(text, one.size_ns, time_ns, one.row, topic) for one in steps]
    return replace(stream, time_ns=time_ns), findings


def step_finding(text: str, size_ns: int, time_ns: IntArray, row: int, topic: str) -> Finding:
    """A finding about a step; the text has a place for its size and its time."""
    size = f"{'back' if size_ns < 0 else 'forward'} by {abs(size_ns) / SECOND:.6g} s"
    at = (int(time_ns[row]) - int(time_ns[0])) / SECOND
    return Finding(
        KIND,
        text.format(f"{size} at {at:.1f} s"),
        topic=topic,
        start_ns=int(time_ns[row]),
        numbers={"step_s": size_ns / SECOND},
    )


def _read(log: Log, topic: ImuTopic) -> dict[str, _Times]:
    """Times of all topics that may be used, by topic."""
    prefixes = {channel.id: f"{topic.path}." if topic.path else "" for channel in topic.channels}
    for number, channel in log.channels.items():
        if channel.type in TYPES and not channel.topic.startswith(OWN_PREFIXES):
            prefixes.setdefault(number, "")
    decoders: dict[int, Decoder | None] = {}
    for number, prefix in prefixes.items():
        definition = log.channels[number].definition(log.path)
        stamped = definition.has(f"{prefix}header.stamp.sec")
        decoders[number] = Decoder(definition, header(prefix)) if stamped else None
    parts: dict[str, list[tuple[IntArray, ...]]] = {}
    met, count = dict.fromkeys(decoders, 0), 0
    for batch in log.batches(list(decoders)):
        for number in np.unique(batch.channel).tolist():
            rows = np.flatnonzero(batch.channel == number)
            one, decoder = batch.rows(rows), decoders[number]
            moves = log.undone.get(number, NOTHING).moves(met[number], len(rows))
            log_ns = one.log_time + moves[1]
            stamp_ns, valid = log_ns, np.ones(len(rows), np.bool_)
            if decoder is not None:
                decoded = decoder.decode(one.buffer, one.offset, one.length)
                stamp_ns, valid = stamp(decoded.values) + moves[0], decoded.valid
            numbers = met[number] + np.arange(len(rows))
            columns = (stamp_ns, log_ns, count + rows, np.full(len(rows), number), numbers)
            mine = parts.setdefault(log.channels[number].topic, [])
            mine.append(tuple(column[valid] for column in columns))
            met[number] += len(rows)
        count += len(batch)
    return {
        name: _Times(name, *(np.concatenate(column) for column in zip(*many, strict=True)))
        for name, many in parts.items()
    }


def _forward(imu: _Times, others: Sequence[_Times]) -> Iterator[Step]:
    """Leaps of the recorder's clock that some stamps took part in, and others did not.

    Where all of them did the recorder may as well have stood still.
    """
    for row in leaps(imu.log_ns).tolist():
        leap, delay = even_level(imu.log_ns, row), delay_level(imu.stamp_ns, imu.log_ns, row)
        if leap is None or delay is None or leap.rise < LEAST_NS or not leap.sure:
            continue
        size = leap.rise
        together = _is(delay, 0.0, size)
        if not together and not _is(delay, size, size):
            continue
        for other in others:
            at = other.row(int(imu.place[row]))
            if at in (0, len(other.place)):
                continue
            late = delay_level(other.stamp_ns, other.log_ns, at)
            even = even_level(other.stamp_ns, at)
            expected = (size, 0.0) if together else (0.0, size)
            if late and even and _is(late, expected[0], size) and _is(even, expected[1], size):
                yield Step(row, round(size))
                break


def _is(level: Level, rise: float, size: float) -> bool:
    """Whether times rise by so much: all of a size, or nothing of it."""
    return abs(level.rise - rise) < ALIKE * size and SURE * level.noise < size


def _undone_with(
    log: Log, step: Step, imu: _Times, others: Sequence[_Times]
) -> tuple[int, list[str]]:
    """Undo a step of the recorder's clock; its size, and topics whose stamps stepped with it."""
    place = int(imu.place[step.row])
    size = step.size_ns
    level, even = delay_level(imu.stamp_ns, imu.log_ns, step.row), even_level(imu.log_ns, step.row)
    follows = {imu.topic: level is not None and abs(level.rise) < abs(level.rise - size)}
    if level is not None and even is not None:
        # Stamps are steadier than times of recording
        if follows[imu.topic]:
            size = whole_size(imu.stamp_ns, step.row, float(size), even.noise)
        else:
            size = round(level.rise)
    for one in others:
        at = one.row(place)
        late = delay_level(one.stamp_ns, one.log_ns, at) if 0 < at < len(one.place) else None
        if late is not None:
            follows[one.topic] = abs(late.rise) < abs(late.rise - size)
        elif level is not None and len(one.place):
            # Too few to tell: as the Imu, if it has the same clock
            apart = float(median(one.log_ns - one.stamp_ns)) - level.before
            follows[one.topic] = follows[imu.topic] and abs(apart) < SAME_CLOCK_NS
    for one in (imu, *others):
        _undo(log, one, one.row(place), size if follows.get(one.topic) else 0, size)
    return size, [name for name, stepped in follows.items() if stepped]


def _undo(log: Log, times: _Times, row: int, stamp_ns: int, log_ns: int) -> None:
    """Move times before a row, here and where the log is read."""
    times.stamp_ns[:row] += stamp_ns
    times.log_ns[:row] += log_ns
    for channel in np.unique(times.channel).tolist():
        before = times.number[:row][times.channel[:row] == channel]
        first = int(before[-1]) + 1 if len(before) else 0
        log.undone[channel] = log.undone.get(channel, NOTHING).and_also(first, stamp_ns, log_ns)
