"""Aiding data of an IMU: the barometer of a log, and functions for all such streams.

They are slow beside the IMU's, so they are read whole. Every message is either used or counted, and
units that cannot be right are refused with the option that answers them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from sinstool.config import InputOptions
from sinstool.core.english import counted, counted_clause
from sinstool.core.errors import DataError, SinstoolError, TopicError
from sinstool.core.finding import Finding, Severity
from sinstool.core.streams import Baro, BaroHeight, GnssEpochs, Stream, concatenate
from sinstool.core.timeline import sorted_stream
from sinstool.io.readers.log import Channel, Log
from sinstool.io.readers.message_types import (
    FIX_TYPES,
    HEIGHT_TYPES,
    JOINT_TYPE,
    PRESSURE_TYPE,
    VELOCITY_TYPES,
)
from sinstool.io.readers.streams import Losses, read_height, read_pressure
from sinstool.io.readers.topics import OWN_PREFIXES, choose_optional
from sinstool.survey.clock_correction import own_steps
from sinstool.survey.wheels import WheelSpeeds

S = TypeVar("S", bound=Stream)
WARNING = Severity.WARNING

PASCALS = {"Pa": 1.0, "hPa": 100.0, "kPa": 1000.0, "inHg": 3386.389}


@dataclass(frozen=True)
class Barometer:
    """A barometer, or heights, of a log.

    Attributes
    ----------
    stream : Baro or BaroHeight or None
        By time; values that no atmosphere has are still in it. None where the log has none.
    problem : SinstoolError or None
        Why it cannot be read, to be raised where it is needed.
    """

    stream: Baro | BaroHeight | None = None
    topic: str = ""
    findings: tuple[Finding, ...] = ()
    problem: SinstoolError | None = None


@dataclass(frozen=True)
class AidingData:
    """GNSS, barometer and wheels of a run.

    Attributes
    ----------
    gnss : GnssEpochs or None
        Epochs with a position or a velocity at least, by time.
    fix_topic, velocity_topic : str
        Where they come from; '' where the log has none.
    findings : tuple of Finding
        What was odd about them, or left out.
    """

    gnss: GnssEpochs | None = None
    fix_topic: str = ""
    velocity_topic: str = ""
    findings: tuple[Finding, ...] = ()
    barometer: Barometer = field(default_factory=Barometer)
    wheels: WheelSpeeds = field(default_factory=WheelSpeeds)


def aiding_channels(log: Log, barometer: bool, wheels: bool) -> list[int]:
    """Channels that GNSS may be read from, and if need be these, but for outputs of ours."""
    types = {*FIX_TYPES, *VELOCITY_TYPES}
    if barometer:
        types |= {PRESSURE_TYPE, *HEIGHT_TYPES}
    if wheels:
        types.add(JOINT_TYPE)
    return [
        number
        for number, channel in log.channels.items()
        if channel.type in types and not channel.topic.startswith(OWN_PREFIXES)
    ]


def read_barometer(log: Log, options: InputOptions, log_time: bool) -> Barometer:
    """Pressure or height of a log, with its problems for later report."""
    try:
        return _barometer(log, options, log_time)
    except (TopicError, DataError) as exc:
        return Barometer(problem=exc)


def _barometer(log: Log, options: InputOptions, log_time: bool) -> Barometer:
    heights = options.baro_kind == "height"
    types = HEIGHT_TYPES if heights else (PRESSURE_TYPE,)
    channels = choose_optional(log, "--baro-topic", options.baro_topic, *types)
    if not channels:
        return Barometer()
    topic = channels[0].topic
    if heights:
        levels = read_height(log, channels, Losses())
        stream, findings = in_order(levels, log_time, topic, repeats=True)
        return Barometer(stream, topic, tuple(findings))
    pressures = read_pressure(log, channels, Losses())
    baro, findings = in_order(pressures, log_time, topic, repeats=True)
    if baro is not None and options.baro_topic is None and not (baro.pressure > 0.0).any():
        # Nobody asked for it
        text = f"topic {topic} holds no pressure that is positive; left out"
        return Barometer(None, "", (_counted("no-pressures", text, topic, len(baro)),))
    if baro is not None and options.baro_unit is None:
        _check_pressure(log, channels[0], baro)
    elif baro is not None and options.baro_unit is not None:
        scale = PASCALS[options.baro_unit]
        baro = replace(baro, pressure=baro.pressure * scale, variance=baro.variance * scale**2)
    return Barometer(baro, topic, tuple(findings))


def until(blocks: Iterable[S], until_ns: int | None) -> Iterator[S]:
    """Blocks up to the first that lies after a time altogether, if there is one."""
    for block in blocks:
        if until_ns is not None and len(block) and int(block.time_ns.min()) > until_ns:
            return
        yield block


def in_order(
    blocks: Iterable[S], log_time: bool, topic: str, repeats: bool = False
) -> tuple[S | None, list[Finding]]:
    """A whole stream sorted by time: its clock's steps, and counts of late and repeated."""
    parts = [block for block in blocks if len(block)]
    if not parts:
        return None, []
    whole = concatenate(parts)
    findings: list[Finding] = []
    del parts
    if not log_time and _unstamped(whole):
        log_time = True
        text = (
            f"topic {topic}: all header stamps are {int(whole.time_ns[0])} ns, so the recorder's"
            " log times are used instead"
        )
        findings.append(Finding("time-source", text, topic=topic))
    elif not log_time:
        whole, findings = own_steps(whole, topic)
    stream = sorted_stream([whole], log_time, repeats)
    if stream is None:
        return None, []
    if stream.backward:
        text = f"topic {topic}: {counted(stream.backward, 'message')} came out of order; sorted"
        findings.append(_counted("out-of-order", text, topic, stream.backward))
    if stream.repeated and not repeats:
        repeat = counted_clause(stream.repeated, "message", "repeats", "repeat")
        text = f"topic {topic}: {repeat} a stamp; left out"
        findings.append(_counted("repeated-stamps", text, topic, stream.repeated))
    return stream.stream, findings


