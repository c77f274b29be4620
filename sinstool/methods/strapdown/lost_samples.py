"""What may have happened in samples that were lost.

Where single samples are missing, rate and specific force are interpolated across. A vehicle on a
rough road does not keep to that: sampled at 25 Hz, a car may pitch by a quarter of a degree more or
less than its neighbouring samples let expect. How much that is shows where no sample is missing: in
the differences of samples from the mean of their neighbours.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.core.arrays import FloatArray
from sinstool.core.parts import kernel
from sinstool.core.timeline import LOST_INTERVALS
from sinstool.methods.strapdown.velocity import Increments

# An update that is longer than usual by this share of a sample's interval lacks one
_SHARE = LOST_INTERVALS - 1.0
# s, over which the squares of differences are averaged
MEAN_S = 1.0
# Of more lost samples in a row the motion is hardly less like those beside them
MOST = 3.0


class LostSamples:
    """Variances of increments by lost samples, over consecutive updates.

    Parameters
    ----------
    update_s, sample_s : float
        Usual durations of an update and between samples, s.

    Notes
    -----
    With mean rates w over updates of equal length, ``d[k] = w[k-1] - (w[k-2] + w[k]) / 2`` is what
    interpolation would have missed of ``w[k-1]``. Increments over an update in which n samples of
    duration T were lost get the variance ``(n T f)^2 mean(d^2)``, the mean being exponential over
    `MEAN_S`. Of a parabola the mean of n samples differs from those beside them by
    ``f = (n + 1) (n + 2) / 6`` times what one would; of motion without any pattern, and of more
    than `MOST` samples, it is less.
    """

    def __init__(self, update_s: float, sample_s: float) -> None:
        self._update_s, self._sample_s = update_s, sample_s
        # Of columns: mean rate of the update before the last, of the last, mean square; then how
        # many usual updates have followed each other
        self._state = np.zeros(19)

    def begin(self) -> None:
        """Begin a new segment: the next update does not follow the one before."""
        self._state[18] = 0.0

    def push(self, interval: FloatArray, turned: FloatArray, gained: FloatArray) -> FloatArray:
        """Variances of the next updates.

        Parameters
        ----------
        interval : ndarray, shape (n,)
            s.
        turned, gained : ndarray, shape (n, 3)
            Rotation vectors, rad, and velocity increments, m/s.

        Returns
        -------
        ndarray, shape (n, 6)
            Of both, in body axes, rad^2 and (m/s)^2; zero where no sample was lost.
        """
        out = np.zeros((len(interval), 6))
        _lost(
            np.ascontiguousarray(interval),
            np.ascontiguousarray(turned),
            np.ascontiguousarray(gained),
            self._update_s,
            self._sample_s,
            self._state,
            out,
        )
        return out

    def marked(self, increments: Increments) -> Increments:
        """Increments with these variances."""
        lost = self.push(
            increments.interval, increments.rotation_vector, increments.velocity_increment
        )
        return replace(increments, lost=lost)


@kernel()
def _lost(
    interval: FloatArray,
    turned: FloatArray,
    gained: FloatArray,
    update: float,
    sample: float,
    state: FloatArray,
    out: FloatArray,
) -> None:
    """Set the variances of updates with lost samples, in an array of zeros."""
    for k in range(len(interval)):
        dt = interval[k]
        more = dt - update
        if more > _SHARE * sample:
            n = min(max(more / sample, 1.0), MOST)
            off = more * (n + 1.0) * (n + 2.0) / 6.0
            for i in range(6):
                out[k, i] = off * off * state[12 + i]
            state[18] = 0.0
            continue
        if dt < update - _SHARE * sample:
            state[18] = 0.0
            continue
        share = dt / (dt + MEAN_S)
        for i in range(6):
            rate = (turned[k, i] if i < 3 else gained[k, i - 3]) / dt
            if state[18] >= 2.0:
                off = state[6 + i] - 0.5 * (state[i] + rate)
                state[12 + i] += share * (off * off - state[12 + i])
            state[i] = state[6 + i]
            state[6 + i] = rate
        state[18] += 1.0
