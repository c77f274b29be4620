"""An INS/GNSS filter over a log: its answers as solutions, smoothed if asked for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.config.align import GnssOptions
from sinstool.core.finding import Finding
from sinstool.core.streams import Diagnostics, Imu, Solution
from sinstool.core.timeline import SECOND
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.ins_gnss.diagnosis import diagnose
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.results import (
    FilterBlock,
    FilterEvent,
    GnssDiagnostics,
    UpdateColumns,
)
from sinstool.methods.ins_gnss.settings import Start
from sinstool.methods.ins_gnss.smoother import SmoothedEpochs, Smoother
from sinstool.methods.ins_gnss.withheld import Withheld
from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.process.height import height_summary, height_warnings
from sinstool.pipelines.process.ins_gnss.before_start import before_start, corrected_start
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.summary import (
    FilterStartTime,
    FilterUsed,
    HeightDamping,
    ImuGrade,
    LatencyUsed,
    WithheldScores,
)
from sinstool.survey.increments import SegmentIncrements
from sinstool.survey.source import Source

DIAGNOSTIC_NAMES = (
    "nis / rows",
    *(
        f"{what} {axis} {unit}"
        for what, unit in (("innovation position", "m"), ("innovation velocity", "m/s"))
        for axis in ("north", "east", "down")
    ),
    *(
        f"{what} {axis} {unit}"
        for what, unit in (("expected position", "m"), ("expected velocity", "m/s"))
        for axis in ("north", "east", "down")
    ),
)


# What is wrong shows within minutes.
DIAGNOSED_NS = 300 * SECOND
USUAL_SIGMA_V = GnssOptions().gnss_sigma_v


DETAIL_ROWS = 512


def _pieces(
    steps: Iterator[tuple[Increments, Imu, Imu | None]], rows: int | None
) -> Iterator[tuple[Increments, Imu]]:
    """Increments with their samples, in pieces of so many."""
    for increments, imu, _ in steps:
        count = len(increments.sample) if rows is None else rows
        for first in range(0, len(increments.sample), count):
            part = slice(first, first + count)
            yield Increments(*(v[part] for v in vars(increments).values())), imu.rows(part)


class FilterRun:
    """A filter over a log, its answers as solutions, smoothed if asked for.

    Attributes
    ----------
    detailed : bool
        Note biases often enough to be drawn.
    carried_back : int
        Samples up to the start that got its state carried back.
    gnss : list of GnssDiagnostics
        All so far.
    """

    def __init__(
        self,
        source: Source,
        config: ProcessConfig,
        start: FilterStart,
        algorithm: ConingAlgorithm,
    ) -> None:
        self.detailed = False
        self.algorithm = algorithm
        self._source, self._config, self._start = source, config, start
        self._steps = SegmentIncrements(source, config, algorithm)
        self.updates = 0
        self.carried_back = 0
        self.gnss: list[GnssDiagnostics] = []
        self._unwritten: list[GnssDiagnostics] = []
        self._biases: list[tuple[int, np.ndarray, np.ndarray]] = []
        self._first: list[UpdateColumns] = []
        self._offset_ns = 0
        self._smooth = config.filter.smooth
        valid = replace(
            start.gnss,
            time_ns=start.gnss.time_ns - round(start.settings.gnss_latency * SECOND),
        )
        arm = start.settings.lever_arm_b
        self._hidden = bool(start.withheld.any())
        self._score = Withheld(valid, start.withheld, arm)
        self._filtered = Withheld(valid, start.withheld, arm)
        self._filter = InsGnssFilter(
            start.start,
            start.settings,
            with_baro=start.reference is not None,
            store=self._smooth,
        )

    def solutions(self, progress: Any = None) -> Iterator[Solution]:
        """Filtered, or smoothed, at every update instant, from the log's start on."""
        if not self._smooth:
            start = self._start.start
            yield from self._scored(self._earlier(start))
            for block, imu in self._run(progress):
                assert block.updates is not None
                yield from self._scored(self._solution(block.updates, imu.log_time_ns))
            return
        log_times: list[np.ndarray] = []
        with Smoother(self._filter.kind) as smoother:
            for block, imu in self._run(progress):
                assert block.updates is not None
                if self._hidden:
                    self._filtered.push(self._solution(block.updates, imu.log_time_ns))
                smoother.push(block)
                log_times.append(imu.log_time_ns)
            if not log_times:
                return
            log_time = np.concatenate(log_times)
            smoothed = smoother.epochs()
            yield from self._scored(self._earlier(self._smoothed_start(smoothed)))
            begin = 0
            for updates in smoother.blocks(smoothed):
                end = begin + len(updates)
                yield from self._scored(self._solution(updates, log_time[begin:end]))
                begin = end

    def _scored(self, solution: Solution | None) -> Iterator[Solution]:
        if solution is not None:
            if self._hidden:
                self._score.push(solution)
            yield solution

    def _earlier(self, start: Start) -> Solution | None:
        """What lies before the start."""
        earlier = before_start(self._source, self._config, self.algorithm, self._start, start)
        self.carried_back = 0 if earlier is None else len(earlier)
        return earlier

    def _smoothed_start(self, smoothed: SmoothedEpochs) -> Start:
        """The start as all of the log says it was."""
        start = self._start.start
        if not np.isfinite(smoothed.first_error).all():
            return start
        return corrected_start(
            start, smoothed.first_error, smoothed.first_covariance, smoothed.kind
        )

    def _run(self, progress: Any) -> Iterator[tuple[FilterBlock, Imu]]:
        p = self._start
        pushed = False
        steps = self._steps.from_time(p.time_ns, progress=progress)
        for increments, imu in _pieces(steps, DETAIL_ROWS if self.detailed else None):
            measurements: dict[str, Any] = {}
            if not pushed:
                measurements = {"gnss": p.gnss, "withheld": p.withheld}
                if p.reference is not None:
                    r = p.reference
                    later = r.arrival_ns >= p.time_ns
                    measurements |= {
                        "baro_time_ns": r.time_ns[later],
                        "baro_height": r.height[later],
                        "baro_reason": r.reason[later],
                    }
                pushed = True
            block = self._filter.push(increments, **measurements)
            self.updates += len(increments.sample)
            self._keep(block.updates)
            estimate = self._filter.summary
            self._biases.append((int(imu.time_ns[-1]), estimate.gyro_bias, estimate.accel_bias))
            self._offset_ns = int(imu.log_time_ns[-1]) - int(imu.time_ns[-1])
            if len(block.gnss):
                self.gnss.append(block.gnss)
                self._unwritten.append(block.gnss)
            yield block, imu

    def _keep(self, updates: UpdateColumns | None) -> None:
        """The first minutes, to tell by what is wrong if something is."""
        if updates is None or not len(updates):
            return
        if self._first and int(updates.time_ns[0]) > int(self._first[0].time_ns[0]) + DIAGNOSED_NS:
            return
        self._first.append(updates)

    def findings(self) -> list[Finding]:
        """What seems to be wrong with settings or sensors, the likeliest cause first."""
        p, gnss = self._start, self.diagnostics()
        if gnss is None or not self._first:
            return []
        columns = list(vars(self._first[0]))
        updates = UpdateColumns(
            **{c: np.concatenate([getattr(u, c) for u in self._first]) for c in columns}
        )
        findings = diagnose(
            p.start,
            updates,
            gnss,
            p.used,
            p.settings,
            self._filter.summary.restarts,
        )
        return [self._completed(f) for f in findings if self._matters(f)]

    def _completed(self, finding: Finding) -> Finding:
        """Slow errors of fixes, taken for small ones, look like those of an IMU."""
        if finding.kind != "imu-noise" or self._config.filter.gnss_noise_scale >= 1.0:
            return finding
        more = "; or --gnss-noise-scale is too small"
        return replace(finding, answer=finding.answer + more)

    def _matters(self, finding: Finding) -> bool:
        """What follows from no option, the user need not put right."""
        gnss, options = self._config.gnss, self._config.filter
        if finding.kind == "latency":
            return self._start.latency is None
        if finding.kind == "gnss-noise" and finding.numbers["sigma_ratio"] < 1.0:
            # Receivers that filter their fixes claim more than the noise that is left in them
            stated = options.gnss_sigma is not None or gnss.gnss_sigma_v != USUAL_SIGMA_V
            return stated or options.gnss_noise_scale > 1.0
        return True

    def _solution(self, u: UpdateColumns, log_time: np.ndarray) -> Solution:
        vertical = None
        if self._start.reference is not None:
            vertical = np.stack([u.height, -u.velocity_n[:, 2], u.correction], axis=1)
        return Solution(
            u.time_ns,
            log_time,
            u.q_nb,
            u.omega_ib_b,
            u.specific_force_b,
            np.stack([u.latitude, u.longitude, u.height], axis=1),
            u.velocity_n,
            vertical,
            u.covariance_position_n,
            u.covariance_velocity_n,
            u.covariance_attitude_n,
        )

    @property
    def first_ns(self) -> int:
        """Time of the log's first sample."""
        return self._source.survey.first_ns

    @property
    def events(self) -> list[FilterEvent]:
        """What the filter noted."""
        return self._filter.events

    def biases(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Times, ns, and gyro (rad/s) and accelerometer (m/s^2) biases after each block."""
        if not self._biases:
            return np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3))
        times, gyro, accel = zip(*self._biases, strict=True)
        return np.array(times, np.int64), np.array(gyro), np.array(accel)

    def new_diagnostics(self) -> list[Diagnostics]:
        """Diagnostics since the last call, for writing."""
        out = []
        for g in self._unwritten:
            values = np.concatenate(
                [(g.nis / np.maximum(g.rows, 1))[:, None], g.innovation, g.innovation_sigma], axis=1
            )
            level = np.where(g.restarted, 2, np.where(g.gated, 1, 0))
            out.append(Diagnostics(g.time_ns, g.time_ns + self._offset_ns, level, values))
        self._unwritten = []
        return out

    def diagnostics(self) -> GnssDiagnostics | None:
        """All of them as one."""
        if not self.gnss:
            return None
        names = list(vars(self.gnss[0]))
        return GnssDiagnostics(
            **{n: np.concatenate([getattr(g, n) for g in self.gnss]) for n in names}
        )

    def summary(self) -> FilterUsed:
        """The filter: what it was, what it used, and what it estimated last."""
        p, s = self._start, self._filter.summary
        events: dict[str, int] = {}
        for event in self._filter.events:
            events[event.kind] = events.get(event.kind, 0) + 1
        return FilterUsed(
            filter=s.filter,
            asked=self._config.filter.filter,
            states=self._filter.kind.size,
            smoothed=self._smooth,
            feedback=p.settings.feedback,
            start=FilterStartTime(p.time_ns, p.how),
            imu_grade=ImuGrade(p.grade, p.grade_why),
            gnss_noise=p.gnss_why,
            gnss_latency_s=p.settings.gnss_latency,
            gnss_latency=self._latency(),
            lever_arm_m=tuple(p.settings.lever_arm_b),
            updates=s.updates,
            epochs_used=s.epochs_used,
            epochs_gated=s.epochs_gated,
            epochs_before_start=s.epochs_before_start,
            restarts=s.restarts,
            mean_nis=s.mean_nis,
            gyro_bias_rad_s=tuple(s.gyro_bias.tolist()),
            accel_bias_m_s2=tuple(s.accel_bias.tolist()),
            accel_scale=tuple(s.accel_scale.tolist()),
            baro_bias_m=s.baro_bias,
            events=events,
            withheld=self._scores(),
        )

    def _latency(self) -> LatencyUsed:
        """When fixes were taken to be valid, and how that is known."""
        p = self._start
        estimate = p.latency
        sure = estimate is not None and bool(np.isfinite(estimate.sigma_s))
        half = 0.5 * p.lag
        return LatencyUsed(
            status="given" if estimate is None else estimate.status,
            sigma_s=estimate.sigma_s if estimate is not None and sure else None,
            estimate_s=estimate.latency_s if estimate is not None and sure else None,
            position_s=p.settings.gnss_latency - half,
            velocity_s=p.settings.gnss_latency + half,
        )

    def _scores(self) -> WithheldScores | None:
        """How far the solutions were from the fixes that the filter did not see."""
        score = self._score.score()
        if score is None:
            return None
        filtered = self._filtered.score() if self._smooth else None
        return WithheldScores(score.outages, score.rms_of_largest_horizontal_m, filtered)

    def height(self, last: Solution) -> HeightDamping | None:
        """What held the height, where a barometer did."""
        p, s = self._start, self._filter.summary
        if p.reference is None or last.vertical is None or s.gains is None:
            return None
        return height_summary(
            p.reference,
            p.settings.damping,
            s.channel,
            self._filter.channel_events,
            p.time_ns,
            last.vertical[-1],
            ImuGrade(p.grade, p.grade_why),
        )

    def warnings(self) -> list[Finding]:
        """What a user has to know about the run, the likeliest causes of trouble included."""
        p, s = self._start, self._filter.summary
        findings: list[Finding] = []

        def note(kind: str, text: str, answer: str = "") -> None:
            findings.append(Finding(kind, text, answer=answer))

        if self.algorithm.caveat:
            note("coning", self.algorithm.caveat)
        if s.fell_back:
            note(
                "no-barometer",
                f"the log has no barometer, so {self._config.filter.filter} runs without its"
                f" network, as {s.filter}",
            )
        if p.latency is not None and p.settings.gnss_latency != 0.0:
            note(
                "latency-used",
                f"fixes were found to be valid {p.settings.gnss_latency:+.3f} s before their stamps"
                f" (sigma {p.latency.sigma_s * 1e3:.1f} ms) and are used so; give"
                " --gnss-latency to say otherwise",
            )
        if p.lag != 0.0 and self._config.filter.gnss_velocity_lag is None:
            note(
                "velocity-lag-used",
                f"the receiver's velocities are stamped {1e3 * p.lag:+.0f} ms later than its"
                " positions, and both are used at their own times; give --gnss-velocity-lag to say"
                " otherwise",
            )
        before = (p.time_ns - self._source.survey.first_ns) / SECOND
        if before > 0.0 and self.carried_back:
            note(
                "before-start",
                f"the first {before:.2f} s lie before the filter's start: the solution there is"
                " that of the start, carried back by the Imu alone",
            )
        elif before > 0.0:
            note(
                "before-start",
                f"the first {before:.2f} s lie before the filter's start and have no solution",
            )
        if self._config.filter.filter == "plain-15":
            note(
                "white-fixes",
                "plain-15 takes errors of fixes for white: where they last, its position sigmas are"
                " several times too small, and innovations do not show it",
            )
        findings += self.findings()
        if s.restarts:
            note(
                "restarts",
                f"the filter began anew {s.restarts} times: fixes were rejected for too long",
            )
        if s.epochs_gated:
            note(
                "rejected-fixes",
                f"{s.epochs_gated} of {s.epochs_used + s.epochs_gated} fixes were rejected",
            )
        if p.reference is not None:
            texts = height_warnings(s.channel, self._filter.channel_events)
            findings += [Finding("height", text) for text in texts]
        return findings
