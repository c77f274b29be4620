"""What is in a log: topics, the survey of each Imu topic, and what `process` would make of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sinstool.config import InputOptions
from sinstool.core.errors import DataError, TopicError
from sinstool.io.readers import open_log
from sinstool.io.readers.frames import turn_body
from sinstool.io.readers.log import Log
from sinstool.io.readers.topics import OWN_PREFIXES, ImuTopic, choose_imu, imu_candidates
from sinstool.pipelines.info.collect import Sampling, Traffic, Values
from sinstool.survey.imu import Survey, survey
from sinstool.survey.oddities import gravity_axis, oddities
from sinstool.survey.source import has_gnss, imu_units, time_span

MAX_SPANS = 20


@dataclass
class Shown:
    """What figures show of an inspection.

    Attributes
    ----------
    samplings : list of Sampling
        One of each Imu topic.
    """

    traffic: Traffic = field(default_factory=Traffic)
    samplings: list[Sampling] = field(default_factory=list)

    def sampling(self, topic: str, options: InputOptions) -> Sampling:
        """One more topic's."""
        values = Values(options.body_axes, _increments(options))
        self.samplings.append(Sampling(topic, values))
        return self.samplings[-1]


@dataclass
class _Traffic:
    """Messages of one topic, by log time."""

    count: int = 0
    size: int = 0
    first: int = 0
    last: int = 0
    low: int = 0
    high: int = 0
    longest: int = 0
    backward: int = 0
    kinds: dict[str, None] = field(default_factory=dict)

    def add(self, times: np.ndarray, size: int) -> None:
        steps = np.diff(times, prepend=times[0] if self.count == 0 else self.last)
        self.longest = max(self.longest, int(steps.max()))
        self.backward += int(np.count_nonzero(steps < 0))
        low, high = int(times.min()), int(times.max())
        self.low = low if self.count == 0 else min(self.low, low)
        self.high = high if self.count == 0 else max(self.high, high)
        self.first = int(times[0]) if self.count == 0 else self.first
        self.last = int(times[-1])
        self.count += len(times)
        self.size += size


def inspect(
    path: Path,
    options: InputOptions,
    progress: Callable[[float], None] | None = None,
    shown: Shown | None = None,
) -> dict[str, Any]:
    """Describe a log.

    Parameters
    ----------
    options : InputOptions
        Topic, axes and units, as for `process`.
    progress : callable, optional
        Called with the fraction done.
    shown : Shown, optional
        Gets what figures show.

    Returns
    -------
    dict
        ``input``, ``topics``, ``imu`` (one entry for each Imu topic), ``process`` (what it would
        take, or why it would refuse) and ``lost`` (see `Log.account`).

    Raises
    ------
    SinstoolError
    """
    with open_log(path, options.salvage) as log:
        wanted = options.imu_topic
        candidates = [
            c
            for c in imu_candidates(log)
            if (c.topic == wanted if wanted else not c.topic.startswith(OWN_PREFIXES))
        ]
        passes = 1 + len(candidates)
        traffic = _traffic(log, _part(progress, log.size, 0, passes), shown)
        imus = []
        for number, candidate in enumerate(candidates):
            report = _part(progress, log.size, 1 + number, passes)
            kept = None if shown is None else shown.sampling(candidate.topic, options)
            imus.append(_describe(log, candidate, options, report, kept))
        return {
            "input": {
                "path": str(path),
                "format": log.format,
                "profile": log.profile,
                "size": log.size,
                "messages": sum(t.count for t in traffic.values()),
                "start_ns": str(min((t.low for t in traffic.values()), default=0)),
                "end_ns": str(max((t.high for t in traffic.values()), default=0)),
            },
            "topics": [_topic(name, t) for name, t in sorted(traffic.items())],
            "imu": imus,
            "process": _verdict(log, options, imus),
            "lost": log.account(),
        }


def _increments(options: InputOptions) -> bool:
    return options.gyro_kind == "increment"


def _part(
    progress: Callable[[float], None] | None, size: int, number: int, passes: int
) -> Callable[[int], None] | None:
    if progress is None:
        return None
    return lambda position: progress((number + min(1.0, position / max(size, 1))) / passes)


def _traffic(
    log: Log, progress: Callable[[int], None] | None, shown: Shown | None
) -> dict[str, _Traffic]:
    found: dict[str, _Traffic] = {}
    for channel in log.channels.values():
        traffic = found.setdefault(channel.topic, _Traffic())
        traffic.kinds[f"{channel.type_name or 'no type'} ({channel.message_encoding})"] = None
    for batch in log.batches():
        if progress:
            progress(batch.position)
        for number in np.unique(batch.channel).tolist():
            mine = batch.channel == number
            size = int(batch.length[mine].sum())
            topic = log.channels[number].topic
            found[topic].add(batch.log_time[mine], size)
            if shown is not None:
                shown.traffic.add(topic, batch.log_time[mine])
    return found


