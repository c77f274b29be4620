"""`--mode ins-gnss`: inertial navigation corrected by GNSS, filtered or smoothed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.arrays import IntArray
from sinstool.core.errors import AlignmentError
from sinstool.core.finding import Finding, Severity
from sinstool.core.result import fields_in
from sinstool.core.rotation import from_dcm
from sinstool.core.streams import Diagnostics, Imu, Solution, concatenate, take_rows
from sinstool.core.timeline import SECOND
from sinstool.io.writers.solution_topics import Frames
from sinstool.methods.ins_gnss.clock_rate import ClockRate
from sinstool.methods.ins_gnss.constraints import Constraints
from sinstool.methods.ins_gnss.diagnosis import diagnose
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.offsets_error import OffsetsError
from sinstool.methods.ins_gnss.results import (
    FilterBlock,
    FilterEvent,
    GnssDiagnostics,
    UpdateColumns,
)
from sinstool.methods.ins_gnss.settings import Start
from sinstool.methods.ins_gnss.smoother import Smoother
from sinstool.methods.ins_gnss.withheld import Withheld
from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.plan import Plan
from sinstool.pipelines.process.filter_used import (
    FilterStartTime,
    FilterUsed,
    WithheldScores,
)
from sinstool.pipelines.process.height import Damping
from sinstool.pipelines.process.height_events import height_warnings
from sinstool.pipelines.process.height_lag import HeightLag
from sinstool.pipelines.process.ins_gnss import settings_used
from sinstool.pipelines.process.ins_gnss.before_start import (
    before_start,
    before_start_finding,
    smoothed_start,
)
from sinstool.pipelines.process.ins_gnss.between_gaps import (
    Stretch,
    before_short_gaps,
    channel_events_of,
    events_of,
    gap_findings,
    longest_carried,
    start_after_gap,
    start_before_gaps,
    summed,
    vehicle_of,
)
from sinstool.pipelines.process.ins_gnss.contradictions import contradictions
from sinstool.pipelines.process.ins_gnss.false_fixes import find_false_fixes
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart, measurements
from sinstool.pipelines.process.ins_gnss.sample_kind import with_sample_kind
from sinstool.pipelines.process.ins_gnss.start import earliest_start, timed_start
from sinstool.pipelines.process.ins_gnss.stated_antenna import start_by_antenna
from sinstool.pipelines.process.ins_gnss.unsmoothed_velocity import with_unsmoothed_velocity
from sinstool.pipelines.process.ins_gnss.untrusted import (
    TOO_MANY_REJECTED,
    doubts,
    marked,
    untrusted,
)
from sinstool.pipelines.process.ins_gnss.vehicle import FirstPass, first_pass
from sinstool.pipelines.process.mode import BytesRead, Mode, warned
from sinstool.pipelines.process.summary import ConingUsed, FilterCourse, ModeResult, Sink
from sinstool.pipelines.process.travel import find_outages
from sinstool.survey.increments import SegmentIncrements
from sinstool.survey.source import Source, lead_in_end

DIAGNOSTIC_NAMES = (
    "nis / rows",
    *(
        f"{kind} {what} {axis} {unit}"
        for kind in ("innovation", "expected")
        for what, unit in (("position", "m"), ("velocity", "m/s"))
        for axis in ("north", "east", "down")
    ),
)
# Length of the part of a log that is examined for faults: they show within minutes.
DIAGNOSED_NS = 300 * SECOND
DETAIL_ROWS = 512


def _pieces(
    steps: Iterator[tuple[Increments, Imu, Imu | None]], rows: int | None
) -> Iterator[tuple[Increments, Imu]]:
    """Increments with their samples, in pieces of at most so many rows."""
    for increments, imu, _ in steps:
        count = len(increments.sample) if rows is None else rows
        for first in range(0, len(increments.sample), count):
            part = slice(first, first + count)
            yield take_rows(increments, part), imu.rows(part)


class FilterRun(Mode):
    """INS/GNSS integration by the filter whose start the plan holds."""

    diagnostic_names = DIAGNOSTIC_NAMES

    def __init__(self, source: Source, config: ProcessConfig, plan: Plan) -> None:
        algorithm = plan.algorithm
        source, first, false = find_false_fixes(source, config, algorithm, plan.filter_start)
        source, config, first, smooth = with_unsmoothed_velocity(source, config, algorithm, first)
        first = before_short_gaps(source, config, algorithm, first)
        config, first, start, means = with_sample_kind(source, config, plan, first)
        config, self._planned, antenna = start_by_antenna(source, config, algorithm, first, start)
        self._shown = [*false, *smooth, *means, *antenna]
        super().__init__(source, config, plan)
        self._start = start = start_before_gaps(source, config, algorithm, self._planned)
        self.emits = ("imu", "attitude", "odometry", "fix", "tf", "diagnostics")
        self._lag = HeightLag(start.reference, config.vertical.baro_lag)
        self._damping: Damping | None = None
        if start.reference is not None:
            self.emits = (*self.emits, "height")
            self._damping = Damping(start.reference, start.settings.damping, start.grade)
        latitude, longitude, height = start.start.nav[:3].tolist()
        self.frames = Frames(
            config.output.world,
            "map",
            source.body_frame,
            config.input.body_axes,
            (latitude, longitude, height),
        )
        self._detailed, self._updates = False, 0
        self._earliest: Solution | None = None
        self._gnss: list[GnssDiagnostics] = []
        self._unwritten: list[GnssDiagnostics] = []
        self._biases: list[tuple[int, np.ndarray, np.ndarray]] = []
        self._first: list[UpdateColumns] = []
        self._offset_ns = 0
        self._smooth = config.filter.smooth
        self._hidden = bool(start.withheld.any())
        self._sample_kind_known = plan.gyro_samples.configured or bool(means)
        self._mount: np.ndarray | None = None
        self._best: FirstPass | None = None
        self._stretches: list[Stretch] = []

    def find_out(self, progress: BytesRead | None) -> None:
        """Determine the latency from the whole log, and the motion constraints of the vehicle."""
        # GNSS, barometer and wheels have been read
        self.source.log.cache(())
        best = self._planned
        if best.time_ns != self._start.time_ns:
            # Beyond a gap the vehicle may show more of itself
            longest = longest_carried(best.settings)
            self._best = first_pass(self.source, self.config, self.plan.algorithm, best, longest)
        first = self._stretch(self.source, self._start)
        if first.start.clock.rate != 0.0 and self._begin_with_clock(first.start.clock):
            first = self._stretch(self.source, self._start)
        self._stretches, self._start = [first], first.start
        self._measure_by(first.start)
        self._mount = first.vehicle.mount
        if self._mount is None and self._best is not None:
            self._mount = self._best.vehicle.mount
        if self._mount is not None:
            self.emits = (*self.emits, "vehicle")

    def _begin_with_clock(self, clock: ClockRate) -> bool:
        """Begin anew with stamps corrected for the rate of the receiver's clock; False if no start.

        Where the latency changes, fixes seem to wander and the IMU to drift: the noise of the first
        start is too large.
        """
        aiding, algorithm = self.source.aiding, self.plan.algorithm
        assert aiding.gnss is not None
        source = replace(self.source, aiding=replace(aiding, gnss=clock.corrected(aiding.gnss)))
        try:
            begun = earliest_start(source, self.config, algorithm)
            begun = timed_start(source, self.config, algorithm, begun)
        except AlignmentError:
            return False
        self.source, self._best = source, None
        self._planned = replace(begun, clock=clock)
        self._start = start_before_gaps(source, self.config, algorithm, self._planned)
        return True

    def _measure_by(self, start: FilterStart) -> None:
        """Score withheld fixes, and widen covariances, by latency and lever arm of this start."""
        valid = replace(start.gnss, time_ns=start.gnss.time_ns - start.late_ns)
        arm = start.settings.lever_arm_b
        self._score = Withheld(valid, start.withheld, arm)
        self._filtered = Withheld(valid, start.withheld, arm) if self._smooth else self._score
        turned = None if start.offsets is None else start.offsets.turned
        half = 0.0 if self._sample_kind_known else 0.5 * self.source.survey.interval_ns / SECOND
        shared = start.latency_status != "given" and start.settings.gnss_latency != 0.0
        moment, slow_m = start.offsets_error, start.slow_m
        self._offsets_error = OffsetsError(moment, turned, half, shared, slow_m)

    def _stretch(
        self, source: Source, start: FilterStart, gap: FilterEvent | None = None
    ) -> Stretch:
        longest = longest_carried(start.settings)
        first = self._best if start.time_ns == self._planned.time_ns else None
        if first is None:
            first = first_pass(source, self.config, self.plan.algorithm, start, longest)
        start = first.started(start)
        run = self._filter_from(start, first.vehicle.constraints)
        return Stretch(source, start, run, first.vehicle, gap)

    def _filter_from(
        self, start: FilterStart, constraints: Constraints | None = None
    ) -> InsGnssFilter:
        return InsGnssFilter(
            start.start,
            start.settings,
            with_baro=start.reference is not None,
            store=self._smooth,
            constraints=constraints,
        )

    def show(self, sink: Sink) -> None:
        """Record barometer heights and fixes, and biases in full detail, for figures."""
        if self._damping is not None:
            self._damping.show(sink)
        gnss = self.source.aiding.gnss
        if gnss is not None:
            sink.refer_track(gnss.latitude, gnss.longitude)
        self._detailed = True

    def solutions(self, progress: BytesRead | None) -> Iterator[Solution]:
        """Filtered or smoothed solutions at every update instant, from the start of the log on."""
        # Processing a stretch may append the next
        for stretch in self._stretches:
            self._mounted(stretch.vehicle.mount)
            solve = self._smoothed if self._smooth else self._as_filtered
            yield from self._lag.watch(solve(stretch, progress))

    def _as_filtered(self, stretch: Stretch, progress: BytesRead | None) -> Iterator[Solution]:
        yield from self._scored(self._earlier(stretch, stretch.start.start))
        for block, imu in self._run(stretch, progress):
            assert block.updates is not None
            yield from self._scored(self._as_solution(block.updates, imu.log_time_ns))
            del block

    def _smoothed(self, stretch: Stretch, progress: BytesRead | None) -> Iterator[Solution]:
        log_times: list[np.ndarray] = []
        with Smoother(stretch.filter.kind) as smoother:
            for block, imu in self._run(stretch, progress):
                assert block.updates is not None
                if self._hidden:
                    self._filtered.push(self._as_solution(block.updates, imu.log_time_ns))
                smoother.push(block)
                log_times.append(imu.log_time_ns)
                del block
            if not log_times:
                return
            vehicle = stretch.filter.summary.land_vehicle
            self._mounted(None if vehicle is None else vehicle.c_vb)
            log_time = np.concatenate(log_times)
            smoothed = smoother.epochs()
            for gnss in self._gnss if self._hidden else ():
                self._score.smoothed(gnss, smoothed)
            first = smoothed_start(stretch.start.start, smoothed)
            yield from self._scored(self._earlier(stretch, first))
            doubtful = doubts(concatenate(self._gnss), stretch.filter.events) if self._gnss else []
            begin = 0
            for updates in smoother.blocks(smoothed):
                end = begin + len(updates)
                updates = marked(updates, doubtful) if doubtful else updates
                yield from self._scored(self._as_solution(updates, log_time[begin:end]))
                begin = end

    def _mounted(self, c_vb: np.ndarray | None) -> None:
        """Use this mount for the attitude of the vehicle, if there is one; else the one before."""
        if self._mount is not None and c_vb is not None:
            self._mount = c_vb

    def _scored(self, solution: Solution | None) -> Iterator[Solution]:
        if solution is not None:
            if self._hidden:  # their stamps are corrected by the same latency
                self._score.push(solution)
            if self._mount is not None:
                q_vb = np.broadcast_to(from_dcm(self._mount), solution.q_nb.shape)
                solution = replace(solution, q_vb=q_vb)
            yield self._offsets_error.added(solution)

    def _earlier(self, stretch: Stretch, start: Start) -> Solution | None:
        """Solutions before the start of a stretch."""
        rests = stretch.vehicle.rests_at_first and (
            lead_in_end(stretch.source.survey) >= stretch.start.time_ns
        )
        earlier = before_start(
            stretch.source, self.config, self.plan.algorithm, stretch.start, start, rests
        )
        if stretch.gap is None:
            self._earliest = None if earlier is None else earlier.rows(slice(0, 1))
        return earlier

    def _run(
        self, stretch: Stretch, progress: BytesRead | None
    ) -> Iterator[tuple[FilterBlock, Imu]]:
        p, run = stretch.start, stretch.filter
        steps = SegmentIncrements(self.source, self.config, self.plan.algorithm)
        pieces = _pieces(
            steps.from_time(p.time_ns, progress=progress), DETAIL_ROWS if self._detailed else None
        )
        columns, last_ns = measurements(p), p.time_ns
        for increments, imu in pieces:
            if self._begins_anew(stretch, last_ns, increments):
                return
            last_ns = int(increments.time_ns[-1])
            block = run.push(increments, **columns)
            columns = {}
            self._updates += len(increments.sample)
            updates = block.updates
            assert updates is not None
            # The first minutes, from which the cause of a fault is found
            if not self._first or updates.time_ns[0] <= self._first[0].time_ns[0] + DIAGNOSED_NS:
                self._first.append(updates)
            now = run.summary
            self._biases.append((int(imu.time_ns[-1]), now.gyro_bias, now.accel_bias))
            self._offset_ns = (imu.log_time_ns[-1:] - imu.time_ns[-1:])[0]
            if len(block.gnss):
                if p.settings.feedback == "closed":  # else too far off for linear innovations
                    self._filtered.filtered(block.gnss)
                self._gnss.append(block.gnss)
                self._unwritten.append(block.gnss)
            yield block, imu
            # Reused by the next block: new memory is cleared first
            del block, updates

    def _begins_anew(self, stretch: Stretch, last_ns: int, increments: Increments) -> bool:
        """Whether these increments follow a gap with a new start, which begins the next stretch."""
        begin_ns = int(increments.time_ns[0]) - round(float(increments.interval[0]) * SECOND)
        gap = (begin_ns - last_ns) / SECOND
        if gap < longest_carried(stretch.start.settings):
            return False
        result = start_after_gap(self.source, self.config, stretch, begin_ns, gap, self._planned)
        if result is None:
            return False
        source, start = result
        event = FilterEvent("imu-gap-new-start", last_ns, gap)
        self._stretches.append(self._stretch(source, start, event))
        return True

    def _diagnosis(self) -> list[Finding]:
        """Suspected faults of settings or sensors, the likeliest first."""
        if not self._gnss:
            return []
        p, gnss = self._start, concatenate(self._gnss)
        # After a gap of the IMU the filter begins anew, whatever the fixes
        events = Counter(event.kind for event in events_of(self._stretches))
        restarts = events["restart"] + events["covariance-lost"]
        updates = concatenate(self._first) if not restarts else self._plain_first()
        fixes = p.used_until(int(updates.time_ns[-1]))
        findings = diagnose(p.start, updates, gnss, fixes, p.settings, restarts, p.offsets)
        return settings_used.about_options(findings, p, self.config)

    def _plain_first(self) -> UpdateColumns:
        """Updates of the first minutes, by a filter whose restarts do not enlarge its sigmas."""
        p = self._start
        control = replace(p.settings.control, escalate=False)
        plain = replace(p, settings=replace(p.settings, control=control))
        run, columns = self._filter_from(plain), measurements(plain)
        steps = SegmentIncrements(self.source, self.config, self.plan.algorithm)
        made = []
        for increments, _, _ in steps.from_time(p.time_ns, p.time_ns + DIAGNOSED_NS):
            made.append(run.push(increments, **columns).updates)
            columns = {}
        return concatenate([updates for updates in made if updates is not None])

    def _as_solution(self, updates: UpdateColumns, log_time_ns: IntArray) -> Solution:
        return updates.as_solution(log_time_ns, height_damped=self._start.reference is not None)

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

    def conclude(self, last: Solution, sink: Sink | None) -> ModeResult:
        """The start, the filter, the height, and what is likely to be wrong."""
        if sink is not None and self._gnss:
            times, gyro, accel = (np.array(column) for column in zip(*self._biases, strict=True))
            first_ns, gnss = self.source.survey.first_ns, concatenate(self._gnss)
            course = FilterCourse(first_ns, gnss, times, gyro, accel, events_of(self._stretches))
            sink.refer_filter(course)
        summary, height = summed(self._stretches), None
        if self._damping is not None and last.vertical is not None and summary.gains is not None:
            events = channel_events_of(self._stretches)
            height = self._damping.result(
                summary.channel, events, self._start.time_ns, last.vertical[-1]
            )
        texts = (*self._start.warnings, *self._start.attitude_warnings)
        return ModeResult(
            alignment=self._start.first_attitude,
            coning=ConingUsed.of(self.plan.algorithm, self.config.input.sample_kind, self._updates),
            height=height,
            filter=self._summary(),
            findings=(*warned("filter-start", texts), *self._warnings()),
        )

    def _summary(self) -> FilterUsed:
        """The filter: what it was, what it used, and what it estimated last."""
        p, s = self._start, summed(self._stretches)
        return FilterUsed(
            **fields_in(s, FilterUsed),
            requested=self.config.filter.filter,
            states=self._stretches[0].filter.kind.size,
            smoothed=self._smooth,
            feedback=p.settings.feedback,
            start=FilterStartTime(p.time_ns, p.how),
            imu_grade=p.grade,
            gnss_noise=p.gnss_why,
            gnss_latency_s=p.settings.gnss_latency,
            gnss_latency=settings_used.latency_used(p),
            lever_arm_m=tuple(p.settings.lever_arm_b),
            gyro_bias_rad_s=tuple(s.gyro_bias.tolist()),
            accel_bias_m_s2=tuple(s.accel_bias.tolist()),
            baro_bias_m=s.baro_bias,
            vehicle=vehicle_of(self._stretches)[1],
            events=dict(Counter(event.kind for event in events_of(self._stretches))),
            outages=find_outages(self._gnss),
            withheld=self._scores(),
        )

    def _scores(self) -> WithheldScores | None:
        """Differences of the solutions from the fixes that were withheld from the filter."""
        score = self._score.score()
        if score is None:
            return None
        filtered = self._filtered.score() if self._smooth else None
        return WithheldScores(**vars(score), filter=filtered)

    def _warnings(self) -> list[Finding]:
        """Warnings about the run, with the likeliest causes of trouble."""
        p, s = self._start, summed(self._stretches)
        first_ns = self.source.survey.first_ns
        findings = gap_findings(self.source.survey, p.settings)

        def note(kind: str, text: str, severity: Severity = Severity.WARNING) -> None:
            findings.append(Finding(kind, text, severity))

        for caveat in self.plan.algorithm.caveats(self.config.input.sample_kind):
            note("coning", caveat)
        findings += self._shown
        findings += settings_used.notes(p, s, self.config, self._offsets_error)
        if p.time_ns > first_ns:
            findings.append(before_start_finding(self.source.survey, p, self._earliest))
        vehicle, used = vehicle_of(self._stretches)
        findings += vehicle.findings(used)
        findings += [*self._diagnosis(), *contradictions(p, self.source.findings)]
        if self._gnss:
            findings += untrusted(
                concatenate(self._gnss), events_of(self._stretches), s.mean_nis, first_ns
            )
        if s.epochs_gated and not any(one.kind == TOO_MANY_REJECTED for one in findings):
            epochs = s.epochs_used + s.epochs_gated
            note("rejected-fixes", f"{s.epochs_gated} of {epochs} GNSS epochs rejected")
        if p.reference is not None and s.gains is not None:
            before = (p.time_ns - first_ns) / SECOND
            texts = height_warnings(s.channel, channel_events_of(self._stretches), before)
            findings += warned("height", [*texts, *self._lag.warnings()])
        return findings
