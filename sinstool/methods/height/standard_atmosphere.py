"""The standard atmosphere: pressure and height on a standard day.

Heights are geopotential; :func:`geometric` turns them into metres above mean sea level.

References
----------
.. [1] ICAO Doc 7488, "Manual of the ICAO Standard Atmosphere", 3rd ed., 1993.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray
from sinstool.core.units import STANDARD_GRAVITY

STANDARD_PRESSURE = 101325.0
"""At mean sea level, Pa; [1]_ of the module."""

STANDARD_TEMPERATURE = 288.15
"""At mean sea level, K; [1]_ of the module."""

LAPSE_RATE = 0.0065
"""Up to the tropopause, K/m of geopotential height; [1]_ of the module."""

GAS_CONSTANT = 287.05287
"""Of dry air, J/(kg K); [1]_ of the module."""

EARTH_RADIUS = 6356766.0
"""That geopotential heights are reckoned with, m; [1]_ of the module."""

TROPOPAUSE = 11000.0
"""Geopotential height, m; [1]_ of the module."""

_EXPONENT = GAS_CONSTANT * LAPSE_RATE / STANDARD_GRAVITY  # 0.190263
_SCALE = STANDARD_TEMPERATURE / LAPSE_RATE  # 44330.769 m
_TOP_TEMPERATURE = STANDARD_TEMPERATURE - LAPSE_RATE * TROPOPAUSE
_TOP_PRESSURE = STANDARD_PRESSURE * (_TOP_TEMPERATURE / STANDARD_TEMPERATURE) ** (1 / _EXPONENT)
_TOP_SCALE = GAS_CONSTANT * _TOP_TEMPERATURE / STANDARD_GRAVITY  # 6341.62 m


def pressure_altitude(pressure: ArrayLike) -> FloatArray:
    """Geopotential height at which a standard atmosphere has a pressure.

    Parameters
    ----------
    pressure : array_like, shape (...)
        Pa. NaN where it is not positive and finite.

    Returns
    -------
    ndarray, shape (...)
        Geopotential m; [1]_ of the module, both layers up to 20 km.
    """
    p = np.asarray(pressure, dtype=np.float64)
    p = np.where(np.isfinite(p) & (p > 0.0), p, np.nan)
    below = _SCALE * (1.0 - (p / STANDARD_PRESSURE) ** _EXPONENT)
    above = TROPOPAUSE - _TOP_SCALE * np.log(p / _TOP_PRESSURE)
    return np.asarray(np.where(p >= _TOP_PRESSURE, below, above))


def pressure_at(altitude: ArrayLike) -> FloatArray:
    """Pressure of a standard atmosphere; the inverse of :func:`pressure_altitude`.

    Parameters
    ----------
    altitude : array_like, shape (...)
        Geopotential m.

    Returns
    -------
    ndarray, shape (...)
        Pa.
    """
    h = np.asarray(altitude, dtype=np.float64)
    warm = np.maximum(1.0 - h / _SCALE, _TOP_TEMPERATURE / STANDARD_TEMPERATURE)
    below = STANDARD_PRESSURE * warm ** (1.0 / _EXPONENT)
    above = _TOP_PRESSURE * np.exp((TROPOPAUSE - h) / _TOP_SCALE)
    return np.asarray(np.where(h <= TROPOPAUSE, below, above))


def height_per_pascal(pressure: ArrayLike) -> FloatArray:
    """Slope dH/dp of :func:`pressure_altitude`, m/Pa: negative; -8.32 m/hPa at sea level."""
    p = np.asarray(pressure, dtype=np.float64)
    temperature = STANDARD_TEMPERATURE * (p / STANDARD_PRESSURE) ** _EXPONENT
    return np.asarray(
        -GAS_CONSTANT * np.maximum(temperature, _TOP_TEMPERATURE) / (STANDARD_GRAVITY * p)
    )


def geometric(geopotential: ArrayLike) -> FloatArray:
    """Geometric height above mean sea level of a geopotential height, both in m."""
    h = np.asarray(geopotential, dtype=np.float64)
    return np.asarray(EARTH_RADIUS * h / (EARTH_RADIUS - h))


def geopotential(height: ArrayLike) -> FloatArray:
    """Geopotential height of a geometric height above mean sea level, both in m."""
    h = np.asarray(height, dtype=np.float64)
    return np.asarray(EARTH_RADIUS * h / (EARTH_RADIUS + h))
