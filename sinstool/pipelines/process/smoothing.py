"""The attitude smoother on a log: two passes, and the findings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.finding import Finding
from sinstool.core.memory import return_freed_memory
from sinstool.core.order_statistics import median
from sinstool.core.streams import Diagnostics, Imu, Solution
from sinstool.core.threads import executor
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.attitude_smoother.correction import Correction
from sinstool.methods.attitude_smoother.epochs import (
    SATURATED,
    Epochs,
    EpochStage,
    steady_turning,
)
from sinstool.methods.attitude_smoother.missed_turn import widened
from sinstool.methods.attitude_smoother.model import (
    LARGE_BIAS,
)
from sinstool.methods.attitude_smoother.motion import Motion
from sinstool.methods.attitude_smoother.rest import with_rest
from sinstool.methods.attitude_smoother.smoother import smooth
from sinstool.methods.strapdown.attitude import AttitudeRun, AttitudeSettings
from sinstool.pipelines.plan import Plan
from sinstool.pipelines.process.compass import MagneticHeading
from sinstool.pipelines.process.epoch_judge import EpochJudge
from sinstool.pipelines.process.smoothing_findings import (
    denied_motion_finding,
    diverged_finding,
    even_turn_finding,
    gyro_at_stop_finding,
    long_turns_finding,
    missed_finding,
    no_rest_finding,
    steady_rate_finding,
    uncertain_tilt_finding,
    unsure_motion_finding,
)
from sinstool.pipelines.process.summary import AttitudeSmoothing
from sinstool.survey.oddities import found_gaps
from sinstool.survey.rest import moving_at
from sinstool.survey.source import Source, nominal_interval

# Gaps up to this long are integrated across, as gravity corrects the tilt afterwards.
SHORT_GAP_NS, SHORT_GAP_INTERVALS = 60_000_000, 8
# A gyro whose largest rate is below this, rad/s, is not saturated.
LEAST_STOP = 1.0
# A still span of the survey is a rest if it is this long, s: a hand turns slowly for two seconds.
LONG_REST_S = 5.0
# Limits of findings: sigma of tilt, rad; share of the time at the stops.
UNCERTAIN_TILT = 2.0 * DEGREE
STOPPED_SHARE = 0.002
# Share of the time in steady turns beyond which the finding `long-turns` is given.
LONG_TURNS = 0.1
# A rate that is steady for this share of the time, and larger than this, rad/s, may be a turn.
STEADY, STEADY_RATE = 0.9, 1.0 * DEGREE
# Diagnostics are written once in this many epochs.
DIAGNOSED = 5
DIAGNOSTICS = (
    "tilt sigma (deg)",
    "heading sigma (deg)",
    "gyro bias forward (rad/s)",
    "gyro bias right (rad/s)",
    "gyro bias down (rad/s)",
    "gyro bias sigma (rad/s)",
    "at rest",
)


class Smoothing:
    """Attitude that is integrated, smoothed over the whole log, and corrected on output.

    Parameters
    ----------
    settings : dict
        Of the integration: see :func:`~sinstool.pipelines.process.mode.sample_settings`.

    Attributes
    ----------
    run : AttitudeRun
        The integration that is, or was, corrected.
    north_referenced : bool or None
        Whether a magnetometer showed true north; None where none was used.
    """

    def __init__(
        self,
        source: Source,
        config: ProcessConfig,
        plan: Plan,
        settings: dict[str, Any],
        omega_ie_n: np.ndarray | None,
    ) -> None:
        self._source, self._config, self._plan = source, config, plan
        if config.input.max_gap is None:
            longer = max(SHORT_GAP_INTERVALS * nominal_interval(source, config), SHORT_GAP_NS)
            settings["max_gap_ns"] = max(settings["max_gap_ns"], int(longer))
        # The smoother finds rests itself, and could not undo an attitude that is held here.
        settings["still_until_ns"] = None
        self._settings = AttitudeSettings(**settings, omega_ie_n=omega_ie_n)
        self.run = self._new_run()
        self.north_referenced: bool | None = None
        self._magnetic: MagneticHeading | None = None
        if plan.magnetic is not None:
            gap_ns = settings["max_gap_ns"]
            self._magnetic = MagneticHeading(source, config, plan.magnetic, gap_ns)
        self._held: list[Solution] | None = None
        stops = self._stops()
        self._judge = EpochJudge(
            source,
            config,
            plan.alignment,
            earth_removed=omega_ie_n is not None,
            stop_rate=float(stops.max(where=np.isfinite(stops), initial=0.0)),
        )
        self._unwritten: list[Diagnostics] = []

    def _new_run(self) -> AttitudeRun:
        return AttitudeRun(self._plan.alignment.q_nb, self._settings)

    def find_out(self, blocks: Iterable[Imu]) -> None:
        """Integrate the attitude and compute its correction."""
        settings = self._settings
        stage = EpochStage(
            settings.max_gap_ns,
            self._stops(),
            settings.sample_rate,
            point_samples=settings.gyro_kind == "rate",
            omega_in_n=settings.omega_ie_n,
        )
        # Where samples are kept in memory they are few enough to keep their attitudes, too.
        self._held = None if self._source.samples.blocks is None else []
        with executor(1, "sinstool-epochs") as pool:
            pushed = None
            for solution in self.run.run(blocks):
                if pushed is not None:
                    pushed.result()
                pushed = pool.submit(stage.push, solution)
                if self._magnetic is not None:
                    self._magnetic.push(solution)
                if self._held is not None:
                    self._held.append(solution)
            if pushed is not None:
                pushed.result()
        spans = (
            (span.start_ns, span.end_ns)
            for span in self._source.survey.spans
            if span.duration_s >= LONG_REST_S and not span.lull
        )
        epochs = with_rest(stage.finish(), self._gnss_moves, spans)
        return_freed_memory()
        epochs, motion, sensors, prior = self._judge.judge(epochs)
        return_freed_memory()
        correction = smooth(epochs, motion.model, sensors, prior)
        north = None
        return_freed_memory()
        if self._magnetic is not None:
            north = self._magnetic.north(epochs, correction.at(epochs.time_ns))
            if north is not None:
                correction = smooth(epochs, motion.model, sensors, prior, north)
                self._magnetic.compare(epochs, correction)
            self.north_referenced = self._magnetic.north_referenced
        if not self._plan.gyro_samples.configured:
            correction = correction.of_samples(epochs)
        correction = widened(correction, self._judge.missed, compassed=north is not None)
        self._correction = correction
        self._conclude(epochs, motion, correction)
        self._turning = steady_turning(epochs) if sensors.bias > LARGE_BIAS else 0.0
        self._unwritten.append(self._diagnostics(epochs, correction))
        return_freed_memory()

    def solutions(self, blocks: Iterable[Imu]) -> Iterator[Solution]:
        """Smoothed attitude at every update instant."""
        if self._held is not None:
            self._held.reverse()
            while self._held:
                yield self._correction.apply(self._held.pop())
            return
        self.run = self._new_run()
        for solution in self.run.run(blocks):
            yield self._correction.apply(solution)

    def new_diagnostics(self) -> list[Diagnostics]:
        """Diagnostics since the last call, for writing."""
        out, self._unwritten = self._unwritten, []
        return out

    def _stops(self) -> np.ndarray:
        """Rates from which on gyros are, or may be, at their stops, rad/s, shape (2, 3)."""
        survey, bias = self._source.survey, self._plan.alignment.gyro_bias
        ends = survey.range_ends[:3]
        stops = np.where(np.isfinite(ends), ends, survey.gyro_stops)
        return np.where(stops > LEAST_STOP, stops, np.inf) - np.array([bias, -bias])

    def _gnss_moves(self, start_ns: int, end_ns: int) -> bool:
        return moving_at(self._source.aiding.gnss, start_ns, end_ns) is not None

    def _conclude(self, epochs: Epochs, motion: Motion, correction: Correction) -> None:
        seconds = np.diff(epochs.time_ns) / SECOND
        tilt, heading = _sigmas(correction)
        self._moved = float(seconds[~epochs.gap].sum())
        stopped = epochs.values[:, SATURATED]
        bias, accel_bias = (
            self._plan.alignment.gyro_bias + correction.gyro_bias,
            correction.accel_bias,
        )
        self.summary = AttitudeSmoothing(
            motion=motion.model.name,
            motion_margin_nat=motion.margin,
            acceleration_density_m_s2_sqrt_hz=motion.model.density,
            rest_s=float(seconds[epochs.at_rest].sum()),
            gyro_at_stop_s=float(stopped.sum()),
            tilt_sigma_deg=float(median(tilt)) / DEGREE,
            tilt_sigma_largest_deg=float(tilt.max()) / DEGREE,
            heading_sigma_end_deg=float(heading[-1]) / DEGREE,
            accel_bias_m_s2=None if accel_bias is None else tuple(accel_bias.tolist()),
            accel_bias_sigma_m_s2=correction.accel_bias_sigma,
            gyro_bias_rad_s=tuple(bias[-1].tolist()),
            gyro_bias_sigma_rad_s=tuple(correction.gyro_bias_sigma[-1].tolist()),
            magnetometer=None if self._magnetic is None else self._magnetic.summary(correction),
        )
        worst = int(np.argmax(tilt))
        self._worst_ns = int(correction.time_ns[worst])
        self._unsure, self._denied = not motion.sure, motion.denied
        self._rested = bool(epochs.rest.any())
        self._diverged = correction.diverged

    def findings(self) -> Iterator[Finding]:
        """Findings about the smoothed attitude."""
        s, survey = self.summary, self._source.survey
        first_ns, across_ns = survey.first_ns, self._settings.max_gap_ns
        if survey.gap_count and across_ns > survey.max_gap_ns:
            yield replace(found_gaps(survey, across_ns), topic=survey.topic)
        if self._magnetic is not None:
            yield from self._magnetic.findings()
        compassed = s.magnetometer is not None and not s.magnetometer.refused
        if self._diverged:
            yield diverged_finding()
        elif self._judge.missed:
            yield missed_finding(self._judge.missed, first_ns, compassed)
        elif s.tilt_sigma_largest_deg * DEGREE > UNCERTAIN_TILT:
            yield uncertain_tilt_finding(s, self._worst_ns, first_ns)
        if not self._rested and not compassed:
            drift = (
                "any angle" if s.heading_lost else f"{s.heading_sigma_end_deg:.2g} deg (1 sigma)"
            )
            quiet_s = max((span.duration_s for span in survey.spans), default=0.0)
            yield no_rest_finding(quiet_s, drift, s.heading_sigma_end_deg)
        if not self._rested and s.motion == "vehicle" and self._turning > LONG_TURNS:
            yield long_turns_finding(self._turning)
        steady = self._source.survey.lead_in
        rate = 0.0 if steady is None else float(np.linalg.norm(steady.gyro))
        if steady is not None and rate > STEADY_RATE and steady.duration_s > STEADY * self._moved:
            yield steady_rate_finding(rate)
        elif self._judge.even_turn.sigma and not compassed:
            yield even_turn_finding(self._judge.even_turn, first_ns, s.heading_sigma_end_deg)
        share = s.gyro_at_stop_s / max(self._moved, 1e-9)
        if share > STOPPED_SHARE:
            yield gyro_at_stop_finding(s.gyro_at_stop_s, share)
        if self._unsure:
            yield unsure_motion_finding(s.motion, s.motion_margin_nat or 0.0)
        if self._denied:
            yield denied_motion_finding(s.motion_margin_nat or 0.0)

    def _diagnostics(self, epochs: Epochs, correction: Correction) -> Diagnostics:
        every = slice(None, None, DIAGNOSED)
        # contiguous, as all other times that are written: the loop is compiled once
        time_ns = epochs.time_ns[every].copy()
        one = correction.at(time_ns)
        tilt, heading = _sigmas(one)
        values = np.column_stack(
            [
                tilt / DEGREE,
                heading / DEGREE,
                self._plan.alignment.gyro_bias + one.gyro_bias,
                one.gyro_bias_sigma.max(axis=1),
                np.append(epochs.at_rest, epochs.at_rest[-1:])[every],
            ]
        )
        level = np.append((epochs.values[:, SATURATED] > 0.0) | epochs.gap, False).astype(int)
        return Diagnostics(time_ns, time_ns, level[every], values)


def _sigmas(correction: Correction) -> tuple[np.ndarray, np.ndarray]:
    """Sigmas of tilt (the larger axis) and of heading at the limits of epochs, rad."""
    variance = np.einsum("nii->ni", correction.covariance_n)
    sigma = np.sqrt(variance)
    return np.max(sigma[:, :2], axis=1), sigma[:, 2]
