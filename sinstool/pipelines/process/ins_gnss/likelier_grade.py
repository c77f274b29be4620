"""Another grade of an IMU than its noise shows, by innovations and by drift.

White noise says little of scale factors, misalignments and biases. As a vehicle turns and
accelerates these show in the innovations of a filter that models them; the errors of the sensors
without fixes show in their drift. All grades are compared with the same noise, that of the drift.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import get_args

import numpy as np

from sinstool.config import ProcessConfig
from sinstool.core.arrays import FloatArray
from sinstool.methods.coning.algorithm import ConingAlgorithm
from sinstool.methods.sensor_errors import (
    IMU_GRADES,
    LOW_COST,
    UNCALIBRATED_BY,
    Grade,
    SensorGrade,
    log_odds_uncalibrated,
    misaligned,
    partly_calibrated,
)
from sinstool.pipelines.align.in_motion import imu_noise
from sinstool.pipelines.process.ins_gnss.filter_settings import (
    as_in_motion,
    as_noisy_as,
    has_scales,
)
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.imu_drift import Drift
from sinstool.pipelines.process.ins_gnss.imu_fit import Fit, fit
from sinstool.pipelines.process.ins_gnss.noise_factors import NoiseFactors
from sinstool.survey.grade import ImuGrade
from sinstool.survey.rest import longest_rest
from sinstool.survey.source import Source

# A better grade is tried where the gyros' noise is below this share of the grade's, and taken where
# -2 log likelihood is smaller by LEAST_GAIN: odds of e^5 to 1.
QUIETER, LEAST_GAIN = 0.7, 10.0
# The shares of calibration error that are tried for low-cost IMUs: 0 is a calibrated module, which
# may be as good as an industrial one, and 1 a bare chip. The last is of axes three times as far
# off, as of gyros and accelerometers on a board of their own each.
SHARES = (0.0, 0.5, 1.0, 1.5)
# Another share is likelier with odds of e to 1 if its log likelihood is larger by this: what
# innovations do not have in common with a model changes their likelihood by tens of nat.
DOUBT = 2.0
# Least log odds by which a small bias at rest speaks for a calibration: drivers remove biases of
# IMUs that nobody has calibrated.
LEAST_LOG_ODDS = -1.0
# Factors on the misalignments of other IMUs that are tried, and the log odds of each step, before
# there are innovations. The axes of few IMUs lie several times worse than those of their grade.
TIMES, LOG_ODDS_TIMES = (1.0, 4.0, 16.0), -3.0
# A factor below this counts as 1: it changes sigmas by little, and doubt is part of every factor.
LEAST_TIMES = 1.6
# A share this close to 0 or 1 counts as that.
NEARLY = 0.1


class GradeFits:
    """Fits of a start with other sensors and the noise of its drift, each made once.

    Parameters
    ----------
    start : FilterStart
        Whose grade is judged.
    factors : NoiseFactors
        With which its sensors are as noisy as its drift shows.
    """

    def __init__(
        self,
        source: Source,
        config: ProcessConfig,
        algorithm: ConingAlgorithm,
        start: FilterStart,
        factors: NoiseFactors,
    ) -> None:
        self.source, self.config, self.start, self.factors = source, config, start, factors
        self._algorithm = algorithm
        self._made: dict[Grade | float | tuple[float, NoiseFactors], Fit | None] = {}

    def sensors(self, grade: Grade) -> SensorGrade:
        """Errors of the sensors of a grade."""
        return imu_noise(self.config, grade, has_scales(self.config))

    def of(self, grade: Grade) -> Fit | None:
        """Fit of sensors of a grade with the noise that the drift shows."""
        return self._fit(grade, self.sensors(grade))

    def uncalibrated_by(self, share: float) -> Fit | None:
        """Fit of low-cost sensors between a calibrated IMU, 0, and a bare chip, 1, or beyond."""
        if share in (0.0, 1.0):
            return self.of("consumer" if share else "mems")
        bare, calibrated = (self.sensors(grade) for grade in LOW_COST)
        return self._fit(share, partly_calibrated(calibrated, bare, share))

    def misaligned(self, times: float) -> Fit | None:
        """The better fit of the sensors with axes so many times as misaligned.

        With their own noise or that of the drift, which takes the errors of axes for noise.
        """
        sensors = misaligned(self.start.settings.imu, times)
        own = replace(self.factors, gyro=1.0, accel=1.0, scale=1.0)
        fits = [self._fit((times, noise), sensors, noise) for noise in {own, self.factors}]
        return min((one for one in fits if one is not None), key=lambda one: one.cost, default=None)

    def _fit(
        self,
        key: Grade | float | tuple[float, NoiseFactors],
        sensors: SensorGrade,
        factors: NoiseFactors | None = None,
    ) -> Fit | None:
        if key not in self._made:
            shown = self.start.by_the_fixes
            used = (factors or self.factors).of(shown.settings, virtual_noise=False)
            # With a state for each error: without them large errors are noise, and ever less likely
            imu = as_noisy_as(sensors, used.imu)
            used = replace(used, imu=imu, filter="network-29a")
            noisy = replace(shown, settings=used)
            self._made[key] = fit(self.source, self.config, self._algorithm, noisy)
        return self._made[key]


def likelier_calibration(fits: GradeFits) -> ImuGrade | None:
    """How well an IMU is calibrated, by its innovations; None where these say nothing of it."""
    if fits.config.navigation.imu_noise is not None:
        return None
    low_cost = fits.start.grade.grade in LOW_COST
    return likelier_low_cost(fits) if low_cost else likelier_axes(fits)


def likelier_axes(fits: GradeFits) -> ImuGrade | None:
    """How well the axes of an IMU with quiet gyros lie, by its innovations.

    Noise says nothing of that, and errors of axes are otherwise taken for noise of accelerometers,
    which averages out where a tilt by misaligned axes stays.

    Returns
    -------
    ImuGrade or None
        None where they lie as those of its grade do, or where there are too few fixes.
    """
    sensors = fits.start.settings.imu
    if fits.config.filter.sigma_misalignment is not None:
        return None
    made = [fits.misaligned(times) for times in TIMES]
    cost = np.array([np.nan if fit is None else fit.cost * fit.epochs for fit in made])
    if np.any(np.isnan(cost)):
        return None
    times = likeliest_times(cost)
    if times < LEAST_TIMES:
        return None
    angle = 1e3 * times * sensors.accel_misalignment
    why = f"its axes as well aligned as innovations show, to about {angle:.2g} mrad"
    return ImuGrade(fits.start.grade.grade, why, misaligned=times)


def likeliest_times(cost: FloatArray) -> float:
    """The root mean square of `TIMES`, weighted by their odds.

    Parameters
    ----------
    cost : ndarray, shape (3,)
        -2 log likelihood of each of them.
    """
    return _root_mean_square(np.array(TIMES), cost, LOG_ODDS_TIMES * np.arange(float(len(TIMES))))


def _root_mean_square(size: FloatArray, cost: FloatArray, log_odds: FloatArray) -> float:
    """Of sizes, weighted by their odds before there are innovations and by their likelihood."""
    log_weight = 0.5 * (cost.min() - cost) / DOUBT + log_odds
    weight = np.exp(log_weight - log_weight.max())
    return float(np.sqrt(weight @ np.square(size) / weight.sum()))


def likelier_low_cost(fits: GradeFits) -> ImuGrade | None:
    """How well a low-cost IMU is calibrated, by its innovations and its bias at rest.

    The noise of calibrated IMUs and of bare chips is the same, but scale factors and misalignments
    of bare chips are ten to fifty times as large. A level vehicle does not show them all, and those
    that it shows may be small by chance. So the same size is assumed of all: the mean square over
    the shares, weighted by their likelihood.

    Returns
    -------
    ImuGrade or None
        None where there are too few fixes.
    """
    made = [fits.uncalibrated_by(share) for share in SHARES]
    if any(fit is None for fit in made):
        return None
    cost = np.array([fit.cost * fit.epochs for fit in made if fit is not None])
    industrial = fits.of("industrial")
    if industrial is not None:
        cost[0] = min(cost[0], industrial.cost * industrial.epochs)
    rest = longest_rest(fits.source.survey.spans, fits.source.aiding.gnss)
    odds = 0.0 if rest is None else max(log_odds_uncalibrated(rest.gyro), LEAST_LOG_ODDS)
    share = uncalibrated_share(cost, odds)
    if share < NEARLY:
        return ImuGrade("mems", "as innovations are clearly likelier than as an uncalibrated one")
    if abs(share - 1.0) < NEARLY:
        return ImuGrade("consumer", "as innovations do not show that it is calibrated")
    angle = 1e3 * IMU_GRADES["mems"].gyro_misalignment * UNCALIBRATED_BY**share
    why = f"calibrated to about {angle:.2g} mrad, as far as innovations show"
    return ImuGrade("mems" if share < 0.5 else "consumer", why, uncalibrated=share)


def uncalibrated_share(cost: FloatArray, log_odds: float) -> float:
    """The share whose squared misalignment is the weighted mean of those of `SHARES`.

    Parameters
    ----------
    cost : ndarray, shape (4,)
        -2 log likelihood of each of them.
    log_odds : float
        Log of the odds, by all other evidence, that the IMU is a bare chip.
    """
    shares = np.array(SHARES)
    odds = log_odds * np.minimum(shares, 1.0) + LOG_ODDS_TIMES * (shares > 1.0)
    times = _root_mean_square(UNCALIBRATED_BY**shares, cost, odds)
    return float(np.log(times) / np.log(UNCALIBRATED_BY))


def better_grade(fits: GradeFits, drift: Drift) -> Grade | None:
    """A better grade that explains a drift clearly better than quieter sensors of this one do.

    An idling engine makes good sensors look poor at rest, and without a rest they are assumed to be
    poor. The assumption of quiet sensors of a poor grade keeps its scale factors, misalignments and
    biases. A grade is excluded if the innovations are clearly less likely with it.

    Parameters
    ----------
    fits : GradeFits
        Of a start whose grade, if low-cost, has been judged by innovations.
    drift : Drift
        Of the same start.
    """
    if fits.factors.gyro >= QUIETER or fits.config.navigation.imu_noise is not None:
        return None
    order: tuple[Grade, ...] = get_args(Grade)  # from the worst on
    judged = fits.start.grade.grade
    others = order[max(order.index(judged), order.index(LOW_COST[-1])) + 1 :]
    left = [grade for grade in others if not _refuted(fits.of(grade), fits.of(judged))]
    sensors = {grade: as_in_motion(fits.source, fits.sensors(grade)) for grade in left}
    return clearly_likelier(drift.gains(fits.factors, sensors))


def clearly_likelier(gains: Mapping[Grade, float]) -> Grade | None:
    """The worst grade than which no better one is clearly likelier; None: the present one.

    Parameters
    ----------
    gains : mapping of Grade to float
        -2 log likelihood of the present grade less theirs, from the worst on.
    """
    grades, gain = (None, *gains), [0.0, *gains.values()]
    return next(grade for k, grade in enumerate(grades) if max(gain[k:]) <= gain[k] + LEAST_GAIN)


def _refuted(other: Fit | None, judged: Fit | None) -> bool:
    return other is not None and judged is not None and other.worse_than(judged)
