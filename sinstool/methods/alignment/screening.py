"""Outliers of GNSS velocity, found before any attitude is known.

A rotation leaves lengths as they are: between two fixes the integrated vector must be as long
in the inertial measurements as in the velocities, whatever the attitude.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

NEIGHBOURS = 5
SIGMAS = 5.0
LENGTH_SHARE = 0.002
"""Of a vector's length: scale factors, bent arcs, a lever arm not quite right."""


def plausible_fixes(alpha: FloatArray, beta: FloatArray, sigma: FloatArray) -> NDArray[np.bool_]:
    """Fixes whose velocity agrees with most of its neighbours.

    Parameters
    ----------
    alpha, beta : ndarray, shape (n, 3)
        Both integrated sides at the fixes, m/s.
    sigma : ndarray, shape (n,)
        Velocity noise, m/s per axis.

    Returns
    -------
    ndarray of bool, shape (n,)
        At least half of the tests against up to 5 fixes on each side pass:
        ``| |d beta| - |d alpha| | <= 5 sqrt(s_k^2 + s_j^2) + 0.002 |d alpha|``. A fix without
        neighbours is kept.
    """
    count = len(alpha)
    passed, tests = np.zeros(count), np.zeros(count)
    for shift in range(1, min(NEIGHBOURS, count - 1) + 1):
        length_a = np.linalg.norm(alpha[shift:] - alpha[:-shift], axis=-1)
        length_b = np.linalg.norm(beta[shift:] - beta[:-shift], axis=-1)
        limit = SIGMAS * np.hypot(sigma[shift:], sigma[:-shift]) + LENGTH_SHARE * length_a
        good = np.abs(length_b - length_a) <= limit
        passed[shift:] += good
        passed[:-shift] += good
        tests[shift:] += 1
        tests[:-shift] += 1
    return np.asarray(2.0 * passed >= tests)
