"""The magnetometer of a log: its topic and its measurements."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from sinstool.core.errors import UnsupportedLogError
from sinstool.core.finding import Finding
from sinstool.core.streams import Magnetometer
from sinstool.core.timeline import SECOND, sorted_stream
from sinstool.io.readers.log import Channel, Log
from sinstool.io.readers.message_types import MAGNETIC_TYPE
from sinstool.io.readers.streams import Losses, frame_id, read_field
from sinstool.io.readers.topics import NONE, ImuTopic, optional_topics, unread_clause

# Samples closer together are averaged, so that those of a log take little more memory than its
# epochs. In this time bodies hardly turn: at 10 rad/s the mean is 0.2 % too small.
BIN_S = 0.02
# The Earth's field is 22 to 67 uT; magnetised iron in the body adds to it, or subtracts, T.
SIZES = (15e-6, 100e-6)
# A tesla in the units that logs use, and their names.
TESLA = {"T": 1.0, "G": 1e4, "uT": 1e6, "mG": 1e7, "nT": 1e9}


@dataclass(frozen=True)
class MagneticTopic:
    """The topic of a magnetometer.

    Attributes
    ----------
    topic : str
        '' for none.
    reason : str
        Why, as the end of a sentence: "as the log has ...".
    doubtful : bool
        There were several, and the log hardly shows which to use.
    """

    topic: str
    reason: str
    channels: tuple[Channel, ...] = ()
    doubtful: bool = False


def magnetic_channels(log: Log) -> list[int]:
    """Channels of magnetometers, except those that sinstool wrote."""
    topics = optional_topics(log, "--magnetometer", None, MAGNETIC_TYPE)
    return [channel.id for channels in topics.values() for channel in channels]


def choose_magnetometer(
    log: Log, name: str | None, imu: ImuTopic, body_frame: str
) -> MagneticTopic:
    """The magnetometer that belongs to an IMU.

    Of several the one in the IMU's frame, and of those the one whose name has most in common with
    the IMU's.

    Parameters
    ----------
    name : str, optional
        ``--magnetometer``.
    body_frame : str
        Frame id of its messages.

    Raises
    ------
    TopicError
        The named topic is missing or of another type.
    """
    topics = optional_topics(log, "--magnetometer", name, MAGNETIC_TYPE)
    if name is not None:
        (channels,) = topics.values() or ((),)
        return MagneticTopic("" if name == NONE else name, "as configured", channels)
    if not topics:
        unread = unread_clause(log, MAGNETIC_TYPE)
        return MagneticTopic("", f"as the log has no MagneticField topic{unread}")
    if len(topics) == 1:
        ((topic, channels),) = topics.items()
        return MagneticTopic(topic, "the log's only MagneticField topic", channels)
    frames = {t: _frame(log, c) for t, c in topics.items()}
    same = [t for t in topics if frames[t] and frames[t] == body_frame.lstrip("/")]
    if len(same) == 1:
        reason = f"of {len(topics)} the only one in the IMU's frame, {body_frame}"
        return MagneticTopic(same[0], reason, topics[same[0]])
    shared = {t: _shared(t, imu.topic) for t in same or topics}
    most = max(shared.values())
    best = [t for t in shared if shared[t] == most]
    if len(best) == 1:
        reason = f"of {len(topics)} the one whose name most resembles that of {imu.topic}"
        return MagneticTopic(best[0], reason, topics[best[0]])
    shown = ", ".join(topics)
    return MagneticTopic("", f"as the log does not show which is meant of {shown}", doubtful=True)


def _frame(log: Log, channels: tuple[Channel, ...]) -> str:
    """Frame of a topic's messages; '' where it has none or they cannot be read."""
    try:
        return frame_id(log, channels).lstrip("/")
    except UnsupportedLogError:
        return ""


def _shared(one: str, other: str) -> int:
    """How many parts of their names two topics have in common, from the left."""
    pairs = zip(one.split("/"), other.split("/"), strict=False)
    return len(list(takewhile(lambda pair: pair[0] == pair[1], pairs)))


def read_magnetometer(
    log: Log, topic: MagneticTopic, axes: str, log_time: bool
) -> tuple[Magnetometer | None, list[Finding]]:
    """The field over time, in tesla, at the rate that epochs need.

    Parameters
    ----------
    axes : {'flu', 'frd'}
    log_time : bool
        Take the recorder's times for stamps.

    Returns
    -------
    Magnetometer or None
        None where there is not one usable sample.
    findings : list of Finding
    """
    losses = Losses()
    blocks = read_field(log, topic.channels, axes, losses)
    try:
        ordered = sorted_stream(_thinned(blocks, log_time), log_time, True)
    except UnsupportedLogError as exc:
        return None, [Finding("no-field", f"the magnetometer cannot be read: {exc}")]
    problem = f" ({losses.problem})" if losses.problem else ""
    if ordered is None:
        text = f"topic {topic.topic} holds no field that is finite and not zero{problem}"
        return None, [Finding("no-field", text, topic=topic.topic)]
    findings = []
    bad = losses.nonfinite + losses.malformed
    if bad:
        text = f"topic {topic.topic}: {bad} fields are zero, not finite or damaged{problem}"
        numbers = {"messages": float(bad)}
        findings.append(Finding("bad-fields", text, topic=topic.topic, numbers=numbers))
    measured = ordered.stream
    size = float(np.median(np.linalg.norm(measured.field, axis=1)))
    unit = suspected_unit(size)
    if unit != "T":
        measured = replace(measured, field=measured.field / TESLA[unit])
        text = (
            f"topic {topic.topic}: the field is {size:.4g} in size, which is the Earth's in {unit},"
            " not in tesla; converted"
        )
        findings.append(
            Finding("field-unit", text, topic=topic.topic, numbers={"size_T": size / TESLA[unit]})
        )
    return measured, findings


def suspected_unit(size: float) -> str:
    """The unit with which the size of a field would be the Earth's; T if no unit does that."""
    return next((u for u, n in TESLA.items() if SIZES[0] <= size / n < SIZES[1]), "T")


def _thinned(blocks: Iterator[Magnetometer], log_time: bool) -> Iterator[Magnetometer]:
    """Means of samples that lie in the same short span."""
    for block in blocks:
        times = block.log_time_ns if log_time else block.time_ns
        span = times // round(BIN_S * SECOND)
        first = np.flatnonzero(np.concatenate(([True], np.diff(span) != 0)))
        count = np.diff(first, append=len(times))
        field = np.add.reduceat(block.field, first, axis=0) / count[:, None]
        middle, logged = (
            column[first]
            + np.add.reduceat(column - np.repeat(column[first], count), first) // count
            for column in (block.time_ns, block.log_time_ns)
        )
        yield Magnetometer(middle, logged, field)
