"""A turntable rig's log: raw gyros, accelerometers and encoder, and its turns.

A rig's IMU topic holds the raw triad, so nothing that `process` asks of a vehicle's log (axes,
units by the size of gravity, stillness) applies; the stretches at constant rate are found by the
encoder alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sinstool.config import InputOptions
from sinstool.core.arrays import BoolArray, FloatArray
from sinstool.core.english import counted
from sinstool.core.errors import AlignmentError, DataError, TopicError
from sinstool.core.finding import Finding, Severity
from sinstool.core.streams import Encoder, Imu
from sinstool.core.timeline import SortedStream, sorted_stream
from sinstool.core.units import DEGREE
from sinstool.io.readers.log import Log
from sinstool.io.readers.message_types import JOINT_TYPE
from sinstool.io.readers.streams import Losses, joint_names, read_imu, read_joint
from sinstool.io.readers.topics import ImuTopic, choose_imu, choose_optional
from sinstool.methods.hse.agreement import StampedAngle, stamped_angles
from sinstool.methods.hse.encoder import TableAngle, table_angle
from sinstool.methods.hse.rig import Rig
from sinstool.methods.hse.segments import (
    Segment,
    Segmentation,
    SegmentRules,
    TurnStatistics,
    find_segments,
    turn_statistics,
)
from sinstool.methods.hse.time_grid import LONGEST_FILLED_S, filled
from sinstool.survey.clock_correction import may_have_stepped, remove_clock_steps
from sinstool.survey.imu import within
from sinstool.survey.no_measurements import LeftOut, Suspects
from sinstool.survey.oddities import no_measurements
from sinstool.survey.source import imu_units, time_span

Progress = Callable[[int], None]


class EncoderError(TopicError):
    """The log lacks the joint that the rig names."""

    exit_code = 2


class TurnsError(AlignmentError):
    """The log has no stretch at constant rate that can be aligned on."""

    exit_code = 3


@dataclass(frozen=True)
class MessageCounts:
    """Messages of a topic that were left out, or were not in order.

    Attributes
    ----------
    repeated : int
        Left out, as their stamps are those of others.
    """

    topic: str
    backward: int
    repeated: int
    malformed: int
    not_finite: int

    @classmethod
    def of(
        cls, topic: str, losses: Losses, ordered: SortedStream[Imu] | SortedStream[Encoder]
    ) -> MessageCounts:
        """Counts of the losses in reading and in sorting."""
        return cls(topic, ordered.backward, ordered.repeated, losses.malformed, losses.nonfinite)

    def findings(self) -> list[Finding]:
        """One for each reason."""
        reasons = (
            ("out of order", self.backward, Severity.WARNING),
            ("repeated stamps", self.repeated, Severity.WARNING),
            ("malformed", self.malformed, Severity.LOST),
            ("not finite", self.not_finite, Severity.LOST),
        )
        return [
            Finding(
                "left-out",
                f"{counted(n, 'message')} of {self.topic} {why}",
                severity,
                topic=self.topic,
            )
            for why, n, severity in reasons
            if n
        ]


@dataclass(frozen=True)
class RigLog:
    """Samples of a rig's log as they are in it, by time.

    Attributes
    ----------
    imu : Imu
        Raw: axes of the log, rad/s and m/s^2; with short gaps filled.
    made : ndarray of bool, shape (n,)
        Samples that are not in the log: see :func:`~sinstool.methods.hse.time_grid.filled`.
    encoder : Encoder
        Readings in the unit of the log.
    left_out : LeftOut or None
        Samples that are no measurements, and are as if they had not been recorded.
    clock_steps : tuple of Finding
        Clocks that were set while the log was recorded: all is read without these steps.
    """

    log: Log
    topic: ImuTopic
    imu: Imu
    made: BoolArray
    encoder: Encoder
    imu_counts: MessageCounts
    encoder_counts: MessageCounts
    left_out: LeftOut | None = None
    clock_steps: tuple[Finding, ...] = ()

    @property
    def start_ns(self) -> int:
        """Stamp of the first sample."""
        return int(self.imu.time_ns[0])

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Messages that were left out, put in order or lost, and clocks that were set."""
        topic = self.imu_counts.topic
        return (
            *self.clock_steps,
            *self.imu_counts.findings(),
            *(replace(one, topic=topic) for one in no_measurements(self.left_out)),
            *self.encoder_counts.findings(),
            *self._filled(),
        )

    def _filled(self) -> list[Finding]:
        count = int(np.count_nonzero(self.made))
        if not count:
            return []
        topic = self.imu_counts.topic
        text = (
            f"{count} of {len(self.made)} samples of {topic} are missing, in gaps of up to"
            f" {LONGEST_FILLED_S:g} s, and were replaced by straight lines between their neighbours"
        )
        return [Finding("gaps", text, topic=topic)]


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
    findings : tuple of Finding
        Of :class:`RigLog`.
    """

    source: str
    start_ns: int
    pieces: list[TableAngle]
    segmentation: Segmentation
    turns: list[TurnStatistics]
    findings: tuple[Finding, ...]

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
    topic = choose_imu(log, options.imu_topic)
    units = replace(imu_units(options), body_axes="frd")
    channels = choose_optional(log, "--encoder-topic", options.encoder_topic, JOINT_TYPE)
    if not channels:
        raise _without_encoder(log, rig, [])

    def samples(progress: Progress | None = None) -> tuple[list[Imu], Losses]:
        losses = Losses()
        blocks = read_imu(log, topic.channels, units, losses, path=topic.path, progress=progress)
        return list(blocks), losses

    span = time_span(log, options)
    read, losses = samples(progress)
    clock_steps: tuple[Finding, ...] = ()
    if may_have_stepped([(block.time_ns, block.log_time_ns) for block in read]):
        clock_steps = remove_clock_steps(log, topic)
        if clock_steps:
            read, losses = samples()
    if not read:
        raise DataError(log.path, f"topic {topic.topic} has no usable Imu message")
    first_ns = int(read[0].time_ns[0])
    begin, end = span(first_ns) if span else (None, None)
    imu = sorted_stream(within(read, begin, end))
    if imu is None:
        raise DataError(
            log.path, f"topic {topic.topic} has no usable Imu message between --start and --end"
        )
    joint = rig.encoder.joint
    names = joint_names(log, channels)
    if not joint and len(names) == 1:
        joint = names[0]
    if joint not in names:
        raise _without_encoder(log, rig, names)
    encoder_losses = Losses()
    encoder = sorted_stream(read_joint(log, channels, joint, encoder_losses))
    if encoder is None:
        raise EncoderError(log.path, f"joint {joint!r} has no usable JointState message")
    measured, left_out = _measured(imu.stream)
    filled_up, made = filled(measured)
    return RigLog(
        log,
        topic,
        filled_up,
        made,
        encoder.stream,
        MessageCounts.of(topic.topic, losses, imu),
        MessageCounts.of(channels[0].topic, encoder_losses, encoder),
        left_out,
        clock_steps,
    )


def _measured(imu: Imu) -> tuple[Imu, LeftOut | None]:
    """Samples without those that are no measurements."""
    suspects = Suspects()
    whole = list(suspects.watch(iter([imu])))
    left_out = suspects.found()
    if left_out is None:
        return imu, None
    return next(left_out.applied(iter(whole)), imu), left_out


def _without_encoder(log: Log, rig: Rig, names: list[str]) -> TopicError:
    if not names:
        return EncoderError(
            log.path,
            "the log has no JointState messages, so no angle of the turntable",
            "record its encoder, or name the topic with --encoder-topic",
        )
    what = f"has no joint {rig.encoder.joint!r}" if rig.encoder.joint else "has several joints"
    return EncoderError(
        log.path,
        f"the log {what} for the turntable's encoder: it has {', '.join(names)}",
        "set joint in [rig.encoder]",
    )


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
        segmentation = find_segments(pieces, rules)
        turns = [
            turn_statistics(pieces[s.piece], s, rig_log.imu.gyro, rig_log.imu.accel)
            for s in segmentation.used
        ]
    except AlignmentError as exc:
        raise AlignmentError(f"{path}: {exc.message}", exc.hint) from exc
    return RigTurns(
        name or path.stem, rig_log.start_ns, pieces, segmentation, turns, rig_log.findings
    )


def angles_at_stamps(rig_log: RigLog, rig: Rig, turns: RigTurns) -> list[StampedAngle]:
    """The table's angle at the stamps of samples, and where the gyros deny it, for each piece.

    Parameters
    ----------
    turns : RigTurns
        Of the log, with a stretch in use at least.
    """
    imu, encoder = rig_log.imu, rig_log.encoder
    read = table_angle(
        imu.time_ns, encoder.time_ns, encoder.position, rig.encoder, rig.imu_stamp, smoothing_s=0.0
    )
    axial = (imu.gyro - rig.gyro_bias) @ rig.gyro_to_b[2]
    latitude = rig.require_latitude()
    return stamped_angles(turns.pieces, read, turns.segments, axial, latitude, rig.imu_stamp)


def denied_angles(
    rig_log: RigLog, turns: RigTurns, angles: Sequence[StampedAngle], withheld: bool = False
) -> list[Finding]:
    """That the gyros deny the encoder at some samples of a log, if so.

    Parameters
    ----------
    withheld : bool, optional
        Attitudes are, so that something is lost; what is measured over turns leaves the stretches
        out in which the encoder does not go on steadily.
    """
    seconds: list[FloatArray] = []
    off: list[FloatArray] = []
    for piece, angle in zip(turns.pieces, angles, strict=True):
        made = rig_log.made[piece.first : piece.first + len(piece)]
        rows = np.flatnonzero(angle.denied & ~made)
        seconds.append(np.asarray(piece.start_s + rows * piece.interval_s))
        off.append(np.abs(angle.off[rows]))
    when, by = np.maximum(np.concatenate(seconds), 0.0), np.concatenate(off)
    if not len(when):
        return []
    text = (
        f"at {counted(len(when), 'sample')} from {when.min():.1f} to {when.max():.1f} s the gyros"
        f" deny the encoder's angle, by up to {by.max() / DEGREE:.2f} deg: it hung or leapt, gives"
        " too few readings, a clock was set, or the base was turned"
        + ("; they get no attitude" * withheld)
    )
    return [
        Finding(
            "encoder",
            text,
            Severity.LOST if withheld else Severity.WARNING,
            "look at the encoder and its stamps",
            topic=rig_log.encoder_counts.topic,
            numbers={"samples": float(len(when))},
        )
    ]


def nothing_to_use(turns: RigTurns, path: Path, rules: SegmentRules) -> TurnsError:
    """Error for a log without a stretch to align on."""
    rejected = turns.segmentation.rejected
    rates = np.abs(turns.segmentation.block_rate)
    seen = float(np.median(rates)) if len(rates) else 0.0
    if seen < rules.min_rate:
        return TurnsError(
            f"{path}: the encoder turns at {seen / DEGREE:.2f} deg/s (median), so that there is no"
            " stretch to align on",
            "record with the table turning, or look at rig.encoder.unit and rig.encoder.joint",
        )
    longest = max((s.turns for s in rejected), default=0.0)
    reasons = [f"{max(s.start_s, 0.0):.1f} s: {s.reason}" for s in rejected if s.turns >= 1.0][:3]
    if longest >= rules.min_turns:
        return TurnsError(
            f"{path}: no stretch at constant rate will do ({'; '.join(reasons)})",
            "record longer, or look at --settle, --min-duration and --skip-warmup",
        )
    why = f" ({'; '.join(reasons)})" if reasons else ""
    return TurnsError(
        f"{path}: the longest stretch at constant rate has {longest:.1f} turns, {rules.min_turns}"
        f" whole ones are needed{why}",
        "record longer at one rate, or lower --min-turns or --settle",
    )
