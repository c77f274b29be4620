"""`--mode ins-gnss`: inertial navigation corrected by GNSS, filtered or smoothed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.result import compass
from sinstool.core.rotation import to_euler
from sinstool.core.streams import Diagnostics, Solution
from sinstool.core.units import DEGREE
from sinstool.io.writers.topics import Frames
from sinstool.pipelines.plan import Plan
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.run import DIAGNOSTIC_NAMES, FilterRun
from sinstool.pipelines.process.ins_gnss.start import timed_start
from sinstool.pipelines.process.mode import BytesRead, Mode, warned
from sinstool.pipelines.process.sink import Sink, show_reference
from sinstool.pipelines.process.summary import ConingUsed, FirstAttitude, ModeResult
from sinstool.survey.source import Source

# A heading known better than this is good, deg.
GOOD_HEADING = 5.0


class InsGnssMode(Mode):
    """INS/GNSS integration by the filter whose start the plan holds."""

    diagnostic_names = DIAGNOSTIC_NAMES

    def __init__(self, source: Source, config: ProcessConfig, plan: Plan) -> None:
        self._source, self._config, self._plan = source, config, plan
        self._start = timed_start(source, config, plan.algorithm, plan.filter_start)
        self.emits = ("imu", "attitude", "odometry", "fix", "tf", "diagnostics")
        if self._start.reference is not None:
            self.emits = (*self.emits, "height")
        latitude, longitude, height = (float(value) for value in self._start.start.nav[:3])
        self.frames = Frames(
            config.output.world,
            "map",
            source.body_frame,
            config.input.body_axes,
            (latitude, longitude, height),
        )
        self._run = FilterRun(source, config, self._start, plan.algorithm)

    def show(self, sink: Sink) -> None:
        """The barometer's heights and the fixes, and more of the biases than the output has."""
        if self._start.reference is not None:
            show_reference(self._start.reference, sink)
        gnss = self._source.aiding.gnss
        if gnss is not None:
            sink.refer_track(gnss.latitude, gnss.longitude)
        self._run.detailed = True

    def solutions(self, progress: BytesRead | None) -> Iterator[Solution]:
        """Filtered or smoothed."""
        return self._run.solutions(progress)

    def new_diagnostics(self) -> Sequence[Diagnostics]:
        """Innovations since the last call."""
        return self._run.new_diagnostics()

    def conclude(self, last: Solution, sink: Sink | None) -> ModeResult:
        """The start, the filter, the height, and what is likely to be wrong."""
        run = self._run
        if sink is not None:
            sink.refer_filter(run)
        return ModeResult(
            first_attitude=_first_attitude(self._start),
            coning=ConingUsed.of(run.algorithm, self._config.input.gyro_kind, run.updates),
            height=run.height(last),
            filter=run.summary(),
            findings=(*warned("filter-start", self._start.warnings), *run.warnings()),
        )


def _first_attitude(start: FilterStart) -> FirstAttitude:
    """The filter's start as a first attitude."""
    roll, pitch, heading = (float(v) for v in to_euler(start.start.nav[6:10]) / DEGREE)
    sigma = np.sqrt(np.diag(start.start.covariance_attitude_n)) / DEGREE
    return FirstAttitude(
        method="filter-start",
        how=start.how,
        time_ns=start.time_ns,
        roll_deg=roll,
        pitch_deg=pitch,
        heading_deg=compass(heading),
        sigma_deg=tuple(sigma.tolist()),
        status="ok" if sigma[2] < GOOD_HEADING else "degraded",
        north_referenced=True,
        gyro_bias_rad_s=tuple(start.start.gyro_bias.tolist()),
        gyro_bias_source="start",
    )
