"""`--mode attitude`: recorded IMU to corrected attitude."""

from __future__ import annotations

from collections.abc import Iterator

from sinstool.config import ProcessConfig
from sinstool.core.finding import Finding
from sinstool.core.streams import Solution
from sinstool.core.units import DEGREE
from sinstool.methods.strapdown.attitude import AttitudeRun, AttitudeSettings
from sinstool.pipelines.align.first_attitude import earth_rate
from sinstool.pipelines.plan import Plan
from sinstool.pipelines.process.mode import (
    BytesRead,
    Mode,
    odometry_frames,
    require_gravity,
    sample_settings,
    warned,
)
from sinstool.pipelines.process.summary import ConingUsed, FirstAttitude, ModeResult, Sink
from sinstool.survey.source import Source, imu_blocks


class AttitudeMode(Mode):
    """Attitude alone, and height where it is damped."""

    def __init__(self, source: Source, config: ProcessConfig, plan: Plan) -> None:
        super().__init__(source, config, plan)
        self._vertical = None
        self.emits = ("imu", "attitude")
        if config.vertical.height_damping != "off":
            from sinstool.pipelines.process.vertical_channel import Vertical

            require_gravity(source, config)
            self._vertical = Vertical(source, config)
            self.emits = (*self.emits, "height")
        self.frames = odometry_frames(source, plan, config)
        settings = AttitudeSettings(
            **sample_settings(source, config, plan), omega_ie_n=earth_rate(source)
        )
        self._run = AttitudeRun(plan.alignment.q_nb, settings)

    def show(self, sink: Sink) -> None:
        """The heights that the vertical channel is held to."""
        if self._vertical is not None:
            self._vertical.damping.show(sink)

    def solutions(self, progress: BytesRead | None) -> Iterator[Solution]:
        """Attitude at every update instant."""
        blocks = imu_blocks(self.source, self.plan.alignment.time_ns, progress)
        for solution in self._run.run(blocks):
            yield solution if self._vertical is None else self._vertical.push(solution)

    def conclude(self, last: Solution, sink: Sink | None) -> ModeResult:
        """The first attitude, the coning algorithm, the height, and what was odd."""
        settings, vertical = self._run.settings, self._vertical
        alignment = self.plan.alignment
        findings = list(warned("alignment", alignment.warnings))
        if vertical is not None:
            findings += warned("height", vertical.warnings())
        if settings.algorithm.caveat:
            findings.append(Finding("coning", settings.algorithm.caveat))
        if self._run.missed_rotation:
            turned = self._run.missed_rotation / DEGREE
            text = (
                "attitude is held across gaps: at the rates on either side the vehicle turned by"
                f" {turned:.3g} deg during them"
            )
            findings.append(Finding("gaps", text, numbers={"rotation_deg": turned}))
        if self.source.latitude is None:
            text = "no latitude is known, so the Earth's rate is not removed"
            findings.append(Finding("no-latitude", text, answer="give --latitude"))
        return ModeResult(
            alignment=FirstAttitude.of(alignment, self.plan.first_attitude.reason),
            coning=ConingUsed.of(settings.algorithm, settings.gyro_kind, self._run.updates),
            height=None if vertical is None else vertical.summary(),
            findings=tuple(findings),
        )
