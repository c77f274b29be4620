"""A turntable rig's log: raw gyros, accelerometers and encoder, and the turns found in it.

A rig's Imu topic holds the raw triad, so nothing that `process` asks of a vehicle's log (axes,
units by the size of gravity, stillness) applies; the stretches at constant rate are found by the
encoder alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from sinstool.config import InputOptions
from sinstool.core.errors import AlignmentError, DataError, SinstoolError, TopicError
from sinstool.core.streams import Encoder, Imu, Stream
from sinstool.core.timeline import whole
from sinstool.core.units import DEGREE, STANDARD_GRAVITY
from sinstool.io.readers.log import Log
from sinstool.io.readers.message_types import JOINT_TYPE
from sinstool.io.readers.streams import ImuUnits, Losses, joint_names, read_imu, read_joint
from sinstool.io.readers.topics import ImuTopic, choose_imu, choose_optional
from sinstool.methods.hse import status
from sinstool.methods.hse.encoder import TableAngle, table_angle
from sinstool.methods.hse.rig import Rig
from sinstool.methods.hse.segments import Segment, Segmentation, SegmentRules, find_segments
from sinstool.methods.hse.turns import TurnStatistics, turn_statistics
from sinstool.survey.imu import within
from sinstool.survey.source import time_span

S = TypeVar("S", bound=Stream)
Progress = Callable[[int], None]


@dataclass(frozen=True)
class RigLog:
    """Samples of a rig's log as they are in it, by time.

    Attributes
    ----------
    imu : Imu
        Raw: axes of the log, rad/s and m/s^2.
    encoder : Encoder
        Readings in the unit of the log.
    counts : dict
        What was left out, by reason.
    damaged : bool
        Messages were malformed or not finite.
    """

    log: Log
    topic: ImuTopic
    imu: Imu
    encoder: Encoder
    encoder_topic: str
    counts: dict[str, int]
    damaged: bool = False

    @property
    def start_ns(self) -> int:
        """Stamp of the first sample."""
        return int(self.imu.time_ns[0])


@dataclass(frozen=True)
class RigTurns:
    """Stretches at constant rate of one log.

    Attributes
    ----------
    source : str
        The log's name.
    segmentation : Segmentation
        What is used and what is not, and why.
    turns : list of TurnStatistics
        One for each of the segments in use.
    counts : dict
        Of :class:`RigLog`.
    damaged : bool
        Messages were left out because they could not be used.
    """

    source: str
    start_ns: int
    pieces: list[TableAngle]
    segmentation: Segmentation
    turns: list[TurnStatistics]
    counts: dict[str, int]
    damaged: bool = False

    @property
    def segments(self) -> list[Segment]:
        """Segments in use."""
        return self.segmentation.used


def read_rig_log(
    log: Log, rig: Rig, options: InputOptions, progress: Progress | None = None
) -> RigLog:
    """Read gyros, accelerometers and encoder.

    Parameters
    ----------
    options : InputOptions
        Topics, units and span of time; axes are the rig's.
    progress : callable, optional
        Called with the bytes read.

    Raises
    ------
    TopicError, DataError
        A topic is missing or empty, or the encoder's joint is not in it.
    """
    counts: dict[str, int] = {}
    topic = choose_imu(log, options.imu_topic)
    units = ImuUnits(
        "frd",
        DEGREE if options.gyro_unit == "deg/s" else 1.0,
        STANDARD_GRAVITY if options.accel_unit == "g" else 1.0,
    )
    losses = Losses()
    channels = choose_optional(log, "--encoder-topic", options.encoder_topic, JOINT_TYPE)
    if not channels:
        raise _without_encoder(log, rig, [])
    blocks = read_imu(log, topic.channels, units, losses, path=topic.path, progress=progress)
    span = time_span(log, options)
    read = list(blocks)
    if not read:
        raise DataError(log.path, f"topic {topic.topic} has no usable Imu message")
    first_ns = int(read[0].time_ns[0])
    begin, end = span(first_ns) if span else (None, None)
    imu = _by_time(within(read, begin, end), counts, topic.topic)
    if imu is None:
        raise DataError(
            log.path, f"topic {topic.topic} has no usable Imu message between --start and --end"
        )
    _count(losses, topic.topic, counts)
    joint = rig.encoder.joint
    names = joint_names(log, channels)
    if not joint and len(names) == 1:
        joint = names[0]
    if joint not in names:
        raise _without_encoder(log, rig, names)
    reading = Losses()
    encoder = _by_time(read_joint(log, channels, joint, reading), counts, channels[0].topic)
    if encoder is None:
        raise _without_encoder(log, rig, names)
    _count(reading, channels[0].topic, counts)
    damaged = any(part.malformed or part.nonfinite for part in (losses, reading))
    return RigLog(log, topic, imu, encoder, channels[0].topic, counts, damaged)


def _without_encoder(log: Log, rig: Rig, names: list[str]) -> TopicError:
    finding = status.no_encoder(str(log.path), rig.encoder.joint, names)
    error = TopicError(log.path, finding.message.removeprefix(f"{log.path}: "), finding.hint)
    error.exit_code = finding.exit_code
    return error


def _count(losses: Losses, topic: str, counts: dict[str, int]) -> None:
    for count, name in ((losses.malformed, "malformed"), (losses.nonfinite, "not finite")):
        if count:
            counts[f"{topic} {name}"] = count


def _by_time(blocks: Iterable[S], counts: dict[str, int], topic: str) -> S | None:
    """All of a stream by stamp, without repeated ones."""
    found = whole(blocks)
    if found is None:
        return None
    if found.backward:
        counts[f"{topic} out of order"] = found.backward
    if found.repeated:
        counts[f"{topic} repeated stamps"] = found.repeated
    return found.stream


def find_turns(rig_log: RigLog, rig: Rig, rules: SegmentRules, name: str = "") -> RigTurns:
    """Segments of a rig's log and the sums over their turns.

    Parameters
    ----------
    name : str
        What to call the log; by default its file's name.

    Raises
    ------
    AlignmentError
        With the name of the log: the encoder or the stamps cannot be used.
    """
    path = rig_log.log.path
    try:
        pieces = table_angle(
            rig_log.imu.time_ns,
            rig_log.encoder.time_ns,
            rig_log.encoder.position,
            rig.encoder,
            rig.imu_stamp,
        )
        found = find_segments(pieces, rules)
        turns = [
            turn_statistics(pieces[s.piece], s, rig_log.imu.gyro, rig_log.imu.accel)
            for s in found.used
        ]
    except AlignmentError as exc:
        raise AlignmentError(f"{path}: {exc.message}", exc.hint) from exc
    return RigTurns(
        name or path.stem, rig_log.start_ns, pieces, found, turns, rig_log.counts, rig_log.damaged
    )


def nothing_to_use(turns: RigTurns, path: Path, rules: SegmentRules) -> SinstoolError:
    """Why a log has no stretch that can be aligned on."""
    rejected = turns.segmentation.rejected
    rates = np.abs(turns.segmentation.block_rate)
    seen = float(np.median(rates)) if len(rates) else 0.0
    if seen < rules.min_rate:
        still = AlignmentError(
            f"{path}: the encoder turns at {seen / DEGREE:.2f} deg/s (median), so that there is no"
            " stretch to align on",
            "record with the table turning, or look at rig.encoder.unit and rig.encoder.joint",
        )
        still.exit_code = status.EXIT_INSUFFICIENT
        return still
    longest = max((s.turns for s in rejected), default=0.0)
    reasons = [f"{max(s.start_s, 0.0):.1f} s: {s.reason}" for s in rejected if s.turns >= 1.0][:3]
    if longest >= rules.min_turns:
        unfit = AlignmentError(
            f"{path}: no stretch at constant rate will do ({'; '.join(reasons)})",
            "record longer, or look at --settle, --min-duration and --skip-warmup",
        )
        unfit.exit_code = status.EXIT_INSUFFICIENT
        return unfit
    finding = status.no_whole_turn(str(path), longest, rules.min_turns)
    why = f" ({'; '.join(reasons)})" if reasons else ""
    error = AlignmentError(finding.message + why, finding.hint)
    error.exit_code = finding.exit_code
    return error
