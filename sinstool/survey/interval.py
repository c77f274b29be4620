"""The interval of a log's samples."""

from __future__ import annotations

from sinstool.config import ProcessConfig
from sinstool.core.timeline import SECOND
from sinstool.survey.source import Source


def nominal_interval(source: Source, config: ProcessConfig) -> float:
    """Interval of the Imu's samples, ns: as told, else the median of the log."""
    rate = config.input.imu_rate
    return (source.survey.interval_ns if rate is None else SECOND / rate) or SECOND
