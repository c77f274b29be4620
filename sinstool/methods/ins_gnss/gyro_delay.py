"""Gyros that are stamped later than the accelerometers beside them.

Drivers that pair two topics, and filters with a delay of their own, bring samples of different
times into one message. The attitude of late gyros is that of some time ago, and so specific forces
are resolved in axes that are turned by the rate times the delay [1]_. Velocities are then off by
the integral of that, which fixes show where the specific force does not turn with the body. In
flight without sideslip it does: there, the delay of the gyros is one of the whole IMU.

References
----------
.. [1] P. G. Savage, "Strapdown Analytics", 2nd ed., 2007, section 18.4.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sinstool.core.arrays import FloatArray, IntArray
from sinstool.core.rotation import to_dcm
from sinstool.methods.ins_gnss.results import UpdateColumns
from sinstool.methods.strapdown.velocity import Increments

GYRO_DELAY_S = 0.2
"""Standard deviation of a delay of gyros about 0, before the log shows it, s."""

LEAST_SIGMA_S = 1e-3
"""Least sigma of an estimated delay, s: rates between samples are not known better."""

_BEYOND = 5.0  # sigmas, and
_LEAST_S = 0.02  # s: a delay that is larger is no chance, and matters
# Means over so long before and after, s: what shakes faster than the delay averages out.
_SLOW_S = 0.1
_USUALLY = 95.0  # percentile over the fixes


@dataclass(frozen=True)
class GyroDelay:
    """Time by which gyros are stamped later than accelerometers.

    Attributes
    ----------
    delay_s, sigma_s : float
        Negative if they are stamped earlier.
    each_second : tuple of float
        Error of attitude that a delay of 1 s causes, which is exceeded at one fix of twenty: rad,
        and over the sigma of the filter.
    """

    delay_s: float
    sigma_s: float
    each_second: tuple[float, float]

    @classmethod
    def of(cls, delay_s: float, sigma_s: float, turns: FloatArray) -> GyroDelay:
        """From an estimate and the errors of attitude at each fix, (n, 2), by a delay of 1 s."""
        turn, sigmas = np.percentile(turns, _USUALLY, axis=0).tolist()
        return cls(delay_s, sigma_s, (turn, sigmas))

    @property
    def turn(self) -> float:
        """Error of attitude that it causes, which is exceeded at one fix of twenty, rad."""
        return abs(self.delay_s) * self.each_second[0]

    @property
    def sigmas(self) -> float:
        """The same over the sigma of the filter."""
        return abs(self.delay_s) * self.each_second[1]

    @property
    def denied(self) -> bool:
        """Whether the log shows that they are of the same time, to what matters."""
        return 2.0 * self.sigma_s < _LEAST_S and abs(self.delay_s) < 2.0 * self.sigma_s

    @property
    def shown(self) -> bool:
        """Whether the log shows that gyros and accelerometers are of different times."""
        return abs(self.delay_s) > max(_LEAST_S, _BEYOND * self.sigma_s)


def in_time(increments: Increments, delay_s: float) -> Increments:
    """Increments with the rotations that late gyros show so many seconds later.

    Beyond the ends of the increments nothing turns.
    """
    seconds = (increments.time_ns - increments.time_ns[0]) * 1e-9
    turned = np.cumsum(increments.rotation_vector, axis=0)
    times = np.concatenate([[-increments.interval[0]], seconds])
    turned = np.concatenate([np.zeros((1, 3)), turned])
    begins = _between(seconds - increments.interval + delay_s, times, turned)
    rate = increments.followed_rate
    return replace(
        increments,
        rotation_vector=_between(seconds + delay_s, times, turned) - begins,
        followed_rate=None if rate is None else _between(seconds + delay_s, seconds, rate),
    )


def by_late_gyros(
    updates: UpdateColumns, interval: FloatArray, fixes_ns: IntArray, rows_ns: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Errors of a navigation by gyros that are 1 s late, in as far as they are linear in it.

    Parameters
    ----------
    updates : UpdateColumns
        Of a block.
    interval : ndarray, shape (n,)
        Of each update, s.
    fixes_ns : ndarray of int64, shape (k,)
        When fixes are valid.
    rows_ns : ndarray of int64, shape (m,)
        Ends of the spans over which errors grow.

    Returns
    -------
    turned : ndarray, shape (k, 3)
        psi at each fix, NED, rad: the rate, as an error that does not grow.
    grown : ndarray, shape (m + 1, 6)
        Position and velocity errors, m and m/s, that come up in each span, from the block's
        beginning on, and in what is left behind the last one.
    """
    seconds = (updates.time_ns - updates.time_ns[0]) * 1e-9
    c_nb = to_dcm(updates.q_nb)
    step = interval[:, None]
    rate, force = (
        _slow(np.einsum("kij,kj->ki", c_nb, body) * step, step, seconds)
        for body in (updates.omega_ib_b, updates.specific_force_b)
    )
    # Sums from the beginning of the first update on
    velocity = np.cumsum(np.cross(force, rate) * step, axis=0)
    both = np.hstack([np.cumsum(velocity * step, axis=0), velocity])
    times = np.concatenate([[-interval[0]], seconds])
    both = np.concatenate([np.zeros((1, 6)), both])
    ends = (np.concatenate([rows_ns, updates.time_ns[-1:]]) - updates.time_ns[0]) * 1e-9
    at = _between(np.concatenate([times[:1], ends]), times, both)
    grown = np.diff(at, axis=0)
    # Each span begins with the velocity that came up before it, which is not its own
    grown[:, :3] -= at[:-1, 3:] * np.diff(ends, prepend=times[0])[:, None]
    return _between((fixes_ns - updates.time_ns[0]) * 1e-9, seconds, rate), grown


def _slow(turned: FloatArray, interval: FloatArray, seconds: FloatArray) -> FloatArray:
    """Means of increments, (n, 3), over a short time about each row."""
    first = np.searchsorted(seconds, seconds - _SLOW_S)
    last = np.searchsorted(seconds, seconds + _SLOW_S, side="right")
    sums = np.cumsum(np.hstack([turned, interval]), axis=0)
    sums = np.concatenate([np.zeros((1, 4)), sums])
    over = sums[last] - sums[first]
    return np.asarray(over[:, :3] / over[:, 3:])


def _between(when: FloatArray, seconds: FloatArray, columns: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(when, seconds, column) for column in columns.T])
