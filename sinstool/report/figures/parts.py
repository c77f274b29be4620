"""Shared parts of figures: names of axes, labels, units, the track."""

from __future__ import annotations

import numpy as np

from sinstool.core.earth import local_position_n
from sinstool.core.units import DEGREE
from sinstool.report.figure import Figure, FloatArray, Series

AXES = ("north", "east", "down")
BODY = ("forward", "right", "down")
LOG_TIME = "time since the log's start, s"
# Lengths beyond this, m, are shown in km.
LONG = 5000.0
# Numbers among the colours of curves.
_FIRST, _END, _START, _GREY = 0, 1, 2, 9


def positive(values: FloatArray, least: float = 0.0) -> FloatArray:
    """Values for a logarithmic axis, with holes where they are not above the least."""
    return np.where(np.isfinite(values) & (values > least), values, np.nan)


def both_sides(
    name: str, x: FloatArray, one: FloatArray, other: FloatArray, colour: int | None = None
) -> Series:
    """Both edges of a band as one curve with a hole in it."""
    y = np.concatenate([one, [np.nan], other])
    return Series(name, y, np.concatenate([x, x[-1:], x]), "dashed", colour=colour)


def length(values: FloatArray) -> tuple[float, str]:
    """A unit in which lengths read well, by the largest of them.

    Parameters
    ----------
    values : ndarray
        Lengths, m; NaN is left out.

    Returns
    -------
    size : float
        Of the unit, m.
    unit : {"m", "km"}
    """
    most = np.nanmax(np.abs(values), initial=0.0)
    return (1000.0, "km") if most > LONG else (1.0, "m")


def track(
    name: str,
    latitude: FloatArray,
    longitude: FloatArray,
    fixes: FloatArray | None = None,
    speed: FloatArray | None = None,
) -> Figure:
    """Track of the vehicle, on the plane tangent to the ellipsoid at its first place.

    Parameters
    ----------
    name : str
        Of the curve.
    latitude, longitude : ndarray, shape (n,)
        rad; NaN makes holes, but not at the first place.
    fixes : ndarray, shape (k, 2), optional
        Latitude and longitude of those of GNSS, rad.
    speed : ndarray, shape (n,), optional
        m/s, by which the curve is coloured.
    """
    origin = latitude[0], longitude[0]
    north, east = _on_plane(latitude, longitude, origin)
    size, unit = length(np.concatenate([north, east]))
    series = [Series(name, north / size, colour=_FIRST, shade=speed)]
    if fixes is not None and len(fixes):
        north_f, east_f = _on_plane(fixes[:, 0], fixes[:, 1], origin)
        dots = Series("GNSS fixes", north_f / size, x=east_f / size, style="halo", colour=_GREY)
        series.insert(0, dots)
    last = np.flatnonzero(np.isfinite(north))[-1]
    for end, k, colour in (("start", 0, _START), ("end", last, _END)):
        at = east[[k]] / size
        series.append(Series(end, north[[k]] / size, x=at, style="points", colour=colour))
    note = (
        f"On the plane at the first place, {origin[0] / DEGREE:.6f} deg north,"
        f" {origin[1] / DEGREE:.6f} deg east; one scale on both axes."
    )
    labels = f"east, {unit}", f"north, {unit}"
    shade = "" if speed is None else "speed, m/s"
    return Figure(
        "track", "Track", east / size, tuple(series), *labels, notes=(note,), equal=True,
        shade_label=shade,
    )  # fmt: skip


def _on_plane(
    latitude: FloatArray, longitude: FloatArray, origin: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """North and east of places of the ellipsoid, m."""
    ground = np.zeros_like(latitude)
    places = np.stack([latitude, longitude, ground], axis=1)
    north, east, _ = local_position_n((*origin, 0.0), places).T
    return north, east
