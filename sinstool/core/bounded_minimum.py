"""The minimum of a function of one variable within bounds.

`scipy.optimize.minimize_scalar` does the same, but takes longer to import than most logs to
process.
"""

from __future__ import annotations

from collections.abc import Callable
from math import copysign, sqrt

GOLDEN = 0.5 * (3.0 - sqrt(5.0))
ROUNDING = sqrt(2.2e-16)
MOST = 500  # evaluations


def bounded_minimum(
    function: Callable[[float], float], low: float, high: float, tolerance: float
) -> tuple[float, float]:
    """Where a function of one variable is least, and its value there.

    Parameters
    ----------
    function : callable
        Has one minimum between the bounds.
    low, high : float
        Bounds of the variable.
    tolerance : float
        Absolute tolerance of the variable.

    Returns
    -------
    x, value : float
        The best point found in at most 500 evaluations, and the function there.

    References
    ----------
    .. [1] R. P. Brent, "Algorithms for Minimization Without Derivatives", 1973, chapter 5:
       parabolas through the best three points, and golden sections where they do not help.
    """
    best = second = third = low + GOLDEN * (high - low)
    f_best = f_second = f_third = function(best)
    step = before = 0.0
    for _ in range(MOST):
        middle = 0.5 * (low + high)
        least = ROUNDING * abs(best) + tolerance / 3.0
        if abs(best - middle) <= 2.0 * least - 0.5 * (high - low):
            break
        parabola = False
        if abs(before) > least:
            r = (best - second) * (f_best - f_third)
            q = (best - third) * (f_best - f_second)
            p = (best - third) * q - (best - second) * r
            q = 2.0 * (q - r)
            p, q = (-p if q > 0.0 else p), abs(q)
            last, before = before, step
            if abs(p) < abs(0.5 * q * last) and q * (low - best) < p < q * (high - best):
                parabola = True
                step = p / q
                if min(best + step - low, high - best - step) < 2.0 * least:
                    step = copysign(least, middle - best)
        if not parabola:
            before = low - best if best >= middle else high - best
            step = GOLDEN * before
        x = best + copysign(max(abs(step), least), step)
        f = function(x)
        if f <= f_best:
            low, high = (best, high) if x >= best else (low, best)
            third, f_third = second, f_second
            second, f_second = best, f_best
            best, f_best = x, f
        else:
            low, high = (x, high) if x < best else (low, x)
            if f <= f_second or second == best:
                third, f_third = second, f_second
                second, f_second = x, f
            elif f <= f_third or third in (best, second):
                third, f_third = x, f
    return best, f_best
