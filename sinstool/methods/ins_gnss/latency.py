"""How late GNSS fixes are stamped, found from the data.

A fix is valid ``latency`` before its stamp on the clock of the IMU; where the IMU's stamps are
the late ones the latency is negative. Wrong by 0.1 s it costs metres and tenths of a degree of
heading, while the size of innovations barely tells.

Two ways, the second starting from the first:

* :func:`correlate` slides the velocity that the IMU alone gives along that of GNSS. Over some
  seconds the IMU's velocity is off by a constant and a slope (tilt and bias times gravity), so
  both are fitted away in each window, and what is left depends on time alone. It needs attitude
  to some degrees only, and one pass of any navigation.
* :func:`refine` takes the latency at which a filter finds its innovations most likely: the
  profile likelihood, ``-2 log L = sum(NIS + log det S)``, Mehra 1970. It uses positions too.

Positions and velocities of one receiver need not be of one instant: see
:mod:`sinstool.methods.ins_gnss.fix_velocity`.

References
----------
.. [1] R. K. Mehra, "On the identification of variances and adaptive Kalman filtering", IEEE
   Trans. Automatic Control 15(2), 1970, 175-184.
.. [2] I. Skog, P. Händel, "Time synchronization errors in loosely coupled GPS-aided inertial
   navigation systems", IEEE Trans. Intelligent Transportation Systems 12(4), 2011, 1014-1023.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize_scalar

from sinstool.core import earth
from sinstool.core.rotation import rotate

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LatencyStatus = Literal["found", "at the limit", "not observable"]

WINDOW_S = 8.0
"""Windows of the correlation: long against the interval of fixes, short against the Schuler and
heading errors that a line does not follow."""

MAX_SIGMA_S = 0.05
"""A latency that is not known to this is as good as not known."""

# -2 log L between the best latency and the worst of the range, below which it is noise: five sigma.
_CONTRAST = 25.0
_GRID_S = 0.025
_OUTLIER = 9.0
_ARM_PRIOR = 10.0  # m
_MIN_FIXES = 5  # in a window; two of them go into the line


@dataclass(frozen=True)
class Latency:
    """A latency, and how well it is known.

    Attributes
    ----------
    latency_s : float
        A fix is valid this long before its stamp; 0 where it is not observable.
    sigma_s : float
        Standard deviation; infinite where it is not observable.
    status : {'found', 'at the limit', 'not observable'}
        ``at the limit`` where the best one lies at an end of the range searched.
    arm_b, arm_sigma_b : ndarray or None, shape (3,)
        How much further on the antenna seems to be, FRD, and how well that is known, m; where
        :func:`correlate` looks for it. A part that no turn shows is 0, its sigma 10 m.
    """

    latency_s: float
    sigma_s: float
    status: LatencyStatus
    arm_b: FloatArray | None = None
    arm_sigma_b: FloatArray | None = None

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
    swing_n: ArrayLike | None = None,
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
    swing_n : array_like, shape (n, 3, 3), optional
        ``C_nb [omega x]``, by which an error of the lever arm shows in the velocity. The one
        that fits best is fitted too: in turns it looks like a latency.

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
    swing = None if swing_n is None else np.asarray(swing_n, dtype=np.float64)
    windows = _Windows(times, inertial, stamps, measured, low_s, high_s, swing)
    if windows.degrees <= 10:
        return NOT_OBSERVABLE
    count = int(np.ceil((high_s - low_s) / _GRID_S)) + 1
    grid = np.linspace(low_s, high_s, count)
    costs = np.array([windows.costs(tau) for tau in grid])
    windows.leave_out_misfits(costs.min(axis=0))
    if windows.degrees <= 10:
        return NOT_OBSERVABLE
    total = costs @ windows.weight
    best = int(np.argmin(total))
    left, right = grid[max(best - 1, 0)], grid[min(best + 1, count - 1)]
    minimum = minimize_scalar(
        windows.cost, bounds=(left, right), method="bounded", options={"xatol": 1e-5}
    )
    tau, least = float(minimum.x), float(minimum.fun)
    noise = least / windows.degrees
    h = 0.5 * _GRID_S
    bend = (windows.cost(tau - h) - 2.0 * least + windows.cost(tau + h)) / (h * h)
    if noise <= 0.0:  # simulated without any noise
        return Latency(tau, 0.0, "found", *windows.arm(tau, 1e-12))
    sigma = float(np.sqrt(2.0 * noise / bend) * np.sqrt(2.0)) if bend > 0.0 else np.inf
    contrast = (float(total.max()) - least) / noise
    judged = _judged(tau, sigma, contrast, best in (0, count - 1))
    arm, arm_sigma = windows.arm(tau, noise)
    return replace(judged, arm_b=arm, arm_sigma_b=arm_sigma)


def _judged(tau: float, sigma: float, contrast: float, at_limit: bool) -> Latency:
    if not sigma <= MAX_SIGMA_S or contrast < _CONTRAST:
        return NOT_OBSERVABLE
    return Latency(tau, sigma, "at the limit" if at_limit else "found")


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
        swing: FloatArray | None,
    ) -> None:
        self._swing = swing
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
        """Of freedom, of the windows in use."""
        rows = self._sum(self._level)
        return float(((rows - 2.0 * (rows > 2)).sum(axis=1) * self.weight).sum())

    def costs(self, tau: float) -> FloatArray:
        """Sum of squares in each window."""
        r, turned = self._rest(tau)
        if turned is not None:
            weight = self.weight[self._window]
            r = r - turned @ self._solved(r, turned, weight)[0]
        return np.asarray(self._sum(r * r).sum(axis=1))

    def arm(self, tau: float, noise: float) -> tuple[FloatArray | None, FloatArray | None]:
        """Lever arm that fits best, and its sigma."""
        r, turned = self._rest(tau)
        if turned is None:
            return None, None
        arm, normal = self._solved(r, turned, self.weight[self._window])
        prior = np.eye(3) / _ARM_PRIOR**2
        inverse = np.linalg.inv(normal / noise + prior)
        return inverse @ (normal / noise) @ arm, np.sqrt(2.0 * np.diag(inverse))

    def _solved(
        self, r: FloatArray, turned: FloatArray, weight: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        normal = np.einsum("k,kij,kil->jl", weight, turned, turned)
        right = np.einsum("k,kij,ki->j", weight, turned, r)
        small = 1e-9 * max(float(np.trace(normal)), 1e-12)
        return np.linalg.solve(normal + small * np.eye(3), right), normal

    def _rest(self, tau: float) -> tuple[FloatArray, FloatArray | None]:
        """What no line in a window explains: of the velocities, and of the swing."""
        at = self._stamp - tau
        r = np.empty_like(self._z)
        for axis in range(3):
            r[:, axis] = self._z[:, axis] - np.interp(at, self._t, self._v[:, axis])
        if self._swing is None:
            return self._bent(r), None
        turned = np.empty((len(at), 3, 3))
        for j in range(3):
            column = [np.interp(at, self._t, self._swing[:, i, j]) for i in range(3)]
            turned[:, :, j] = self._bent(np.column_stack(column))
        return self._bent(r), turned

    def _bent(self, values: FloatArray) -> FloatArray:
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


def refine(
    cost: Callable[[float], float],
    first_s: float = 0.0,
    span_s: float = 0.1,
    tolerance_s: float = 1e-3,
    scale: float = 1.0,
    most: int = 25,
) -> Latency:
    """Latency at which a filter finds its innovations most likely.

    Parameters
    ----------
    cost : callable
        Takes a latency, s, runs the filter with it over the same fixes each time, and returns
        ``sum(NIS + log det S)``, a rejected fix with the limit of the gate instead of its NIS;
        see :func:`likelihood_cost`.
    first_s : float, optional
        Where to begin, best that of :func:`correlate`.
    span_s : float, optional
        Half the first bracket. It moves on while the best is at its end, three times at most.
    tolerance_s : float, optional
        At which the golden section ends.
    scale : float, optional
        By which the cost overrates its curvature: mean NIS per degree of freedom, if above 1.
    most : int, optional
        Runs of the filter.

    Returns
    -------
    Latency

    Raises
    ------
    ValueError
        If a number makes no sense.
    """
    if not (span_s > 0.0 and tolerance_s > 0.0 and scale > 0.0):
        raise ValueError("Expected `span_s`, `tolerance_s` and `scale` to be positive.")
    costs: dict[float, float] = {}

    def at(tau: float) -> float:
        if tau not in costs:
            costs[tau] = float(cost(tau))
        return costs[tau]

    left, middle, right = first_s - span_s, first_s, first_s + span_s
    for _ in range(3):
        if at(middle) <= min(at(left), at(right)):
            break
        if at(left) < at(right):
            left, middle, right = left - (right - middle), left, middle
        else:
            left, middle, right = middle, right, right + (right - middle)
    bracketed = at(middle) <= min(at(left), at(right))
    contrast = (max(costs.values()) - min(costs.values())) / scale
    if bracketed:
        middle, bend = _golden(at, left, middle, right, tolerance_s, most - len(costs))
    else:
        middle = min(costs, key=costs.__getitem__)
        bend = (at(left) - 2.0 * at(0.5 * (left + right)) + at(right)) / (
            0.25 * (right - left) ** 2
        )
    sigma = float(np.sqrt(2.0 * scale / bend)) if bend > 0.0 else np.inf
    return _judged(middle, sigma, contrast, not bracketed)


def _golden(
    at: Callable[[float], float],
    left: float,
    middle: float,
    right: float,
    tolerance: float,
    most: int,
) -> tuple[float, float]:
    """Golden section, then the parabola through three points as wide as the noise allows.

    Gates make a cost step a little, so that the last points of the section are no ground for a
    curvature: the parabola is fitted to all points of the bracket.
    """
    share = 0.5 * (3.0 - np.sqrt(5.0))
    tried = {left: at(left), middle: at(middle), right: at(right)}
    for _ in range(max(most, 0)):
        if right - left <= 2.0 * tolerance:
            break
        new = (
            middle + share * (right - middle)
            if right - middle > middle - left
            else middle - share * (middle - left)
        )
        value = tried[new] = at(new)
        if value <= at(middle):
            left, right = (middle, right) if new > middle else (left, middle)
            middle = new
        elif new > middle:
            right = new
        else:
            left = new
    x = np.array(sorted(tried))
    y = np.array([tried[v] for v in x]) - tried[middle]
    near = np.argsort(np.abs(x - middle))[:7]
    width = float(np.abs(x[near] - middle).max())
    fit = np.polynomial.polynomial.polyfit((x[near] - middle) / width, y[near], 2)
    bend = 2.0 * float(fit[2]) / width**2
    return middle, bend


def likelihood_cost(
    nis: ArrayLike, log_det: ArrayLike, used: ArrayLike, gate: float = np.inf
) -> float:
    """What :func:`refine` minimises.

    Parameters
    ----------
    nis : array_like, shape (m,)
        Normalised innovations squared.
    log_det : array_like, shape (m,)
        Of their covariances.
    used : array_like of bool, shape (m,)
        Fixes that the filter took. The others count as at the gate.
    gate : float, optional
        Limit of the NIS; an infinite one counts the NIS as it is.

    Returns
    -------
    float
    """
    values = np.asarray(nis, dtype=np.float64)
    determinant = np.asarray(log_det, dtype=np.float64)
    if np.isfinite(gate):
        values = np.where(np.asarray(used, dtype=bool), np.minimum(values, gate), gate)
    finite = np.isfinite(values) & np.isfinite(determinant)
    return float(np.sum(values[finite] + determinant[finite]))
