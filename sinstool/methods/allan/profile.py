"""Edges of intervals of profile likelihood, chances of chi-squared, and where a fit begins."""

from __future__ import annotations

from collections.abc import Callable
from math import erfc, exp, pi, sqrt

import numpy as np

from sinstool.core.arrays import FloatArray


def chance_above(value: float, freedom: int) -> float:
    """Chance that chi-squared with so many degrees of freedom is above a value.

    Abramowitz and Stegun, Handbook of Mathematical Functions, 26.4.4 and 26.4.5. SciPy has it, but
    takes longer to import than all else here.
    """
    half = 0.5 * value
    if freedom % 2:
        total, part, k = erfc(sqrt(half)), 2.0 * sqrt(half / pi) * exp(-half), 1.5
    else:
        total, part, k = 0.0, exp(-half), 1.0
    for _ in range(freedom // 2):
        total += part
        part *= half / k
        k += 1.0
    return min(total, 1.0)


def between(
    one: float, other: float, outer: Callable[[float, float], float], inward: float
) -> float:
    """An edge of an interval, from two of which neither is quite right."""
    far = outer(one, other)
    return far + inward * (one + other - 2.0 * far)


def edge(
    rise: Callable[[float, FloatArray], tuple[float, FloatArray]],
    p: FloatArray,
    best: float,
    spread: float,
    side: float,
    target: float,
) -> float:
    """Where the root of the rise in deviance reaches its target.

    The root of the rise is nearly straight in the coefficient; secants find the edge soon.
    """
    inner, inner_root = best, 0.0
    outer = best + side * 2.0 * spread
    start = p
    if side < 0.0:
        outer = max(outer, 0.0)
    for _ in range(40):
        value, fitted = rise(outer, start)
        root = sqrt(max(value, 0.0))
        if root >= target or (side < 0.0 and outer <= 0.0):
            break
        inner, inner_root, start = outer, root, fitted
        outer = best + side * 1.6 * abs(outer - best)
        if side < 0.0:
            outer = max(outer, 0.0)
    if root < target:
        return outer
    for _ in range(25):
        # Between secant and halving: safe where the root is far from straight
        part = (target - inner_root) / (root - inner_root)
        middle = inner + min(max(part, 0.1), 0.9) * (outer - inner)
        value, start = rise(middle, start)
        at = sqrt(max(value, 0.0))
        if abs(at - target) < 0.005:
            return middle
        if at < target:
            inner, inner_root = middle, at
        else:
            outer, root = middle, at
    return middle


def least_squares(rows: FloatArray) -> FloatArray:
    """Terms, none of them negative, that bring each row next to 1."""
    size = np.max(rows, axis=0)
    scaled, one = rows / size, np.ones(len(rows))
    best, least = np.zeros(len(size)), float(len(rows))
    # The best of all choices of terms whose own best is not negative
    for chosen in range(1, 1 << len(size)):
        some = [k for k in range(len(size)) if chosen >> k & 1]
        solution = np.linalg.lstsq(scaled[:, some], one, rcond=None)[0]
        left = float(np.sum((one - scaled[:, some] @ solution) ** 2))
        if np.all(solution >= 0.0) and left < least:
            best, least = np.zeros(len(size)), left
            best[some] = solution
    return np.asarray(best / size)
