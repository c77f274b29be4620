"""Lulls: stretches of a slow motion that look like rest, as nothing shakes what moves.

An aircraft in a turn, a ship or a balloon may keep its rate for some seconds. But where such a
motion goes over into one of another rate it does so gradually, and then the rate changes a little
within the stretch, too, as a smooth curve must. A vehicle or a hand that comes to rest keeps its
rate until it moves off; or it shakes more where it moves.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray
from sinstool.core.order_statistics import median

# The rate beside a stretch is the mean over BESIDE_S, s, or half of its length, before or after it
# less SKIP_S. It differs by more than LEAST, rad/s, and DIFFER sigmas of noise.
SKIP_S, BESIDE_S = 0.4, 1.6
LEAST, DIFFER = 0.003, 4.0
# What is beside a rest shakes, where it is motion, with a variance more than SHAKES times that of
# the rest. Variances below these show the resolution of the sensors, (rad/s)^2 and (m/s^2)^2.
SHAKES = 4.0
STILL_VARIANCE = np.array([1e-4, 3e-3]) ** 2
# Within a stretch of a slow motion the rate changes by at least this share (of squares) of what a
# parabola or a line through the rate beside it has there; so many variances of noise hide it.
SHARE, HIDES = 0.2, 10.0


def lulls(
    rate: FloatArray,
    noise: FloatArray,
    shake: FloatArray,
    joined: BoolArray,
    stretches: Iterable[tuple[int, int]],
    step_s: float,
) -> list[bool]:
    """Which apparent rests are part of a slow motion, or may be.

    Parameters
    ----------
    rate : ndarray, shape (n, 3)
        Means over steps of `step_s`, rad/s, body axes.
    noise : ndarray, shape (n,)
        Variance of an axis' mean rate by the noise of the sensor, rad^2/s^2.
    shake : ndarray, shape (n, 2)
        Variances of single samples of rate and of specific force.
    joined : ndarray of bool, shape (n,)
        Whether a step follows the one before it without a gap.
    stretches : iterable of (int, int)
        First and last (exclusive) step of each apparent rest.
    step_s : float
    """
    skip, wide = round(SKIP_S / step_s + 0.4), round(BESIDE_S / step_s)
    return [
        _is_lull(rate, noise, np.maximum(shake, STILL_VARIANCE), joined, begin, end, skip, wide)
        for begin, end in stretches
    ]


def _is_lull(
    rate: FloatArray,
    noise: FloatArray,
    shake: FloatArray,
    joined: BoolArray,
    begin: int,
    end: int,
    skip: int,
    wide: int,
) -> bool:
    """Whether the rate goes over gradually into another one on each side that the log shows."""
    inside = rate[begin:end]
    at: FloatArray = np.arange(end - begin, dtype=np.float64) - 0.5 * (end - begin - 1)
    powers = np.column_stack([at**0, at, at**2])[:, : min(3, len(at))]
    curves, _ = np.linalg.qr(powers)
    found = curves[:, 1:].T @ inside
    own = float(median(noise[begin:end]))
    bends = max(float(np.sum(found**2)), HIDES * own)
    mean, shaken = inside.mean(axis=0), median(shake[begin:end], axis=0)
    gradual, wide = False, max(wide, (end - begin) // 2)
    for beside in (_before(joined, begin, skip, wide), _after(joined, end, skip, wide)):
        if len(beside) < 2:
            continue
        if np.any(median(shake[beside], axis=0) > SHAKES * shaken):
            return False
        square = float(np.sum((rate[beside].mean(axis=0) - mean) ** 2))
        if square < (LEAST + DIFFER * np.sqrt(3.0 * own / len(beside))) ** 2:
            continue
        if bends < SHARE * square * _least_bend(at, beside - begin + at[0]):
            return False
        gradual = True
    return gradual


def _least_bend(inside: FloatArray, beside: FloatArray) -> float:
    """Sum of squares about its mean, inside, of a line or a parabola that is 1 off it beside."""
    least = np.inf
    for power in (1, 2):
        curve, other = inside**power, float(np.mean(beside**power))
        about = curve - curve.mean()
        least = min(least, float(about @ about) / (other - float(curve.mean())) ** 2)
        if len(inside) < 3:
            break
    return least


def _before(joined: BoolArray, begin: int, skip: int, wide: int) -> np.ndarray:
    """Steps before a stretch, as far as they follow one another without a gap."""
    first = max(begin - skip - wide, 0)
    breaks = np.flatnonzero(~joined[first + 1 : begin + 1])
    return np.arange(first + 1 + breaks[-1] if len(breaks) else first, begin - skip)


def _after(joined: BoolArray, end: int, skip: int, wide: int) -> np.ndarray:
    """Steps after a stretch, as far as they follow one another without a gap."""
    last = min(end + skip + wide, len(joined))
    breaks = np.flatnonzero(~joined[end:last])
    return np.arange(end + skip, end + breaks[0] if len(breaks) else last)
