"""Contents of a log: topics, the survey of each IMU topic, and the plan of `process`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sinstool.config import InputOptions, ProcessConfig
from sinstool.core.errors import DataError, SinstoolError, TopicError, UnsupportedLogError
from sinstool.core.progress import share
from sinstool.io.readers import open_log
from sinstool.io.readers.frames import turn_body
from sinstool.io.readers.log import Log
from sinstool.io.readers.topics import OWN_PREFIXES, ImuTopic, choose_imu, imu_candidates
from sinstool.pipelines.info import result
from sinstool.pipelines.info.collect import Sampling, Traffic, Values
from sinstool.pipelines.planning import make_plan
from sinstool.survey.imu import Survey
from sinstool.survey.oddities import found_gaps, gravity_axis, oddities
from sinstool.survey.samples import SampleCache
from sinstool.survey.source import prepare, survey_samples

MAX_SPANS = 20


@dataclass
class Shown:
    """Data of an inspection for its figures.

    Attributes
    ----------
    samplings : list of Sampling
        One of each IMU topic.
    """

    traffic: Traffic = field(default_factory=Traffic)
    samplings: list[Sampling] = field(default_factory=list)

    def sampling(self, topic: str, options: InputOptions) -> Sampling:
        """One more topic's."""
        values = Values(options.body_axes, options.gyro_kind == "increment")
        self.samplings.append(Sampling(topic, values))
        return self.samplings[-1]


@dataclass
class TopicTraffic:
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
        """Count messages with these log times, ns, and so many bytes in all."""
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
    config: ProcessConfig,
    progress: Callable[[float], None] | None = None,
    shown: Shown | None = None,
) -> result.Inspection:
    """Describe a log.

    Parameters
    ----------
    config : ProcessConfig
        As for `process`, whose plan is part of the answer.
    progress : callable, optional
        Called with the fraction done.
    shown : Shown, optional
        Gets what figures show.

    Raises
    ------
    SinstoolError
    """
    options = config.input
    with open_log(path, options.salvage) as log:
        candidates = [
            c
            for c in imu_candidates(log)
            if (
                c.topic == options.imu_topic
                if options.imu_topic
                else not c.topic.startswith(OWN_PREFIXES)
            )
        ]
        passes = 1 + len(candidates)
        traffic = _traffic(log, share(progress, log.size, 0.0, 1.0 / passes), shown)
        imus: list[result.InspectedImu | result.UnusableImu] = []
        chosen: tuple[Survey, SampleCache] | None = None
        choice = _choice(log, options)
        for number, topic in enumerate(candidates, start=1):
            report = share(progress, log.size, number / passes, 1.0 / passes)
            sampling = None if shown is None else shown.sampling(topic.topic, options)
            judged = None if sampling is None else sampling.values
            try:
                surveyed = survey_samples(log, topic, options, report, sampling, judged)
            except (DataError, UnsupportedLogError) as exc:
                number = traffic[topic.topic].count
                imus.append(result.UnusableImu(topic.topic, number, exc.message))
                continue
            imus.append(_describe(topic, surveyed[0], options))
            if isinstance(choice, ImuTopic) and topic.topic == choice.topic:
                chosen = surveyed
        return result.Inspection(
            input=result.InspectedFile(
                path=str(path),
                format=log.format,
                profile=log.profile,
                size=log.size,
                messages=sum(t.count for t in traffic.values()),
                start_ns=min((t.low for t in traffic.values()), default=0),
                end_ns=max((t.high for t in traffic.values()), default=0),
            ),
            topics=tuple(topic_of(name, t) for name, t in sorted(traffic.items())),
            imu=tuple(imus),
            process=_verdict(log, config, choice, chosen),
            lost=log.account(),
        )