def _topic(name: str, t: _Traffic) -> dict[str, Any]:
    span = (t.high - t.low) / 1e9
    return {
        "topic": name,
        "type": ", ".join(t.kinds),
        "n": t.count,
        "bytes": t.size,
        "rate_hz": (t.count - 1) / span if span > 0 else None,
        "longest_interval_s": t.longest / 1e9,
        "out_of_order": t.backward,
    }


def _describe(
    log: Log,
    topic: ImuTopic,
    options: InputOptions,
    progress: Callable[[int], None] | None,
    kept: Sampling | None,
) -> dict[str, Any]:
    try:
        found = survey(
            log,
            topic,
            imu_units(options),
            span=time_span(log, options),
            max_gap_s=options.max_gap,
            increments=_increments(options),
            progress=progress,
            kept=kept,
            judged=None if kept is None else kept.values,
        )
    except DataError as exc:
        return {"topic": topic.topic, "n": 0, "problem": exc.message, "oddities": []}
    return {
        "topic": topic.topic,
        "path": topic.path,
        "n": found.count,
        "rate_hz": found.rate_hz,
        "first_ns": str(found.first_ns),
        "last_ns": str(found.last_ns),
        "covered_s": found.duration_s,
        "interval_ms": [
            found.interval_range_ns[0] / 1e6,
            found.interval_ns / 1e6,
            found.interval_range_ns[1] / 1e6,
        ],
        "time_source": found.time_source,
        "gaps": found.gap_count,
        "gap_list": [{"start_ns": str(t), "length_s": length} for t, length in found.gaps],
        "duplicates": found.order.duplicates,
        "backward": found.order.backward,
        "log_less_stamp_s": list(found.clock_offset_s),
        "specific_force_m_s2": found.specific_force_median,
        "gyro_max_rad_s": found.gyro_max.tolist(),
        "accel_max_m_s2": found.accel_max.tolist(),
        "orientation": found.orientation is not None,
        "still": _spans(found, options),
        "align": _align(found),
        "oddities": [
            {"kind": o.kind, "text": o.text, "answer": o.answer, "fatal": o.fatal}
            for o in oddities(found, options)
        ],
    }


def _spans(found: Survey, options: InputOptions) -> list[dict[str, Any]]:
    """The still spans, in the log's own axes."""
    return [
        {
            "start_s": (span.start_ns - found.first_ns) / 1e9,
            "duration_s": span.duration_s,
            "gyro_bias_rad_s": turn_body(span.gyro, options.body_axes).tolist(),
            "specific_force_m_s2": turn_body(span.accel, options.body_axes).tolist(),
            "gravity_axis": gravity_axis(span.accel, options.body_axes),
            "gyro_noise_rad_s": span.gyro_std,
            "accel_noise_m_s2": span.accel_std,
        }
        for span in sorted(found.spans, key=lambda s: -s.duration_s)[:MAX_SPANS]
    ]


def _align(found: Survey) -> str:
    """What --align auto would do."""
    if found.lead_in is not None:
        return f"level, from {found.lead_in.duration_s:.1f} s at rest; gyro bias removed"
    if found.orientation is not None and not found.orientation_constant:
        return "log: the first orientation of the Imu topic; no gyro bias removed"
    return "rough tilt from the first second; no gyro bias removed"


def _verdict(log: Log, options: InputOptions, imus: list[dict[str, Any]]) -> dict[str, Any]:
    """What `process` would take, or why it would refuse."""
    wanted = options.imu_topic
    try:
        chosen = choose_imu(log, wanted)
    except TopicError as exc:
        return {"possible": False, "imu_topic": None, "why": str(exc)}
    found = next(i for i in imus if i["topic"] == chosen.topic)
    if "problem" in found:
        return {"possible": False, "imu_topic": chosen.topic, "why": found["problem"]}
    fatal = [o for o in found["oddities"] if o["fatal"]]
    if fatal:
        why = f"{fatal[0]['text']}: {fatal[0]['answer']}"
        return {"possible": False, "imu_topic": chosen.topic, "why": why}
    return {
        "possible": True,
        "imu_topic": chosen.topic,
        "mode": "ins-gnss" if has_gnss(log, options) else "attitude",
        "align": found["align"],
        "why": chosen.note,
    }
