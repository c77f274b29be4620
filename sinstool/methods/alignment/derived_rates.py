"""What velocities that are derived from positions show of the motion of an antenna.

Such a velocity is the slope of a parabola through the positions of seconds. What the IMU measures
in that time is treated in the same way: then a vehicle that accelerates, and an antenna that swings
to and fro, do not look like errors of an attitude.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import BoolArray, FloatArray
from sinstool.core.parts import kernel

# Slopes are computed from rows this far apart at most, s.
GRID_S = 0.05


def slopes(
    time_s: FloatArray, values: FloatArray, at_s: FloatArray, half_s: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Slopes of parabolas through columns, by least squares within windows.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Increasing.
    values : ndarray, shape (n, m)
    at_s, half_s : ndarray, shape (k,)
        Middle and half-width of each window, s.

    Returns
    -------
    slopes : ndarray, shape (k, m)
        At the middles, per second.
    whole : ndarray of bool, shape (k,)
        Whether the rows cover the window; the slope is 0 where they do not.
    """
    out, whole = np.zeros((len(at_s), values.shape[1])), np.zeros(len(at_s), dtype=np.bool_)
    if len(time_s):
        _slopes(time_s, np.ascontiguousarray(values), at_s, half_s, out, whole)
    return out, whole


@kernel()
def _slopes(
    time_s: FloatArray,
    values: FloatArray,
    at_s: FloatArray,
    half_s: FloatArray,
    out: FloatArray,
    whole: BoolArray,
) -> None:
    """:func:`slopes` into zeros."""
    n, first = len(time_s), 0
    for k in range(len(at_s)):
        middle, half = at_s[k], half_s[k]
        slack = 1e-3 * half
        if not (time_s[0] <= middle - half + slack and time_s[n - 1] >= middle + half - slack):
            continue
        while first > 0 and time_s[first - 1] >= middle - half:
            first -= 1
        while time_s[first] < middle - half:
            first += 1
        s0, s1, s2, s3, s4 = 0.0, 0.0, 0.0, 0.0, 0.0
        last = first
        while last < n and time_s[last] <= middle + half:
            t = time_s[last] - middle
            s0, s1, s2, s3, s4 = s0 + 1.0, s1 + t, s2 + t**2, s3 + t**3, s4 + t**4
            last += 1
        # The row of the slope in the inverse of the normal equations
        a, b, c = s2 * s3 - s1 * s4, s0 * s4 - s2 * s2, s1 * s2 - s0 * s3
        det = s1 * a + s2 * b + s3 * c
        if last - first < 5 or not det > 0.0:
            continue
        whole[k] = True
        for j in range(first, last):
            t = time_s[j] - middle
            weight = (a + b * t + c * t * t) / det
            for i in range(out.shape[1]):
                # The weights sum to zero: less a value, large ones lose no digits
                out[k, i] += weight * (values[j, i] - values[first, i])
