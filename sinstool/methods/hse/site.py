"""Whether the Earth's rate that a turning base feels is that of the stated latitude."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from sinstool.core.earth import EARTH_RATE
from sinstool.core.order_statistics import median
from sinstool.core.units import DEGREE, DEGREE_PER_HOUR

# Share of the Earth's rate that errors of a rig and its gyros do not add to its part about north,
# and so many sigmas of the noise.
DOUBTFUL, SIGMAS = 0.01, 5.0


class Base(Protocol):
    """An alignment of a base over whole turns, or what is kept of one; angles in rad."""

    @property
    def heading(self) -> float:
        """Heading of the base."""

    @property
    def sigma_heading(self) -> float:
        """Of the heading."""

    @property
    def theta(self) -> float:
        """Pitch of the base."""

    @property
    def gamma(self) -> float:
        """Roll of the base."""

    @property
    def rate(self) -> float:
        """Rate of the table, rad/s."""

    @property
    def c_axial(self) -> float:
        """Relative error of the rate along the axis."""

    @property
    def latitude(self) -> float:
        """As stated."""

    @property
    def quality(self) -> dict[str, float]:
        """With ``rate_north_residual``, rad/s."""


def wrong_latitude(bases: Sequence[Base]) -> str:
    """Say at which latitude the Earth's rate about north would be what the gyros feel.

    The relative error of the rate along the axis, times the rate of the table, leans to the north
    with the axis and is taken off.

    Parameters
    ----------
    bases : sequence
        At one latitude; those without ``rate_north_residual`` are not looked at.

    Returns
    -------
    str
        Empty where the stated latitude will do, or nothing is known.
    """
    known = [base for base in bases if "rate_north_residual" in base.quality]
    if not known:
        return ""
    off = float(median([_off(base) for base in known]))
    latitude = known[0].latitude
    north = EARTH_RATE * np.cos(latitude)
    noise = median([base.sigma_heading for base in known]) * north / np.sqrt(len(known))
    if not abs(off) > max(DOUBTFUL * EARTH_RATE, SIGMAS * float(noise)):
        return ""
    felt = north + off
    text = (
        f"the gyros feel {felt / DEGREE_PER_HOUR:.2f} deg/h of the Earth's rotation about north,"
        f" but at latitude {latitude / DEGREE:.2f} deg it is {north / DEGREE_PER_HOUR:.2f} deg/h"
    )
    if abs(felt) <= EARTH_RATE:
        there = np.arccos(felt / EARTH_RATE) / DEGREE
        return f"{text}: they would at {there:.1f} deg north or south"
    return f"{text}, and nowhere more than {EARTH_RATE / DEGREE_PER_HOUR:.2f} deg/h"


def _off(base: Base) -> float:
    """Rate about north beyond that of the latitude, rad/s."""
    psi, theta, gamma = base.heading, base.theta, base.gamma
    lean = np.cos(psi) * np.sin(theta) * np.cos(gamma) + np.sin(psi) * np.sin(gamma)
    return float(base.quality["rate_north_residual"] - lean * base.c_axial * base.rate)
