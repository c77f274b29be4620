"""What the epochs of a log are: rests or motion, of which kind, measured by what sensors.

Each of these depends on the others. What looks like a rest is judged by the sensors and the motion;
then it may show that the sensors are worse than their grade, or that what they were judged by was a
turn, and all is judged again.
"""

from __future__ import annotations

from dataclasses import replace
from math import hypot

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.earth import normal_gravity
from sinstool.core.order_statistics import quantile
from sinstool.methods.alignment.initial import Alignment, shown_tilt_error
from sinstool.methods.alignment.still import StillSpan
from sinstool.methods.attitude_smoother.bias_wander import wandering
from sinstool.methods.attitude_smoother.epochs import (
    MOVING,
    REST,
    SATURATED,
    TURN_DOUBT,
    Epochs,
)
from sinstool.methods.attitude_smoother.even_turn import NO_TURN, doubt_turns
from sinstool.methods.attitude_smoother.missed_turn import MissedTurn, missed_turns
from sinstool.methods.attitude_smoother.model import (
    LARGE_BIAS,
    POOR_ACCEL_BIAS,
    SensorModel,
    accel_uncalibrated,
    as_calibrated,
    sensor_model,
)
from sinstool.methods.attitude_smoother.motion import Motion, find_motion, likeliest_stop_rate
from sinstool.methods.attitude_smoother.quiet_doubt import WINDOW
from sinstool.methods.attitude_smoother.rest import MARKS, confirmed, drop_turns
from sinstool.methods.attitude_smoother.smoother import gravity_at_rest, gravity_off
from sinstool.methods.attitude_smoother.start import Prior
from sinstool.methods.attitude_smoother.steady import turning, with_steady
from sinstool.methods.attitude_smoother.two_rates import two_rates
from sinstool.methods.sensor_errors import LOW_COST
from sinstool.survey.grade import bias_grade, gyro_walk, largest_bias, sensor_grade
from sinstool.survey.rest import longest_rest
from sinstool.survey.source import Source

# Factor on the sigmas of an alignment in motion: its unmodelled errors last for the whole log.
CAUTION = 2.0
# The mean rate of a still span is the gyro bias if this share of it is judged to be a rest.
LEAST_REST = 0.5
# So many epochs beside a turn that looked quiet are part of it, as they hardly differ from it.
BESIDE_TURN = 2 * WINDOW


