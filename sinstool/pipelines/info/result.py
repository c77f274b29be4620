"""Result of `info`: the values of ``--json``, the terminal and the page."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from sinstool.core.finding import Finding, Severity, exit_status
from sinstool.core.result import as_json
from sinstool.io.readers.lost import LogLosses
from sinstool.methods.alignment.still import STEADY_TURN
from sinstool.pipelines.plan import Plan

SCHEMA = "sinstool.info/1"


@dataclass(frozen=True)
class InspectedFile:
    """The log: all of its messages, and the span of their log times.

    Attributes
    ----------
    path : str
        As given.
    format : str
        ``mcap``, ``rosbag1``, ``rosbag2`` or ``ulog``.
    profile : str
        Of an MCAP; '' without.
    size : int
        Bytes.
    messages : int
        Of all topics.
    start_ns, end_ns : int
        First and last log time.
    """

    path: str
    format: str
    profile: str
    size: int
    messages: int
    start_ns: int
    end_ns: int


@dataclass(frozen=True)
class Topic:
    """One topic, by log time.

    Attributes
    ----------
    topic, type : str
        Its name, and its type with the encoding.
    n, bytes : int
        Number of messages, and their size.
    rate_hz : float or None
        Mean rate; None for a single instant.
    longest_interval_s : float
        Between two messages.
    out_of_order : int
        Messages whose log time is before that of their predecessor.
    """

    topic: str
    type: str
    n: int
    bytes: int
    rate_hz: float | None
    longest_interval_s: float
    out_of_order: int


@dataclass(frozen=True)
class Gap:
    """A gap between two samples.

    Attributes
    ----------
    start_ns : int
        Time of the sample before.
    length_s : float
        Time to the next one.
    """

    start_ns: int
    length_s: float


@dataclass(frozen=True)
class StillStretch:
    """A stretch in which the sensor turns at most steadily, in the log's own axes.

    Attributes
    ----------
    start_s, duration_s : float
        From the first sample, and its length.
    gyro_bias_rad_s : tuple of float
        Mean rate: the bias and the Earth's rate, if it is a rest.
    specific_force_m_s2 : tuple of float
        Mean.
    gravity_axis : str
        Axis that points up, with its sign.
    gyro_noise_rad_s, accel_noise_m_s2 : float
        Standard deviation of the samples.
    """

    start_s: float
    duration_s: float
    gyro_bias_rad_s: tuple[float, ...]
    specific_force_m_s2: tuple[float, ...]
    gravity_axis: str
    gyro_noise_rad_s: float
    accel_noise_m_s2: float

    @property
    def turning(self) -> bool:
        """Whether it turns faster than the bias of any but the worst gyros."""
        return math.hypot(*self.gyro_bias_rad_s) > STEADY_TURN


@dataclass(frozen=True)
class InspectedImu:
    """An IMU topic.

    Attributes
    ----------
    topic, path : str
        Its name, and where in the message the IMU is nested.
    n : int
        Samples in order, without repeated ones.
    rate_hz : float
        By the median interval.
    first_ns, last_ns : int
        Times of the first and last sample.
    covered_s : float
        Without the gaps.
    interval_ms : tuple of float
        Shortest, median and longest interval.
    time_source : str
        ``stamp`` (header stamps), or ``log`` (log times, if stamps are unusable).
    gaps, gap_list : int, tuple of Gap
        Intervals longer than ``--max-gap``.
    duplicates, backward : int
        Samples that repeat a stamp, and samples stamped before their predecessor.
    log_less_stamp_s : tuple of float
        Least and largest log time less header stamp.
    specific_force_m_s2 : float
        Median size.
    gyro_max_rad_s, accel_max_m_s2 : tuple of float
        Largest value on each axis.
    orientation : bool
        Whether it holds orientations.
    still : tuple of StillStretch
        The longest first.
    findings : tuple of Finding
        About this topic.
    """

    topic: str
    path: str
    n: int
    rate_hz: float
    first_ns: int
    last_ns: int
    covered_s: float
    interval_ms: tuple[float, float, float]
    time_source: str
    gaps: int
    gap_list: tuple[Gap, ...]
    duplicates: int
    backward: int
    log_less_stamp_s: tuple[float, float]
    specific_force_m_s2: float
    gyro_max_rad_s: tuple[float, ...]
    accel_max_m_s2: tuple[float, ...]
    orientation: bool
    still: tuple[StillStretch, ...]
    findings: tuple[Finding, ...]


@dataclass(frozen=True)
class UnusableImu:
    """An IMU topic without a usable sample.

    Attributes
    ----------
    topic : str
        Its name.
    n : int
        Number of messages.
    problem : str
        In words.
    """

    topic: str
    n: int
    problem: str


@dataclass(frozen=True)
class Verdict:
    """The plan of `process` for the log, or why it would refuse it.

    Attributes
    ----------
    possible : bool
        Whether `process` would compute a result.
    imu_topic : str or None
        The topic that it would use.
    why : str
        Reason of a refusal, or of the choice of the topic.
    plan : Plan or None
        None if it would refuse.
    findings : tuple of Finding
        About aiding sensors, and about choices that could not be made.
    """

    possible: bool
    imu_topic: str | None
    why: str
    plan: Plan | None
    findings: tuple[Finding, ...] = ()

    def __str__(self) -> str:
        if self.plan is None:
            return f"process would refuse this log: {self.why}"
        note = f" ({self.why})" if self.why else ""
        mode, first = self.plan.mode, self.plan.first_attitude
        what = "INS/GNSS" if mode.value == "ins-gnss" else f"{mode.value} only"
        text = f"process would use {self.imu_topic}{note}; {what}; first attitude {first}"
        if self.plan.magnetometer.value != "none":
            topic = self.plan.magnetometer.value
            text += f"; heading by the magnetometer {topic}, where its field is undisturbed"
        return text


@dataclass(frozen=True)
class Inspection:
    """Contents of a log, its findings, and the plan of `process`.

    Attributes
    ----------
    input : InspectedFile
        The log.
    topics : tuple of Topic
        All of them.
    imu : tuple of InspectedImu or UnusableImu
        Each IMU topic.
    process : Verdict
        What `process` would do.
    lost : LogLosses
        Damaged parts.
    """

    input: InspectedFile
    topics: tuple[Topic, ...]
    imu: tuple[InspectedImu | UnusableImu, ...]
    process: Verdict
    lost: LogLosses

    @property
    def usable(self) -> tuple[InspectedImu, ...]:
        """IMU topics that can be surveyed."""
        return tuple(imu for imu in self.imu if isinstance(imu, InspectedImu))

    @property
    def plan(self) -> Plan | None:
        """The plan of `process`, with a reason for each choice; None where it refuses the log."""
        return self.process.plan

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings about the log, over all topics."""
        return (
            *self.lost.findings(),
            *(finding for imu in self.usable for finding in imu.findings),
            *self.process.findings,
        )

    @property
    def exit_status(self) -> int:
        """0, or 3 where something was lost; what `process` would refuse can be inspected."""
        return exit_status(f for f in self.findings if f.severity != Severity.FAILED)

    def to_json(self) -> dict[str, Any]:
        """The values of ``--json``."""
        return {"schema": SCHEMA, **as_json(self)}
