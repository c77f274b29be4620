"""The Earth's magnetic field at a place and a time: the World Magnetic Model."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from sinstool.core.timeline import SECOND

# m: the model is of the air and of near space, not of the mantle.
LOWEST = -10_000.0


@dataclass(frozen=True)
class EarthField:
    """The field at a place.

    Attributes
    ----------
    declination : float
        Of the horizontal field, east of true north, rad.
    dip : float
        Downwards, rad.
    size : float
        T.
    """

    declination: float
    dip: float
    size: float


def model_field(
    latitude: float, longitude: float, height: float, time_ns: int
) -> EarthField | None:
    """The Earth's field by the World Magnetic Model.

    Parameters
    ----------
    latitude, longitude : float
        rad.
    height : float
        m.
    time_ns : int
        Since 1970, UTC.

    Returns
    -------
    EarthField or None
        None where there is no model: for other years than those from 2010 to 2029.
    """
    # It takes time to import, and few logs need it
    from pygeomag import GeoMag, calculate_decimal_year

    when = datetime.fromtimestamp(time_ns // SECOND, UTC)
    place = float(np.degrees(latitude)), float(np.degrees(longitude))
    try:
        model = GeoMag(base_year=when.year)
        result = model.calculate(*place, max(height, LOWEST) / 1000.0, calculate_decimal_year(when))
    except ValueError:
        return None
    return EarthField(float(np.radians(result.d)), float(np.radians(result.i)), 1e-9 * result.f)
