"""The finding that gyros missed a turn."""

from __future__ import annotations

from sinstool.core.finding import Finding, Severity
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.attitude_smoother.missed_turn import MissedTurn


def missed_finding(missed: list[MissedTurn], first_ns: int, compassed: bool) -> Finding:
    """That gyros missed turns between rests: the largest, and how many there are.

    Parameters
    ----------
    missed : list of MissedTurn
        At least one.
    first_ns : int
        From which seconds of the log count.
    compassed : bool
        A magnetometer corrects heading.
    """
    worst = max(missed, key=lambda one: one.angle)
    begin, end = ((t - first_ns) / SECOND for t in (worst.start_ns, worst.end_ns))
    angle = worst.angle / DEGREE
    more = f" (the worst of {len(missed)} times)" if len(missed) > 1 else ""
    return Finding(
        "missed-turn",
        f"between the rests at {begin:.1f} and {end:.1f} s the gyros missed a turn of {angle:.0f}"
        f" deg or more, as gravity shows{more}: do not trust "
        + (
            "the attitude meanwhile"
            if compassed
            else "roll and pitch meanwhile, nor heading from then on"
        ),
        start_ns=worst.start_ns,
        end_ns=worst.end_ns,
        severity=Severity.LOST,
        answer="look for a gyro that hangs or saturates, a wrong scale or sign of an axis, or lost"
        " samples",
        numbers={"angle_deg": angle, "times": len(missed)},
    )
