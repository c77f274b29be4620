"""Wheel speeds against a reference: their scale, their latency, and where one of them slips."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray, IntArray

# Latencies that are tried, s, and over how much the slope of a reading is taken
EARLIEST_S, LATEST_S, STEP_S, SLOPE_S = -0.3, 1.0, 0.01, 0.05
ROUNDS, SIGMAS = 5, 4.0
# Of the fastest speeds, below which nothing is learnt of a scale; pairs that are needed
MOVING, LEAST = 0.1, 30
# m/s^2, beyond which wheels slip: at 10 m/s two per cent of slip for each m/s^2 look like 0.2 s of
# latency. Over how much an acceleration is taken, s
GENTLE, SPAN_S = 1.0, 1.0
# Readings further apart than so many usual intervals leave a hole
HOLE = 3.0
# Residuals are alike over so long at most
ALIKE_S = 10.0
# No residual is smaller, of the fastest speeds: wheels are counted in steps
FINEST = 1e-3


@dataclass(frozen=True)
class WheelFit:
    """How the readings of wheels are to be taken.

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
    """

    scale: float
    scale_sigma: float
    latency_s: float
    latency_sigma: float
    residual_sigma: float
    samples: int


def fit_wheels(
    time_ns: IntArray, reading: FloatArray, reference_ns: IntArray, reference: FloatArray
) -> WheelFit | None:
    """Robust least squares of ``reference(t) = scale * reading(t + latency)``.

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
        None where too little motion is in both. Sigmas are those of least squares, times what
        the autocorrelation of the residuals makes of them.
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
    t, speed = t[use], reference[use]
    if len(t) < LEAST or not np.interp(t, at, reading).any():
        return None
    lags = np.arange(EARLIEST_S, LATEST_S + 0.5 * STEP_S, STEP_S)
    kept = np.ones(len(t), np.bool_)
    scale, lag, sigma = 0.0, 0.0, 0.0
    for _ in range(ROUNDS):
        costs = [_cost(np.interp(t[kept] + each, at, reading), speed[kept]) for each in lags]
        scale, lag = _refined(at, reading, t[kept], speed[kept], float(lags[np.argmin(costs)]))
        rest = speed - scale * np.interp(t + lag, at, reading)
        sigma = max(1.4826 * float(np.median(np.abs(rest))), FINEST * fastest)
        before, kept = kept, np.abs(rest) <= SIGMAS * sigma
        if kept.sum() < LEAST:
            return None
        if np.array_equal(before, kept):
            break
    design = _design(at, reading, t[kept], scale, lag)
    normal = design.T @ design
    rest = rest[kept]
    variance = float(np.mean(rest**2)) * _inflation(t[kept], rest)
    # Where speed never changes, a slope of nothing says nothing of latency
    normal[1, 1] += 1e-12 * normal[0, 0]
    covariance = variance * np.linalg.inv(normal)
    return WheelFit(
        scale,
        float(np.sqrt(covariance[0, 0])),
        lag,
        float(np.sqrt(covariance[1, 1])),
        sigma,
        int(kept.sum()),
    )


def slipping_wheels(
    time_ns: IntArray,
    speed: FloatArray,
    apart: FloatArray,
    yaw_ns: IntArray,
    yaw_rate: FloatArray,
) -> BoolArray:
    """Where the difference of two wheels of an axle is not that of a turn.

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
    kept = moving
    rest, most = apart, np.full(len(apart), np.inf)
    for _ in range(ROUNDS):
        track = float(turn[kept] @ apart[kept] / (turn[kept] @ turn[kept]))
        rest = apart - track * turn
        sigma = 1.4826 * float(np.median(np.abs(rest[kept])))
        most = SIGMAS * max(sigma, FINEST * fastest) + 0.01 * np.abs(speed)
        kept = moving & (np.abs(rest) <= most)
        if not turn[kept].any():
            break
    return np.asarray(within & (np.abs(rest) > most))


def _covered(at: FloatArray, t: FloatArray) -> BoolArray:
    """Times about which readings leave no hole, at any latency that is tried."""
    step = np.diff(at)
    holes = np.concatenate([[0], np.cumsum(step > HOLE * float(np.median(step)))])
    first = np.searchsorted(at, t + EARLIEST_S - SLOPE_S, "right") - 1
    last = np.searchsorted(at, t + LATEST_S + SLOPE_S, "left")
    inside = (first >= 0) & (last < len(at))
    return np.asarray(
        inside & (holes[np.minimum(last, len(at) - 1)] == holes[np.maximum(first, 0)])
    )


def _cost(turned: FloatArray, speed: FloatArray) -> float:
    """What a scale leaves of the squares."""
    power = float(turned @ turned)
    return float(speed @ speed) - (float(speed @ turned) ** 2 / power if power > 0.0 else 0.0)


def _design(
    at: FloatArray, reading: FloatArray, t: FloatArray, scale: float, lag: float
) -> FloatArray:
    """Derivatives of the scaled reading by scale and latency, shape (n, 2)."""
    late, early = (np.interp(t + lag + d, at, reading) for d in (SLOPE_S, -SLOPE_S))
    return np.stack(
        [np.interp(t + lag, at, reading), scale * (late - early) / (2.0 * SLOPE_S)], axis=1
    )


def _refined(
    at: FloatArray, reading: FloatArray, t: FloatArray, speed: FloatArray, lag: float
) -> tuple[float, float]:
    """Scale and latency between those that are tried: three steps of Gauss and Newton."""
    turned = np.interp(t + lag, at, reading)
    scale = float(speed @ turned / (turned @ turned))
    about = lag
    for _ in range(3):
        rest = speed - scale * np.interp(t + lag, at, reading)
        step = np.linalg.lstsq(_design(at, reading, t, scale, lag), rest, rcond=1e-9)[0]
        scale += float(step[0])
        lag = float(np.clip(lag + step[1], about - STEP_S, about + STEP_S))
    return scale, lag


def _inflation(t: FloatArray, rest: FloatArray) -> float:
    """By how much a variance grows as residuals that follow each other are alike."""
    step = float(np.median(np.diff(t)))
    power = float(np.mean(rest**2))
    total = 1.0
    for k in range(1, min(int(ALIKE_S / step) + 1, len(rest) // 2)):
        near = np.abs(t[k:] - t[:-k] - k * step) < 0.5 * step
        if not near.any():
            break
        alike = float(np.mean((rest[k:] * rest[:-k])[near])) / power
        if alike <= 0.0:
            break
        total += 2.0 * alike
    return total