def _traffic(
    log: Log, progress: Callable[[int], None] | None, shown: Shown | None
) -> dict[str, TopicTraffic]:
    traffics: dict[str, TopicTraffic] = {}
    for channel in log.channels.values():
        traffic = traffics.setdefault(channel.topic, TopicTraffic())
        traffic.kinds[f"{channel.type_name or 'no type'} ({channel.message_encoding})"] = None
    for batch in log.batches():
        if progress:
            progress(batch.position)
        for number in np.unique(batch.channel).tolist():
            mine = batch.channel == number
            size = int(batch.length[mine].sum())
            topic = log.channels[number].topic
            traffics[topic].add(batch.log_time[mine], size)
            if shown is not None:
                shown.traffic.add(topic, batch.log_time[mine])
    return traffics


def topic_of(name: str, t: TopicTraffic) -> result.Topic:
    """What is told of a topic."""
    span = (t.high - t.low) / 1e9
    return result.Topic(
        topic=name,
        type=", ".join(t.kinds),
        n=t.count,
        bytes=t.size,
        rate_hz=(t.count - 1) / span if span > 0 else None,
        longest_interval_s=t.longest / 1e9,
        out_of_order=t.backward,
    )


def _describe(topic: ImuTopic, survey: Survey, options: InputOptions) -> result.InspectedImu:
    low, high = survey.interval_range_ns
    return result.InspectedImu(
        topic=topic.topic,
        path=topic.path,
        n=survey.count,
        rate_hz=survey.rate_hz,
        first_ns=survey.first_ns,
        last_ns=survey.last_ns,
        covered_s=survey.duration_s,
        interval_ms=(low / 1e6, survey.interval_ns / 1e6, high / 1e6),
        time_source=survey.time_source,
        gaps=survey.gap_count,
        gap_list=tuple(result.Gap(start_ns, length) for start_ns, length in survey.gaps),
        duplicates=survey.order.duplicates,
        backward=survey.order.backward,
        log_less_stamp_s=survey.clock_offset_s,
        specific_force_m_s2=survey.specific_force_median,
        gyro_max_rad_s=tuple(survey.gyro_max.tolist()),
        accel_max_m_s2=tuple(survey.accel_max.tolist()),
        orientation=survey.orientation is not None,
        still=_still(survey, options),
        # What is done about gaps is for the modes of `process` to say
        findings=tuple(
            found_gaps(survey) if f.kind == "gaps" else f for f in oddities(survey, options)
        ),
    )


def _still(survey: Survey, options: InputOptions) -> tuple[result.StillStretch, ...]:
    """The still stretches, the longest first."""
    spans = sorted(survey.spans, key=lambda s: -s.duration_s)[:MAX_SPANS]
    return tuple(
        result.StillStretch(
            start_s=(span.start_ns - survey.first_ns) / 1e9,
            duration_s=span.duration_s,
            gyro_bias_rad_s=tuple(turn_body(span.gyro, options.body_axes).tolist()),
            specific_force_m_s2=tuple(turn_body(span.accel, options.body_axes).tolist()),
            gravity_axis=gravity_axis(span.accel, options.body_axes),
            gyro_noise_rad_s=span.gyro_std,
            accel_noise_m_s2=span.accel_std,
        )
        for span in spans
    )


def _choice(log: Log, options: InputOptions) -> ImuTopic | TopicError:
    """The IMU topic that `process` would take, or why there is none."""
    try:
        return choose_imu(log, options.imu_topic)
    except TopicError as exc:
        return exc


def _verdict(
    log: Log,
    config: ProcessConfig,
    choice: ImuTopic | TopicError,
    surveyed: tuple[Survey, SampleCache] | None,
) -> result.Verdict:
    """The plan of `process` for the log, or why it would refuse it."""
    if isinstance(choice, TopicError):
        return result.Verdict(False, None, str(choice), None)
    try:
        source = prepare(log, config, surveyed=surveyed)
        plan = make_plan(source, config)
    except SinstoolError as exc:
        # the name of the log has been said already
        return result.Verdict(False, choice.topic, str(exc).removeprefix(f"{log.path}: "), None)
    why = "" if choice.obvious else choice.reason
    # What is odd about the IMU has been said with it
    odd = {finding.kind for finding in oddities(source.survey, config.input)}
    findings = (*source.findings, *plan.findings)
    more = tuple(f for f in findings if f.kind not in odd and f.kind != "imu-topic")
    return result.Verdict(True, choice.topic, why, plan, more)
