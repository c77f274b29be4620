"""`--mode attitude`: attitude from a recorded IMU."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from sinstool.config import ProcessConfig
from sinstool.core.finding import Finding, Severity
from sinstool.core.streams import Diagnostics, Imu, Solution
from sinstool.core.units import DEGREE, DEGREE_PER_HOUR
from sinstool.methods.alignment.initial import NOT_STILL, Alignment
from sinstool.methods.strapdown.attitude import AttitudeRun, AttitudeSettings
from sinstool.pipelines.align.earth_rotation import earth_rate
from sinstool.pipelines.plan import Plan
from sinstool.pipelines.process.mode import (
    BytesRead,
    Mode,
    before_alignment,
    odometry_frames,
    require_gravity,
    sample_settings,
    warned,
)
from sinstool.pipelines.process.summary import ConingUsed, FirstAttitude, ModeResult, Sink
from sinstool.survey.gravity import without_gravity
from sinstool.survey.source import Source, imu_blocks

if TYPE_CHECKING:
    from sinstool.pipelines.process.smoothing import Smoothing

# A drift of roll and pitch over the log that is not worth a warning, rad.
SMALL_DRIFT = 0.1 * DEGREE


class AttitudeMode(Mode):
    """Attitude alone, and height where it is damped."""

    def __init__(self, source: Source, config: ProcessConfig, plan: Plan) -> None:
        super().__init__(source, config, plan)
        self._vertical = None
        self.emits = ("imu", "attitude")
        if config.vertical.height_damping != "off":
            from sinstool.pipelines.process.vertical_channel import Vertical

            require_gravity(source, config)
            self._vertical = Vertical(source, config, plan.alignment.q_nb)
            self.emits = (*self.emits, "height")
        self.frames = odometry_frames(source, plan, config)
        settings, earth = sample_settings(source, config, plan), earth_rate(source)
        self._smoothing: Smoothing | None = None
        if plan.attitude.value == "smoothed":
            require_gravity(source, config)
            # Compiled loops that integration alone does not need
            from sinstool.pipelines.process.smoothing import DIAGNOSTICS, Smoothing

            self._smoothing = Smoothing(source, config, plan, settings, earth)
            self.diagnostic_names = DIAGNOSTICS
            self.emits = (*self.emits, "diagnostics")
            self._run = self._smoothing.run
        else:
            self._run = AttitudeRun(
                plan.alignment.q_nb, AttitudeSettings(**settings, omega_ie_n=earth)
            )

    def show(self, sink: Sink) -> None:
        """Pass to a sink whether heading is free, and the heights used by the vertical channel."""
        compassed = self._smoothing is not None and self._smoothing.north_referenced is not None
        if not (self.plan.alignment.north_referenced or compassed):
            sink.free_heading()
        if self._vertical is not None:
            self._vertical.damping.show(sink)

    def find_out(self, progress: BytesRead | None) -> None:
        """Smooth over the whole log; that also shows whether heading counts from north."""
        # GNSS, barometer and magnetometer have been read
        self.source.log.cache(())
        if self._smoothing is not None:
            self._smoothing.find_out(self._blocks(0, progress))
            referenced = self._smoothing.north_referenced
            if referenced is not None:
                self.frames = replace(self.frames, reference="map" if referenced else "odom")

    def solutions(self, progress: BytesRead | None) -> Iterator[Solution]:
        """Attitude at every update instant."""
        for solution in self._attitudes(progress):
            yield solution if self._vertical is None else self._vertical.push(solution)

    def _attitudes(self, progress: BytesRead | None) -> Iterator[Solution]:
        if self._smoothing is None:
            begin_ns = self.plan.alignment.time_ns
            yield from self._run.run(imu_blocks(self.source, begin_ns, progress, last=True))
            return
        yield from self._smoothing.solutions(self._blocks(1, progress))
        self._run = self._smoothing.run

    def _blocks(self, number: int, progress: BytesRead | None) -> Iterator[Imu]:
        """The samples for a pass, 0 or 1; each pass is half of the progress."""
        size = self.source.log.size
        half = progress and (lambda read: progress((number * size + read) // 2))
        # Where samples were kept, their solutions are kept for the second pass.
        return imu_blocks(self.source, self.plan.alignment.time_ns, half, last=True)

    def new_diagnostics(self) -> Sequence[Diagnostics]:
        """Sigmas and biases, once they are known."""
        return () if self._smoothing is None else self._smoothing.new_diagnostics()

    def conclude(self, last: Solution, sink: Sink | None) -> ModeResult:
        """The first attitude, the coning algorithm, the height, and what was odd."""
        settings, vertical = self._run.settings, self._vertical
        alignment = self.plan.alignment
        # A smoothed attitude depends neither on its first tilt nor on its first bias.
        findings = [
            one
            for one in warned("alignment", alignment.warnings)
            if self._smoothing is None or not one.text.startswith(NOT_STILL)
        ]
        findings += before_alignment(self.source, alignment)
        if vertical is not None:
            findings += vertical.findings()
        findings += warned("coning", settings.algorithm.caveats(settings.gyro_kind))
        if self._run.missed_rotation:
            turned = self._run.missed_rotation / DEGREE
            what = "attitude" if self._smoothing is None else "heading"
            text = (
                f"{what} is held constant across gaps: at the rates on either side the vehicle"
                f" turned by {turned:.3g} deg during them"
            )
            findings.append(Finding("gaps", text, numbers={"rotation_deg": turned}))
        if self.source.latitude is None:
            text = "the latitude is unknown, so the Earth's rate is not removed"
            findings.append(Finding("no-latitude", text, answer="give --latitude"))
        elif self._smoothing is None and not alignment.north_referenced:
            findings += self._turned_earth_rate()
        smoothing = self._smoothing
        if smoothing is not None:
            findings += smoothing.findings()
        elif self.config.navigation.attitude == "auto" and without_gravity(self.source):
            findings.append(_not_held(alignment))
        return ModeResult(
            smoothing=None if smoothing is None else smoothing.summary,
            alignment=FirstAttitude.of(alignment, self.plan.first_attitude.reason),
            coning=ConingUsed.of(settings.algorithm, settings.gyro_kind, self._run.updates),
            height=None if vertical is None else vertical.summary(),
            findings=tuple(findings),
        )

    def _turned_earth_rate(self) -> list[Finding]:
        """That its level part is taken off in a direction that a heading of 0 has."""
        earth = earth_rate(self.source)
        assert earth is not None
        drift = 2.0 * float(earth[0])
        if drift * self.source.survey.duration_s < SMALL_DRIFT:
            return []
        per_hour = drift / DEGREE_PER_HOUR
        text = (
            "heading does not count from north, so the level part of the Earth's rate is removed"
            f" in a wrong direction: roll and pitch may drift by {per_hour:.2g} deg/h"
        )
        answer = "give --initial-attitude with --align fixed, or --attitude smoothed"
        return [Finding("earth-rate", text, answer=answer, numbers={"drift_deg_h": per_hour})]


def _not_held(alignment: Alignment) -> Finding:
    """That gravity does not hold roll and pitch, nor show the first ones."""
    text = "the specific force is not of gravity's size, so it does not hold roll and pitch"
    if alignment.method.startswith("level"):
        return Finding(
            "gravity-unused",
            f"{text}; the first ones come from it all the same, and may be wrong by any angle",
            answer="look for accelerometers that saturate or have a wrong unit, or give the first"
            " attitude by --align log or --align fixed",
            severity=Severity.LOST,
        )
    return Finding("gravity-unused", f"{text}: they drift as the gyros do")
