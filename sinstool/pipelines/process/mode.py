"""The interface of all modes: a mode computes solutions, the runner writes them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from sinstool.config import ProcessConfig
from sinstool.core.errors import DataError
from sinstool.core.finding import Finding, Severity
from sinstool.core.streams import Diagnostics, Solution
from sinstool.core.timeline import SECOND
from sinstool.io.writers.solution_topics import Frames
from sinstool.methods.alignment.initial import Alignment
from sinstool.pipelines.align.first_attitude import rest_held
from sinstool.pipelines.plan import Plan
from sinstool.pipelines.process.summary import ModeResult, Sink
from sinstool.survey.oddities import oddities
from sinstool.survey.source import Source, nominal_interval

# m/s^2. No vehicle's median; beyond it a specific force is in mg or cm/s^2. (The survey counts
# what is larger than 100 as 100.)
MAX_SPECIFIC_FORCE = 90.0

# More than this share of a log without a solution counts as lost, and less than so many seconds
# as nothing.
MOST_WITHOUT, BRIEF_S = 0.5, 1.0

BytesRead = Callable[[int], None]


class Mode(ABC):
    """One kind of run on one log.

    Attributes
    ----------
    emits : sequence of str
        What it writes unless the configuration says otherwise; beside it there are always Euler
        angles, poses and transforms.
    """

    emits: Sequence[str]
    frames: Frames
    diagnostic_names: Sequence[str] = ()

    def __init__(self, source: Source, config: ProcessConfig, plan: Plan) -> None:
        self.source, self.config, self.plan = source, config, plan

    def show(self, sink: Sink) -> None:  # noqa: B027 - most have nothing to show before they run
        """Pass the run's references to a sink."""

    def find_out(self, progress: BytesRead | None) -> None:  # noqa: B027 - most know it all
        """Do the passes that must precede any output."""

    @abstractmethod
    def solutions(self, progress: BytesRead | None) -> Iterator[Solution]:
        """Compute, block by block."""

    def new_diagnostics(self) -> Sequence[Diagnostics]:
        """Diagnostics since the last call."""
        return ()

    @abstractmethod
    def conclude(self, last: Solution, sink: Sink | None) -> ModeResult:
        """Result of the run, once all solutions are written."""


def odometry_frames(source: Source, plan: Plan, config: ProcessConfig) -> Frames:
    """Frames of a run: ``map`` where heading counts from north, else ``odom``."""
    referenced = plan.alignment.north_referenced and source.latitude is not None
    return Frames(
        config.output.world,
        "map" if referenced else "odom",
        source.body_frame,
        config.input.body_axes,
    )


def sample_settings(source: Source, config: ProcessConfig, plan: Plan) -> dict[str, Any]:
    """Settings for integrating samples from the plan's first attitude.

    Returns
    -------
    dict
        By the names of :class:`~sinstool.methods.strapdown.segment_samples.SampleSettings`.
    """
    alignment = plan.alignment
    still = rest_held(source, alignment)
    return {
        "algorithm": plan.algorithm,
        "gyro_kind": config.input.sample_kind,
        "nominal_ns": nominal_interval(source, config),
        "max_gap_ns": source.survey.max_gap_ns,
        "gyro_bias": alignment.gyro_bias,
        "sample_rate": config.input.imu_rate,
        "still_until_ns": None if still is None else still.end_ns,
    }


def before_alignment(source: Source, alignment: Alignment) -> list[Finding]:
    """That the first attitude is that of a later time, and nothing is computed of what precedes.

    Returns
    -------
    list of Finding
        One, lost if that is most of the log, where it is a second or more.
    """
    survey, begin_ns = source.survey, alignment.time_ns
    without_s = (begin_ns - survey.first_ns) / SECOND
    if without_s < BRIEF_S:
        return []
    most = begin_ns - survey.first_ns > MOST_WITHOUT * (survey.last_ns - survey.first_ns)
    return [
        Finding(
            "before-start",
            f"the first {without_s:.2f} s have no solution, as the first attitude is that of a"
            " later time and is not carried back to them",
            Severity.LOST if most else Severity.WARNING,
            "choose another first attitude: --align level, log or fixed",
            "",
            survey.first_ns,
            begin_ns,
        )
    ]


def warned(kind: str, texts: Sequence[str]) -> tuple[Finding, ...]:
    """Findings of one kind, from texts."""
    return tuple(Finding(kind, text) for text in texts)


def require_gravity(source: Source, config: ProcessConfig) -> None:
    """Refuse accelerometers whose integral is no velocity: without gravity, or in a strange unit.

    Raises
    ------
    DataError
    """
    if config.input.accel_unit is not None:
        return  # a user who names the unit has looked at the numbers
    survey = source.survey
    if any(odd.kind == "no-gravity" for odd in oddities(survey, config.input)):
        raise DataError(
            source.path,
            f"topic {survey.topic}: the specific force is only"
            f" {survey.specific_force_median:.3f} m/s^2 in size: gravity has been removed from it,"
            " so velocity and height cannot be computed",
            "choose the topic with raw accelerations by --imu-topic, or use --mode attitude"
            " --attitude inertial without --height-damping (--accel-unit m/s^2 if the vehicle"
            " falls freely)",
        )
    if survey.specific_force_median > MAX_SPECIFIC_FORCE:
        raise DataError(
            source.path,
            f"topic {survey.topic}: the specific force is mostly"
            f" {survey.specific_force_median:.3g} m/s^2 in size or more: its unit may be mg or"
            " cm/s^2",
            "sensor_msgs/Imu holds m/s^2: convert it, or choose another topic with --imu-topic",
        )
