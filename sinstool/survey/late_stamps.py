"""Whether stamps are late, or right: what rates and intervals say of even times of samples."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.order_statistics import median, quantile
from sinstool.core.streams import Imu
from sinstool.core.timeline import GAP_INTERVALS, SECOND

# Usual intervals beyond which samples may be missing; an interval counts as at most so many.
MISSED, LONGEST = 1.5, 10.0
# Intervals are multiples of the usual one if this share of them are, to within so much of it.
# Stamps at ticks differ from even times by 0.29 of a tick, rms, and by more where some are lost.
# The usual one is that of the shortest, of this share, unless they are too short for their median.
ON_GRID, GRID, TICK, SHARE, SHORT = 0.98, 0.1, 0.6, 0.1, 0.2
# Samples come in batches if their median interval is shorter than this part of the mean. It is half
# of it at least where any share is lost by chance.
BATCHES = 0.45
# A regression on the stamps gives 0 for even samples and 1 if the stamps are right: the limit
# between both, and the sigmas from 0 beyond which it counts.
HALF_WAY, BELIEVED = 0.5, 4.0
# Variance of a sixth difference of white noise, over that of the noise.
SIXTH = 924.0


@dataclass(frozen=True)
class Late:
    """Samples at their stamps, and the even times that they may be of.

    Attributes
    ----------
    imu : Imu
    even_ns : ndarray, shape (n,)
        Even time of each sample.
    usual_ns : float
        From one even time to the next.
    """

    imu: Imu
    even_ns: IntArray
    usual_ns: float

    @cached_property
    def late_s(self) -> FloatArray:
        """Stamps less even times, s, shape (n,)."""
        return np.asarray((self.imu.time_ns - self.even_ns) / SECOND)

    @property
    def lack_samples(self) -> bool:
        """Whether intervals are long as samples are missing, not as samples are late.

        They are whole multiples of the usual one then, but they are so too where a bus collects
        samples at its ticks. There each waits for the next tick; what is further off is not late.
        """
        steps = np.diff(self.imu.time_ns).astype(np.float64)
        usual = float(median(steps))
        if usual < BATCHES * steps.mean():
            return False
        # Where more than half of the samples are missing, most intervals are several usual ones
        shortest = quantile(steps, SHARE)
        if shortest > SHORT * usual:
            # Those that arrive together are no intervals of a sensor
            apart = steps[steps > SHORT * usual]
            usual = float(median(apart[apart <= MISSED * shortest]))
        off = np.abs(steps - usual * np.maximum(np.rint(steps / usual), 1.0))
        if quantile(off, ON_GRID) > GRID * usual:
            return False
        late = np.minimum(np.abs(self.imu.time_ns - self.even_ns), LONGEST * usual)
        return float(np.mean(late**2)) > (TICK * usual) ** 2

    def follow_stamps(self, increments: bool) -> bool:
        """Whether the rates follow the stamps: by their change where intervals vary.

        Parameters
        ----------
        increments : bool
            Samples are increments, not rates.
        """
        gyro, late = self.imu.gyro, self.late_s
        interval = self.usual_ns / SECOND
        kept = slice(3, len(gyro) - 3)
        between = _between(late[:, None])[kept]
        residual = _between(gyro)[kept]
        if increments:
            # An increment is as long as its own interval
            mean = np.cumsum(gyro, axis=0)
            rate = (mean[6:] - mean[:-6]) / (6.0 * interval)
            expected = rate * _between(np.diff(late, prepend=late[0])[:, None])[kept]
        else:
            slope = (gyro[6:] - gyro[:-6]) / (6.0 * interval)
            expected = slope * between
        # Across a gap neither rates nor times belong together
        gaps = np.diff(self.even_ns) > GAP_INTERVALS * self.usual_ns
        whole = np.convolve(gaps, np.ones(6))[5:-5] < 1
        residual, expected = residual[whole], expected[whole]
        factor, sigma = right_stamps(residual, expected)
        return factor > HALF_WAY and factor > BELIEVED * sigma

    def matter(self, increments: bool) -> bool:
        """Whether late stamps turn a sample by more than the noise of the gyros does.

        Delays do not add up, so what is left of them is the change of the rate in the meantime. Of
        smooth motion sixth differences show only the noise; what shakes counts as noise here.

        Parameters
        ----------
        increments : bool
            Samples are increments, not rates.
        """
        interval = self.usual_ns / SECOND
        rate = self.imu.gyro / interval if increments else self.imu.gyro
        change = float(np.mean(np.square(np.diff(rate, axis=0))))
        noise = float(np.mean(np.square(np.diff(rate, 6, axis=0)))) / SIXTH
        return float(np.std(self.late_s)) ** 2 * change > interval**2 * noise


def right_stamps(residual: FloatArray, expected: FloatArray) -> tuple[float, float]:
    """How right stamps are, from 0, where even times are, to 1, and the sigma of that.

    By a regression whose sigma allows for residuals of any size (White 1980).

    Parameters
    ----------
    residual : ndarray
        Values less those that their neighbours give at even times.
    expected : ndarray
        The same if the stamps are right.

    Returns
    -------
    factor, sigma : float
        0 and infinity where nothing is expected.
    """
    square = float(np.sum(expected**2))
    if not square:
        return 0.0, np.inf
    factor = float(np.sum(residual * expected)) / square
    sigma = float(np.sqrt(np.sum((residual - factor * expected) ** 2 * expected**2))) / square
    return factor, sigma


def _between(values: FloatArray) -> FloatArray:
    """Each value less the mean of its neighbours; zero at both ends."""
    out = np.zeros_like(values)
    out[1:-1] = values[1:-1] - 0.5 * (values[2:] + values[:-2])
    return out
