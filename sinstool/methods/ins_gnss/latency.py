"""Delay of velocity stamps, from the shift between two velocities.

Over some seconds a velocity that the IMU alone gives is off by a constant and a slope (tilt and
bias times gravity); both are fitted away in each window, and what is left depends on time
alone. It needs attitude to some degrees only, and one pass of any navigation.

Positions and velocities of one receiver need not be of one instant: see
:mod:`sinstool.methods.ins_gnss.fix_velocity`, which slides the ones along the other. Latency of
both against the IMU is found together with the lever arm, see
:mod:`sinstool.methods.ins_gnss.receiver_offsets`.

References
----------
.. [1] I. Skog, P. Händel, "Time synchronization errors in loosely coupled GPS-aided inertial
   navigation systems", IEEE Trans. Intelligent Transportation Systems 12(4), 2011, 1014-1023.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sinstool.core import earth
from sinstool.core.arrays import ArrayLike, FloatArray, IntArray
from sinstool.core.bounded_minimum import bounded_minimum
from sinstool.core.rotation import rotate

LatencyStatus = Literal["found", "at the limit", "not observable"]

WINDOW_S = 8.0
"""Windows of the correlation: long against the interval of fixes, short against the Schuler and
heading errors that a line does not follow."""

MAX_SIGMA_S = 0.05
"""A latency with a larger sigma counts as not observable, s."""

# -2 log L between the best latency and the worst of the range, below which it is noise: five sigma.
_CONTRAST = 25.0
_GRID_S = 0.025
_OUTLIER = 9.0
_MIN_FIXES = 5  # in a window; two of them go into the line


@dataclass(frozen=True)
class Latency:
    """A latency and its sigma.

    Attributes
    ----------
    latency_s : float
        A fix is valid this long before its stamp; 0 where it is not observable.
    sigma_s : float
        Standard deviation; infinite where it is not observable.
    status : {'found', 'at the limit', 'not observable'}
        ``at the limit`` where the best one lies at an end of the range searched.
    contrast : float, optional
        Squares that no latency at all leaves over those of this one, in units of the noise.
    """

    latency_s: float
    sigma_s: float
    status: LatencyStatus
    contrast: float = np.inf

    def differs_from(self, assumed_s: float, least_s: float, sigmas: float) -> bool:
        """Whether it is further from an assumed latency than `least_s`, and than its own noise.

        Parameters
        ----------
        assumed_s, least_s : float
            s.
        sigmas : float
            Of its own.
        """
        apart = abs(self.latency_s - assumed_s)
        return self.status != "not observable" and apart > max(least_s, sigmas * self.sigma_s)

    def __str__(self) -> str:
        if self.status == "not observable":
            return "latency of GNSS not observable: the motion changes too little"
        text = f"latency of GNSS {1e3 * self.latency_s:.0f} ms +- {1e3 * self.sigma_s:.1f} ms"
        return text + (" at the end of the range searched" if self.status != "found" else "")


NOT_OBSERVABLE = Latency(0.0, np.inf, "not observable")


def inertial_velocity(
    q_nb: ArrayLike,
    velocity_increment: ArrayLike,
    interval: ArrayLike,
    latitude: ArrayLike,
    height: ArrayLike,
    velocity_n: ArrayLike,
) -> FloatArray:
    """Velocity of the IMU alone: no correction ever steps in it.

    Parameters
    ----------
    q_nb : array_like, shape (n, 4)
        Attitude at the **start** of each update, of a filter or an alignment.
    velocity_increment : array_like, shape (n, 3)
        Integral of the specific force in the body axes of the start, biases removed as far as
        possible, m/s.
    interval : array_like, shape (n,)
        s.
    latitude, height : array_like, shape (n,)
        rad and m.
    velocity_n : array_like, shape (n, 3)
        For the Coriolis terms, m/s.

    Returns
    -------
    ndarray, shape (n, 3)
        At the end of each update, but for a constant; NED, m/s.
    """
    v = np.asarray(velocity_n, dtype=np.float64)
    rate = earth.transport_rate_n(latitude, height, v) + 2.0 * earth.earth_rate_n(latitude)
    pull = earth.gravity_n(latitude, height) - np.cross(rate, v)
    step = rotate(q_nb, velocity_increment) + pull * np.asarray(interval, dtype=np.float64)[:, None]
    return np.asarray(np.cumsum(step, axis=0))


def correlate(
    time_ns: ArrayLike,
    velocity_n: ArrayLike,
    fix_time_ns: ArrayLike,
    fix_velocity_n: ArrayLike,
    low_s: float = -0.6,
    high_s: float = 0.6,
) -> Latency:
    """Latency at which velocities of IMU and GNSS run alike.

    Parameters
    ----------
    time_ns : array_like of int64, shape (n,)
        Increasing.
    velocity_n : array_like, shape (n, 3)
        Of the IMU alone at these times; see :func:`inertial_velocity`. With the antenna far
        from the IMU, its velocity against it may be added.
    fix_time_ns : array_like of int64, shape (m,)
        Stamps of the fixes, increasing.
    fix_velocity_n : array_like, shape (m, 3)
        NED, m/s; rows or down parts that are NaN are not used.
    low_s, high_s : float, optional
        Range searched.

    Returns
    -------
    Latency
        Sigma is that of white velocity noise of the size found, times the root of 2 for what of
        it is not white.

    Raises
    ------
    ValueError
        If the range is empty or shapes do not fit.
    """
    times = np.asarray(time_ns, dtype=np.int64)
    inertial = np.asarray(velocity_n, dtype=np.float64)
    stamps = np.asarray(fix_time_ns, dtype=np.int64)
    measured = np.asarray(fix_velocity_n, dtype=np.float64)
    if not high_s > low_s:
        raise ValueError(f"Expected `low_s` below `high_s`, got {low_s}, {high_s}.")
    if inertial.shape != (len(times), 3) or measured.shape != (len(stamps), 3):
        raise ValueError("Expected velocities of shape (n, 3) and (m, 3) for their times.")
    windows = _Windows(times, inertial, stamps, measured, low_s, high_s)
    if windows.degrees <= 10:
        return NOT_OBSERVABLE
    count = int(np.ceil((high_s - low_s) / _GRID_S)) + 1
    grid = np.linspace(low_s, high_s, count)
    costs = np.array([windows.costs(tau) for tau in grid])
    # At least half of the windows remain: two, with 12 degrees of freedom, or all
    windows.leave_out_misfits(costs.min(axis=0))
    total = costs @ windows.weight
    best = int(np.argmin(total))
    left, right = grid[max(best - 1, 0)], grid[min(best + 1, count - 1)]
    tau, least = bounded_minimum(windows.cost, float(left), float(right), 1e-5)
    noise = least / windows.degrees
    h = 0.5 * _GRID_S
    bend = (windows.cost(tau - h) - 2.0 * least + windows.cost(tau + h)) / (h * h)
    if noise <= 0.0:  # simulated without any noise
        return Latency(tau, 0.0, "found")
    sigma = float(np.sqrt(2.0 * noise / bend) * np.sqrt(2.0)) if bend > 0.0 else np.inf
    contrast = (float(total.max()) - least) / noise
    if not sigma <= MAX_SIGMA_S or contrast < _CONTRAST:
        return NOT_OBSERVABLE
    none = (windows.cost(0.0) - least) / noise
    return Latency(tau, sigma, "at the limit" if best in (0, count - 1) else "found", none)


class _Windows:
    """Fixes in windows, and the squares that a latency leaves in each."""

    def __init__(
        self,
        times: IntArray,
        inertial: FloatArray,
        stamps: IntArray,
        measured: FloatArray,
        low_s: float,
        high_s: float,
    ) -> None:
        origin = int(times[0]) if len(times) else 0
        self._t = (times - origin) * 1e-9
        self._v = inertial
        t = (stamps - origin) * 1e-9
        good = np.isfinite(measured[:, :2]).all(axis=1)
        if len(times):
            good &= (t - high_s >= self._t[0]) & (t - low_s <= self._t[-1])
        t, z = t[good], measured[good].copy()
        self._down = np.isfinite(z[:, 2])
        z[~self._down, 2] = 0.0
        label = np.floor(t / WINDOW_S).astype(np.int64)
        _, window, number = np.unique(label, return_inverse=True, return_counts=True)
        enough = number >= _MIN_FIXES
        rows = enough[window]
        self._stamp, self._z, self._down = t[rows], z[rows], self._down[rows]
        _, self._window = np.unique(label[rows], return_inverse=True)
        self._count = int(self._window.max()) + 1 if len(self._window) else 0
        self.weight = np.ones(self._count)  # 0 for windows left out
        # Regressors of a line about the middle of each window
        self._level = np.ones((len(self._stamp), 3))
        self._level[:, 2] = self._down
        self._slope = self._detrended(self._level * self._stamp[:, None])
        self._slope2 = self._sum(self._slope**2)

    def leave_out_misfits(self, least: FloatArray) -> None:
        """Leave out windows that fit at no latency: outliers of GNSS, a jump of attitude.

        `least` is the least cost of each window over the latencies tried.
        """
        typical = np.median(least[self.weight > 0.0])
        self.weight = np.where(least <= _OUTLIER * typical, self.weight, 0.0)

    @property
    def degrees(self) -> float:
        """Degrees of freedom of the windows in use."""
        rows = self._sum(self._level)
        # One or two downs are on any line
        return float((np.maximum(rows - 2.0, 0.0).sum(axis=1) * self.weight).sum())

    def costs(self, tau: float) -> FloatArray:
        """Sum of squares in each window."""
        at = self._stamp - tau
        r = np.empty_like(self._z)
        for axis in range(3):
            r[:, axis] = self._z[:, axis] - np.interp(at, self._t, self._v[:, axis])
        r = self._without_trend(r)
        return np.asarray(self._sum(r * r).sum(axis=1))

    def _without_trend(self, values: FloatArray) -> FloatArray:
        """Less the line that fits best in each window."""
        r = self._detrended(values * self._level)
        with np.errstate(invalid="ignore", divide="ignore"):
            b = np.where(self._slope2 > 0.0, self._sum(self._slope * r) / self._slope2, 0.0)
        return np.asarray(r - b[self._window] * self._slope)

    def cost(self, tau: float) -> float:
        """Sum over the windows in use."""
        return float(self.costs(tau) @ self.weight)

    def _sum(self, values: FloatArray) -> FloatArray:
        return np.stack(
            [np.bincount(self._window, values[:, i], self._count) for i in range(3)], axis=1
        )

    def _detrended(self, values: FloatArray) -> FloatArray:
        mean = self._sum(values) / np.maximum(self._sum(self._level), 1.0)
        return (values - mean[self._window]) * self._level
