"""Points of the chi-square distribution.

`scipy.special.chdtri` gives the same, but takes longer to import than most logs to process.
"""

from __future__ import annotations

from functools import lru_cache
from math import exp, inf, lgamma, log, sqrt
from statistics import NormalDist

# Steps of Newton's method, and terms of series and fraction, at most.
STEPS, TERMS = 60, 10_000
CLOSE = 1e-15
MEDIAN_SQUARE = 0.4549
"""Of a unit normal: the median with one degree of freedom."""


@lru_cache(maxsize=256)
def upper_point(freedom: float, probability: float) -> float:
    """What a sum of squares of unit normals exceeds with a probability.

    Parameters
    ----------
    freedom : float
        How many are summed, more than 0.
    probability : float
        0 to 1.

    Returns
    -------
    float
        Infinite for a probability of 0.

    References
    ----------
    .. [1] M. Abramowitz, I. A. Stegun, "Handbook of Mathematical Functions", 1964, 26.4.17 for
       the first guess, by Wilson and Hilferty.
    """
    if not 0.0 < probability < 1.0:
        return 0.0 if probability >= 1.0 else inf
    share = 2.0 / (9.0 * freedom)
    normal = NormalDist().inv_cdf(1.0 - probability) if probability > 1e-15 else 8.0
    x = 0.5 * freedom * max(1.0 - share + normal * sqrt(share), 1e-3) ** 3
    a = 0.5 * freedom
    for _ in range(STEPS):
        density = exp((a - 1.0) * log(x) - x - lgamma(a))
        below, above = _shares(a, x)
        # The smaller of the two is known better; Newton on its logarithm where that is far out
        if probability < 0.5:
            change = above * log(above / probability) / density
        else:
            change = (1.0 - probability - below) / density
        x = max(x + change, 0.1 * x)
        if abs(change) <= CLOSE * x:
            break
    return 2.0 * x


def _shares(a: float, x: float) -> tuple[float, float]:
    """Incomplete gamma functions P(a, x) and Q(a, x), by series or continued fraction.

    References
    ----------
    .. [1] M. Abramowitz, I. A. Stegun, "Handbook of Mathematical Functions", 1964, 6.5.29 and
       6.5.31, the latter evaluated by Lentz's method.
    """
    scale = exp(a * log(x) - x - lgamma(a))
    if x < a + 1.0:
        term = total = 1.0 / a
        for k in range(1, TERMS):
            term *= x / (a + k)
            total += term
            if term < CLOSE * total:
                break
        return scale * total, 1.0 - scale * total
    b = x + 1.0 - a
    c, d = 1e300, 1.0 / b
    h = d
    for k in range(1, TERMS):
        factor = -k * (k - a)
        b += 2.0
        d = 1.0 / (factor * d + b)
        c = b + factor / c
        h *= d * c
        if abs(d * c - 1.0) < CLOSE:
            break
    return 1.0 - scale * h, scale * h
