"""Start data of a run of the INS/GNSS filter."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray
from sinstool.core.result import compass
from sinstool.core.rotation import to_euler
from sinstool.core.streams import GnssEpochs
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.alignment.initial import Alignment
from sinstool.methods.height.reference import HeightReference
from sinstool.methods.ins_gnss.clock_rate import STEADY, ClockRate
from sinstool.methods.ins_gnss.receiver_offsets import (
    ARM_USUAL_M,
    LATENCY_S,
    ReceiverOffsets,
)
from sinstool.methods.ins_gnss.settings import Settings, Start
from sinstool.pipelines.process.ins_gnss.initial_state import FoundStart
from sinstool.pipelines.process.summary import FirstAttitude
from sinstool.survey.grade import ImuGrade

# A heading more certain than this is good, deg.
GOOD_HEADING = 5.0
# An arm whose mean square is less than so much of a fix's adds nothing to positions.
MUCH_BETTER = 0.1


@dataclass(frozen=True)
class WhiteNoise:
    """White noise of fixes as a log shows it.

    Attributes
    ----------
    position, velocity : tuple of float
        Horizontal (of one axis) and vertical, m and m/s; NaN where too few fixes show it.
    start, settings, usual
        Of the filter's run that showed it, and which fixes took part, shape (n,).
    """

    position: tuple[float, float]
    velocity: tuple[float, float]
    start: Start
    settings: Settings
    usual: BoolArray

    def is_of(self, start: Start, settings: Settings, usual: BoolArray) -> bool:
        """Whether a run from such a start shows no other."""
        same = start is self.start and settings == self.settings
        return same and np.array_equal(usual, self.usual)


@dataclass(frozen=True)
class FilterStart:
    """A filter's settings, start and measurements: all but the samples.

    Attributes
    ----------
    time_ns : int
        An Imu sample's: the first update of the filter begins there.
    how : str
        Where the start comes from, in words.
    alignment : Alignment
        The first attitude that it comes from.
    gnss : GnssEpochs
        Valid `settings.gnss_latency` before their stamps.
    withheld : ndarray of bool
        Epochs that are scored, not used.
    reference : HeightReference or None
        Barometer heights.
    offsets : ReceiverOffsets or None
        Latency and arm as the log shows them; None before it was asked, or with too few fixes.
    latency_status : {'given', 'found', 'not settled', 'not observable'}
        ``given`` by the user; ``not settled`` where what the log shows is not what is used.
    arm_status : {'given', 'found', 'open'}
        The lever arm: given by the user, as the log shows it, or 0 as neither says where it is.
    lag : float
        By which velocities are taken to be stamped later than positions, s.
    warnings : tuple of str
        About settings and measurements.
    white : WhiteNoise, optional
        Of the fixes, as the log shows it from here or from the start before.
    noisier : tuple of float, optional
        How many times as noisy as the receiver says positions are, horizontally and vertically.
    velocity_noise : tuple of float, optional
        White noise of velocities as the log shows it, horizontally and vertically, m/s; NaN where
        it does not.
    noisier_velocity : tuple of float, optional
        The same of velocities.
    slow_errors : tuple of float, optional
        How many times as large as follows from what the receiver says the slow errors of positions
        are, horizontally and vertically.
    drifts : float, optional
        How many times as far as options that say how good the Imu is explain the navigation drifts
        where fixes are left out; 1 where that shows no more.
    turned : tuple of float, optional
        How far the attitude is, in sigmas and in rad, from that with the latency and the lever arm
        that the log shows where it contradicts those in use.
    denied : float, optional
        By how much -2 log likelihood is less with another first attitude than with that of options;
        0 where none is clearly likelier.
    clock : ClockRate, optional
        Of the receiver, by which the stamps of `gnss` were put right.
    unexplained : float, optional
        How many times as noisy as the positions of the same receiver allow its velocities are
        beside the Imu, whatever the latency and the lever arm.
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
    drifts: float = 1.0
    turned: tuple[float, float] = (0.0, 0.0)
    denied: float = 0.0
    unexplained: float = 0.0
    clock: ClockRate = STEADY

    @cached_property
    def used(self) -> GnssEpochs:
        """Epochs that are not withheld."""
        return self.gnss.rows(~self.withheld)

    @property
    def attitude_warnings(self) -> tuple[str, ...]:
        """About how the attitude was found."""
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

    @property
    def by_the_fixes(self) -> FilterStart:
        """With estimated lever arm and latency, lest wrong options be blamed on the Imu."""
        shown, settings = self.offsets, self.settings
        if shown is None:
            return self
        if shown.arm_contradicts:
            x, y, z = shown.arm_b.tolist()
            settings = replace(settings, lever_arm_b=(x, y, z))
        if shown.latency_contradicts(settings.gnss_latency):
            settings = replace(settings, gnss_latency=shown.latency_s)
        return replace(self, settings=settings)

    def used_until(self, time_ns: int) -> GnssEpochs:
        """Those that are valid up to a time, for runs that end there."""
        late = round(self.settings.gnss_latency * SECOND)
        return self.used.rows(
            slice(0, int(np.searchsorted(self.used.time_ns, time_ns + late, "right")))
        )

    def with_slow_position(self, level: float, vertical: float, why: str) -> FilterStart:
        """The same start with slow errors of positions that are so many times as large.

        Those of single fixes, and of the start, which is one, grow with them: a filter leaves to
        the white part of a fix's noise what is left beside the slow one.
        """
        before = self.settings.gnss
        model = before.with_slow_position(level, vertical)
        white, slow = np.square(before.position_white), np.square(before.position_markov)
        square = np.square(self.gnss.sigma_position_n)
        left = np.where(square >= white + slow, square - slow, square * white / (white + slow))
        sigma = np.sqrt(left + np.square(model.position_markov))
        covariance = self.start.covariance_position_n
        least = np.square(model.position_white) + np.square(model.position_markov)
        covariance = covariance + np.diag(np.maximum(least - np.diagonal(covariance), 0.0))
        return replace(
            self,
            settings=replace(self.settings, gnss=model),
            start=replace(self.start, covariance_position_n=covariance),
            gnss=replace(self.gnss, sigma_position_n=sigma),
            gnss_why=f"{self.gnss_why}; {why}",
        )

    @property
    def offsets_error(self) -> FloatArray:
        """Second moments of the errors of the latency and lever arm used, of s and m, (4, 4).

        What nobody gave and the log does not show is as uncertain as latencies and arms are. An arm
        matters where fixes are better than it is known. Where it is known much better than they
        are, it moves no position, but velocities wherever the vehicle turns quickly.
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
    def fix_sigma_m(self) -> float:
        """Of one horizontal axis of a fix, with the slow part of its errors."""
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
