"""Another grade of an Imu than its noise shows, by innovations and by drift.

White noise says little of scale factors, of misaligned axes and of biases. As a vehicle turns and
speeds up these show in the innovations of a filter that knows of them; what the sensors are worth
without fixes shows in their drift. All grades are compared with the same noise, that of the drift.
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
    partly_calibrated,
)
from sinstool.pipelines.align.in_motion import imu_noise
from sinstool.pipelines.process.ins_gnss.filter_settings import (
    as_in_motion,
    as_noisy_as,
    has_scales,
)
from sinstool.pipelines.process.ins_gnss.filter_start import FilterStart
from sinstool.pipelines.process.ins_gnss.imu_drift import Drift, NoiseFactors
from sinstool.pipelines.process.ins_gnss.imu_fit import Fit, fit
from sinstool.survey.grade import ImuGrade
from sinstool.survey.rest import longest_rest
from sinstool.survey.source import Source

# A better grade is tried where gyros are so many times as noisy as theirs, and taken where it is
# likelier by this: twice the log, e^5 to 1.
QUIETER, LEAST_GAIN = 0.7, 10.0
# As how far from calibrated low-cost Imus are tried; one that is, may be as good as an industrial.
SHARES = (0.0, 0.5, 1.0)
# By so many natural units another share must be likelier for odds of e to 1: what innovations do
# not have in common with a model moves their likelihood by tens of units.
DOUBT = 2.0
# Odds that a small bias at rest speaks for a calibration with, at most: e to 1. Drivers take biases
# off that nobody has calibrated.
LEAST_LOG_ODDS = -1.0
# A share that is as good as all or nothing.
NEARLY = 0.1


class GradeFits:
    """Fits of a start with sensors of other grades and the noise of its drift, each made once.

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
        self._made: dict[Grade | float, Fit | None] = {}

    def sensors(self, grade: Grade) -> SensorGrade:
        """Errors of the sensors of a grade."""
        return imu_noise(self.config, grade, has_scales(self.config))

    def of(self, grade: Grade) -> Fit | None:
        """Fit of sensors of a grade with the noise that the drift shows."""
        return self._fit(grade, self.sensors(grade))

    def uncalibrated_by(self, share: float) -> Fit | None:
        """The same of low-cost sensors between a calibrated Imu, 0, and a bare chip, 1."""
        if share in (0.0, 1.0):
            return self.of("consumer" if share else "mems")
        bare, calibrated = (self.sensors(grade) for grade in LOW_COST)
        return self._fit(share, partly_calibrated(calibrated, bare, share))

    def _fit(self, key: Grade | float, sensors: SensorGrade) -> Fit | None:
        if key not in self._made:
            shown = self.start.by_the_fixes
            used = self.factors.of(shown.settings, virtual_noise=False)
            # With a state for each error: without, large ones are noise, and ever less likely
            imu = as_noisy_as(sensors, used.imu)
            used = replace(used, imu=imu, filter="network-29a")
            noisy = replace(shown, settings=used)
            self._made[key] = fit(self.source, self.config, self._algorithm, noisy)
        return self._made[key]


def likelier_low_cost(fits: GradeFits) -> ImuGrade | None:
    """How well a low-cost Imu is calibrated, by its innovations and its bias at rest.

    The noise of calibrated Imus and of bare chips is the same, but scale factors and angles of
    these are ten to fifty times as large. A level vehicle does not show them all, and those that it
    shows may be small by chance. So what is assumed of all is the mean of their squares by how
    likely each share is.

    Returns
    -------
    ImuGrade or None
        None where the Imu is a better one, its noise was measured, or too few fixes show it.
    """
    if fits.start.grade.grade not in LOW_COST or fits.config.navigation.imu_noise is not None:
        return None
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
    if share > 1.0 - NEARLY:
        return ImuGrade("consumer", "as innovations do not show that it is calibrated")
    angle = 1e3 * IMU_GRADES["mems"].gyro_misalignment * UNCALIBRATED_BY**share
    why = f"calibrated to about {angle:.2g} mrad, as far as innovations show"
    return ImuGrade("mems" if share < 0.5 else "consumer", why, uncalibrated=share)


def uncalibrated_share(cost: FloatArray, log_odds: float) -> float:
    """The share whose squared angles are the mean of those of `SHARES`.

    Parameters
    ----------
    cost : ndarray, shape (3,)
        -2 log likelihood of each of them.
    log_odds : float
        Log of the odds, by all else that is known, that the Imu is a bare chip.
    """
    shares = np.array(SHARES)
    log_weight = 0.5 * (cost.min() - cost) / DOUBT + log_odds * shares
    weight = np.exp(log_weight - log_weight.max())
    square = float(weight @ UNCALIBRATED_BY ** (2.0 * shares)) / float(weight.sum())
    return float(np.log(square) / (2.0 * np.log(UNCALIBRATED_BY)))


def better_grade(fits: GradeFits, drift: Drift) -> Grade | None:
    """A better grade that explains a drift clearly better than quieter sensors of this one do.

    An idling engine makes good sensors look poor at rest, and without a rest they are taken for
    poor. Quiet sensors of a poor grade have its scale factors, angles and biases all the same.
    Innovations that are clearly less likely refute a grade.

    Parameters
    ----------
    fits : GradeFits
        Of a start whose grade, if it is of low cost, innovations have judged.
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
    """The worst grade that no better one is clearly likelier than; None: that which there is.

    Parameters
    ----------
    gains : mapping of Grade to float
        -2 log likelihood of the present grade less theirs, from the worst on.
    """
    best, least = None, LEAST_GAIN
    for grade, gain in gains.items():
        if gain > least:
            best, least = grade, gain + LEAST_GAIN
    return best


def _refuted(other: Fit | None, judged: Fit | None) -> bool:
    return other is not None and judged is not None and other.worse_than(judged)