def _unstamped(stream: Stream) -> bool:
    """Whether messages have one and the same stamp, though they were recorded one by one."""
    same = (stream.time_ns == stream.time_ns[0]).all()
    return bool(same and (stream.log_time_ns != stream.log_time_ns[0]).any())


def _counted(kind: str, text: str, topic: str, count: int, severity: Severity = WARNING) -> Finding:
    return Finding(kind, text, severity, topic=topic, numbers={"messages": count})


def only(
    stream: S,
    good: np.ndarray,
    topic: str,
    kind: str,
    what: tuple[str, str],
    severity: Severity = WARNING,
) -> tuple[S | None, list[Finding]]:
    """The good rows, None where there is none, and what one that is not good is, or several."""
    bad = int(len(good) - np.count_nonzero(good))
    if not bad:
        return stream, []
    finding = _counted(kind, f"topic {topic}: {bad} {what[bad > 1]}", topic, bad, severity)
    return stream.rows(good) if good.any() else None, [finding]


def _check_pressure(log: Log, channel: Channel, baro: Baro) -> None:
    """Refuse pressures that are not in pascal."""
    from sinstool.methods.height.pressure import suspected_unit

    judged = suspected_unit(baro.pressure)
    if judged.unit == "Pa":
        return
    if not judged.samples:
        raise DataError(
            log.path,
            f"topic {channel.topic} holds no pressure that is positive",
            "name another topic with --baro-topic",
        )
    if judged.unit == "unknown":
        raise DataError(
            log.path,
            f"topic {channel.topic}: its pressures are about {judged.median:.5g}, which no"
            " atmosphere has in any usual unit",
            "give the unit with --baro-unit, or name another topic with --baro-topic",
        )
    raise DataError(
        log.path,
        f"topic {channel.topic}: its pressures are about {judged.median:.5g}, not pascal but as in"
        f" {judged.unit}",
        f"add --baro-unit {judged.unit} (or --baro-unit Pa if the log is right)",
    )
