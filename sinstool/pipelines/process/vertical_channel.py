"""A vertical channel of its own, beside a run that computes attitude alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.streams import Solution
from sinstool.core.units import DEGREE
from sinstool.methods.height.layout import ACCEPTED
from sinstool.methods.height.vertical import VerticalChannel, upward_specific_force
from sinstool.pipelines.process.height import (
    height_reference,
    height_summary,
    height_warnings,
    network,
)
from sinstool.pipelines.process.sink import Sink
from sinstool.survey.aiding import read_baro
from sinstool.survey.grade import sensor_grade
from sinstool.survey.source import Source

# Gravity there is half-way between that of the equator and the poles.
MIDDLE_LATITUDE = 45.0 * DEGREE


class Vertical:
    """Height and vertical velocity beside attitude, held to a barometer or to GNSS heights.

    Parameters
    ----------
    config : ProcessConfig
        With damping.

    Raises
    ------
    TopicError, DataError
        The log has no such heights.
    """

    def __init__(self, source: Source, config: ProcessConfig) -> None:
        log = source.log
        by_log_time = source.survey.time_source == "log"
        aiding = source.aiding
        told_before = len(aiding.warnings)
        if config.vertical.height_damping == "baro":
            read_baro(log, config.input, by_log_time, aiding)
        self._notes = aiding.warnings[told_before:]
        latitude = source.latitude
        if latitude is None:
            latitude = MIDDLE_LATITUDE
            self._notes.append("no latitude is known; gravity for the height is that of 45 deg")
        start = source.position[2] or 0.0
        self._reference, notes = height_reference(log, aiding, config, start)
        self._grade, self._why = sensor_grade(source, config)
        self._network, more = network(config, self._grade, latitude)
        self._notes += [*notes, *more]
        self._channel = VerticalChannel(
            self._network,
            latitude,
            self._grade,
            height=start,
            baro_lag=config.vertical.baro_lag,
            point_samples=config.input.gyro_kind == "rate",
        )
        self._given = False
        self._first_ns = 0
        self._last = (start, 0.0, 0.0)

    def show(self, recorder: Sink) -> None:
        """Give the page of figures the heights that this one is held to."""
        r = self._reference
        good = r.reason == ACCEPTED
        recorder.refer_height(r.topic, r.time_ns[good], r.height[good])

    def push(self, solution: Solution) -> Solution:
        """The same solution, with its vertical columns."""
        r = self._reference
        heights: tuple[Any, ...] = ()
        if not self._given:
            self._given = True
            self._first_ns = int(solution.time_ns[0])
            later = r.arrival_ns >= self._first_ns
            heights = (r.time_ns[later], r.height[later], r.reason[later], r.arrival_ns[later])
        f_up = upward_specific_force(solution.q_nb, solution.specific_force_b)
        out = self._channel.push(solution.time_ns, f_up, *heights)
        vertical = np.stack([out.height, out.v_up, out.correction], axis=1)
        self._last = (float(vertical[-1, 0]), float(vertical[-1, 1]), float(vertical[-1, 2]))
        return replace(solution, vertical=vertical)

    def summary(self) -> dict[str, Any]:
        """``height`` of the summary."""
        told = height_summary(
            self._reference,
            self._network,
            self._channel.summary,
            self._channel.events,
            self._first_ns,
            self._last,
        )
        return told | {"imu_grade": {"grade": self._grade, "why": self._why}}

    def warnings(self) -> list[str]:
        """What a user has to know about the height."""
        return [*self._notes, *height_warnings(self._channel.summary, self._channel.events)]
