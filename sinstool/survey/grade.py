"""What grade the IMU of a log is: as told, or as its noise at rest says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE_PER_ROOT_HOUR
from sinstool.methods.sensor_errors import Grade, grade_by_noise
from sinstool.survey.source import Source


@dataclass(frozen=True)
class ImuGrade:
    """The IMU's grade, and why it was taken for that."""

    grade: Grade
    why: str


def random_walk(source: Source) -> float | None:
    """Angular random walk at rest, rad/sqrt(s) an axis; None where the log has no rest."""
    # a stretch of steady flight will do: it is the scatter that counts, not the mean
    spans = [s for s in source.survey.spans if s.samples > 50]
    if not spans:
        return None
    longest = max(spans, key=lambda s: s.samples)
    step = source.survey.interval_ns / SECOND
    return float(longest.gyro_std / np.sqrt(3.0) * np.sqrt(step))


def sensor_grade(source: Source, config: ProcessConfig) -> ImuGrade:
    """Grade of the IMU, and why.

    Without a rest to judge by the sensors are taken for MEMS: too much caution costs accuracy,
    too little the truth of every sigma.
    """
    configured = config.navigation.imu_grade
    if configured != "auto":
        return ImuGrade(configured, "as configured")
    walk = random_walk(source)
    if walk is None:
        return ImuGrade("mems", "assumed, as the log shows no rest")
    shown = walk / DEGREE_PER_ROOT_HOUR
    return ImuGrade(grade_by_noise(walk), f"by its gyro noise at rest, {shown:.2g} deg/sqrt(h)")
