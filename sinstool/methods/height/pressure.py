"""Checks of logged pressures: which are usable, their unit, and where the sensor is frozen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sinstool.core.arrays import ArrayLike, IntArray
from sinstool.core.order_statistics import median
from sinstool.methods.height.layout import ACCEPTED, NOT_FINITE, OUT_OF_RANGE

PRESSURE_RANGE = (868.0, 1.2e5)
"""Pa: 32 km above to 1.4 km below sea level. Higher up an error of 1 hPa is more than 700 m."""

UNIT_SAMPLES = 100
"""Number of valid samples by which the unit is judged."""

FROZEN_TIME = 30.0
"""Time for which a frozen sensor repeats one value, s."""

Unit = Literal["Pa", "hPa", "kPa", "inHg", "unknown"]


def pressure_reason(pressure: ArrayLike) -> IntArray:
    """Reason why each pressure must not be used.

    Parameters
    ----------
    pressure : array_like, shape (n,)
        Pa.

    Returns
    -------
    ndarray of int, shape (n,)
        ``ACCEPTED`` (0), ``NOT_FINITE`` or ``OUT_OF_RANGE`` of
        :mod:`~sinstool.methods.height.layout`; zero and negative pressures are out of range.
    """
    p = np.asarray(pressure, dtype=np.float64)
    inside = (p >= PRESSURE_RANGE[0]) & (p <= PRESSURE_RANGE[1])
    reason = np.where(inside, ACCEPTED, OUT_OF_RANGE)
    return np.where(np.isfinite(p), reason, NOT_FINITE).astype(np.int64)


@dataclass(frozen=True)
class UnitSuspicion:
    """Evidence about the unit of pressures from their size.

    Attributes
    ----------
    unit : {"Pa", "hPa", "kPa", "inHg", "unknown"}
    median : float
        Of the first valid samples, as logged; NaN where there are none.
    samples : int
        Number of those.
    """

    unit: Unit
    median: float
    samples: int


def suspected_unit(pressure: ArrayLike) -> UnitSuspicion:
    """Judge the unit of pressures by the median of the first 100 valid samples.

    Parameters
    ----------
    pressure : array_like, shape (n,)
        As logged. Valid are finite positive ones.

    Returns
    -------
    UnitSuspicion
        ``inHg`` for 20 to 32, as that many kPa would be 9 to 12 km up; ``kPa`` for 100 to 120,
        as that many hPa would be 15 to 16 km up; ``hPa`` up to 1200, as that many Pa would be at
        least 30 km up.
    """
    p = np.asarray(pressure, dtype=np.float64)
    p = p[np.isfinite(p) & (p > 0.0)][:UNIT_SAMPLES]
    if not len(p):
        return UnitSuspicion("unknown", float("nan"), 0)
    middle = float(median(p))
    unit: Unit = "unknown"
    if 1200.0 < middle <= PRESSURE_RANGE[1]:
        unit = "Pa"
    elif 20.0 <= middle <= 32.0:
        unit = "inHg"
    elif 10.0 <= middle <= 120.0:
        unit = "kPa"
    elif 120.0 < middle <= 1200.0:
        unit = "hPa"
    return UnitSuspicion(unit, middle, len(p))


def frozen_spans(
    time_ns: ArrayLike, pressure: ArrayLike, longest: float = FROZEN_TIME
) -> list[tuple[int, int]]:
    """Spans in which a sensor repeated one value for too long.

    A coarse sensor at rest may do so without a fault. Whether it is frozen, only motion shows,
    which the vertical channel takes into account.

    Parameters
    ----------
    time_ns : array_like of int, shape (n,)
        Increasing.
    pressure : array_like, shape (n,)
        Pa.
    longest : float, optional
        Shortest span that is reported, s.

    Returns
    -------
    list of tuple of int
        First and last stamp of each, ns.
    """
    stamps = np.asarray(time_ns, dtype=np.int64)
    p = np.asarray(pressure, dtype=np.float64)
    if not len(p):
        return []
    first = np.flatnonzero(np.concatenate([[True], p[1:] != p[:-1]]))
    last = np.concatenate([first[1:], [len(p)]]) - 1
    long = stamps[last] - stamps[first] >= round(longest * 1e9)
    return [(int(stamps[a]), int(stamps[b])) for a, b in zip(first[long], last[long], strict=True)]
