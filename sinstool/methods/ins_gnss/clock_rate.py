"""A receiver's clock that runs faster or slower than the IMU's: the latency changes steadily.

Unless one clock is set by the other, each runs by its own crystal, and two crystals differ by some
20 ppm: 72 ms in an hour, or a metre at 15 m/s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sinstool.core.streams import GnssEpochs
from sinstool.methods.ins_gnss.offset_scores import OffsetScores
from sinstool.methods.receiver_priors import ARM_UNKNOWN_M, LATENCY_S

USUAL_RATE = 2e-5
"""Difference in rate of two crystals, 1 sigma."""

# A rate is used if it exceeds this many of its sigmas and changes the latency by this many seconds.
# A less significant one is followed up: the filter takes most of a rate for errors of its sensors,
# so that only a part of it shows at first.
_SIGNIFICANT, _HINT, _LEAST_S = 5.0, 2.0, 0.01


@dataclass(frozen=True)
class ClockRate:
    """Rate of change of a latency.

    Attributes
    ----------
    rate, sigma : float
        Growth of the latency, s/s, and its standard deviation.
    middle_ns : int
        The time at which the latency is the constant one estimated beside the rate.
    span_s : float
        Length of the time over which the rate was estimated, s.
    """

    rate: float
    sigma: float
    middle_ns: int
    span_s: float

    @property
    def significant(self) -> bool:
        """Whether the log shows that one clock runs faster than the other."""
        return self._exceeds(_SIGNIFICANT)

    @property
    def worth_repeating(self) -> bool:
        """Whether the rate is large enough to be estimated again."""
        return self._exceeds(_HINT)

    def _exceeds(self, sigmas: float) -> bool:
        change = abs(self.rate) * self.span_s
        return abs(self.rate) > sigmas * self.sigma and change > _LEAST_S

    @property
    def spread_s(self) -> float:
        """Error of the latency that the rate's sigma causes, root mean square over the span, s."""
        return self.sigma * self.span_s / float(np.sqrt(12.0))

    def plus(self, other: ClockRate) -> ClockRate:
        """Sum of this rate and of one estimated after stamps were corrected by this one."""
        if self.rate == 0.0 or other.rate == 0.0:
            return self if other.rate == 0.0 else other
        return replace(other, rate=self.rate + other.rate, middle_ns=self.middle_ns)

    def latency_at(self, time_ns: int) -> float:
        """Latency at a time less that in the middle, s."""
        return self.rate * (time_ns - self.middle_ns) * 1e-9

    def corrected(self, gnss: GnssEpochs) -> GnssEpochs:
        """Fixes with stamps of a clock that runs at the rate of the IMU's."""
        late = np.round(self.rate * (gnss.time_ns - self.middle_ns)).astype(np.int64)
        return replace(gnss, time_ns=gnss.time_ns - late)


STEADY = ClockRate(0.0, USUAL_RATE, 0, 0.0)
"""Clocks of the same rate, as far as is known."""


def clock_rate(scores: OffsetScores) -> ClockRate:
    """Rate of change of the latency, estimated together with the latency and the lever arm.

    The memory of a filter is short compared with a log: the scores of an epoch depend on the
    latency at that time.

    Parameters
    ----------
    scores : OffsetScores
        Of one epoch or more.
    """
    first_ns, last_ns = int(scores.time_ns[0]), int(scores.time_ns[-1])
    middle_ns = (first_ns + last_ns) // 2
    scores = scores.robust
    seconds = (scores.time_ns - middle_ns) * 1e-9
    # The latency of each epoch is that in the middle plus the rate times the seconds since then
    design = np.zeros((len(scores), 4, 5))
    design[:, :, :4] = np.eye(4)
    design[:, 0, 4] = seconds
    score = np.einsum("kij,ki->kj", design, scores.score)
    each = np.einsum("kia,kij,kjb->kab", design, scores.information, design)
    information = each.sum(axis=0)
    prior = np.diag(1.0 / np.square([LATENCY_S, *[ARM_UNKNOWN_M] * 3, USUAL_RATE]))
    covariance = np.linalg.inv(information + prior)
    b = covariance @ score.sum(axis=0)
    spread = scores.scatter(score - each @ b)
    scattered = covariance @ (spread + prior) @ covariance
    sigma = float(np.sqrt(max(covariance[4, 4], scattered[4, 4])))
    return ClockRate(float(b[4]), sigma, middle_ns, (last_ns - first_ns) * 1e-9)
