"""A separate vertical channel for a run that computes attitude alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.arrays import FloatArray
from sinstool.core.finding import Finding
from sinstool.core.streams import Solution
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.height.vertical import VerticalChannel, upward_specific_force
from sinstool.pipelines.process.height import damping, with_heights_of_imu
from sinstool.pipelines.process.height_beside_gnss import HeightBesideGnss
from sinstool.pipelines.process.height_events import height_warnings, untrusted_heights
from sinstool.pipelines.process.height_lag import HeightLag
from sinstool.pipelines.process.height_used import HeightDamping
from sinstool.pipelines.process.mode import warned
from sinstool.survey.source import Source

# Gravity there is half-way between that of the equator and the poles.
MIDDLE_LATITUDE = 45.0 * DEGREE


class Vertical:
    """Height and vertical velocity beside attitude, held to a barometer or to GNSS heights.

    Parameters
    ----------
    config : ProcessConfig
        With damping.
    q_nb : ndarray, shape (4,)
        First attitude.

    Raises
    ------
    TopicError, DataError
        The log has no such heights.
    """

    def __init__(self, source: Source, config: ProcessConfig, q_nb: FloatArray) -> None:
        source = with_heights_of_imu(source, config, q_nb)
        by_baro = config.vertical.height_damping == "baro"
        self._notes = [str(f) for f in source.aiding.barometer.findings] if by_baro else []
        latitude = source.latitude
        if latitude is None:
            latitude = MIDDLE_LATITUDE
            self._notes.append("the latitude is unknown; gravity at 45 deg is used for the height")
        start = source.position[2] or 0.0
        self.damping, notes = damping(source, config, latitude, start)
        if source.position[2] is None:
            start = self.damping.reference.first_height
        self._notes += notes
        self._beside = HeightBesideGnss(self.damping.reference, source.aiding.gnss)
        self._lag = HeightLag(self.damping.reference, config.vertical.baro_lag)
        self._channel = VerticalChannel(
            self.damping.network,
            latitude,
            self.damping.grade.grade,
            height=start,
            baro_lag=config.vertical.baro_lag,
            point_samples=config.input.sample_kind == "rate",
        )
        self._pushed = False
        self._first_ns, self._log_ns = 0, source.survey.first_ns
        self._last = np.array([start, 0.0, 0.0])

    def push(self, solution: Solution) -> Solution:
        """The same solution, with its vertical columns."""
        r = self.damping.reference
        heights: tuple[Any, ...] = ()
        if not self._pushed:
            self._pushed = True
            self._first_ns = int(solution.time_ns[0])
            later = r.arrival_ns >= self._first_ns
            heights = (r.time_ns[later], r.height[later], r.reason[later], r.arrival_ns[later])
        f_up = upward_specific_force(solution.q_nb, solution.specific_force_b)
        out = self._channel.push(solution.time_ns, f_up, *heights)
        vertical = np.stack([out.height, out.v_up, out.correction], axis=1)
        self._last = vertical[-1]
        solution = replace(solution, vertical=vertical)
        self._beside.push(solution)
        self._lag.push(solution, f_up)
        return solution

    def summary(self) -> HeightDamping:
        """Damping of the height, and its events."""
        return self.damping.result(
            self._channel.summary, self._channel.events, self._first_ns, self._last
        )

    def findings(self) -> list[Finding]:
        """What there is to know about the height."""
        events, begins_s = self._channel.events, (self._first_ns - self._log_ns) / SECOND
        said = height_warnings(self._channel.summary, events, begins_s)
        said = [*self._notes, *said, *self._lag.warnings(), *self._beside.warnings()]
        length, sigma = sum(self._channel.summary.seconds.values()), self.damping.reference.sigma
        untrusted = untrusted_heights(events, self._first_ns, begins_s, length, sigma)
        return [*warned("height", said), *untrusted]
