"""Noise of an IMU, estimated from the drift of its navigation where fixes are left out.

From one fix to the next even a poor IMU drifts by less than the errors of the fixes. In the first
seconds without fixes mostly the noise of the accelerometers shows, later that of the gyros, which
tilts the navigation: errors after several times separate the two. Accelerometer scale factors that
wander show in the vertical, where gravity always acts. All are estimated by the likelihood of these
errors (Schweppe 1965), as a composite likelihood of single errors (Varin 2011): those of one window
are correlated.

References
----------
.. [1] F. C. Schweppe, "Evaluation of likelihood functions for Gaussian signals", IEEE Trans.
   Information Theory 11(1), 1965, 61-70.
.. [2] C. Varin, N. Reid, D. Firth, "An overview of composite likelihood methods", Statistica
   Sinica 21, 2011, 5-42.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TypeVar, cast

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.chi_square import upper_point
from sinstool.core.earth import horizontal_metres
from sinstool.core.rotation import wrapped
from sinstool.core.streams import GnssEpochs, take_rows
from sinstool.core.timeline import SECOND
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.ins_gnss.filter import InsGnssFilter
from sinstool.methods.ins_gnss.results import GnssDiagnostics
from sinstool.methods.ins_gnss.settings import Settings
from sinstool.methods.land_vehicle.shaking import Shaking, find_shaking
from sinstool.methods.land_vehicle.track import MeansStage
from sinstool.methods.sensor_errors import SensorGrade
from sinstool.methods.strapdown.joined_updates import JOINED_S, joined_updates
from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.likeliest_noise import MOST_SQUARE, cost, likeliest
from sinstool.pipelines.process.ins_gnss.noise_factors import (
    NoiseFactors,
    noise_at_rest,
    white_noise_bounds,
)
from sinstool.survey.increments import first_increments
from sinstool.survey.source import Source

# The first part of a log, which is used.
SHOWN_NS = 660 * SECOND
# Fixes are left out and used in turn, for LEFT_OUT_S each, after the filter has settled, s.
LEFT_OUT_S, SETTLED_S = 20.0, 60.0
LONGEST_STEP_S = 1.5
# Times in a window at which errors are compared with their sigmas, as shares of its length.
LOOKS = (0.1, 0.35, 1.0)
LEAST_WINDOWS = 4
# A window counts if the vehicle moves by more than LEAST_WAY, m, plus so many sigmas of the fixes:
# otherwise it shows the IMU at rest.
LEAST_WAY, LEAST_WAY_SIGMAS = 10.0, 6.0
# In a window without a stop the vehicle moves in each of so many parts; so many windows are enough.
PARTS, LEAST_DRIVEN = 10, 6
# Probability with which the mean square of good sigmas is larger by chance.
CHANCE = 0.01
# The median of the sum of two squares of unit normals, over its mean.
MEDIAN_OF_MEAN = float(np.log(2.0))
# Factors within this ratio of 1 count as 1.
LEAST_CHANGE = 1.3
# The bias instability of a bare chip is at least this share of its grade's.
WARMING = 0.5
# Gyros noisier than this many times those of a grade are not of that grade.
MOST_BETTER = 8.0

T = TypeVar("T")


@dataclass(frozen=True)
class WindowErrors:
    """Errors of two runs in the windows without fixes.

    Attributes
    ----------
    error, sigma : ndarray, shape (w, looks, 3)
        North, east, down, m.
    moved : ndarray of bool, shape (w,)
        Whether the window counts, see `LEAST_WAY`.
    restarts : int
        Of the filter.
    times_ns : tuple of ndarray of int64, shape (w, looks)
        Times of the errors, for each run.
    """

    error: FloatArray
    sigma: FloatArray
    moved: BoolArray
    restarts: int
    times_ns: tuple[IntArray, ...] = ()

    @property
    def ratio(self) -> float:
        """Error over sigma at the windows' ends, RMS of north and east.

        1 if it exceeds 1 by chance only, or if there are too few windows. After a restart, which
        bad fixes may have caused, it follows from the median, which they hardly change.
        """
        ends = (self.error / self.sigma)[:, -1, :2]
        square = np.minimum(np.sum(ends**2, axis=1), MOST_SQUARE)
        if len(square) < LEAST_WINDOWS:
            return 1.0
        mean = float(np.median(square)) / MEDIAN_OF_MEAN if self.restarts else float(square.mean())
        chance = upper_point(2 * len(square), CHANCE) / len(square)
        return float(np.sqrt(0.5 * mean)) if mean > chance else 1.0

    @property
    def independent_errors(self) -> float:
        """Effective number of independent errors in a window.

        The mean of correlated squares has the variance of the mean of so many independent ones
        (Varin 2011, section 2.3).
        """
        square = np.minimum((self.error / self.sigma)[self.moved] ** 2, MOST_SQUARE)
        columns = np.nan_to_num(square).transpose(0, 2, 1).reshape(-1, len(LOOKS))
        with np.errstate(divide="ignore", invalid="ignore"):
            together = np.nan_to_num(np.corrcoef(columns.T), nan=1.0)
        return float(np.clip(len(LOOKS) ** 2 / together.sum(), 1.0, len(LOOKS)))


def shown_increments(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> Increments | None:
    """Increments of the first minutes from a start on, up to a long gap; None without any.

    Joined but for those in which fixes lie.
    """
    shown, valid_ns = _shown(source, config, algorithm, start), start.valid_ns
    if shown is None:
        return None
    made, fixes = source.samples.made, valid_ns[valid_ns <= shown.time_ns[-1]]
    key = "joined", fixes.tobytes(), start.time_ns, id(shown)
    if key not in made:
        made[key] = joined_updates(shown, JOINED_S, fixes)
    return cast("Increments", made[key])


def _shown(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> Increments | None:
    """The same, none of them joined."""
    gap_ns = round(start.settings.max_gap * SECOND)
    return first_increments(source, config, algorithm, start.time_ns, SHOWN_NS, gap_ns)


def shaking(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> Shaking | None:
    """Noise of an IMU that is shaken while the vehicle stands, which is not its noise in motion."""
    shown = _shown(source, config, algorithm, start)
    if shown is None:
        return None
    late = start.late_ns
    made, fixes = source.samples.made, (start.gnss, start.withheld)
    key = "shaking", late, start.time_ns, *map(id, (shown, *fixes))
    if key not in made:
        stage = MeansStage(start.time_ns)
        stage.push(shown)
        # The fixes are stored too: as long as they exist no others have their id
        made[key] = find_shaking(stage.finish(), start.used, late), fixes
    return cast("Shaking", made[key][0])


class Drift:
    """The drift of a navigation without fixes in the first part of a log.

    Parameters
    ----------
    start : FilterStart
        Its withheld fixes are not used.
    """

    def __init__(
        self, source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
    ) -> None:
        self._start = start
        self._estimated = config.filter.virtual_noise == "auto"
        self._measured = config.navigation.imu_noise is not None
        rest = noise_at_rest(source, start)
        self._white = white_noise_bounds(source, start, rest)
        # Noise at rest may come from an engine or people, not from the IMU
        self._shaken = bool(np.any(rest > LEAST_CHANGE))
        self._guess = rest if np.all(rest > 0.0) and not self._shaken else None
        self._increments = shown_increments(source, config, algorithm, start)
        self._shaking = shaking(source, config, algorithm, start)

    @property
    def ratio(self) -> float:
        """Drift over its sigma, see :class:`WindowErrors`."""
        windows = self._as_graded
        return 1.0 if windows is None else windows.ratio

    @property
    def conclusive(self) -> bool:
        """Whether enough windows show the noise, without a restart of the filter."""
        windows = self._as_graded
        return windows is not None and not (windows.restarts or windows.moved.sum() < LEAST_WINDOWS)

    def factors(self) -> NoiseFactors:
        """Noise of gyros and accelerometers over that of the settings.

        If one kind of sensor is noisier than its grade, the model is in doubt and the noise of the
        other is not reduced. Nor is it if the vehicle hardly moves, or if the noise was measured.
        The factor on accelerometers is at least that of their noise at rest.
        """
        if not self.conclusive:
            return NoiseFactors(self.ratio, self.ratio)
        gyro, accel, scale = likeliest(self._errors, self._weight, self._guess)
        accel = max(accel, self._white[1][0])
        scale = scale if scale > LEAST_CHANGE else 1.0
        if max(gyro, accel) > LEAST_CHANGE or self._measured:
            gyro, accel = max(gyro, 1.0), max(accel, 1.0)
        if max(gyro, accel, 1.0 / gyro, 1.0 / accel) < LEAST_CHANGE:
            gyro = accel = 1.0
        return NoiseFactors(gyro, accel, scale, self._white)

    def used(self, factors: NoiseFactors) -> Settings:
        """Settings with this noise, without fictitious process noise if both kinds are better.

        The biases of a bare chip follow its temperature over minutes, which no window shows: its
        bias instability stays at least `WARMING` of the grade's.
        """
        better = self._estimated and max(factors.gyro, factors.accel) < 1.0
        settings = factors.of(self._start.settings, not better)
        if settings.grade != "consumer":
            return settings
        imu, least = settings.imu, self._start.settings.imu
        warming = replace(
            imu,
            gyro_instability=max(imu.gyro_instability, WARMING * least.gyro_instability),
            accel_instability=max(imu.accel_instability, WARMING * least.accel_instability),
        )
        return replace(settings, imu=warming)

    def gains(self, factors: NoiseFactors, others: Mapping[T, SensorGrade]) -> dict[T, float]:
        """Decrease of -2 log likelihood of the drift with other sensors of the same noise.

        Parameters
        ----------
        factors : NoiseFactors
            Noise of the sensors over that of the settings.
        others : mapping to SensorGrade
            The other sensors, with their scale factors, angles and correlation times. Their white
            noise is set to that of `factors`, and their bias instability is scaled with it.

        Returns
        -------
        dict
            By the keys of `others`; minus infinity if the gyros are too noisy for these.
        """
        used, virtual = factors.of(self._start.settings, not self._estimated), not self._estimated
        gains = dict.fromkeys(others, -np.inf)
        least = None
        for name, imu in others.items():
            gyro = used.imu.angle_random_walk / imu.angle_random_walk
            if gyro > MOST_BETTER:
                continue
            least = self._cost(used) if least is None else least
            accel = used.imu.velocity_random_walk / imu.velocity_random_walk
            other = NoiseFactors(gyro, accel).of(replace(used, imu=imu), virtual)
            gains[name] = least - self._cost(other)
        return gains

    def _cost(self, settings: Settings) -> float:
        if self._as_graded is None:
            return np.inf
        return self._weight * cost(*self.window_errors(settings))

    @property
    def _weight(self) -> float:
        return 1.0 if self._as_graded is None else self._as_graded.independent_errors / len(LOOKS)

    def _errors(self, gyro: float, accel: float, scale: float) -> tuple[FloatArray, FloatArray]:
        factors = NoiseFactors(gyro, accel, scale, self._white)
        return self.window_errors(factors.of(self._start.settings, not self._estimated))

    @cached_property
    def _gnss(self) -> GnssEpochs:
        """Fixes of the part of the log that is used."""
        assert self._increments is not None
        return self._start.used_until(int(self._increments.time_ns[-1]))

    @cached_property
    def _left_out(self) -> tuple[BoolArray, BoolArray]:
        """Fixes that each of the two runs leaves out: the second has the two kinds exchanged."""
        step = np.diff(self._gnss.time_ns, prepend=self._start.time_ns) / SECOND
        # Time with fixes: outages of the log itself do not count
        used = np.cumsum(np.minimum(step, LONGEST_STEP_S))
        first, second = (
            (used > SETTLED_S) & ((used + phase) % (2.0 * LEFT_OUT_S) >= LEFT_OUT_S)
            for phase in (0.0, LEFT_OUT_S)
        )
        return first, second

    def _run(
        self, settings: Settings, gnss: GnssEpochs, left_out: BoolArray, increments: Increments
    ) -> tuple[GnssDiagnostics, int]:
        """Epochs with a position, used or compared, and the number of restarts."""
        settings = replace(settings, network=None)
        shaken = None if self._shaking is None else self._shaking.constraints(settings.imu)
        run = InsGnssFilter(
            self._start.start, settings, with_baro=False, output=False, constraints=shaken
        )
        epochs = run.push(increments, gnss, left_out).gnss
        return take_rows(epochs, np.isfinite(epochs.innovation[:, 1])), run.summary.restarts

    def window_errors(self, settings: Settings) -> tuple[FloatArray, FloatArray]:
        """Errors at all times in `LOOKS` of the windows that count, and their sigmas."""
        windows, gnss, increments = self._as_graded, self._gnss, self._increments
        assert windows is not None and increments is not None
        late = round(settings.gnss_latency * SECOND)
        errors, sigmas = [], []
        moved = np.split(windows.moved, [len(windows.times_ns[0])])
        for left_out, times_ns, which in zip(self._left_out, windows.times_ns, moved, strict=True):
            if not which.any():
                continue
            times_ns = times_ns[which]
            # Fixes that are neither used nor compared, and all later samples, are not needed
            last = int(times_ns.max())
            valid_ns = gnss.time_ns - late
            rows = (~left_out & (valid_ns <= last)) | np.isin(valid_ns, times_ns)
            updates = slice(0, int(np.searchsorted(increments.time_ns, last)) + 1)
            epochs, _ = self._run(
                settings, gnss.rows(rows), left_out[rows], take_rows(increments, updates)
            )
            at = np.minimum(np.searchsorted(epochs.time_ns, times_ns), len(epochs) - 1)
            there = (epochs.time_ns[at] == times_ns)[:, :, None]
            errors.append(np.where(there, epochs.innovation[at, :3], np.nan))
            sigmas.append(epochs.innovation_sigma[at, :3])
        if not errors:
            return np.empty((0, len(LOOKS), 3)), np.empty((0, len(LOOKS), 3))
        return np.concatenate(errors), np.concatenate(sigmas)

    @cached_property
    def _as_graded(self) -> WindowErrors | None:
        """Windows with the settings of the start; None without a log."""
        if self._increments is None:
            return None
        errors, sigmas, moved, times, restarts = [], [], [], [], 0
        for left_out in self._left_out:
            epochs, begun = self._run(self._start.settings, self._gnss, left_out, self._increments)
            restarts += begun
            begin, end = _spans(epochs.withheld)
            share = epochs.time_ns[end] - epochs.time_ns[begin]
            looks = [
                np.searchsorted(epochs.time_ns, epochs.time_ns[begin] + (s * share).astype(int))
                for s in LOOKS
            ]
            at = np.minimum(np.stack(looks, axis=1), end[:, None])
            errors.append(epochs.innovation[at, :3])
            sigmas.append(epochs.innovation_sigma[at, :3])
            times.append(epochs.time_ns[at])
            moved.append(self.moved_between(epochs, begin, end))
        return WindowErrors(
            np.concatenate(errors),
            np.concatenate(sigmas),
            np.concatenate(moved),
            restarts,
            tuple(times),
        )

    def moved_between(
        self, epochs: GnssDiagnostics, begin: np.ndarray, end: np.ndarray
    ) -> BoolArray:
        """Windows in which the vehicle moves; only those without a stop, if it is shaken at rest.

        An engine or people that shake a vehicle at rest are not noise of the IMU.
        """
        times = epochs.time_ns[begin], epochs.time_ns[end]
        moved = self._travels(*times, LEAST_WAY)
        if not self._shaken:
            return moved
        steps = np.linspace(*times, PARTS + 1).astype(np.int64)
        goes = [self._travels(a, b, LEAST_WAY / PARTS) for a, b in pairwise(steps)]
        drives = moved & np.all(goes, axis=0)
        return drives if drives.sum() >= LEAST_DRIVEN else moved

    def _travels(self, begin_ns: np.ndarray, end_ns: np.ndarray, least_m: float) -> BoolArray:
        """Whether the vehicle moves by `least_m` plus the noise of the fixes between two times."""
        gnss = self._start.used
        late = self._start.late_ns
        placed = np.flatnonzero(gnss.has_position)
        rows = [
            placed[np.clip(np.searchsorted(gnss.time_ns[placed] - late, time), 0, len(placed) - 1)]
            for time in (begin_ns, end_ns)
        ]
        latitude, longitude = gnss.latitude, gnss.longitude
        north, east = horizontal_metres(
            latitude[rows[1]] - latitude[rows[0]],
            wrapped(longitude[rows[1]] - longitude[rows[0]]),
            latitude[rows[0]],
            gnss.height[rows[0]],
        )
        sigma = np.nan_to_num(gnss.sigma_position_n[rows[0], 0])
        return np.asarray(np.hypot(north, east) > least_m + LEAST_WAY_SIGMAS * sigma)


def _spans(mask: BoolArray) -> tuple[np.ndarray, np.ndarray]:
    """First and last row of each run of marked rows; one at the end of `mask` is left out."""
    edge = np.diff(mask.astype(np.int8), prepend=0)
    begin, end = np.flatnonzero(edge > 0), np.flatnonzero(edge < 0) - 1
    return begin[: len(end)], end
