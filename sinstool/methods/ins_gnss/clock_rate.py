"""A receiver's clock that runs faster or slower than the Imu's: a latency that changes steadily.

Each has a crystal of its own where none is set by the other, and two crystals differ by some
20 ppm: 72 ms in an hour, which is a metre at 15 m/s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sinstool.core.streams import GnssEpochs
from sinstool.methods.ins_gnss.offset_scores import OffsetScores

USUAL_RATE = 2e-5
"""Rates of crystals, 1 sigma."""

# What the scores are estimated beside: see `receiver_offsets`.
_LATENCY_S, _ARM_M = 0.2, 2.0
# A rate counts that is so many of its sigmas and changes the latency by so many seconds. One of
# fewer may be part of a larger one, as a filter takes most of it for errors of its sensors.
_SHOWN, _HINTED, _LEAST_S = 5.0, 2.0, 0.01


@dataclass(frozen=True)
class ClockRate:
    """By how much a latency grows in each second.

    Attributes
    ----------
    rate, sigma : float
    middle_ns : int
        When the latency is the one that is spoken of.
    span_s : float
        For how long it was looked at.
    """

    rate: float
    sigma: float
    middle_ns: int
    span_s: float

    @property
    def shown(self) -> bool:
        """Whether the log shows that the clocks do not run together."""
        return self._is(_SHOWN)

    @property
    def hinted(self) -> bool:
        """Whether that is worth looking for."""
        return self._is(_HINTED)

    def _is(self, sigmas: float) -> bool:
        change = abs(self.rate) * self.span_s
        return abs(self.rate) > sigmas * self.sigma and change > _LEAST_S

    @property
    def spread_s(self) -> float:
        """How far off the latency is for the rate's own sigma, root mean square over the span."""
        return self.sigma * self.span_s / float(np.sqrt(12.0))

    def plus(self, other: ClockRate) -> ClockRate:
        """With what is left after stamps were put right by this one."""
        if self.rate == 0.0 or other.rate == 0.0:
            return self if other.rate == 0.0 else other
        return replace(other, rate=self.rate + other.rate, middle_ns=self.middle_ns)

    def latency_at(self, time_ns: int) -> float:
        """How much longer the latency is at a time than in the middle, s."""
        return self.rate * (time_ns - self.middle_ns) * 1e-9

    def put_right(self, gnss: GnssEpochs) -> GnssEpochs:
        """Fixes with the stamps of a clock that runs with the Imu's."""
        late = np.round(self.rate * (gnss.time_ns - self.middle_ns)).astype(np.int64)
        return replace(gnss, time_ns=gnss.time_ns - late)


STEADY = ClockRate(0.0, USUAL_RATE, 0, 0.0)
"""Clocks that run together, as far as anybody knows."""


def clock_rate(scores: OffsetScores) -> ClockRate:
    """By how much the latency changes meanwhile, estimated beside it and the lever arm.

    A filter's memory is short beside a log: the scores of an epoch are about the latency of then.

    Parameters
    ----------
    scores : OffsetScores
        At least one.
    """
    first_ns, last_ns = int(scores.time_ns[0]), int(scores.time_ns[-1])
    middle_ns = (first_ns + last_ns) // 2
    scores = scores.robust
    seconds = (scores.time_ns - middle_ns) * 1e-9
    # The latency of each epoch is that in the middle, and so many seconds times the rate
    design = np.zeros((len(scores), 4, 5))
    design[:, :, :4] = np.eye(4)
    design[:, 0, 4] = seconds
    score = np.einsum("kij,ki->kj", design, scores.score)
    each = np.einsum("kia,kij,kjb->kab", design, scores.information, design)
    information = each.sum(axis=0)
    prior = np.diag(1.0 / np.square([_LATENCY_S, _ARM_M, _ARM_M, _ARM_M, USUAL_RATE]))
    covariance = np.linalg.inv(information + prior)
    b = covariance @ score.sum(axis=0)
    spread = scores.scatter(score - each @ b)
    scattered = covariance @ (spread + prior) @ covariance
    sigma = float(np.sqrt(max(covariance[4, 4], scattered[4, 4])))
    return ClockRate(float(b[4]), sigma, middle_ns, (last_ns - first_ns) * 1e-9)