class EpochJudge:
    """Judges the epochs of a log.

    Parameters
    ----------
    alignment : Alignment
        The first attitude, with the gyro bias that the integration takes off.
    earth_removed : bool
        Whether the integration takes the Earth's rate off.
    stop_rate : float
        Rate at which a gyro is, or may be, at its stop, rad/s; 0 if none is.

    Attributes
    ----------
    even_turn : EvenTurn
        An even turn that what was taken for a rest, or for straight travel, may be.
    missed : list of MissedTurn
        Turns that the gyros missed.
    """

    def __init__(
        self,
        source: Source,
        config: ProcessConfig,
        alignment: Alignment,
        earth_removed: bool,
        stop_rate: float,
    ) -> None:
        self._source, self._config, self._alignment = source, config, alignment
        # without a heading the level part of the Earth's rate is removed in a wrong direction
        self._earth_removed = earth_removed and alignment.north_referenced
        self._stop_rate = stop_rate
        self._grade = sensor_grade(source, config).grade
        self.even_turn = NO_TURN
        self.missed: list[MissedTurn] = []

    def judge(self, seen: Epochs) -> tuple[Epochs, Motion, SensorModel, Prior]:
        """The epochs with rest marked, the kind of motion, and what is known of the sensors.

        Parameters
        ----------
        seen : Epochs
            With those marked that look like rest. Its marks are overwritten.
        """
        alignment = self._alignment
        drop_turns(seen, alignment.gyro_bias, largest_bias(self._source, self._config))
        if alignment.bias_source in ("still", "rest"):
            self.even_turn = doubt_turns(
                seen, alignment.gyro_bias, bias_grade(self._source, self._config), self._gnss_covers
            )
        sensors, prior = self._first_sensors(), self._prior()
        # What looks like rest, before it is judged: there are too many epochs to keep them twice
        looks = seen.values[:, MARKS].copy()
        epochs, motion = self._judged(seen, looks, sensors, prior)
        self.missed = missed_turns(epochs, looks[:, MARKS.index(REST)] > MOVING)
        if self.missed:
            sensors = replace(sensors, missed=max(one.rate_error for one in self.missed))
            epochs, motion = self._judged(seen, looks, sensors, prior)
        if seen.values[:, SATURATED].any():
            surely = any(name.startswith("gyro") for name in self._source.survey.saturated)
            rate = likeliest_stop_rate(epochs, sensors, self._stop_rate, surely)
            if not rate:
                seen.values[:, SATURATED] = 0.0
            sensors = replace(sensors, stop_rate=rate)
            epochs, motion = self._judged(seen, looks, sensors, prior)
        inside = self._bias_epochs(epochs)
        if inside.any() and np.mean(epochs.at_rest[inside]) < LEAST_REST:
            # A turn whose mean rate was taken for the bias shows neither a bias nor, at first, a
            # tilt
            sensors = replace(
                self._sensors(bias_known=False),
                bias_mean=tuple((-alignment.gyro_bias).tolist()),
                missed=sensors.missed,
                stop_rate=sensors.stop_rate,
            )
            if alignment.bias_source == "still":
                prior = replace(prior, tilt=None)
            if np.mean(epochs.rest[inside]) < LEAST_REST:
                looks[inside, MARKS.index(REST)] = MOVING
            epochs, motion = self._judged(seen, looks, sensors, prior)
        turns = turning(epochs, motion.model, sensors, prior)
        if turns.any():
            near = np.convolve(turns, np.ones(2 * BESIDE_TURN + 1), "same") > 0.0
            looks[near, MARKS.index(REST)] = MOVING
            epochs, motion = self._judged(seen, looks, sensors, prior)
        if motion.model.name == "vehicle":
            sensors, epochs, motion = self._bends(seen, looks, epochs, motion, sensors, prior)
        wider = wandering(epochs, motion.model, sensors)
        if wider is not sensors:
            sensors = wider
            epochs, motion = self._judged(seen, looks, sensors, prior)
        return epochs, motion, sensors, prior

    def _bends(
        self,
        seen: Epochs,
        looks: np.ndarray,
        epochs: Epochs,
        motion: Motion,
        sensors: SensorModel,
        prior: Prior,
    ) -> tuple[SensorModel, Epochs, Motion]:
        """What was judged, once more if its quiet times show two rates: one of them is a bend's."""
        looked = looks[:, MARKS.index(REST)] > MOVING
        grade = bias_grade(self._source, self._config)
        bends = two_rates(epochs, looked, sensors, self._alignment.gyro_bias, grade)
        if bends is None:
            return sensors, epochs, motion
        looks[bends.turning, MARKS.index(REST)] = MOVING
        looks[bends.quiet, MARKS.index(TURN_DOUBT)] = bends.variance * bends.quiet.sum()
        self.even_turn = max(self.even_turn, bends.turn, key=lambda one: one.sigma)
        sensors = replace(sensors, bias=hypot(sensors.bias, bends.turn.sigma))
        return sensors, *self._judged(seen, looks, sensors, prior)

    def _sensors(self, bias_known: bool) -> SensorModel:
        """Errors of the sensors by their grade, and by the bias that was taken off."""
        sensors = sensor_model(
            self._grade,
            walk_at_rest=gyro_walk(self._source, self._config),
            bias_known=bias_known,
            earth_removed=self._earth_removed,
        )
        removed = tuple(self._alignment.gyro_bias.tolist()) if self._grade in LOW_COST else None
        return replace(sensors, bias_removed=removed, stop_rate=self._stop_rate)

    def _first_sensors(self) -> SensorModel:
        """Errors of the sensors as far as the first attitude and its gyro bias show them."""
        alignment = self._alignment
        sensors = self._sensors(bias_known=alignment.bias_source != "none")
        if sensors.bias_removed is not None:
            sensors = as_calibrated(sensors, alignment.gyro_bias)
        if alignment.gyro_bias_sigma is not None:
            bias = CAUTION * alignment.gyro_bias_sigma
            sensors = replace(sensors, bias=min(sensors.bias, bias))
        # a turn whose rate was taken off leaves as large a bias
        bias = hypot(sensors.bias, self.even_turn.sigma)
        return replace(sensors, bias=min(bias, max(sensors.bias, LARGE_BIAS)))

    def _prior(self) -> Prior:
        """What the first attitude and the place show before any sample is smoothed."""
        alignment, source = self._alignment, self._source
        heading = alignment.sigma_rad[2] if alignment.north_referenced else None
        latitude, height = source.latitude, source.position[2]
        return Prior(
            heading or 0.0,
            _first_tilt(alignment, source.survey.lead_in),
            None if latitude is None else float(normal_gravity(latitude, height or 0.0)),
        )

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
        alignment = self._alignment
        if sensors.bias_removed is None or not seen.rest.any():
            return sensors
        known = alignment.gyro_bias if alignment.bias_source != "none" else None
        off = gravity_off(gravity_at_rest(seen), prior.gravity)
        poor = accel_uncalibrated(known, off) > 0.5
        return replace(sensors, accel_bias=POOR_ACCEL_BIAS) if poor else sensors

    def _bias_epochs(self, epochs: Epochs) -> np.ndarray:
        """Which epochs lie in the rest whose mean rate was taken for the bias, shape (n,)."""
        source, of = self._source, self._alignment.bias_source
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

    def _gnss_speed(self) -> float | None:
        """Speed that GNSS velocities reach, m/s, without the fastest of them."""
        gnss = self._source.aiding.gnss
        if gnss is None or not gnss.has_velocity.any():
            return None
        speeds = np.linalg.norm(gnss.velocity_n[gnss.has_velocity, :2], axis=1)
        return float(quantile(speeds, 0.95))


def _first_tilt(alignment: Alignment, still: StillSpan | None) -> float | None:
    """Sigma of a first tilt without that by accelerometer biases, rad; None: unknown."""
    if alignment.method == "level" and still is not None:
        return CAUTION * shown_tilt_error(still)
    roll, pitch, _ = alignment.sigma_rad
    if roll is None or pitch is None:
        return None
    return CAUTION * float(max(roll, pitch))
