"""Where magnetic north is: the World Magnetic Model."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

from sinstool.core.timeline import SECOND

# m: the model is of the air and of near space, not of the mantle.
LOWEST = -10_000.0


def model_declination(
    latitude: float, longitude: float, height: float, time_ns: int
) -> float | None:
    """Declination of the Earth's field, rad, positive to the east.

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
    float or None
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
    return float(np.radians(result.d))
