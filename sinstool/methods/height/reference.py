"""The height reference of the vertical channel: barometric heights, or heights of GNSS.

Pressure altitude is that of a standard day. A :class:`BaroReference` turns it into height above the
ellipsoid, by an altimeter setting, by GNSS heights, or by a known height at the start; where the
log climbs far enough with GNSS, it also has the scale of a warmer or colder day (3.5 % for each
10 K).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sinstool.core.arrays import ArrayLike, FloatArray, IntArray
from sinstool.core.order_statistics import SIGMA_PER_MAD, median, quantile
from sinstool.core.timeline import SECOND
from sinstool.methods.height.layout import ACCEPTED
from sinstool.methods.height.pressure import pressure_reason
from sinstool.methods.height.standard_atmosphere import (
    geometric,
    height_per_pascal,
    pressure_altitude,
)

GNSS_WINDOW = 30.0
"""Span of GNSS heights that set the barometer's offset, s."""

MIN_SCALE_RANGE = 100.0
"""Range of GNSS heights below which a fitted scale is not applied, m."""

SCALE_BOUNDS = (0.85, 1.15)
"""Scales that the temperature of a day can cause."""

LONGEST_LAG = 5.0
"""Lag of a barometer's heights behind those of GNSS, or ahead of them, that is believed, s."""

# The climb is the change of height over so long before and after, s.
_CLIMB_S = 5.0
# Rounds of a robust fit at most, and by which, m and m per 100 m, the last changes it.
_HUBER_ROUNDS, _HUBER_CLOSE = 200, 1e-9


@dataclass(frozen=True)
class BaroReference:
    """How pressure becomes height above the ellipsoid: ``offset + scale * geometric height``.

    Attributes
    ----------
    mode : {"qnh", "gnss", "init"}
    offset : float
        m.
    scale : float
        1 unless fitted.
    samples : int
        Heights that it rests on; 0 for an altimeter setting.
    fit : ScaleFit, optional
        The fit of the scale, also where it was not applied.
    """

    mode: Literal["qnh", "gnss", "init"]
    offset: float
    scale: float = 1.0
    samples: int = 0
    fit: ScaleFit | None = None

    def height(self, pressure: ArrayLike) -> FloatArray:
        """Height above the ellipsoid, m, NaN for impossible pressures.

        Parameters
        ----------
        pressure : array_like, shape (...)
            Pa.
        """
        return np.asarray(self.offset + self.scale * _standard_height(pressure))

    def sigma(self, pressure: ArrayLike, variance: ArrayLike) -> FloatArray:
        """Standard deviation of the height, m.

        Parameters
        ----------
        pressure : array_like, shape (...)
            Pa.
        variance : array_like, shape (...)
            Pa^2; 0 for unknown gives 0.
        """
        slope = self.scale * np.abs(height_per_pascal(pressure))
        return np.asarray(slope * np.sqrt(np.asarray(variance, dtype=np.float64)))


@dataclass(frozen=True)
class ScaleFit:
    """GNSS heights as ``offset + scale * standard height``, by robust least squares.

    Attributes
    ----------
    offset : float
        m.
    height_range : float
        Of the GNSS heights used, 1st to 99th percentile, m.
    applied : bool
        Whether the range of heights was large enough and the scale lies within SCALE_BOUNDS.
    """

    offset: float
    scale: float
    height_range: float
    samples: int
    applied: bool


def reference_from_setting(qnh: float, undulation: float = 0.0) -> BaroReference:
    """Heights by an altimeter setting.

    Parameters
    ----------
    qnh : float
        Pa.
    undulation : float, optional
        Height of mean sea level above the ellipsoid, m: -107 to 86 over the Earth. With 0, the
        heights are above mean sea level.

    Raises
    ------
    ValueError
        If the setting is no air pressure at sea level.
    """
    if not 8e4 <= qnh <= 1.1e5:
        raise ValueError(f"Expected an altimeter setting between 800 and 1100 hPa, got {qnh} Pa.")
    # A shift in geopotential height is one in geometric height, but for 0.3 % of it at 10 km.
    return BaroReference("qnh", undulation - float(pressure_altitude(qnh)))


