"""The topic to use: the one that the user names, or the only candidate."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sinstool.core.choices import log_choice
from sinstool.core.errors import TopicError, UnsupportedLogError
from sinstool.core.suggest import nearest
from sinstool.io.readers.log import Channel, Log
from sinstool.io.readers.message_types import FIX_TYPES, IMU_TYPE
from sinstool.io.readers.streams import IMU_FIELDS, ImuUnits, Losses, read_imu

# Topics that sinstool itself writes are used as sensors only if they are named.
OWN_PREFIXES = ("/sinstool/", "/truth/")
PROBE_SAMPLES = 2000
# Value of an option that uses no topic at all
NONE = "none"


@dataclass(frozen=True)
class ImuTopic:
    """A topic that carries IMU data.

    Attributes
    ----------
    path : str
        Where the IMU lies in the message; '' for a plain IMU topic.
    reason : str
        Why it was chosen.
    obvious : bool
        Whether there was no other choice.
    """

    topic: str
    channels: tuple[Channel, ...]
    path: str = ""
    reason: str = ""
    obvious: bool = True


def topics_of_type(log: Log, *types: str) -> dict[str, tuple[Channel, ...]]:
    """Topics with channels of some types that can be read; a topic may have others beside them."""
    channels = [c for _, c in sorted(log.channels.items()) if c.type in types and c.readable]
    return {c.topic: tuple(log.channels_of(c.topic, *types)) for c in channels}


def unread_topics(log: Log, *types: str) -> dict[str, str]:
    """Topics of some types that cannot be read, and why; but for those that sinstool writes."""
    read, unread = topics_of_type(log, *types), dict[str, str]()
    for _, channel in sorted(log.channels.items()):
        topic = channel.topic
        if channel.type in types and topic not in read and not topic.startswith(OWN_PREFIXES):
            try:
                channel.definition(log.path)
            except UnsupportedLogError as exc:
                unread.setdefault(topic, exc.message.removeprefix(f"{log.path}: "))
    return unread


def unread_clause(log: Log, *types: str) -> str:
    """Clause that follows what a log has none of: what topics of these types cannot be read."""
    return "".join(f"; {why}" for why in unread_topics(log, *types).values())


def imu_candidates(log: Log) -> list[ImuTopic]:
    """Every topic with IMU data: plain IMU, types that nest an IMU, types with the same fields.

    Topics that cannot be read are among them only if there are no others.
    """
    plain = [ImuTopic(t, c) for t, c in topics_of_type(log, IMU_TYPE).items()]
    nested, alike = [], []
    for topic in dict.fromkeys(c.topic for _, c in sorted(log.channels.items())):
        channels = tuple(log.channels_of(topic))
        if any(c.type == IMU_TYPE and c.readable for c in channels):
            continue
        path = _nested_path(log, channels)
        if path:
            nested.append(ImuTopic(topic, channels, path))
        elif _like_an_imu(log, channels):
            alike.append(ImuTopic(topic, channels))
    unread = dict.fromkeys(c.topic for _, c in sorted(log.channels.items()) if c.type == IMU_TYPE)
    return plain + nested + alike or [
        ImuTopic(t, tuple(log.channels_of(t, IMU_TYPE))) for t in unread
    ]


def _like_an_imu(log: Log, channels: tuple[Channel, ...]) -> bool:
    """Whether a driver's own type has all fields of :data:`IMU_FIELDS`."""
    try:
        definitions = [channel.definition(log.path) for channel in channels]
    except UnsupportedLogError:
        return False
    return all(one.has(field) for one in definitions for field in IMU_FIELDS)


def _nested_path(log: Log, channels: tuple[Channel, ...]) -> str:
    """Path of the only IMU inside a topic's type; '' where there is none or several."""
    nested = set()
    for channel in channels:
        try:
            paths = list(channel.definition(log.path).paths_of(IMU_TYPE))
        except UnsupportedLogError:
            return ""
        if len(paths) != 1:
            return ""
        nested.add(paths[0])
    return nested.pop() if len(nested) == 1 else ""


def choose_imu(log: Log, name: str | None) -> ImuTopic:
    """The IMU topic of a run.

    Parameters
    ----------
    name : str, optional
        ``--imu-topic``.

    Raises
    ------
    TopicError
        The topic is missing or carries no IMU; there is none; there are several with data.
    """
    candidates = imu_candidates(log)
    if name is not None:
        for candidate in candidates:
            if candidate.topic == name:
                return replace(candidate, reason="as configured")
        if log.channels_of(name):
            kind = log.channels_of(name)[0].type_name or "unknown type"
            raise TopicError(log.path, f"topic {name} is {kind}, not sensor_msgs/Imu")
        near = nearest(name, [c.topic for c in candidates])
        hint = f"{near} {_listing(candidates)}" if near else _listing(candidates)
        raise TopicError(log.path, f"there is no topic {name}", hint)
    candidates = [c for c in candidates if not c.topic.startswith(OWN_PREFIXES)]
    if not candidates:
        types = sorted({c.type_name for c in log.channels.values() if c.type_name})
        hint = f"it has {', '.join(types[:8])}" if types else "it has no topic of a known type"
        raise TopicError(log.path, "the log has no sensor_msgs/Imu topic", hint)
    if len(candidates) == 1:
        return replace(candidates[0], reason="the only one with an IMU")
    plain = [c for c in candidates if all(one.type == IMU_TYPE for one in c.channels)]
    if len(plain) == 1:
        return _noted(plain[0], "the only plain IMU topic")
    rates = {c.topic: probe_rate(log, c) for c in plain or candidates}
    alive = [c for c in plain or candidates if rates[c.topic] is not None]
    if len(alive) == 1:
        return _noted(alive[0], "the only IMU topic whose data is not all zeros")
    shown = ", ".join(f"{c.topic} ({_hertz(rates[c.topic])})" for c in plain or candidates)
    raise TopicError(
        log.path, f"several topics carry an IMU: {shown}", "choose one with --imu-topic"
    )


