"""Normal gravity in compiled loops, to the same digits as `sinstool.core.earth`."""

from __future__ import annotations

from sinstool.core import earth
from sinstool.core.parts import part


@part()
def normal_gravity(sin2: float, root: float, height: float) -> float:
    """Normal gravity, see :func:`sinstool.core.earth.normal_gravity`.

    Parameters
    ----------
    sin2 : float
        Squared sine of latitude.
    root : float
        Square root of 1 - e^2 sin2, which the radii of curvature need too.
    height : float
        m.

    Returns
    -------
    float
        m/s^2.
    """
    relative = height / earth.SEMI_MAJOR_AXIS
    return (
        earth.NORMAL_GRAVITY_EQUATOR
        * (1.0 + earth.SOMIGLIANA * sin2)
        / root
        * (
            1.0
            - (earth.GRAVITY_PER_HEIGHT - earth.GRAVITY_PER_HEIGHT_SIN2 * sin2) * height
            + 3.0 * relative * relative
        )
    )