def reference_from_start(pressure: ArrayLike, height: float) -> BaroReference:
    """Reference heights that begin at a given initial height.

    Parameters
    ----------
    pressure : array_like, shape (n,)
        The first samples, Pa; say, those of the first second.
    height : float
        Above the ellipsoid, m.

    Raises
    ------
    ValueError
        If no pressure lies between 8.68 and 1200 hPa.
    """
    p = np.asarray(pressure, dtype=np.float64)
    p = p[pressure_reason(p) == ACCEPTED]
    if not len(p):
        raise ValueError("Expected at least one pressure between 8.68 and 1200 hPa.")
    return BaroReference("init", height - float(median(_standard_height(p))), samples=len(p))


def reference_from_gnss(
    time_ns: ArrayLike, pressure: ArrayLike, gnss_time_ns: ArrayLike, gnss_height: ArrayLike
) -> BaroReference | None:
    """Heights set by GNSS: its median over the first 30 s, and the day's scale where it shows.

    Parameters
    ----------
    time_ns : array_like of int, shape (n,)
        Increasing.
    pressure : array_like, shape (n,)
        Pa.
    gnss_time_ns : array_like of int, shape (m,)
        Of valid 3-D fixes, increasing.
    gnss_height : array_like, shape (m,)
        Above the ellipsoid, m; NaN rows are left out.

    Returns
    -------
    BaroReference or None
        With ``fit`` set wherever a fit was possible; its scale and offset are used where
        ``fit.applied``. None if no fix falls between two pressures.
    """
    standard, heights, times = _paired(time_ns, pressure, gnss_time_ns, gnss_height)
    if not len(times):
        return None
    early = times - times[0] <= round(GNSS_WINDOW * 1e9)
    offset = float(median(heights[early] - standard[early]))
    reference = BaroReference("gnss", offset, samples=int(np.count_nonzero(early)))
    if len(times) < 10:
        return reference
    seconds = (times - times[0]) * 1e-9
    before, after = (np.interp(seconds + s, seconds, standard) for s in (-_CLIMB_S, _CLIMB_S))
    fit = fit_scale(standard, heights, (after - before) / (2.0 * _CLIMB_S))
    reference = replace(reference, fit=fit)
    if fit.applied:
        reference = replace(reference, offset=fit.offset, scale=fit.scale, samples=fit.samples)
    return reference


def fit_scale(
    standard_height: ArrayLike, gnss_height: ArrayLike, climb: ArrayLike | None = None
) -> ScaleFit:
    """Fit ``h_GNSS = offset + scale * h + lag * climb`` with Huber's loss.

    A barometer that lags, holds its samples, or is stamped late, is too low in each climb, which
    one climb from a rest would show as a scale.

    Parameters
    ----------
    standard_height : array_like, shape (n,)
        Geometric height of a standard day, m.
    gnss_height : array_like, shape (n,)
        m.
    climb : array_like, shape (n,), optional
        Rate of change of the former, m/s; without it, or if the lag is none that a barometer has,
        that is 0.
    """
    h = np.asarray(standard_height, dtype=np.float64)
    g = np.asarray(gnss_height, dtype=np.float64)
    centre, level = float(median(h)), float(median(g))
    low, high = quantile(g, 0.01), quantile(g, 0.99)
    # The scale is searched per 100 m, so that both unknowns are of one size.
    columns = [np.ones_like(h), (h - centre) / 100.0]
    if climb is not None:
        columns.append(np.asarray(climb, dtype=np.float64))
    x = np.column_stack(columns)
    found, spread = np.array([0.0, 100.0, 0.0])[: len(columns)], 10.0
    # What is an outlier shows once a line is laid
    for _ in range(2):
        found = _huber_fit(x, g - level, found, max(1.345 * spread, 0.1))
        rest = g - level - x @ found
        spread = min(SIGMA_PER_MAD * float(median(np.abs(rest - median(rest)))), 10.0)
    if abs(found[2:]).max(initial=0.0) > LONGEST_LAG:
        return fit_scale(h, g)
    scale = float(found[1]) / 100.0
    applied = high - low > MIN_SCALE_RANGE and SCALE_BOUNDS[0] <= scale <= SCALE_BOUNDS[1]
    return ScaleFit(
        offset=level + float(found[0]) - scale * centre,
        scale=scale,
        height_range=float(high - low),
        samples=len(h),
        applied=bool(applied),
    )