def _noted(topic: ImuTopic, why: str) -> ImuTopic:
    return replace(topic, reason=why, obvious=False)


def _hertz(rate: float | None) -> str:
    return "no data" if rate is None else f"{rate:.4g} Hz"


def _listing(candidates: list[ImuTopic]) -> str:
    if not candidates:
        return "no topic of this log carries an IMU"
    return "IMU topics are " + ", ".join(c.topic for c in candidates)


def probe_rate(log: Log, topic: ImuTopic) -> float | None:
    """Rate of a topic from its first samples; None when it has none or they are all zero."""
    times: list[np.ndarray] = []
    count, alive = 0, False
    for imu in read_imu(log, topic.channels, ImuUnits(), Losses(), path=topic.path):
        times.append(imu.time_ns)
        count += len(imu)
        alive = alive or bool(imu.gyro.any() or imu.accel.any())
        if count >= PROBE_SAMPLES:
            break
    if not alive:
        return None
    steps = np.diff(np.sort(np.concatenate(times)))
    steps = steps[steps > 0]
    return float(1e9 / np.median(steps)) if len(steps) else 0.0


def optional_topics(
    log: Log, flag: str, name: str | None, *types: str
) -> dict[str, tuple[Channel, ...]]:
    """Channels by topic that an option selects: the named topic, or all of suitable types.

    Topics of the log's `references` are none of them unless named: who compares a result with
    another receiver does not want it made from that.

    Parameters
    ----------
    flag : str
        The option, for the message.
    name : str, optional
        The topic that the option names; ``none`` for no topic.
    *types : str
        Accepted types.

    Raises
    ------
    TopicError
        The named topic is missing or of another type.
    UnsupportedLogError
        It cannot be read.
    """
    topics = topics_of_type(log, *types)
    if name == NONE:
        return {}
    if name is not None and (unread := log.channels_of(name, *types)) and name not in topics:
        unread[0].definition(log.path)
    if name is None:
        topics = {t: c for t, c in topics.items() if t not in log.references}
        return {t: c for t, c in topics.items() if not t.startswith(OWN_PREFIXES)}
    if name not in topics:
        kinds = ", ".join(t.replace("/msg/", "/") for t in types)
        hint = nearest(name, topics) or (f"there are {', '.join(topics)}" if topics else "")
        other = log.channels_of(name)
        if other:
            what = f"topic {name} is {other[0].type_name or 'of unknown type'}, not {kinds}"
            raise TopicError(log.path, what, hint)
        raise TopicError(log.path, f"there is no topic {name} of type {kinds}", hint)
    log_choice(flag.removeprefix("--").replace("-", " "), f"{name}, as specified")
    return {name: topics[name]}


def fix_topics(log: Log, name: str | None) -> dict[str, tuple[Channel, ...]]:
    """Channels by topic with fixes that ``--gnss-topic`` selects.

    A reference is one of them if the log has no other receiver, whose fixes it then needs.

    Raises
    ------
    TopicError
        The named topic is missing or of another type.
    """
    topics = optional_topics(log, "--gnss-topic", name, *FIX_TYPES)
    if topics or name is not None:
        return topics
    return {
        t: c
        for t, c in topics_of_type(log, *FIX_TYPES).items()
        if t in log.references and not t.startswith(OWN_PREFIXES)
    }


def choose_optional(log: Log, flag: str, name: str | None, *types: str) -> tuple[Channel, ...]:
    """Channels of an optional topic; empty when the log has none.

    Parameters
    ----------
    flag, name, *types : str
        As for :func:`optional_topics`.

    Raises
    ------
    TopicError
        The named topic is missing or of another type, or there are several.
    """
    topics = optional_topics(log, flag, name, *types)
    if len(topics) > 1:
        raise TopicError(
            log.path,
            f"several topics could be used: {', '.join(topics)}",
            f"choose one with {flag}",
        )
    for topic in topics:
        if name is None:
            what = flag.removeprefix("--").replace("-", " ")
            log_choice(what, f"{topic}, the only one of its type")
    return next(iter(topics.values()), ())
