"""Whether gravity is in the specific force of a log."""

from __future__ import annotations

from sinstool.core.units import STANDARD_GRAVITY
from sinstool.survey.odd_units import steady_force, usual_force
from sinstool.survey.source import Source


def without_gravity(source: Source) -> bool:
    """Whether the specific force is not gravity and what accelerations of a vehicle add to it.

    Of a size between a half and two g it may be that of one that circles, or of sensors with a
    wrong scale, which still show where gravity points. What varies, as that of a foot that runs,
    may be larger by as much as it varies: over some seconds, in axes that do not turn, its mean is
    gravity all the same.
    """
    kinds = {odd.kind for odd in source.findings}
    if "gravity-size" in kinds:
        return usual_force(source.survey) <= 0.5 * STANDARD_GRAVITY or (
            steady_force(source.survey) >= 2.0 * STANDARD_GRAVITY
        )
    return "no-gravity" in kinds
