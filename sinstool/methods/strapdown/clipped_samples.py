"""What a sensor may have missed beyond the end of its range.

A sample at the end of the range of an axis says that the rate or the specific force was at least
that large. How much larger it was is not known: by shares of the range that are all as likely, as
where attitude is smoothed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.methods.sensor_errors import MISSED
from sinstool.methods.strapdown.velocity import Increments


class ClippedSamples:
    """Variances of increments by samples at the end of a range, over consecutive samples.

    Parameters
    ----------
    limits : ndarray, shape (6,)
        From these on, gyros and accelerometers are at the ends of their ranges, rad/s and m/s^2;
        infinite for axes that never are.
    sample_s : float
        Between samples, s.

    Notes
    -----
    What is missed of one turn has one sign: over n samples of duration T the increment is off by
    ``n T`` times the missed rate r. The k-th sample of a run therefore adds ``(2 k - 1) (r T)^2``,
    which makes ``(n r T)^2`` of all.
    """

    def __init__(self, limits: FloatArray, sample_s: float) -> None:
        self._limits = limits
        self._any = bool(np.isfinite(limits).any())
        missed = np.where(np.isfinite(limits), limits, 0.0) * sample_s
        self._variance = np.mean(np.square(MISSED)) * np.square(missed)
        self.begin()

    def begin(self) -> None:
        """Begin a new segment, at its sample 0."""
        self._run = np.zeros(6)
        self._first, self._before = 0, np.zeros(6)
        self._held = np.empty((0, 6))

    def push(self, gyro: FloatArray, accel: FloatArray) -> None:
        """Take the next samples of the segment, of shape (n, 3)."""
        if not self._any:
            return
        stopped = np.abs(np.hstack([gyro, accel])) >= self._limits
        number = np.arange(1.0, len(stopped) + 1.0)[:, None]
        free = np.maximum.accumulate(np.where(stopped, -self._run, number), axis=0)
        run = np.where(stopped, number - free, 0.0)
        if len(run):
            self._run = run[-1]
        added = np.where(stopped, (2.0 * run - 1.0) * self._variance, 0.0)
        last = self._held[-1] if len(self._held) else self._before
        self._held = np.concatenate([self._held, last + np.cumsum(added, axis=0)])

    def marked(self, increments: Increments) -> Increments:
        """Increments with these variances beside those of lost samples.

        Parameters
        ----------
        increments : Increments
            At least one, over the samples pushed, that follow those marked before.
        """
        if not self._any:
            return increments
        total = self._held[increments.sample - self._first]
        added = np.diff(total, axis=0, prepend=self._before[None])
        done = int(increments.sample[-1]) + 1 - self._first
        self._first, self._before, self._held = self._first + done, total[-1], self._held[done:]
        if not added.any():
            return increments
        lost = added if increments.lost is None else increments.lost + added
        return replace(increments, lost=lost)
