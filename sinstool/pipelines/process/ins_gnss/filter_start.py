"""Start data of a run of the INS/GNSS filter."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.result import compass
from sinstool.core.rotation import to_euler
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.alignment.initial import Alignment
from sinstool.methods.height.reference import HeightReference
from sinstool.methods.ins_gnss.clock_rate import STEADY, ClockRate
from sinstool.methods.ins_gnss.fix_velocity import outlying
from sinstool.methods.ins_gnss.receiver_offsets import ReceiverOffsets
from sinstool.methods.ins_gnss.settings import Settings, Start
from sinstool.methods.ins_gnss.states import GNSS_POSITION
from sinstool.methods.receiver_priors import ARM_USUAL_M, LATENCY_S
from sinstool.methods.sensor_errors import Grade, Triple
from sinstool.pipelines.process.ins_gnss.initial_state import FoundStart, StartFixes, find_start
from sinstool.pipelines.process.summary import FirstAttitude
from sinstool.survey.grade import ImuGrade
from sinstool.survey.source import Source

# Status `ok` needs a sigma of heading below this, deg.
GOOD_HEADING = 5.0
# A lever arm whose variance is less than this share of that of a fix adds nothing to positions.
MUCH_BETTER = 0.1


@dataclass(frozen=True)
class WhiteNoise:
    """White noise of fixes as a log shows it.

    Attributes
    ----------
    position, velocity : tuple of float
        Horizontal (of one axis) and vertical, m and m/s; NaN where too few fixes show it.
    start, settings : Start, Settings
        Of the run of the filter that showed it.
    usual : ndarray of bool, shape (n,)
        Fixes that took part in it.
    outlying : ndarray of bool, shape (n,)
        Those far off their neighbours by the IMU.
    """

    position: tuple[float, float]
    velocity: tuple[float, float]
    start: Start
    settings: Settings
    usual: BoolArray
    outlying: BoolArray

    def is_of(self, start: Start, settings: Settings, usual: BoolArray) -> bool:
        """Whether a run from this start would show the same."""
        same = start is self.start and settings == self.settings
        return same and np.array_equal(usual, self.usual)


@dataclass(frozen=True)
class LikelierGrade:
    """Another grade of an IMU, and by how much it lowers -2 log likelihood."""

    grade: Grade
    gain: float


@dataclass(frozen=True)
class FilterStart:
    """A filter's settings, start and measurements: everything but the samples.

    Attributes
    ----------
    settings, start : Settings, Start
        Of the filter.
    time_ns : int
        Of an IMU sample, at which the first update of the filter begins.
    how : str
        Source of the start, in words.
    alignment : Alignment
        Its first attitude.
    gnss : GnssEpochs
        Valid `settings.gnss_latency` before their stamps.
    withheld : ndarray of bool
        Epochs that are scored, not used.
    reference : HeightReference or None
        Barometer heights.
    offsets : ReceiverOffsets or None
        Estimate of latency and arm; None before it was made, or with too few fixes.
    latency_status : {'given', 'found', 'not settled', 'not observable'}
        ``given`` by the user; ``not settled`` if the estimate did not converge.
    lag : float
        By which velocities are stamped later than positions, s.
    grade : ImuGrade
        Of the IMU, with the reason.
    gnss_why : str
        Noise of the fixes and its source, in words.
    warnings : tuple of str
        About settings and measurements.
    white : WhiteNoise, optional
        Of the fixes, by a run from this start or from the one before.
    arm_status : {'given', 'found', 'open'}
        The lever arm: given by the user, found in the log, or 0 as it is neither.
    noisier, noisier_velocity : tuple of float, optional
        Noise of positions and of velocities over what the receiver states, horizontal and vertical;
        1 where it is not clearly more.
    velocity_noise : tuple of float, optional
        White noise of velocities by the log, horizontal and vertical, m/s; NaN where it is not
        known.
    slow_errors : tuple of float, optional
        Slow errors of positions over those that follow from what the receiver states, horizontal
        and vertical.
    slow_velocity : tuple of float, optional
        The same of velocities.
    expected_slow_errors : tuple of float, optional
        Slow errors to expect over those that the log shows: of positions, horizontal and vertical,
        and of velocities, horizontal and vertical.
    unseen_m : float, optional
        Up to which size slow errors of positions would not show in the log, m; 0 if none is unseen.
    drifts : float, optional
        Drift without fixes over its sigma, if options give the noise of the IMU; 1 where it is not
        clearly more.
    likelier : LikelierGrade or None, optional
        A worse grade than that of an option, if innovations are far likelier with it.
    bias_at_rest : float, optional
        Least gyro bias at rest over its sigma, if options give the errors of the IMU; 0 without a
        rest.
    turned : tuple of float, optional
        Distance of the attitude, in sigmas and in rad, from that with the latency and lever arm of
        the log, if the log contradicts those in use.
    denied : float, optional
        By how much another first attitude than the configured one lowers -2 log likelihood; 0 if
        none is clearly likelier.
    unexplained : float, optional
        Noise of velocities compared with the IMU, over the most that the positions of the same
        receiver allow, with the latency and lever arm of the log.
    noisier_gyros : float, optional
        Noise of low-cost gyros by the drift without fixes, over that of their grade.
    placed : bool, optional
        It lies before gaps behind which an alignment finds its attitude: with another latency or
        grade the attitude is the same.
    clock : ClockRate, optional
        Rate of the receiver's clock, by which the stamps of `gnss` were corrected.
    """

    settings: Settings
    start: Start
    time_ns: int
    how: str
    alignment: Alignment
    gnss: GnssEpochs
    withheld: np.ndarray
    reference: HeightReference | None
    offsets: ReceiverOffsets | None
    latency_status: str
    lag: float
    grade: ImuGrade
    gnss_why: str
    warnings: tuple[str, ...]
    white: WhiteNoise | None = None
    arm_status: str = "given"
    noisier: tuple[float, float] = (1.0, 1.0)
    velocity_noise: tuple[float, float] = (np.nan, np.nan)
    noisier_velocity: tuple[float, float] = (1.0, 1.0)
    slow_errors: tuple[float, float] = (1.0, 1.0)
    slow_velocity: tuple[float, float] = (1.0, 1.0)
    expected_slow_errors: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    unseen_m: float = 0.0
    drifts: float = 1.0
    likelier: LikelierGrade | None = None
    bias_at_rest: float = 0.0
    turned: tuple[float, float] = (0.0, 0.0)
    denied: float = 0.0
    unexplained: float = 0.0
    noisier_gyros: float = 1.0
    placed: bool = False
    clock: ClockRate = STEADY

    @cached_property
    def used(self) -> GnssEpochs:
        """Epochs that are not withheld."""
        return self.gnss.rows(~self.withheld)

    @cached_property
    def believable(self) -> GnssEpochs:
        """Those used, but for positions far off their neighbours: for runs without a gate."""
        far = outlying(self.used)
        if self.white is not None and len(self.white.outlying) == len(far):
            far |= self.white.outlying
        return self.used.rows(~far)

    @property
    def attitude_warnings(self) -> tuple[str, ...]:
        """Warnings about the first attitude."""
        return self.alignment.warnings

    def at(self, found: FoundStart) -> FilterStart:
        """The same filter from another start."""
        return replace(
            self,
            start=found.start,
            time_ns=found.time_ns,
            how=found.how,
            alignment=found.alignment,
        )

    def from_attitude(
        self, source: Source, config: ProcessConfig, alignment: Alignment
    ) -> FilterStart:
        """The same filter from a known attitude.

        Raises
        ------
        AlignmentError
            There are no fixes near it.
        """
        fixes = StartFixes.of(self.used, self.settings.gnss)
        return self.at(find_start(source, config, self.settings, fixes, alignment))

    @property
    def by_the_fixes(self) -> FilterStart:
        """With the estimated lever arm and latency where the log contradicts those in use.

        For judging noise: errors of a wrong option would be attributed to the IMU or the fixes.
        """
        shown, settings = self.offsets, self.settings
        if shown is None:
            return self
        if shown.arm_contradicts:
            x, y, z = shown.arm_b.tolist()
            settings = replace(settings, lever_arm_b=(x, y, z))
        if shown.latency_contradicts(settings.gnss_latency):
            settings = replace(settings, gnss_latency=shown.latency_s)
        return replace(self, settings=settings)

    def with_latency(self, latency_s: float, at_start_s: float | None = None) -> FilterStart:
        """The same with another latency, s, of which that at the start may differ.

        The position of a start is that of a fix, which with another latency is valid at another
        time: its covariance grows by the distance moved in between.
        """
        begun, settings = self.start, self.settings
        at_start_s = latency_s if at_start_s is None else at_start_s
        off = begun.nav[3:6] * (at_start_s - settings.gnss_latency)
        covariance = begun.covariance_position_n + np.outer(off, off)
        return replace(
            self,
            settings=replace(settings, gnss_latency=latency_s),
            start=replace(begun, covariance_position_n=covariance),
        )

    @property
    def late_ns(self) -> int:
        """By how much fixes are stamped later than they are valid."""
        return round(self.settings.gnss_latency * SECOND)

    @property
    def valid_ns(self) -> IntArray:
        """When the epochs that are used are valid."""
        return self.used.time_ns - self.late_ns

    def used_until(self, time_ns: int) -> GnssEpochs:
        """Epochs that are used and valid up to a time, for runs that end there."""
        return self._until(self.used, time_ns)

    def believable_until(self, time_ns: int) -> GnssEpochs:
        """The same of `believable`."""
        return self._until(self.believable, time_ns)

    def _until(self, fixes: GnssEpochs, time_ns: int) -> GnssEpochs:
        """Fixes that are valid up to a time."""
        last_ns = time_ns + self.late_ns
        return fixes.rows(slice(0, int(np.searchsorted(fixes.time_ns, last_ns, "right"))))

    def with_slow_position(self, level: float, vertical: float, why: str) -> FilterStart:
        """The same start with larger slow errors of positions.

        The sigmas of single fixes, and of the start, which is a fix, grow with them: a filter takes
        the part of a fix's sigma beyond the slow one for white.

        Parameters
        ----------
        level, vertical : float
            Factors on the slow errors.
        why : str
            The reason, for `gnss_why`; empty if there is none to give.
        """
        before = self.settings.gnss
        model = before.with_slow_position(level, vertical)
        parts = before.position_white, before.position_markov, model.position_markov
        sigma = np.sqrt(_with_slow(np.square(self.gnss.sigma_position_n), *parts))
        covariance = _grown(self.start.covariance_position_n, *parts)
        return replace(
            self,
            settings=replace(self.settings, gnss=model),
            start=replace(self.start, covariance_position_n=covariance),
            gnss=replace(self.gnss, sigma_position_n=sigma),
            gnss_why=f"{self.gnss_why}; {why}" if why else self.gnss_why,
        )

    def lasting(self, seconds: float) -> FilterStart:
        """The same start with slow errors of positions that last so long."""
        gnss = self.settings.gnss.lasting(seconds)
        return replace(self, settings=replace(self.settings, gnss=gnss))

    def with_slow_velocity(self, level: float, vertical: float) -> FilterStart:
        """The same start with slow errors of velocities so many times as large, and its sigmas."""
        before = self.settings.gnss
        model = before.with_slow_velocity(level, vertical)
        parts = before.velocity_white, before.velocity_markov, model.velocity_markov
        sigma = np.sqrt(_with_slow(np.square(self.gnss.sigma_velocity_n), *parts))
        covariance = _grown(self.start.covariance_velocity_n, *parts)
        return replace(
            self,
            settings=replace(self.settings, gnss=model),
            start=replace(self.start, covariance_velocity_n=covariance),
            gnss=replace(self.gnss, sigma_velocity_n=sigma),
        )

    @property
    def slow_m(self) -> tuple[float, float, float]:
        """Slow errors of positions, NED, m, that the filter has no states for.

        A filter follows them, and takes their part in innovations for white noise.
        """
        modelled = self.settings.kind.first(GNSS_POSITION) >= 0
        return (0.0, 0.0, 0.0) if modelled else self.settings.gnss.position_markov

    @property
    def offsets_error(self) -> FloatArray:
        """Second moments of the errors of the latency and lever arm used, of s and m, (4, 4).

        Those neither given nor found have the sigmas of their priors. An arm counts if it is less
        certain than fixes, whose positions then depend on it, or much more certain: then it changes
        no position, but velocities where the vehicle turns quickly.
        """
        configured = self.latency_status == "given"
        arm = 0.0 if self.arm_status == "given" else ARM_USUAL_M**2
        moment = np.diag([0.0 if configured else LATENCY_S**2, arm, arm, arm])
        if self.offsets is not None:
            moment = self.offsets.error_of(self.settings.gnss_latency, configured)
        moment[0, 0] += self.clock.spread_s**2
        contradicted = self.offsets is not None and self.offsets.arm_contradicts
        square, fix = float(np.trace(moment[1:, 1:])), self.fix_sigma_m**2
        matters = not MUCH_BETTER * fix < square < 3.0 * fix
        if self.arm_status == "open" and not (matters or contradicted):
            moment[1:], moment[:, 1:] = 0.0, 0.0
        return moment

    @property
    def arm_matters(self) -> bool:
        """Whether positions are less certain for the lever arm, which was not given, than fixes."""
        arm = float(np.trace(self.offsets_error[1:, 1:]))
        return self.arm_status != "given" and arm > self.fix_sigma_m**2

    @property
    def fix_sigma_m(self) -> float:
        """Sigma of one horizontal axis of a fix, m, white and slow parts together."""
        noise = self.settings.gnss
        return float(np.hypot(noise.position_white[0], noise.position_markov[0]))

    @property
    def first_attitude(self) -> FirstAttitude:
        """The attitude that the filter starts from."""
        start = self.start
        roll, pitch, heading = (to_euler(start.nav[6:10]) / DEGREE).tolist()
        sigma = np.sqrt(np.diag(start.covariance_attitude_n)) / DEGREE
        return FirstAttitude(
            method="filter-start",
            how=self.how,
            time_ns=self.time_ns,
            roll_deg=roll,
            pitch_deg=pitch,
            heading_deg=compass(heading),
            sigma_deg=tuple(sigma.tolist()),
            status="ok" if sigma[2] < GOOD_HEADING else "degraded",
            north_referenced=True,
            gyro_bias_rad_s=tuple(start.gyro_bias.tolist()),
            gyro_bias_source="start",
        )


def measurements(p: FilterStart) -> dict[str, Any]:
    """Measurements that a filter gets with its first increments."""
    columns: dict[str, Any] = {"gnss": p.gnss, "withheld": p.withheld}
    if p.reference is not None:
        r = p.reference
        later = r.arrival_ns >= p.time_ns
        columns["baro_time_ns"] = r.time_ns[later]
        columns["baro_height"] = r.height[later]
        columns["baro_reason"] = r.reason[later]
    return columns


def _with_slow(square: FloatArray, white: Triple, before: Triple, slow: Triple) -> FloatArray:
    """Variances, shape (n, 3) or (3,), with another slow part beside the same white one.

    Of variances below those of the model, which a filter takes for white and slow in the proportion
    of the model, both parts count as much less.
    """
    whole, other = (np.square(white) + np.square(part) for part in (before, slow))
    return np.asarray(np.where(square >= whole, square + other - whole, square * other / whole))


def _grown(covariance: FloatArray, white: Triple, before: Triple, slow: Triple) -> FloatArray:
    """Covariance of a start with a larger slow part; a smaller one leaves it alone."""
    square = np.diagonal(covariance)
    more = _with_slow(square, white, before, slow) - square
    return np.asarray(covariance + np.diag(np.maximum(more, 0.0)))
