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
    """The log: all of its messages, and the span of their log times."""

    path: str
    format: str
    profile: str
    size: int
    messages: int
    start_ns: int
    end_ns: int


@dataclass(frozen=True)
class Topic:
    """One topic by log time; the rate is None for a single instant."""

    topic: str
    type: str
    n: int
    bytes: int
    rate_hz: float | None
    longest_interval_s: float
    out_of_order: int


@dataclass(frozen=True)
class Gap:
    """A gap between two samples."""

    start_ns: int
    length_s: float


@dataclass(frozen=True)
class StillStretch:
    """A stretch in which the sensor turns at most steadily, in the log's own axes."""

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
    """An Imu topic: intervals are the shortest, the median and the longest."""

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
    """An Imu topic without a usable sample, and why."""

    topic: str
    n: int
    problem: str


@dataclass(frozen=True)
class Verdict:
    """The plan of `process` for the log, or why it would refuse it.

    Its findings are of what it takes beside the Imu, and of what it has to give up.
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
    """Contents of a log, its findings, and the plan of `process`."""

    input: InspectedFile
    topics: tuple[Topic, ...]
    imu: tuple[InspectedImu | UnusableImu, ...]
    process: Verdict
    lost: LogLosses

    @property
    def usable(self) -> tuple[InspectedImu, ...]:
        """Imu topics that can be surveyed."""
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
