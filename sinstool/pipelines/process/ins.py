"""`--mode ins`: attitude, velocity and position from inertial data, height damped or not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.earth import SEMI_MAJOR_AXIS
from sinstool.core.english import in_seconds
from sinstool.core.finding import Finding, Severity
from sinstool.core.streams import GnssEpochs, Solution, concatenate
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE_PER_HOUR, MILLI_G, STANDARD_GRAVITY
from sinstool.methods.alignment.initial import Alignment
from sinstool.methods.height import layout
from sinstool.methods.height.network import gravity_gradient
from sinstool.methods.height.vertical import MAX_HOLD, beginning_quickly
from sinstool.methods.strapdown.free_inertial import InsRun, InsSettings
from sinstool.pipelines.plan import Plan
from sinstool.pipelines.process.height import Damping, damping, with_heights_of_imu
from sinstool.pipelines.process.height_beside_gnss import HeightBesideGnss
from sinstool.pipelines.process.height_events import height_warnings, untrusted_heights
from sinstool.pipelines.process.height_lag import HeightLag
from sinstool.pipelines.process.ins_start import errors_at_fixes, start_state
from sinstool.pipelines.process.mode import (
    BytesRead,
    Mode,
    before_alignment,
    odometry_frames,
    require_gravity,
    sample_settings,
    warned,
)
from sinstool.pipelines.process.summary import (
    ConingUsed,
    FirstAttitude,
    GnssDifference,
    ModeResult,
    Sink,
)
from sinstool.survey.oddities import found_gaps
from sinstool.survey.rest import rests_across
from sinstool.survey.source import Source, imu_blocks

# Plausible bias of a MEMS accelerometer, for an example: 1 mg.
EXAMPLE_BIAS = MILLI_G
# Plausible bias of a MEMS gyro after removal of its mean at rest.
EXAMPLE_DRIFT = 10.0 * DEGREE_PER_HOUR


class InsMode(Mode):
    """Inertial navigation, its height damped or not."""

    def __init__(self, source: Source, config: ProcessConfig, plan: Plan) -> None:
        require_gravity(source, config)
        super().__init__(source, config, plan)
        order = config.navigation.attitude_order
        settings = InsSettings(
            **sample_settings(source, config, plan), order=0 if order == "exact" else int(order)
        )
        state, self._notes, known = start_state(source, plan.alignment, settings, config)
        self._latitude, longitude, height = state[:3].tolist()
        self._damping: Damping | None = None
        self._height_beside: HeightBesideGnss | None = None
        self._lag = HeightLag(None, 0.0)
        self.emits = ("imu", "attitude", "odometry", "fix", "tf")
        if config.vertical.height_damping != "off":
            self.emits = (*self.emits, "height")
            source = with_heights_of_imu(source, config, plan.alignment.q_nb)
            self._damping, notes = damping(source, config, self._latitude, height)
            self._notes += notes
            self._height_beside = HeightBesideGnss(self._damping.reference, source.aiding.gnss)
            self._lag = HeightLag(self._damping.reference, config.vertical.baro_lag)
            parameters = layout.new_parameters(
                self._damping.network, self._damping.grade.grade, baro_lag=config.vertical.baro_lag
            )
            if not known:
                parameters = beginning_quickly(parameters)
            settings = replace(settings, parameters=parameters, reference=self._damping.reference)
        origin = (self._latitude, longitude, height)
        self.frames = replace(odometry_frames(source, plan, config), origin=origin)
        self._run = InsRun(state, settings)
        self._beside: Solution | None = None  # the last that has a fix within
        self._late_ns = round((config.gnss.gnss_latency or 0.0) * SECOND)

    def show(self, sink: Sink) -> None:
        """Pass to a sink the reference heights, and the fixes, which the run does not use."""
        if self._damping is not None:
            self._damping.show(sink)
        gnss = self.source.aiding.gnss
        if gnss is not None:
            sink.refer_track(gnss.latitude, gnss.longitude)

    def solutions(self, progress: BytesRead | None) -> Iterator[Solution]:
        """Attitude, velocity and position at every update instant."""
        gnss = self.source.aiding.gnss
        fixes_ns = np.zeros(0, np.int64) if gnss is None else gnss.time_ns[gnss.has_position]
        fixes_ns = fixes_ns - self._late_ns
        end: Solution | None = None
        for solution in self._run.run(
            imu_blocks(self.source, self.plan.alignment.time_ns, progress)
        ):
            if len(solution):
                first = solution if end is None else end
                if np.searchsorted(fixes_ns, first.time_ns[0]) < np.searchsorted(
                    fixes_ns, solution.time_ns[-1], "right"
                ):
                    self._beside = concatenate([solution] if end is None else [end, solution])
                end = solution.rows(slice(-1, None))
            if self._height_beside is not None:
                self._height_beside.push(solution)
            self._lag.push(solution)
            yield solution

    def conclude(self, last: Solution, sink: Sink | None) -> ModeResult:
        """First attitude, coning, height, and the distance of the run from GNSS at its end."""
        run, alignment, settings = self._run, self.plan.alignment, self._run.settings
        seconds = (int(last.time_ns[-1]) - run.first_ns) / SECOND
        height, texts = None, list(self._notes)
        untrusted: list[Finding] = []
        if self._damping is not None:
            assert last.vertical is not None
            height = self._damping.result(run.channel, run.events, run.first_ns, last.vertical[-1])
            begins_s = (run.first_ns - self.source.survey.first_ns) / SECOND
            texts += height_warnings(run.channel, run.events, begins_s)
            sigma = self._damping.reference.sigma
            untrusted = untrusted_heights(run.events, run.first_ns, begins_s, seconds, sigma)
            assert self._height_beside is not None
            texts += [*self._lag.warnings(), *self._height_beside.warnings()]
        else:
            texts.append(undamped_warning(self._latitude, seconds))
        arm_b = np.array(self.config.gnss.lever_arm or (0.0, 0.0, 0.0))
        off = difference_to_gnss(self._beside, self.source.aiding.gnss, self._late_ns, arm_b)
        texts.append(drift_warning(seconds, off, run.first_ns))
        baro = self.source.aiding.barometer
        damped_by_baro = self.config.vertical.height_damping == "baro"
        return ModeResult(
            alignment=FirstAttitude.of(alignment, self.plan.first_attitude.reason),
            coning=ConingUsed.of(settings.algorithm, settings.gyro_kind, run.updates),
            height=height,
            gnss_difference=off,
            findings=(
                *(baro.findings if damped_by_baro else ()),
                *warned("alignment", alignment.warnings),
                *before_alignment(self.source, alignment),
                *_rotated(alignment),
                *gap_findings(self.source, run.first_ns, settings.gyro_bias),
                *warned("navigation", texts),
                *untrusted,
                *warned("navigation", _run_warnings(run)),
            ),
        )


def _rotated(alignment: Alignment) -> list[Finding]:
    """A track in an unknown direction is not to be trusted."""
    if alignment.north_referenced:
        return []
    return [
        Finding(
            "unknown-heading",
            "heading at the start is not referenced to north, so the whole track is rotated by the"
            " unknown heading: do not trust its positions and velocities",
            severity=Severity.LOST,
            answer="use --align log, fixed or a method that finds north, or --mode ins-gnss, which"
            " also starts from fixes without velocity",
        )
    ]


def gap_findings(source: Source, first_ns: int, gyro_bias: np.ndarray) -> list[Finding]:
    """Which gaps of the IMU are integrated across, and those in which the vehicle was in motion.

    Parameters
    ----------
    first_ns : int
        Of the run.
    gyro_bias : ndarray, shape (3,)
        That it removes, rad/s.
    """
    survey, held_ns = source.survey, round(MAX_HOLD * SECOND)
    if not survey.gap_count:
        return []
    findings = [replace(found_gaps(survey, held_ns), topic=survey.topic)]
    lost = [
        (begin, begin + round(length * SECOND))
        for begin, length in survey.gaps
        if length > MAX_HOLD and begin >= first_ns
    ]
    spans = survey.spans
    lost = [gap for gap in lost if not rests_across(spans, *gap, gyro_bias)]
    if lost:
        seconds = [(time - survey.first_ns) / SECOND for time in lost[0]]
        text = (
            f"the IMU has no samples from {seconds[0]:.1f} to {seconds[1]:.1f} s, and the vehicle"
            " is not at rest on both sides: attitude and velocity are held there, whatever it did;"
            " do not trust the solution from then on"
        )
        findings.append(
            Finding(
                "moved-in-gap",
                text,
                severity=Severity.LOST,
                answer="end before it with --end, start after it with --start, or use --mode"
                " ins-gnss where there are fixes",
                topic=survey.topic,
                start_ns=lost[0][0],
                numbers={"gaps": float(len(lost))},
            )
        )
    return findings


def undamped_warning(latitude: float, seconds: float) -> str:
    """Growth of an error of height without damping, as gravity decreases with height.

    Parameters
    ----------
    latitude : float
        rad.
    seconds : float
        Length of the run.
    """
    rate = float(np.sqrt(gravity_gradient(latitude)))
    # at the ends of 10^4 s and more the numbers only say: very far
    grown = float(np.cosh(min(rate * seconds, 50.0)))
    by_bias = EXAMPLE_BIAS * (grown - 1.0) / rate**2
    return (
        f"height is not damped and runs away: in these {seconds:.0f} s an error of 1 m at the start"
        f" grows to {_three(grown)} m, and 1 mg of the vertical accelerometer makes"
        f" {_three(by_bias)} m;"
        " --height-damping baro or gnss holds it"
    )


def drift_warning(seconds: float, off: GnssDifference | None, first_ns: int) -> str:
    """Drift of position without fixes, and its difference from those that were not used.

    By a constant error of an accelerometer, and of a gyro, about level (Titterton and Weston,
    "Strapdown Inertial Navigation Technology", 2nd ed., 2004, table 12.2).

    Parameters
    ----------
    seconds : float
        Length of the run.
    off : GnssDifference or None
        At the last fix.
    first_ns : int
        Of the run.
    """
    rate = np.sqrt(STANDARD_GRAVITY / SEMI_MAJOR_AXIS)  # of Schuler
    turned = rate * seconds
    by_accel = EXAMPLE_BIAS / rate**2 * (1.0 - np.cos(turned))
    by_gyro = EXAMPLE_DRIFT * SEMI_MAJOR_AXIS * (seconds - np.sin(turned) / rate)
    text = (
        f"position and velocity drift without fixes: in these {seconds:.0f} s 1 mg of a horizontal"
        f" accelerometer makes {_three(by_accel)} m, and 10 deg/h of a horizontal gyro"
        f" {_three(by_gyro)} m"
    )
    if off is not None:
        at = (off.time_ns - first_ns) / SECOND
        distance = _three(float(np.hypot(off.north_m, off.east_m)))
        text += f"; at the last fix, after {at:.0f} s, position is {distance} m off;"
        text += " --mode ins-gnss uses the fixes"
    return text


def _three(value: float) -> str:
    """A number with three digits, zeros included."""
    return f"{value:#.3g}".rstrip(".")


def difference_to_gnss(
    beside: Solution | None, gnss: GnssEpochs | None, late_ns: int, arm_b: np.ndarray
) -> GnssDifference | None:
    """Position less that of the last fix, while there are solutions around it.

    Parameters
    ----------
    beside : Solution or None
        The last part of a run that has a fix within.
    late_ns : int
        Age of a fix at its stamp.
    arm_b : ndarray, shape (3,)
        From the IMU to the antenna, m.
    """
    if gnss is None or beside is None or beside.position is None:
        return None
    when_ns = gnss.time_ns - late_ns
    inside = (when_ns >= beside.time_ns[0]) & (when_ns <= beside.time_ns[-1])
    rows = np.flatnonzero(inside & gnss.has_position)[-1:]
    if not len(rows):
        return None
    seconds = (when_ns[rows] - beside.time_ns[0]) / SECOND
    north, east, down = errors_at_fixes(gnss.rows(rows), seconds, beside, arm_b)[0][0].tolist()
    return GnssDifference(
        time_ns=int(gnss.time_ns[rows[0]]),
        north_m=-north,
        east_m=-east,
        up_m=down if np.isfinite(down) else None,
    )


def _run_warnings(run: InsRun) -> list[str]:
    notes = list(run.settings.algorithm.caveats(run.settings.gyro_kind))
    if run.gaps_s:
        notes.append(
            f"{in_seconds(run.gaps_s, 3)} are without IMU data: gaps up to {MAX_HOLD:g} s are"
            " bridged with the values on either side, longer ones at constant velocity"
        )
    if run.diverged_ns is not None:
        seconds = (run.diverged_ns - run.first_ns) / SECOND
        notes.append(
            f"after {seconds:.0f} s the solution reached 1000 km or 20 km/s and is held"
            " there: an undamped vertical channel diverges, or the start was wrong"
        )
    return notes
