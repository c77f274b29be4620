"""Error of a solution whose fixes are used at wrong times, or of an antenna that is elsewhere.

A filter follows its fixes: where the latency is wrong the whole solution is early or late, and
where the lever arm is, it lies beside the track. Innovations hardly show either, and no state
stands for them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray
from sinstool.core.congruence import congruent
from sinstool.core.rotation import to_dcm
from sinstool.core.streams import Solution
from sinstool.core.timeline import SECOND

# Fixes hold a solution to their own time and place over so long: what shakes faster the Imu shows
# rightly.
HELD_NS = SECOND


class OffsetsError:
    """Adds to covariances what comes of a wrong latency and lever arm, while solutions stream by.

    With ``b`` the true latency and arm less those used, position is off by ``J b``, where
    ``J = [-v_n, C_nb]``, and velocity by what that changes by. An outage of fixes keeps the error
    that it began with, which is small beside what grows in it.

    Parameters
    ----------
    moment : array_like, shape (4, 4)
        Expected ``b b^T``, of s and m (FRD); where it is 0 nothing is added.
    turned : array_like, shape (3, 4, 4), optional
        Mean products of what each axis of attitude, NED, is off by for each part of b, rad; see
        :class:`~sinstool.methods.ins_gnss.receiver_offsets.ReceiverOffsets`.

    Attributes
    ----------
    largest_m : float
        What has been added most to the sigma of a position for the latency alone.
    """

    def __init__(self, moment: ArrayLike, turned: ArrayLike | None = None) -> None:
        self._moment = np.asarray(moment, dtype=np.float64)
        self.largest_m = 0.0
        self._attitude = np.zeros((3, 3))
        if turned is not None:
            self._attitude = np.diag(np.einsum("iab,ab->i", np.asarray(turned), self._moment))
        self._time_ns = np.empty(0, np.int64)
        self._shift = np.empty((0, 3, 4))

    def added(self, solution: Solution) -> Solution:
        """The next solutions, in the order of time, with covariances that admit the error."""
        position, velocity = solution.covariance_position_n, solution.covariance_velocity_n
        attitude, v = solution.covariance_attitude_n, solution.velocity_n
        if not self._moment.any() or not len(solution) or v is None:
            return solution
        assert position is not None and velocity is not None and attitude is not None
        now = np.concatenate([-v[:, :, None], to_dcm(solution.q_nb)], axis=2)
        time = np.concatenate([self._time_ns, solution.time_ns])
        shift = np.concatenate([self._shift, now])
        before = self._at(solution.time_ns - HELD_NS, time, shift)
        speed = np.linalg.norm(v, axis=1).max()
        self.largest_m = max(self.largest_m, float(np.sqrt(self._moment[0, 0]) * speed))
        latest = slice(max(int(np.searchsorted(time, time[-1] - HELD_NS)) - 1, 0), None)
        self._time_ns, self._shift = time[latest], shift[latest]
        return replace(
            solution,
            covariance_position_n=position + congruent(now, self._moment),
            covariance_velocity_n=velocity
            + congruent((now - before) / (HELD_NS / SECOND), self._moment),
            covariance_attitude_n=attitude + self._attitude,
        )

    def _at(self, when: np.ndarray, time: np.ndarray, shift: FloatArray) -> FloatArray:
        """Shifts at other times, between those there are."""
        since = (time - time[0]).astype(np.float64)
        columns = shift.reshape(len(shift), -1).T
        when_ns = (when - time[0]).astype(np.float64)
        between = np.stack([np.interp(when_ns, since, column) for column in columns], axis=1)
        return between.reshape(-1, 3, 4)
