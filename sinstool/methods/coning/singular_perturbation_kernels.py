"""Kernels of the singular-perturbation coning algorithm that keep their digits everywhere.

With ``x = T / epsilon`` and ``E = exp(-x)`` the exact integrals of the paper's rate model
(eq. 10 of [1]_) are

    g0 = (1 - E) / x
    g1 = -1/(2x) - E/(2x) - 2E/x**2 + 2(1 - E)/x**3
    g2 = 2(1 - E)/x**2 - (1 + E)/x

and those of the two-point solution of its eq. 3

    L  = coth(x/2) - 2/x = -g2/g0,     h1 = (g1 + 1/6)/(1 - E),     h2 = -L/x.

As written they lose all digits for small x (g2 is off by 7 % at x = 1e-5); below x = 1
their power series are summed instead. All functions take x >= 0 and numbers only.

References
----------
.. [1] L. Fu, Z. Luo, "A singular perturbation-based algorithm for compensation of
   pseudo-coning error for strapdown inertial navigation" (in Chinese), 2011.
"""

from __future__ import annotations

from math import factorial

import numba
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

# The series are cut where their terms fall below 1e-19 of the first at x = 1.
_TERMS = 18

# (g1 + 1/6) / x**2 in powers of x: coefficients -(-1)**m (m-1)(m-4) / (2 m!), m = 5, 6, ..
_G1_SERIES = np.array(
    [-((-1) ** m) * (m - 1) * (m - 4) / (2 * factorial(m)) for m in range(5, 5 + _TERMS)]
)
# g2 / x in powers of x: coefficients (-1)**m (m-2) / m!, m = 3, 4, ..
_G2_SERIES = np.array([(-1) ** m * (m - 2) / factorial(m) for m in range(3, 3 + _TERMS)])


@numba.njit(cache=True, nogil=True)
def _series(coefficients: FloatArray, x: float) -> float:
    """Sum of a power series for x < 1, the highest power first."""
    total = 0.0
    for i in range(_TERMS - 1, -1, -1):
        total = total * x + coefficients[i]
    return total


@numba.njit(cache=True, nogil=True)
def g0(x: float) -> float:
    """Integral of the boundary layer, in units of T: ``(1 - E) / x``."""
    if x == 0.0:
        return 1.0
    return -np.expm1(-x) / x


@numba.njit(cache=True, nogil=True)
def g1(x: float) -> float:
    """Coning of the boundary layer with the slope, in units of T**3."""
    if x < 1.0:
        return x * x * _series(_G1_SERIES, x) - 1.0 / 6.0
    e = np.exp(-x)
    return (-0.5 * (1.0 + e) + (-2.0 * e - 2.0 * np.expm1(-x) / x) / x) / x


@numba.njit(cache=True, nogil=True)
def g2(x: float) -> float:
    """Coning of the constant with the boundary layer, in units of T**2."""
    if x < 1.0:
        return x * _series(_G2_SERIES, x)
    return (-2.0 * np.expm1(-x) / x - (1.0 + np.exp(-x))) / x


@numba.njit(cache=True, nogil=True)
def langevin(x: float) -> float:
    """Return ``L = coth(x/2) - 2/x``, the asymmetry of the two-point solution."""
    if x < 1.0:
        return -g2(x) / g0(x)
    return (1.0 + np.exp(-x)) / -np.expm1(-x) - 2.0 / x


@numba.njit(cache=True, nogil=True)
def h1(x: float) -> float:
    """Coning of the two-point boundary layer with the slope, in units of T**3."""
    if x < 1.0:
        return x * _series(_G1_SERIES, x) / g0(x)
    return (g1(x) + 1.0 / 6.0) / -np.expm1(-x)


@numba.njit(cache=True, nogil=True)
def h2(x: float) -> float:
    """Coning of the first rate with the two-point boundary layer, in units of T**2."""
    if x < 1.0:
        return _series(_G2_SERIES, x) / g0(x)
    return -langevin(x) / x
