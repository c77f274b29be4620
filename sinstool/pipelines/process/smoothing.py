"""The attitude smoother on a log: two passes, and the findings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from math import hypot
from typing import Any

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.earth import normal_gravity
from sinstool.core.english import in_seconds
from sinstool.core.finding import Finding, Severity
from sinstool.core.memory import return_freed_memory
from sinstool.core.order_statistics import median, quantile
from sinstool.core.streams import Diagnostics, Imu, Solution
from sinstool.core.threads import executor
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.alignment.initial import Alignment, shown_tilt_error
from sinstool.methods.alignment.still import StillSpan
from sinstool.methods.attitude_smoother.bias_wander import wandering
from sinstool.methods.attitude_smoother.correction import Correction
from sinstool.methods.attitude_smoother.epochs import (
    MOVING,
    REST,
    SATURATED,
    TURN_DOUBT,
    Epochs,
    EpochStage,
    steady_turning,
)
from sinstool.methods.attitude_smoother.even_turn import NO_TURN, doubt_turns
from sinstool.methods.attitude_smoother.missed_turn import missed_turns, widened
from sinstool.methods.attitude_smoother.model import (
    LARGE_BIAS,
    POOR_ACCEL_BIAS,
    SensorModel,
    accel_uncalibrated,
    as_calibrated,
    sensor_model,
)
from sinstool.methods.attitude_smoother.motion import Motion, find_motion, likeliest_stop_rate
from sinstool.methods.attitude_smoother.rest import MARKS, confirmed, drop_turns, with_rest
from sinstool.methods.attitude_smoother.smoother import gravity_at_rest, gravity_off, smooth
from sinstool.methods.attitude_smoother.start import Prior
from sinstool.methods.attitude_smoother.steady import turning, with_steady
from sinstool.methods.sensor_errors import LOW_COST
from sinstool.methods.strapdown.attitude import AttitudeRun, AttitudeSettings
from sinstool.pipelines.plan import Plan
from sinstool.pipelines.process.compass import MagneticHeading
from sinstool.pipelines.process.missed_finding import missed_finding
from sinstool.pipelines.process.smoothing_findings import (
    even_turn_finding,
    no_rest_finding,
    steady_rate_finding,
    unsure_motion_finding,
)
from sinstool.pipelines.process.summary import AttitudeSmoothing
from sinstool.survey.grade import bias_grade, gyro_walk, largest_bias, sensor_grade
from sinstool.survey.oddities import found_gaps
from sinstool.survey.rest import longest_rest, moving_at
from sinstool.survey.source import Source, nominal_interval

# Gaps up to this long are integrated across, as gravity corrects the tilt afterwards.
SHORT_GAP_NS, SHORT_GAP_INTERVALS = 60_000_000, 8
# Factor on the sigmas of an alignment in motion: its unmodelled errors last for the whole log.
CAUTION = 2.0
# A gyro whose largest rate is below this, rad/s, is not saturated. One that is, is so from this
# share of its largest rate on.
LEAST_STOP, STOP_SHARE = 1.0, 0.997
# A still span of the survey is a rest if it is this long, s: a hand turns slowly for two seconds.
LONG_REST_S = 5.0
# The mean rate of a still span is the gyro bias if this share of it is judged to be a rest.
LEAST_REST = 0.5
# Limits of findings: sigma of tilt, rad; share of the time at the stops, for a warning and for a
# result that is not to be trusted.
UNCERTAIN_TILT = 2.0 * DEGREE
STOPPED_SHARE, LOST_SHARE = 0.002, 0.03
# Share of the time in steady turns beyond which the finding `long-turns` is given.
LONG_TURNS = 0.1
# A rate that is steady for this share of the time, and larger than this, rad/s, may be a turn.
STEADY, STEADY_RATE = 0.9, 1.0 * DEGREE
# Margin of a vehicle over a hand, nat per moving epoch, beyond that of any recorded hand or drone.
DENIED_MARGIN = 2.0
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
        self._even_turn = NO_TURN
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
            if span.duration_s >= LONG_REST_S
        )
        epochs = with_rest(stage.finish(), self._gnss_moves, spans)
        return_freed_memory()
        epochs, motion, sensors, prior = self._understood(epochs)
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
        correction = widened(correction, self._missed, compassed=north is not None)
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
        saturated = [f"gyro {axis}" in survey.saturated for axis in "xyz"]
        stops = np.where(saturated, STOP_SHARE * survey.gyro_max, survey.gyro_stops)
        return np.where(stops > LEAST_STOP, stops, np.inf) - np.array([bias, -bias])

    def _gnss_speed(self) -> float | None:
        """Speed that GNSS velocities reach, m/s, without the fastest of them."""
        gnss = self._source.aiding.gnss
        if gnss is None or not gnss.has_velocity.any():
            return None
        speeds = np.linalg.norm(gnss.velocity_n[gnss.has_velocity, :2], axis=1)
        return float(quantile(speeds, 0.95))

    def _understood(self, seen: Epochs) -> tuple[Epochs, Motion, SensorModel, Prior]:
        """The epochs with rest marked, the kind of motion, and what is known of the sensors.

        Parameters
        ----------
        seen : Epochs
            With those marked that look like rest.
        """
        grade = sensor_grade(self._source, self._config).grade
        alignment, omega = self._plan.alignment, self._settings.omega_ie_n
        drop_turns(seen, alignment.gyro_bias, largest_bias(self._source, self._config))
        if alignment.bias_source in ("still", "rest"):
            self._even_turn = doubt_turns(
                seen, alignment.gyro_bias, bias_grade(self._source, self._config), self._gnss_covers
            )
        about: dict[str, Any] = {
            "walk_at_rest": gyro_walk(self._source, self._config),
            # without a heading the level part of the Earth's rate is removed in a wrong direction
            "earth_removed": omega is not None and alignment.north_referenced,
        }
        stops = self._stops()
        stop = float(stops.max(where=np.isfinite(stops), initial=0.0))
        judged: dict[str, Any] = {
            "bias_removed": tuple(alignment.gyro_bias.tolist()) if grade in LOW_COST else None,
            "stop_rate": stop,
        }
        sensors = sensor_model(grade, bias_known=alignment.bias_source != "none", **about)
        sensors = replace(sensors, **judged)
        if sensors.bias_removed is not None:
            sensors = as_calibrated(sensors, alignment.gyro_bias)
        if alignment.gyro_bias_sigma is not None:
            bias = CAUTION * alignment.gyro_bias_sigma
            sensors = replace(sensors, bias=min(sensors.bias, bias))
        # a turn whose rate was taken off leaves as large a bias
        bias = hypot(sensors.bias, self._even_turn.sigma)
        sensors = replace(sensors, bias=min(bias, max(sensors.bias, LARGE_BIAS)))
        heading = alignment.sigma_rad[2] if alignment.north_referenced else None
        latitude, height = self._source.latitude, self._source.position[2]
        prior = Prior(
            heading or 0.0,
            _first_tilt(alignment, self._source.survey.lead_in),
            None if latitude is None else float(normal_gravity(latitude, height or 0.0)),
        )
        # What looks like rest, before it is judged: there are too many epochs to keep them twice
        looks = seen.values[:, MARKS].copy()
        epochs, motion = self._judged(seen, looks, sensors, prior)
        self._missed = missed_turns(epochs, looks[:, MARKS.index(REST)] > MOVING)
        if self._missed:
            judged["missed"] = max(one.rate_error for one in self._missed)
            sensors = replace(sensors, **judged)
            epochs, motion = self._judged(seen, looks, sensors, prior)
        if seen.values[:, SATURATED].any():
            surely = any(name.startswith("gyro") for name in self._source.survey.saturated)
            judged["stop_rate"] = likeliest_stop_rate(epochs, sensors, stop, surely)
            if not judged["stop_rate"]:
                seen.values[:, SATURATED] = 0.0
            sensors = replace(sensors, **judged)
            epochs, motion = self._judged(seen, looks, sensors, prior)
        inside = self._bias_epochs(epochs)
        if inside.any() and np.mean(epochs.at_rest[inside]) < LEAST_REST:
            # A turn whose mean rate was taken for the bias shows neither a bias nor, at first, a
            # tilt
            mean = tuple((-alignment.gyro_bias).tolist())
            sensors = sensor_model(grade, bias_known=False, **about)
            sensors = replace(sensors, bias_mean=mean, **judged)
            if alignment.bias_source == "still":
                prior = replace(prior, tilt=None)
            if np.mean(epochs.rest[inside]) < LEAST_REST:
                looks[inside, MARKS.index(REST)] = MOVING
            epochs, motion = self._judged(seen, looks, sensors, prior)
        turns = turning(epochs, motion.model, sensors, prior)
        if turns.any():
            looks[turns, MARKS.index(REST)] = MOVING
            epochs, motion = self._judged(seen, looks, sensors, prior)
        wider = wandering(epochs, motion.model, sensors)
        if wider is not sensors:
            sensors = wider
            epochs, motion = self._judged(seen, looks, sensors, prior)
        return epochs, motion, sensors, prior

    def _judged(
        self, seen: Epochs, looks: np.ndarray, sensors: SensorModel, prior: Prior
    ) -> tuple[Epochs, Motion]:
        """The kind of motion, and of what looks like rest, by all that is known of the log."""
        chosen = self._config.navigation.motion
        motion_class = None if chosen == "auto" else chosen
        seen.values[:, MARKS] = looks
        still = seen.rest
        epochs = confirmed(seen, self._doubted(seen, sensors, prior), prior.tilt, in_place=True)
        motion = find_motion(epochs, sensors, motion_class, self._gnss_speed())
        epochs = with_steady(epochs, still, motion.model, sensors, prior, in_place=True)
        doubt = epochs.values[:, TURN_DOUBT]
        np.maximum(doubt, looks[:, MARKS.index(TURN_DOUBT)], out=doubt)
        return epochs, motion

    def _doubted(self, seen: Epochs, sensors: SensorModel, prior: Prior) -> SensorModel:
        """The sensors, with accelerometer biases as large as gravity in apparent rests shows."""
        alignment = self._plan.alignment
        if sensors.bias_removed is None or not seen.rest.any():
            return sensors
        known = alignment.gyro_bias if alignment.bias_source != "none" else None
        off = gravity_off(gravity_at_rest(seen), prior.gravity)
        poor = accel_uncalibrated(known, off) > 0.5
        return replace(sensors, accel_bias=POOR_ACCEL_BIAS) if poor else sensors

    def _bias_epochs(self, epochs: Epochs) -> np.ndarray:
        """Which epochs lie in the rest whose mean rate was taken for the bias, shape (n,)."""
        source, of = self._source, self._plan.alignment.bias_source
        span = source.survey.lead_in if of == "still" else None
        if of == "rest":
            span = longest_rest(source.survey.spans, source.aiding.gnss)
        if span is None:
            return np.zeros(len(epochs), np.bool_)
        begins, ends = epochs.time_ns[:-1], epochs.time_ns[1:]
        return (begins >= span.start_ns) & (ends <= span.end_ns) & ~epochs.gap

    def _gnss_covers(self, start_ns: int, end_ns: int) -> bool:
        gnss = self._source.aiding.gnss
        return gnss is not None and bool(
            np.any((gnss.time_ns >= start_ns) & (gnss.time_ns <= end_ns))
        )

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
            yield Finding(
                "diverged",
                "gravity and the gyros contradict each other in all of the log, so roll and pitch"
                " are those of the gyros alone: do not trust them",
                severity=Severity.LOST,
                answer="see what info says about units, axes and ranges",
            )
        elif self._missed:
            yield missed_finding(self._missed, first_ns, compassed)
        elif s.tilt_sigma_largest_deg * DEGREE > UNCERTAIN_TILT:
            at = max(0.0, (self._worst_ns - first_ns) / SECOND)
            usual, most = f"{s.tilt_sigma_deg:.2g} deg", f"{s.tilt_sigma_largest_deg:.2g} deg"
            known = f"roll and pitch are known to {usual}"
            text = f"{known} only (1 sigma)"
            if most != usual:
                text = f"{known} (1 sigma, median), but only to {most} at {at:.1f} s"
            yield Finding(
                "uncertain-tilt",
                text,
                start_ns=self._worst_ns,
                end_ns=self._worst_ns,
                numbers={"tilt_sigma_deg": s.tilt_sigma_largest_deg},
            )
        if not self._rested and not compassed:
            drift = (
                "any angle" if s.heading_lost else f"{s.heading_sigma_end_deg:.2g} deg (1 sigma)"
            )
            quiet_s = max((span.duration_s for span in survey.spans), default=0.0)
            yield no_rest_finding(quiet_s, drift, s.heading_sigma_end_deg)
        if not self._rested and s.motion == "vehicle" and self._turning > LONG_TURNS:
            yield Finding(
                "long-turns",
                f"{self._turning:.0%} of the log are turns of half a minute and more, and"
                " no rest shows the gyro bias: such turns look like a bias, so roll and pitch may"
                " be off by several of their sigmas",
                answer="record some seconds at rest, or give --gyro-bias X,Y,Z",
                numbers={"share": self._turning},
            )
        steady = self._source.survey.lead_in
        rate = 0.0 if steady is None else float(np.linalg.norm(steady.gyro))
        if steady is not None and rate > STEADY_RATE and steady.duration_s > STEADY * self._moved:
            yield steady_rate_finding(rate)
        elif self._even_turn.sigma and not compassed:
            yield even_turn_finding(self._even_turn, first_ns, s.heading_sigma_end_deg)
        share = s.gyro_at_stop_s / max(self._moved, 1e-9)
        if share > STOPPED_SHARE:
            lost = share > LOST_SHARE
            yield Finding(
                "gyro-at-stop",
                f"a gyro is saturated for {in_seconds(s.gyro_at_stop_s, 3)},"
                f" {100.0 * share:.2g} % of the time; the rotation beyond its"
                " range is lost" + (": do not trust the attitude" if lost else ""),
                severity=Severity.LOST if lost else Severity.WARNING,
                answer="use a gyro of a larger range",
                numbers={"gyro_at_stop_s": s.gyro_at_stop_s, "share": share},
            )
        if self._unsure:
            yield unsure_motion_finding(s.motion, s.motion_margin_nat or 0.0)
        if self._denied:
            margin = s.motion_margin_nat or 0.0
            lost = margin > DENIED_MARGIN
            yield Finding(
                "motion-denied",
                "the motion was taken for that of a hand, as --motion says, but a vehicle explains"
                f" it better, by {margin:.2g} nat per moving epoch (0.4 is decisive): "
                + (
                    "do not trust roll and pitch"
                    if lost
                    else "roll and pitch may be off by several of their sigmas"
                ),
                severity=Severity.LOST if lost else Severity.WARNING,
                answer="leave --motion out",
                numbers={"margin_nat": margin},
            )

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


def _first_tilt(alignment: Alignment, still: StillSpan | None) -> float | None:
    """Sigma of a first tilt without that by accelerometer biases, rad; None: unknown."""
    if alignment.method == "level" and still is not None:
        return CAUTION * shown_tilt_error(still)
    roll, pitch, _ = alignment.sigma_rad
    if roll is None or pitch is None:
        return None
    return CAUTION * float(max(roll, pitch))


def _sigmas(correction: Correction) -> tuple[np.ndarray, np.ndarray]:
    """Sigmas of tilt (the larger axis) and of heading at the limits of epochs, rad."""
    variance = np.einsum("nii->ni", correction.covariance_n)
    sigma = np.sqrt(variance)
    return np.max(sigma[:, :2], axis=1), sigma[:, 2]
