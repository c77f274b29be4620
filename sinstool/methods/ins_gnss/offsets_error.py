"""Errors of a solution that its filter has no states for.

They come from a wrong latency, a wrong lever arm, or samples of another time; and, without states
for them, from slow errors of the fixes.

A filter follows its fixes: with a wrong latency the whole solution is early or late, and with a
wrong lever arm it lies beside the track. Innovations hardly show either, and there are no states
for them. The same holds for the samples of the IMU: each may be a mean until its stamp or a rate at
it, and the two motions are half a sample apart.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray, IntArray
from sinstool.core.parts import kernel, part
from sinstool.core.quaternion_kernels import dcm, row
from sinstool.core.streams import Solution
from sinstool.core.timeline import SECOND
from sinstool.core.units import STANDARD_GRAVITY

# Fixes hold a solution to their own time and place over this time, s; faster motion is that of the
# IMU.
HELD_NS = SECOND


class OffsetsError:
    """Adds errors without states to the covariances of solutions that stream by.

    With ``b`` the true latency and arm less those used, position is off by ``J b``, where ``J =
    [-v_n, C_nb]``, and velocity by the change of that. In an outage the error stays what it was at
    its start, which is small compared with what grows meanwhile.

    Parameters
    ----------
    moment : array_like, shape (4, 4)
        Expected ``b b^T``, of s and m (FRD); where it is 0 nothing is added.
    turned : array_like, shape (3, 4, 4), optional
        Mean products of the attitude errors about each axis, NED, by each part of b, rad; see
        :class:`~sinstool.methods.ins_gnss.receiver_offsets.ReceiverOffsets`.
    sample_s : float, optional
        Time, s, by which the samples of the IMU may be off, with even odds.
    shared : bool, optional
        Whether the latency was estimated against these samples: then position is off too.
    slow_m : array_like, shape (3,), optional
        Slow errors of positions of the fixes, NED, m, if the filter has no states for them.

    Attributes
    ----------
    largest_m : float
        Largest sigma of position added for the latency alone, m.
    heading_added : float
        Sigma of heading added for latency and arm, rad.
    """

    def __init__(
        self,
        moment: ArrayLike,
        turned: ArrayLike | None = None,
        sample_s: float = 0.0,
        shared: bool = False,
        slow_m: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        self._moment = np.array(moment, dtype=np.float64)
        self.largest_m = 0.0
        self._attitude = np.zeros((3, 3))
        if turned is not None:
            self._attitude = np.diag(np.einsum("iab,ab->i", np.asarray(turned), self._moment))
        self.heading_added = float(np.sqrt(self._attitude[2, 2]))
        self._heading_square, self._count = 0.0, 0
        self._latency_s = float(np.sqrt(self._moment[0, 0]))
        self._other_time = 0.5 * sample_s**2
        self._squares = np.full((2, 3, 3), np.nan)
        self._slow = np.diag(np.square(np.asarray(slow_m, dtype=np.float64)))
        if shared:
            self._moment[0, 0] += self._other_time
        self._time_ns = np.empty(0, np.int64)
        self._shift = np.empty((0, 3, 4))

    @property
    def heading_before(self) -> float:
        """Root mean square of the sigmas of heading that solutions had before, rad."""
        return float(np.sqrt(self._heading_square / max(self._count, 1)))

    def added(self, solution: Solution) -> Solution:
        """The next solutions, in the order of time, with these errors in their covariances."""
        if self._slow.any() and solution.covariance_position_n is not None:
            whole = solution.covariance_position_n + self._slow
            solution = replace(solution, covariance_position_n=whole)
        position, velocity = solution.covariance_position_n, solution.covariance_velocity_n
        attitude, v = solution.covariance_attitude_n, solution.velocity_n
        moved = bool(self._moment.any()) and v is not None
        if not len(solution) or attitude is None or not (moved or self._other_time):
            return solution
        self._heading_square += float(attitude[:, 2, 2].sum())
        self._count += len(solution)
        attitude = attitude + self._attitude if moved else attitude.copy()
        velocity = None if velocity is None else velocity.copy()
        if self._other_time:
            _add_other_time(
                self._other_time,
                solution.q_nb,
                solution.omega_ib_b,
                solution.specific_force_b,
                self._squares,
                attitude,
                np.empty((0, 3, 3)) if velocity is None else velocity,
            )
        solution = replace(solution, covariance_attitude_n=attitude, covariance_velocity_n=velocity)
        if not moved:
            return solution
        assert position is not None and velocity is not None and v is not None
        kept = len(self._time_ns)
        time = np.concatenate([self._time_ns, solution.time_ns])
        shift = np.concatenate([self._shift, np.empty((len(solution), 3, 4))])
        position = position.copy()
        _shifts(v, solution.q_nb, shift[kept:])
        change = np.empty((3, 4))
        _add(time, shift, kept, HELD_NS, self._moment, change, position, velocity)
        speed = np.linalg.norm(v, axis=1).max()
        self.largest_m = max(self.largest_m, float(self._latency_s * speed))
        latest = slice(max(int(np.searchsorted(time, time[-1] - HELD_NS)) - 1, 0), None)
        self._time_ns, self._shift = time[latest], shift[latest].copy()
        return replace(solution, covariance_position_n=position)


@kernel()
def _add_other_time(
    square: float,
    q: FloatArray,
    rate: FloatArray,
    force: FloatArray,
    squares: FloatArray,
    attitude: FloatArray,
    velocity: FloatArray,
) -> None:
    """Add the errors by samples of another time, of this mean square, s^2, to covariances.

    It counts how it moves in the latest samples: what shakes may stand still at one of them.

    Parameters
    ----------
    q, rate, force : ndarray, shape (n, 4), (n, 3) and (n, 3)
        Attitudes, and the rates and specific forces that the IMU measures.
    squares : ndarray, shape (2, 3, 3)
        Mean squares of rate and acceleration of the latest samples, each of which counts half as
        much as the next, NED; NaN without one. Changed.
    attitude, velocity : ndarray, shape (n, 3, 3)
        Changed; a velocity without rows is not.
    """
    for i in range(len(q)):
        c = dcm(q[i, 0], q[i, 1], q[i, 2], q[i, 3])
        _add_squares(c, row(rate, i), 0.0, square, squares[0], attitude[i])
        if len(velocity) > 0:
            _add_squares(c, row(force, i), STANDARD_GRAVITY, square, squares[1], velocity[i])


@part()
def _add_squares(
    c: tuple[float, ...],
    v: tuple[float, ...],
    down: float,
    factor: float,
    squares: FloatArray,
    out: FloatArray,
) -> None:
    """Add to `out` a factor times mean squares, with that of `v` turned by `c`, plus `down`."""
    x, y, z = v
    north = c[0] * x + c[1] * y + c[2] * z
    east = c[3] * x + c[4] * y + c[5] * z
    turned = north, east, c[6] * x + c[7] * y + c[8] * z + down
    first = np.isnan(squares[0, 0])
    for i, a in enumerate(turned):
        for j, b in enumerate(turned):
            squares[i, j] = a * b if first else 0.5 * (squares[i, j] + a * b)
            out[i, j] += factor * squares[i, j]


@kernel()
def _shifts(v: FloatArray, q: FloatArray, out: FloatArray) -> None:
    """J of velocities and attitudes, shape (n, 3) and (n, 4)."""
    for i in range(len(v)):
        j = out[i]
        j[0, 0], j[1, 0], j[2, 0] = -v[i, 0], -v[i, 1], -v[i, 2]
        (
            j[0, 1],
            j[0, 2],
            j[0, 3],
            j[1, 1],
            j[1, 2],
            j[1, 3],
            j[2, 1],
            j[2, 2],
            j[2, 3],
        ) = dcm(q[i, 0], q[i, 1], q[i, 2], q[i, 3])


@kernel()
def _add(
    time_ns: IntArray,
    shift: FloatArray,
    first: int,
    held_ns: int,
    moment: FloatArray,
    change: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
) -> None:
    """Add ``J moment J^T`` to covariances of position, and that of J's change to velocity's.

    Parameters
    ----------
    time_ns : ndarray of int64, shape (m,)
        Of J, in order; the first of them are needed for those `held_ns` later.
    shift : ndarray, shape (m, 3, 4)
        J.
    first : int
        The first of the times that are those of the covariances.
    held_ns : int
        Time over which J changes.
    moment : ndarray, shape (4, 4)
    change : ndarray, shape (3, 4)
        Room to work in.
    position, velocity : ndarray, shape (m - first, 3, 3)
        Changed.
    """
    scale = 1e9 / held_ns
    k = 0
    for i in range(first, len(time_ns)):
        # Interpolated between the times; before the first of them J is that of the first
        when = time_ns[i] - held_ns
        while k + 1 < len(time_ns) and time_ns[k + 1] <= when:
            k += 1
        share = 0.0
        if when > time_ns[k]:
            share = (when - time_ns[k]) / (time_ns[k + 1] - time_ns[k])
        following = min(k + 1, len(time_ns) - 1)
        for a in range(3):
            for b in range(4):
                before = shift[k, a, b] + share * (shift[following, a, b] - shift[k, a, b])
                change[a, b] = scale * (shift[i, a, b] - before)
        _add_congruent(shift[i], moment, position[i - first])
        _add_congruent(change, moment, velocity[i - first])


@part()
def _add_congruent(a: FloatArray, moment: FloatArray, out: FloatArray) -> None:
    for i in range(3):
        for j in range(i + 1):
            total = 0.0
            for k in range(4):
                one = 0.0
                for p in range(4):
                    one += a[i, p] * moment[p, k]
                total += one * a[j, k]
            out[i, j] += total
            if j < i:
                out[j, i] += total
