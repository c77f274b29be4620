"""Findings about what a smoothed attitude leaves open: biases of gyros, kinds of motion."""

from __future__ import annotations

from sinstool.core.finding import Finding
from sinstool.core.timeline import SECOND
from sinstool.core.units import DEGREE
from sinstool.methods.attitude_smoother.even_turn import EvenTurn
from sinstool.survey.rest import REST_S


def no_rest_finding(quiet_s: float, drift: str, heading_sigma_deg: float) -> Finding:
    """A log without a rest.

    Parameters
    ----------
    quiet_s : float
        Duration of the quietest part.
    drift : str
        By which heading may have drifted at the end.
    heading_sigma_deg : float
        The same as a number.
    """
    what = "the log has no rest of 2 s"
    if quiet_s >= REST_S:
        what = f"the quietest {quiet_s:.0f} s of the log are no sure rest"
    return Finding(
        "no-rest",
        f"{what}, so the gyro"
        " bias about the vertical is not observable: by the end heading may have"
        f" drifted by {drift}",
        answer="record some seconds at rest, or give --gyro-bias X,Y,Z",
        numbers={"heading_sigma_deg": heading_sigma_deg},
    )


def steady_rate_finding(rate: float) -> Finding:
    """A rate, rad/s, that a log shows nearly all the time."""
    return Finding(
        "steady-rate",
        f"the IMU shows a steady {rate / DEGREE:.2g} deg/s nearly all the time: either the"
        " gyro bias at rest, which is assumed, or a steady turn, and then roll and pitch"
        " are wrong by the angle between the specific force and the vertical",
        answer="give --gyro-bias X,Y,Z, or record other motion too",
        numbers={"rate_deg_s": rate / DEGREE},
    )


def even_turn_finding(turn: EvenTurn, first_ns: int, heading_sigma_deg: float) -> Finding:
    """A rest that may be an even turn.

    Parameters
    ----------
    first_ns : int
        Time of the first sample.
    heading_sigma_deg : float
        At the end of the log.
    """
    begin, end = ((time - first_ns) / SECOND for time in (turn.start_ns, turn.end_ns))
    rate = abs(turn.rate) / DEGREE
    return Finding(
        "steady-rate",
        f"from {max(begin, 0.0):.1f} to {end:.1f} s the IMU shows a steady {rate:.2g} deg/s about"
        " the vertical and hardly any rate across it: either a gyro bias at rest, or an even turn,"
        " which looks the same; by the end heading may have drifted by"
        f" {heading_sigma_deg:.2g} deg (1 sigma)",
        start_ns=turn.start_ns,
        end_ns=turn.end_ns,
        answer="give --gyro-bias X,Y,Z, or record some seconds at rest for sure",
        numbers={"rate_deg_s": rate, "heading_sigma_deg": heading_sigma_deg},
    )


def unsure_motion_finding(motion: str, margin_nat: float) -> Finding:
    """The motion of a hand or of a vehicle, where it could be the other one's."""
    other = "vehicle" if motion == "hand" else "hand"
    return Finding(
        "unsure-motion",
        f"the motion was taken for that of a {motion}, but might be that of a {other}:"
        " with the wrong choice roll and pitch can be degrees off",
        answer=f"choose with --motion {motion} or {other}",
        numbers={"margin_nat": margin_nat},
    )
