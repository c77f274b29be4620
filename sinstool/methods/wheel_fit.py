"""Wheel speeds compared with a reference: their scale, their latency, their slip."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray, IntArray
from sinstool.core.order_statistics import SIGMA_PER_MAD

# Latencies that are tried, s, and over how much the slope of a reading is taken
EARLIEST_S, LATEST_S, STEP_S, SLOPE_S = -0.3, 1.0, 0.01, 0.05
ROUNDS, SIGMAS = 5, 4.0
# Of the fastest speeds, below which nothing is learnt of a scale; pairs that are needed
MOVING, LEAST = 0.1, 30
# Wheels that drive or brake slip by this share of their speed for each m/s^2 (1 sigma about 0), up
# to so many m/s^2. At any one speed a slip looks like a latency: 0.02 at 10 m/s like 0.2 s. Over
# how much an acceleration is taken, s
SLIP, GENTLE, SPAN_S = 0.02, 3.0, 1.0
# Readings are averaged over so many intervals, within limits, s: between two of them noise is less
# than at one, and the latency would be drawn there
INTERVALS, SHORTEST_S, LONGEST_S = 8.0, 0.2, 1.0
MARGIN_S = SLOPE_S + 0.5 * LONGEST_S
# Readings further apart than so many usual intervals leave a hole
HOLE = 3.0
# Residuals are alike over so long at most: a receiver wanders for a minute
ALIKE_S = 60.0
# No residual is smaller, of the fastest speeds: wheels are counted in steps
FINEST = 1e-3


@dataclass(frozen=True)
class WheelFit:
    """Scale and latency of wheel readings.

    Attributes
    ----------
    scale, scale_sigma : float
        Metres for each unit of a reading: a factor near 1, or the radius.
    latency_s, latency_sigma : float
        By which stamps are later than what they are of.
    residual_sigma : float
        Robust standard deviation of the reference less the readings so taken, m/s.
    samples : int
        Of the reference that were used.
    slip : float
        Share of the speed for each m/s^2 by which readings are too high as the vehicle is driven,
        and too low as it brakes, s^2/m.
    """

    scale: float
    scale_sigma: float
    latency_s: float
    latency_sigma: float
    residual_sigma: float
    samples: int
    slip: float = 0.0

    def rolled(self, t: FloatArray, at: FloatArray, reading: FloatArray) -> FloatArray:
        """Speed over ground at some times, m/s: scaled, without slip.

        Parameters
        ----------
        t : ndarray, shape (k,)
            s.
        at, reading : ndarray, shape (n,)
            When readings are valid, s, increasing; and what they are.
        """
        speed, behind, ahead = (
            self.scale * np.interp(t + d, at, reading) for d in (0.0, -0.5 * SPAN_S, 0.5 * SPAN_S)
        )
        changes = np.clip((ahead - behind) / SPAN_S, -GENTLE, GENTLE)
        return np.asarray(speed - self.slip * np.abs(speed) * changes)

    def with_prior(self, latency_sigma: float) -> WheelFit:
        """The same with a latency that is 0 to so many seconds (1 sigma) unless the speeds show it.

        Where speed hardly changes the fit's own latency may be any, and where it then does change,
        readings would be used at a wrong time.
        """
        share = latency_sigma**2 / (latency_sigma**2 + self.latency_sigma**2)
        return replace(
            self,
            latency_s=share * self.latency_s,
            latency_sigma=float(np.sqrt(share)) * self.latency_sigma,
        )


def fit_wheels(
    time_ns: IntArray, reading: FloatArray, reference_ns: IntArray, reference: FloatArray
) -> WheelFit | None:
    """Robust least squares of ``reference(t) = scale * reading(t + latency) - slip(t)``.

    The slip is in proportion to speed and acceleration, by a factor that is usually within `SLIP`.

    Parameters
    ----------
    time_ns : ndarray of int64, shape (n,)
        Stamps of the readings, increasing.
    reading : ndarray, shape (n,)
        Any unit.
    reference_ns : ndarray of int64, shape (m,)
        Increasing.
    reference : ndarray, shape (m,)
        m/s; forward is positive for both.

    Returns
    -------
    WheelFit or None
        None where too little motion is in both.
    """
    if len(time_ns) < 2 or not len(reference_ns):
        return None
    origin = int(time_ns[0])
    at: FloatArray = (time_ns - origin).astype(np.float64) * 1e-9
    t: FloatArray = (reference_ns - origin).astype(np.float64) * 1e-9
    fastest = float(np.quantile(np.abs(reference), 0.95))
    use = _covered(at, t) & (np.abs(reference) > MOVING * fastest)
    ahead, behind = (np.interp(t + d, t, reference) for d in (0.5 * SPAN_S, -0.5 * SPAN_S))
    gentle = use & (np.abs(ahead - behind) <= GENTLE * SPAN_S)
    use = gentle if gentle.sum() >= LEAST else use
    mean = _Mean(at, reading)
    changes = ((ahead - behind) / SPAN_S)[use]
    t, speed = t[use], reference[use]
    push = np.abs(speed) * changes
    if len(t) < LEAST or not mean(t).any():
        return None
    lags = np.arange(EARLIEST_S, LATEST_S + 0.5 * STEP_S, STEP_S)
    used = np.ones(len(t), np.bool_)
    scale, lag, slip, sigma = 0.0, 0.0, 0.0, FINEST * fastest
    for done in range(ROUNDS):
        some, prior = (mean, t[used], speed[used], push[used]), sigma / SLIP
        costs = [_cost(mean(t[used] + each), *some[2:], prior) for each in lags]
        scale, lag, slip = _refined(*some, prior, float(lags[np.argmin(costs)]))
        rest = speed - scale * mean(t + lag) + slip * push
        sigma = max(SIGMA_PER_MAD * float(np.median(np.abs(rest))), FINEST * fastest)
        before, used = used, np.abs(rest) <= SIGMAS * sigma
        if used.sum() < LEAST:
            return None
        # The first residuals say how noisy the next ones are
        if done and np.array_equal(before, used):
            break
    design = _design(mean, t[used], push[used], scale, lag)
    normal = design.T @ design
    # The slope of noisy readings is never 0. What it has in common with that of the reference,
    # whose noise is another, is the vehicle's: nothing of latency where speed never changes
    shared, mixed = float(design[:, 1] @ changes[used]), normal[1, [0, 2]]
    explained = mixed @ np.linalg.lstsq(normal[np.ix_([0, 2], [0, 2])], mixed, rcond=1e-12)[0]
    normal[1, 1] = max(shared, float(explained)) + 1e-12 * normal[0, 0]
    rest = rest[used]
    power = float(np.mean(rest**2))
    normal[2, 2] += power / SLIP**2
    inverse = np.linalg.inv(normal)[:2]
    by_slip = (power / SLIP * inverse[:, 2]) ** 2
    by_noise = np.maximum(power * np.diag(inverse) - by_slip, 0.0)
    own = [variance_inflation(t[used], column * rest) for column in design.T[:2]]
    scale_sigma, lag_sigma = np.sqrt(by_noise * own + by_slip).tolist()
    return WheelFit(
        scale,
        scale_sigma,
        lag,
        lag_sigma,
        sigma,
        int(used.sum()),
        slip,
    )


def slipping_wheels(
    time_ns: IntArray,
    speed: FloatArray,
    apart: FloatArray,
    yaw_ns: IntArray,
    yaw_rate: FloatArray,
) -> BoolArray:
    """Times at which the difference of an axle's two wheels contradicts the turn.

    Parameters
    ----------
    time_ns : ndarray of int64, shape (n,)
        At which the readings are valid.
    speed, apart : ndarray, shape (n,)
        Mean and difference of the wheels, in one unit.
    yaw_ns : ndarray of int64, shape (m,)
        Increasing.
    yaw_rate : ndarray, shape (m,)
        rad/s.

    Returns
    -------
    ndarray of bool, shape (n,)
        More than four robust sigmas of the difference, and one part in a hundred of the speed, off
        a multiple of the yaw rate. The multiple is the track over the unit of the readings.
    """
    origin = int(time_ns[0]) if len(time_ns) else 0
    turn = np.interp((time_ns - origin) * 1e-9, (yaw_ns - origin) * 1e-9, yaw_rate)
    within = (time_ns >= yaw_ns[0]) & (time_ns <= yaw_ns[-1])
    fastest = float(np.quantile(np.abs(speed), 0.95))
    moving = within & (np.abs(speed) > MOVING * fastest)
    if moving.sum() < LEAST or not turn[moving].any():
        return np.zeros(len(time_ns), np.bool_)
    rolling = moving
    rest, most = apart, np.full(len(apart), np.inf)
    for _ in range(ROUNDS):
        track = float(turn[rolling] @ apart[rolling] / (turn[rolling] @ turn[rolling]))
        rest = apart - track * turn
        sigma = SIGMA_PER_MAD * float(np.median(np.abs(rest[rolling])))
        most = SIGMAS * max(sigma, FINEST * fastest) + 0.01 * np.abs(speed)
        rolling = moving & (np.abs(rest) <= most)
        if not turn[rolling].any():
            break
    return np.asarray(within & (np.abs(rest) > most))


def _covered(at: FloatArray, t: FloatArray) -> BoolArray:
    """Times about which readings leave no hole, at any latency that is tried."""
    step = np.diff(at)
    holes = np.concatenate([[0], np.cumsum(step > HOLE * float(np.median(step)))])
    first = np.searchsorted(at, t + EARLIEST_S - MARGIN_S, "right") - 1
    last = np.searchsorted(at, t + LATEST_S + MARGIN_S, "left")
    inside = (first >= 0) & (last < len(at))
    return np.asarray(
        inside & (holes[np.minimum(last, len(at) - 1)] == holes[np.maximum(first, 0)])
    )


def _cost(turned: FloatArray, speed: FloatArray, push: FloatArray, prior: float) -> float:
    """Sum of squared residuals after fitting a scale and a slip."""
    design = np.stack([turned, -push], axis=1)
    normal, seen = design.T @ design, design.T @ speed
    normal[1, 1] += prior**2
    return float(speed @ speed - seen @ np.linalg.lstsq(normal, seen, rcond=1e-12)[0])


class _Mean:
    """Mean of readings about any time."""

    def __init__(self, at: FloatArray, reading: FloatArray) -> None:
        step = np.diff(at)
        self._at = at
        self._sum = np.concatenate([[0.0], np.cumsum(0.5 * (reading[1:] + reading[:-1]) * step)])
        self._half = 0.5 * float(np.clip(INTERVALS * np.median(step), SHORTEST_S, LONGEST_S))

    def __call__(self, t: FloatArray) -> FloatArray:
        ends = [np.interp(t + d, self._at, self._sum) for d in (self._half, -self._half)]
        return np.asarray((ends[0] - ends[1]) / (2.0 * self._half))


def _design(mean: _Mean, t: FloatArray, push: FloatArray, scale: float, lag: float) -> FloatArray:
    """Derivatives of the modelled speed by scale, latency and slip, shape (n, 3)."""
    slope = (mean(t + lag + SLOPE_S) - mean(t + lag - SLOPE_S)) / (2.0 * SLOPE_S)
    return np.stack([mean(t + lag), scale * slope, -push], axis=1)


def _refined(
    mean: _Mean, t: FloatArray, speed: FloatArray, push: FloatArray, prior: float, lag: float
) -> tuple[float, float, float]:
    """Scale, latency between those that are tried, slip: three steps of Gauss and Newton."""
    turned = mean(t + lag)
    scale, slip = float(speed @ turned / (turned @ turned)), 0.0
    about = lag
    for _ in range(3):
        rest = np.append(speed - scale * turned + slip * push, -prior * slip)
        design = np.vstack([_design(mean, t, push, scale, lag), [0.0, 0.0, prior]])
        step = np.linalg.lstsq(design, rest, rcond=1e-9)[0]
        scale, slip = scale + float(step[0]), slip + float(step[2])
        lag = float(np.clip(lag + step[1], about - STEP_S, about + STEP_S))
        turned = mean(t + lag)
    return scale, lag, slip


def variance_inflation(t: FloatArray, score: FloatArray) -> float:
    """Factor on a variance for the correlation in time of samples' contributions.

    The autocovariances up to the first that is not positive count.
    """
    step = float(np.median(np.diff(t)))
    power = float(np.mean(score**2))
    total = 1.0
    for k in range(1, min(int(ALIKE_S / step) + 1, len(score) // 2)):
        near = np.abs(t[k:] - t[:-k] - k * step) < 0.5 * step
        alike = float(np.mean((score[k:] * score[:-k])[near])) if near.any() else 0.0
        if not alike > 0.0:
            break
        total += 2.0 * alike / power
    return total