def _huber_fit(x: FloatArray, y: FloatArray, start: FloatArray, limit: float) -> FloatArray:
    """Factors of columns fitted with Huber's loss, which is linear beyond a limit.

    Iteratively reweighted least squares, to convergence [1]_.

    References
    ----------
    .. [1] P. J. Huber, "Robust Statistics", 1981, section 7.8.
    """
    found = start
    for _ in range(_HUBER_ROUNDS):
        off = y - x @ found
        weighted = (limit / np.maximum(np.abs(off), limit))[:, None] * x
        # Of columns that do not vary the factor stays what it is
        change = np.linalg.lstsq(weighted.T @ x, weighted.T @ off, rcond=1e-10)[0]
        found = found + change
        if np.abs(change).max() <= _HUBER_CLOSE:
            break
    return found


def _standard_height(pressure: ArrayLike) -> FloatArray:
    p = np.asarray(pressure, dtype=np.float64)
    return geometric(pressure_altitude(np.where(pressure_reason(p) == ACCEPTED, p, np.nan)))


def _paired(
    time_ns: ArrayLike, pressure: ArrayLike, gnss_time_ns: ArrayLike, gnss_height: ArrayLike
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Standard heights at the times of GNSS heights, those heights, and the times."""
    stamps = np.asarray(time_ns, dtype=np.int64)
    p = np.asarray(pressure, dtype=np.float64)
    good = pressure_reason(p) == ACCEPTED
    stamps, h = stamps[good], _standard_height(p[good])
    times = np.asarray(gnss_time_ns, dtype=np.int64)
    heights = np.asarray(gnss_height, dtype=np.float64)
    if not len(stamps):
        return np.empty(0), np.empty(0), np.empty(0, np.int64)
    keep = np.isfinite(heights) & (times >= stamps[0]) & (times <= stamps[-1])
    times, heights = times[keep], heights[keep]
    seconds = (stamps - stamps[0]) * 1e-9
    return np.interp((times - stamps[0]) * 1e-9, seconds, h), heights, times


@dataclass(frozen=True)
class HeightReference:
    """Heights that damp the vertical channel.

    Attributes
    ----------
    kind : {'baro', 'gnss'}
    topic : str
    time_ns : ndarray of int64, shape (m,)
        When measured, in the order of arrival.
    height : ndarray, shape (m,)
        Above the ellipsoid, m, as far as the reference allows.
    reason : ndarray of int64, shape (m,)
        Why a sample must not be used, by :mod:`~sinstool.methods.height.layout`; 0 for usable ones.
    sigma : float
        Median of the sigma that the sensor states, m; 0 where it states none.
    baro : BaroReference or None
        How pressures became heights; None for GNSS, and for heights that the log holds.
    """

    kind: Literal["baro", "gnss"]
    topic: str
    time_ns: np.ndarray
    height: np.ndarray
    reason: np.ndarray
    sigma: float
    baro: BaroReference | None

    @property
    def first_height(self) -> float:
        """Median of the first second of usable heights, m; 0 if there is none."""
        good = (self.reason == ACCEPTED) & np.isfinite(self.height)
        times, heights = self.time_ns[good], self.height[good]
        if not len(times):
            return 0.0
        return float(median(heights[times - times[0] <= SECOND]))

    @property
    def arrival_ns(self) -> np.ndarray:
        """Times at which samples are used, ns, shape (m,): none before an earlier sample's."""
        return np.asarray(np.maximum.accumulate(self.time_ns))
