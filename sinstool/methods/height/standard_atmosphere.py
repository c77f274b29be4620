"""The standard atmosphere: pressure and height on a standard day.

Heights are geopotential; :func:`geometric` turns them into metres above mean sea level. In each
layer the temperature changes evenly with height, or is the same throughout.

References
----------
.. [1] ICAO Doc 7488, "Manual of the ICAO Standard Atmosphere", 3rd ed., 1993.
.. [2] "U.S. Standard Atmosphere, 1976", NOAA-S/T 76-1562: the same in these layers.
"""

from __future__ import annotations

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray, IntArray
from sinstool.core.units import STANDARD_GRAVITY

STANDARD_PRESSURE = 101325.0
"""At mean sea level, Pa; [1]_ of the module."""

STANDARD_TEMPERATURE = 288.15
"""At mean sea level, K; [1]_ of the module."""

GAS_CONSTANT = 287.05287
"""Of dry air, J/(kg K); [1]_ of the module."""

EARTH_RADIUS = 6356766.0
"""That geopotential heights are reckoned with, m; [1]_ of the module."""

LAYERS = ((0.0, -0.0065), (11_000.0, 0.0), (20_000.0, 0.001), (32_000.0, 0.0028))
"""Lower end of each layer, geopotential m, and its change of temperature with height, K/m; [1]_ of
the module. The first layer goes on below sea level, the last one up to 47 km."""

_BASE, _LAPSE = np.array(LAYERS).T
_WARMTH = STANDARD_TEMPERATURE + np.cumsum([0.0, *np.diff(_BASE) * _LAPSE[:-1]])  # K at each base
_PER_LENGTH = STANDARD_GRAVITY / (GAS_CONSTANT * _WARMTH)  # 1/m: decrease of ln p at each base


def _ratio(h: FloatArray, layer: IntArray) -> FloatArray:
    """Pressure at a height over that at the base of its layer."""
    slope = _LAPSE[layer] / _WARMTH[layer]
    up, even = h - _BASE[layer], slope == 0.0
    # Beyond the height where the formula has no air left there is none
    warmer = np.maximum(1.0 + slope * up, 0.0)
    power = _PER_LENGTH[layer] / np.where(even, 1.0, slope)
    with np.errstate(divide="ignore"):
        changing = warmer**-power
    return np.where(even, np.exp(-_PER_LENGTH[layer] * up), changing)


# Pa, at the base of each layer
_PRESSURE = STANDARD_PRESSURE * np.cumprod([1.0, *_ratio(_BASE[1:], np.arange(len(LAYERS) - 1))])


def _layer_of(pressure: FloatArray) -> IntArray:
    """Number of the layer that has a pressure."""
    return np.asarray(np.searchsorted(-_PRESSURE[1:], -pressure, side="left"))


def _temperature(pressure: FloatArray, layer: IntArray) -> FloatArray:
    """Temperature at a pressure, K."""
    power = _LAPSE[layer] * GAS_CONSTANT / STANDARD_GRAVITY
    return np.asarray(_WARMTH[layer] * (pressure / _PRESSURE[layer]) ** -power)


def pressure_altitude(pressure: ArrayLike) -> FloatArray:
    """Geopotential height at which a standard atmosphere has a pressure.

    Parameters
    ----------
    pressure : array_like, shape (...)
        Pa. NaN where it is not positive and finite.

    Returns
    -------
    ndarray, shape (...)
        Geopotential m; [1]_ of the module.
    """
    p = np.asarray(pressure, dtype=np.float64)
    p = np.where(np.isfinite(p) & (p > 0.0), p, np.nan)
    layer = _layer_of(p)
    lapse = _LAPSE[layer]
    changing = (_temperature(p, layer) - _WARMTH[layer]) / np.where(lapse == 0.0, 1.0, lapse)
    even = -np.log(p / _PRESSURE[layer]) / _PER_LENGTH[layer]
    return np.asarray(_BASE[layer] + np.where(lapse == 0.0, even, changing))


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
    layer = np.searchsorted(_BASE[1:], h, side="left")
    return np.asarray(_PRESSURE[layer] * _ratio(h, layer))


def height_per_pascal(pressure: ArrayLike) -> FloatArray:
    """Slope dH/dp of :func:`pressure_altitude`, m/Pa: negative; -8.32 m/hPa at sea level."""
    p = np.asarray(pressure, dtype=np.float64)
    return np.asarray(-GAS_CONSTANT * _temperature(p, _layer_of(p)) / (STANDARD_GRAVITY * p))


def geometric(geopotential: ArrayLike) -> FloatArray:
    """Geometric height above mean sea level of a geopotential height, both in m."""
    h = np.asarray(geopotential, dtype=np.float64)
    return np.asarray(EARTH_RADIUS * h / (EARTH_RADIUS - h))


def geopotential(height: ArrayLike) -> FloatArray:
    """Geopotential height of a geometric height above mean sea level, both in m."""
    h = np.asarray(height, dtype=np.float64)
    return np.asarray(EARTH_RADIUS * h / (EARTH_RADIUS + h))
