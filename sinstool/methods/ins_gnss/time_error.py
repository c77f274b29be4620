"""Error of a solution whose fixes are used a little too early or too late.

A filter that is told when fixes were valid follows them wherever they are: where that time is
wrong the whole solution is early or late. No innovation shows it, and no state stands for it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.core.streams import Solution
from sinstool.core.timeline import SECOND

# Fixes hold a solution to their own time over so long: what shakes faster the Imu times rightly.
HELD_NS = SECOND


class TimeError:
    """Adds to covariances what comes of an uncertain time, while solutions stream by.

    Position is off by velocity times the error of the time, velocity by acceleration times it. An
    outage of fixes keeps the error that it began with, which is small beside what grows in it.

    Parameters
    ----------
    sigma_s : float
        Of the time at which fixes are valid; 0: nothing is added.

    Attributes
    ----------
    largest_m : float
        What has been added most to the sigma of a position.
    """

    def __init__(self, sigma_s: float) -> None:
        self._sigma_s = sigma_s
        self.largest_m = 0.0
        self._time_ns = np.empty(0, np.int64)
        self._velocity_n = np.empty((0, 3))

    def added(self, solution: Solution) -> Solution:
        """The next solutions, in the order of time, with covariances that admit the error."""
        position, velocity = solution.covariance_position_n, solution.covariance_velocity_n
        v = solution.velocity_n
        if self._sigma_s == 0.0 or not len(solution) or v is None:
            return solution
        assert position is not None and velocity is not None
        time = np.concatenate([self._time_ns, solution.time_ns])
        known = np.concatenate([self._velocity_n, v])
        at, before = time - solution.time_ns[0], solution.time_ns - solution.time_ns[0] - HELD_NS
        earlier = np.stack([np.interp(before, at, axis) for axis in known.T], axis=1)
        acceleration = (v - earlier) / (HELD_NS / SECOND)
        self.largest_m = max(self.largest_m, self._sigma_s * float(np.linalg.norm(v, axis=1).max()))
        kept = slice(max(int(np.searchsorted(time, time[-1] - HELD_NS)) - 1, 0), None)
        self._time_ns, self._velocity_n = time[kept], known[kept]
        return replace(
            solution,
            covariance_position_n=position + self._square(v),
            covariance_velocity_n=velocity + self._square(acceleration),
        )

    def _square(self, rate: np.ndarray) -> np.ndarray:
        off = self._sigma_s * rate
        return np.asarray(off[:, :, None] * off[:, None, :])
