"""Noise of an Imu, estimated from the drift of its navigation where fixes are left out.

From one fix to the next even a poor Imu errs by less than the fixes do. Within the first seconds
without fixes mostly the accelerometers' noise shows, later that of the gyros, which tilts the
navigation: errors at several ages tell the two apart. Scale factors of accelerometers that wander
show in the vertical, where gravity always acts. All are sought by the likelihood of these errors
(Schweppe 1965), each error by itself, as those of a window belong together.

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
from sinstool.methods.ins_gnss.states import ACCEL_AXES
from sinstool.methods.land_vehicle.shaking import Shaking, find_shaking
from sinstool.methods.land_vehicle.track import MeansStage
from sinstool.methods.sensor_errors import LOW_COST, SensorGrade
from sinstool.methods.strapdown.joined_updates import JOINED_S
from sinstool.methods.strapdown.velocity import Increments
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.likeliest_noise import MOST_SQUARE, cost, likeliest
from sinstool.survey.grade import random_walks
from sinstool.survey.increments import first_increments
from sinstool.survey.noise_in_motion import walks_in_motion
from sinstool.survey.source import Source

# So much of a log shows it.
SHOWN_NS = 660 * SECOND
# Fixes are left out for so long, s, and used as long, from when the filter has settled, s, on.
LEFT_OUT_S, SETTLED_S = 20.0, 60.0
LONGEST_STEP_S = 1.5
# Where errors of a window are looked at, as shares of it.
LOOKS = (0.1, 0.35, 1.0)
LEAST_WINDOWS = 4
# A window in which the fixes show less of a way, m and sigmas, shows the Imu at rest.
LEAST_WAY, LEAST_WAY_SIGMAS = 10.0, 6.0
# One in each of whose parts they do shows no rest at all; so many of these are enough.
PARTS, LEAST_DRIVEN = 10, 6
# The scatter of a sum of squares of unit normals.
CHANCE = 0.01
# The median of the sum of two squares of unit normals, over its mean.
MEDIAN_OF_MEAN = float(np.log(2.0))
# Factors nearer to 1 than this are none.
LEAST_CHANGE = 1.3
# The least share of its grade's bias instability that a bare chip has.
WARMING = 0.5
# Sensors that are noisier than so many times a grade are not of it.
MOST_BETTER = 8.0

T = TypeVar("T")
Bounds = tuple[float, float]
ANY: Bounds = (0.0, np.inf)


@dataclass(frozen=True)
class NoiseFactors:
    """By how much gyros and accelerometers are noisier than a grade has them.

    Attributes
    ----------
    gyro, accel : float
        Of what of the biases wanders, and of white noise.
    scale : float
        Of what of the scale factors wanders.
    white : tuple of tuple of float
        Least and largest factor of the white noise of gyros and of that of accelerometers: as far
        as a log shows it by itself, the drift has no say.
    """

    gyro: float
    accel: float
    scale: float = 1.0
    white: tuple[Bounds, Bounds] = (ANY, ANY)

    @property
    def ordinary(self) -> bool:
        """Whether all factors are 1."""
        return self.gyro == self.accel == self.scale == 1.0

    def of(self, settings: Settings, virtual_noise: bool) -> Settings:
        """Settings with the noise that is meant.

        Parameters
        ----------
        virtual_noise : bool
            Whether fictitious noise, if there is any, remains.
        """
        imu, control = settings.imu, settings.control
        gyro, accel = (
            min(max(factor, least), most)
            for factor, (least, most) in zip((self.gyro, self.accel), self.white, strict=True)
        )
        noisier = replace(
            imu,
            angle_random_walk=gyro * imu.angle_random_walk,
            gyro_instability=self.gyro * imu.gyro_instability,
            velocity_random_walk=accel * imu.velocity_random_walk,
            accel_instability=self.accel * imu.accel_instability,
            scale_wander=min(1.0, self.scale * imu.scale_wander),
        )
        virtual = replace(control, virtual_noise=control.virtual_noise and virtual_noise)
        return replace(settings, imu=noisier, control=virtual)

    def __str__(self) -> str:
        parts = [] if self.scale == 1.0 else [f"scale factors {self.scale:.2g}"]
        if self.gyro != self.accel:
            parts += [f"gyros {self.gyro:.2g}", f"accelerometers {self.accel:.2g}"]
        elif not parts:
            parts.append(f"{self.gyro:.2g}")
        elif self.gyro != 1.0:
            parts.append(f"gyros and accelerometers {self.gyro:.2g}")
        return ", ".join(parts) + " times"


@dataclass(frozen=True)
class _Windows:
    """Errors where fixes are left out, with all fixes of both runs.

    Attributes
    ----------
    error, sigma : ndarray, shape (w, looks, 3)
        North, east, down, m.
    moved : ndarray of bool, shape (w,)
        Whether the vehicle went anywhere.
    restarts : int
        How often the filter began anew.
    times_ns : tuple of ndarray of int64, shape (w, looks)
        Of each run.
    """

    error: FloatArray
    sigma: FloatArray
    moved: BoolArray
    restarts: int
    times_ns: tuple[IntArray, ...] = ()

    @property
    def ratio(self) -> float:
        """Error over sigma at the windows' ends, RMS of north and east.

        1 where it is not more than chance makes of 1, or too few windows show it. Where the filter
        began anew, bad fixes may have been the cause: what counts then is the median, to which
        these add little.
        """
        ends = (self.error / self.sigma)[:, -1, :2]
        square = np.minimum(np.sum(ends**2, axis=1), MOST_SQUARE)
        if len(square) < LEAST_WINDOWS:
            return 1.0
        mean = float(np.median(square)) / MEDIAN_OF_MEAN if self.restarts else float(square.mean())
        chance = upper_point(2 * len(square), CHANCE) / len(square)
        return float(np.sqrt(0.5 * mean)) if mean > chance else 1.0

    @property
    def looks(self) -> float:
        """The number of looks of a window, less as far as their squares belong together.

        This makes up for treating them as independent: the variance of a mean of squares that are
        correlated is that of so many (Varin 2011, section 2.3).
        """
        square = np.minimum((self.error / self.sigma)[self.moved] ** 2, MOST_SQUARE)
        columns = np.nan_to_num(square).transpose(0, 2, 1).reshape(-1, len(LOOKS))
        with np.errstate(divide="ignore", invalid="ignore"):
            together = np.nan_to_num(np.corrcoef(columns.T), nan=1.0)
        return float(np.clip(len(LOOKS) ** 2 / together.sum(), 1.0, len(LOOKS)))


def shown_increments(
    source: Source,
    config: ProcessConfig,
    algorithm: ConingAlgorithm,
    start: FilterStart,
    below_s: float | None = JOINED_S,
) -> Increments | None:
    """Increments of the first minutes from a start on, up to a long gap; None without any.

    Parameters
    ----------
    below_s : float or None
        They are joined as long as they stay shorter, s.
    """
    gap_ns = round(start.settings.max_gap * SECOND)
    return first_increments(source, config, algorithm, start.time_ns, SHOWN_NS, gap_ns, below_s)


def shaking(
    source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
) -> Shaking | None:
    """What shakes the Imu where the vehicle stands: that is no noise of the Imu in motion."""
    shown = shown_increments(source, config, algorithm, start, None)
    if shown is None:
        return None
    late = round(start.settings.gnss_latency * SECOND)
    made, fixes = source.samples.made, (start.gnss, start.withheld)
    key = "shaking", late, start.time_ns, *map(id, fixes)
    if key not in made:
        stage = MeansStage(start.time_ns)
        stage.push(shown)
        # With the fixes, as others may be where those were
        made[key] = find_shaking(stage.finish(), start.used, late), fixes
    return cast("Shaking", made[key][0])


class Drift:
    """The drift of a navigation in the first part of a log.

    Parameters
    ----------
    start : FilterStart
        What it withholds is not looked at.
    """

    def __init__(
        self, source: Source, config: ProcessConfig, algorithm: ConingAlgorithm, start: FilterStart
    ) -> None:
        self._start = start
        self._estimated = config.filter.virtual_noise == "auto"
        self._measured = config.navigation.imu_noise is not None
        rest = _noise_at_rest(source, start)
        self._white = _white_noise(source, start, rest)
        # By an engine or people, which is no noise of the Imu in motion
        self._shaken = bool(np.any(rest > LEAST_CHANGE))
        self._guess = rest if np.all(rest > 0.0) and not self._shaken else None
        self._increments = shown_increments(source, config, algorithm, start)
        self._shaking = shaking(source, config, algorithm, start)

    @property
    def ratio(self) -> float:
        """By how much more the navigation drifts than the filter says that it does."""
        windows = self._as_graded
        return 1.0 if windows is None else windows.ratio

    @property
    def tells(self) -> bool:
        """Whether enough windows show the noise, and no restart of the filter spoils them."""
        windows = self._as_graded
        return windows is not None and not (windows.restarts or windows.moved.sum() < LEAST_WINDOWS)

    def factors(self) -> NoiseFactors:
        """Noise of gyros and accelerometers over that of the settings.

        Where one is noisier than its grade the model is in doubt, and the other is not taken for
        better than its own; nor is any by a log in which the vehicle hardly moves, or whose noise
        was measured. Sensors that a rest shows to be quiet are no quieter in motion.
        """
        if not self.tells:
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
        """The settings with such noise, and without a fictitious one that has been measured.

        The biases of a bare chip follow its temperature over minutes, which no window shows.
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
        """Twice the log of how much likelier the drift is with other sensors that are as noisy.

        Parameters
        ----------
        factors : NoiseFactors
            With which those of the settings are as noisy as they seem to be.
        others : mapping to SensorGrade
            The other sensors. Their scale factors, angles and correlation times count; their white
            noise becomes that of `factors`, and the bias instability changes with it.

        Returns
        -------
        dict
            Minus infinity where gyros are too noisy to be those.
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
        return self._weight * cost(*self._looked(settings))

    @property
    def _weight(self) -> float:
        return 1.0 if self._as_graded is None else self._as_graded.looks / len(LOOKS)

    def _errors(self, gyro: float, accel: float, scale: float) -> tuple[FloatArray, FloatArray]:
        factors = NoiseFactors(gyro, accel, scale, self._white)
        return self._looked(factors.of(self._start.settings, not self._estimated))

    @cached_property
    def _gnss(self) -> GnssEpochs:
        """Fixes of the time that is looked at."""
        assert self._increments is not None
        return self._start.used_until(int(self._increments.time_ns[-1]))

    @cached_property
    def _left_out(self) -> tuple[BoolArray, BoolArray]:
        """Fixes that either run leaves out, by turns: with fixes and without, and the other way."""
        step = np.diff(self._gnss.time_ns, prepend=self._start.time_ns) / SECOND
        # Time with fixes: an outage of the log itself is none of ours
        used = np.cumsum(np.minimum(step, LONGEST_STEP_S))
        first, second = (
            (used > SETTLED_S) & ((used + phase) % (2.0 * LEFT_OUT_S) >= LEFT_OUT_S)
            for phase in (0.0, LEFT_OUT_S)
        )
        return first, second

    def _run(
        self, settings: Settings, gnss: GnssEpochs, left_out: BoolArray, increments: Increments
    ) -> tuple[GnssDiagnostics, int]:
        """Epochs with a position, used or compared, and how often the filter began anew."""
        settings = replace(settings, network=None)
        shaken = None if self._shaking is None else self._shaking.constraints(settings.imu)
        run = InsGnssFilter(
            self._start.start, settings, with_baro=False, output=False, constraints=shaken
        )
        epochs = run.push(increments, gnss, left_out).gnss
        return take_rows(epochs, np.isfinite(epochs.innovation[:, 1])), run.summary.restarts

    def _looked(self, settings: Settings) -> tuple[FloatArray, FloatArray]:
        """Errors of all looks of the windows in motion, and their sigmas."""
        windows, gnss, increments = self._as_graded, self._gnss, self._increments
        assert windows is not None and increments is not None
        late = round(settings.gnss_latency * SECOND)
        errors, sigmas = [], []
        moved = np.split(windows.moved, [len(windows.times_ns[0])])
        for left_out, times_ns, which in zip(self._left_out, windows.times_ns, moved, strict=True):
            if not which.any():
                continue
            times_ns = times_ns[which]
            # What is left out and not looked at changes nothing, nor does what comes later
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
    def _as_graded(self) -> _Windows | None:
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
            moved.append(self._moved(epochs, begin, end))
        return _Windows(
            np.concatenate(errors),
            np.concatenate(sigmas),
            np.concatenate(moved),
            restarts,
            tuple(times),
        )

    def _moved(self, epochs: GnssDiagnostics, begin: np.ndarray, end: np.ndarray) -> BoolArray:
        """Windows in which the vehicle goes somewhere; those without a stop, where it shakes there.

        What shakes a vehicle that stands, an engine or people, is none of the Imu's noise.
        """
        times = epochs.time_ns[begin], epochs.time_ns[end]
        moved = self._goes(*times, LEAST_WAY)
        if not self._shaken:
            return moved
        steps = np.linspace(*times, PARTS + 1).astype(np.int64)
        goes = [self._goes(a, b, LEAST_WAY / PARTS) for a, b in pairwise(steps)]
        drives = moved & np.all(goes, axis=0)
        return drives if drives.sum() >= LEAST_DRIVEN else moved

    def _goes(self, begin_ns: np.ndarray, end_ns: np.ndarray, least_m: float) -> BoolArray:
        """Whether fixes show more way from some times to others than their noise may make."""
        gnss = self._start.used
        late = round(self._start.settings.gnss_latency * SECOND)
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


def _noise_at_rest(source: Source, start: FilterStart) -> FloatArray:
    """Noise of gyros and accelerometers at rest over that of the settings; NaN without a rest."""
    walks, imu = random_walks(source), start.settings.imu
    if walks is None:
        return np.full(2, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.divide(walks, (imu.angle_random_walk, imu.velocity_random_walk))


def _white_noise(source: Source, start: FilterStart, rest: FloatArray) -> tuple[Bounds, Bounds]:
    """What a log shows of the white noise of gyros and accelerometers over that of the settings.

    Sensors are no quieter than at rest, which does not hold for a grade that was judged by its
    drift, as an idling engine looks like poor sensors; and no noisier than in motion. White noise
    of accelerometers stands in for their cross-axis errors where a filter has no states for these,
    and that of a MEMS grade for more.

    Parameters
    ----------
    rest : ndarray, shape (2,)
        See :func:`_noise_at_rest`.
    """
    moving, imu = walks_in_motion(source), start.settings.imu
    assumed = imu.angle_random_walk, imu.velocity_random_walk
    if start.grade.grade in LOW_COST or not all(assumed):
        return ANY, ANY
    shown = np.full(2, np.inf) if moving is None else np.divide(moving, assumed)
    rest = np.zeros(2) if start.grade.by_drift else np.nan_to_num(rest)
    gyro, accel = np.minimum(np.minimum(rest, shown), 1.0).tolist()
    most_gyro, most_accel = np.maximum(shown, 1.0).tolist()
    has_axes = start.settings.kind.first(ACCEL_AXES) >= 0
    return (gyro, most_gyro), (accel, most_accel if has_axes else np.inf)


def _spans(mask: BoolArray) -> tuple[np.ndarray, np.ndarray]:
    """First and last of each run of marked rows that ends."""
    edge = np.diff(mask.astype(np.int8), prepend=0)
    begin, end = np.flatnonzero(edge > 0), np.flatnonzero(edge < 0) - 1
    return begin[: len(end)], end
